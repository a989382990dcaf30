"""Routes in outline: every task once, ends that add up, and routes without recharges wherever there are some."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from strategies import problems

from planner import kernel
from planner.arrays import decode
from planner.instances import data_set
from planner.kernel import U_CAPACITY, U_CRUISE, U_HOVER, U_RESERVE, U_SERVICE, U_SPEED
from planner.plan import Visit
from planner.policy import outline_kernel as ok
from planner.policy import tokens_kernel as tk
from planner.policy.outline_kernel import A_CHARGE, A_RECHARGE, SHORT, T_END, T_METRES, alone, outline, short_j
from planner.policy.state import State, new_state
from planner.presets import preset
from planner.problem import Problem
from planner.schedule import evaluate

pytestmark = pytest.mark.slow  # much compiling


def begun(problem: Problem) -> State:
    s = new_state(problem)
    tk.start(s.world, s.work, s.turn)
    return s


def inserted(dist, near, uavs, node, tasks, state) -> list[list[int]]:
    """Farthest insertion in plain words: every place of every route is looked at, every time."""
    routes: list[list[int]] = [[] for _ in uavs]
    metres = [0.0] * len(uavs)

    def end(u: int, way: float, n: int, last: int) -> float:
        return ok._end_s(uavs, near, u, way, n, last)

    left = list(tasks)
    while left:
        best: list[tuple[float, int, int, float]] = []
        for m in left:
            found = (np.inf, 0, 0, 0.0)
            for u, route in enumerate(routes):
                if state[u, T_END] == -np.inf:
                    continue
                stops = [node[u], *route]
                more = [dist[a, m] + dist[m, b] - dist[a, b] for a, b in itertools.pairwise(stops)]
                mine = (end(u, metres[u] + dist[stops[-1], m], len(stops), m), u, len(route), dist[stops[-1], m])
                if more:
                    k = int(np.argmin(more))
                    inside = end(u, metres[u] + more[k], len(stops), route[-1])
                    if inside <= mine[0]:
                        mine = (inside, u, k, more[k])
                if mine[0] < found[0]:
                    found = mine
            best.append(found)
        i = int(np.argmax([x[0] for x in best]))
        _, u, k, more_m = best[i]
        routes[u].insert(k, left[i])
        metres[u] += more_m
        left[i] = left[-1]
        left.pop()
    return routes


@pytest.mark.parametrize("grid_m", [0.0, 1500.0])
def test_insertion_is_that_of_looking_everywhere(grid_m: float) -> None:
    for i, team in enumerate([(1, 1), (2, 1), (4, 2)] * 4):
        problem = preset("T15-P5", team, i)
        if grid_m:  # many places that are equally good
            problem = replace(problem, tasks=np.round(problem.tasks / grid_m) * grid_m)
        s = begun(problem)
        w, o = s.world, s.turn.outline
        outline(w, s.work, s.turn)
        tasks = np.arange(problem.n_tasks, dtype=np.int32)
        o.sizes[:], o.state[:, T_METRES], o.state[:, T_END] = 0, 0.0, s.work.us[:, 0]
        o.state[1:2, T_END] = -np.inf if i % 2 else o.state[1:2, T_END]  # the second takes no part, sometimes
        plain = inserted(w.dist, w.near, o.uavs, s.work.node, tasks.tolist(), o.state)
        ok._insert(w.dist, w.near, o.uavs, s.work.node, tasks, o.routes, o.sizes, o.state)
        assert [o.routes[u, : o.sizes[u]].tolist() for u in range(len(w.uavs))] == plain


@given(problem=problems())
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_every_task_is_in_one_route_and_ends_add_up(problem: Problem) -> None:
    s = begun(problem)
    s.turn.done[1:2] = 1  # the second UAV takes no part any more
    if not (s.turn.done == 0).any():
        return
    w = s.world
    outline(w, s.work, s.turn)
    o = s.turn.outline
    routes = [o.routes[u, : o.sizes[u]].tolist() for u in range(len(w.uavs))]
    assert sorted(itertools.chain(*routes)) == np.flatnonzero(w.visited == 0).tolist()
    for u, route in enumerate(routes):
        if s.turn.done[u]:
            assert not route and o.state[u, T_END] == -np.inf
            continue
        uav = w.uavs[u]
        stops = [s.work.node[u], *route]
        metres = sum(w.dist[a, b] for a, b in itertools.pairwise(stops))
        assert o.state[u, T_METRES] == pytest.approx(metres, abs=1e-6)
        end = s.work.us[u, 0] + metres / uav[U_SPEED] + len(route) * uav[U_SERVICE]
        lacks = -np.inf
        if route:
            fly = (metres + w.near[route[-1]]) / uav[U_SPEED]
            lacks = fly * uav[U_CRUISE] + len(route) * uav[U_SERVICE] * uav[U_HOVER]
            lacks -= s.work.us[u, 1] - uav[U_RESERVE]
            assert short_j(w.near, o.uavs, o.routes, o.sizes, o.state, u) == pytest.approx(lacks, abs=1e-3)
        if lacks > 1e-3:
            end += SHORT * lacks / uav[U_CRUISE]
            end += np.ceil(lacks / max(1.0, uav[U_CAPACITY] - uav[U_RESERVE])) * o.uavs[u, A_RECHARGE]
        charges = lacks / o.uavs[u, A_CHARGE]
        if not route or (abs(lacks) > 1e-3 and abs(charges - np.rint(charges)) > 1e-9):  # else rounding decides
            assert o.state[u, T_END] == pytest.approx(end, rel=1e-9)


def brute_s(s: State) -> float:
    """The least makespan without any recharge; inf where there is no such plan."""
    w = s.world
    left = np.flatnonzero(w.visited == 0).tolist()
    n_uavs = len(w.uavs)
    best = np.inf
    for owners in itertools.product(range(n_uavs), repeat=len(left)):
        worst = 0.0
        for u in range(n_uavs):
            mine = [m for m, owner in zip(left, owners, strict=True) if owner == u]
            uav, least = w.uavs[u], np.inf
            for route in itertools.permutations(mine):
                metres = sum(w.dist[a, b] for a, b in itertools.pairwise([s.work.node[u], *route]))
                home = w.near[route[-1]] if route else 0.0
                need = uav[U_CRUISE] * (metres + home) / uav[U_SPEED] + uav[U_HOVER] * uav[U_SERVICE] * len(route)
                if not route or s.work.us[u, 1] - need >= uav[U_RESERVE]:
                    least = min(least, metres / uav[U_SPEED] + uav[U_SERVICE] * len(route))
            worst = max(worst, s.work.us[u, 0] + least if mine else 0.0)
        best = min(best, worst)
    return best


def some_tasks(problem: Problem, n: int) -> Problem:
    """The problem with its first ``n`` tasks left."""
    visited = tuple(m >= n for m in range(problem.n_tasks))
    return Problem.from_json({**problem.to_json(), "visited": list(visited)})


def test_routes_without_recharges_are_found_and_near_the_best() -> None:
    found, longer = 0, []
    for team in ("1-1", "2-1", "4-2"):
        one = data_set(f"T15-P5_{team}")
        for i in range(12):
            problem = some_tasks(one.instance(i), 6 if team == "1-1" else 5)
            s = begun(problem)
            best = brute_s(s)
            n = alone(s.world, s.work, s.turn, s.acts)
            if n < 0:
                assert best == np.inf, (team, i)
                continue
            actions = decode(problem, s.acts[:n])
            plan = evaluate(problem, actions)
            assert plan.feasible and all(isinstance(a, Visit) for a in actions)
            assert plan.makespan_s >= best - 1e-6
            found += 1
            longer.append(plan.makespan_s / best - 1.0)
    assert found >= 20 and np.mean(longer) < 0.03


def test_without_enough_energy_there_are_no_such_routes() -> None:
    s = begun(data_set("T15-P5_1-1").instance(0))
    assert alone(s.world, s.work, s.turn, s.acts) == -1
    s.work.us[:, 1] *= 10.0
    n = alone(s.world, s.work, s.turn, s.acts)
    assert n == 15
    kernel.go(s.world, s.work, s.acts, 0, n, np.inf, s.turn.rows)
    assert s.work.sums[kernel.S_LEFT] == 0


def test_routes_are_made_anew_when_the_state_changes() -> None:
    problem = data_set("T15-P5_2-1").instance(3)
    s = begun(problem)
    outline(s.world, s.work, s.turn)
    first = s.turn.outline.routes[0, : s.turn.outline.sizes[0]].tolist()
    tk.apply(s.world, s.work, s.turn, tk.code_of(0, first[0], problem.n_tasks, s.world.road.shape[1]))
    outline(s.world, s.work, s.turn)
    other = begun(problem)
    tk.apply(other.world, other.work, other.turn, s.turn.code[0])
    outline(other.world, other.work, other.turn)
    for mine, fresh in zip(s.turn.outline, other.turn.outline, strict=True):
        if mine is not s.turn.outline.tasks and mine is not s.turn.outline.routes:
            assert np.array_equal(mine, fresh)
    assert s.turn.outline.sizes.sum() == 14 and s.turn.outline.seen[first[0]] == 1
    s.turn.done[0] = 1
    outline(s.world, s.work, s.turn)
    assert s.turn.outline.sizes.tolist() == [0, 14]
