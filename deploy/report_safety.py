"""Was the run safe? Computed from recorded positions and energies alone; shares no code with monitors and gate.

Between two recorded moments vehicles are taken to move uniformly, so that a close pass between them is found.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import shapely
from numpy.typing import NDArray

from deploy.events import EventKind
from deploy.report_history import Array, History
from deploy.state import AIRBORNE, UavPhase, UgvPhase

EXACT_M = 1e-6  # a boundary is not breached by rounding


@dataclass(frozen=True, slots=True)
class Violation:
    """One breach of a safety limit.

    Attributes:
        kind: ``separation``, ``ugv_separation``, ``geofence``, ``ceiling``, ``energy``, ``crash`` or ``left_airborne``.
        vehicles: who.
        start_s, end_s: mission time.
        worst, limit: the worst value and the limit, in ``unit``; None where there is no number.
        text: one sentence.
    """

    kind: str
    vehicles: tuple[str, ...]
    start_s: float
    end_s: float
    worst: float | None
    limit: float | None
    unit: str
    text: str


@dataclass(frozen=True, slots=True)
class Safety:
    """Least distances (arena m; None where no two were ever comparable), least energy above reserve, violations.

    Attributes:
        min_separation_m: horizontal, between two airborne UAVs less than the downwash height apart vertically.
        min_ugv_separation_m: between two UGVs of which one drives.
        min_energy_margin_j: per UAV and over all of them, energy less reserve.
    """

    min_separation_m: float | None
    min_ugv_separation_m: float | None
    min_energy_margin_j: float | None
    margin_of: dict[str, float]
    violations: tuple[Violation, ...]


def judge(history: History) -> Safety:
    """Judges a run."""
    uav_min, uav_bad = _uav_pairs(history)
    ugv_min, ugv_bad = _ugv_pairs(history)
    margins, energy_bad = _energy(history)
    found = [*uav_bad, *ugv_bad, *_fence(history), *energy_bad, *_told(history)]
    return Safety(
        uav_min,
        ugv_min,
        min(margins.values(), default=None),
        margins,
        tuple(sorted(found, key=lambda v: (v.start_s, v.kind, v.vehicles))),
    )


def pair_distance_m(history: History, a: int, b: int) -> tuple[Array, Array]:
    """Least horizontal distance and least vertical gap of two vehicles in each interval, (T-1,) each, arena m.

    The two minima may belong to different moments of the interval, which errs on the safe side. One status alone
    counts as an interval of its own.
    """
    gap = history.position_m[:, a] - history.position_m[:, b]
    if len(gap) == 1:
        gap = np.repeat(gap, 2, axis=0)
    start, step = gap[:-1], np.diff(gap, axis=0)
    length2 = (step[:, :2] ** 2).sum(axis=1)
    along = np.divide(-(start[:, :2] * step[:, :2]).sum(axis=1), length2, out=np.zeros(len(step)), where=length2 > 0)
    nearest = start[:, :2] + np.clip(along, 0, 1)[:, None] * step[:, :2]
    z0, z1 = gap[:-1, 2], gap[1:, 2]
    vertical = np.where(z0 * z1 <= 0, 0.0, np.minimum(abs(z0), abs(z1)))
    return np.hypot(nearest[:, 0], nearest[:, 1]), vertical


def both_airborne(history: History, a: int, b: int) -> NDArray[np.bool_]:
    """In which intervals both UAVs are in the air at both ends, (T-1,)."""
    up = history.airborne[:, a] & history.airborne[:, b]
    return up[:-1] & up[1:] if len(up) > 1 else up


def _uav_pairs(history: History) -> tuple[float | None, list[Violation]]:
    limit = history.settings.separation
    least, found = np.inf, []
    for a, b in combinations(range(history.n_uavs), 2):
        if not len(history.now_s):
            break
        distance, vertical = pair_distance_m(history, a, b)
        near = both_airborne(history, a, b) & (vertical < limit.vertical_m)
        distance = np.where(near, distance, np.inf)
        least = min(least, float(distance.min()))
        for i, j in _runs(distance < limit.horizontal_m - EXACT_M):
            worst = float(distance[i:j].min())
            pair = (history.ids[a], history.ids[b])
            words = f"{_exact(worst)} m apart in the air; the limit is {limit.horizontal_m:g} m"
            text = f"{pair[0]} and {pair[1]} were {words}"
            found.append(_violation(history, "separation", pair, i, j, worst, limit.horizontal_m, "m", text))
    return (least if np.isfinite(least) else None), found


def _ugv_pairs(history: History) -> tuple[float | None, list[Violation]]:
    limit = history.settings.separation.ugv_m
    least, found = np.inf, []
    for a, b in combinations(range(history.n_uavs, len(history.ids)), 2):
        if not len(history.now_s):
            break
        distance, _ = pair_distance_m(history, a, b)
        drives = (history.phase[:, [a, b]] == str(UgvPhase.DRIVING)).any(axis=1)
        drives = drives[:-1] | drives[1:] if len(drives) > 1 else drives
        distance = np.where(drives & ~np.isnan(distance), distance, np.inf)
        least = min(least, float(distance.min()))
        for i, j in _runs(distance < limit - EXACT_M):
            worst = float(distance[i:j].min())
            pair = (history.ids[a], history.ids[b])
            text = f"{pair[0]} and {pair[1]} were {_exact(worst)} m apart; the limit is {limit:g} m"
            found.append(_violation(history, "ugv_separation", pair, i, j, worst, limit, "m", text))
    return (least if np.isfinite(least) else None), found


def _fence(history: History) -> Iterator[Violation]:
    fence = history.settings.geofence
    polygon = shapely.Polygon(fence.polygon_m)
    for v, name in enumerate(history.ids):
        x, y, z = (history.position_m[:, v, axis] for axis in range(3))
        outside = shapely.distance(polygon, shapely.points(np.nan_to_num(x), np.nan_to_num(y)))
        outside = np.where(np.isnan(x), 0.0, outside)
        for i, j in _runs(outside > EXACT_M):
            worst = float(outside[i:j].max())
            text = f"{name} was {_exact(worst)} m outside the geofence"
            yield _violation(history, "geofence", (name,), i, j, worst, 0.0, "m", text)
        if v >= history.n_uavs:
            continue
        for i, j in _runs(np.nan_to_num(z, nan=-np.inf) > fence.ceiling_m + EXACT_M):
            worst = float(z[i:j].max())
            text = f"{name} was at {_exact(worst)} m; the ceiling is {fence.ceiling_m:g} m"
            yield _violation(history, "ceiling", (name,), i, j, worst, fence.ceiling_m, "m", text)


def _energy(history: History) -> tuple[dict[str, float], list[Violation]]:
    margins, found = {}, []
    for v, uav in enumerate(history.settings.problem.uavs):
        margin = history.energy_j[:, v] - uav.reserve_j
        # a lost UAV has no energy that anyone knows
        margin = np.where(np.isnan(margin) | (history.phase[:, v] == str(UavPhase.LOST)), np.inf, margin)
        if np.isfinite(margin).any():
            margins[uav.id] = float(margin.min())
        # The reserve is there to be used when something goes wrong; the supervisor guarantees the floor below it.
        floor_j = min(uav.reserve_j, history.settings.monitors.energy_margin * uav.capacity_j)
        above = margin + uav.reserve_j - floor_j
        for i, j in _runs((above < -EXACT_M) & _using(history, v)):
            worst = float(above[i:j].min())
            text = f"{uav.id} was {-worst / 1000:.2f} kJ below its energy floor of {floor_j / 1000:.1f} kJ"
            found.append(_violation(history, "energy", (uav.id,), i, j, worst, 0.0, "J", text))
    return margins, found


def _using(history: History, uav: int) -> NDArray[np.bool_]:
    """When a UAV uses energy, and the moment after, (T,): a low battery on the ground breaches nothing anew."""
    up: NDArray[np.bool_] = np.isin(history.phase[:, uav], [str(p) for p in AIRBORNE])
    after: NDArray[np.bool_] = np.concatenate([up[:1], up[:-1]])
    return np.logical_or(up, after)


def _told(history: History) -> Iterator[Violation]:
    """What positions cannot show: a crash that a vehicle reported, and a mission that ended with a UAV in the air."""
    for event in history.events:
        if event.kind is EventKind.TUMBLED:
            at = history.to_mission_s(event.time_s)
            yield Violation("crash", (event.vehicle or "?",), at, at, None, None, "", event.text)
    if history.state in ("done", "aborted"):
        for u in np.flatnonzero(history.airborne[-1]):
            name, at = history.ids[u], float(history.mission_s[-1])
            yield Violation(
                "left_airborne", (name,), at, at, None, None, "", f"{name} was in the air when the mission ended"
            )


def _violation(
    history: History, kind: str, who: tuple[str, ...], i: int, j: int, worst: float, limit: float, unit: str, text: str
) -> Violation:
    t = history.mission_s
    return Violation(kind, who, float(t[i]), float(t[min(j, len(t) - 1)]), worst, limit, unit, text)


def _exact(value: float) -> str:
    """Enough digits to see on which side of a limit it is, in arenas of 4 m too."""
    return f"{value:.3f}" if abs(value) < 1 else f"{value:.2f}"


def _runs(bad: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Half-open index ranges in which ``bad`` is true."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
