"""What a UGV is doing: along its path by a carrot ahead of it, or standing. No I/O, no clock.

Rovers get a velocity vector: both autopilots turn it into speed and heading. Corners are driven to and turned at.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.limits import UgvLimits
from drivers.mavlink_frames import wrap
from drivers.mavlink_motion import approach_mps
from drivers.vehicle import Vec2

CORNER_RAD = math.radians(15.0)
"""A sharper bend is driven to, not cut."""
ARRIVED_M = 0.05
"""Left of the way when a point counts as reached; a rover stops within a few centimetres of it."""
CREEP_MPS = 0.08
"""Slowest speed on the way: autopilots take less for standing."""
LOOK_S = 0.8
"""The carrot is so far ahead; more cuts bends, less wobbles."""
LOOK_M = 0.25
CROSS_GAIN = 1.5
"""Per s: how fast a rover comes back to its line."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Wanted velocity of a UGV in the arena, m/s; None: stand."""

    velocity_mps: Vec2 | None = None


STAND = Motion()


class Driving:
    """The way of one UGV."""

    def __init__(self, limits: UgvLimits) -> None:
        self._limits = limits
        self._asked: tuple[Vec2, ...] = ()
        self._points: list[Vec2] = []
        self._leg = 0
        self._speed_mps = 0.0
        self._now_mps = 0.0
        self._going = False

    @property
    def going(self) -> bool:
        """On its way."""
        return self._going

    def drive(self, path_m: tuple[Vec2, ...], speed_mps: float, at_m: Vec2) -> None:
        """Takes a new way; the same again resumes it after a hold, and at its end changes nothing."""
        self._speed_mps = speed_mps
        if path_m != self._asked:
            self._asked = path_m
            points = [at_m]
            for point in path_m:
                if math.dist(point, points[-1]) > 1e-6:
                    points.append(point)
            # who stands on the first point has no way to it
            if len(points) > 2 and math.dist(points[0], points[1]) < 4 * ARRIVED_M:
                del points[1]
            self._points, self._leg, self._now_mps = points, 0, 0.0
        self._going = self._leg < len(self._points) - 1

    def hold(self) -> None:
        """Brakes; the way is not forgotten."""
        self._going, self._now_mps = False, 0.0

    def reset(self) -> None:
        """Forgets its way."""
        self.hold()
        self._asked, self._points, self._leg = (), [], 0

    def step(self, at_m: Vec2 | None, yaw_rad: float, dt_s: float) -> Motion:
        """The velocity wanted now.

        Args:
            at_m: where it is; None: stale, then it stands until it is fresh again.
            yaw_rad: its heading.
            dt_s: step.
        """
        if not self._going or at_m is None:
            self._now_mps = 0.0
            return STAND
        while True:
            a, b = self._points[self._leg], self._points[self._leg + 1]
            length = math.dist(a, b)
            ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
            done = (at_m[0] - a[0]) * ux + (at_m[1] - a[1]) * uy
            if length - done > ARRIVED_M:
                break
            self._leg += 1
            if self._leg >= len(self._points) - 1:
                self.hold()
                return STAND
        aside = -(at_m[0] - a[0]) * uy + (at_m[1] - a[1]) * ux
        look = LOOK_M + LOOK_S * self._now_mps
        heading = math.atan2(uy, ux) - math.atan2(min(CROSS_GAIN * abs(aside), 2 * look), look) * math.copysign(
            1, aside
        )
        speed = min(self._speed_mps, self._limits.max_speed_mps)
        speed = min(speed, approach_mps(self._straight_m(length - done), self._limits.accel_mps2, dt_s))
        speed = min(speed, self._now_mps + self._limits.accel_mps2 * dt_s)
        # who looks elsewhere turns first
        turn = math.cos(wrap(heading - yaw_rad))
        speed = max(CREEP_MPS, speed * max(0.0, turn))
        self._now_mps = speed
        return Motion((speed * math.cos(heading), speed * math.sin(heading)))

    def _straight_m(self, left_m: float) -> float:
        """Distance to the next corner or the end."""
        for k in range(self._leg + 1, len(self._points) - 1):
            p, q, r = self._points[k - 1], self._points[k], self._points[k + 1]
            bend = wrap(math.atan2(r[1] - q[1], r[0] - q[0]) - math.atan2(q[1] - p[1], q[0] - p[0]))
            if abs(bend) > CORNER_RAD:
                break
            left_m += math.dist(q, r)
        return left_m
