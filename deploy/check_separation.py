"""Exact closest approach of two timed paths: no sampling, each pair of legs is solved in closed form."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from deploy.check_paths import Leg

WAITING = frozenset({"wait", "park"})


@dataclass(frozen=True, slots=True)
class Approach:
    """The nearest that two vehicles come.

    Attributes:
        margin_m: the larger of the distances to the cylinder's wall and to its lid; negative inside it.
        time_s: when, arena s.
        horizontal_m, vertical_m: how near then.
        stuck: somewhere inside the cylinder both wait or park, so that neither can hold for the other.
    """

    margin_m: float
    time_s: float
    horizontal_m: float
    vertical_m: float
    stuck: bool = False


def episodes(
    a: Sequence[Leg], b: Sequence[Leg], horizontal_m: float, vertical_m: float
) -> tuple[Approach | None, tuple[Approach, ...]]:
    """The closest approach of two paths and every stay inside the cylinder.

    Args:
        a: legs of one vehicle, in order of time.
        b: legs of the other.
        horizontal_m: radius of the cylinder.
        vertical_m: half its height; ``inf`` judges by horizontal distance alone.

    Returns:
        The closest approach (None where the two are never both on their way), and the closest of each row of
        touching conflicts.
    """
    closest: Approach | None = None
    found: list[Approach] = []
    inside = False  # at the end of the pair of legs before
    for one, other in _overlaps(a, b):
        approach = closest_approach(one, other, horizontal_m, vertical_m)
        if closest is None or approach.margin_m < closest.margin_m:
            closest = approach
        if approach.margin_m < 0:
            approach = replace(approach, stuck={one.kind, other.kind} <= WAITING)
            if inside and _margin_at(one, other, max(one.t0_s, other.t0_s), horizontal_m, vertical_m) < 0:
                stuck = approach.stuck or found[-1].stuck
                found[-1] = replace(min(found[-1], approach, key=lambda x: x.margin_m), stuck=stuck)
            else:
                found.append(approach)
        inside = _margin_at(one, other, min(one.t1_s, other.t1_s), horizontal_m, vertical_m) < 0
    return closest, tuple(found)


def _margin_at(a: Leg, b: Leg, t: float, horizontal_m: float, vertical_m: float) -> float:
    x, y, z = _relative(a, b, t)
    wall = math.hypot(x, y) - horizontal_m
    return wall if math.isinf(vertical_m) else max(wall, abs(z) - vertical_m)


def _overlaps(a: Sequence[Leg], b: Sequence[Leg]) -> Iterator[tuple[Leg, Leg]]:
    i = j = 0
    while i < len(a) and j < len(b):
        if min(a[i].t1_s, b[j].t1_s) >= max(a[i].t0_s, b[j].t0_s):
            yield a[i], b[j]
        if a[i].t1_s <= b[j].t1_s:
            i += 1
        else:
            j += 1


def closest_approach(a: Leg, b: Leg, horizontal_m: float, vertical_m: float) -> Approach:
    """The closest approach while both legs last.

    Horizontal and vertical distance to the cylinder are both convex in time, hence so is the larger of them: its
    minimum lies at an end, at the minimum of either, or where the two are equal.
    """
    t0, t1 = max(a.t0_s, b.t0_s), min(a.t1_s, b.t1_s)
    (x0, y0, z0), (x1, y1, z1) = _relative(a, b, t0), _relative(a, b, t1)
    vx, vy, vz = x1 - x0, y1 - y0, z1 - z0  # per unit of f, from 0 to 1
    shares = [0.0, 1.0]
    qa, qb, qc = vx * vx + vy * vy, x0 * vx + y0 * vy, x0 * x0 + y0 * y0  # squared distance: qa f^2 + 2 qb f + qc
    if qa > 0:
        shares.append(-qb / qa)
    if vz != 0 and math.isfinite(vertical_m):
        shares.append(-z0 / vz)
    if math.isfinite(vertical_m):
        gap = horizontal_m - vertical_m
        for sign in (1.0, -1.0):  # distance = sign (z0 + vz f) + gap
            shares += _roots(qa - vz * vz, qb - vz * z0 - sign * vz * gap, qc - (sign * z0 + gap) ** 2)
    best: Approach | None = None
    for f in shares:
        if not 0.0 <= f <= 1.0:
            continue
        h, v = math.hypot(x0 + f * vx, y0 + f * vy), abs(z0 + f * vz)
        margin = h - horizontal_m if math.isinf(vertical_m) else max(h - horizontal_m, v - vertical_m)
        if best is None or margin < best.margin_m:
            best = Approach(margin, t0 + f * (t1 - t0), h, v)
    assert best is not None  # both ends are always looked at
    return best


def _relative(a: Leg, b: Leg, t: float) -> tuple[float, float, float]:
    pa, pb = _at(a, t), _at(b, t)
    return pa[0] - pb[0], pa[1] - pb[1], pa[2] - pb[2]


def _at(leg: Leg, t: float) -> tuple[float, float, float]:
    f = (t - leg.t0_s) / (leg.t1_s - leg.t0_s) if leg.t1_s > leg.t0_s else 0.0
    a, b = leg.a_m, leg.b_m
    return a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])


def _roots(a: float, half_b: float, c: float) -> list[float]:
    """Real roots of a f^2 + 2 half_b f + c."""
    if abs(a) < 1e-12:
        return [-c / (2 * half_b)] if half_b != 0 else []
    d = half_b * half_b - a * c
    if d < 0:
        return []
    root = math.sqrt(d)
    return [(-half_b - root) / a, (-half_b + root) / a]
