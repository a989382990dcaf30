"""cflib's own calls, as in its examples, against the simulated Crazyflie's process."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import cflib.crtp
import psutil
import pytest
from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crazyflie.syncLogger import SyncLogger
from cflib.positioning.motion_commander import MotionCommander
from cflib.positioning.position_hl_commander import PositionHlCommander
from cflib.utils.power_switch import PowerSwitch
from cflib.utils.reset_estimator import reset_estimator

from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav, SimUgv, WorldConfig

pytestmark = [pytest.mark.wire, pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")]

ROOT = Path(__file__).parents[3]
FLYING, LOCKED = 0x10, 0x40
UAV = SimUav("uav0", "u", (0.3, -0.2), tracking_noise_m=0.01, dock_noise_m=0.003, energy_j=200_000.0)
UGV = SimUgv("ugv0", "g", (1.0, -0.2), pad_height_m=0.2, dock_offsets_m=((0.0, 0.0),), charge_s=60.0)


class Server:
    """The process, its world, and the motion capture that this test plays."""

    def __init__(self, folder: Path, *options: str) -> None:
        config = WorldConfig((UAV,), (UGV,), dock_tolerance_m=0.05)
        self.world = World.create(folder / "world", config)
        self.world.put(1, self.world.body(1))
        self.cache = str(folder / "cache")
        command = [sys.executable, "-m", "sim_backends.wire.crazyflie_server", "--world", str(self.world.folder)]
        self.process = subprocess.Popen(
            [*command, "--port", "0", *options], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        word, _, self.uri = self.process.stdout.readline().strip().partition(" ")
        assert word == "ready"
        self.address = ("127.0.0.1", int(self.uri.rpartition(":")[2]))

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait(5.0)

    @contextlib.contextmanager
    def connected(self, *, feed: bool = True) -> Iterator[SyncCrazyflie]:
        with SyncCrazyflie(self.uri, cf=Crazyflie(rw_cache=self.cache)) as scf:
            scf.wait_for_params()
            over = threading.Event()
            eyes = threading.Thread(target=self._feed, args=(scf.cf, over))
            if feed:
                eyes.start()
            try:
                yield scf
            finally:
                over.set()
                if feed:
                    eyes.join()

    def _feed(self, cf: Crazyflie, over: threading.Event) -> None:
        while not over.wait(0.02):
            body = self.world.body(0)
            cf.extpos.send_extpose(*map(float, body.position_m), *map(float, body.quaternion))

    def fault(self, **changes: object) -> None:
        self.world.modify(0, replace(Modifiers(swap=0), **changes))  # type: ignore[arg-type]

    def height(self) -> float:
        return float(self.world.body(0).position_m[2])


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


def until(condition: Callable[[], bool], seconds: float, what: str = "") -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"did not happen in time: {what}"
        time.sleep(0.02)


def log_rows(scf: SyncCrazyflie, names: tuple[str, ...], count: int, period_ms: int = 20) -> list[dict[str, float]]:
    config = LogConfig("test", period_ms)
    for name in names:
        config.add_variable(name)
    rows: list[dict[str, float]] = []
    with SyncLogger(scf, config) as logger:
        for _, row, _ in logger:
            rows.append(row)
            if len(rows) >= count:
                break
    return rows


def info(scf: SyncCrazyflie) -> int:
    return int(log_rows(scf, ("supervisor.info",), 1)[0]["supervisor.info"])


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
        until(lambda: heard.get("ring.effect") == "7", 2.0)
        defaults: dict[str, object] = {}
        cf.param.get_default_value("ring.effect", lambda name, value: defaults.update({name: value}))
        until(lambda: defaults == {"ring.effect": 6}, 2.0)
        stored: list[bool] = []
        cf.param.persistent_store("ring.effect", lambda _, done: stored.append(done))
        until(lambda: stored == [True], 2.0)
        rows = log_rows(scf, ("stateEstimate.x", "pm.vbat", "pm.state", "supervisor.info"), 20, 10)
        assert rows[-1]["pm.state"] == 0
        assert 3.7 < rows[-1]["pm.vbat"] < 4.2
        until(lambda: "up and running" in "".join(said), 2.0)
    files = sorted(Path(server.cache).iterdir())
    assert len(files) == 2
    with server.connected(feed=False) as again:
        assert again.cf.param.get_value("ring.effect") == "7"
    assert sorted(Path(server.cache).iterdir()) == files


def test_the_log_keeps_its_period(start: Callable[..., Server]) -> None:
    with start("--clock-rate", "0.97").connected(feed=False) as scf:
        config = LogConfig("test", 20)
        config.add_variable("stateEstimate.z")
        stamps = []
        with SyncLogger(scf, config) as logger:
            begun = time.monotonic()
            for stamp, _, _ in logger:
                stamps.append(stamp)
                if len(stamps) == 100:
                    break
            lasted = time.monotonic() - begun
        assert stamps[-1] - stamps[0] == pytest.approx(99 * 20, abs=15)
        assert lasted == pytest.approx(100 * 0.02 / 0.97, abs=0.3)


def test_high_level_flight_after_an_estimator_reset(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        reset_estimator(scf)
        commander = scf.cf.high_level_commander
        commander.takeoff(0.6, 1.5, yaw=None)
        until(lambda: server.height() > 0.55, 5.0, "take-off")
        commander.go_to(1.0, -0.2, 0.6, 0.0, 2.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 1.0) < 0.02, 4.0, "flight")
        until(lambda: info(scf) & 0x300 == 0x300, 2.0, "active and finished")
        commander.land(0.15, 1.5, yaw=None)
        until(lambda: log_rows(scf, ("pm.state",), 1)[0]["pm.state"] == 1, 5.0, "charging")
        body = server.world.body(0)
        assert (body.on, body.charging) == (1, True)
        age = int(log_rows(scf, ("locSrvZ.tick",), 1)[0]["locSrvZ.tick"])
        time.sleep(0.2)
        assert int(log_rows(scf, ("locSrvZ.tick",), 1)[0]["locSrvZ.tick"]) != age


def test_position_helper_and_low_level_helper(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        time.sleep(0.5)
        with PositionHlCommander(scf, x=0.3, y=-0.2, default_height=0.4, default_velocity=0.6) as helper:
            helper.go_to(0.6, -0.2)
            assert abs(server.world.body(0).position_m[0] - 0.6) < 0.1
        until(lambda: not server.world.body(0).airborne, 3.0)
        until(lambda: not info(scf) & FLYING, 4.0)
        with MotionCommander(scf, default_height=0.4) as motion:
            until(lambda: server.height() > 0.35, 3.0)
            motion.forward(0.3)
            until(lambda: abs(server.world.body(0).position_m[0] - 0.9) < 0.12, 2.0)
        until(lambda: not server.world.body(0).airborne, 3.0)
        time.sleep(2.5)  # the helper has handed back to the high-level commander: silence locks nothing
        assert not info(scf) & (LOCKED | FLYING)


def test_brushless_is_armed_and_stopped_through_the_supervisor(start: Callable[..., Server]) -> None:
    server = start("--variant", "brushless")
    with server.connected() as scf:
        supervisor = scf.cf.supervisor
        assert supervisor.can_be_armed
        supervisor.send_arming_request(True)
        until(lambda: bool(info(scf) & 2), 2.0)
        scf.cf.high_level_commander.takeoff(0.5, 1.0, yaw=None)
        until(lambda: server.height() > 0.4, 4.0)
        supervisor.send_emergency_stop()
        until(lambda: bool(info(scf) & LOCKED), 1.0)
        until(lambda: not server.world.body(0).airborne, 2.0)
        assert "Is locked" in supervisor.read_state_list()
        supervisor.send_arming_request(True)
        time.sleep(0.3)
        assert not info(scf) & 2
    PowerSwitch(server.uri).stm_power_cycle()
    with server.connected() as scf:
        assert not info(scf) & LOCKED


def test_old_firmware_without_some_groups(start: Callable[..., Server]) -> None:
    server = start("--protocol", "7", "--without", "pm,radio", "--variant", "brushless")
    with server.connected() as scf:
        cf = scf.cf
        assert cf.platform.get_protocol_version() == 7
        config = LogConfig("power", 100)
        config.add_variable("pm.vbat")
        with pytest.raises(KeyError, match=r"pm\.vbat"):
            cf.log.add_config(config)
        assert cf.supervisor.read_bitfield() == 0  # there is no port 9
        assert info(scf) == 1
        cf.supervisor.send_arming_request(True)
        until(lambda: bool(info(scf) & 2), 2.0)
        cf.high_level_commander.takeoff(0.4, 1.0, yaw=None)
        until(lambda: server.height() > 0.35, 4.0)
        cf.high_level_commander.go_to(0.6, -0.2, 0.4, 0.0, 1.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 0.6) < 0.05, 3.0)
        cf.supervisor.send_emergency_stop()
        until(lambda: bool(info(scf) & LOCKED), 1.0)


def test_flies_on_through_loss_silence_and_a_dead_link(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        rows: list[float] = []
        config = LogConfig("z", 20)
        config.add_variable("stateEstimate.z")
        config.data_received_cb.add_callback(lambda *_: rows.append(time.monotonic()))
        scf.cf.log.add_config(config)
        config.start()
        until(lambda: len(rows) > 5, 2.0)
        server.fault(loss=0.3)
        time.sleep(0.2)
        heard, begun = len(rows), time.monotonic()
        end = time.monotonic() + 6.0
        while server.height() < 0.4:  # a take-off that was lost is sent again
            assert time.monotonic() < end
            scf.cf.high_level_commander.takeoff(0.5, 1.0, yaw=None)
            time.sleep(0.3)
        time.sleep(1.0)
        rate = (len(rows) - heard) / (time.monotonic() - begun)
        assert 25.0 < rate < 45.0  # of 50
        assert server.height() == pytest.approx(0.5, abs=0.05)
        server.fault(silent=True)
        time.sleep(0.2)
        heard = len(rows)
        scf.cf.high_level_commander.go_to(0.6, -0.2, 0.5, 0.0, 1.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 0.6) < 0.05, 3.0, "it hears")
        assert len(rows) == heard
        server.fault(lost=True)
        time.sleep(0.2)
        scf.cf.high_level_commander.land(0.0, 0.5, yaw=None)
        time.sleep(1.5)
        assert server.world.body(0).airborne
        assert len(rows) == heard
        server.fault()
        until(lambda: len(rows) > heard, 2.0, "it is back")


def test_nonsense_scans_and_second_clients_do_no_harm(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected(feed=False) as scf, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(1.0)
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
