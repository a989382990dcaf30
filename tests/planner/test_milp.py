"""Method ``milp``: its optima against trying everything, its bounds against what other methods find."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from brute import Brute
from ortools.sat.python import cp_model
from reference import Reference

from planner.errors import PlannerError
from planner.instances import DataSet
from planner.midway import midway
from planner.milp_data import Data
from planner.milp_model import Model
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate
from planner.solve import Params, Stop, solve


def tiny(seed: int, kind: str) -> Problem:
    """Two or three tasks, one or two path points: small enough to try everything, tight enough to need recharges."""
    rng = np.random.default_rng([seed, len(kind)])
    n_uavs, n_ugvs = ((1, 1), (2, 1), (2, 2), (1, 2))[seed % 4]
    n_tasks, n_points = 3 if n_uavs + n_ugvs < 4 else 2, int(rng.integers(1, 3))
    points = rng.uniform(0, 8_000, (n_points, 2))
    sites = np.vstack([points, [4_000.0, 0.0]])
    road = 1.2 * np.linalg.norm(sites[:, None] - sites[None], axis=2)
    tasks = rng.uniform(0, 8_000, (n_tasks, 2))
    uav = {"capacity_j": 200e3, "energy_j": 200e3}
    ugv: dict[str, object] = {"docks": int(rng.integers(1, 3))}
    if kind == "hover":
        uav |= {"waiting": "hover", "service_s": 10.0, "reserve_j": 10e3}
        ugv |= {"dock_s": 10.0, "undock_s": 5.0}
    elif kind == "power":
        ugv |= {"charge_s": None, "charge_w": 900.0, "dock_s": 20.0}
    elif kind == "poor":
        ugv |= {"energy_j": 3.2e6, "idle_w": 50.0}
    problem = Problem(
        (4_000.0, 0.0),
        tasks,
        points,
        road,
        tuple(Uav(f"uav{i}", (4_000.0, 0.0), **uav) for i in range(n_uavs)),
        tuple(Ugv(f"ugv{i}", **ugv) for i in range(n_ugvs)),
    )
    if kind == "midway":
        used = [float(rng.uniform(0.4, 0.9)) * 200e3 for _ in problem.uavs]
        uavs = tuple(
            replace(u, energy_j=e, ready_s=float(rng.integers(0, 2) * 80), position=tuple(rng.uniform(2e3, 6e3, 2)))
            for u, e in zip(problem.uavs, used, strict=True)
        )
        ugvs = list(problem.ugvs)
        ugvs[0] = replace(ugvs[0], distance_to_m=tuple(rng.uniform(500, 5000, len(sites))), position=(1.0, 1.0))
        ugvs[-1] = replace(ugvs[-1], dock_ready_s=(150.0,), ready_s=30.0)
        problem = replace(problem, uavs=uavs, ugvs=tuple(ugvs))
    return problem


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "kind", ["landed", *(pytest.param(kind, marks=SLOW) for kind in ("hover", "power", "poor", "midway"))]
)
def test_optima_are_those_of_trying_everything(kind: str) -> None:
    proven = feasible = recharged = 0
    for seed in (0, 1, 4, 6, 7) if kind == "power" else range(8):
        problem = tiny(seed, kind)
        plan = solve(problem, Stop(iterations=10_000), seed, Params("milp")).plan
        brute = Brute(problem, recharges=3 if len(problem.uavs) + len(problem.ugvs) < 4 else 2)
        if brute.actions is None:
            assert not plan.feasible or sum(type(a).__name__ == "Recharge" for a in plan.actions) > 2
            continue
        feasible += 1
        recharged += len(brute.actions) > problem.n_tasks
        ref = Reference(problem, brute.actions)
        if kind != "poor":  # which trying everything does not look at
            assert ref.violation() is None
        elif ref.violation() is not None:
            continue
        assert ref.makespan == pytest.approx(brute.best)
        assert plan.feasible, (seed, plan.schedule.violation)
        assert plan.lower_bound_s is not None
        assert plan.lower_bound_s <= brute.best + 1e-6, (seed, plan.lower_bound_s, brute.best)
        if plan.gap == 0.0:
            proven += 1
            assert plan.makespan_s == pytest.approx(brute.best, abs=0.03), seed
        assert Reference(problem, list(plan.actions)).violation() is None
    assert feasible >= 4 and recharged >= 2
    assert proven >= (3 if kind in ("power", "poor") else 5)


def seven(team: tuple[int, int], index: int, n_tasks: int = 7) -> Problem:
    problem = DataSet("T15-P5", team).instance(index)
    return replace(problem, tasks=problem.tasks[:n_tasks], visited=problem.visited[:n_tasks])


@pytest.mark.parametrize("team", [(1, 1), (2, 1), (2, 2)])
def test_seven_tasks_are_proven_in_seconds(team: tuple[int, int]) -> None:
    for index in (0, 16):
        problem = seven(team, index)
        plan = solve(problem, Stop(time_s=60.0), 0, Params("milp", options={"start_s": 0.3})).plan
        assert plan.gap == 0.0 and plan.lower_bound_s == plan.makespan_s
        assert Reference(problem, list(plan.actions)).violation() is None
        assert plan.planning_s is not None and plan.planning_s < 60.0
        best = solve(problem, Stop(iterations=20_000), 1).plan
        assert best.makespan_s >= plan.makespan_s - 0.03


@SLOW
def test_the_solver_agrees_with_itself_without_presolve() -> None:
    """OR-Tools 9.15 called some of these infeasible until one step of its presolve was switched off."""
    for index in (3, 12):
        problem = seven((1, 1), index)
        limit = solve(problem, Stop(iterations=50_000), 1).plan.makespan_s
        data = Data.of(problem, (), (), limit)
        slots = {0: data.most_recharges(0) or 0}
        found = []
        for presolve in (True, False):
            solver = cp_model.CpSolver()
            solver.parameters.num_workers = 1
            solver.parameters.cp_model_presolve = presolve
            solver.parameters.presolve_inclusion_work_limit = 0
            assert solver.solve(Model(data, slots).model) == cp_model.OPTIMAL
            found.append(solver.objective_value)
        assert found[0] == found[1]


def test_time_up_is_told_honestly() -> None:
    problem = DataSet("T15-P5", (2, 1)).instance(800)
    plan = solve(problem, Stop(iterations=4_000), 0, Params("milp")).plan
    assert plan.feasible and plan.lower_bound_s is not None
    assert 0.0 < plan.lower_bound_s < plan.makespan_s
    assert plan.gap is not None and 0.0 < plan.gap < 1.0
    assert plan.to_json()["lower_bound_s"] == plan.lower_bound_s
    again = solve(problem, Stop(iterations=4_000), 0, Params("milp")).plan
    assert again.actions == plan.actions and again.lower_bound_s == plan.lower_bound_s
    known = solve(problem, Stop(iterations=60_000), 3).plan
    assert plan.lower_bound_s <= known.makespan_s
    warm = solve(problem, Stop(iterations=1_000), 0, Params("milp", start=known.actions)).plan
    assert warm.makespan_s <= known.makespan_s + 1e-6


def test_mid_mission_states_are_proven_too() -> None:
    for index in range(3):
        later, rest = midway(seven((2, 2), index), index)
        plan = solve(later, Stop(iterations=20_000), 0, Params("milp", start=rest)).plan
        assert plan.feasible and plan.gap == 0.0
        assert plan.makespan_s <= evaluate(later, rest).makespan_s + 1e-6


def test_lost_vehicles_get_no_action() -> None:
    problem = seven((2, 2), 6, 5)
    options = {"exclude_uavs": {0}, "exclude_ugvs": {1}}
    plan = solve(problem, Stop(iterations=20_000), 0, Params("milp", options=options)).plan
    assert plan.feasible and plan.gap is not None
    assert Reference(problem, list(plan.actions), no_uavs=(0,), no_ugvs=(1,)).violation() is None
    alone = replace(problem, uavs=problem.uavs[1:], ugvs=problem.ugvs[:1])
    same = solve(alone, Stop(iterations=20_000), 0, Params("milp")).plan
    assert plan.gap == same.gap == 0.0 and plan.makespan_s == pytest.approx(same.makespan_s, abs=0.03)


def test_roads_that_are_longer_than_a_detour() -> None:
    """UGVs drive by way of another site where that is shorter than the matrix's own entry."""
    far = 20_000.0
    road = [[0.0, 2_000.0, far], [2_000.0, 0.0, 2_000.0], [far, 2_000.0, 0.0]]
    uav = Uav("uav0", (0.0, 0.0))
    problem = Problem(
        (0, 0), [(8_000.0, 0.0), (12_000.0, 0.0)], [(8_000.0, 500.0), (4_000.0, 0.0)], road, [uav], [Ugv("g")]
    )
    plan = solve(problem, Stop(iterations=20_000), 0, Params("milp")).plan
    assert plan.feasible and plan.gap == 0.0


def test_nothing_to_do_and_nothing_possible() -> None:
    problem = seven((1, 1), 0)
    done = replace(problem, visited=np.ones(7, bool))
    plan = solve(done, Stop(iterations=100), 0, Params("milp")).plan
    assert plan.feasible and plan.actions == () and plan.gap == 0.0
    far = replace(problem, tasks=np.array([[90_000.0, 0.0]]), visited=np.zeros(1, bool), ugvs=())
    plan = solve(far, Stop(iterations=100), 0, Params("milp")).plan
    assert not plan.feasible and plan.lower_bound_s is None and plan.gap is None
    both = replace(far, tasks=np.array([[90_000.0, 0.0], [5_000.0, 900.0]]), visited=np.zeros(2, bool))
    plan = solve(both, Stop(iterations=1_000), 0, Params("milp", options={"allow_partial": True})).plan
    assert plan.schedule.violation == "task 0 is not visited" and plan.lower_bound_s is None


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"threads": 2}, "method 'milp' has no option 'threads'; there are exclude_uavs"),
        ({"workers": 0}, "option workers is 0; give a whole number of at least 1"),
        ({"start_s": -1}, "option start_s is -1; give a number of seconds above 0"),
        ({"exclude_uavs": 3}, "option exclude_uavs is 3"),
    ],
)
def test_wrong_options(options: dict, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        solve(seven((1, 1), 0), Stop(iterations=1), 0, Params("milp", options=options))
