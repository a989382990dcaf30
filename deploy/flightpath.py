"""Timed paths and whether two of them come too near: what dispatch plans with and what the gate judges by.

A path is piecewise linear in time. Because a vehicle is never exactly on time, a path is judged as a row of *pieces*,
each occupied some seconds before and after its own time; two paths conflict where two pieces overlap in time and come
nearer than the cylinder of ``Separation`` allows (horizontally and vertically at once, for downwash).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from drivers.vehicle import Vec2, Vec3

FOREVER_S = 1e9
PIECE_S = 4.0
EXACT_M = 1e-6  # distances are sums and differences of decimals
EARLY_LATE_S = 3.0


@dataclass(frozen=True, slots=True)
class TimedPath:
    """Knots (t in s, x, y, z in m) with growing times; before the first and after the last the vehicle rests there."""

    knots: tuple[tuple[float, float, float, float], ...]

    @property
    def end_s(self) -> float:
        """Time of the last knot."""
        return self.knots[-1][0]

    @property
    def end_m(self) -> Vec3:
        """Position of the last knot."""
        return self.knots[-1][1:]

    @property
    def rests_from_s(self) -> float:
        """When it comes to rest at its end."""
        for (_, *a), (t1, *b) in zip(self.knots[-2::-1], self.knots[:0:-1], strict=True):
            if a != b:
                return t1
        return self.knots[0][0]

    def until(self, time_s: float) -> TimedPath:
        """The path up to ``time_s``, which must lie after its first knot; it ends there."""
        return TimedPath((*(k for k in self.knots if k[0] < time_s), (time_s, *self.at(time_s))))

    def later(self, by_s: float) -> TimedPath:
        """The same path, ``by_s`` later."""
        if by_s == 0:
            return self
        return TimedPath(tuple((t + by_s if t < FOREVER_S else t, x, y, z) for t, x, y, z in self.knots))

    def at(self, time_s: float) -> Vec3:
        """Position at ``time_s``."""
        previous = self.knots[0]
        if time_s <= previous[0]:
            return previous[1:]
        for knot in self.knots[1:]:
            if time_s < knot[0]:
                f = (time_s - previous[0]) / (knot[0] - previous[0])
                return (
                    previous[1] + f * (knot[1] - previous[1]),
                    previous[2] + f * (knot[2] - previous[2]),
                    previous[3] + f * (knot[3] - previous[3]),
                )
            previous = knot
        return previous[1:]


@dataclass(frozen=True, slots=True)
class Conflict:
    """Two paths come too near: when (earliest), and how near horizontally and vertically."""

    time_s: float
    horizontal_m: float
    vertical_m: float


def rest_to_rest_s(distance_m: float, speed_mps: float, accel_mps2: float) -> float:
    """Duration of a straight motion from rest to rest with a trapezoidal speed profile."""
    if distance_m <= 0:
        return 0.0
    if distance_m >= speed_mps * speed_mps / accel_mps2:
        return distance_m / speed_mps + speed_mps / accel_mps2
    return 2.0 * math.sqrt(distance_m / accel_mps2)


def resting(position_m: Vec3, now_s: float) -> TimedPath:
    """A vehicle that stays where it is."""
    return TimedPath(((now_s, *position_m), (FOREVER_S, *position_m)))


def straight(start_m: Vec3, end_m: Vec3, now_s: float, speed_mps: float, accel_mps2: float) -> TimedPath:
    """A straight rest-to-rest flight that begins now, at constant mean speed, and then rests at its end."""
    duration_s = rest_to_rest_s(math.dist(start_m, end_m), speed_mps, accel_mps2)
    if duration_s <= 0:
        return resting(end_m, now_s)
    return TimedPath(((now_s, *start_m), (now_s + duration_s, *end_m), (FOREVER_S, *end_m)))


def column(low_m: Vec3, high_z_m: float, now_s: float) -> TimedPath:
    """The air above ``low_m`` up to ``high_z_m`` for as long as need be: a docking may climb back at any time."""
    x, y, z = low_m
    return TimedPath(((now_s, x, y, high_z_m), (FOREVER_S, x, y, z)))


def along(points_m: Sequence[Vec2], height_m: float, now_s: float, speed_mps: float) -> TimedPath:
    """A drive along a polyline at constant speed that begins now, and then rests at its end."""
    knots = [(now_s, points_m[0][0], points_m[0][1], height_m)]
    for x, y in points_m[1:]:
        step_s = math.dist((x, y), knots[-1][1:3]) / speed_mps
        if step_s > 0:
            knots.append((knots[-1][0] + step_s, x, y, height_m))
    return TimedPath((*knots, (FOREVER_S, *knots[-1][1:])))


_Piece = tuple[float, float, Vec3, Vec3]  # (from s, to s, start, end)


def pieces(path: TimedPath, from_s: float) -> list[_Piece]:
    """The path from ``from_s`` on, cut so that no moving piece lasts longer than ``PIECE_S``; at rest at either end."""
    first, last = path.knots[0], path.knots[-1]
    knots = [(from_s, *first[1:]), *path.knots] if from_s < first[0] else list(path.knots)
    if last[0] < FOREVER_S:
        knots.append((max(from_s, last[0], 0.0) + FOREVER_S, *last[1:]))
    found: list[_Piece] = []
    for (t0, *_), (t1, *p1) in pairwise(knots):
        if t1 <= from_s:
            continue
        begin_s = max(t0, from_s)
        a = path.at(begin_s)
        b = (p1[0], p1[1], p1[2])
        if a == b or t1 == FOREVER_S:  # at rest, or somewhere in a column
            found.append((begin_s, t1, a, b))
            continue
        n = max(1, math.ceil((t1 - begin_s) / PIECE_S))
        for i in range(n):
            f0, f1 = i / n, (i + 1) / n
            found.append((begin_s + f0 * (t1 - begin_s), begin_s + f1 * (t1 - begin_s), _mix(a, b, f0), _mix(a, b, f1)))
    return found


def _mix(a: Vec3, b: Vec3, f: float) -> Vec3:
    return (a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2]))


def segment_distance_m(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> float:
    """Least horizontal distance between segments a-b and c-d (Ericson, Real-Time Collision Detection, 5.1.9)."""
    ux, uy, vx, vy = b[0] - a[0], b[1] - a[1], d[0] - c[0], d[1] - c[1]
    wx, wy = a[0] - c[0], a[1] - c[1]
    uu, vv, uv = ux * ux + uy * uy, vx * vx + vy * vy, ux * vx + uy * vy
    uw, vw = ux * wx + uy * wy, vx * wx + vy * wy
    det = uu * vv - uv * uv
    s = _clamp((uv * vw - vv * uw) / det) if det > 1e-12 * max(uu * vv, 1e-12) else 0.0
    t = (uv * s + vw) / vv if vv > 0 else 0.0
    if t < 0 or t > 1 or vv == 0:
        t = _clamp(t)
        s = _clamp((uv * t - uw) / uu) if uu > 0 else 0.0
    return math.hypot(wx + s * ux - t * vx, wy + s * uy - t * vy)


def _clamp(x: float) -> float:
    return 0.0 if x < 0 else min(x, 1.0)


def vertical_gap_m(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> float:
    """Least vertical distance between the height ranges of a-b and c-d; 0 where they overlap."""
    return max(0.0, max(min(a[2], b[2]), min(c[2], d[2])) - min(max(a[2], b[2]), max(c[2], d[2])))


def conflict(
    mine: TimedPath,
    other: TimedPath,
    now_s: float,
    horizontal_m: float,
    vertical_m: float,
    slop_s: float = EARLY_LATE_S,
) -> Conflict | None:
    """The first conflict of two paths from ``now_s`` on, or None.

    Args:
        mine: the path that is to begin.
        other: the path of another vehicle.
        now_s: pieces before this time do not count.
        horizontal_m: radius of the cylinder, buffer included.
        vertical_m: its half height, buffer included.
        slop_s: how much earlier or later than planned either may be.

    A pair that is too near at the very start and only moves apart is no conflict: it must be allowed to part.
    """
    ours, theirs = pieces(mine, now_s), pieces(other, now_s)
    parting = _parting(ours[0], theirs[0], horizontal_m, vertical_m)
    j0 = 0
    for i, (a0, a1, a, b) in enumerate(ours):
        while j0 < len(theirs) - 1 and theirs[j0][1] + slop_s < a0 - slop_s:
            j0 += 1
        for j in range(j0, len(theirs)):
            c0, _, c, d = theirs[j]
            if c0 - slop_s > a1 + slop_s:
                break
            gap_m = vertical_gap_m(a, b, c, d)
            if gap_m >= vertical_m - EXACT_M:
                continue
            distance_m = segment_distance_m(a, b, c, d)
            if distance_m < horizontal_m - EXACT_M and not (parting and i == 0 and j == 0):
                return Conflict(max(a0, c0, now_s), distance_m, gap_m)
    return None


def _parting(ours: _Piece, theirs: _Piece, horizontal_m: float, vertical_m: float) -> bool:
    """Whether the two start inside each other's cylinder and only move apart while both are in their first pieces.

    Their nearness is measured in cylinders (1 where the two just touch). It is a convex function of time as long as
    both move uniformly, so it only grows if it does not shrink at the start.
    """
    (a0, a1, a, b), (c0, c1, c, d) = ours, theirs
    until_s = min(a1, c1)
    p, q = _mix(a, b, (until_s - a0) / (a1 - a0)), _mix(c, d, (until_s - c0) / (c1 - c0))
    x, y, z = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    u, v, w = q[0] - p[0] - x, q[1] - p[1] - y, q[2] - p[2] - z
    start_h, start_v = math.hypot(x, y), abs(z)
    if start_h >= horizontal_m or start_v >= vertical_m:
        return False
    near_h, near_v = start_h / horizontal_m, start_v / vertical_m
    leaves_h = x * u + y * v >= 0
    leaves_v = z * w >= 0
    grows = leaves_h if near_h > near_v else leaves_v if near_v > near_h else leaves_h or leaves_v
    end_h, end_v = math.hypot(x + u, y + v) / horizontal_m, abs(z + w) / vertical_m
    return grows and max(end_h, end_v) > max(near_h, near_v)
