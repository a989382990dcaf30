"""The search's compiled parts: meetings are moves and recharges, marks change nothing, moves lose no task."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from strategies import problems

from planner import kernel, moves_kernel, ruin_kernel, search, search_kernel
from planner.arrays import arrays_of, decode, encode, encode_meets, meet
from planner.plan import Recharge, Visit
from planner.presets import preset
from planner.problem import Problem
from planner.search import Options as SearchOptions
from planner.search import _Draft, _Search, _space, _Walker
from planner.solve import Params, Stop, solve

ROWS = np.empty((0, 9))
SEEDS = st.integers(1, 1 << 62)


def random_meets(problem: Problem, seed: int, extra: int) -> np.ndarray:
    """All tasks that are left in any order, with meetings between them."""
    rng = np.random.default_rng(seed)
    n_uavs, n_ugvs, n_sites = len(problem.uavs), len(problem.ugvs), len(problem.sites)
    codes = [int(rng.integers(n_uavs)) << kernel.VEHICLE | int(m) for m in np.flatnonzero(~problem.visited)]
    if n_ugvs:
        codes += [meet(*(int(rng.integers(k)) for k in (n_uavs, n_ugvs, n_sites))) for _ in range(extra)]
    return rng.permutation(np.array(codes, np.int64))


def results(problem: Problem, codes: np.ndarray) -> np.ndarray:
    a = arrays_of(problem)
    work = a.work()
    assert kernel.run(a.world(), work, codes, len(codes), np.inf, ROWS)
    return work.out.copy()


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problems(max_tasks=6, fresh=False), SEEDS, st.integers(0, 8))
def test_a_meeting_is_a_move_and_a_recharge(problem: Problem, seed: int, extra: int) -> None:
    codes = random_meets(problem, seed, extra)
    a = arrays_of(problem)
    roads = [a.road[int(a.site0[c & kernel.MASK])].min() for c in codes if c >> kernel.KIND == kernel.MEET]
    if np.isinf(a.road).any() or any(np.isinf(r) for r in roads):
        return  # where there is no road, a meeting is passed over as a whole, a move alone
    actions = decode(problem, codes)
    ours, theirs = results(problem, codes), results(problem, encode(problem, actions))
    same = [i for i in range(kernel.OUT_SIZE) if i not in (kernel.O_CODE, kernel.O_WHERE, kernel.O_AMOUNT)]
    np.testing.assert_allclose(ours[same], theirs[same], rtol=1e-12, atol=1e-9)
    assert (ours[kernel.O_CODE] == kernel.OK) == (theirs[kernel.O_CODE] == kernel.OK)
    np.testing.assert_array_equal(encode_meets(problem, actions), codes)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problems(max_tasks=6, fresh=False), SEEDS, st.integers(0, 40))
def test_evaluation_goes_on_from_a_mark(problem: Problem, seed: int, extra: int) -> None:
    codes = random_meets(problem, seed, extra)
    n = len(codes)
    whole = results(problem, codes)
    a = arrays_of(problem)
    w, work = a.world(), a.work(unique=True)
    _, marks = _space(w, work, n + 1)
    state = work.node, work.us, work.site, work.gs, work.docks, work.sums
    for k in range(n // search_kernel.EVERY + 1):
        kernel.begin(w, work)
        at = k * search_kernel.EVERY

        kernel.go(w, work, codes, 0, at, np.inf, ROWS)
        search_kernel.keep(k, *marks, *state)
        kernel.go(w, work, codes, at, n, np.inf, ROWS)  # away from the mark, and back
        search_kernel.back(k, *marks, *state)
        kernel.go(w, work, codes, at, n, np.inf, ROWS)
        kernel.total(w, work)
        np.testing.assert_array_equal(work.out, whole)


def tasks_of(codes: np.ndarray, n: int) -> list[int]:
    return sorted(int(c & kernel.MASK) for c in codes[:n] if c >> kernel.KIND == kernel.VISIT)


@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("team", [(1, 1), (4, 2)])
def test_moves_lose_no_task_and_name_only_what_exists(team: tuple[int, int], partial: bool) -> None:
    problem = preset("T45-P10", team, 2)
    s = _Search(problem, SearchOptions(allow_partial=partial))
    draft = s.pack(solve(problem, Stop(iterations=2_000)).plan.actions, fill=True)
    rng = np.array([7], dtype=np.uint64)
    tools, _ = _space(s.world, s.work, len(draft.acts))
    applied = {"small": 0, "large": 0}
    for step in range(6_000):
        was = _Draft(draft.acts.copy(), draft.counts.copy())
        if step % 3 == 0:
            s.score(draft)
            tools.ends[:] = s.work.us[:, 0]
            taken = ruin_kernel.take_out(draft.acts, draft.counts, s.around, tools, rng)
            assert 0 <= taken <= ruin_kernel.MOST
            if taken == 0:  # it looks for a visit a few times only
                continue
            missing = set(tools.bag[:taken].tolist())
            pool = draft.acts[draft.counts[0] : draft.counts.sum()].tolist()
            assert missing.isdisjoint(tasks_of(draft.acts, int(draft.counts[0])))
            assert sorted(missing | set(tasks_of(draft.acts, int(draft.counts[0]))) | set(pool)) == list(range(45))
            ruin_kernel.put_back(draft.acts, draft.counts, taken, 1e3, s.world, s.around, tools, rng)
            applied["large"] += 1
        else:
            size = len(draft.acts)
            if moves_kernel.change(draft.acts, draft.counts, size, *s.around, partial, rng):
                applied["small"] += 1
            else:
                draft = was
                continue
        n, pooled = draft.counts.tolist()
        assert n + pooled <= len(draft.acts)
        assert sorted(tasks_of(draft.acts, n) + draft.acts[n : n + pooled].tolist()) == list(range(45))
        assert partial or pooled == 0
        for code in draft.acts[:n].tolist():
            assert code >> kernel.KIND in (kernel.VISIT, kernel.MEET)
            assert code >> kernel.VEHICLE & kernel.MASK < team[0]
            if code >> kernel.KIND == kernel.MEET:
                assert code & kernel.MASK < team[1] and code >> kernel.SITE & kernel.MASK <= 10
    assert min(applied.values()) > 1_500


def test_large_moves_know_the_energy_that_is_left() -> None:
    """The spare distances of all trips, against the evaluator's energies."""
    problem = preset("T45-P10", (2, 1), 3)
    plan = solve(problem, Stop(iterations=20_000)).plan
    assert plan.feasible
    s = _Search(problem, SearchOptions())
    codes = encode_meets(problem, plan.actions)
    tools, _ = _space(s.world, s.work, len(codes) + 2)
    ruin_kernel.measure(codes, len(codes), s.world, s.around, tools)
    uav = problem.uavs[0]
    acting = [
        (a, r) for a, r in zip(plan.actions, plan.schedule.actions, strict=True) if isinstance(a, Visit | Recharge)
    ]
    found = 0
    for i, (act, row) in enumerate(acting):
        if isinstance(act, Recharge):
            left_m = row.energy_arrive_j / uav.cruise_w * uav.speed_mps
            assert tools.spare[tools.trip[i]] == pytest.approx(left_m, abs=1e-6)
            found += 1
    assert found > 2
    for recovery in plan.schedule.recovery:
        left_m = recovery.energy_end_j / uav.cruise_w * uav.speed_mps
        assert tools.spare[tools.open[recovery.uav]] == pytest.approx(left_m, abs=1e-6)


def test_workers_keep_to_seed_and_steps() -> None:
    problem = preset("T15-P5", (2, 2), 5)
    for options in ({"workers": 1}, {"workers": 2}):
        one, two = (solve(problem, Stop(iterations=20_000), 3, Params(options=options)) for _ in range(2))
        assert one.plan.feasible and one.plan.actions == two.plan.actions
        assert one.iterations == two.iterations == 20_000
        alone = solve(problem, Stop(iterations=10_000), 3).plan
        assert alone.makespan_s >= one.plan.makespan_s - 1.0  # two walks of that length, the best one counts


def test_every_other_worker_begins_cooler_where_there_is_time_for_one_walk(monkeypatch: pytest.MonkeyPatch) -> None:
    heats: list[tuple[float, int]] = []
    walk = _Walker._walk

    def noted(self: _Walker, first: Any, begin: float, end: float, heat: float, cap_s: float = 0.0) -> Any:
        if cap_s == 0.0:
            heats.append((heat, int(self.cooler < 1.0)))
        return walk(self, first, begin, end, heat, cap_s)

    monkeypatch.setattr(_Walker, "_walk", noted)
    problem, options = preset("T15-P5", (2, 2), 5), {"workers": 3}
    plan = solve(problem, Stop(iterations=3_000), 3, Params(options=options)).plan
    assert sorted(heats) == [(0.5, 1), (1.0, 0), (1.0, 0)]
    heats.clear()
    solve(problem, Stop(iterations=3_000), 3, Params(start=plan.actions, options=options))
    assert {heat for heat, _ in heats} == {0.15}  # a start that is worth keeping
    heats.clear()
    monkeypatch.setattr(search, "WALK_STEPS", 50)
    solve(problem, Stop(iterations=3 * 2 * 50 * problem.n_tasks), 3, Params(options=options))
    assert [heat for heat, _ in heats] == [1.0] * 6  # two walks each
