"""Checks of the mission itself, before there is a plan: roads, tasks, landing places, layers, speeds."""

from __future__ import annotations

import math
from itertools import combinations, pairwise

import numpy as np

from deploy.check_report import CheckRow, Verdict, at_least, at_most
from deploy.fence import margin_m
from deploy.settings import Settings, UavSettings, UgvSettings
from drivers.vehicle import Vec2

GROUP = "mission"


def mission_rows(settings: Settings) -> list[CheckRow]:
    """All checks of the mission."""
    return [
        _roads(settings),
        _tasks(settings),
        _places_inside(settings),
        _pads(settings),
        _parking(settings),
        _layers(settings),
        _speeds(settings),
    ]


def _site_name(settings: Settings, site: int) -> str:
    return "the depot" if site == settings.problem.depot_index else f"path point {site}"


def _roads(settings: Settings) -> CheckRow:
    """Path points that no road connects with the depot."""
    problem = settings.problem
    cut_off = [int(p) for p in np.flatnonzero(np.isinf(problem.road_distance_m[-1, :-1]))]
    total = len(problem.path_points)
    if not cut_off:
        text = f"roads lead from the depot to all {total} path points"
        return CheckRow("roads", GROUP, Verdict.PASS, 0.0, "points", 0.0, text)
    names = ", ".join(str(p) for p in cut_off)
    verdict = Verdict.FAIL if len(cut_off) == total else Verdict.WARN
    text = f"no road leads from the depot to path point{'s' if len(cut_off) > 1 else ''} {names}; move or remove them"
    return CheckRow("roads", GROUP, verdict, float(len(cut_off)), "points", 0.0, text)


def _tasks(settings: Settings) -> CheckRow:
    """Distance of the task nearest to the geofence's edge, negative outside."""
    fence, problem = settings.geofence, settings.problem
    places = [settings.frame.to_arena((float(x), float(y))) for x, y in problem.tasks]
    margins = [margin_m(fence.polygon_m, *place) for place in places]
    if not margins:
        return CheckRow("tasks inside", GROUP, Verdict.PASS, None, "m", 0.0, "there are no tasks")
    worst = min(range(len(margins)), key=margins.__getitem__)
    outside = sum(m < 0 for m in margins)
    where = f"{abs(margins[worst]):.3g} m {'outside' if margins[worst] < 0 else 'inside'} the geofence"
    text = f"task {worst} lies {where}" + (f", {outside} of {len(margins)} tasks are outside" if outside else "")
    return at_least(
        "tasks inside",
        GROUP,
        margins[worst],
        "m",
        warn=fence.soft_margin_m,
        fail=0.0,
        text=text,
        remedy=f"the soft margin is {fence.soft_margin_m:g} m: widen the geofence or move the task",
    )


def places(settings: Settings, site: int) -> list[tuple[str, Vec2]]:
    """Who stops where at a site: vehicle ids and arena positions, UAV pads first."""
    pads = [(u.id, settings.pad_m(i, site)) for i, u in enumerate(settings.uavs)]
    return pads + [(g.id, settings.park_m(j, site)) for j, g in enumerate(settings.ugvs)]


def _places_inside(settings: Settings) -> CheckRow:
    """Distance of the landing or stopping place nearest to the geofence's edge, negative outside."""
    fence = settings.geofence
    found = [
        (margin_m(fence.polygon_m, *place), f"{who} at {_site_name(settings, site)}")
        for site in range(len(settings.problem.sites))
        for who, place in places(settings, site)
    ]
    worst, who = min(found)
    side = "outside" if worst < 0 else "inside"
    return at_least(
        "places inside",
        GROUP,
        worst,
        "m",
        warn=fence.soft_margin_m,
        fail=0.0,
        text=f"the place of {who} lies {abs(worst):.3g} m {side} the geofence",
        remedy=f"the soft margin is {fence.soft_margin_m:g} m: widen the geofence or move the site",
    )


def _least_distance(named: list[tuple[str, Vec2]]) -> tuple[float, str]:
    pairs = [(math.dist(a[1], b[1]), f"{a[0]} and {b[0]}") for a, b in combinations(named, 2)]
    return min(pairs, default=(math.inf, ""))


def _pads(settings: Settings) -> CheckRow:
    """Least distance between landing places of two UAVs at one site."""
    s = settings.separation
    distance, who = _least_distance([(u.id, u.pad_offset_m) for u in settings.uavs])
    if math.isinf(distance):
        return CheckRow("pads apart", GROUP, Verdict.PASS, None, "m", s.horizontal_m, "one UAV has every pad to itself")
    return at_least(
        "pads apart",
        GROUP,
        distance,
        "m",
        warn=s.horizontal_m + s.buffer_m - 1e-6,
        fail=s.horizontal_m - 1e-6,
        text=f"the pads of {who} lie {distance:.3g} m apart",
        remedy=f"set arena.pad_spacing_m to {s.horizontal_m + s.buffer_m:g} m or more: holding cannot resolve this",
    )


def _parking(settings: Settings) -> CheckRow:
    """Least distance between stopping places of two UGVs at one site."""
    least = settings.separation.ugv_m
    distance, who = _least_distance([(g.id, g.park_offset_m) for g in settings.ugvs])
    if math.isinf(distance):
        text = "at most one UGV parks anywhere"
        return CheckRow("parking apart", GROUP, Verdict.PASS, None, "m", least, text)
    return at_least(
        "parking apart",
        GROUP,
        distance,
        "m",
        warn=least - 1e-6,
        fail=least - 1e-6,
        text=f"the parking places of {who} lie {distance:.3g} m apart",
        remedy=f"set arena.parking_spacing_m to {least:g} m or more: holding cannot resolve this",
    )


def _layers(settings: Settings) -> CheckRow:
    """Altitude layers: below the ceiling, apart, and one for each UAV."""
    fence, s = settings.geofence, settings.separation
    altitudes = sorted({u.altitude_m for u in settings.uavs})
    room = fence.ceiling_m - altitudes[-1]
    gap = min((b - a for a, b in pairwise(altitudes)), default=math.inf)
    shared = len(settings.uavs) - len(altitudes)
    spread = f"{len(altitudes)} layer{'s' if len(altitudes) > 1 else ''} for {len(settings.uavs)} UAVs"
    if room < 0:
        text = f"the highest layer, {altitudes[-1]:g} m, is {-room:.3g} m above the ceiling; lower arena.layers"
        return CheckRow("layers", GROUP, Verdict.FAIL, room, "m", 0.0, text)
    if gap < s.vertical_m - 1e-6:
        text = f"two layers are {gap:.3g} m apart, closer than separation.vertical_m; widen arena.layers.spacing_m"
        return CheckRow("layers", GROUP, Verdict.FAIL, gap, "m", s.vertical_m, text)
    if room < fence.soft_margin_m:
        text = f"the highest layer is {room:.3g} m below the ceiling, within its soft margin; lower arena.layers"
        return CheckRow("layers", GROUP, Verdict.WARN, room, "m", fence.soft_margin_m, text)
    if shared:
        text = f"{spread}: {shared} must share, and hold more often; lower the spacing or raise the ceiling"
        return CheckRow("layers", GROUP, Verdict.WARN, float(len(altitudes)), "layers", float(len(settings.uavs)), text)
    text = f"{spread}, the highest {room:.3g} m below the ceiling"
    return CheckRow("layers", GROUP, Verdict.PASS, room, "m", fence.soft_margin_m, text)


def _speeds(settings: Settings) -> CheckRow:
    """Largest share of its speed limit that a vehicle uses, and whether planner and supervisor mean the same speed."""
    flown: list[UavSettings | UgvSettings] = [*settings.uavs, *settings.ugvs]
    planned = [u.speed_mps for u in settings.problem.uavs] + [g.speed_mps for g in settings.problem.ugvs]
    for f, speed in zip(flown, planned, strict=True):
        arena = settings.frame.speed_to_arena(speed)
        if abs(arena - f.speed_mps) > 0.01 * f.speed_mps:
            text = (
                f"{f.id} is planned at {arena:.3g} m/s in the arena but flown at {f.speed_mps:.3g} m/s; "
                "no time of the schedule would hold: correct its speed or the time scale"
            )
            return CheckRow("speeds", GROUP, Verdict.FAIL, arena, "m/s", f.speed_mps, text)
    share, who = max((f.speed_mps / f.max_speed_mps, f.id) for f in flown)
    return at_most(
        "speeds",
        GROUP,
        share,
        "of limit",
        warn=1.0 + 1e-9,
        fail=1.0 + 1e-9,
        text=f"{who} uses {100 * share:.3g} % of its speed limit",
        remedy="the gate would refuse it: lower its speed or raise max_speed_mps",
    )
