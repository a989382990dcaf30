"""The motion-capture driver with the vendors' real client, against a NatNet server that is a process of its own."""

from __future__ import annotations

import contextlib
import itertools
import math
import os
import re
import signal
import socket
import statistics
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.mocap import Mocap, MocapOptions
from drivers.mocap_identity import identify
from drivers.vehicle import Pose, PoseSource
from sim_backends.wire import natnet_packets as natnet
from sim_backends.wire.world import Body, Modifiers, World, yaw_quaternion
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.sim_backends.wire.natnet import Server, alive, wait_for, world_server

pytestmark = pytest.mark.wire

CONFIG = WorldConfig(
    uavs=(SimUav("cf1", "cf1", (1.0, 2.0)), SimUav("cf2", "cf2", (-1.0, 0.0))),
    ugvs=(SimUgv("limo1", "limo1", (3.0, -2.0), yaw_rad=0.7),),
    pose_noise_m=0.001,
    pose_noise_rad=0.002,
)
BODIES = ("cf1", "cf2", "limo1")


class Rig:
    """A world, its server and a connected driver."""

    def __init__(self, folder: Path, *arguments: str, config: WorldConfig = CONFIG, **options: object) -> None:
        self.world = World.create(folder, config)
        self.server = world_server(folder, *arguments)
        self.clock = RealClock()
        self.mocap = self.make(**options)
        self.seen: dict[str, Pose] = {}

    def make(self, bodies: tuple[str, ...] = BODIES, **options: object) -> Mocap:
        base = MocapOptions("optitrack", self.server.host, self.server.port, interface_ip="127.0.0.1")
        return Mocap(replace(base, **options), bodies, self.clock)  # type: ignore[arg-type]

    def connect(self) -> None:
        self.mocap.connect(self.clock.now() + 30.0)

    def poll(self) -> dict[str, Pose]:
        fresh = {pose.body: pose for pose in self.mocap.read()}
        self.seen.update(fresh)
        return fresh

    def until(self, condition: Callable[[dict[str, Pose]], object], deadline_s: float = 20.0) -> None:
        def met() -> object:
            self.poll()
            return condition(self.seen)

        wait_for(met, deadline_s)

    def quiet(self, *bodies: str) -> Callable[[], bool]:
        """Whether none of these has come for 0.3 s."""
        return lambda: (
            self.poll() is not None
            and all(b not in self.seen or self.clock.now() - self.seen[b].stamp_s > 0.3 for b in bodies)
        )

    def close(self) -> None:
        self.mocap.close()
        self.server.__exit__()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    rig = Rig(tmp_path)
    rig.connect()
    yield rig
    rig.close()


def channels() -> int:
    """Sockets and pipes of this process."""
    count = 0
    for file in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            count += str(file.readlink()).startswith(("socket:", "pipe:"))
    return count


def children() -> list[psutil.Process]:
    return [p for p in psutil.Process().children() if "mocap_child" in " ".join(p.cmdline())]


@pytest.fixture(autouse=True)
def nothing_left() -> Iterator[None]:
    """No test leaves a child, a thread or a socket."""
    before = channels()
    yield
    assert not children()
    assert not [t for t in threading.enumerate() if t.name == "mocap"]
    assert channels() <= before


# --- what it reads


def test_it_reads_every_body_once_a_frame_at_the_servers_rate(rig: Rig) -> None:
    rig.poll()
    begun_s, stamps = rig.clock.now(), {body: list[float]() for body in BODIES}

    def period_s() -> float:
        """The middle one of the newest fifty: pauses of a busy machine are outliers."""
        for pose in rig.mocap.read():
            assert begun_s - 1.0 < pose.stamp_s <= rig.clock.now()
            stamps[pose.body].append(pose.stamp_s)
        newest = stamps["cf1"][-51:]
        return statistics.median(b - a for a, b in itertools.pairwise(newest)) if len(newest) == 51 else math.inf

    wait_for(lambda: 0.008 < period_s() < 0.0165, 40.0)
    assert len(stamps["cf1"]) < 103 * (rig.clock.now() - begun_s) + 20, "none comes twice"
    assert stamps["cf1"] == sorted(set(stamps["cf1"]))
    assert stamps["cf1"] == stamps["cf2"] == stamps["limo1"]


def test_it_reads_places_and_headings(rig: Rig) -> None:
    rig.until(lambda seen: len(seen) == 3)
    assert rig.seen["cf1"].position_m == pytest.approx((1.0, 2.0, 0.0), abs=0.01)
    assert rig.seen["limo1"].yaw_rad == pytest.approx(0.7, abs=0.02)
    rig.world.put(0, Body(position_m=(0.5, 0.25, 1.5), quaternion=yaw_quaternion(-2.0)))
    rig.until(lambda seen: seen["cf1"].position_m[2] > 1.0)
    assert rig.seen["cf1"].position_m == pytest.approx((0.5, 0.25, 1.5), abs=0.01)
    assert rig.seen["cf1"].yaw_rad == pytest.approx(-2.0, abs=0.02)


def test_the_newest_pose_is_kept_while_nobody_reads(rig: Rig) -> None:
    def newest() -> bool:
        time.sleep(0.5)
        poses = rig.mocap.read()
        assert len(poses) <= len(BODIES)
        return len(poses) == len(BODIES) and all(rig.clock.now() - p.stamp_s < 0.1 for p in poses)

    wait_for(newest)


def test_it_is_a_pose_source_that_closes_twice_and_connects_again(rig: Rig) -> None:
    source: PoseSource = rig.mocap
    source.close()
    source.close()
    assert source.read() == ()
    source.connect(rig.clock.now() + 30.0)
    rig.until(lambda seen: len(seen) == 3)


@pytest.mark.parametrize("arguments", [("--natnet", "3.1"), ("--up", "y")])
def test_it_understands_both_versions_and_both_axes(tmp_path: Path, arguments: tuple[str, str]) -> None:
    rig = Rig(tmp_path, *arguments, up="y" if "y" in arguments else "z")
    try:
        rig.world.put(0, Body(position_m=(0.5, 0.25, 1.5), quaternion=yaw_quaternion(1.0)))
        rig.connect()
        rig.until(lambda seen: len(seen) == 3)
        assert rig.seen["cf1"].position_m == pytest.approx((0.5, 0.25, 1.5), abs=0.01)
        assert rig.seen["cf1"].yaw_rad == pytest.approx(1.0, abs=0.02)
        assert rig.seen["limo1"].yaw_rad == pytest.approx(0.7, abs=0.02)
    finally:
        rig.close()


def test_it_turns_and_moves_the_system_into_the_arena(tmp_path: Path) -> None:
    rig = Rig(tmp_path, yaw_rad=math.pi / 2, translation_m=(10.0, 0.0, 0.5))
    try:
        rig.connect()
        rig.until(lambda seen: len(seen) == 3)
        assert rig.seen["cf1"].position_m == pytest.approx((8.0, 1.0, 0.5), abs=0.01)
        assert rig.seen["limo1"].yaw_rad == pytest.approx(0.7 + math.pi / 2, abs=0.02)
    finally:
        rig.close()


def test_it_hears_multicast(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        port = str(probe.getsockname()[1])
    group = f"239.255.{int(port) >> 8}.{int(port) & 255}"
    rig = Rig(tmp_path, "--multicast", group, "--data-port", port)
    other = rig.make()
    try:
        rig.connect()
        other.connect(rig.clock.now() + 30.0)
        rig.until(lambda seen: len(seen) == 3)
        wait_for(lambda: len(other.read()) == 3)
    finally:
        other.close()
        rig.close()


def test_two_programs_read_one_server(rig: Rig) -> None:
    other = rig.make()
    try:
        other.connect(rig.clock.now() + 30.0)
        rig.poll()
        wait_for(lambda: len(other.read()) == 3)
        rig.until(lambda seen: all(rig.clock.now() - p.stamp_s < 0.2 for p in seen.values()))
    finally:
        other.close()


# --- faults of motion capture reach the reader as they are


@pytest.mark.parametrize("modifiers", [Modifiers(dropout=True), Modifiers(lost=True)])
def test_a_body_out_of_sight_brings_no_poses(rig: Rig, modifiers: Modifiers) -> None:
    rig.world.modify(0, modifiers)
    wait_for(rig.quiet("cf1"))
    rig.until(lambda seen: rig.clock.now() - seen["cf2"].stamp_s < 0.2)
    assert rig.clock.now() - rig.seen["cf1"].stamp_s > 0.3
    rig.world.modify(0, Modifiers(swap=0))
    rig.until(lambda seen: rig.clock.now() - seen["cf1"].stamp_s < 0.2)


def test_a_frozen_pose_comes_again_and_again_to_the_bit(rig: Rig) -> None:
    rig.until(lambda seen: len(seen) == 3)
    rig.world.modify(2, Modifiers(freeze=True))
    newest = rig.seen["limo1"]

    def same(seen: dict[str, Pose]) -> bool:
        """Noise makes two poses in a row alike only when they are frozen."""
        nonlocal newest
        before, newest = newest, seen["limo1"]
        return newest.stamp_s > before.stamp_s and newest.position_m == before.position_m

    rig.until(same)
    frozen = rig.seen["limo1"]
    rig.until(lambda seen: seen["limo1"].stamp_s > frozen.stamp_s + 0.3)
    assert (rig.seen["limo1"].position_m, rig.seen["limo1"].yaw_rad) == (frozen.position_m, frozen.yaw_rad)


def test_jumps_and_swaps_are_seen(rig: Rig) -> None:
    rig.world.modify(0, Modifiers(jump_x=0.5))
    rig.until(lambda seen: "cf1" in seen and abs(seen["cf1"].position_m[0] - 1.5) < 0.02)
    rig.world.modify(0, Modifiers(swap=1))
    rig.world.modify(1, Modifiers(swap=0))
    rig.until(lambda seen: abs(seen["cf1"].position_m[0] + 1.0) < 0.02 and abs(seen["cf2"].position_m[0] - 1.0) < 0.02)


# --- what pre-flight asks


def test_the_checks_of_a_healthy_stream_pass_and_those_of_a_sick_one_do_not(rig: Rig) -> None:
    def healthy() -> bool:
        """At some time: a busy machine may lose frames."""
        checks = {c.name: c for c in rig.mocap.checks()}
        rate = checks["poses rate"].value
        return (
            checks.keys() >= {"poses noise", "poses visible", "poses others"}
            and all(checks[name].verdict == "pass" for name in ("poses noise", "poses visible", "poses others"))
            and rate == pytest.approx(85, abs=20)
        )

    wait_for(healthy, 40.0)
    assert {c.name: c for c in rig.mocap.checks()}["poses noise"].value == pytest.approx(0.001, rel=0.5)
    rig.world.modify(0, Modifiers(freeze=True))
    wait_for(lambda: any(c.name == "poses frozen" and "cf1" in c.text for c in rig.mocap.checks()))
    rig.server.kill()
    wait_for(lambda: any(c.name == "poses rate" and c.verdict == "fail" for c in rig.mocap.checks()))


def test_identity_through_the_real_stream(rig: Rig) -> None:
    rig.world.modify(0, Modifiers(swap=1))
    rig.world.modify(1, Modifiers(swap=0))

    def lift(text: str) -> None:
        for row, vehicle in enumerate(BODIES):
            body = rig.world.body(row)
            x, y, _ = body.position_m
            if f"lift or push {vehicle} " in text:
                rig.world.put(row, replace(body, position_m=(x, y, 0.3)))
            elif f"put {vehicle} down" in text:
                rig.world.put(row, replace(body, position_m=(x, y, 0.0)))

    results = identify(rig.mocap, {b: b for b in BODIES}, rig.clock, lift)
    assert [(r.verdict, r.moved) for r in results] == [("swapped", "cf2"), ("swapped", "cf1"), ("pass", None)]


# --- what goes wrong while it connects


def failure(mocap: Mocap, clock: RealClock, deadline_s: float) -> tuple[str, float]:
    begun_s = clock.now()
    with pytest.raises(DriverError) as caught:
        mocap.connect(begun_s + deadline_s)
    return str(caught.value), clock.now() - begun_s


def test_a_silent_host_is_an_error_at_the_deadline_and_the_program_lives_on() -> None:
    clock = RealClock()
    turns: list[float] = []
    stop = threading.Event()

    def work() -> None:
        while not stop.wait(0.005):
            turns.append(time.monotonic())

    worker = threading.Thread(target=work, daemon=True)
    worker.start()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        mocap = Mocap(MocapOptions("optitrack", "127.0.0.1", silent.getsockname()[1], attempt_s=0.5), ["a"], clock)
        try:
            text, took_s = failure(mocap, clock, 6.0)
        finally:
            stop.set()
            worker.join()
        silent.setblocking(False)
        asked = [silent.recv(100) for _ in range(2)]
    assert "motion capture (optitrack at 127.0.0.1:" in text
    assert re.search(r"no answer within \d+\.\d s; check that Motive streams", text)
    assert 5.9 < took_s < 9.0
    assert asked == [b"\0\0\0\0"] * 2  # it tried again: a lost datagram is no verdict
    assert max(b - a for a, b in itertools.pairwise(turns)) < 2.0


def test_a_host_that_does_not_exist_is_an_error() -> None:
    clock = RealClock()
    text, took_s = failure(Mocap(MocapOptions("optitrack", "no-such-host.invalid"), ["a"], clock), clock, 8.0)
    assert "no-such-host.invalid" in text
    assert took_s < 11.0


def test_a_host_name_is_resolved_for_a_client_that_wants_numbers(rig: Rig) -> None:
    mocap = rig.make(hostname="localhost")
    mocap.connect(rig.clock.now() + 30.0)
    mocap.close()


@pytest.mark.parametrize("kind", ["vicon", "qualisys", "vrpn"])
def test_nobody_there_is_an_error_for_every_type(kind: str) -> None:
    clock = RealClock()
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as closed:
        closed.bind(("127.0.0.1", 0))  # bound and not listening: refuses
        mocap = Mocap(MocapOptions(kind, "127.0.0.1", closed.getsockname()[1]), ["a"], clock)
        text, took_s = failure(mocap, clock, 2.0)
    assert text.startswith(f"motion capture ({kind} at 127.0.0.1:")
    assert "check that" in text
    assert took_s < 5.0


@contextlib.contextmanager
def answering(answer: Callable[[bytes], bytes]) -> Iterator[int]:
    """Something on a UDP port that answers as it is told; gives the port."""
    stop = threading.Event()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(0.05)

        def run() -> None:
            while not stop.is_set():
                with contextlib.suppress(TimeoutError):
                    request, sender = server.recvfrom(1000)
                    server.sendto(answer(request), sender)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            yield server.getsockname()[1]
        finally:
            stop.set()
            thread.join()


def test_a_server_of_another_kind_is_an_error() -> None:
    clock = RealClock()
    with answering(lambda _: b"\x63\x63nonsense" * 20) as port:
        text, took_s = failure(Mocap(MocapOptions("optitrack", "127.0.0.1", port), ["a"], clock), clock, 30.0)
    assert "Could not query NatNet version" in text
    assert took_s < 15.0


def test_a_client_that_crashes_takes_nobody_along() -> None:
    """A model that says more than it holds: the vendor's parser runs out of its buffer."""
    clock = RealClock()
    model = natnet.packet(natnet.MODEL, (2**31 - 1).to_bytes(4, "little") + b"\x01\0\0\0" + b"x" * 60000)

    def answer(request: bytes) -> bytes:
        return natnet.server_info((3, 1), 1511, None) if request[0] == natnet.CONNECT else model

    with answering(answer) as port:
        text, took_s = failure(Mocap(MocapOptions("optitrack", "127.0.0.1", port), ["a"], clock), clock, 30.0)
    assert "its client was ended by SIG" in text
    assert took_s < 15.0


def test_wrong_names_are_listed_with_what_is_there(rig: Rig) -> None:
    mocap = rig.make(("cf1", "Cf_2", "limo9000"), bodies_s=0.5)
    text, took_s = failure(mocap, rig.clock, 30.0)
    assert "it does not see 'Cf_2' (did you mean 'cf2'?), 'limo9000'" in text
    assert "it sees cf1, cf2, limo1." in text
    assert took_s < 15.0


def test_a_hidden_body_is_waited_for(rig: Rig) -> None:
    rig.mocap.close()
    rig.world.modify(1, Modifiers(dropout=True))
    threading.Timer(1.0, lambda: rig.world.modify(1, Modifiers(swap=1))).start()
    rig.mocap.connect(rig.clock.now() + 30.0)


def test_a_server_that_answers_but_sends_nothing_is_told_apart() -> None:
    clock = RealClock()

    def answer(request: bytes) -> bytes:
        return natnet.server_info((4, 1), free, None) if request[0] == natnet.CONNECT else natnet.model((4, 1), ["a"])

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("", 0))
        free = probe.getsockname()[1]
    with answering(answer) as port:
        mocap = Mocap(MocapOptions("optitrack", "127.0.0.1", port, silence_s=0.5), ["a"], clock)
        text, took_s = failure(mocap, clock, 5.0)
    assert re.search(r"it answers but has sent no frame for \d+\.\d s", text)
    assert "interface_ip if it multicasts" in text
    assert 4.9 < took_s < 8.0


def test_a_mock_needs_nobody() -> None:
    clock = RealClock()
    options = MocapOptions("mock", mock_bodies=(("a", (1.0, 2.0, 3.0)), ("b", (0.0, 0.0, 0.5))), mock_rate_hz=50)
    mocap = Mocap(options, ["a"], clock)
    mocap.connect(clock.now() + 30.0)

    def fresh() -> bool:
        (pose,) = mocap.read() or (None,)
        if pose is None:
            return False
        assert (pose.body, pose.position_m, pose.yaw_rad) == ("a", (1.0, 2.0, 3.0), 0.0)
        assert pose.stamp_s <= clock.now()
        return clock.now() - pose.stamp_s < 0.1

    for _ in range(3):
        wait_for(fresh)
    mocap.close()


# --- what goes wrong in flight


def test_a_dead_server_brings_silence_and_its_return_poses(tmp_path: Path) -> None:
    rig = Rig(tmp_path, silence_s=0.6, attempt_s=1.0)
    try:
        rig.connect()
        port, first_child = rig.server.port, rig.mocap.child_pid
        rig.server.kill()
        wait_for(rig.quiet(*BODIES))
        wait_for(lambda: rig.mocap.child_pid not in (None, first_child))

        def slowest_s() -> float:
            """Of as many reads as there are between two new connections and more."""
            slowest_s = 0.0
            for _ in range(200):
                begun_s = time.perf_counter()
                assert rig.mocap.read() == ()
                slowest_s = max(slowest_s, time.perf_counter() - begun_s)
                time.sleep(0.005)
            return slowest_s

        # reading never waits for anything but, on a busy machine, its turn
        assert any(slowest_s() < 0.1 for _ in range(5))
        rig.server.__exit__()
        rig.server = world_server(tmp_path, port=port)
        rig.until(lambda seen: all(rig.clock.now() - p.stamp_s < 0.2 for p in seen.values()))
        assert any(c.name == "poses connection" and c.verdict == "warn" for c in rig.mocap.checks())
    finally:
        rig.close()


@pytest.mark.parametrize("stopped_s", [0.8, 2.5])
def test_a_server_that_stands_still_is_silent_until_it_goes_on(tmp_path: Path, stopped_s: float) -> None:
    rig = Rig(tmp_path, silence_s=1.5)
    try:
        rig.connect()
        rig.server.signal(signal.SIGSTOP)
        wait_for(rig.quiet(*BODIES))
        time.sleep(stopped_s - 0.3)
        rig.server.signal(signal.SIGCONT)
        rig.until(lambda seen: all(rig.clock.now() - p.stamp_s < 0.2 for p in seen.values()))
    finally:
        rig.close()


def test_a_killed_child_is_started_again(rig: Rig) -> None:
    first = rig.mocap.child_pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    wait_for(lambda: rig.mocap.child_pid not in (None, first))
    begun_s = rig.clock.now()
    rig.until(lambda seen: all(p.stamp_s > begun_s for p in seen.values()) and len(seen) == 3)
    assert not alive(first)
    connection = next(c for c in rig.mocap.checks() if c.name == "poses connection")
    assert "lost 1 times (its client was ended by SIGKILL)" in connection.text


def test_a_child_that_hangs_is_replaced(tmp_path: Path) -> None:
    rig = Rig(tmp_path, silence_s=0.5)
    try:
        rig.connect()
        first = rig.mocap.child_pid
        assert first is not None
        os.kill(first, signal.SIGSTOP)
        wait_for(lambda: rig.mocap.child_pid not in (None, first))
        rig.until(lambda seen: len(seen) == 3 and all(rig.clock.now() - p.stamp_s < 0.2 for p in seen.values()))
        assert not alive(first)
    finally:
        rig.close()


def test_ctrl_c_in_the_terminal_does_not_reach_the_child(rig: Rig) -> None:
    assert rig.mocap.child_pid is not None
    assert os.getpgid(rig.mocap.child_pid) != os.getpgid(0)
    os.kill(rig.mocap.child_pid, signal.SIGINT)
    time.sleep(0.3)
    rig.poll()
    wait_for(rig.poll)
    assert alive(rig.mocap.child_pid)


PARENT = """
import sys, time
from drivers.clock import RealClock
from drivers.mocap import Mocap, MocapOptions
clock = RealClock()
mocap = Mocap(MocapOptions("optitrack", "127.0.0.1", int(sys.argv[1]), attempt_s=60.0), [], clock)
mocap.connect(clock.now() + 60.0)
print("connected", flush=True)
time.sleep(60.0)
"""


@pytest.mark.parametrize("hanging", [True, False], ids=["while connecting", "connected"])
def test_no_child_outlives_its_program(hanging: bool) -> None:
    silent = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    silent.bind(("127.0.0.1", 0))
    with silent, Server("--body", "a") as server:
        port = silent.getsockname()[1] if hanging else server.port
        with subprocess.Popen([sys.executable, "-c", PARENT, str(port)], stdout=subprocess.PIPE) as program:
            if hanging:
                silent.settimeout(30.0)
                silent.recv(100)  # now it hangs in connect, holding its GIL
            else:
                assert program.stdout is not None
                assert program.stdout.readline() == b"connected\n"
            (child,) = psutil.Process(program.pid).children()
            assert "mocap_child" in " ".join(child.cmdline())
            program.kill()
            program.wait()
            wait_for(lambda: not alive(child.pid))
