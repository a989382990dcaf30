"""The link of the simulated Crazyflie's process: cflib's sessions, logs, losses, nonsense, cost."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import cflib.crtp
import psutil
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crazyflie.syncLogger import SyncLogger

from tests.sim_backends.wire.crazyflie_rig import Server, log_rows, until

pytestmark = [pytest.mark.wire, pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")]


@pytest.fixture(scope="module", autouse=True)
def drivers() -> None:
    cflib.crtp.init_drivers()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Server]]:
    servers: list[Server] = []

    def begin(*options: str) -> Server:
        servers.append(Server(tmp_path / str(len(servers)), *options))
        return servers[-1]

    yield begin
    for server in servers:
        server.stop()


def test_connects_reads_writes_and_logs(start: Callable[..., Server]) -> None:
    server = start()
    said: list[str] = []
    cf = Crazyflie(rw_cache=server.cache)
    cf.console.receivedChar.add_callback(said.append)
    with SyncCrazyflie(server.uri, cf=cf) as scf:
        scf.wait_for_params()
        assert cf.platform.get_protocol_version() == 12
        assert cf.mem.mems == []
        assert cf.param.get_value("stabilizer.estimator") == "2"
        heard: dict[str, str] = {}
        cf.param.add_update_callback("ring", "effect", lambda name, value: heard.update({name: value}))
        cf.param.set_value("ring.effect", "7")
        until(lambda: heard.get("ring.effect") == "7")
        defaults: dict[str, object] = {}
        cf.param.get_default_value("ring.effect", lambda name, value: defaults.update({name: value}))
        until(lambda: defaults == {"ring.effect": 6})
        stored: list[bool] = []
        cf.param.persistent_store("ring.effect", lambda _, done: stored.append(done))
        until(lambda: stored == [True])
        rows = log_rows(scf, ("stateEstimate.x", "pm.vbat", "pm.state", "supervisor.info"), 20, 10)
        assert rows[-1]["pm.state"] == 0
        assert 3.7 < rows[-1]["pm.vbat"] < 4.2
        until(lambda: "up and running" in "".join(said))
    files = sorted(Path(server.cache).iterdir())
    assert len(files) == 2
    with server.connected(feed=False) as again:
        assert again.cf.param.get_value("ring.effect") == "7"
    assert sorted(Path(server.cache).iterdir()) == files


def test_the_log_keeps_its_period(start: Callable[..., Server]) -> None:
    with start("--clock-rate", "0.97").connected(feed=False) as scf:
        config = LogConfig("test", 20)
        config.add_variable("stateEstimate.z")
        stamps: list[int] = []
        times: list[float] = []
        with SyncLogger(scf, config) as logger:
            # a busy machine may keep the one who counts or the one who sends waiting, but not each time
            for stamp, _, _ in logger:
                stamps.append(stamp)
                times.append(time.monotonic())
                of_stamps, of_times = stamps[-1] - stamps[-100:][0], times[-1] - times[-100:][0]
                if len(stamps) >= 100 and abs(of_stamps - 99 * 20) <= 15 and abs(of_times - 1.98 / 0.97) < 0.3:
                    break
                assert len(stamps) < 1500, (of_stamps, of_times)
        assert min(b - a for a, b in pairwise(stamps)) > 0


def test_flies_on_through_loss_silence_and_a_dead_link(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        rows: list[int] = []
        config = LogConfig("z", 20)
        config.add_variable("stateEstimate.z")
        config.data_received_cb.add_callback(lambda stamp_ms, *_: rows.append(stamp_ms))
        scf.cf.log.add_config(config)
        config.start()
        until(lambda: len(rows) > 5)
        server.fault(loss=0.3)
        time.sleep(0.2)
        heard = len(rows)
        end = time.monotonic() + 30.0
        while server.height() < 0.4:  # a take-off that was lost is sent again
            assert time.monotonic() < end
            scf.cf.high_level_commander.takeoff(0.5, 1.0, yaw=None)
            time.sleep(0.3)
        until(lambda: len(rows) > heard + 80)
        # whoever it was that a busy machine kept waiting, a stamp tells how many periods lie between two rows
        periods = [round((b - a) / 20) for a, b in pairwise(rows[heard:])]
        usual = [n for n in periods if n <= 6]
        assert 0.5 < len(usual) / sum(usual) < 0.9
        until(lambda: abs(server.height() - 0.5) < 0.05)
        server.fault(silent=True)
        time.sleep(0.2)
        heard = len(rows)
        scf.cf.high_level_commander.go_to(0.6, -0.2, 0.5, 0.0, 1.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 0.6) < 0.05, "it hears")
        assert len(rows) == heard
        server.fault(lost=True)
        time.sleep(0.2)
        scf.cf.high_level_commander.land(0.0, 0.5, yaw=None)
        time.sleep(1.5)
        assert server.world.body(0).airborne
        assert len(rows) == heard
        server.fault()
        until(lambda: len(rows) > heard, "it is back")


def test_nonsense_scans_and_second_clients_do_no_harm(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected(feed=False) as scf, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(20.0)
        for junk in (b"", b"\x00", os.urandom(31), os.urandom(500), bytes(range(31)), b"\x30short"):
            other.sendto(junk, server.address)
        other.sendto(b"\xff", server.address)  # cflib's scan
        while other.recv(100)[0] & 0xF3 != 0xF3:
            pass
        other.sendto(b"\x90\x0c", server.address)  # somebody else asks: the answer is theirs
        while True:
            answer = other.recv(100)
            if answer[:2] == b"\x90\x8c":
                break
        assert len(log_rows(scf, ("pm.vbat",), 5)) == 5  # the stream is not stolen
    for _ in range(3):
        with server.connected(feed=False) as scf:
            assert len(log_rows(scf, ("pm.vbat",), 2)) == 2
    assert server.process.poll() is None


def test_it_needs_little_of_a_core(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        for i, names in enumerate((("stateEstimate.x", "stateEstimate.y"), ("pm.vbat",), ("supervisor.info",))):
            config = LogConfig(f"block{i}", 20)
            for name in names:
                config.add_variable(name)
            scf.cf.log.add_config(config)
            config.start()
        scf.cf.high_level_commander.takeoff(0.5, 1.0, yaw=None)
        process = psutil.Process(server.process.pid)
        time.sleep(1.0)
        before, begun = process.cpu_times(), time.monotonic()
        time.sleep(3.0)
        after, lasted = process.cpu_times(), time.monotonic() - begun
        share = (after.user + after.system - before.user - before.system) / lasted
        print(f"{share:.1%} of a core, {process.memory_info().rss / 2**20:.0f} MiB")
        assert share < 0.12
