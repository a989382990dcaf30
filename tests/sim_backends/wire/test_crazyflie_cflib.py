"""cflib's own calls, as in its examples, fly the simulated Crazyflie."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cflib.crtp
import pytest
from cflib.crazyflie.log import LogConfig
from cflib.positioning.motion_commander import MotionCommander
from cflib.positioning.position_hl_commander import PositionHlCommander
from cflib.utils.power_switch import PowerSwitch
from cflib.utils.reset_estimator import reset_estimator

from tests.sim_backends.wire.crazyflie_rig import FLYING, LOCKED, Server, info, log_rows, until

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


def test_high_level_flight_after_an_estimator_reset(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        reset_estimator(scf)
        commander = scf.cf.high_level_commander
        commander.takeoff(0.6, 1.5, yaw=None)
        until(lambda: server.height() > 0.55, "take-off")
        commander.go_to(1.0, -0.2, 0.6, 0.0, 2.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 1.0) < 0.02, "flight")
        until(lambda: info(scf) & 0x300 == 0x300, "active and finished")
        commander.land(0.15, 1.5, yaw=None)
        until(lambda: log_rows(scf, ("pm.state",), 1)[0]["pm.state"] == 1, "charging")
        body = server.world.body(0)
        assert (body.on, body.charging) == (1, True)
        age = int(log_rows(scf, ("locSrvZ.tick",), 1)[0]["locSrvZ.tick"])
        until(lambda: int(log_rows(scf, ("locSrvZ.tick",), 1)[0]["locSrvZ.tick"]) != age)


def test_position_helper_and_low_level_helper(start: Callable[..., Server]) -> None:
    server = start()
    with server.connected() as scf:
        time.sleep(0.5)
        with PositionHlCommander(scf, x=0.3, y=-0.2, default_height=0.4, default_velocity=0.6) as helper:
            helper.go_to(0.6, -0.2)
            until(lambda: abs(server.world.body(0).position_m[0] - 0.6) < 0.1)
        until(lambda: not server.world.body(0).airborne)
        until(lambda: not info(scf) & FLYING)
        motion = MotionCommander(scf)
        motion.take_off(0.4, 0.5)
        until(lambda: server.height() > 0.35)
        motion.forward(0.3, 0.15)  # by time: who has to wait meanwhile goes too far, so slowly
        until(lambda: abs(server.world.body(0).position_m[0] - 0.9) < 0.12)
        motion.land(0.4)
        until(lambda: not server.world.body(0).airborne)
        time.sleep(2.5)  # the helper has handed back to the high-level commander: silence locks nothing
        assert not info(scf) & (LOCKED | FLYING)


def test_brushless_is_armed_and_stopped_through_the_supervisor(start: Callable[..., Server]) -> None:
    server = start("--variant", "brushless")
    with server.connected() as scf:
        supervisor = scf.cf.supervisor
        assert supervisor.can_be_armed
        supervisor.send_arming_request(True)
        until(lambda: bool(info(scf) & 2))
        scf.cf.high_level_commander.takeoff(0.5, 1.0, yaw=None)
        until(lambda: server.height() > 0.4)
        supervisor.send_emergency_stop()
        until(lambda: bool(info(scf) & LOCKED))
        until(lambda: not server.world.body(0).airborne)
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
        until(lambda: bool(info(scf) & 2))
        cf.high_level_commander.takeoff(0.4, 1.0, yaw=None)
        until(lambda: server.height() > 0.35)
        cf.high_level_commander.go_to(0.6, -0.2, 0.4, 0.0, 1.0)
        until(lambda: abs(server.world.body(0).position_m[0] - 0.6) < 0.05)
        cf.supervisor.send_emergency_stop()
        until(lambda: bool(info(scf) & LOCKED))
