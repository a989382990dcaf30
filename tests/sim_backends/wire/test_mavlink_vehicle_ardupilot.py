"""ArduPilot's rules and time-outs, on a virtual clock."""

from __future__ import annotations

import math

import pytest

from sim_backends.wire.mavlink_autopilot import (
    ACCEPTED,
    ARM_DISARM,
    DENIED,
    FAILED,
    FORCE_MAGIC,
    INT_ONLY,
    LAND,
    REPOSITION,
    SET_MODE,
    TAKEOFF,
    TERMINATE,
    UNSUPPORTED,
)  # fmt: skip
from sim_backends.wire.mavlink_modes import COPTER_MODES, ROVER_MODES
from sim_backends.wire.mavlink_setpoints import Target
from tests.sim_backends.wire.mavlink_flight import Flight, position, velocity

GUIDED = (1.0, 4.0)


def hovering(height_m: float = 10.0, **params: float) -> Flight:
    flight = Flight("ardupilot", **params)
    assert flight.order(SET_MODE, *GUIDED) == ACCEPTED
    assert flight.order(ARM_DISARM, 1) == ACCEPTED
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == ACCEPTED
    flight.until(lambda: abs(flight.ned[2] + height_m) < 0.2 and flight.speed < 0.1)
    return flight


@pytest.mark.parametrize(
    ("table", "mode", "number"),
    [
        (COPTER_MODES, "GUIDED", 4),
        (COPTER_MODES, "LAND", 9),
        (COPTER_MODES, "BRAKE", 17),
        (ROVER_MODES, "GUIDED", 15),
        (ROVER_MODES, "HOLD", 4),
    ],
)
def test_mode_numbers(table: dict[str, object], mode: str, number: int) -> None:
    assert getattr(table[mode], "number") == number  # noqa: B009


def test_takes_off_lands_and_disarms_at_once() -> None:
    flight = hovering()
    assert flight.order(LAND) == ACCEPTED
    flight.until(lambda: flight.pilot.landed)
    flight.run(0.1)
    assert not flight.pilot.armed


def test_take_off_wants_guided_armed_and_the_ground() -> None:
    flight = Flight("ardupilot")
    flight.order(SET_MODE, *GUIDED)
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == FAILED
    flight.order(ARM_DISARM, 1)
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0, frame=0, is_int=True) == DENIED
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == ACCEPTED
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, 5.0) == ACCEPTED, "again while it climbs"
    flight.until(lambda: flight.ned[2] < -4.8)
    flight.run(3.0)
    assert flight.order(TAKEOFF, 0, 0, 0, 0, 0, 0, 9.0) == FAILED


def test_set_points_on_the_ground_do_not_lift_it() -> None:
    flight = Flight("ardupilot")
    flight.order(SET_MODE, *GUIDED)
    flight.order(ARM_DISARM, 1)
    flight.streaming = lambda: velocity(0.0, 0.0, -2.0)
    flight.run(5.0)
    assert flight.copter.landed


def test_velocity_targets_time_out_position_targets_persist() -> None:
    flight = hovering()
    flight.pilot.set_point(velocity(2.0, 0.0, 0.0), flight.sense)
    flight.run(2.9)
    assert flight.speed > 1.9
    flight.run(2.5)
    assert flight.speed < 0.1
    stopped = flight.ned
    flight.run(10.0)
    assert math.dist(flight.ned, stopped) < 0.5
    flight.pilot.set_point(position(40.0, 0.0, -10.0), flight.sense)
    flight.until(lambda: math.dist(flight.ned, (40.0, 0.0, -10.0)) < 0.3)
    flight.run(10.0)
    assert math.dist(flight.ned, (40.0, 0.0, -10.0)) < 0.3


@pytest.mark.parametrize(
    "target",
    [
        Target(False, 12, 0b110111111000, (50.0, 0.0, -10.0), (0.0, 0.0, 0.0)),
        Target(False, 1, 0b111111111111, (50.0, 0.0, -10.0), (0.0, 0.0, 0.0)),
        Target(False, 1, 0b110111000111, (0.0, 0.0, 0.0), (math.nan, 0.0, 0.0)),
        Target(False, 1, 0b110111000111, (0.0, 0.0, 0.0), (1001.0, 0.0, 0.0)),
    ],
    ids=["frame", "nothing given", "not a number", "insane"],
)
def test_an_invalid_target_stops_it(target: Target) -> None:
    flight = hovering()
    flight.streaming = lambda: velocity(3.0, 0.0, 0.0)
    flight.run(2.0)
    flight.streaming = lambda: target
    flight.run(4.0)
    assert flight.speed < 0.1


def test_targets_outside_guided_are_ignored() -> None:
    flight = hovering()
    flight.order(SET_MODE, 1, 5)
    flight.streaming = lambda: velocity(3.0, 0.0, 0.0)
    flight.run(3.0)
    assert flight.speed < 0.1


@pytest.mark.parametrize(("enable", "mode"), [(1, "RTL"), (5, "LAND"), (7, "BRAKE")])
def test_ground_station_failsafe(enable: int, mode: str) -> None:
    flight = hovering(FS_GCS_ENABLE=enable)
    flight.run(10.0)
    assert flight.pilot.mode == "GUIDED", "a ground station that never spoke cannot be lost"
    flight.gcs = 255
    flight.run(1.0)
    flight.gcs = 254
    flight.run(4.9)
    assert flight.pilot.mode == "GUIDED"
    flight.run(0.2)
    assert flight.pilot.mode == mode
    assert flight.pilot.failsafe
    flight.gcs = 255
    flight.run(0.1)
    assert not flight.pilot.failsafe
    assert flight.pilot.mode == mode, "it does not go back by itself"


def test_ground_station_failsafe_is_off_by_default() -> None:
    flight = hovering()
    flight.gcs = 255
    flight.run(1.0)
    flight.gcs = None
    flight.run(20.0)
    assert flight.pilot.mode == "GUIDED"


def test_without_position_no_guided_and_no_arming_in_it() -> None:
    flight = Flight("ardupilot")
    flight.global_ok = False
    assert flight.order(SET_MODE, *GUIDED) == FAILED
    flight.step()
    assert any("requires position" in text for text in flight.texts)
    assert flight.order(ARM_DISARM, 1) == ACCEPTED, "STABILIZE needs none"


def test_position_lost_in_the_air_lands() -> None:
    flight = hovering()
    flight.position_ok = False
    flight.run(0.1)
    assert flight.pilot.mode == "LAND"
    flight.until(lambda: not flight.pilot.armed)


def test_disarming_in_the_air_needs_force_and_termination_disarms() -> None:
    flight = hovering()
    assert flight.order(ARM_DISARM, 0) == FAILED
    assert flight.order(ARM_DISARM, 0, FORCE_MAGIC) == ACCEPTED
    flight.until(lambda: flight.copter.tumbled, 3.0)
    other = hovering()
    assert other.order(TERMINATE, 0.0) == FAILED
    assert other.order(TERMINATE, 1.0) == ACCEPTED
    assert not other.pilot.armed


def test_landing_modes_cannot_be_armed_in_but_forced() -> None:
    flight = Flight("ardupilot")
    flight.order(SET_MODE, 1, 9)
    assert flight.order(ARM_DISARM, 1) == FAILED
    flight.step()
    assert "Arm: LAND mode not armable" in flight.texts
    assert flight.order(ARM_DISARM, 1, 2989) == ACCEPTED


def test_disarms_by_itself_on_the_ground() -> None:
    flight = Flight("ardupilot")
    flight.order(SET_MODE, *GUIDED)
    flight.order(ARM_DISARM, 1)
    assert 9.9 <= flight.until(lambda: not flight.pilot.armed) <= 10.1


def test_reposition_is_for_command_int_alone() -> None:
    flight = hovering()
    place = (-1.0, 0.0, 0.0, 0.0, 30e-5, 10e-5, 20.0)
    assert flight.order(REPOSITION, *place) == INT_ONLY
    assert flight.order(REPOSITION, *place, frame=6, is_int=True) == ACCEPTED
    flight.until(lambda: math.dist(flight.ned, (30.0, 10.0, -20.0)) < 0.5)


def test_a_rover_drives_stops_at_the_radius_and_on_silence() -> None:
    rover = Flight("ardupilot", "rover")
    assert rover.order(TAKEOFF) == UNSUPPORTED
    rover.order(SET_MODE, 1, 15)
    rover.order(ARM_DISARM, 1)
    rover.pilot.set_point(position(20.0, 0.0, 0.0), rover.sense)
    rover.until(lambda: rover.ned[0] > 10.0)
    rover.until(lambda: rover.speed == 0.0)
    assert 17.5 < rover.ned[0] < 20.0, "within WP_RADIUS of 2 m is there"
    rover.pilot.set_point(velocity(1.0, 0.0, 0.0), rover.sense)
    rover.run(2.9)
    assert rover.speed > 0.9
    rover.run(2.0)
    assert rover.speed == 0.0
    assert "target not received last 3.0secs, stopping" in rover.texts


def test_a_rover_holds_when_its_ground_station_is_lost() -> None:
    rover = Flight("ardupilot", "rover", FS_GCS_ENABLE=1)
    rover.order(SET_MODE, 1, 15)
    rover.order(ARM_DISARM, 1)
    rover.gcs = 255
    rover.pilot.set_point(position(500.0, 0.0, 0.0), rover.sense)
    rover.run(3.0)
    rover.gcs = None
    rover.run(5.1)
    assert rover.pilot.mode == "HOLD"
    rover.until(lambda: rover.speed == 0.0, 10.0)
