"""Methods ``gls``, ``ts`` and ``sa``: the paper's metaheuristic baselines, as that literature uses OR-Tools.

Two levels. First the UGVs' route is fixed (``planner.baseline_stops``). Then the UAVs are routed around one stop after
the other by OR-Tools (``planner.baseline_routing``) with guided local search, tabu search or simulated annealing. At
each stop the UAVs meet their UGV and are filled up, visit the tasks nearest to that stop with as many recharges there
as they need, and can reach the next stop at the end. The published scheme has one UAV; here the model has as many
vehicles as UAVs follow the UGV. The evaluator decodes the plans as it does everybody's: UAVs wait only for their UGV.

With option ``meet: false`` UAVs go on from where they are with what energy they have, and the UGV leaves out stops at
which nobody recharges: better than published where the team needs few recharges. With ``every_site: true`` the UGVs
stop at every path point that is nearest to a task.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from planner.arrays import arrays_of
from planner.baseline_routing import Around, Start, route
from planner.baseline_stops import Group, make_groups
from planner.errors import PlannerError
from planner.order import canonical
from planner.plan import Action, Move, Plan, Recharge, Visit
from planner.problem import Problem
from planner.schedule import evaluate
from planner.search import Options as SearchOptions
from planner.solve import Method, Params, Result, Stop

METAHEURISTICS = {"gls": "GUIDED_LOCAL_SEARCH", "ts": "TABU_SEARCH", "sa": "SIMULATED_ANNEALING"}
LEAST_S = 0.02  # of one routing model


@dataclass(frozen=True, slots=True)
class Options:
    """Options of the baselines.

    Attributes:
        solve_s: seconds for the model of each stop, as published, instead of a share of the time for all.
        meet: UAVs are filled up whenever their team comes to a stop; without, the model says where they need it.
        every_site: UGVs tour the path points nearest to tasks, instead of as few stops as possible.
        exclude_uavs: indices of UAVs that get no action and need no recovery.
        exclude_ugvs: indices of UGVs that get no action.
    """

    solve_s: float | None = None
    meet: bool = True
    every_site: bool = False
    exclude_uavs: frozenset[int] = frozenset()
    exclude_ugvs: frozenset[int] = frozenset()


def baseline(name: str) -> Method:
    """The method ``gls``, ``ts`` or ``sa``."""

    def method(problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
        return _plan(name, problem, stop, params)

    return method


def _plan(name: str, problem: Problem, stop: Stop, params: Params) -> Result:
    """Plans; ``stop.time_s`` is shared among the stops by their tasks, ``iterations`` limits solutions per stop.

    Option ``solve_s`` gives every stop's model that many seconds instead, as published (15). OR-Tools' metaheuristics
    take no seed, and a plan to start from is of no use to them.

    Raises:
        PlannerError: for an unknown option.
    """
    given = read_options(name, params.options)
    actions: list[Action] = []
    groups = make_groups(problem, given.exclude_uavs, given.exclude_ugvs, every_site=given.every_site)
    weight = sum(1 + len(tasks) for group in groups for tasks in group.tasks)
    solved = 0
    for group in groups:
        for k in range(len(group.stops)):
            limit_s = given.solve_s
            if limit_s is None and stop.time_s is not None:
                limit_s = max(LEAST_S, stop.time_s * (1 + len(group.tasks[k])) / weight)
            actions += _stop_actions(
                problem, actions, group, k, METAHEURISTICS[name], limit_s, stop.iterations, given.meet
            )
            solved += 1
    ordered = canonical(problem, actions)
    schedule = evaluate(problem, ordered, exclude_uavs=given.exclude_uavs, exclude_ugvs=given.exclude_ugvs)
    return Result(Plan(ordered, schedule, name), solved, 0.0)


def read_options(name: str, options: Mapping[str, Any]) -> Options:
    """Reads ``Params.options`` of the baseline ``name``.

    Raises:
        PlannerError: for an unknown option or a wrong value.
    """
    known = [f.name for f in fields(Options)]
    if unknown := sorted(set(options) - {*known, "allow_partial"}):
        raise PlannerError(f"method {name!r} has no option {unknown[0]!r}; there are {', '.join(known)}")
    value = options.get("solve_s")
    if value is not None and (type(value) not in (int, float) or not 0 < value < float("inf")):
        raise PlannerError(f"option solve_s is {value!r}; give a number of seconds above 0")
    for key in ("meet", "every_site", "allow_partial"):
        if not isinstance(options.get(key, True), bool):
            raise PlannerError(f"option {key} is {options[key]!r}; give true or false")
    # Leaving out what does not fit is what they do anyhow.
    rest = {k: v for k, v in options.items() if k != "allow_partial"}
    teams = SearchOptions.read({k: v for k, v in options.items() if k in ("exclude_uavs", "exclude_ugvs")})
    return Options(**{**rest, "exclude_uavs": teams.exclude_uavs, "exclude_ugvs": teams.exclude_ugvs})


def _stop_actions(
    problem: Problem,
    before: list[Action],
    group: Group,
    k: int,
    metaheuristic: str,
    limit_s: float | None,
    solutions: int | None,
    meet: bool,
) -> list[Action]:
    """What ``group`` does at its stop ``k``, after all actions ``before``."""
    if not group.tasks[k] or not group.uavs:
        return []
    sites = problem.sites
    made: list[Action] = []
    place, there_s, here = None, 0.0, False
    if group.ugv is not None:
        site = group.stops[k]
        place = _point(sites[site])
        there_s, here = _arrival(problem, before, group.ugv, site)
        drive = [] if here else [Move(group.ugv, None if site == problem.depot_index else site)]
        if meet and not here:
            first = sorted(group.uavs, key=lambda u: (_state(problem, before, u).time_s, u))
            made, drive = [*drive, *(Recharge(u, group.ugv) for u in first)], []
    starts = tuple(_state(problem, [*before, *made], u) for u in group.uavs)
    following = next((j for j in range(k + 1, len(group.stops)) if group.tasks[j]), None)
    next_stop = None if following is None else _point(sites[group.stops[following]])
    around = Around(starts, group.tasks[k], place, group.ugv or 0, there_s, next_stop)
    routes = route(problem, around, metaheuristic, limit_s, solutions)
    if routes is None:
        return made
    if group.ugv is not None and any(node is None for nodes in routes for node in nodes):
        made += drive
    return made + _merge(problem, [*before, *made], group, [s.uav for s in starts], routes)


def _merge(
    problem: Problem, before: list[Action], group: Group, uavs: list[int], routes: list[list[int | None]]
) -> list[Action]:
    """The routes as one list: whoever is free first acts next, so that docks are taken in order of arrival."""
    made: list[Action] = []
    left = {u: list(nodes) for u, nodes in zip(uavs, routes, strict=True)}
    while any(left.values()):
        free = {u: _state(problem, [*before, *made], u).time_s for u in uavs if left[u]}
        u = min(free, key=lambda u: (free[u], u))
        node = left[u].pop(0)
        if node is not None:
            made.append(Visit(u, node))
        elif left[u] or group.ugv is not None:
            assert group.ugv is not None
            made.append(Recharge(u, group.ugv))
    return made


def _state(problem: Problem, actions: list[Action], u: int) -> Start:
    """Where UAV ``u`` is after the actions."""
    uav = problem.uavs[u]
    site = {g: int(s) for g, s in enumerate(arrays_of(problem).site0.tolist())}
    at, last = (float(uav.position[0]), float(uav.position[1])), None
    for i, act in enumerate(actions):
        if isinstance(act, Move):
            site[act.ugv] = problem.depot_index if act.path_point is None else act.path_point
        elif act.uav == u:
            at = _point(problem.tasks[act.task] if isinstance(act, Visit) else problem.sites[site[act.ugv]])
            last = i
    if last is None:
        return Start(u, at, uav.ready_s, uav.energy_j)
    row = evaluate(problem, actions).actions[last]
    return Start(u, at, row.end_s, row.energy_end_j)


def _arrival(problem: Problem, actions: list[Action], g: int, site: int) -> tuple[float, bool]:
    """When UGV ``g`` can be at ``site``, and whether it is there already."""
    a, ugv = arrays_of(problem), problem.ugvs[g]
    here = int(a.site0[g])
    for act in actions:
        if isinstance(act, Move) and act.ugv == g:
            here = problem.depot_index if act.path_point is None else act.path_point
    if here == site:
        rows = zip(actions, evaluate(problem, actions).actions, strict=True)
        moved = [row.end_s for act, row in rows if isinstance(act, Move) and act.ugv == g]
        return max([ugv.ready_s, *moved]), True
    trial = [*actions, Move(g, None if site == problem.depot_index else site)]
    return evaluate(problem, trial).actions[-1].end_s, False


def _point(xy: Any) -> tuple[float, float]:
    return float(xy[0]), float(xy[1])
