"""The baselines' first level: where UGVs stop, in which order, and which tasks belong to which stop.

A set cover picks the fewest stops such that every task is within half a UAV's range of one; each UGV drives its stops
by a shortest tour. This is decided before any UAV is routed and never revised: it is what "fixed UGV path" means.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from ortools.sat.python import cp_model

from planner.arrays import arrays_of
from planner.problem import Problem

COVER_S = 5.0  # limit of the set cover; it takes milliseconds
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


def make_groups(problem: Problem, *, every_site: bool = False) -> list[Group]:
    """Stops, tours and tasks of all UGVs; UAVs are shared out evenly.

    Args:
        problem: the problem.
        every_site: stop at every path point that is the nearest one to a task, instead of at the fewest.
    """
    a = arrays_of(problem)
    n_ugvs = len(problem.ugvs)
    todo = [int(m) for m in np.flatnonzero(~problem.visited)]
    everybody = tuple(range(len(problem.uavs)))
    if n_ugvs == 0:
        return [Group(None, everybody, (problem.depot_index,), (tuple(todo),))]
    away = a.dist[: problem.n_tasks, problem.n_tasks :][todo]  # (tasks, sites) in m
    reach = _half_range_m(problem)
    chosen = sorted(set(away.argmin(axis=1).tolist())) if every_site and todo else _cover(problem, away, reach)
    nearest = [chosen[int(i)] for i in away[:, chosen].argmin(axis=1)] if todo else []
    served = {p: tuple(m for m, q in zip(todo, nearest, strict=True) if q == p) for p in chosen}
    leg_s = {p: 2.0 * float(sum(a.dist[m, problem.n_tasks + p] for m in served[p])) for p in chosen}
    speed = problem.uavs[0].speed_mps
    shares = {g: [u for u in everybody if u % n_ugvs == g] for g in range(n_ugvs)}
    work = {p: leg_s[p] / speed for p in chosen}
    routes = _tours(problem, chosen, work, {g: max(1, len(us)) for g, us in shares.items()})
    groups = []
    for g in range(n_ugvs):
        stops = routes[g]
        groups.append(Group(g, tuple(shares[g]), stops, tuple(served[p] for p in stops)))
    return groups


def _half_range_m(problem: Problem) -> float:
    ranges = []
    for u in problem.uavs:
        usable = u.capacity_j - u.reserve_j - u.hover_w * u.service_s
        ranges.append(0.5 * usable / u.cruise_w * u.speed_mps)
    return min(ranges)


def _cover(problem: Problem, away: NDArray[np.float64], reach_m: float) -> list[int]:
    """The fewest stops within ``reach_m`` of every task, then the nearest ones; at least one a UGV.

    Sites at which a UGV stands already cost no stop. A task out of reach of all sites does not count.
    """
    n_tasks, n_sites = away.shape
    free = {s for s in arrays_of(problem).site0.tolist() if s < n_sites}
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
    m.add(sum(stop) >= min(len(problem.ugvs), n_sites))
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
    """Shares the stops among the UGVs and orders each share by a shortest open tour (exact, Held and Karp).

    The share is the one with the least longest (drive + flying of the UGV's UAVs); every UGV gets a stop where there
    are enough.
    """
    road = arrays_of(problem).road.tolist()
    start = arrays_of(problem).site0.tolist()

    @cache
    def tour(g: int, mine: tuple[int, ...]) -> tuple[float, tuple[int, ...]]:
        best: dict[tuple[frozenset[int], int], tuple[float, tuple[int, ...]]] = {}
        for p in mine:
            best[frozenset([p]), p] = (0.0 if start[g] == p else road[start[g]][p], (p,))
        for size in range(2, len(mine) + 1):
            for subset in combinations(mine, size):
                all_of = frozenset(subset)
                for p in subset:
                    rest = all_of - {p}
                    before = min((best[rest, q][0] + road[q][p], best[rest, q][1]) for q in rest)
                    best[all_of, p] = (before[0], (*before[1], p))
        return min((best[frozenset(mine), p] for p in mine), default=(0.0, ()))

    ugvs = list(crew)
    shares: dict[tuple[tuple[int, ...], ...], float] = {}

    def share(left: tuple[int, ...], k: int, made: tuple[tuple[int, ...], ...]) -> None:
        if k == len(ugvs) - 1:
            whole = (*made, left)
            if len(stops) >= len(ugvs) and not all(whole):
                return
            times = []
            for g, mine in zip(ugvs, whole, strict=True):
                drive = tour(g, mine)[0] / problem.ugvs[g].speed_mps
                times.append(drive + sum(work_s[p] for p in mine) / crew[g])
            shares[whole] = max(times) + 1e-3 * sum(times)
            return
        for size in range(len(left) + 1):
            for mine in combinations(left, size):
                share(tuple(p for p in left if p not in mine), k + 1, (*made, mine))

    share(tuple(stops), 0, ())
    chosen = min(shares, key=lambda w: (shares[w], w))
    return {g: tour(g, mine)[1] for g, mine in zip(ugvs, chosen, strict=True)}
