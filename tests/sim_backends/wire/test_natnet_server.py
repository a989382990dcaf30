"""The NatNet server over real sockets: its own protocol, several clients, garbage, its end."""

from __future__ import annotations

import contextlib
import os
import random
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from sim_backends.errors import SimulationError
from sim_backends.wire import natnet_packets as natnet
from sim_backends.wire.natnet_clients import GRACE_S
from sim_backends.wire.natnet_server import NatNetServer, NatNetSettings
from sim_backends.wire.world import World
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.sim_backends.wire.natnet import Server, alive, wait_for, world_server

CONFIG = WorldConfig(
    uavs=(SimUav("u0", "a", (1.0, 2.0)), SimUav("u1", "b", (-1.0, 0.0))),
    ugvs=(SimUgv("g0", "c", (3.0, 0.0)),),
    pose_noise_m=0.0,
    pose_noise_rad=0.0,
    pose_latency_s=0.05,
)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"address": "localhost"}, "address is 'localhost'.*numeric"),
        ({"command_port": -1}, "command_port is -1"),
        ({"data_port": 70000}, "data_port is 70000"),
        ({"rate_hz": 0.0}, "rate_hz is 0.0"),
        ({"version": (2, 9)}, "version is"),
        ({"group": "10.0.0.1"}, "give a multicast address"),
        ({"group": "239.255.42.99", "data_port": 0}, "one data port for all"),
    ],
)
def test_nonsense_is_one_clear_error(settings: dict, message: str) -> None:
    with pytest.raises(SimulationError, match=message):
        NatNetSettings(**settings)


class Client:
    """A NatNet client by hand: what libmotioncapture sends, and no more."""

    def __init__(self, address: tuple[str, int]) -> None:
        self.command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.command.settimeout(20.0)
        self.command.connect(address)
        info = self.ask(natnet.CONNECT)
        assert struct.unpack_from("<H", info) == (natnet.SERVER_INFO,)
        (self.port,) = struct.unpack_from("<H", info, 276)
        self.model = self.ask(natnet.REQUEST_MODEL)
        self.data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.data.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self.data.settimeout(20.0)
        self.data.bind(("", self.port))

    def ask(self, kind: int) -> bytes:
        self.command.send(natnet.packet(kind))
        return self.command.recv(65535)

    def frames(self, count: int) -> list[bytes]:
        return [self.data.recv(65535) for _ in range(count)]

    def close(self) -> None:
        self.command.close()
        self.data.close()


def numbers(frames: list[bytes]) -> list[int]:
    return [struct.unpack_from("<i", f, 4)[0] for f in frames]


@pytest.fixture
def served(tmp_path: Path) -> Iterator[tuple[World, NatNetServer]]:
    """A server in a thread, and its world."""
    world = World.create(tmp_path, CONFIG)
    server = NatNetServer(world, NatNetSettings(command_port=0, data_port=0))
    stop = threading.Event()
    thread = threading.Thread(target=server.run, args=(stop,), daemon=True)
    thread.start()
    try:
        yield world, server
    finally:
        stop.set()
        thread.join()
        server.close()


@pytest.mark.wire
def test_every_client_gets_every_frame(served: tuple[World, NatNetServer]) -> None:
    clients = [Client(served[1].address) for _ in range(3)]
    assert len({c.port for c in clients}) == 3
    assert all(b"a\0" in c.model and b"b\0" in c.model and b"c\0" in c.model for c in clients)
    time.sleep(0.3)
    for client in clients:
        got = numbers(client.frames(25))
        assert got == list(range(got[0], got[0] + 25))
        client.close()


@pytest.mark.wire
def test_frames_come_on_time_and_late_by_the_latency(served: tuple[World, NatNetServer]) -> None:
    client = Client(served[1].address)

    def stamps_s(frame: bytes) -> tuple[float, float]:
        """When it was exposed and when sent: precision stamp, parameters and end follow the three time stamps."""
        exposed, _, sent = struct.unpack_from("<3Q", frame, len(frame) - 24 - 8 - 6)
        return exposed / natnet.CLOCK_HZ, sent / natnet.CLOCK_HZ

    # by the server's own stamps; a busy machine may keep it waiting, which is not made up for, but not each time
    for _ in range(10):
        stamps = [stamps_s(frame) for frame in client.frames(101)]
        took_s = stamps[-1][0] - stamps[0][0]
        late_s = sorted(sent_s - exposed_s for exposed_s, sent_s in stamps)
        assert took_s > 0.85
        assert late_s[0] > 0.049
        if took_s < 1.15 and late_s[50] < 0.08:
            break
    else:
        pytest.fail(f"100 frames took {took_s} s, and came {late_s[50]} s after they were seen")
    client.close()


@pytest.mark.wire
def test_who_has_gone_is_forgotten_and_its_port_is_free_again(tmp_path: Path) -> None:
    world = World.create(tmp_path, CONFIG)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        base = int(probe.getsockname()[1])
    server = NatNetServer(world, NatNetSettings(command_port=0, data_port=base))
    stop = threading.Event()
    thread = threading.Thread(target=server.run, args=(stop,), daemon=True)
    thread.start()
    try:
        first, second = Client(server.address), Client(server.address)
        assert first.port == base
        assert second.port > base
        first.close()
        wait_for(lambda: len(server._clients) == 1, GRACE_S + 20)
        third = Client(server.address)
        assert third.port == base
        third.frames(3)
        third.command.send(natnet.packet(natnet.DISCONNECT))
        wait_for(lambda: len(server._clients) == 1, 0.8 * GRACE_S)  # at its word, not by its silence
        second.frames(3)
        third.close()
        second.close()
    finally:
        stop.set()
        thread.join()
        server.close()


@pytest.mark.wire
def test_garbage_is_ignored_and_requests_unknown_to_it_are_refused(served: tuple[World, NatNetServer]) -> None:
    client = Client(served[1].address)
    rng = random.Random(5)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as noise:
        for turn in range(500):
            data = rng.randbytes(rng.randint(0, 60))
            if data[:2] not in (b"\0\0", b"\4\0"):
                noise.sendto(data, served[1].address)
            if turn % 50 == 0:  # a full socket would lose requests: let it come to this one
                assert client.ask(natnet.REQUEST)[:2] == struct.pack("<H", natnet.UNRECOGNIZED)
        noise.sendto(b"\xff" + rng.randbytes(60000), served[1].address)
    assert client.ask(natnet.REQUEST)[:2] == struct.pack("<H", natnet.UNRECOGNIZED)
    assert client.ask(natnet.CONNECT)[276:278] == struct.pack("<H", client.port)
    before = numbers(client.frames(1))[0]
    assert numbers(client.frames(50))[-1] > before
    client.close()


@pytest.mark.wire
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it(number: signal.Signals) -> None:
    with Server("--body", "a") as server:
        server.signal(number)
        assert server.process.wait(5.0) == 0


@pytest.mark.wire
def test_it_ends_with_its_parent() -> None:
    parent = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
    with Server("--parent", str(parent.pid)) as server:
        parent.kill()
        parent.wait()
        assert server.process.wait(20.0) == 0


@pytest.mark.wire
def test_a_port_that_is_taken_is_one_clear_error(tmp_path: Path) -> None:
    World.create(tmp_path, CONFIG)
    with world_server(tmp_path) as server:
        command = [sys.executable, "-m", "sim_backends.wire.natnet_server", "--command-port", str(server.port)]
        second = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert second.returncode == 2
        assert second.stderr.startswith(f"error: NatNet server: cannot serve on 127.0.0.1:{server.port}")
        assert "Traceback" not in second.stderr


@pytest.mark.wire
def test_no_world_is_one_clear_error(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sim_backends.wire.natnet_server", "--world", str(tmp_path), "--command-port", "0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert "holds no simulated world" in done.stderr


@pytest.mark.wire
def test_it_leaves_no_temporary_world_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with Server("--body", "a", "--body", "b") as server:
        assert list(tmp_path.iterdir())
        server.signal(signal.SIGTERM)
        server.process.wait(20.0)
    assert not list(tmp_path.iterdir())
    assert not alive(server.process.pid)


@pytest.mark.wire
def test_one_that_was_stopped_goes_on_at_its_rate(tmp_path: Path) -> None:
    World.create(tmp_path, CONFIG)
    with world_server(tmp_path) as server, contextlib.closing(Client((server.host, server.port))) as client:
        client.frames(5)
        server.signal(signal.SIGSTOP)
        time.sleep(0.5)
        client.data.settimeout(0.05)
        with contextlib.suppress(TimeoutError):
            while True:  # what was under way
                client.frames(1)
        os.kill(server.process.pid, signal.SIGCONT)
        client.data.settimeout(20.0)
        begun_s = time.monotonic()
        client.frames(60)
        assert time.monotonic() - begun_s > 0.4  # no burst of what was missed
