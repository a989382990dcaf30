"""The simulated MAVLink vehicles fly over real sockets: offboard, guided, failsafes, decks, faults."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path

import pytest

from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.sim_backends.wire.mavlink_station import NAN, Station, flying, mavlink

pytestmark = pytest.mark.wire

ARM, TAKEOFF, LAND, SET_MODE = 400, 22, 21, 176
OFFBOARD, HOLD, LANDING = 0x60000, 0x3040000, 0x6040000


def test_a_flight_with_commands_that_are_lost_repeated_and_doubled() -> None:
    with flying("--param", "MIS_TAKEOFF_ALT=2", "--param", "MPC_TKO_SPEED=3") as s:
        assert s.newest["HEARTBEAT"].autopilot == mavlink.MAV_AUTOPILOT_PX4
        assert s.newest["HEARTBEAT"].type == mavlink.MAV_TYPE_QUADROTOR
        for confirmation in (0, 1, 2):
            assert s.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN, confirmation=confirmation) == 0
        for confirmation in (0, 1, 2):
            assert s.command(ARM, 1, confirmation=confirmation) == 0
        s.pump(0.3)
        assert sum("Armed by" in text for text in s.texts) == 1
        s.until(lambda: s.newest["EXTENDED_SYS_STATE"].landed_state == 2 and s.ned[2] < -1.8)
        assert s.command(SET_MODE, 1, 6) == 1, "no stream yet"
        s.stream = lambda: s.velocity(1.0, 0.0, 0.0)
        s.insist(SET_MODE, 1, 6)
        s.until(lambda: s.ned[0] > 1.0)
        assert s.mode == OFFBOARD
        assert s.command(ARM, 0) == 1
        s.stream = None
        s.until(lambda: s.mode == HOLD)
        assert time.monotonic() - s.streamed_s > 0.9, "COM_OF_LOSS_T"
        assert s.command(ARM, 0, 21196) == 0
        s.until(lambda: not s.armed and s.newest["EXTENDED_SYS_STATE"].landed_state == 1)


def test_offboard_loss_lands_as_configured_and_disarms() -> None:
    arguments = (
        "COM_OBL_RC_ACT=4",
        "COM_FAIL_ACT_T=0.5",
        "MPC_LAND_SPEED=2",
        "MPC_Z_V_AUTO_DN=2",
        "COM_DISARM_LAND=0.5",
    )
    with flying(*(x for a in arguments for x in ("--param", a))) as s:
        s.stream = lambda: s.position(0.0, 0.0, -3.0)
        s.insist(SET_MODE, 1, 6)
        assert s.command(ARM, 1) == 0
        s.until(lambda: s.ned[2] < -2.5)
        s.stream = None
        s.until(lambda: s.mode == LANDING)
        s.until(lambda: not s.armed)
        s.until(lambda: "Disarmed by landing" in s.texts)


def test_ardupilot_says_nothing_until_asked_and_velocities_time_out() -> None:
    with flying("--autopilot", "ardupilot", "--param", "GUID_TIMEOUT=1", "--param", "FS_GCS_ENABLE=5",
                "--param", "FS_GCS_TIMEOUT=2") as s:  # fmt: skip
        s.pump(1.5)
        assert set(s.newest) == {"HEARTBEAT"}
        s.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 10, 1))
        s.until(lambda: {"LOCAL_POSITION_NED", "SYS_STATUS", "BATTERY_STATUS", "EKF_STATUS_REPORT"} <= set(s.newest))
        assert s.command(SET_MODE, 1, 4) == 0
        assert s.command(ARM, 1) == 0
        assert s.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 3) == 0
        s.until(lambda: s.ned[2] < -2.7)
        s.stream = lambda: s.velocity(3.0, 0.0, 0.0)
        s.until(lambda: s.newest["LOCAL_POSITION_NED"].vx > 1.5)
        s.stream = None
        s.until(lambda: abs(s.newest["LOCAL_POSITION_NED"].vx) < 0.2)
        assert s.mode == 4
        x = s.ned[0] + 2.0
        s.send(s.position(x, 0.0, -3.0))
        s.until(lambda: s.ned[0] > x - 0.4)
        s.beats = False
        s.until(lambda: s.mode == 9)
        s.until(lambda: "GCS Failsafe" in s.texts)


def team(folder: Path, **more: object) -> World:
    uav = SimUav("uav0", "u", on="ugv0", capacity_j=2000.0, energy_j=1000.0)
    ugv = SimUgv("ugv0", "g", (5.0, 2.0), max_speed_mps=2.0, pad_height_m=0.5, dock_offsets_m=((0.0, 0.0),),
                 charge_s=None, charge_w=40.0)  # fmt: skip
    return World.create(folder, WorldConfig(uavs=(uav,), ugvs=(ugv,), **more))  # type: ignore[arg-type]


def set_faults(s: Station, world: World, faults: Modifiers) -> None:
    """Sets the UAV's faults and waits until they are surely in force: the turn under way may have looked before."""
    world.modify(0, faults)
    for _ in range(2):
        turn_s = world.body(0).time_s
        s.until(lambda before_s=turn_s: world.body(0).time_s != before_s)


def test_it_rides_charges_and_loses_its_link(tmp_path: Path) -> None:
    world = team(tmp_path)
    arguments = ("--world", str(tmp_path), "--position", "gps", "--param")
    quick = ("MIS_TAKEOFF_ALT=1.5", "--param", "MPC_LAND_SPEED=1.5", "--param", "COM_DISARM_LAND=0.5")
    with (
        flying(*arguments, *quick, "--vehicle", "uav0") as s,
        flying(*arguments, "NAV_ACC_RAD=0.3", "--vehicle", "ugv0") as g,
    ):
        s.until(lambda: "BATTERY_STATUS" in s.newest)
        assert s.newest["BATTERY_STATUS"].charge_state == mavlink.MAV_BATTERY_CHARGE_STATE_CHARGING
        assert world.body(0).charging
        g.stream = lambda: g.position(3.0, 0.0, 0.0)
        g.insist(SET_MODE, 1, 6)
        assert world.started_s is None
        assert g.command(ARM, 1) == 0
        carried_mps = 0.0

        def there() -> bool:
            nonlocal carried_mps
            s.turn()
            carried_mps = max(carried_mps, s.newest["LOCAL_POSITION_NED"].vx)
            return bool(g.ned[0] > 2.5)

        g.until(there)
        assert carried_mps > 0.5
        assert world.started_s is not None
        g.until(lambda: world.body(1).speed_mps == 0.0)
        g.until(lambda: math.dist(world.body(0).position_m[:2], world.body(1).position_m[:2]) < 0.1)
        assert world.body(0).on == 1
        assert world.body(1).given_j > 0
        s.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN)
        assert s.command(ARM, 1) == 0
        s.until(lambda: world.body(0).position_m[2] > 1.8)
        assert world.body(0).on == -1
        s.until(lambda: s.newest["BATTERY_STATUS"].charge_state != 7)
        set_faults(s, world, Modifiers(silent=True, dock_miss=1))
        s.pump(0.2)
        n = len(s.all["HEARTBEAT"])
        s.command(LAND, wait=False)
        s.until(lambda: world.body(0).position_m[2] < 1.5)  # silent, but it obeys
        s.pump(1.2)
        assert len(s.all["HEARTBEAT"]) == n
        world.modify(0, replace(world.modifiers(0), silent=False))
        s.until(lambda: not s.armed and world.body(0).on == 1)
        assert not world.body(0).charging, "beside the contact"
        assert world.modifiers(0).dock_miss == 0
        set_faults(s, world, Modifiers(lost=True))
        s.command(ARM, 1, wait=False)
        s.pump(1.0)
        assert not world.body(0).armed


def test_motor_failure_brings_it_down(tmp_path: Path) -> None:
    world = team(tmp_path)
    with flying(
        "--position", "gps", "--world", str(tmp_path), "--vehicle", "uav0", "--param", "MIS_TAKEOFF_ALT=3"
    ) as s:
        s.command(TAKEOFF, 0, 0, 0, NAN, NAN, NAN, NAN)
        s.command(ARM, 1)
        s.until(lambda: world.body(0).position_m[2] > 3.0)
        world.modify(0, replace(world.modifiers(0), motor_fail=True))
        s.until(lambda: world.body(0).tumbled)
        assert world.body(0).code == 3
