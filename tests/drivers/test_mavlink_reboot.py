"""What a copter's driver makes of a clock that goes back: a reboot on the ground, nothing in the air. No socket."""

from __future__ import annotations

from typing import Any

import pytest

from drivers import mavlink_px4
from drivers.clock import RealClock
from drivers.limits import PoseBook, UavLimits
from drivers.mavlink import MavlinkUav
from drivers.mavlink_link import mavlink as m
from drivers.vehicle import Arm, StopMotors

LIMITS = UavLimits(max_speed_mps=3.0, accel_mps2=2.0, climb_mps=1.5, descent_mps=1.0, altitude_m=30.0)


class Copter(MavlinkUav):
    """Without a link: messages and commands are handed over as the link's thread does."""

    def __init__(self) -> None:
        super().__init__(
            "u", "udpin:127.0.0.1:1", body="b", sysid=1, limits=LIMITS, pads={}, book=PoseBook(), frame=None,
            clock=RealClock(),
        )  # fmt: skip
        self._adopt(mavlink_px4.COPTER)
        self._dialect = mavlink_px4.COPTER

    def hear(self, *messages: Any) -> None:
        for message in messages:
            self.on_message(message, self._clock.now())

    def stop(self) -> None:
        self._inbox.append(StopMotors("u"))
        self.pump(self._clock.now())

    @property
    def latched(self) -> bool:
        self._inbox.append(Arm("u"))
        self.pump(self._clock.now())
        assert self._flight is not None
        return not self._flight.arming and "stop" in (self.state().fault or "")


def heartbeat(armed: bool) -> Any:
    return m.MAVLink_heartbeat_message(2, 12, 1 | (128 if armed else 0), 0, 3, 3)


def attitudes(*boot_ms: int) -> list[Any]:
    return [m.MAVLink_attitude_message(ms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0) for ms in boot_ms]


@pytest.fixture
def copter() -> Copter:
    return Copter()


def test_a_stop_stays_latched_while_it_is_armed(copter: Copter) -> None:
    copter.hear(heartbeat(armed=True), *attitudes(900_000))
    copter.stop()
    copter.hear(*attitudes(896_000, 896_050, 900_100), heartbeat(armed=True), *attitudes(900_200))
    assert copter.latched
    copter.hear(heartbeat(armed=False), *attitudes(900_300))
    assert copter.latched, "its motors stopped: that is no reboot"


def test_a_reboot_releases_when_a_heartbeat_shows_it_disarmed(copter: Copter) -> None:
    copter.hear(heartbeat(armed=True), *attitudes(900_000))
    copter.stop()
    copter.hear(*attitudes(2_000, 2_050))
    assert copter.latched
    copter.hear(heartbeat(armed=False))
    assert not copter.latched
