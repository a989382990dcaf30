"""The baselines' second level: the UAVs' routes around one stop, as an OR-Tools routing model."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil
from typing import Any

from ortools.constraint_solver import pywrapcp, routing_enums_pb2

from planner.problem import Point, Problem

TASK_PENALTY = 10**9  # of a task left out
SPAN_COST = 100  # of a second of makespan, a flown second costs 1
LATEST_S = 10**6
FIRST = routing_enums_pb2.FirstSolutionStrategy
# As published. From its first plan, guided local search and simulated annealing often never find room for all tasks (a
# task and the recharge for it would have to come in at once), so a share of the time goes to the others where tasks are
# left out.
STRATEGIES = (FIRST.PATH_MOST_CONSTRAINED_ARC, FIRST.PARALLEL_CHEAPEST_INSERTION, FIRST.PATH_CHEAPEST_ARC)


@dataclass(frozen=True, slots=True)
class Start:
    """A UAV before the routes: where, when and with which energy."""

    uav: int
    at: Point
    time_s: float
    energy_j: float


@dataclass(frozen=True, slots=True)
class Around:
    """One routing problem.

    Attributes:
        starts: the UAVs.
        tasks: to visit.
        stop: where they recharge; None: nowhere.
        ugv: whose recharges.
        ugv_there_s: when it is at the stop.
        next_stop: where the routes must be able to end; None: at any site, and the flight there takes no time.
    """

    starts: tuple[Start, ...]
    tasks: tuple[int, ...]
    stop: Point | None
    ugv: int
    ugv_there_s: float
    next_stop: Point | None


def route(
    problem: Problem, around: Around, metaheuristic: str, limit_s: float | None, solutions: int | None
) -> list[list[int | None]] | None:
    """For each UAV, tasks in order with None for a recharge; tasks may be left out. None where no plan was found.

    Args:
        problem: the problem.
        around: what to route.
        metaheuristic: name in OR-Tools' ``LocalSearchMetaheuristic``.
        limit_s: time limit.
        solutions: limit of accepted solutions, which does not depend on the clock.
    """
    model = _Routes(problem, around)
    published, *others = STRATEGIES
    best = model.solve(published, metaheuristic, _share(limit_s, 0.6), solutions)
    if best is not None and best.cost < TASK_PENALTY:
        best = model.solve(published, metaheuristic, _share(limit_s, 0.4), solutions, best) or best
        return best.routes
    for strategy in others:
        found = _Routes(problem, around).solve(strategy, metaheuristic, _share(limit_s, 0.2), solutions)
        if found is not None and (best is None or found.cost < best.cost):
            best = found
    return best.routes if best is not None else None


def _share(limit_s: float | None, share: float) -> float | None:
    return None if limit_s is None else share * limit_s


@dataclass(frozen=True, slots=True)
class Found:
    """What a search found: its cost in the model, the routes, and the assignment to go on from."""

    cost: int
    routes: list[list[int | None]]
    assignment: Any


class _Routes:
    """The model; UAVs of one group are taken to be alike.

    Nodes: tasks, then copies of the stop for recharging, then each UAV's start, then the common end.
    """

    def __init__(self, problem: Problem, around: Around) -> None:
        self.problem, self.around = problem, around
        self.n_tasks, n_uavs = len(around.tasks), len(around.starts)
        uav = problem.uavs[around.starts[0].uav]
        self.uav = uav
        self.points: list[Point] = [(float(x), float(y)) for x, y in problem.tasks[list(around.tasks)]]
        self.copies = 0
        if around.stop is not None:
            flown = sum(2.0 * _distance(p, around.stop) for p in self.points) * uav.cruise_w / uav.speed_mps
            usable = max(1.0, uav.capacity_j - uav.reserve_j)
            self.copies = min(self.n_tasks, ceil(flown / usable)) + n_uavs + 1
            self.points += [around.stop] * self.copies
        self.end = self.n_tasks + self.copies + n_uavs
        starts = [self.n_tasks + self.copies + i for i in range(n_uavs)]
        self.points += [s.at for s in around.starts]
        self.manager = pywrapcp.RoutingIndexManager(self.end + 1, n_uavs, starts, [self.end] * n_uavs)
        self.routing = pywrapcp.RoutingModel(self.manager)
        self._time()
        self._energy()
        for node in range(self.n_tasks):
            self.routing.AddDisjunction([self.manager.NodeToIndex(node)], TASK_PENALTY)
        for node in self._recharges():
            self.routing.AddDisjunction([self.manager.NodeToIndex(node)], 0)

    def _recharges(self) -> range:
        return range(self.n_tasks, self.n_tasks + self.copies)

    def _metres(self, i: int, j: int) -> float:
        """Between nodes; the flight to the end is the recovery where no stop follows."""
        if j != self.end:
            return _distance(self.points[i], self.points[j])
        if self.around.next_stop is not None:
            return _distance(self.points[i], self.around.next_stop)
        return min(_distance(self.points[i], (float(x), float(y))) for x, y in self.problem.sites)

    def _time(self) -> None:
        uav, routing, manager = self.uav, self.routing, self.manager
        size = self.end + 1
        charge = 0.0
        if self.copies:
            ugv = self.problem.ugvs[self.around.ugv]
            whole = (uav.capacity_j - uav.reserve_j) / ugv.charge_w if ugv.charge_w else 0.0
            charge = ugv.dock_s + ugv.undock_s + (ugv.charge_s or 0.0) + 0.8 * whole
        table = [[0] * size for _ in range(size)]
        for i in range(size - 1):
            there = uav.service_s if i < self.n_tasks else charge if i in self._recharges() else 0.0
            for j in range(size):
                fly = self._metres(i, j) / uav.speed_mps if j != self.end or self.around.next_stop else 0.0
                table[i][j] = round(there + fly)
        transit = routing.RegisterTransitMatrix(table)
        routing.SetArcCostEvaluatorOfAllVehicles(transit)
        routing.AddDimension(transit, LATEST_S, LATEST_S, False, "time")
        clock = routing.GetDimensionOrDie("time")
        clock.SetGlobalSpanCostCoefficient(SPAN_COST)
        for v, start in enumerate(self.around.starts):
            at = round(start.time_s)
            clock.CumulVar(routing.Start(v)).SetRange(at, at)
            routing.AddVariableMinimizedByFinalizer(clock.CumulVar(routing.End(v)))
        for node in self._recharges():
            clock.CumulVar(manager.NodeToIndex(node)).SetMin(ceil(self.around.ugv_there_s))

    def _energy(self) -> None:
        """Energy used since the last recharge, in 10 J; leaving a recharge, the slack takes it back to nothing."""
        uav, routing, manager = self.uav, self.routing, self.manager
        full = int((uav.capacity_j - uav.reserve_j) / 10.0)
        size = self.end + 1
        table = [[0] * size for _ in range(size)]
        for i in range(size - 1):
            for j in range(size):
                joules = self._metres(i, j) / uav.speed_mps * uav.cruise_w
                if j < self.n_tasks:
                    joules += uav.hover_w * uav.service_s
                table[i][j] = ceil(joules / 10.0) - (full if i in self._recharges() else 0)
        transit = routing.RegisterTransitMatrix(table)
        routing.AddDimension(transit, full, full, False, "energy")
        energy = routing.GetDimensionOrDie("energy")
        solver = routing.solver()
        for v, start in enumerate(self.around.starts):
            spent = ceil((uav.capacity_j - start.energy_j) / 10.0)
            spent = min(max(spent, 0), full)
            energy.CumulVar(routing.Start(v)).SetRange(spent, spent)
            energy.SlackVar(routing.Start(v)).SetValue(0)
        for node in range(self.n_tasks):
            energy.SlackVar(manager.NodeToIndex(node)).SetValue(0)
        for node in self._recharges():
            index = manager.NodeToIndex(node)
            solver.Add(energy.SlackVar(index) + energy.CumulVar(index) == full)

    def solve(
        self,
        strategy: int,
        metaheuristic: str,
        limit_s: float | None,
        solutions: int | None,
        start: Found | None = None,
    ) -> Found | None:
        """Searches, from ``start`` where that is given; then the answer is at least as good."""
        given: Any = pywrapcp.DefaultRoutingSearchParameters()
        given.first_solution_strategy = strategy
        given.local_search_metaheuristic = getattr(routing_enums_pb2.LocalSearchMetaheuristic, metaheuristic)
        if limit_s is not None:
            given.time_limit.FromMilliseconds(max(1, round(1000.0 * limit_s)))
        if solutions is not None:
            given.solution_limit = max(1, solutions)
        if start is None:
            found = self.routing.SolveWithParameters(given)
        else:
            found = self.routing.SolveFromAssignmentWithParameters(start.assignment, given)
        if found is None or (start is not None and found.ObjectiveValue() > start.cost):
            return start
        routes: list[list[int | None]] = []
        for v in range(len(self.around.starts)):
            nodes: list[int | None] = []
            index = found.Value(self.routing.NextVar(self.routing.Start(v)))
            while not self.routing.IsEnd(index):
                node = self.manager.IndexToNode(index)
                nodes.append(self.around.tasks[node] if node < self.n_tasks else None)
                index = found.Value(self.routing.NextVar(index))
            routes.append(nodes)
        return Found(int(found.ObjectiveValue()), routes, found)


def _distance(a: Point, b: Point) -> float:
    return float(((a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2) ** 0.5)
