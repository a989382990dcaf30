"""Method ``milp``: the exact method. Warm-started by the search, solved by CP-SAT, with a proven lower bound.

The model is in ``planner.milp_model``; what HiGHS did instead is told in docs/benchmark.md.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ortools.sat.python import cp_model

from planner.errors import PlannerError
from planner.milp_data import MAX_RECHARGES, MS, Data
from planner.milp_model import Model
from planner.milp_plan import add_hint, read_plan
from planner.order import canonical
from planner.plan import Plan, Recharge
from planner.problem import Problem
from planner.schedule import evaluate
from planner.search import Options as SearchOptions
from planner.search import search
from planner.solve import Params, Result, Stop

ROUNDING_S = 0.02  # times in the model are rounded down to ms; a bound that close to the plan is the plan
START_SHARE, START_S = 0.15, 2.0  # the search gets this share of the time, at most these seconds
START_STEPS = 20_000  # its steps where only iterations are given
STEP_WORK = 1e-4  # and one iteration is that much of the solver's deterministic time (about a second per unit)


@dataclass(frozen=True, slots=True)
class Options:
    """Options of method ``milp``.

    Attributes:
        exclude_uavs: indices of UAVs that get no action and need no recovery.
        exclude_ugvs: indices of UGVs that get no action.
        allow_partial: where no plan visits every task, the search's best that leaves some out, without a bound.
        workers: threads of the solver. With one and a budget of iterations, the same seed gives the same plan.
        start_s: seconds for the search that gives the first plan; None is a share of the time.
    """

    exclude_uavs: frozenset[int] = frozenset()
    exclude_ugvs: frozenset[int] = frozenset()
    allow_partial: bool = False
    workers: int = 1
    start_s: float | None = None

    @classmethod
    def read(cls, options: Mapping[str, Any]) -> Options:
        """Reads ``Params.options``.

        Raises:
            PlannerError: for an unknown option or a wrong value.
        """
        known = ("exclude_uavs", "exclude_ugvs", "allow_partial", "workers", "start_s")
        if unknown := sorted(set(options) - set(known)):
            raise PlannerError(f"method 'milp' has no option {unknown[0]!r}; there are {', '.join(known)}")
        teams = SearchOptions.read({k: v for k, v in options.items() if k in known[:3]})
        workers, start_s = options.get("workers", 1), options.get("start_s")
        if type(workers) is not int or workers < 1:
            raise PlannerError(f"option workers is {workers!r}; give a whole number of at least 1")
        if start_s is not None and (type(start_s) not in (int, float) or not start_s > 0):
            raise PlannerError(f"option start_s is {start_s!r}; give a number of seconds above 0")
        return cls(teams.exclude_uavs, teams.exclude_ugvs, teams.allow_partial, workers, start_s)


def milp(problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
    """Plans and proves: the plan's ``lower_bound_s`` holds for every feasible plan.

    Where it is the makespan (to within ``ROUNDING_S``), the plan is optimal.

    Raises:
        PlannerError: for an unknown option, or a start that names something that does not exist.
    """
    begun = time.perf_counter()
    options = Options.read(params.options)
    teams = {"exclude_uavs": options.exclude_uavs, "exclude_ugvs": options.exclude_ugvs}
    given = {**teams, "allow_partial": options.allow_partial}
    first = search(problem, _start_stop(stop, options), seed, Params("search", params.start, given))
    plan = first.plan
    if options.allow_partial and not plan.feasible:
        return first
    data = Data.of(
        problem, options.exclude_uavs, options.exclude_ugvs, plan.makespan_s if plan.feasible else float("inf")
    )
    if not data.tasks or not data.uav_ids:
        return Result(Plan(plan.actions, plan.schedule, "milp", None, 0.0 if plan.feasible else None), 0, 0.0)
    most = {u: data.most_recharges(u) for u in data.uav_ids}
    used = Counter(a.uav for a in plan.actions if isinstance(a, Recharge))
    slots = {u: min(_or(most[u], MAX_RECHARGES), MAX_RECHARGES, max(2, used[u] + 1)) for u in data.uav_ids}
    bound_s = float(data.soonest_ms().max()) / MS  # holds whatever the solver manages
    possible = True
    while True:
        more = {u for u in data.uav_ids if slots[u] != most[u]}
        model = Model(data, slots, more)
        if plan.feasible:
            add_hint(model, plan.actions, plan.schedule.actions)
        solver = _solver(stop, seed, options, time.perf_counter() - begun)
        status = solver.solve(model.model)
        if status == cp_model.INFEASIBLE and plan.feasible:  # there is a plan: the presolve is wrong again
            solver = _solver(stop, seed, options, time.perf_counter() - begun)
            solver.parameters.cp_model_presolve = False
            status = solver.solve(model.model)
        if status == cp_model.MODEL_INVALID:
            raise AssertionError(f"the model is wrong: {model.model.validate()}")
        if status == cp_model.INFEASIBLE:
            possible = False
            break
        bound_s = max(bound_s, solver.best_objective_bound / MS)
        if status == cp_model.UNKNOWN:
            break
        actions = canonical(problem, read_plan(model, solver))
        schedule = evaluate(problem, actions, **teams)
        if schedule.feasible and (not plan.feasible or schedule.makespan_s < plan.makespan_s - 1e-6):
            plan = Plan(actions, schedule, "milp")
        if plan.feasible and plan.makespan_s - bound_s <= ROUNDING_S:
            break
        longer = {u for u in more if solver.value(model.uavs[u].extra) > 0 and slots[u] < MAX_RECHARGES}
        late = stop.time_s is not None and time.perf_counter() - begun > 0.9 * stop.time_s
        if status != cp_model.OPTIMAL or not longer or late:
            break
        for u in longer:
            slots[u] += 1
    if plan.feasible:
        bound_s = min(bound_s, plan.makespan_s)
        if plan.makespan_s - bound_s <= ROUNDING_S:
            bound_s = plan.makespan_s
    bound = bound_s if plan.feasible or possible else None
    return Result(Plan(plan.actions, plan.schedule, "milp", None, bound), first.iterations, 0.0)


def _or(value: int | None, other: int) -> int:
    return other if value is None else value


def _start_stop(stop: Stop, options: Options) -> Stop:
    steps = None if stop.iterations is None else min(stop.iterations, START_STEPS)
    if options.start_s is not None:
        return Stop(options.start_s, steps)
    seconds = None if stop.time_s is None else min(START_SHARE * stop.time_s, START_S)
    return Stop(seconds, steps)


def _solver(stop: Stop, seed: int, options: Options, used_s: float) -> cp_model.CpSolver:
    solver = cp_model.CpSolver()
    given = solver.parameters
    given.num_workers = options.workers
    given.random_seed = seed % (1 << 31)
    # Presolve by inclusion of constraints is wrong in OR-Tools 9.15: it calls some of these models infeasible that are
    # not. Without it, presolve agreed with no presolve at all wherever both were tried (tests/planner/test_milp.py).
    given.presolve_inclusion_work_limit = 0
    if stop.time_s is not None:
        given.max_time_in_seconds = max(0.01, stop.time_s - used_s)
    if stop.iterations is not None:
        given.max_deterministic_time = STEP_WORK * stop.iterations
    return solver
