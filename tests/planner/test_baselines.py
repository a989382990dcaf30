"""Methods ``gls``, ``ts``, ``sa``: the published scheme, fairly done."""

from __future__ import annotations

import time

import numpy as np
import pytest
from reference import Reference

from planner.baseline_routing import Around, Start, route
from planner.baseline_stops import make_groups
from planner.errors import PlannerError
from planner.instances import DATA_SETS, data_set
from planner.midway import midway
from planner.plan import Move, Recharge, Visit
from planner.presets import preset, random_roads
from planner.problem import Problem, Uav, Ugv
from planner.solve import Params, Stop, solve

NAMES = ("gls", "ts", "sa")


@pytest.mark.parametrize("one", DATA_SETS[:4], ids=lambda d: d.name)
def test_stops_cover_all_tasks_by_the_fewest(one) -> None:
    problem = one.instance(800)
    groups = make_groups(problem)
    assert [g.ugv for g in groups] == list(range(one.team[1]))
    assert sorted(u for g in groups for u in g.uavs) == list(range(one.team[0]))
    assert sorted(m for g in groups for tasks in g.tasks for m in tasks) == list(range(15))
    stops = [p for g in groups for p in g.stops]
    assert len(set(stops)) == len(stops)
    away = np.linalg.norm(problem.tasks[:, None] - problem.sites[None], axis=2)
    for g in groups:
        for p, tasks in zip(g.stops, g.tasks, strict=True):
            assert (away[list(tasks), p] <= 7_244.0).all()
            assert (away[list(tasks), p] <= away[list(tasks)][:, stops].min(axis=1) + 1e-9).all()
    extra = [p for p in stops if p != problem.depot_index]
    for p in extra:  # no stop could be left out
        rest = [q for q in [*stops, problem.depot_index] if q != p]
        assert len(extra) <= len(problem.ugvs) or (away[:, rest].min(axis=1) > 7_243.0).any()


def test_a_tour_of_all_path_points_is_shortest() -> None:
    problem = data_set("T15-P5_1-1").instance(801)
    (group,) = make_groups(problem, every_site=True)
    road = problem.road_distance_m
    from itertools import pairwise, permutations  # noqa: PLC0415

    def length(order: tuple[int, ...]) -> float:
        return float(road[problem.depot_index, order[0]] + sum(road[a, b] for a, b in pairwise(order)))

    assert length(group.stops) == pytest.approx(min(length(o) for o in permutations(group.stops)))


def test_two_ugvs_share_the_stops_evenly() -> None:
    problem = data_set("T45-P10_4-2").instance(800)
    begun = time.perf_counter()
    groups = make_groups(problem, every_site=True)
    assert time.perf_counter() - begun < 3.0
    assert all(g.stops for g in groups)
    counts = [sum(len(tasks) for tasks in g.tasks) for g in groups]
    assert sum(counts) == 45 and min(counts) >= 10


def test_many_ugvs_and_stops() -> None:
    sites, road = random_roads(16, np.random.default_rng(3))
    tasks = sites[:-1] + 100.0
    team = tuple(Uav(f"u{i}", (5000.0, 0.0)) for i in range(4)), tuple(Ugv(f"g{i}") for i in range(3))
    problem = Problem((5000.0, 0.0), tasks, sites[:-1], road, *team)
    groups = make_groups(problem, every_site=True)
    assert sorted(m for g in groups for tasks in g.tasks for m in tasks) == list(range(16))
    assert solve(problem, Stop(time_s=0.5), 0, Params("gls")).plan.feasible


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    "options",
    [{}, *(pytest.param(o, marks=pytest.mark.slow) for o in ({"meet": False}, {"every_site": True}))],
    ids=str,
)
def test_plans_are_feasible_and_as_described(name: str, options: dict) -> None:
    for team in ("1-1", "2-2"):
        problem = data_set(f"T15-P5_{team}").instance(800)
        plan = solve(problem, Stop(time_s=0.8), 0, Params(name, options=options)).plan
        assert plan.feasible, plan.schedule.violation
        assert Reference(problem, list(plan.actions)).violation() is None
        groups = make_groups(problem, every_site=options.get("every_site", False))
        for g in groups:
            driven = [problem.depot_index if a.path_point is None else a.path_point
                      for a in plan.actions if isinstance(a, Move) and a.ugv == g.ugv]  # fmt: skip
            kept = [p for p in g.stops if p in driven]
            assert driven == kept  # the fixed path, in its order
            for u in g.uavs:
                assert {a.ugv for a in plan.actions if isinstance(a, Recharge) and a.uav == u} <= {g.ugv}


def test_the_routing_model_knows_energy_and_time() -> None:
    """Two tasks in opposite directions, each near the end of the range: a recharge between is needed, and is enough."""
    problem = Problem(
        (0, 0), [(6_000.0, 0.0), (-6_000.0, 0.0)], [], [[0.0]], (Uav("u", (0, 0)),), (Ugv("g"),)
    )  # fmt: skip
    starts = (Start(0, (0.0, 0.0), 0.0, 287_700.0),)
    around = Around(starts, (0, 1), (0.0, 0.0), 0, 0.0, (0.0, 0.0))
    routes = route(problem, around, "GUIDED_LOCAL_SEARCH", 0.3, None)
    assert routes in ([[0, None, 1]], [[1, None, 0]])
    late = Around(starts, (0, 1), (0.0, 0.0), 0, 5_000.0, (0.0, 0.0))
    plan = solve(problem, Stop(time_s=0.3), 0, Params("ts")).plan
    assert plan.feasible and plan.makespan_s == pytest.approx(600 + 600 + 300 + 600)
    assert route(problem, late, "TABU_SEARCH", 0.3, None) in ([[0, None, 1]], [[1, None, 0]])
    weak = (Start(0, (0.0, 0.0), 0.0, 100_000.0),)
    first = route(problem, Around(weak, (0, 1), (0.0, 0.0), 0, 0.0, None), "TABU_SEARCH", 0.3, None)
    assert first is not None and first[0][0] is None  # it cannot go anywhere before it is charged


def test_several_uavs_share_the_tasks() -> None:
    problem = preset("T15-P5", (2, 1), 1)
    plan = solve(problem, Stop(time_s=1.0), 0, Params("gls")).plan
    assert {a.uav for a in plan.actions if isinstance(a, Visit)} == {0, 1}


def test_infeasible_is_stated() -> None:
    problem = Problem((0, 0), [(30_000.0, 0.0), (100.0, 0.0)], [], [[0.0]], (Uav("u", (0, 0)),), (Ugv("g"),))
    plan = solve(problem, Stop(time_s=0.3), 0, Params("gls")).plan
    assert not plan.feasible and plan.schedule.violation == "task 0 is not visited"
    alone = Problem((0, 0), [(3_000.0, 0.0), (100.0, 0.0)], [], [[0.0]], (Uav("u", (0, 0)),), ())
    assert solve(alone, Stop(time_s=0.3), 0, Params("sa")).plan.feasible


def test_lost_vehicles_get_no_action() -> None:
    problem = preset("T15-P5", (4, 2), 1)
    options = {"exclude_uavs": (0, 2), "exclude_ugvs": {1}, "allow_partial": True}
    plan = solve(problem, Stop(time_s=0.8), 0, Params("ts", options=options)).plan
    assert plan.feasible
    assert Reference(problem, list(plan.actions), no_uavs=(0, 2), no_ugvs=(1,)).violation() is None
    nobody = solve(problem, Stop(time_s=0.5), 0, Params("ts", options={"exclude_uavs": (0, 1, 2, 3)})).plan
    assert nobody.actions == ()
    alone = solve(problem, Stop(time_s=0.5), 0, Params("ts", options={"exclude_ugvs": (0, 1)})).plan
    assert not any(isinstance(a, Recharge | Move) for a in alone.actions)


@pytest.mark.parametrize("team", ["2-1", "4-2"])
def test_mid_mission_states(team: str) -> None:
    for index in range(3):
        later, _ = midway(data_set(f"T15-P5_{team}").instance(index), index)
        plan = solve(later, Stop(time_s=0.5), 0, Params("gls")).plan
        ref = Reference(later, list(plan.actions)).violation()
        assert (ref is None) == plan.feasible


@pytest.mark.slow
def test_time_limits_are_kept() -> None:
    problem = data_set("T45-P10_4-2").instance(800)
    result = solve(problem, Stop(time_s=2.0), 0, Params("gls"))
    assert result.time_s < 3.5
    assert result.iterations >= 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hot": 1}, "method 'gls' has no option 'hot'; there are solve_s, meet"),
        ({"solve_s": 0}, "option solve_s is 0; give a number of seconds above 0"),
        ({"meet": 1}, "option meet is 1; give true or false"),
    ],
)
def test_wrong_options(options: dict, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        solve(preset("T15-P5"), Stop(iterations=1), 0, Params("gls", options=options))
