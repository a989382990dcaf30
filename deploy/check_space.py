"""Checks of the whole timed plan in space: separation in the air and on the road, and the geofence."""

from __future__ import annotations

import math
from itertools import combinations

import shapely

from deploy.check_paths import TeamPaths, polyline, team_paths
from deploy.check_report import CheckRow, Verdict, at_least, not_run
from deploy.check_separation import Approach, episodes
from deploy.settings import Settings
from planner.errors import PlannerError
from planner.plan import Plan

GROUP = "space"
NAMES = ("separation", "ugv separation", "flights inside", "drives inside")
Found = tuple[Approach, str, str]  # the approach, who goes first, who holds


def space_rows(settings: Settings, plan: Plan) -> list[CheckRow]:
    """All checks in space; not run where the plan is infeasible."""
    why = "the plan is infeasible"
    if plan.feasible:
        try:
            paths = team_paths(settings, plan)
        except PlannerError as error:
            why = str(error)
        else:
            return [
                _separation(settings, paths),
                _ugv_separation(settings, paths),
                _flights_inside(settings, paths),
                _drives_inside(settings, paths),
            ]
    return [not_run(name, GROUP, why, "m") for name in NAMES]


def _separation(settings: Settings, paths: TeamPaths) -> CheckRow:
    """Least distance to the cylinder around a flying UAV that another one keeps."""
    s = settings.separation
    closest: list[Found] = []
    conflicts: list[Found] = []
    for i, j in combinations(range(len(paths.uavs)), 2):
        nearest, inside = episodes(paths.uavs[i], paths.uavs[j], s.horizontal_m, s.vertical_m)
        names = settings.uavs[i].id, settings.uavs[j].id
        if nearest is not None:
            closest.append((nearest, *names))
        conflicts += [(c, *names) for c in inside]
    if not closest:
        text = "no two UAVs are ever in the air together"
        return CheckRow("separation", GROUP, Verdict.PASS, None, "m", 0.0, text)
    worst, first, second = min(closest, key=lambda c: c[0].margin_m)
    near = f"{first} and {second} come within {worst.horizontal_m:.3g} m and {worst.vertical_m:.3g} m in height"
    text = f"{near} at {_when(settings, worst)}"
    stuck = [c for c in conflicts if c[0].stuck]
    return _space_row(
        "separation",
        worst,
        text,
        settings,
        conflicts,
        stuck,
        ("spread arena.layers to avoid it", "put landing and waiting places further apart (arena.pad_spacing_m)"),
    )


def _ugv_separation(settings: Settings, paths: TeamPaths) -> CheckRow:
    """Least distance between two UGVs less the allowed one."""
    least = settings.separation.ugv_m
    closest: list[Found] = []
    conflicts: list[Found] = []
    for i, j in combinations(range(len(paths.ugvs)), 2):
        nearest, inside = episodes(paths.ugvs[i], paths.ugvs[j], least - 1e-6, math.inf)
        names = settings.ugvs[i].id, settings.ugvs[j].id
        if nearest is not None:
            closest.append((nearest, *names))
        conflicts += [(c, *names) for c in inside]
    if not closest:
        text = "no two UGVs are on the road"
        return CheckRow("ugv separation", GROUP, Verdict.PASS, None, "m", 0.0, text)
    worst, first, second = min(closest, key=lambda c: c[0].margin_m)
    text = f"{first} and {second} come within {worst.horizontal_m:.3g} m at {_when(settings, worst)}"
    stuck = [c for c in conflicts if c[0].stuck]
    return _space_row(
        "ugv separation",
        worst,
        text,
        settings,
        conflicts,
        stuck,
        ("lane_offset_m on two-way roads avoids it", "put parking places further apart (arena.parking_spacing_m)"),
    )


def _when(settings: Settings, approach: Approach) -> str:
    return f"{approach.time_s / settings.frame.time_scale:.0f} s"


def _space_row(
    name: str,
    worst: Approach,
    text: str,
    settings: Settings,
    conflicts: list[Found],
    stuck: list[Found],
    remedies: tuple[str, str],
) -> CheckRow:
    if stuck:
        approach, first, second = stuck[0]
        text = (
            f"{first} and {second} wait {approach.horizontal_m:.3g} m from each other at {_when(settings, approach)}: "
            f"holding cannot resolve it; {remedies[1]}"
        )
        return CheckRow(name, GROUP, Verdict.FAIL, approach.margin_m, "m", 0.0, text)
    if conflicts:
        count = len(conflicts)
        others = f" ({count} conflicts in all)" if count > 1 else ""
        holds = max(conflicts, key=lambda c: -c[0].margin_m)[2]
        text += f"{others}: {holds} will hold, which takes time; {remedies[0]}"
        return CheckRow(name, GROUP, Verdict.WARN, worst.margin_m, "m", 0.0, text)
    return CheckRow(name, GROUP, Verdict.PASS, worst.margin_m, "m", 0.0, text)


def _flights_inside(settings: Settings, paths: TeamPaths) -> CheckRow:
    """Least distance of any flight to the geofence's edge or the ceiling, negative outside."""
    fence = settings.geofence
    found = []
    for config, legs in zip(settings.uavs, paths.uavs, strict=True):
        if not legs:
            continue
        found.append((_inside_m(settings, polyline(legs)), f"{config.id} flies"))
        top = max(max(leg.a_m[2], leg.b_m[2]) for leg in legs)
        found.append((fence.ceiling_m - top, f"{config.id} climbs"))
    if not found:
        return CheckRow("flights inside", GROUP, Verdict.PASS, None, "m", 0.0, "nobody flies")
    return _inside_row("flights inside", settings, found)


def _drives_inside(settings: Settings, paths: TeamPaths) -> CheckRow:
    """Least distance of any drive to the geofence's edge, negative outside."""
    found = [
        (_inside_m(settings, polyline(legs)), f"{config.id} drives")
        for config, legs in zip(settings.ugvs, paths.ugvs, strict=True)
    ]
    if not found:
        return CheckRow("drives inside", GROUP, Verdict.PASS, None, "m", 0.0, "there are no UGVs")
    return _inside_row("drives inside", settings, found)


def _inside_row(name: str, settings: Settings, found: list[tuple[float, str]]) -> CheckRow:
    margin, who = min(found)
    soft = settings.geofence.soft_margin_m
    side = "outside" if margin < 0 else "inside"
    return at_least(
        name,
        GROUP,
        margin,
        "m",
        warn=soft - 1e-6,
        fail=0.0,
        text=f"{who} {abs(margin):.3g} m {side} the geofence",
        remedy=f"within {soft:g} m of it monitors warn, outside they end the flight: widen it or move tasks and sites",
    )


def _inside_m(settings: Settings, points: list[tuple[float, float]]) -> float:
    """Distance of a polyline to the geofence's edge, in m: negative (by how far it goes out) when it leaves."""
    fence = shapely.Polygon(settings.geofence.polygon_m)
    line = shapely.LineString(points) if len(points) > 1 else shapely.Point(points[0])
    if fence.covers(line):
        return float(fence.exterior.distance(line))
    out = shapely.segmentize(line.difference(fence), max(line.length / 200, 1e-6))
    # Where a straight path cuts a corner both its ends lie on the edge: never report less than a millimetre outside.
    furthest = max(float(fence.distance(shapely.Point(p))) for p in shapely.get_coordinates(out))
    return -max(furthest, 1e-3)
