"""What PX4 and ArduPilot do differently, as one table per autopilot and kind of vehicle."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from drivers import mavlink_words as w
from drivers.vehicle import SelfCheck

Parameters = dict[str, float]


@dataclass(frozen=True)
class Dialect:
    """One autopilot on one kind of vehicle.

    Attributes:
        name: for people.
        guided: ``custom_mode`` in which it follows this driver.
        guided_parameters: parameters 2 and 3 of DO_SET_MODE for it.
        landing_parameters: the same for its own landing mode.
        streams_on_ground: wants set-points before it enters its guided mode, and all the time.
        lifts_by_command: leaves the ground only by NAV_TAKEOFF.
        turns_on_spot_by_rate: a velocity of zero has a direction for it, so a rover stands by a turn rate of zero.
        terminates: understands DO_FLIGHTTERMINATION.
        bytewise: encoding of integer parameters.
        wants_origin: has no local frame without GPS until somebody names an origin.
        estimator: name and id of the message that tells how its estimator is.
        parameters: read at connecting, for the checks.
        returns: ``custom_mode`` values in which a copter lands or returns by itself.
        mode_name: a ``custom_mode`` in words.
        by_pilot: whether a ``custom_mode`` is one in which a pilot steers.
        death_checks: what happens when this program dies, by the parameters.
    """

    name: str
    guided: int
    guided_parameters: tuple[float, float]
    landing_parameters: tuple[float, float] | None
    streams_on_ground: bool
    lifts_by_command: bool
    turns_on_spot_by_rate: bool
    terminates: bool
    bytewise: bool
    wants_origin: bool
    estimator: tuple[str, int]
    parameters: tuple[str, ...]
    returns: frozenset[int]
    mode_name: Callable[[int], str]
    by_pilot: Callable[[int], bool]
    death_checks: Callable[[Parameters, int], list[SelfCheck]]


def kind_of(mav_type: int) -> str | None:
    """``uav`` or ``ugv`` of a MAV_TYPE; None for what these drivers cannot command."""
    return "uav" if mav_type in w.COPTERS else "ugv" if mav_type in w.ROVERS else None


def described(autopilot: int, mav_type: int) -> str:
    """A heartbeat's vehicle in words."""
    pilot = {w.PX4: "PX4", w.ARDUPILOT: "ArduPilot", w.NO_AUTOPILOT: "no autopilot"}.get(autopilot, f"{autopilot}")
    kind = w.COPTERS.get(mav_type) or w.ROVERS.get(mav_type) or f"vehicle of MAV_TYPE {mav_type}"
    return f"{pilot} {kind}"
