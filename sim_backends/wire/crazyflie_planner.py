"""The planner of the high-level commander: from commands to a trajectory, and the set-point on it at any time.

It is the firmware's: polynomials of 7th order with no jerk at either end, of exactly the duration that was asked for,
however fast that is. Source: ``planner.c`` and ``pptraj.c`` of the firmware.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

from drivers.vehicle import Vec3


@dataclass(frozen=True, slots=True)
class Goal:
    """Where it should be: position m, velocity m/s, acceleration m/s^2, heading rad, its rate rad/s."""

    position_m: Vec3 = (0.0, 0.0, 0.0)
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)
    accel_mps2: Vec3 = (0.0, 0.0, 0.0)
    yaw_rad: float = 0.0
    yaw_rate: float = 0.0


class Phase(Enum):
    """What the planner does."""

    IDLE = "idle"
    FLYING = "flying"
    LANDING = "landing"


def wrap(angle_rad: float) -> float:
    """An angle in -pi..pi."""
    return math.remainder(angle_rad, math.tau)


class Axis:
    """One coordinate: a polynomial of 7th order from a moving start to rest, without jerk at the ends."""

    __slots__ = ("_c", "_t")

    def __init__(self, start: float, speed: float, accel: float, end: float, duration_s: float) -> None:
        t = duration_s
        v, a = speed * t, accel * t * t
        d0, d1, d2 = end - start - v - 0.5 * a, -v - a, -a
        self._t = t
        self._c = (
            start,
            v,
            0.5 * a,
            0.0,
            35.0 * d0 - 15.0 * d1 + 2.5 * d2,
            -84.0 * d0 + 39.0 * d1 - 7.0 * d2,
            70.0 * d0 - 34.0 * d1 + 6.5 * d2,
            -20.0 * d0 + 10.0 * d1 - 2.0 * d2,
        )

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Value, speed and acceleration; after the end it rests."""
        s = min(1.0, max(0.0, time_s / self._t))
        value = speed = accel = 0.0
        for c in reversed(self._c):
            accel = accel * s + 2.0 * speed
            speed = speed * s + value
            value = value * s + c
        if s >= 1.0:
            return value, 0.0, 0.0
        return value, speed / self._t, accel / self._t**2


@dataclass(frozen=True, slots=True)
class Trajectory:
    """What is flown from ``begin_s`` for ``duration_s``."""

    begin_s: float
    duration_s: float
    evaluate: Callable[[float], Goal]

    def at(self, now_s: float) -> Goal:
        """The goal at a time."""
        return self.evaluate(min(now_s - self.begin_s, self.duration_s))

    def over(self, now_s: float) -> bool:
        """Whether its time has passed."""
        return now_s - self.begin_s >= self.duration_s


def smooth(start: Goal, end_m: Vec3, end_yaw: float, duration_s: float, now_s: float) -> Trajectory:
    """From a moving start to rest, turning the shorter way."""
    duration_s = max(duration_s, 1e-3)
    yaw = start.yaw_rad + wrap(end_yaw - start.yaw_rad)
    x, y, z = (
        Axis(start.position_m[i], start.velocity_mps[i], start.accel_mps2[i], end_m[i], duration_s) for i in range(3)
    )
    turn = Axis(start.yaw_rad, start.yaw_rate, 0.0, yaw, duration_s)

    def evaluate(t: float) -> Goal:
        (px, vx, ax), (py, vy, ay), (pz, vz, az), (heading, rate, _) = x.at(t), y.at(t), z.at(t), turn.at(t)
        return Goal((px, py, pz), (vx, vy, vz), (ax, ay, az), heading, rate)

    return Trajectory(now_s, duration_s, evaluate)


def linear(start: Goal, end_m: Vec3, end_yaw: float, duration_s: float, now_s: float) -> Trajectory:
    """At one speed all the way, as ``go_to(linear=True)``."""
    duration_s = max(duration_s, 1e-3)
    turn = wrap(end_yaw - start.yaw_rad)
    a, step = start.position_m, tuple(e - s for e, s in zip(end_m, start.position_m, strict=True))

    def evaluate(t: float) -> Goal:
        s = max(0.0, t / duration_s)
        rate = 0.0 if s >= 1.0 else 1.0 / duration_s
        at = (a[0] + s * step[0], a[1] + s * step[1], a[2] + s * step[2])
        speed = (rate * step[0], rate * step[1], rate * step[2])
        return Goal(at, speed, yaw_rad=start.yaw_rad + s * turn, yaw_rate=rate * turn)

    return Trajectory(now_s, duration_s, evaluate)


def spiral(
    start: Goal, angle: float, radii_m: tuple[float, float], ascent_m: float, sideways: bool, clockwise: bool,
    duration_s: float, now_s: float,
) -> Trajectory:  # fmt: skip
    """An arc whose radius and height change evenly, around a point to the side (sideways: in front)."""
    duration_s = max(duration_s, 1e-3)
    turn = -abs(angle) if clockwise else abs(angle)
    if angle < 0:
        turn = -turn
    side = start.yaw_rad if sideways else start.yaw_rad + math.copysign(0.5 * math.pi, -1.0 if clockwise else 1.0)
    cx = start.position_m[0] + radii_m[0] * math.cos(side)
    cy = start.position_m[1] + radii_m[0] * math.sin(side)

    def place(s: float) -> Vec3:
        r, bearing = radii_m[0] + s * (radii_m[1] - radii_m[0]), side + math.pi + s * turn
        return (cx + r * math.cos(bearing), cy + r * math.sin(bearing), start.position_m[2] + s * ascent_m)

    def evaluate(t: float) -> Goal:
        s = max(0.0, t / duration_s)
        at, ahead = place(s), place(s + 1e-4)
        rate = 0.0 if s >= 1.0 else 1e4 / duration_s
        speed = (rate * (ahead[0] - at[0]), rate * (ahead[1] - at[1]), rate * (ahead[2] - at[2]))
        return Goal(at, speed, yaw_rad=start.yaw_rad + s * turn, yaw_rate=1e-4 * rate * turn)

    return Trajectory(now_s, duration_s, evaluate)


class Planner:
    """The state machine: idle (motors off), flying, or landing (idle at its end)."""

    def __init__(self) -> None:
        self.phase = Phase.IDLE
        self._trajectory: Trajectory | None = None

    def stop(self) -> None:
        """Motors off."""
        self.phase = Phase.IDLE

    def finished(self, now_s: float) -> bool:
        """Whether the last trajectory has ended."""
        return self._trajectory is None or self._trajectory.over(now_s)

    def goal(self, now_s: float) -> Goal | None:
        """The set-point now; None while idle."""
        if self.phase is Phase.IDLE or self._trajectory is None:
            return None
        goal = self._trajectory.at(now_s)
        if self.phase is Phase.LANDING and self._trajectory.over(now_s):
            self.phase = Phase.IDLE
        return goal

    def start(self, trajectory: Trajectory, phase: Phase = Phase.FLYING) -> None:
        """Flies ``trajectory`` from now on."""
        self._trajectory, self.phase = trajectory, phase
