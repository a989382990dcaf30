"""Mid-mission states: a problem as it stands a while after its plan was begun, and what is left of that plan."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planner.errors import PlannerError
from planner.plan import Action, Move, Recharge, ScheduledAction, Visit
from planner.problem import Point, Problem, Uav, Ugv
from planner.roads import Roads
from planner.schedule import evaluate
from planner.solve import Stop, solve

DRAFT_STEPS = 4_000  # of the search for the plan that a drawn state comes from


def midway(problem: Problem, seed: int, roads: Roads | None = None) -> tuple[Problem, tuple[Action, ...]]:
    """A random mid-mission state: a quickly searched plan of ``problem`` at a random moment before its last visit.

    Returns:
        The problem from then on, and the rest of the plan.

    Raises:
        PlannerError: when no feasible plan is found.
    """
    draft = solve(problem, Stop(iterations=DRAFT_STEPS), seed).plan
    if not draft.feasible:
        raise PlannerError(f"the problem has no plan to be in the middle of: {draft.schedule.violation}")
    share = float(np.random.default_rng([seed, 1]).uniform(0.02, 0.95))
    return state_at(problem, draft.actions, share * draft.makespan_s, roads)


def state_at(
    problem: Problem, actions: Sequence[Action], now_s: float, roads: Roads | None = None
) -> tuple[Problem, tuple[Action, ...]]:
    """The problem at ``now_s`` into the plan, as exact dead reckoning has it.

    UAVs are where they fly, hover, wait or charge; UGVs are on their roads. Times count from ``now_s``. From
    there the rest of the plan ends as foreseen.

    Args:
        problem: the problem at the plan's start.
        actions: a feasible plan.
        now_s: moment from the problem's time 0.
        roads: for the way to other sites of a UGV that is on a road; None: along the road that it is on, to its ends.

    Returns:
        The problem from then on, and the actions that are left.
    """
    rows = evaluate(problem, actions).actions
    uavs, ugvs = list(problem.uavs), list(problem.ugvs)
    visited = problem.visited.copy()
    used_j = [0.0] * len(ugvs)
    driven_s = [0.0] * len(ugvs)
    docks = [[*g.dock_ready_s, *[0.0] * (g.docks - len(g.dock_ready_s))] for g in ugvs]
    site: list[int | None] = [g.path_point for g in ugvs]
    left: list[Action] = []
    for act, row in zip(actions, rows, strict=True):
        if isinstance(act, Move):
            g = ugvs[act.ugv]
            away = row.work_s - row.start_s
            if row.end_s <= now_s:
                ugvs[act.ugv] = replace(g, path_point=act.path_point, distance_to_m=None, position=None)
                driven_s[act.ugv] += away
            else:
                left.append(act)
                if row.start_s < now_s:
                    share = (now_s - row.start_s) / away
                    driven_s[act.ugv] += now_s - row.start_s
                    ugvs[act.ugv] = _on_the_road(problem, g, act.path_point, share, roads)
            site[act.ugv] = act.path_point
            continue
        uav = uavs[act.uav]
        point = problem.tasks[act.task] if isinstance(act, Visit) else problem.sites[_row(problem, site[act.ugv])]
        to = (float(point[0]), float(point[1]))
        if row.start_s > now_s:
            left.append(act)
        elif row.arrive_s > now_s or (isinstance(act, Recharge) and row.work_s > now_s):
            left.append(act)
            uavs[act.uav] = _under_way(uav, to, row, now_s)
        else:
            uavs[act.uav] = replace(uav, position=to, energy_j=row.energy_end_j, ready_s=row.end_s)
            if isinstance(act, Visit):
                visited[act.task] = True
            else:
                used_j[act.ugv] += row.energy_end_j - row.energy_arrive_j
                dock = row.dock or 0
                docks[act.ugv][dock] = max(docks[act.ugv][dock], row.end_s)
    for i, g in enumerate(ugvs):
        stood = max(0.0, now_s - problem.ugvs[i].ready_s - driven_s[i])
        used_j[i] += g.drive_w * driven_s[i] + g.idle_w * stood
        ugvs[i] = replace(
            g,
            energy_j=max(0.0, g.energy_j - used_j[i]),
            ready_s=max(0.0, g.ready_s - now_s),
            dock_ready_s=tuple(max(0.0, d - now_s) for d in docks[i]),
        )
    uavs = [replace(u, ready_s=max(0.0, u.ready_s - now_s)) for u in uavs]
    return replace(problem, uavs=tuple(uavs), ugvs=tuple(ugvs), visited=visited), tuple(left)


def _row(problem: Problem, path_point: int | None) -> int:
    return problem.depot_index if path_point is None else path_point


def _under_way(uav: Uav, to: Point, row: ScheduledAction, now_s: float) -> Uav:
    """On the straight line to ``to``, or waiting there."""
    flown = min(now_s, row.arrive_s) - row.start_s
    share = flown / (row.arrive_s - row.start_s) if row.arrive_s > row.start_s else 1.0
    x, y = (a + share * (b - a) for a, b in zip(uav.position, to, strict=True))
    waited = max(0.0, now_s - row.arrive_s) if uav.waiting == "hover" else 0.0
    energy = row.energy_start_j - uav.cruise_w * flown - uav.hover_w * waited
    return replace(uav, position=(x, y), energy_j=max(0.0, energy), ready_s=now_s)


def _on_the_road(problem: Problem, ugv: Ugv, to: int | None, share: float, roads: Roads | None) -> Ugv:
    """A UGV that has driven that share of the road to ``to``."""
    there = _row(problem, to)
    away = ugv.distance_to_m
    start = problem.depot_index if ugv.path_point is None else ugv.path_point
    before = problem.road_distance_m[start] if away is None else np.array(away)
    whole = float(before[there])
    if roads is not None and away is None:
        line = roads.route((float(problem.sites[start, 0]), float(problem.sites[start, 1])), there)
        point = _along(line, share)
        distance = roads.distances_from(point)
    else:
        # Back the way it came, or on the way it goes: what is certain without a map.
        distance = np.minimum(before + share * whole, problem.road_distance_m[there] + (1.0 - share) * whole)
        at = problem.sites[start] if away is None or ugv.position is None else np.array(ugv.position)
        x, y = at + share * (problem.sites[there] - at)
        point = (float(x), float(y))
    distance = np.array(distance, dtype=np.float64)
    distance[there] = (1.0 - share) * whole
    return replace(ugv, distance_to_m=tuple(float(d) for d in distance), position=point)


def _along(line: np.ndarray[tuple[int, ...], np.dtype[np.float64]], share: float) -> Point:
    """The point at that share of a polyline's length."""
    length = np.r_[0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
    at = share * length[-1]
    x, y = np.interp(at, length, line[:, 0]), np.interp(at, length, line[:, 1])
    assert math.isfinite(x + y)
    return float(x), float(y)
