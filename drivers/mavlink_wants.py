"""What the flight machine looks at and what it wants of the autopilot."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.mavlink_dock import PadSeen
from drivers.mavlink_motion import Reference
from drivers.vehicle import Vec3


@dataclass(frozen=True, slots=True)
class Seen:
    """Everything that a step may look at.

    Attributes:
        now_s, dt_s: time and what has passed since the last step.
        own_m: its own estimate, in which set-points are meant; None: stale.
        pose_m: where it trustworthily is; None: stale.
        yaw_rad: in the arena.
        armed, on_ground, airborne: by its own judgement.
        guided: it follows set-points.
        link: it was heard lately.
        by_pilot: a pilot steers.
        failsafe: it is in a landing or returning mode, or in another than ours with a status of CRITICAL or EMERGENCY.
        lapsed: set-points or telemetry paused a moment ago, so that a failsafe may be the answer to that.
        pad: of the attempt's dock; None: stale or no attempt.
        charging: None: cannot be told.
        battery: 0..1 or None.
    """

    now_s: float
    dt_s: float
    own_m: Vec3 | None
    pose_m: Vec3 | None
    yaw_rad: float
    armed: bool
    on_ground: bool
    airborne: bool
    guided: bool
    link: bool = True
    by_pilot: bool = False
    failsafe: bool = False
    lapsed: bool = False
    pad: PadSeen | None = None
    charging: bool | None = None
    battery: float | None = None

    @property
    def at_m(self) -> Vec3 | None:
        """Its own estimate, or else the trusted pose."""
        return self.own_m if self.own_m is not None else self.pose_m


@dataclass(frozen=True, slots=True)
class Wants:
    """What the autopilot should be told and become.

    Attributes:
        setpoint: to stream; None: nothing.
        yaw_rad: to keep, in the arena.
        guided: be in its guided mode.
        armed: become armed or disarmed; None: as it is.
        takeoff_m: leave the ground by its own command, so high above where it stands.
        land_mode: land by its own means.
    """

    setpoint: Reference | None = None
    yaw_rad: float = 0.0
    guided: bool = False
    armed: bool | None = None
    takeoff_m: float | None = None
    land_mode: bool = False
