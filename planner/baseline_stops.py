"""The baselines' first level: where UGVs stop, in which order, and which tasks belong to which stop.

A set cover picks the fewest stops such that every task is within half a UAV's range of one; each UGV drives its stops
by a shortest tour. This is decided before any UAV is routed and never revised: it is what "fixed UGV path" means.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from ortools.sat.python import cp_model

from planner.arrays import arrays_of
from planner.problem import Problem

COVER_S = 5.0  # limit of the set cover; it takes milliseconds
EXACT_STOPS = 12
INF = float("inf")
STOP_COST = 10**7  # fewer stops come first, then the distance from tasks to stops in m


@dataclass(frozen=True, slots=True)
class Group:
    """One UGV (None: no UGV at all), its stops in order, and the UAVs that follow it.

    Attributes:
        stops: sites; the first may be where the UGV stands.
        tasks: for each stop, the tasks that are nearest to it.
    """

    ugv: int | None
    uavs: tuple[int, ...]
    stops: tuple[int, ...]
    tasks: tuple[tuple[int, ...], ...]


def make_groups(
    problem: Problem,
    exclude_uavs: Collection[int] = (),
    exclude_ugvs: Collection[int] = (),
    *,
    every_site: bool = False,
) -> list[Group]:
    """Stops, tours and tasks of all UGVs; UAVs are shared out evenly.

    Args:
        problem: the problem.
        exclude_uavs: indices of UAVs that take no part.
        exclude_ugvs: indices of UGVs that take no part.
        every_site: stop at every path point that is the nearest one to a task, instead of at the fewest.
    """
    a = arrays_of(problem)
    uavs = [u for u in range(len(problem.uavs)) if u not in exclude_uavs]
    ugvs = [g for g in range(len(problem.ugvs)) if g not in exclude_ugvs]
    todo = [int(m) for m in np.flatnonzero(~problem.visited)]
    if not uavs or not todo:
        return []
    if not ugvs:
        return [Group(None, tuple(uavs), (problem.depot_index,), (tuple(todo),))]
    away = a.dist[: problem.n_tasks, problem.n_tasks : problem.n_tasks + len(problem.sites)][todo]  # (tasks, sites)
    if every_site:
        chosen = sorted(set(away.argmin(axis=1).tolist()))
    else:
        chosen = _cover(problem, ugvs, away, _half_range_m(problem, uavs))
    nearest = [chosen[int(i)] for i in away[:, chosen].argmin(axis=1)]
    served = {p: tuple(m for m, q in zip(todo, nearest, strict=True) if q == p) for p in chosen}
    speed = problem.uavs[uavs[0]].speed_mps
    work = {p: 2.0 * float(sum(a.dist[m, problem.n_tasks + p] for m in served[p])) / speed for p in chosen}
    shares = {g: tuple(uavs[k :: len(ugvs)]) for k, g in enumerate(ugvs)}
    routes = _tours(problem, chosen, work, {g: max(1, len(mine)) for g, mine in shares.items()})
    return [Group(g, shares[g], routes[g], tuple(served[p] for p in routes[g])) for g in ugvs]


def _half_range_m(problem: Problem, uavs: list[int]) -> float:
    ranges = []
    for u in (problem.uavs[i] for i in uavs):
        usable = u.capacity_j - u.reserve_j - u.hover_w * u.service_s
        ranges.append(0.5 * usable / u.cruise_w * u.speed_mps)
    return min(ranges)


def _cover(problem: Problem, ugvs: list[int], away: NDArray[np.float64], reach_m: float) -> list[int]:
    """The fewest stops within ``reach_m`` of every task, then the nearest ones; at least one a UGV.

    Sites at which a UGV stands already cost no stop. A task out of reach of all sites does not count.
    """
    n_tasks, n_sites = away.shape
    free = {int(arrays_of(problem).site0[g]) for g in ugvs}
    m = cp_model.CpModel()
    stop = [m.new_bool_var("") for _ in range(n_sites)]
    costs = [(0 if p in free else STOP_COST) * stop[p] for p in range(n_sites)]
    for k in range(n_tasks):
        near = [p for p in range(n_sites) if away[k, p] <= reach_m]
        mine = {p: m.new_bool_var("") for p in near or range(n_sites)}
        m.add_exactly_one(mine.values())
        for p, literal in mine.items():
            m.add_implication(literal, stop[p])
            costs.append(round(float(away[k, p])) * literal)
    m.add(sum(stop) >= min(len(ugvs), n_sites))
    m.minimize(sum(costs))
    solver = cp_model.CpSolver()
    solver.parameters.num_workers = 1
    solver.parameters.max_time_in_seconds = COVER_S
    status = solver.solve(m)
    assert status in (cp_model.OPTIMAL, cp_model.FEASIBLE)
    return [p for p in range(n_sites) if solver.boolean_value(stop[p])]


def _tours(
    problem: Problem, stops: list[int], work_s: dict[int, float], crew: dict[int, int]
) -> dict[int, tuple[int, ...]]:
    """Shares the stops among the UGVs and orders each share by a shortest open tour.

    The share is the one with the least longest (drive + flying of the UGV's UAVs); every UGV gets a stop where there
    are enough. Exact for up to two UGVs and ``EXACT_STOPS`` stops, else by cheapest insertion.
    """
    ugvs = list(crew)
    speed = {g: problem.ugvs[g].speed_mps for g in ugvs}
    if len(ugvs) > 2 or len(stops) > EXACT_STOPS:
        return _insertion(problem, stops, work_s, crew)
    tours = {g: _all_tours(problem, g, stops) for g in ugvs}
    every = (1 << len(stops)) - 1
    flying = [sum(work_s[p] for k, p in enumerate(stops) if mask >> k & 1) for mask in range(every + 1)]
    if len(ugvs) == 1:
        return {ugvs[0]: tours[ugvs[0]][every][1]}
    best: tuple[float, int] | None = None
    for mask in range(every + 1):
        if len(stops) >= 2 and mask in (0, every):
            continue
        times = [
            tours[g][part][0] / speed[g] + flying[part] / crew[g]
            for g, part in zip(ugvs, (mask, every ^ mask), strict=True)
        ]
        value = max(times) + 1e-3 * sum(times)
        if best is None or value < best[0]:
            best = (value, mask)
    assert best is not None
    return {g: tours[g][part][1] for g, part in zip(ugvs, (best[1], every ^ best[1]), strict=True)}


def _first_m(problem: Problem, g: int) -> list[float]:
    """Road distance of UGV ``g`` to each site from where it is; 0 where it is already."""
    a = arrays_of(problem)
    start = int(a.site0[g])
    return [0.0 if start == p else float(x) for p, x in enumerate(a.road[start])]


def _all_tours(problem: Problem, g: int, stops: list[int]) -> list[tuple[float, tuple[int, ...]]]:
    """Length in m and order of the shortest open tour of every set of stops, by bit mask (Held and Karp 1962)."""
    first, road = _first_m(problem, g), problem.road_distance_m.tolist()
    n = len(stops)
    cost = [[INF] * n for _ in range(1 << n)]
    before = [[-1] * n for _ in range(1 << n)]
    tours: list[tuple[float, tuple[int, ...]]] = [(0.0, ())]
    for mask in range(1, 1 << n):
        mine = [k for k in range(n) if mask >> k & 1]
        for k in mine:
            rest = mask ^ (1 << k)
            if rest == 0:
                cost[mask][k] = first[stops[k]]
                continue
            for j in mine:
                if j != k and cost[rest][j] + road[stops[j]][stops[k]] < cost[mask][k]:
                    cost[mask][k] = cost[rest][j] + road[stops[j]][stops[k]]
                    before[mask][k] = j
        last = min(mine, key=lambda k: cost[mask][k])
        length, order, left, at = cost[mask][last], [], mask, last
        while at >= 0:
            order.append(stops[at])
            left, at = left ^ (1 << at), before[left][at]
        tours.append((length, tuple(reversed(order))))
    return tours


def _insertion(
    problem: Problem, stops: list[int], work_s: dict[int, float], crew: dict[int, int]
) -> dict[int, tuple[int, ...]]:
    """Stop by stop, the one with most work first, where the longest time grows least."""
    road: list[list[float]] = problem.road_distance_m.tolist()
    routes: dict[int, list[int]] = {g: [] for g in crew}

    def time_s(g: int, route: list[int]) -> float:
        drive = _first_m(problem, g)[route[0]] if route else 0.0
        drive += sum(road[a][b] for a, b in pairwise(route))
        return drive / problem.ugvs[g].speed_mps + sum(work_s[p] for p in route) / crew[g]

    for p in sorted(stops, key=lambda p: -work_s[p]):
        trials = [(g, [*route[:i], p, *route[i:]]) for g, route in routes.items() for i in range(len(route) + 1)]
        g, route = min(trials, key=lambda t: (time_s(*t), t[0]))
        routes[g] = route
    return {g: tuple(route) for g, route in routes.items()}
