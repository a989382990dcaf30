"""The decoder's tokens: experts' plans are never masked out, and whatever is offered ends in a feasible plan."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from planner import kernel
from planner.arrays import decode, encode_meets
from planner.instances import data_set
from planner.midway import midway
from planner.policy import tokens_kernel as tk
from planner.policy.complete_kernel import complete
from planner.policy.order import in_turns
from planner.policy.state import State, new_state
from planner.presets import preset
from planner.problem import Problem
from planner.schedule import evaluate
from planner.solve import Stop, solve

# Much compiling, and nothing that is shipped uses it yet: not in the default suite.
pytestmark = pytest.mark.slow

TEAMS = [(1, 1), (2, 1), (2, 2), (4, 2), (3, 1), (6, 3)]


def hovering(problem: Problem) -> Problem:
    """The same team, which hovers while it waits, serves tasks and keeps a reserve, with UGVs that stand at a cost."""
    uavs = tuple(
        replace(u, waiting="hover", service_s=20.0, reserve_j=0.05 * u.capacity_j, capacity_j=1.3 * u.capacity_j,
                energy_j=1.3 * u.energy_j)
        for u in problem.uavs
    )  # fmt: skip
    ugvs = tuple(replace(g, idle_w=50.0, dock_s=15.0, undock_s=10.0) for g in problem.ugvs)
    return replace(problem, uavs=uavs, ugvs=ugvs)


def walk(problem: Problem, rng: np.random.Generator) -> tuple[State, int, int]:
    """A random walk over what is offered and provably can be finished; the state, actions, and refused options."""
    s = new_state(problem)
    tk.start(s.world, s.work, s.turn)
    n_tasks, n_sites = len(s.world.visited), s.world.road.shape[1]
    hint = np.zeros(2, np.int64)
    assert complete(s.world, s.work, s.space, s.turn, hint, s.way) >= 0
    n, refused = 0, 0
    before = s.space.__class__(*(x.copy() for x in s.work))
    while s.work.sums[kernel.S_LEFT] > 0:
        u = tk.acting(s.work, s.turn)
        count = tk.offer(s.world, s.work, s.turn, u)
        options = np.r_[
            np.flatnonzero(s.turn.visits),
            n_tasks + np.flatnonzero(s.turn.meets),
            [n_tasks + s.turn.meets.size] if s.turn.may_end[0] else [],
        ].astype(int)
        assert count == len(options)
        for option in rng.permutation(options).tolist():
            for a, b in zip(before, s.work, strict=True):
                a[...] = b
            row = s.turn.row.copy()
            if option == n_tasks + s.turn.meets.size:
                s.turn.done[u] = 1
            else:
                s.acts[n] = tk.code_of(u, option, n_tasks, n_sites)
                tk.apply(s.world, s.work, s.turn, s.acts[n])
            if complete(s.world, s.work, s.space, s.turn, hint, s.way) >= 0:
                n += option != n_tasks + s.turn.meets.size
                break
            refused += 1
            s.turn.done[u] = 0
            s.turn.row[:] = row
            for a, b in zip(before, s.work, strict=True):
                b[...] = a
        else:
            raise AssertionError("a dead end")
        assert n < len(s.acts)
    return s, n, refused


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("hover", [False, True])
def test_random_walks_are_feasible(team: tuple[int, int], hover: bool) -> None:
    rng = np.random.default_rng(1)
    for seed in range(3):
        for setup in ("T15-P5", "T45-P10"):
            problem = preset(setup, team, seed)
            if hover:
                problem = hovering(problem)
            s, n, _ = walk(problem, rng)
            schedule = evaluate(problem, decode(problem, s.acts[:n]))
            assert schedule.violation is None


@pytest.mark.parametrize("team", TEAMS)
@pytest.mark.parametrize("hover", [False, True])
def test_midway_walks_are_feasible(team: tuple[int, int], hover: bool) -> None:
    rng = np.random.default_rng(2)
    for seed in range(4):
        problem = preset("T15-P5", team, seed)
        problem, _ = midway(hovering(problem) if hover else problem, seed)
        s, n, _ = walk(problem, rng)
        assert evaluate(problem, decode(problem, s.acts[:n])).violation is None


@pytest.mark.parametrize("name", ["T15-P5_1-1", "T15-P5_2-1", "T15-P5_4-2", "T45-P10_2-1", "T45-P10_4-2_drawn"])
@pytest.mark.parametrize("hover", [False, True])
def test_experts_plans_are_reproduced(name: str, hover: bool) -> None:
    for index in range(3):
        problem = data_set(name).instance(index)
        if hover:
            problem = hovering(problem)
        plan = solve(problem, Stop(iterations=20_000), index).plan
        assert plan.feasible
        states = [(problem, plan.actions)]
        states.append(midway(problem, index))
        for one, actions in states:
            s = new_state(one)
            told = in_turns(one, actions, s)
            assert told.feasible
            assert told.makespan_s <= 1.1 * evaluate(one, actions).makespan_s
            again = decode(one, told.codes)
            assert evaluate(one, again).makespan_s == told.makespan_s
            assert len(told.codes) <= len(encode_meets(one, actions))


def test_what_is_told_is_certain_at_every_step() -> None:
    """In the paper's setups a way to finish is known behind every decision of the expert."""
    for name in ("T15-P5_1-1", "T45-P10_2-1", "T45-P10_4-2"):
        problem = data_set(name).instance(0)
        told = in_turns(problem, solve(problem, Stop(iterations=20_000), 0).plan.actions)
        s = new_state(problem)
        tk.start(s.world, s.work, s.turn)
        hint = np.zeros(2, np.int64)
        for code in told.codes.tolist():
            tk.apply(s.world, s.work, s.turn, code)
            assert complete(s.world, s.work, s.space, s.turn, hint, s.way) >= 0


def test_planning_needs_no_torch() -> None:
    code = "import sys, planner.policy.decode, planner.policy.paper_decode; assert 'torch' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
