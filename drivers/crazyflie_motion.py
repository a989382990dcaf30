"""What the Crazyflie's high-level commander makes of a command: its own polynomial, computed beside it.

The firmware plans every ``go_to`` from its current set-point to rest at the target by a polynomial of 7th order
with no jerk at both ends (``planner.c`` and ``pptraj.c`` of the firmware). It has no limits of its own, so this side
chooses durations with which speed and acceleration stay within ours, and knows where the set-point is meanwhile.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.limits import UavLimits
from drivers.vehicle import Vec3

PEAK_SPEED = 2.1875
"""Rest to rest over distance d in T seconds peaks at 2.1875 d / T ..."""
PEAK_ACCELERATION = 7.513
"""... and accelerates with up to 7.513 d / T^2: the extremes of the polynomial 35 s^4 - 84 s^5 + 70 s^6 - 20 s^7."""
PEAK_BRAKING = 1.875
"""Braking from speed v within T seconds decelerates with up to 1.875 v / T (the steepest slope of a smootherstep)."""
SHORTEST_S = 0.3
"""No segment is shorter: the firmware's planner runs at 100 Hz and the attitude needs time to follow."""
AT_REST_MPS, AT_REST_MPS2 = 1e-3, 1e-2
"""What is left of speed and acceleration swings out over the whole next motion: 0.1 m/s^2 is half a metre in 10 s."""

_ENDS = np.linalg.inv(np.array([[1, 1, 1, 1], [4, 5, 6, 7], [12, 20, 30, 42], [24, 60, 120, 210]], dtype=float))
_POWERS = np.arange(8)


@dataclass(frozen=True, slots=True)
class SetPoint:
    """Where the set-point is and how it moves; arena frame, m and s."""

    position_m: Vec3
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)
    acceleration_mps2: Vec3 = (0.0, 0.0, 0.0)

    @property
    def speed_mps(self) -> float:
        """Magnitude of the velocity."""
        return math.hypot(*self.velocity_mps)

    @property
    def resting(self) -> bool:
        """Whether it neither moves nor is about to."""
        return self.speed_mps < AT_REST_MPS and math.hypot(*self.acceleration_mps2) < AT_REST_MPS2


@dataclass(frozen=True, slots=True)
class Segment:
    """One planned motion: from ``start`` at ``start_s`` to rest at ``end_m`` after ``duration_s``.

    Attributes:
        linear: at constant speed, without smooth ends (``go_to`` with ``linear``, protocol >= 8).
    """

    start: SetPoint
    end_m: Vec3
    duration_s: float
    start_s: float
    linear: bool = False

    @property
    def end_s(self) -> float:
        """When it is over."""
        return self.start_s + self.duration_s

    def _coefficients(self) -> NDArray[np.float64]:  # (8, 3), over normalised time
        t = self.duration_s
        p = np.array(self.start.position_m)
        v = np.array(self.start.velocity_mps) * t
        a = np.array(self.start.acceleration_mps2) * t * t
        ends = np.array([np.array(self.end_m) - p - v - 0.5 * a, -v - a, -a, np.zeros(3)])
        return np.vstack([p, v, 0.5 * a, np.zeros(3), _ENDS @ ends])

    def at(self, now_s: float) -> SetPoint:
        """The set-point at a time; it rests at the end afterwards."""
        s = (now_s - self.start_s) / self.duration_s
        if s >= 1.0:
            return SetPoint(self.end_m)
        if s <= 0.0:
            return self.start
        if self.linear:
            step = np.array(self.end_m) - np.array(self.start.position_m)
            return SetPoint(_vec(self.start.position_m + s * step), _vec(step / self.duration_s))
        c = self._coefficients()
        powers = s**_POWERS
        first = _POWERS[1:] * powers[:-1]
        second = _POWERS[2:] * _POWERS[1:-1] * powers[:-2]
        return SetPoint(
            _vec(powers @ c),
            _vec(first @ c[1:] / self.duration_s),
            _vec(second @ c[2:] / self.duration_s**2),
        )

    def peaks(self) -> tuple[float, float]:
        """Greatest speed in m/s and acceleration in m/s^2 on the way."""
        s = np.linspace(0.0, 1.0, 41)[:, None] ** _POWERS[None, :]  # (41, 8)
        c = self._coefficients()
        speed = (s[:, :-1] * _POWERS[1:]) @ c[1:] / self.duration_s
        acceleration = (s[:, :-2] * (_POWERS[2:] * _POWERS[1:-1])) @ c[2:] / self.duration_s**2
        return float(np.linalg.norm(speed, axis=1).max()), float(np.linalg.norm(acceleration, axis=1).max())


def _vec(values: NDArray[np.float64]) -> Vec3:
    return (float(values[0]), float(values[1]), float(values[2]))


def rest_to_rest_s(start_m: Vec3, end_m: Vec3, speed_mps: float, limits: UavLimits) -> float:
    """Shortest duration of a ``go_to`` between two points at rest that keeps every limit.

    Args:
        start_m: the one point.
        end_m: the other.
        speed_mps: greatest speed along the way.
        limits: of the vehicle; climbing and descending have their own speeds.
    """
    distance = math.dist(start_m, end_m)
    level = math.hypot(end_m[0] - start_m[0], end_m[1] - start_m[1])
    rise = end_m[2] - start_m[2]
    vertical = limits.climb_mps if rise > 0 else limits.descent_mps
    return max(
        SHORTEST_S,
        PEAK_SPEED * distance / speed_mps,
        PEAK_SPEED * level / limits.max_speed_mps,
        PEAK_SPEED * abs(rise) / vertical,
        math.sqrt(PEAK_ACCELERATION * distance / limits.accel_mps2),
    )


def brake(start: SetPoint, start_s: float, accel_mps2: float) -> Segment:
    """The way to stop from a moving set-point: short, without going back and within ``accel_mps2`` where possible.

    The distance is the one with which the firmware's polynomial for the velocity has the lowest order, so that it
    does not swing: v T / 2 + a T^2 / 10.
    """
    duration_s = max(SHORTEST_S, PEAK_BRAKING * start.speed_mps / accel_mps2)
    most = 1.15 * max(accel_mps2, math.hypot(*start.acceleration_mps2))
    while True:
        t = duration_s
        x, y, z = (
            p + v * t / 2 + a * t * t / 10
            for p, v, a in zip(start.position_m, start.velocity_mps, start.acceleration_mps2, strict=True)
        )
        segment = Segment(start, (x, y, z), t, start_s)
        # a longer brake of an accelerating set-point goes far: three seconds suffice for every limit we accept
        if segment.peaks()[1] <= most or duration_s > 3.0:
            return segment
        duration_s *= 1.2


@dataclass(frozen=True, slots=True)
class Stage:
    """One ``go_to`` of a leg.

    Attributes:
        at_s: when to send it, after the start of the leg.
        end_m: its target.
        duration_s: until it would be there.
        linear: at constant speed.
    """

    at_s: float
    end_m: Vec3
    duration_s: float
    linear: bool = False


def plan_leg(start_m: Vec3, end_m: Vec3, speed_mps: float, limits: UavLimits, cruise: bool) -> tuple[Stage, ...]:
    """A straight flight from rest to rest as one ``go_to``, or as three with a cruise at constant speed.

    One polynomial is on average 2.19 times slower than its peak. On a long leg, therefore, a second, linear one takes
    over where the first reaches its peak (there its acceleration is 0) and a third brakes. Speed and acceleration are
    continuous at both changes, and each lost packet leaves a motion that ends at rest on the way.

    Args:
        start_m: where it begins.
        end_m: where it ends.
        speed_mps: greatest speed along the way.
        limits: of the vehicle.
        cruise: the firmware knows linear ``go_to`` (protocol >= 8).
    """
    whole_s = rest_to_rest_s(start_m, end_m, speed_mps, limits)
    distance = math.dist(start_m, end_m)
    if distance == 0.0:
        return (Stage(0.0, end_m, whole_s),)
    direction = [(b - a) / distance for a, b in zip(start_m, end_m, strict=True)]
    level, rise = math.hypot(direction[0], direction[1]), direction[2]
    vertical = limits.climb_mps if rise > 0 else limits.descent_mps
    v = min(
        speed_mps,
        limits.max_speed_mps / level if level else math.inf,
        vertical / abs(rise) if rise else math.inf,
    )
    # the polynomial with peak v that just keeps the acceleration: 2.1875 d / T = v and 7.513 d / T^2 = a
    first_m = PEAK_ACCELERATION / PEAK_SPEED**2 * v * v / limits.accel_mps2
    first_s = PEAK_SPEED * first_m / v
    brake_s = max(SHORTEST_S, PEAK_BRAKING * v / limits.accel_mps2)
    brake_m = 0.5 * v * brake_s
    cruise_m = distance - 0.5 * first_m - brake_m
    # the linear one aims beyond the braking point: at its very end its speed would already be 0
    beyond_m = min(0.4 * v, 0.6 * brake_m)
    if not cruise or first_s < 2 * SHORTEST_S or cruise_m < 0.3 * v:
        return (Stage(0.0, end_m, whole_s),)

    def along(m: float) -> Vec3:
        return (start_m[0] + m * direction[0], start_m[1] + m * direction[1], start_m[2] + m * direction[2])

    return (
        Stage(0.0, along(first_m), first_s),
        Stage(0.5 * first_s, along(distance - brake_m + beyond_m), (cruise_m + beyond_m) / v, linear=True),
        Stage(0.5 * first_s + cruise_m / v, end_m, brake_s),
    )
