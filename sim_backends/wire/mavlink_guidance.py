"""What an autopilot wants of its vehicle and the velocities that follow. Pure; NED, m, s, rad."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.vehicle import Vec3

NAN = math.nan
NOWHERE: Vec3 = (NAN, NAN, NAN)
POSITION_GAIN = 0.95
"""Velocity per m of position error, 1/s; PX4's MPC_XY_P."""
BRAKE_SHARE = 0.6
"""Of its acceleration, that a vehicle plans its braking with: the rest is for the limited jerk."""


@dataclass(frozen=True, slots=True)
class Sense:
    """What an autopilot believes about its vehicle.

    Attributes:
        now_s: monotonic time.
        ned: position in its local frame.
        velocity: of it.
        yaw: heading, clockwise from north.
        contact: it touches the ground.
        pushing: the last velocity wanted was downward.
        position_ok: the position may be flown by.
        global_ok: and is known on the globe.
        battery: share that is left.
        tumbled: it lies on its back.
    """

    now_s: float
    ned: Vec3 = (0.0, 0.0, 0.0)
    velocity: Vec3 = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    contact: bool = True
    pushing: bool = False
    position_ok: bool = True
    global_ok: bool = True
    battery: float = 1.0
    tumbled: bool = False


@dataclass(frozen=True, slots=True)
class Wish:
    """Where to go; an axis without position follows its velocity, one with both takes the velocity on top.

    Attributes:
        motors: they turn at all.
        lift: a copter may leave the ground for it.
        position, velocity: NaN where not given.
        yaw, yaw_rate: NaN where not given.
        level_mps, up_mps, down_mps: limits of speed.
        blind: there is no position to hold: stay level and sink.
    """

    motors: bool = True
    lift: bool = False
    position: Vec3 = NOWHERE
    velocity: Vec3 = NOWHERE
    yaw: float = NAN
    yaw_rate: float = NAN
    level_mps: float = math.inf
    up_mps: float = math.inf
    down_mps: float = math.inf
    blind: bool = False


OFF = Wish(motors=False)
IDLE = Wish()


@dataclass(frozen=True, slots=True)
class Limits:
    """What the body can do: speeds in m/s, acceleration in m/s^2."""

    level_mps: float
    up_mps: float
    down_mps: float
    accel_mps2: float


def approach_mps(distance_m: float, accel_mps2: float) -> float:
    """Speed towards a point ``distance_m`` away so that it can still stop there."""
    return min(POSITION_GAIN * distance_m, math.sqrt(2.0 * BRAKE_SHARE * accel_mps2 * distance_m))


def stopping_point(ned: Vec3, velocity: Vec3, accel_mps2: float) -> Vec3:
    """Where it comes to rest when it brakes now."""
    n, e, d = ned
    vn, ve, vd = velocity
    share = 0.5 / (BRAKE_SHARE * accel_mps2)
    speed = math.hypot(vn, ve)
    return (n + vn * speed * share, e + ve * speed * share, d + vd * abs(vd) * share)


def _or(value: float, other: float) -> float:
    return value if math.isfinite(value) else other


def velocity_for(wish: Wish, sense: Sense, limits: Limits) -> Vec3:
    """The velocity that serves ``wish`` from where the vehicle believes to be."""
    n, e, d = sense.ned
    pn, pe, pd = wish.position
    vn, ve, vd = (_or(v, 0.0) for v in wish.velocity)
    # parameters may be anything, even negative
    level = max(0.0, min(wish.level_mps, limits.level_mps))
    if math.isfinite(pn) and math.isfinite(pe):
        dn, de = pn - n, pe - e
        distance = math.hypot(dn, de)
        if distance > 0.0:
            speed = min(level, approach_mps(distance, limits.accel_mps2))
            vn, ve = vn + dn / distance * speed, ve + de / distance * speed
    speed = math.hypot(vn, ve)
    if speed > level:
        vn, ve = vn * level / speed, ve * level / speed
    if math.isfinite(pd):
        dd = pd - d
        vd += math.copysign(approach_mps(abs(dd), limits.accel_mps2), dd)
    up = max(0.0, min(wish.up_mps, limits.up_mps))
    down = max(0.0, min(wish.down_mps, limits.down_mps))
    return (vn, ve, min(max(vd, -up), down))
