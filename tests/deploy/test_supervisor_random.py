"""What holds whatever happens: delays and faults end with everybody down, replay repeats, skipping changes nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import world
from fake_world import World, no_better, nothing_works
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from deploy import supervisor
from deploy.observation import PlanReply, PlanRequest
from deploy.state import MissionPhase, UavPhase
from deploy.supervisor import initial
from deploy.wake import wake_s
from drivers.vehicle import Hold
from planner.plan import Move, Recharge, Visit

DUO = (
    Move(0, 0), Move(1, 1), Visit(0, 0), Visit(1, 1), Recharge(1, 0), Recharge(0, 0), Move(0, 1), Visit(0, 2),
    Visit(1, 3), Recharge(0, 1), Recharge(1, 1),
)  # fmt: skip


def duo(planner=no_better, **members) -> World:
    """Two UAVs, two UGVs with one dock each, and rendezvous that wait for one another."""
    of = world.problem(n_uavs=2, n_ugvs=2, n_tasks=4, docks=1, charge_s=5.0)
    these = world.settings(
        of=of,
        ugv={"dock_offsets_m": ((0.0, 0.0),)},
        monitors={"ugv_stuck_s": 30.0, "dock_timeout_s": 40.0},
    )
    pads, places = ((0.0, 12.0), (0.0, 24.0)), ((0.0, -4.0), (0.0, -10.0))  # as missions place them: apart
    these = replace(
        these,
        uavs=tuple(replace(u, pad_offset_m=p) for u, p in zip(these.uavs, pads, strict=True)),
        ugvs=tuple(replace(g, park_offset_m=p) for g, p in zip(these.ugvs, places, strict=True)),
    )
    w = World(these, world.plan(these, DUO), planner, **members)
    assert w.state.plan.violation is None
    return w


def partial(request: PlanRequest) -> PlanReply:
    """A planner that leaves out whatever cannot be done: the rest of the plan without the gone, tasks to the others."""
    left = [u for u in range(len(request.problem.uavs)) if u not in request.exclude_uavs]
    open_tasks = [m for m, v in enumerate(request.problem.visited) if not v]
    actions = tuple(Visit(left[i % len(left)], m) for i, m in enumerate(open_tasks))
    return PlanReply(request.number, False, actions, "test", 0.1)


SHARES = {"uav": st.sampled_from([0.5, 0.8, 1.0]), "ugv": st.sampled_from([0.1, 0.3, 1.0])}
IDS = ("uav0", "uav1", "ugv0", "ugv1")


@settings(max_examples=3, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    slow=st.fixed_dictionaries({i: SHARES[i[:3]] for i in IDS}), misses=st.tuples(st.integers(0, 2), st.integers(0, 2))
)
def test_no_delay_deadlocks(slow, misses) -> None:
    w = duo(slow=slow, misses={"uav0": misses[0], "uav1": misses[1]}, planner=partial)
    w.fly(limit_s=1500.0)
    assert w.state.over, [u.phase for u in w.state.uavs]
    assert all(u.phase in (UavPhase.DOWN, UavPhase.LOST) for u in w.state.uavs)
    assert not any(b.airborne for b in w.bodies.values())


FAULTS = ("blind", "mute", "stalled", "tumbled", "no_charge", "deaf")


@settings(max_examples=5, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    faults=st.lists(
        st.tuples(st.integers(1, 90), st.sampled_from(FAULTS), st.sampled_from(IDS), st.sampled_from([2, 8, 1000])),
        min_size=1,
        max_size=4,
    ),
    planner=st.sampled_from([no_better, partial, nothing_works, None]),
)
def test_random_faults_end_with_everybody_down_or_lost(faults, planner) -> None:
    w = duo(planner=planner)
    ends: list[tuple[float, str, str]] = []
    for at_s, fault, who, lasts_s in sorted(faults):
        w.fly(limit_s=max(0.0, at_s - w.now_s))
        if fault == "tumbled":
            if w.bodies[who].airborne or who.startswith("ugv"):
                w.bodies[who].tumbled = True
        else:
            getattr(w, fault).add(who)
            ends.append((w.now_s + lasts_s, fault, who))
    for end_s, fault, who in sorted(ends):
        w.fly(limit_s=max(0.0, min(end_s - w.now_s, 200.0)))
        if who.startswith("ugv") or fault != "no_charge":
            getattr(w, fault).discard(who)
    w.fly(limit_s=1500.0)
    assert w.state.over, ([u.phase for u in w.state.uavs], [g.phase for g in w.state.ugvs], w.state.phase)
    for uav in w.state.uavs:
        assert uav.phase in (UavPhase.DOWN, UavPhase.LOST) or w.state.phase is MissionPhase.ABORTED
        if uav.phase is UavPhase.DOWN:
            assert not w.bodies[w.settings.uavs[uav.index].id].airborne


def test_replay_of_what_was_seen_gives_the_same_commands() -> None:
    w = duo(misses={"uav0": 1}, slow={"ugv0": 0.5})
    w.fly(limit_s=80.0)
    w.wish("hold")
    w.fly(limit_s=5.0)
    w.wish("recover")
    w.fly()
    state = initial(w.settings, w.plan)
    for before, seen, result in w.history:
        assert state == before
        again = supervisor.step(w.settings, state, seen)
        assert again.commands == result.commands and again.events == result.events
        state = again.state
    assert state == w.state and state.over


def test_skipping_turns_in_which_nothing_is_decided_changes_no_decision() -> None:
    def decisions(w: World, who: str) -> list:
        # Without Hold: whether a UAV is still slowing down when its next flight begins depends on the turn's moment.
        return [type(c).__name__ for _, c in w.commands if c.vehicle == who and not isinstance(c, Hold)]

    every, few = duo().fly(), duo().fly(skip=True)
    assert few.turns < every.turns / 2
    for who in IDS:
        assert decisions(few, who) == decisions(every, who)
        told = [[e.kind for e in w.events if e.vehicle == who] for w in (few, every)]
        assert told[0] == told[1]
    assert abs(every.now_s - few.now_s) < 0.05 * every.now_s and few.state.visited == every.state.visited


def test_skipping_finds_faults_as_soon() -> None:
    def run(skip: bool) -> World:
        w = duo(planner=partial)
        w.fly(limit_s=20.0, skip=skip)
        w.blind.add("uav0")
        w.fly(limit_s=1.0, skip=skip)
        w.blind.clear()
        w.misses["uav1"] = 1
        w.fly(limit_s=30.0, skip=skip)
        w.mute.add("uav1")
        w.fly(limit_s=3.0, skip=skip)
        w.mute.clear()
        return w.fly(skip=skip)

    every, few = run(False), run(True)
    for who in IDS:
        told = [[e for e in w.events if e.vehicle == who] for w in (every, few)]
        assert [e.kind for e in told[0]] == [e.kind for e in told[1]]
        for a, b in zip(*told, strict=True):
            assert math.isclose(a.time_s, b.time_s, abs_tol=2.5)


def test_wake_is_always_later_than_now_and_within_a_review() -> None:
    w = duo(misses={"uav0": 1}, no_charge={"uav1"}, planner=None)
    w.fly(limit_s=200.0)
    for before, seen, result in w.history:
        for state, now_s in ((result.state, seen.now_s), (before, seen.now_s), (result.state, seen.now_s + 0.7)):
            assert now_s < wake_s(w.settings, state, now_s) <= now_s + w.settings.replanning.review_s


def test_wake_before_the_start_and_in_measured_missions() -> None:
    w = duo()
    assert wake_s(w.settings, w.state, 5.0) == 5.2
    w.fly(until=lambda w: any(u.phase is UavPhase.CHARGING for u in w.state.uavs))
    virtual = wake_s(w.settings, w.state, w.now_s)
    measured = replace(w.settings, uavs=tuple(replace(u, energy="measured") for u in w.settings.uavs))
    assert wake_s(measured, w.state, w.now_s) >= virtual
