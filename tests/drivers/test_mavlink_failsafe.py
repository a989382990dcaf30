"""From heartbeats to what the flight machine sees of an autopilot's failsafe, and whether we caused it. No socket."""

from __future__ import annotations

import pytest

from drivers import mavlink_ardupilot, mavlink_px4
from drivers.clock import RealClock
from drivers.limits import PoseBook, UavLimits
from drivers.mavlink import MavlinkUav
from drivers.mavlink_dialect import Dialect
from drivers.mavlink_link import mavlink as m
from drivers.mavlink_wants import Seen

LIMITS = UavLimits(max_speed_mps=3.0, accel_mps2=2.0, climb_mps=1.5, descent_mps=1.0, altitude_m=30.0)
PX4, ARDUPILOT = mavlink_px4.COPTER, mavlink_ardupilot.COPTER
OFFBOARD, HOLD, LAND = mavlink_px4.custom_mode(6), mavlink_px4.custom_mode(4, 3), mavlink_px4.custom_mode(4, 6)
POSITION, RETURN = mavlink_px4.custom_mode(3), mavlink_px4.custom_mode(4, 5)
ACTIVE, CRITICAL = 4, 5


class Copter(MavlinkUav):
    """Without a link: it hears and steps at the times that it is given."""

    def __init__(self, dialect: Dialect) -> None:
        super().__init__(
            "u", "udpin:127.0.0.1:1", body="b", sysid=1, limits=LIMITS, pads={}, book=PoseBook(), frame=None,
            clock=RealClock(),
        )  # fmt: skip
        self._adopt(dialect)
        self._dialect = dialect

    def hear(self, now_s: float, mode: int, status: int = ACTIVE) -> None:
        self.on_message(m.MAVLink_heartbeat_message(2, 12, 129, mode, status, 3), now_s)
        self.on_message(m.MAVLink_extended_sys_state_message(0, 2), now_s)

    def turn(self, now_s: float) -> None:
        self._step(now_s, 0.05)

    def look(self, now_s: float) -> Seen:
        return self._seen(now_s, 0.0)


@pytest.mark.parametrize(
    ("dialect", "mode", "status", "failsafe"),
    [
        (PX4, OFFBOARD, ACTIVE, False), (PX4, HOLD, ACTIVE, False), (PX4, HOLD, CRITICAL, True),
        (PX4, LAND, ACTIVE, True), (PX4, RETURN, CRITICAL, True), (PX4, OFFBOARD, CRITICAL, False),
        (ARDUPILOT, 4, ACTIVE, False), (ARDUPILOT, 4, CRITICAL, False), (ARDUPILOT, 6, ACTIVE, True),
        (ARDUPILOT, 9, CRITICAL, True), (ARDUPILOT, 17, CRITICAL, True), (ARDUPILOT, 17, ACTIVE, False),
    ],
)  # fmt: skip
def test_a_failsafe_is_a_landing_mode_or_a_grave_status_in_another_than_ours(
    dialect: Dialect, mode: int, status: int, failsafe: bool
) -> None:
    copter = Copter(dialect)
    copter.hear(1.0, mode, status)
    assert copter.look(1.0).failsafe is failsafe


def flown(until_s: float, *, hears: bool = True, steps: bool = True, copter: Copter | None = None) -> Copter:
    """Hears and steps 20 times a second, on from a quiet start of 10 s."""
    made = copter or Copter(PX4)
    for k in range(200 if copter is None else 0):
        made.hear(k * 0.05, OFFBOARD)
        made.turn(k * 0.05)
    for k in range(200, round(until_s / 0.05)):
        if hears:
            made.hear(k * 0.05, OFFBOARD)
        if steps:
            made.turn(k * 0.05)
    return made


def test_who_hears_and_sends_all_the_time_has_not_lapsed() -> None:
    assert not flown(10.0).look(10.0).lapsed


@pytest.mark.parametrize(("hears", "steps"), [(False, True), (True, False), (False, False)])
def test_a_pause_of_telemetry_or_of_set_points_is_remembered_for_a_while(hears: bool, steps: bool) -> None:
    copter = flown(11.2, hears=hears, steps=steps, copter=flown(10.0))
    copter.hear(11.25, LAND, CRITICAL)
    assert copter.look(11.25).lapsed
    for k in range(226, 300):
        copter.hear(k * 0.05, LAND, CRITICAL)
        copter.turn(k * 0.05)
    assert not copter.look(15.0).lapsed


def test_a_mode_of_the_pilot_is_told() -> None:
    copter = Copter(PX4)
    copter.hear(1.0, POSITION, CRITICAL)
    assert copter.look(1.0).by_pilot
