"""A path as pure pursuit wants it: cleaned, cut where the vehicle must stop and turn, rounded elsewhere. Pure.

A *piece* is driven without stopping. Corners between pieces are those that the vehicle cannot, or need not, drive
around: a differential or mecanum drive stops at every sharp one, an Ackermann drive only where changing gear keeps it
nearer to the path than turning around does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from drivers.vehicle import Vec2

GAP_M = 0.005
"""Points nearer to each other are one point; the noise of motion capture is of this size."""
STOP_TURN_RAD = math.radians(40.0)
"""A sharper corner is turned on the spot: rounding it at speed would leave the path by more than its own noise."""
CUSP_TURN_RAD = math.radians(105.0)
"""An Ackermann drive changes gear at a sharper corner: here rounding it and reversing leave the path equally far."""
_ARC_STEP_RAD = math.radians(10.0)


@dataclass(frozen=True, slots=True)
class Piece:
    """A polyline of at least two distinct points with the distance along it.

    Attributes:
        points: m.
        at_m: distance of each point from the first.
        turn_rad: how sharply it turns at each point; 0 at the ends.
    """

    points: tuple[Vec2, ...]
    at_m: tuple[float, ...]
    turn_rad: tuple[float, ...]

    @classmethod
    def of(cls, points: Sequence[Vec2]) -> Piece:
        """Measures a polyline."""
        at = [0.0]
        for a, b in pairwise(points):
            at.append(at[-1] + math.dist(a, b))
        turns = [abs(turn_at(*three)) for three in zip(points, points[1:], points[2:], strict=False)]
        return cls(tuple(points), tuple(at), (0.0, *turns, 0.0))

    @property
    def length_m(self) -> float:
        """From its first to its last point."""
        return self.at_m[-1]

    def point(self, at_m: float) -> Vec2:
        """The point ``at_m`` along it; straight on beyond its ends."""
        i = 0
        while i < len(self.points) - 2 and self.at_m[i + 1] < at_m:
            i += 1
        (ax, ay), (bx, by) = self.points[i], self.points[i + 1]
        f = (at_m - self.at_m[i]) / (self.at_m[i + 1] - self.at_m[i])
        return (ax + f * (bx - ax), ay + f * (by - ay))

    def locate(self, x_m: float, y_m: float, from_m: float, to_m: float) -> tuple[float, float]:
        """The nearest point between two distances along it: its distance along, and how far off it is.

        On the last segment the distance along may exceed the length: by how much the end was passed.
        """
        best = (from_m, math.inf)
        last = len(self.points) - 2
        for i, ((ax, ay), (bx, by)) in enumerate(pairwise(self.points)):
            low, high = self.at_m[i], self.at_m[i + 1]
            if (high < from_m and i != last) or low > to_m:
                continue
            ux, uy = (bx - ax) / (high - low), (by - ay) / (high - low)
            along = low + (x_m - ax) * ux + (y_m - ay) * uy
            along = min(max(along, low, min(from_m, high)), math.inf if i == last else high)
            off = math.hypot(ax + (along - low) * ux - x_m, ay + (along - low) * uy - y_m)
            if off < best[1]:
                best = (along, off)
        return best


def turn_at(a: Vec2, b: Vec2, c: Vec2) -> float:
    """By how much the way from ``a`` to ``c`` turns at ``b``, left positive."""
    before, after = math.atan2(b[1] - a[1], b[0] - a[0]), math.atan2(c[1] - b[1], c[0] - b[0])
    return math.remainder(after - before, math.tau)


def clean(path: Sequence[Vec2]) -> list[Vec2]:
    """Without points that say nothing: doubles, and those on the straight line between their neighbours."""
    points: list[Vec2] = []
    for p in path:
        if not points or math.dist(points[-1], p) > GAP_M:
            points.append(p)
    if len(points) > 1 and points[-1] != path[-1]:
        points[-1] = path[-1]
    kept = points[:1]
    for p, q in pairwise(points[1:]):
        if abs(turn_at(kept[-1], p, q)) > 1e-3:
            kept.append(p)
    return kept + points[1:][-1:]


def rounded(points: Sequence[Vec2], radius_m: float) -> list[Vec2]:
    """The polyline with an arc of ``radius_m`` in each corner, or of a smaller one where there is no room."""
    if len(points) < 3 or radius_m <= 0.0:
        return list(points)
    made = [points[0]]
    for a, b, c in zip(points, points[1:], points[2:], strict=False):
        turn = turn_at(a, b, c)
        # an end piece may be used up whole, one between two corners is shared
        before_m = math.dist(a, b) * (1.0 if a == points[0] else 0.5)
        room_m = min(before_m, math.dist(b, c) * (1.0 if c == points[-1] else 0.5))
        half = abs(math.tan(turn / 2.0))
        tangent_m = min(radius_m * half, 0.98 * room_m)
        steps = math.ceil(abs(turn) / _ARC_STEP_RAD)
        if steps < 2 or tangent_m <= GAP_M:
            made.append(b)
            continue
        r = tangent_m / half
        heading = math.atan2(b[1] - a[1], b[0] - a[0])
        start = (b[0] - tangent_m * math.cos(heading), b[1] - tangent_m * math.sin(heading))
        side = math.copysign(1.0, turn)
        centre = (start[0] - side * r * math.sin(heading), start[1] + side * r * math.cos(heading))
        for k in range(steps + 1):
            at = heading + turn * k / steps
            made.append((centre[0] + side * r * math.sin(at), centre[1] - side * r * math.cos(at)))
    made.append(points[-1])
    return clean(made)


def pieces(path: Sequence[Vec2], stop_turn_rad: float, radius_m: float) -> list[Piece]:
    """Cuts a path at corners sharper than ``stop_turn_rad`` and rounds the others; empty when it leads nowhere."""
    points = clean(path)
    if len(points) < 2:
        return []
    runs, run = [], points[:2]
    for p in points[2:]:
        if abs(turn_at(run[-2], run[-1], p)) > stop_turn_rad:
            runs.append(run)
            run = run[-1:]
        run.append(p)
    runs.append(run)
    return [Piece.of(rounded(r, radius_m)) for r in runs]
