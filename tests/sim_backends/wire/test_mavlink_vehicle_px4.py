"""PX4's rules and time-outs, on a virtual clock."""

from __future__ import annotations

import math

import pytest

from sim_backends.wire.mavlink_autopilot import (
    ACCEPTED,
    ARM_DISARM,
    DENIED,
    FORCE_MAGIC,
    IN_AIR,
    LAND,
    LANDING,
    ON_GROUND,
    REJECTED,
    REPOSITION,
    RTL,
    SET_MODE,
    TAKEOFF,
    TAKING_OFF,
    TERMINATE,
    TERMINATED,
    UNSUPPORTED,
)  # fmt: skip
from sim_backends.wire.mavlink_modes import PX4_MODES
from sim_backends.wire.mavlink_px4 import action_in_effect
from tests.sim_backends.wire.mavlink_flight import Flight, position, velocity

NAN = math.nan
OFFBOARD, MANUAL_MODE, HOLD = (1.0, 6.0), (1.0, 1.0), (1.0, 4.0, 3.0)


def hovering(height_m: float = 10.0, **params: float) -> Flight:
    flight = Flight("px4", MIS_TAKEOFF_ALT=height_m, **params)
    assert flight.order(TAKEOFF, 0, 0, 0, 0, NAN, NAN, NAN) == ACCEPTED
    assert flight.order(ARM_DISARM, 1) == ACCEPTED
    flight.until(lambda: flight.pilot.shown == "HOLD" and flight.speed < 0.1)
    return flight


def offboard(**params: float) -> Flight:
    flight = hovering(**params)
    flight.streaming = lambda: velocity(2.0, 0.0, 0.0)
    flight.run(0.2)
    assert flight.order(SET_MODE, *OFFBOARD) == ACCEPTED
    flight.run(2.0)
    assert flight.pilot.shown == "OFFBOARD"
    return flight


@pytest.mark.parametrize(
    ("mode", "custom", "base"),
    [
        ("HOLD", 0x03040000, 29),
        ("TAKEOFF", 0x02040000, 29),
        ("LAND", 0x06040000, 29),
        ("RTL", 0x05040000, 29),
        ("OFFBOARD", 0x00060000, 17),
        ("POSCTL", 0x00030000, 81),
        ("MANUAL", 0x00010000, 65),
    ],
)
def test_heartbeat_of_each_mode(mode: str, custom: int, base: int) -> None:
    assert (PX4_MODES[mode].number, PX4_MODES[mode].flags) == (custom, base)


def test_takes_off_holds_and_lands_with_the_right_states() -> None:
    flight = Flight("px4")
    assert flight.pilot.landed_state == ON_GROUND
    flight.order(TAKEOFF, 0, 0, 0, 0, NAN, NAN, 488.0 + 8.0)
    assert flight.order(ARM_DISARM, 1) == ACCEPTED
    assert flight.pilot.base_mode & 128
    assert flight.until(lambda: not flight.copter.landed) >= 0.9, "motors spool up for 1 s"
    flight.run(1.0)
    assert flight.pilot.landed_state == TAKING_OFF
    flight.until(lambda: flight.pilot.shown == "HOLD")
    assert flight.pilot.landed_state == IN_AIR
    flight.run(4.0)
    assert abs(flight.ned[2] + 8.0) < 0.2
    flight.order(LAND)
    flight.run(1.0)
    assert flight.pilot.landed_state == LANDING
    flight.until(lambda: flight.copter.landed)
    assert 0.9 <= flight.until(lambda: flight.pilot.landed) <= 1.2
    assert 1.9 <= flight.until(lambda: not flight.pilot.armed) <= 2.1
    assert flight.pilot.mode == "HOLD"
    assert "Disarmed by landing" in flight.texts


def test_disarms_by_itself_10_s_after_arming_without_take_off() -> None:
    flight = Flight("px4")
    flight.order(ARM_DISARM, 1)
    assert 9.9 <= flight.until(lambda: not flight.pilot.armed) <= 10.1


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ({"position_ok": False}, "position"),
        ({"battery": 0.1}, "low battery"),
    ],
)
def test_arming_is_denied_with_a_reason(setting: dict[str, float], reason: str) -> None:
    flight = Flight("px4")
    for name, value in setting.items():
        setattr(flight, name, value)
    assert flight.order(ARM_DISARM, 1) == REJECTED
    flight.step()
    assert any(reason in text for text in flight.texts)
    assert "Arming denied: Resolve system health failures first" in flight.texts
    assert not flight.pilot.armed


def test_landing_modes_cannot_be_armed_in() -> None:
    flight = Flight("px4")
    flight.pilot.set_mode("LAND", flight.sense)
    assert flight.order(ARM_DISARM, 1) == REJECTED


def test_offboard_wants_its_stream_before_arming_and_before_switching() -> None:
    flight = Flight("px4")
    assert flight.order(SET_MODE, *OFFBOARD) == ACCEPTED, "any mode may be chosen while disarmed"
    assert flight.order(ARM_DISARM, 1) == REJECTED
    flight.pilot.set_point(position(0.0, 0.0, -5.0), flight.sense)
    assert flight.order(ARM_DISARM, 1) == ACCEPTED
    flying = hovering()
    assert flying.order(SET_MODE, *OFFBOARD) == REJECTED
    flying.pilot.set_point(position(0.0, 0.0, -5.0), flying.sense)
    flying.run(1.1)
    assert flying.order(SET_MODE, *OFFBOARD) == REJECTED, "the set-point is older than COM_OF_LOSS_T"


def test_offboard_takes_off_from_the_ground_and_lands_by_pushing_down() -> None:
    flight = Flight("px4")
    flight.streaming = lambda: position(0.0, 0.0, -5.0)
    flight.run(0.2)
    flight.order(SET_MODE, *OFFBOARD)
    flight.order(ARM_DISARM, 1)
    flight.until(lambda: abs(flight.ned[2] + 5.0) < 0.2)
    flight.streaming = lambda: position(0.0, 0.0, 0.0)
    flight.run(15.0)
    assert flight.pilot.armed, "at the height of the ground it is not landed yet"
    flight.streaming = lambda: velocity(0.0, 0.0, 0.5)
    flight.until(lambda: not flight.pilot.armed, 5.0)


@pytest.mark.parametrize(("act", "then"), [(0, "RTL"), (3, "RTL"), (4, "LAND"), (5, "HOLD")])
def test_offboard_loss_holds_first_then_does_what_is_configured(act: int, then: str) -> None:
    flight = offboard(COM_OBL_RC_ACT=act)
    flight.streaming = None
    assert 0.9 <= flight.until(lambda: flight.pilot.shown == "HOLD") <= 1.1
    flight.run(4.9)
    assert flight.pilot.shown == "HOLD"
    assert flight.speed < 0.1
    assert flight.pilot.failsafe
    flight.run(0.2)
    assert flight.pilot.shown == then


def test_the_stream_that_comes_back_flies_on_unless_another_mode_was_asked_for() -> None:
    flight = offboard(COM_OBL_RC_ACT=4)
    stream, flight.streaming = flight.streaming, None
    flight.run(8.0)
    assert flight.pilot.shown == "LAND"
    flight.streaming = stream
    flight.run(0.1)
    assert flight.pilot.shown == "OFFBOARD", "a failsafe clears with its cause"
    flight.streaming = None
    flight.run(2.0)
    assert flight.order(SET_MODE, *HOLD) == ACCEPTED
    flight.streaming = stream
    flight.run(2.0)
    assert flight.pilot.shown == "HOLD"


@pytest.mark.parametrize(("act", "falls"), [(6, True), (7, True)])
def test_offboard_loss_may_terminate_at_once(act: int, falls: bool) -> None:
    flight = offboard(COM_OBL_RC_ACT=act)
    flight.streaming = None
    flight.run(1.1)
    flight.until(lambda: flight.copter.landed, 3.0)
    assert flight.copter.tumbled is falls


@pytest.mark.parametrize(
    ("action", "since_s", "position_ok", "global_ok", "effect"),
    [
        ("LAND", 1.0, True, True, "HOLD"),
        ("LAND", 6.0, True, True, "LAND"),
        ("RTL", 6.0, True, False, "LAND"),
        ("RTL", 6.0, True, True, "RTL"),
        ("HOLD", 6.0, True, True, "HOLD"),
        ("RTL", 0.0, False, True, "DESCEND"),
        ("TERMINATE", 0.0, True, True, "TERMINATE"),
        ("", 0.0, True, True, ""),
    ],
)
def test_what_a_failsafe_does(action: str, since_s: float, position_ok: bool, global_ok: bool, effect: str) -> None:
    found = action_in_effect(action, since_s=since_s, delay_s=5.0, position_ok=position_ok, global_ok=global_ok)
    assert found == effect


def test_without_position_it_descends_blindly_and_calls_it_land() -> None:
    flight = hovering()
    flight.position_ok = False
    flight.run(0.1)
    assert flight.pilot.shown == "DESCEND"
    assert flight.pilot.custom_mode == PX4_MODES["LAND"].number
    assert flight.wish.blind
    flight.until(lambda: not flight.pilot.armed)


def test_disarming_in_the_air_needs_force() -> None:
    flight = hovering()
    assert flight.order(ARM_DISARM, 0) == REJECTED
    assert flight.order(ARM_DISARM, 0, 1.0) == REJECTED
    flight.run(0.1)
    assert flight.pilot.armed
    assert flight.order(ARM_DISARM, 0, FORCE_MAGIC) == ACCEPTED
    flight.until(lambda: flight.copter.tumbled, 3.0)
    flight.run(2.0)
    assert flight.order(ARM_DISARM, 1) == REJECTED, "it lies on its back"


def test_termination_stops_the_motors_and_stays() -> None:
    flight = hovering()
    assert flight.order(TERMINATE, 1.0) == ACCEPTED
    flight.until(lambda: flight.copter.landed, 3.0)
    assert flight.pilot.system_status == TERMINATED
    flight.copter.tumbled = False
    flight.until(lambda: not flight.pilot.armed, 5.0)
    assert flight.order(ARM_DISARM, 1) == REJECTED
    flight.step()
    assert any("termination" in text for text in flight.texts)


def test_ground_station_loss_is_no_failsafe_unless_configured() -> None:
    flight = hovering()
    flight.gcs = 255
    flight.run(1.0)
    flight.gcs = None
    flight.run(30.0)
    assert flight.pilot.shown == "HOLD"
    assert not flight.pilot.failsafe
    strict = hovering(NAV_DLL_ACT=3)
    strict.gcs = 255
    strict.run(1.0)
    strict.gcs = None
    strict.run(9.0)
    assert not strict.pilot.failsafe
    strict.until(lambda: strict.pilot.shown == "LAND", 8.0)


def test_reposition_moves_and_keeps_what_is_not_given() -> None:
    flight = hovering()
    assert flight.order(REPOSITION, -1.0, 1.0, 0.0, NAN, 20e-5, 0.0, NAN) == ACCEPTED
    flight.until(lambda: math.dist(flight.ned, (20.0, 0.0, -10.0)) < 0.5)
    flight.order(REPOSITION, 1.0, 1.0, 0.0, NAN, NAN, NAN, 488.0 + 15.0)
    flight.until(lambda: math.dist(flight.ned, (20.0, 0.0, -15.0)) < 0.5)


def test_returns_home_by_way_of_its_altitude() -> None:
    flight = hovering()
    flight.order(REPOSITION, -1.0, 1.0, 0.0, NAN, 40e-5, 0.0, NAN)
    flight.until(lambda: flight.ned[0] > 39.0)
    assert flight.order(RTL) == ACCEPTED
    flight.until(lambda: flight.ned[2] < -38.0)
    assert flight.ned[0] > 35.0
    flight.until(lambda: not flight.pilot.armed, 120.0)
    assert math.hypot(*flight.ned[:2]) < 1.0


def test_speeds_stay_within_the_parameters() -> None:
    flight = offboard(MPC_XY_VEL_MAX=4.0)
    flight.streaming = lambda: velocity(9.0, 0.0, -9.0)
    flight.run(4.0)
    vn, _, vd = flight.sense.velocity
    assert 3.8 < vn < 4.2
    assert 2.8 < -vd < 3.2


def test_a_rover_drives_offboard_and_neither_flies_nor_lands() -> None:
    rover = Flight("px4", "rover")
    assert rover.order(TAKEOFF) == UNSUPPORTED
    assert rover.order(LAND) == UNSUPPORTED
    rover.streaming = lambda: position(10.0, 5.0, 0.0)
    rover.run(0.2)
    assert rover.order(SET_MODE, *OFFBOARD) == ACCEPTED
    assert rover.order(ARM_DISARM, 1) == ACCEPTED
    rover.until(lambda: math.dist(rover.ned, (10.0, 5.0, 0.0)) < 0.6)
    rover.run(2.0)
    assert rover.speed == 0.0
    rover.streaming = None
    rover.run(7.0)
    assert rover.pilot.armed
    assert rover.order(ARM_DISARM, 0) == ACCEPTED


def test_unknown_orders_are_unsupported() -> None:
    flight = Flight("px4")
    assert flight.order(31337) == UNSUPPORTED
    assert flight.order(ARM_DISARM, 7) == UNSUPPORTED
    assert flight.order(179, 0.0) == DENIED
    assert flight.order(SET_MODE, *MANUAL_MODE) == ACCEPTED
    assert flight.order(SET_MODE, 1, 9) == REJECTED
