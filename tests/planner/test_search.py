"""Method ``search``: feasible, deterministic, replannable, honest about what it cannot do."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference import Reference
from strategies import problems

from planner import search_kernel
from planner.errors import PlannerError
from planner.order import canonical
from planner.plan import Move, Recharge, Visit
from planner.presets import PRESETS, TEAMS, preset
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate
from planner.solve import Params, Stop, solve

HOVER = {"waiting": "hover", "reserve_j": 0.15 * 287_700.0}


def check(problem: Problem, plan, no_uavs=(), no_ugvs=()) -> None:
    """The plan's own word against the independent evaluator's."""
    ref = Reference(problem, list(plan.actions), no_uavs=tuple(no_uavs), no_ugvs=tuple(no_ugvs))
    assert (ref.violation() is None) == plan.feasible
    assert ref.makespan == pytest.approx(plan.makespan_s)
    assert plan.actions == canonical(problem, plan.actions)


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize("team", TEAMS)
def test_presets_are_solved_well_within_moments(name: str, team: tuple[int, int]) -> None:
    for seed in (0, 1):
        problem = preset(name, team, seed)
        start = solve(problem, Stop(iterations=0)).plan
        better = solve(problem, Stop(iterations=30_000), seed).plan
        for plan in (start, better):
            assert plan.feasible, plan.schedule.violation
            check(problem, plan)
        assert better.makespan_s < 0.8 * start.makespan_s


@pytest.mark.parametrize("team", TEAMS)
def test_hovering_and_reserve(team: tuple[int, int]) -> None:
    for seed in (1, 2, 7):
        problem = preset("T15-P5", team, seed, uav=HOVER)
        plan = solve(problem, Stop(iterations=60_000), seed).plan
        assert plan.feasible, plan.schedule.violation
        check(problem, plan)


def test_same_seed_and_iterations_give_the_same_plan() -> None:
    problem = preset("T15-P5", (2, 2))
    first, second = (solve(problem, Stop(iterations=20_000), 5) for _ in range(2))
    assert first.plan.actions == second.plan.actions
    assert first.plan.digest == second.plan.digest
    assert first.iterations == second.iterations == 20_000
    same_numbers = Problem.from_json(problem.to_json())
    assert solve(same_numbers, Stop(iterations=20_000), 5).plan.actions == first.plan.actions


def test_budgets_are_kept() -> None:
    problem = preset("T15-P5", (2, 2))
    begun = time.perf_counter()
    result = solve(problem, Stop(time_s=0.1))
    assert time.perf_counter() - begun < 1.0
    assert result.iterations > 0
    assert result.plan.method == "search"
    assert result.plan.planning_s == result.time_s > 0.0
    assert result.plan.lower_bound_s is None
    assert solve(problem, Stop(iterations=3_000, time_s=60.0)).iterations == 3_000
    assert solve(problem, Stop(iterations=10**9, time_s=0.05)).iterations < 10**9


def test_driving_may_count() -> None:
    """With a price on driving, UGVs drive less, and what counts then is less than for the shortest plans."""
    short, thrifty = [], []
    for seed in range(3):
        problem = preset("T15-P5", (2, 2), seed)
        for price, found in ((0.0, short), (0.5, thrifty)):
            plan = solve(problem, Stop(iterations=100_000), 1, Params("search", options={"drive": price})).plan
            check(problem, plan)
            assert plan.feasible
            driven_s = plan.schedule.ugv_energy_j / problem.ugvs[0].drive_w  # standing is free
            found.append((plan.makespan_s, driven_s, plan.makespan_s + 0.5 * driven_s))
    assert all(b[2] < a[2] + 1e-6 for a, b in zip(short, thrifty, strict=True))
    assert sum(b[1] for b in thrifty) < 0.9 * sum(a[1] for a in short)


def test_no_useless_action_is_left() -> None:
    problem = preset("T15-P5", (2, 2), 1)
    plan = solve(problem, Stop(iterations=30_000)).plan
    for i, act in enumerate(plan.actions):
        if not isinstance(act, Visit):
            rest = evaluate(problem, plan.actions[:i] + plan.actions[i + 1 :])
            assert not rest.feasible or rest.makespan_s > plan.makespan_s - 1.0


def test_warm_start_is_never_worse() -> None:
    problem = preset("T15-P5", (2, 2), 3)
    good = solve(problem, Stop(iterations=30_000)).plan
    again = solve(problem, Stop(iterations=2_000), 1, Params(start=good.actions)).plan
    assert again.feasible
    assert again.makespan_s <= good.makespan_s + 1.0
    unchanged = solve(problem, Stop(iterations=0), 1, Params(start=good.actions)).plan
    assert unchanged.actions == good.actions


def test_warm_start_is_repaired() -> None:
    problem = preset("T15-P5", (2, 2), 3)
    good = solve(problem, Stop(iterations=30_000)).plan
    visits = [a for a in good.actions if isinstance(a, Visit)]
    broken = [visits[0], visits[0], *(a for a in good.actions if a != visits[1])]
    visited = np.zeros(problem.n_tasks, bool)
    visited[visits[2].task] = True
    later = replace(problem, visited=visited)
    plan = solve(later, Stop(iterations=0), 0, Params(start=broken)).plan
    assert plan.feasible, plan.schedule.violation
    assert visits[2].task not in {a.task for a in plan.actions if isinstance(a, Visit)}


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problems(max_tasks=6, fresh=False), st.booleans())
def test_any_state_can_be_replanned(problem: Problem, partial: bool) -> None:
    plan = solve(problem, Stop(iterations=4_000), 1, Params(options={"allow_partial": partial})).plan
    check(problem, plan)
    if not partial and not plan.feasible:
        alone = solve(problem, Stop(iterations=4_000), 1, Params(options={"allow_partial": True})).plan
        assert not alone.feasible or alone.makespan_s > 0.0
    if partial and not plan.feasible:
        idle = evaluate(problem, [])
        if idle.violation is None or "not visited" in idle.violation:  # nobody is lost already
            assert plan.schedule.violation is not None and "not visited" in plan.schedule.violation


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.sampled_from([(1, 1), (2, 1), (2, 2), (4, 2)]), st.integers(0, 50), st.floats(0.05, 0.95), st.integers(0, 99))
def test_a_mission_can_be_replanned_at_any_moment(team: tuple[int, int], seed: int, share: float, other: int) -> None:
    """Where the rest of the plan is still possible, the search finds a feasible plan as well."""
    problem = preset("T15-P5", team, seed)
    plan = solve(problem, Stop(iterations=8_000), seed).plan
    assert plan.feasible
    later, rest = cut(problem, plan, share * plan.makespan_s)
    follow = evaluate(later, rest)
    assert follow.feasible, follow.violation
    cold = solve(later, Stop(iterations=20_000), other).plan
    warm = solve(later, Stop(iterations=2_000), other, Params(start=rest)).plan
    check(later, warm)
    assert warm.feasible and warm.makespan_s <= follow.makespan_s + 1.0
    check(later, cold)
    assert cold.feasible, cold.schedule.violation


def cut(problem: Problem, plan, now: float) -> tuple[Problem, list]:
    """The state after all actions that have begun by ``now`` have ended, and the actions that are left."""
    rows = plan.schedule.actions
    begun = [r.start_s <= now for r in rows]
    # A recharge that is under way needs its UGV's moves before it, too.
    for i, act in enumerate(plan.actions):
        if isinstance(act, Recharge) and begun[i]:
            for j in range(i):
                other = plan.actions[j]
                if isinstance(other, Move | Recharge) and other.ugv == act.ugv:
                    begun[j] = True
    for i in range(len(rows) - 1, -1, -1):  # and whatever the same UAV did before
        act = plan.actions[i]
        if begun[i] and not isinstance(act, Move):
            for j in range(i):
                if getattr(plan.actions[j], "uav", None) == act.uav:
                    begun[j] = True
    uavs, ugvs = list(problem.uavs), list(problem.ugvs)
    visited = problem.visited.copy()
    docks = [[0.0] * g.docks for g in ugvs]
    here = [g.path_point for g in ugvs]
    for i, act in enumerate(plan.actions):
        r = rows[i]
        if not begun[i]:
            continue
        if isinstance(act, Move):
            here[act.ugv] = act.path_point
            ugvs[act.ugv] = replace(ugvs[act.ugv], path_point=act.path_point, ready_s=r.end_s)
        elif isinstance(act, Visit):
            visited[act.task] = True
            at = tuple(map(float, problem.tasks[act.task]))
            uavs[act.uav] = replace(uavs[act.uav], position=at, energy_j=r.energy_end_j, ready_s=r.end_s)
        else:
            site = problem.depot_index if here[act.ugv] is None else here[act.ugv]
            at = tuple(map(float, problem.sites[site]))
            uavs[act.uav] = replace(uavs[act.uav], position=at, energy_j=r.energy_end_j, ready_s=r.end_s)
            docks[act.ugv][r.dock] = max(docks[act.ugv][r.dock], r.end_s)
    ugvs = [replace(g, dock_ready_s=tuple(d)) for g, d in zip(ugvs, docks, strict=True)]
    later = replace(problem, uavs=tuple(uavs), ugvs=tuple(ugvs), visited=visited)
    return later, [a for i, a in enumerate(plan.actions) if not begun[i]]


# ---- what cannot be done


def far(n_far: int = 1, **more) -> Problem:
    """Two tasks nearby, and ``n_far`` out of reach of a UAV that flies 14 km."""
    tasks = [(1000.0, 0.0), (0.0, 2000.0)] + [(30_000.0, 1000.0 * i) for i in range(n_far)]
    return Problem((0, 0), tasks, [], [[0.0]], (Uav("uav0", (0, 0)), Uav("uav1", (0, 0))), (Ugv("ugv0"),), **more)


def test_infeasible_problem_is_reported_in_words() -> None:
    plan = solve(far(), Stop(iterations=3_000)).plan
    assert not plan.feasible
    assert "short" in (plan.schedule.violation or "")
    check(far(), plan)


def test_partial_plan_leaves_out_what_cannot_be_served() -> None:
    plan = solve(far(2), Stop(iterations=3_000), 0, Params(options={"allow_partial": True})).plan
    assert plan.schedule.violation == "tasks 2, 3 are not visited"
    assert plan.makespan_s == pytest.approx(200.0)  # one UAV each


def test_lost_vehicles_get_no_action() -> None:
    problem = preset("T15-P5", (4, 2), 1)
    options = {"exclude_uavs": {0, 2}, "exclude_ugvs": [1]}
    plan = solve(problem, Stop(iterations=20_000), 0, Params(options=options)).plan
    assert plan.feasible
    check(problem, plan, (0, 2), (1,))
    assert {a.uav for a in plan.actions if not isinstance(a, Move)} <= {1, 3}
    assert {a.ugv for a in plan.actions if not isinstance(a, Visit)} <= {0}
    start = solve(problem, Stop(iterations=5_000)).plan.actions
    assert solve(problem, Stop(iterations=20_000), 0, Params(start=start, options=options)).plan.feasible


def test_nobody_left() -> None:
    params = Params(options={"exclude_uavs": {0, 1}, "allow_partial": True})
    plan = solve(far(), Stop(iterations=1_000), 0, params).plan
    assert plan.actions == ()
    assert plan.schedule.violation == "tasks 0, 1, 2 are not visited"


def test_no_ugv_at_all() -> None:
    problem = replace(far(0), ugvs=())
    assert solve(problem, Stop(iterations=1_000)).plan.feasible
    problem = preset("T15-P5", (1, 1), 0)
    params = Params(options={"exclude_ugvs": {0}, "allow_partial": True})
    plan = solve(problem, Stop(iterations=20_000), 0, params).plan
    assert "not visited" in (plan.schedule.violation or "")
    assert len(plan.actions) >= 3


def test_nothing_to_do() -> None:
    problem = far(visited=[True, True, True])
    result = solve(problem, Stop(time_s=5.0))
    assert result.plan.feasible and result.plan.actions == () and result.iterations == 0
    assert solve(replace(far(0), tasks=[], visited=[]), Stop(time_s=5.0)).plan.feasible


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"exlude_uavs": {0}}, "method 'search' has no option 'exlude_uavs'; there are allow_partial"),
        ({"exclude_uavs": 3}, "option exclude_uavs is 3; give a set of indices"),
        ({"exclude_ugvs": ["0"]}, "option exclude_ugvs is .*; give a set of indices"),
        ({"exclude_uavs": {9}}, "excluded uav 9 does not exist; there are 2"),
        ({"allow_partial": 1}, "option allow_partial is 1; give true or false"),
        ({"hot": 0}, "option hot is 0; give a number above 0"),
        ({"cold": "x"}, "option cold is 'x'; give a number above 0"),
        ({"ruin": 1.0}, "option ruin is 1.0; give a number above 0 and below 1"),
        ({"drive": -1}, "option drive is -1; give a number, 0 or above"),
        ({"drive": float("nan")}, "option drive is nan; give a number, 0 or above"),
        ({"workers": 0}, "option workers is 0; give a whole number from 1 to 64"),
        ({"workers": True}, "option workers is True; give a whole number from 1 to 64"),
    ],
)
def test_wrong_options(options: dict, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        solve(far(), Stop(iterations=1), 0, Params(options=options))


def test_start_that_names_nothing_is_bad_input() -> None:
    with pytest.raises(PlannerError, match="task 99 does not exist"):
        solve(far(), Stop(iterations=1), 0, Params(start=[Visit(0, 99)]))


def test_random_numbers_are_uniform() -> None:
    rng = np.array([12345], dtype=np.uint64)
    draws = np.array([search_kernel.uniform(rng) for _ in range(4000)])
    assert draws.min() >= 0.0 and draws.max() < 1.0
    assert abs(draws.mean() - 0.5) < 0.02
    assert abs(np.corrcoef(draws[:-1], draws[1:])[0, 1]) < 0.05
