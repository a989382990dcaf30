"""The compiled evaluator against the independent one, on random problems and plans."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import Reference
from strategies import action_lists, problems

from planner.order import canonical
from planner.plan import Move
from planner.schedule import evaluate, predict

WORDS = {
    "excluded": "excluded",
    "no road": "no road leads",
    "between": "between path points",
    "drive": "short on its way to",
    "twice": "visited already",
    "way": "short on its way to",
    "wait": "short while",
    "give": "short while recharging",
    "recovery": "short of reaching any path point or the depot",
    "stand": "short at the end of the plan",
    "unvisited": "not visited",
}


@st.composite
def cases(draw):
    problem = draw(problems())
    actions = draw(action_lists(problem))
    no_uavs = draw(st.sampled_from([(), (), (), (0,)]))
    no_ugvs = draw(st.sampled_from([(), (), (), (0,)])) if problem.ugvs else ()
    return problem, actions, no_uavs, no_ugvs


@settings(max_examples=250, deadline=None)
@given(cases())
def test_evaluator_agrees_with_the_reference(case) -> None:
    problem, actions, no_uavs, no_ugvs = case
    mine = evaluate(problem, actions, exclude_uavs=no_uavs, exclude_ugvs=no_ugvs)
    ref = Reference(problem, actions, no_uavs=no_uavs, no_ugvs=no_ugvs)
    same = np.testing.assert_allclose
    for row, e, a in zip(mine.actions, ref.events, actions, strict=True):
        got = [
            row.start_s,
            row.arrive_s,
            row.work_s,
            row.end_s,
            row.energy_start_j,
            row.energy_arrive_j,
            row.energy_end_j,
        ]
        want = [e.start, e.arrive, e.work, e.end, e.energy_start, e.energy_dock, e.energy_end]
        same(got, want, rtol=1e-9, atol=1e-5, err_msg=str(a))
        if not isinstance(a, Move):
            assert row.dock == e.dock
    same(mine.makespan_s, ref.makespan, atol=1e-6)
    same(mine.uav_energy_j, ref.uav_energy, rtol=1e-9, atol=1e-4)
    same(mine.ugv_energy_j, ref.ugv_energy_used, rtol=1e-9, atol=1e-4)
    same(mine.energy_given_j, ref.given, rtol=1e-9, atol=1e-4)
    same(mine.waiting_s, ref.waiting, atol=1e-6)
    on = [u for u in range(len(problem.uavs)) if u not in no_uavs]
    assert [r.uav for r in mine.recovery] == on
    for r in mine.recovery:
        _, end, rest = ref.recovery(r.uav)
        same([r.end_s, r.energy_end_j], [end, rest], rtol=1e-9, atol=1e-5)
    same(mine.recovery_s, max((ref.recovery(u)[1] for u in on), default=0.0), atol=1e-6)
    first = ref.violation()
    if first is None:
        assert mine.feasible and mine.violation is None
    else:
        assert not mine.feasible
        assert WORDS[first[0]] in mine.violation, (first, mine.violation)
        if first[0] in ("recovery", "stand"):
            assert f"{'uav' if first[0] == 'recovery' else 'ugv'} {first[1]}" in mine.violation
        elif first[0] != "unvisited":
            a = actions[first[1]]
            who = f"ugv {a.ugv}" if isinstance(a, Move) else f"uav {a.uav}"
            assert who in mine.violation
    quick = predict(problem, actions, exclude_uavs=no_uavs, exclude_ugvs=no_ugvs)
    assert quick.feasible == mine.feasible
    assert quick.survives == (first is None or first[0] == "unvisited")
    assert (quick.makespan_s, quick.uav_energy_j, quick.waiting_s) == (
        mine.makespan_s,
        mine.uav_energy_j,
        mine.waiting_s,
    )


@settings(max_examples=100, deadline=None)
@given(cases())
def test_canonical_order_keeps_the_schedule(case) -> None:
    problem, actions, _, _ = case
    before, ordered = evaluate(problem, actions), canonical(problem, actions)
    after = evaluate(problem, ordered)
    assert sorted(map(repr, ordered)) == sorted(map(repr, actions))
    assert canonical(problem, ordered) == ordered

    def rows(plan, schedule):
        return sorted(
            (repr(a), r.start_s, r.end_s, r.energy_end_j) for a, r in zip(plan, schedule.actions, strict=True)
        )

    assert rows(actions, before) == rows(ordered, after)
    assert after.feasible == before.feasible


@settings(max_examples=150, deadline=None)
@given(cases(), st.data())
def test_slack_is_never_over_stated(case, data) -> None:
    problem, actions, _, _ = case
    plan = evaluate(problem, actions)
    if not actions:
        return
    i = data.draw(st.integers(0, len(actions) - 1))
    row = plan.actions[i]
    nominal = Reference(problem, actions)
    assert row.slack_s <= row.total_slack_s + 1e-6 or row.total_slack_s < float("inf")
    late = min(row.total_slack_s, 5_000.0)
    delayed = Reference(problem, actions, {i: late})
    assert delayed.makespan <= nominal.makespan + 1e-5 or row.total_slack_s == 0.0
    if plan.feasible:
        assert delayed.violation() is None or late == 0.0 or _only_just(delayed)
    late = min(row.slack_s, 5_000.0)
    delayed = Reference(problem, actions, {i: late})
    for j, (e, f) in enumerate(zip(nominal.events, delayed.events, strict=True)):
        if j != i:
            assert f.start <= e.start + 1e-6 and f.end <= e.end + 1e-6


def _only_just(delayed: Reference) -> bool:
    """Whether the violation is a rounding error."""
    import reference  # noqa: PLC0415

    reference.TINY_J, before = 1e-3, reference.TINY_J
    try:
        return Reference(delayed.p, delayed.actions, delayed.late).violation() is None
    finally:
        reference.TINY_J = before
