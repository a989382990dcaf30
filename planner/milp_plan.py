"""Between the exact model and plans: a plan as a hint for the solver, and the solver's answer as a plan."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

import numpy as np

from planner.milp_data import Data
from planner.milp_model import Model
from planner.plan import Action, Move, Recharge, ScheduledAction, Visit


def add_hint(model: Model, actions: Sequence[Action], rows: Sequence[ScheduledAction]) -> None:
    """Tells the solver a plan; recharges beyond those in the model are left out, which makes the hint incomplete."""
    data = model.data
    hints: dict[int, tuple[Any, int]] = {}  # circuits share literals with slots: one hint each

    def hint(variable: Any, value: int) -> None:
        if variable.index >= 0:  # no negation
            hints[variable.index] = (variable, value)

    number = {task: k for k, task in enumerate(data.tasks)}
    n, s = len(data.tasks), data.n_sites
    chosen: dict[tuple[int, int], set[tuple[int, int]]] = defaultdict(set)  # arcs by UAV and trip
    trip = dict.fromkeys(data.uav_ids, 0)
    node = dict.fromkeys(data.uav_ids, 0)
    site = {g: _site(data, g) for g in data.ugv_ids}
    used: dict[tuple[int, int], tuple[int, int, int]] = {}  # site, UGV, row
    for i, act in enumerate(actions):
        if isinstance(act, Move):
            site[act.ugv] = data.problem.depot_index if act.path_point is None else act.path_point
        elif isinstance(act, Visit):
            chosen[act.uav, trip[act.uav]].add((node[act.uav], number[act.task] + 1))
            node[act.uav] = number[act.task] + 1
        else:
            u, p = act.uav, site[act.ugv]
            if trip[u] >= len(model.uavs[u].slots):
                return
            chosen[u, trip[u]] |= {(node[u], n + 1 + s + p), (n + 1 + s + p, 0)}
            used[u, trip[u]] = (p, act.ugv, i)
            trip[u] += 1
            node[u] = n + 1 + p
            chosen[u, trip[u]].add((0, node[u]))
    for u in data.uav_ids:
        if node[u]:
            chosen[u, trip[u]].add((node[u], 0))
        for one in model.uavs[u].trips:
            arcs = chosen[u, one.number]
            flown = {a for a, _ in arcs}
            for (a, b), literal in one.arcs.items():
                hint(literal, (a, b) in arcs if a != b else a not in flown)
        for slot in model.uavs[u].slots:
            where = used.get((u, slot.number))
            hint(slot.used, where is not None)
            for p, literal in enumerate(slot.at):
                hint(literal, where is not None and where[0] == p)
            for g, literal in slot.by.items():
                hint(literal, where is not None and where[1] == g)
            if where is not None:
                hint(slot.work, int(rows[where[2]].work_s * 1000.0))
                hint(slot.end, int(rows[where[2]].end_s * 1000.0))
    for variable, value in hints.values():
        model.model.add_hint(variable, value)


def _site(data: Data, g: int) -> int:
    ugv = data.problem.ugvs[g]
    return data.problem.depot_index if ugv.path_point is None else ugv.path_point


def read_plan(model: Model, solver: Any) -> list[Action]:
    """The solver's answer as actions, in an order in which everything can happen."""
    data = model.data
    stops: dict[int, list[tuple[int, int, int]]] = {g: [] for g in data.ugv_ids}  # begin, site, slot
    for i, slot in enumerate(model.slots):
        if solver.boolean_value(slot.used):
            p = next(p for p, x in enumerate(slot.at) if solver.boolean_value(x))
            g = next(g for g, x in slot.by.items() if solver.boolean_value(x))
            stops[g].append((solver.value(slot.work), p, i))
    events: list[tuple[int, int, Action]] = []  # time, rank among those at one time
    doing: dict[int, Recharge] = {}
    for g, mine in stops.items():
        ugv = data.problem.ugvs[g]
        at = None if ugv.distance_to_m is not None else _site(data, g)
        leave = int(max([ugv.ready_s, *ugv.dock_ready_s]) * 1000.0)
        for begin, p, i in sorted(mine):
            slot = model.slots[i]
            if p != at:
                events += [(leave, 0, move) for move in _moves(data, g, at, p)]
                at = p
            doing[i] = Recharge(slot.uav, g)
            events.append((begin, 1, doing[i]))
            leave = max(leave, solver.value(slot.end))
    for u, uav in model.uavs.items():
        clock = int(data.problem.uavs[u].ready_s * 1000.0)
        for trip in uav.trips:
            nexts = {a: b for (a, b), x in trip.arcs.items() if a != b and solver.boolean_value(x)}
            times = {(a, b): t for (a, b), t in trip.lengths.items()}
            a = 0
            while a in nexts:
                b = nexts[a]
                clock += times.get((a, b), 0)
                if 1 <= b <= len(data.tasks):
                    events.append((clock, 2, Visit(u, data.tasks[b - 1])))
                a = b
                if a == 0:
                    break
            if trip.number < len(uav.slots) and solver.boolean_value(uav.slots[trip.number].used):
                clock = solver.value(uav.slots[trip.number].end)
    return [act for _, _, act in sorted(events, key=lambda e: e[:2])]


def _moves(data: Data, g: int, start: int | None, end: int) -> list[Action]:
    """The drive to site ``end``; by way of other sites where the problem's own distance is longer than that."""
    road = np.array(data.problem.road_distance_m)
    ugv = data.problem.ugvs[g]
    if start is None:
        row = np.array(ugv.distance_to_m)
        via = int((row + data.road_m[:, end]).argmin())
        way = [via] if row[end] > row[via] + data.road_m[via, end] + 0.01 else [end]
    else:
        way = []
    at = way[-1] if way else start
    assert at is not None
    while at != end:
        hops = road[at] + data.road_m[:, end]
        hops[at] = np.inf
        at = end if road[at, end] <= hops.min() + 0.01 else int(hops.argmin())
        way.append(at)
    return [Move(g, None if p == data.problem.depot_index else p) for p in way]
