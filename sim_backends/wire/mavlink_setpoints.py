"""How the two autopilots read SET_POSITION_TARGET_LOCAL_NED and SET_POSITION_TARGET_GLOBAL_INT. Pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from drivers.vehicle import Vec2, Vec3
from sim_backends.wire.mavlink_guidance import NAN, NOWHERE, Sense

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
GLOBAL, GLOBAL_RELATIVE, GLOBAL_INT, GLOBAL_RELATIVE_INT = 0, 3, 5, 6
"""MAV_FRAME of common.xml."""
FORCE, IGNORE_YAW, IGNORE_YAW_RATE = 1 << 9, 1 << 10, 1 << 11
POSITION_BITS, VELOCITY_BITS, ACCELERATION_BITS = 0b111, 0b111 << 3, 0b111 << 6
"""POSITION_TARGET_TYPEMASK."""
SANE_MPS = 1000.0
"""ArduPilot takes a velocity beyond this for a mistake (``sane_vel_or_acc_vector``)."""


@dataclass(frozen=True, slots=True)
class Globe:
    """Latitude, longitude and altitude in a vehicle's local frame.

    Attributes:
        to_ned: (lat, lon) in degrees to (north, east) in m; None while there is no origin on the globe.
        altitude_m: of the local origin above mean sea level.
        home_m: of home above mean sea level.
    """

    to_ned: Callable[[float, float], Vec2] | None
    altitude_m: float = 0.0
    home_m: float = 0.0

    def place(self, frame: int, lat: float, lon: float, alt: float) -> Vec3 | None:
        """A position of the globe, its altitude as ``frame`` says; None where it cannot be placed."""
        if self.to_ned is None or not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
            return None
        base = self.home_m if frame in (GLOBAL_RELATIVE, GLOBAL_RELATIVE_INT) else 0.0
        n, e = self.to_ned(lat, lon)
        return (n, e, self.altitude_m - (alt + base))


@dataclass(frozen=True, slots=True)
class Target:
    """A set-point as it came: position in m, or in degrees and m of altitude where ``globe`` is set."""

    globe: bool
    frame: int
    mask: int
    position: Vec3
    velocity: Vec3
    acceleration: Vec3 = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    yaw_rate: float = 0.0


@dataclass(frozen=True, slots=True)
class SetPoint:
    """What the autopilot follows; NaN where nothing is given.

    Attributes:
        position, velocity: NED.
        yaw, yaw_rate: clockwise.
        at_s: receipt.
    """

    position: Vec3 = NOWHERE
    velocity: Vec3 = NOWHERE
    yaw: float = NAN
    yaw_rate: float = NAN
    at_s: float = -math.inf

    @property
    def has_position(self) -> bool:
        """Whether a level position is given."""
        return math.isfinite(self.position[0]) and math.isfinite(self.position[1])


def turned(vector: Vec3, yaw: float) -> Vec3:
    """A body vector (forward, right, down) in NED."""
    c, s = math.cos(yaw), math.sin(yaw)
    return (c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2])


def _masked(vector: Vec3, mask: int, shift: int) -> Vec3:
    x, y, z = (NAN if mask >> (shift + i) & 1 else v for i, v in enumerate(vector))
    return (x, y, z)


def read_px4(target: Target, sense: Sense, globe: Globe) -> SetPoint | str:
    """PX4's reading: each axis by itself; or why it takes nothing (``mavlink_receiver.cpp``)."""
    position, velocity = _masked(target.position, target.mask, 0), _masked(target.velocity, target.mask, 3)
    if target.mask & FORCE:
        return "SET_POSITION_TARGET force not supported"
    if target.globe:
        if target.frame not in (GLOBAL, GLOBAL_RELATIVE, GLOBAL_INT, GLOBAL_RELATIVE_INT):
            return f"SET_POSITION_TARGET_GLOBAL_INT coordinate frame {target.frame} unsupported"
        if any(map(math.isfinite, position)):
            placed = globe.place(target.frame, *target.position)
            if placed is None:
                return "SET_POSITION_TARGET_GLOBAL_INT needs a global position"
            position = _masked(placed, target.mask, 0)
    elif target.frame == BODY_NED:
        position, velocity = NOWHERE, turned(velocity, sense.yaw)
    elif target.frame != LOCAL_NED:
        return f"SET_POSITION_TARGET_LOCAL_NED coordinate frame {target.frame} unsupported"
    given = (*position, *velocity, *_masked(target.acceleration, target.mask, 6))
    if not any(map(math.isfinite, given)):
        return ""
    yaw = NAN if target.mask & IGNORE_YAW else target.yaw
    rate = NAN if target.mask & IGNORE_YAW_RATE else target.yaw_rate
    return SetPoint(position, velocity, yaw, rate, sense.now_s)


def read_ardupilot(target: Target, sense: Sense, globe: Globe) -> SetPoint | None:
    """ArduPilot's reading: all three axes of a vector or none; None: invalid, and the vehicle stops.

    ``GCS_MAVLINK_Copter::handle_message_set_position_target_local_ned`` and its neighbour.
    """
    no_position, no_velocity = target.mask & POSITION_BITS, target.mask & VELOCITY_BITS
    no_acceleration = target.mask & ACCELERATION_BITS
    if (target.mask & FORCE and not no_acceleration) or (no_position and no_velocity):
        return None
    position, velocity, yaw = NOWHERE, NOWHERE, target.yaw
    body = target.frame in (BODY_NED, BODY_OFFSET_NED)
    if target.globe:
        if not no_position:
            placed = globe.place(target.frame, *target.position)
            if placed is None:
                return None
            position = placed
        body = False
    else:
        if target.frame not in (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED):
            return None
        if not no_position:
            position = turned(target.position, sense.yaw) if body else target.position
            if target.frame != LOCAL_NED:
                x, y, z = (a + b for a, b in zip(position, sense.ned, strict=True))
                position = (x, y, z)
    if not no_velocity:
        if not all(math.isfinite(v) and abs(v) <= SANE_MPS for v in target.velocity):
            return None
        velocity = turned(target.velocity, sense.yaw) if body else target.velocity
    if target.mask & IGNORE_YAW:
        yaw = NAN
    elif body:
        yaw += sense.yaw
    rate = NAN if target.mask & IGNORE_YAW_RATE else target.yaw_rate
    return SetPoint(position, velocity, yaw, rate, sense.now_s)
