"""Whole missions in the fake world: what goes wrong, and that everybody comes down safely all the same."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import groupby, pairwise

import fake_world
import pytest
import world
from fake_world import World, no_better, nothing_works

from deploy.events import Action, EventKind
from deploy.observation import PlanReply, PlanRequest
from deploy.state import MissionPhase, UavPhase, UgvPhase
from drivers.vehicle import Arm, Disarm, Dock, GoTo, Hold, Land, StopMotors, TakeOff
from planner.plan import Move, Recharge, Visit

K, M = EventKind, MissionPhase
SOLO = (Move(0, 0), Visit(0, 0), Visit(0, 1), Recharge(0, 0), Visit(0, 2))


def solo(actions=SOLO, planner=no_better, *, of=None, settings=None, **members) -> World:
    """One UAV and one UGV."""
    of = of or world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = settings or world.settings(of=of)
    return World(settings, world.plan(settings, actions), planner, **members)


def actions_of(*actions):
    """A planner that always answers with these actions, those done already left out."""

    def answer(request: PlanRequest) -> PlanReply:
        todo = tuple(a for a in actions if not (isinstance(a, Visit) and request.problem.visited[a.task]))
        return PlanReply(request.number, True, todo, "test", 0.1)

    return answer


def phase(uav: int, *phases: UavPhase):
    return lambda w: w.state.uavs[uav].phase in phases


def order_of(w: World) -> list[tuple[str, str]]:
    return [(e.kind.value, e.vehicle or "") for e in w.events if e.kind in (K.TASK_VISITED, K.RECHARGE_DONE)]


# --- the good case --------------------------------------------------------------------------------------------------


def test_a_whole_mission_with_a_recharge() -> None:
    w = solo().fly()
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.recharges == 1
    assert order_of(w) == [("task_visited", "uav0")] * 2 + [("recharge_done", "uav0"), ("task_visited", "uav0")]
    assert w.state.plan.done == (True,) * len(SOLO)
    assert w.state.uavs[0].phase is UavPhase.DOWN and w.state.ugvs[0].phase is UgvPhase.PARKED
    assert w.state.ugvs[0].site == w.state.uavs[0].site  # the UGV has come to where the UAV is
    kinds = [type(c) for _, c in w.commands if c.vehicle == "uav0" and not isinstance(c, Hold)]
    assert [kind for kind, _ in groupby(kinds)] == [
        Arm, TakeOff, GoTo, Dock, Arm, TakeOff, GoTo, Land, Disarm
    ]  # fmt: skip
    assert w.state.last_visit_s is not None and w.state.end_s is not None and w.state.end_s > w.state.last_visit_s


def test_a_recharged_uav_is_full_and_the_ugv_has_paid_for_it() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.CHARGING))
    before = w.state
    w.fly(until=phase(0, UavPhase.TAKING_OFF))
    given_j = w.state.uavs[0].energy_j - before.uavs[0].energy_j
    assert w.state.uavs[0].energy_j >= 0.995 * 60_000.0
    assert before.ugvs[0].energy_j - w.state.ugvs[0].energy_j == pytest.approx(given_j, rel=0.02)


def test_service_is_hovered_out_and_begins_again_after_a_hold() -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=1, service_s=10.0)
    w = solo((Visit(0, 0),), of=of)
    w.fly(until=lambda w: w.state.uavs[0].work_until_s is not None, limit_s=100)
    begun_s = w.now_s
    w.fly(limit_s=3.0)
    w.wish("hold")
    assert w.state.uavs[0].work_until_s is None
    w.fly(limit_s=2.0)
    w.wish("resume")
    w.fly()
    assert w.state.phase is M.DONE
    assert w.told(K.TASK_VISITED)[0].time_s >= begun_s + 3 + 2 + 5  # stopping and starting count as 5 s of it


def test_waiting_landed_for_a_ugv_that_is_late() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0, uav={"waiting": "landed"})
    w = solo(settings=world.settings(of=of, monitors={"ugv_stuck_s": 300.0}), stalled={"ugv0"})
    w.fly(until=lambda w: bool(w.told(K.UAV_DOWN)))
    w.stalled.clear()
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited)
    landed_s = w.told(K.UAV_DOWN)[0].time_s
    came_s = w.told(K.UGV_ARRIVED)[0].time_s
    docked_s = w.told(K.RECHARGE_STARTED)[0].time_s
    assert landed_s < came_s < docked_s
    taken_off = [t for t, c in w.commands if isinstance(c, TakeOff)]
    assert not [t for t in taken_off if landed_s < t < came_s]


def test_waiting_hovering_for_a_ugv_that_is_a_little_late() -> None:
    w = solo(slow={"ugv0": 0.4}).fly()
    assert w.state.phase is M.DONE and len(w.told(K.UAV_DOWN)) == 1


# --- docking and charging -------------------------------------------------------------------------------------------


def test_a_missed_dock_is_tried_again() -> None:
    w = solo(misses={"uav0": 1}).fly()
    assert w.state.phase is M.DONE and all(w.state.visited)
    assert [e.action for e in w.told(K.DOCK_MISSED)] == [Action.HOLD]
    assert len(w.sent(Dock)) == 2 and w.state.recharges == 1


def test_three_missed_docks_end_in_a_landing_and_not_in_endless_attempts() -> None:
    w = solo(planner=nothing_works, misses={"uav0": 99}).fly()
    assert [e.action for e in w.told(K.DOCK_MISSED)] == [Action.HOLD, Action.HOLD, Action.DIVERT]
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN
    assert w.state.visited == (True, True, False) and not w.told(K.RECHARGE_DONE)


def test_a_dock_without_contact_is_tried_three_times_and_then_no_more() -> None:
    w = solo(planner=nothing_works, no_charge={"uav0"}).fly()
    assert [e.action for e in w.told(K.CHARGE_UNCONFIRMED)] == [Action.HOLD] * 3
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN and w.state.uavs[0].out
    assert not w.told(K.RECHARGE_DONE) and not w.told(K.RECHARGE_STARTED)
    assert w.now_s < 600.0


def test_a_dock_without_contact_that_then_finds_it() -> None:
    w = solo(no_charge={"uav0"})
    w.fly(until=lambda w: bool(w.told(K.CHARGE_UNCONFIRMED)))
    w.no_charge.clear()
    w.fly()
    assert w.state.phase is M.DONE and w.state.recharges == 1 and all(w.state.visited)


def test_a_docking_that_never_ends_times_out() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.DOCKING))
    w.stalled.add("uav0")
    w.fly(until=lambda w: w.state.uavs[0].phase is not UavPhase.DOCKING, limit_s=60)
    assert w.told(K.COMMAND_FAILED, "uav0") and w.state.uavs[0].diverting  # it does not follow at all
    w.stalled.clear()
    w.fly()
    assert w.state.over


def test_two_uavs_share_one_dock_in_the_order_of_the_plan() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, n_tasks=4, docks=1, charge_s=10.0)
    actions = (Move(0, 0), Visit(0, 0), Visit(1, 1), Recharge(1, 0), Recharge(0, 0), Visit(0, 2), Visit(1, 3))
    settings = world.settings(of=of, ugv={"dock_offsets_m": ((0.0, 0.0),)})
    w = World(settings, world.plan(settings, actions), no_better).fly()
    assert w.state.phase is M.DONE and all(w.state.visited)
    assert [e.vehicle for e in w.told(K.RECHARGE_STARTED)] == ["uav1", "uav0"]
    done, begun = w.told(K.RECHARGE_DONE)[0], w.told(K.RECHARGE_STARTED)[1]
    assert done.vehicle == "uav1" and done.time_s < begun.time_s


def test_two_uavs_on_two_docks_leave_one_after_the_other_and_the_ugv_last() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, n_tasks=4, charge_s=10.0)
    actions = (
        Move(0, 0), Visit(0, 0), Visit(1, 1), Recharge(0, 0), Recharge(1, 0), Move(0, 1), Visit(0, 2), Visit(1, 3),
        Recharge(0, 0),
    )  # fmt: skip
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings, actions), no_better).fly()
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.recharges == 3
    left_s = w.told(K.UGV_ARRIVED)[1].time_s
    assert max(e.time_s for e in w.told(K.RECHARGE_DONE)[:2]) < left_s


def test_a_charge_that_stalls_does_not_hold_the_mission_for_ever() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, uav={"energy": "measured"})
    w = solo(settings=settings, charge=0.0, drain=0.001).fly()  # it says it charges, but its battery gains nothing
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_a_measured_battery_charges() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    w = solo(settings=world.settings(of=of, uav={"energy": "measured"}, ugv={"energy": "measured"})).fly()
    assert w.state.phase is M.DONE and w.state.recharges == 1 and all(w.state.visited)


# --- commands, poses, links -----------------------------------------------------------------------------------------


def test_a_lost_command_is_repeated() -> None:
    w = solo(deaf={"uav0"})
    w.fly(until=lambda w: w.now_s > 3.0)
    assert w.state.phase is M.CHECKED and len(w.sent(Arm, "uav0")) == 2
    w.deaf.clear()
    w.fly(until=phase(0, UavPhase.TAKING_OFF))
    w.deaf.add("uav0")
    w.bodies["uav0"].path.clear()
    w.fly(limit_s=5.0)
    w.deaf.clear()
    w.fly()
    assert len(w.sent(TakeOff)) > 2 and w.state.phase is M.DONE and all(w.state.visited)


def test_a_uav_that_does_not_follow_its_commands_is_landed() -> None:
    w = solo(planner=nothing_works)
    w.fly(until=phase(0, UavPhase.FLYING))
    w.stalled.add("uav0")
    w.fly(until=phase(0, UavPhase.LANDING))
    assert w.told(K.COMMAND_FAILED, "uav0")[0].action is Action.LAND_HERE
    w.stalled.clear()
    w.fly()
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN


def test_arming_that_never_works_ends_the_mission_on_the_ground() -> None:
    w = solo(deaf={"uav0"}).fly(limit_s=60)
    assert w.state.phase is M.ABORTED
    assert w.sent(Disarm, "ugv0") and not w.sent(TakeOff)


def test_a_stale_pose_holds_until_it_is_back() -> None:
    w = solo()
    w.fly(until=lambda w: len(w.sent(GoTo)) == 1)
    w.fly(limit_s=2.0)
    w.blind.add("uav0")
    w.fly(until=lambda w: bool(w.sent(Hold, "uav0")))
    assert w.told(K.POSE_STALE, "uav0")[0].action is Action.HOLD and w.state.uavs[0].held
    w.fly(limit_s=1.0)
    w.blind.clear()
    w.fly()
    assert w.told(K.RECOVERED_FROM, "uav0") and w.state.phase is M.DONE and all(w.state.visited)
    assert w.state.uavs[0].order is not None


def test_a_lost_pose_lands_it_and_its_landing_ends_without_a_pose() -> None:
    w = solo(planner=nothing_works)
    w.fly(until=lambda w: len(w.sent(GoTo)) == 1)
    w.blind.add("uav0")
    w.fly(until=phase(0, UavPhase.LANDING))
    assert w.told(K.POSE_LOST, "uav0")[0].action is Action.LAND_HERE
    assert not w.told(K.RECOVERED_FROM, "uav0"), "a stale pose that is lost now is not over"
    w.fly(limit_s=120)
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN and w.state.uavs[0].out


def test_a_lost_link_is_planned_without() -> None:
    w = solo(planner=nothing_works)
    w.fly(until=lambda w: len(w.sent(GoTo)) == 1)
    w.mute.add("uav0")
    w.fly(until=phase(0, UavPhase.LANDING))
    assert w.told(K.TELEMETRY_STALE, "uav0")[0].action is Action.HOLD
    assert w.told(K.LINK_LOST, "uav0")[0].action is Action.LAND_HERE
    w.fly(limit_s=10)
    assert len(w.sent(Land)) >= 4  # it is asked again and again
    assert not w.told(K.RECOVERED_FROM, "uav0")
    w.mute.clear()
    w.fly()
    assert [e.text for e in w.told(K.RECOVERED_FROM, "uav0")] == ["link lost is over"]
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN


def test_a_silent_uav_seen_on_the_floor_is_down() -> None:
    w = solo(planner=nothing_works)
    w.fly(until=phase(0, UavPhase.FLYING))
    w.mute.add("uav0")
    w.fly(until=phase(0, UavPhase.LANDING))
    x, y, _ = w.bodies["uav0"].at
    w.bodies["uav0"].path, w.bodies["uav0"].speed_mps = [(x, y, 0.0)], 1.5  # it lands by itself, as autopilots do
    w.fly(limit_s=60)
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN


def test_a_uav_neither_seen_nor_heard_is_lost_and_asked_to_land_for_ever() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings), actions_of(Visit(1, 0), Visit(1, 1), Visit(1, 2)))
    w.fly(until=phase(0, UavPhase.FLYING))
    w.mute.add("uav0")
    w.blind.add("uav0")
    w.fly(until=phase(0, UavPhase.LOST))
    asked = len(w.sent(Land, "uav0"))
    w.fly(limit_s=10.0)
    assert len(w.sent(Land, "uav0")) > asked
    assert not w.told(K.RECOVERED_FROM, "uav0"), "what nobody looks at any more is not over"
    w.mute.clear()  # it can hear again
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited)
    assert w.state.uavs[0].phase is UavPhase.LOST and not w.bodies["uav0"].airborne


def test_a_tumbled_uav_is_stopped_and_planned_without() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings), actions_of(Visit(1, 0), Visit(1, 1), Visit(1, 2)))
    w.fly(until=phase(0, UavPhase.FLYING))
    w.bodies["uav0"].tumbled = True
    w.fly()
    assert w.sent(StopMotors, "uav0") and not w.sent(StopMotors, "uav1")
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.uavs[0].phase is UavPhase.LOST


def test_a_uav_that_lands_by_itself_is_left_out() -> None:
    w = solo(planner=nothing_works)
    w.fly(until=phase(0, UavPhase.FLYING))
    w.fly(limit_s=3.0)
    body = w.bodies["uav0"]
    body.at, body.path, body.airborne, body.armed = (*body.at[:2], 0.0), [], False, False
    w.fly()
    assert "by itself" in w.told(K.UAV_DOWN)[0].text
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN


def test_a_refused_command_is_asked_for_again() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.FLYING))
    loose = w.settings
    w.settings = replace(loose, uavs=(replace(loose.uavs[0], max_speed_mps=5.0),))
    w.state = replace(w.state, uavs=(replace(w.state.uavs[0], order=None),))  # asked once more
    w.bodies["uav0"].path.clear()
    w.fly(limit_s=3.0)
    assert len(w.told(K.GATE_REFUSED)) == 1  # told once, however often it is asked for
    w.settings = loose
    w.fly()
    assert w.state.over and w.state.uavs[0].phase is UavPhase.DOWN


def test_a_refused_drive_is_asked_for_again() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings, SOLO), no_better)
    fence = replace(settings.geofence, polygon_m=((-9.0, -60.0), (50.0, -60.0), (50.0, 200.0), (-9.0, 200.0)))
    w.fly(until=lambda w: w.state.phase is M.ARMED)
    w.settings = replace(settings, geofence=fence)
    w.fly(limit_s=3.0)
    assert w.state.ugvs[0].phase is UgvPhase.HOLDING and w.told(K.GATE_REFUSED, "ugv0")
    w.settings = settings
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited)


# --- the UGV --------------------------------------------------------------------------------------------------------


def test_a_stuck_ugv_is_planned_without_until_it_moves_again() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, n_tasks=8, n_points=8, charge_s=10.0, uav={"waiting": "landed"})
    settings = world.settings(of=of, monitors={"ugv_stuck_s": 10.0})
    w = World(settings, world.plan(settings, (Move(0, 5), *(Visit(0, m) for m in range(8)))), no_better)
    w.fly(until=lambda w: w.state.ugvs[0].phase is UgvPhase.DRIVING)
    w.fly(limit_s=5.0)
    w.stalled.add("ugv0")
    w.fly(until=lambda w: len(w.requests) > 0 and w.state.ugvs[0].stuck and w.requests[-1].exclude_ugvs == (0,))
    assert w.told(K.UGV_STUCK, "ugv0")[0].action is Action.REPLAN_WITHOUT
    assert not w.state.ugvs[0].out
    w.stalled.clear()
    w.fly(until=lambda w: not w.state.ugvs[0].stuck)
    w.fly(limit_s=50.0)
    assert w.requests[-1].exclude_ugvs == () and "moves again" in w.requests[-1].reason
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_a_stuck_ugv_that_arrives_after_all() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, monitors={"ugv_stuck_s": 10.0, "ugv_stuck_m": 50.0})
    w = World(settings, world.plan(settings, (Move(0, 0), *(Visit(0, m) for m in range(3)))), no_better)
    w.fly(until=lambda w: w.bodies["ugv0"].at[0] > 60)
    w.stalled |= {"ugv0", "uav0"}
    w.fly(until=lambda w: w.state.ugvs[0].stuck)
    w.stalled.clear()
    w.fly(until=lambda w: bool(w.told(K.UGV_ARRIVED)))
    assert not w.state.ugvs[0].stuck and w.state.ugvs[0].site == 0 and not w.told(K.RECOVERED_FROM, "ugv0")
    assert "has arrived after all" in (w.state.replan_reason or "")
    w.fly()
    assert w.state.over


def test_a_ugv_that_another_one_blocks_for_ever_counts_as_stuck() -> None:
    of = world.problem(n_uavs=1, n_ugvs=2, charge_s=10.0)
    thresholds = {"ugv_stuck_s": 20.0, "ugv_off_road_m": 25.0}
    settings = world.settings(of=of, ugv={"park_offset_m": (0.0, 0.0)}, monitors=thresholds)
    actions = (Move(1, 0), Move(0, 1), Visit(0, 0), Visit(0, 1), Recharge(0, 0), Visit(0, 2))
    w = World(settings, world.plan(settings, actions), no_better)
    w.bodies["ugv0"].at = (-20.0, 0.0, 0.0)
    w.fly(until=lambda w: w.bodies["ugv1"].at[0] > 40)
    w.bodies["ugv1"].tumbled = True  # it stands on the only road from now on
    w.fly(until=lambda w: w.state.ugvs[0].stuck, limit_s=200)
    assert w.state.ugvs[0].stuck and w.told(K.CONFLICT_HELD, "ugv0")
    assert math.dist(w.bodies["ugv0"].at, w.bodies["ugv1"].at) >= settings.separation.ugv_m
    w.fly(limit_s=600)
    assert w.state.over


def test_a_ugv_without_a_road_asks_for_another_plan() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, roads=world.LineRoads(3, cut_beyond_m=50.0))
    w = World(settings, world.plan(settings, SOLO), actions_of(Visit(0, 0), Visit(0, 1), Visit(0, 2)))
    w.fly()
    assert "no road leads" in w.requests[1].reason and w.requests[1].urgent
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_a_dead_uav_on_its_dock_keeps_the_ugv_but_not_the_others() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, n_tasks=4, charge_s=30.0)
    settings = world.settings(of=of)
    actions = (
        Move(0, 0),
        Visit(0, 0),
        Visit(1, 1),
        Recharge(0, 0),
        Move(0, 1),
        Visit(1, 3),
        Recharge(1, 0),
        Visit(1, 2),
    )
    w = World(settings, world.plan(settings, actions), no_better)
    w.fly(until=lambda w: bool(w.told(K.RECHARGE_STARTED)))
    w.mute.add("uav0")  # its link is gone while it stands on the dock
    w.fly(limit_s=900)
    assert w.state.over and all(w.state.visited)
    assert w.bodies["ugv0"].at[0] == pytest.approx(100.0, abs=2.0)  # nobody drives with it aboard


def test_a_ugv_with_a_uav_at_its_dock_is_not_sent_to_another_one_at_the_end() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, n_tasks=3, charge_s=10.0)
    settings = world.settings(of=of)
    actions = (Move(0, 0), Visit(0, 0), Recharge(0, 0), Visit(1, 1), Visit(1, 2))
    w = World(settings, world.plan(settings, actions), no_better).fly(limit_s=300)
    assert w.state.phase is M.DONE and all(w.state.visited)


# --- energy ---------------------------------------------------------------------------------------------------------


def thirsty(**members) -> World:
    """The battery holds less than the plan believes: the UAV turns back before its rendezvous."""
    of = world.problem(n_uavs=1, n_ugvs=1, n_tasks=6, n_points=6, charge_s=10.0, reserve_j=9_000.0)
    settings = world.settings(of=of)
    actions = (Visit(0, 0), Visit(0, 1), Visit(0, 2), Move(0, 3), Recharge(0, 0), Visit(0, 3), Visit(0, 4), Visit(0, 5))
    w = World(settings, world.plan(settings, actions), **members)
    w.fly(until=lambda w: sum(w.state.visited) == 2)
    w.state = replace(w.state, uavs=(replace(w.state.uavs[0], energy_j=9_000.0),))
    return w


def test_a_uav_that_cannot_go_on_lands_and_is_rescued() -> None:
    w = thirsty(planner=actions_of(Move(0, 1), Recharge(0, 0), *(Visit(0, m) for m in range(2, 6))))
    w.fly()
    assert w.told(K.ENERGY_NO_RETURN, "uav0")[0].action is Action.DIVERT
    assert w.told(K.ENERGY_RENDEZVOUS) and w.requests[0].urgent
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.recharges == 1


def test_an_empty_uav_stays_on_the_ground_while_no_better_plan_comes() -> None:
    w = thirsty(planner=None)
    w.fly(until=phase(0, UavPhase.ON_PAD))
    begun = len(w.sent(TakeOff))
    w.fly(limit_s=120.0)
    assert len(w.sent(TakeOff)) == begun  # its old plan would end in the air
    assert w.told(K.PLANNER_LATE) and len(w.requests) > 1  # asked again: an answer that does not come is no answer


def test_energy_of_a_held_mission_brings_the_uav_down() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.FLYING))
    w.wish("hold")
    w.fly(limit_s=900.0, until=phase(0, UavPhase.ON_PAD))
    assert w.told(K.ENERGY_NO_RETURN) and w.state.phase is M.HOLDING
    assert not w.bodies["uav0"].airborne


def test_nothing_works_brings_everybody_down() -> None:
    w = thirsty(planner=nothing_works)
    w.fly()
    assert w.told(K.PLANNER_INFEASIBLE) and w.state.over
    assert w.state.uavs[0].phase is UavPhase.DOWN


# --- replanning -----------------------------------------------------------------------------------------------------


def test_drift_within_slack_asks_for_nothing() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, replanning={"loss_ratio": 0.5})
    w = World(settings, world.plan(settings, SOLO), no_better, slow={"ugv0": 0.7}).fly()
    assert w.state.phase is M.DONE and not w.requests and not w.told(K.SCHEDULE_DRIFT)


def test_drift_beyond_the_threshold_asks_once_per_interval() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, replanning={"interval_s": 20.0})
    w = World(settings, world.plan(settings, SOLO), no_better, slow={"ugv0": 0.2}).fly()
    times = [e.time_s for e in w.told(K.PLAN_REQUESTED)]
    assert len(times) >= 2 and all(b - a >= 20.0 - 1e-6 for a, b in pairwise(times))
    assert w.told(K.PLAN_KEPT) and not w.told(K.PLAN_ADOPTED)


def test_the_interval_is_in_mission_time() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    frame = world.Frame(time_scale=2.0)
    settings = world.settings(of=of, frame=frame, replanning={"interval_s": 20.0})
    w = World(settings, world.plan(settings, SOLO), no_better, slow={"ugv0": 0.1}).fly()
    times = [e.time_s for e in w.told(K.PLAN_REQUESTED)]
    assert len(times) >= 2 and all(b - a >= 40.0 - 1e-6 for a, b in pairwise(times))


def detour(first: int) -> tuple:
    return (Visit(0, first), *(Visit(0, m) for m in range(4) if m != first))


def test_a_much_better_reply_is_adopted() -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings, detour(3)), actions_of(*detour(0))).fly()
    assert w.state.plan.number == 1 and w.told(K.PLAN_ADOPTED) and w.state.phase is M.DONE


@pytest.mark.parametrize(("ratio", "adopted"), [(0.02, True), (0.9, False)])
def test_a_reply_must_be_better_by_the_wanted_share(ratio: float, adopted: bool) -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of, replanning={"adopt_ratio": ratio})
    w = World(settings, world.plan(settings, detour(3)), actions_of(*detour(0))).fly()
    assert bool(w.told(K.PLAN_ADOPTED)) is adopted and w.state.phase is M.DONE and all(w.state.visited)


def test_what_a_reply_says_of_itself_is_told_with_the_plan() -> None:
    def noted(request: PlanRequest) -> PlanReply:
        return replace(actions_of(*detour(0))(request), note="search took over: no weights")

    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings, detour(3)), noted).fly()
    assert w.told(K.PLAN_ADOPTED)[0].text.endswith("; search took over: no weights")


def test_a_late_reply_is_told_and_still_taken() -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of, monitors={"planner_late_s": 3.0})
    w = World(settings, world.plan(settings, detour(3)), actions_of(*detour(0)), reply_after_s=5.0).fly()
    assert len(w.told(K.PLANNER_LATE)) == len(w.requests) and w.told(K.PLAN_ADOPTED)
    assert w.told(K.PLANNER_LATE)[0].action is Action.WARN


def test_a_reply_with_a_stale_number_is_ignored() -> None:
    def stale(request: PlanRequest) -> PlanReply:
        return replace(actions_of(*detour(0))(request), number=request.number - 1)

    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of)
    w = World(settings, world.plan(settings, detour(3)), stale)
    w.fly(limit_s=8.0)
    assert w.requests and not w.told(K.PLAN_ADOPTED) and w.state.pending is not None


def test_a_planner_that_never_answers_does_not_keep_the_mission_from_ending() -> None:
    w = solo(planner=None, slow={"ugv0": 0.2}).fly()
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_tasks_visited_while_planning_are_not_visited_again() -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of, monitors={"planner_late_s": 100.0})
    w = World(settings, world.plan(settings, detour(3)), None)
    w.fly(until=lambda w: bool(w.requests))
    reply = actions_of(Visit(0, 3), Visit(0, 2), Visit(0, 1), Visit(0, 0))(w.requests[0])
    w.fly(until=lambda w: sum(w.state.visited) == 1)
    w.replies = [(w.now_s, reply)]
    w.fly()
    assert w.told(K.PLAN_ADOPTED) and w.state.phase is M.DONE
    assert len(w.told(K.TASK_VISITED)) == 4


def test_a_recharge_begun_while_planning_is_not_done_again() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, n_tasks=4, charge_s=30.0)
    settings = world.settings(of=of, replanning={"loss_ratio": 0.001})
    actions = (Move(0, 0), Visit(0, 0), Visit(0, 1), Recharge(0, 0), Visit(0, 3), Visit(0, 2))
    w = World(settings, world.plan(settings, actions), None)
    w.fly(until=phase(0, UavPhase.WAITING))
    request = w.requests[-1] if w.state.pending is not None else None
    assert request is not None
    reply = PlanReply(request.number, True, (Recharge(0, 0), Visit(0, 2), Visit(0, 3)), "test", 0.1)
    w.fly(until=phase(0, UavPhase.CHARGING))
    w.replies = [(w.now_s, reply)]
    w.fly(limit_s=0.3)
    if w.told(K.PLAN_ADOPTED):
        assert w.state.plan.actions == (Visit(0, 2), Visit(0, 3)) and w.state.uavs[0].phase is UavPhase.CHARGING
    w.planner = no_better
    w.fly()
    assert w.state.phase is M.DONE and w.state.recharges == 1 and len(w.told(K.TASK_VISITED)) == 4


def test_a_reply_that_no_longer_fits_asks_again_instead_of_giving_up() -> None:
    w = thirsty(planner=None)
    w.fly(until=lambda w: bool(w.requests))
    answers = actions_of(Visit(0, 2), Visit(0, 3), Visit(0, 4), Visit(0, 5))  # what it asks for cannot be flown now
    w.replies = [(w.now_s, replace(answers(w.requests[0]), usable=True))]
    w.planner = actions_of(Move(0, 1), Recharge(0, 0), *(Visit(0, m) for m in range(2, 6)))
    w.fly()
    assert not w.told(K.PLANNER_INFEASIBLE)
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_a_kept_plan_does_not_wait_for_those_who_are_gone() -> None:
    of = world.problem(n_uavs=2, n_ugvs=1, n_tasks=4, charge_s=10.0)
    settings = world.settings(of=of)
    actions = (
        Move(0, 0), Visit(1, 0), Recharge(1, 0), Move(0, 1), Visit(0, 1), Visit(0, 2), Recharge(0, 0), Visit(0, 3),
    )  # fmt: skip
    w = World(settings, world.plan(settings, actions), no_better)
    w.fly(until=lambda w: w.state.visited[0])
    w.bodies["uav1"].tumbled = True  # after its last task: its recharge is all that is left of it in the plan
    w.fly(limit_s=600)
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.recharges == 1


def test_a_kept_plan_does_not_wait_for_a_ugv_that_is_gone() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, n_tasks=4, capacity_j=200_000.0, charge_s=10.0)
    settings = world.settings(of=of)
    actions = (Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(0, 1), Visit(0, 2), Visit(0, 3))
    w = World(settings, world.plan(settings, actions), no_better)
    w.fly(until=lambda w: w.state.ugvs[0].phase is UgvPhase.DRIVING)
    w.bodies["ugv0"].tumbled = True
    w.fly(limit_s=600)
    assert w.sent(StopMotors, "ugv0") and w.state.phase is M.DONE and all(w.state.visited)


def test_with_all_uavs_gone_the_rest_comes_to_its_end() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.FLYING))
    w.bodies["uav0"].tumbled = True
    w.fly()
    assert "no UAV can take part" in w.told(K.PLANNER_INFEASIBLE)[0].text
    assert w.state.over and w.state.ugvs[0].phase is not UgvPhase.DRIVING


def test_with_the_override_the_plan_is_flown_as_far_as_it_goes() -> None:
    of = world.problem(n_uavs=1, n_ugvs=1, charge_s=10.0)
    settings = world.settings(of=of, failsafe={"planner_infeasible": "warn"})
    w = World(settings, world.plan(settings, SOLO), nothing_works)
    w.fly(until=phase(0, UavPhase.FLYING))
    w.bodies["uav0"].tumbled = True
    w.fly()
    assert w.told(K.PLANNER_INFEASIBLE)[0].action is Action.WARN and w.state.over


# --- the operator ---------------------------------------------------------------------------------------------------


def test_hold_and_resume() -> None:
    w = solo()
    w.fly(until=lambda w: len(w.sent(GoTo)) == 1)
    w.wish("hold")
    assert w.state.phase is M.HOLDING and w.sent(Hold, "uav0") and w.sent(Hold, "ugv0")
    at = w.bodies["uav0"].at
    w.fly(limit_s=10.0)
    assert math.dist(w.bodies["uav0"].at, at) < 1.5
    w.wish("resume")
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited)


def test_a_reply_that_comes_while_held_does_not_stop_replanning() -> None:
    of = world.problem(n_uavs=1, n_ugvs=0, n_tasks=4, capacity_j=200_000.0)
    settings = world.settings(of=of, replanning={"interval_s": 5.0})
    w = World(settings, world.plan(settings, detour(3)), actions_of(*detour(0)), reply_after_s=2.0)
    w.fly(until=lambda w: bool(w.requests))
    w.wish("hold")
    w.fly(limit_s=5.0)
    w.wish("resume")
    w.fly()
    assert len(w.requests) >= 2 and w.state.phase is M.DONE and all(w.state.visited)


def test_hold_at_every_moment_of_a_docking_and_resume() -> None:
    w = solo()
    for want in (UavPhase.TAKING_OFF, UavPhase.WAITING, UavPhase.DOCKING, UavPhase.CHARGING):
        w.fly(until=phase(0, want))
        w.wish("hold")
        w.fly(limit_s=4.0)
        w.wish("resume")
    w.fly()
    assert w.state.phase is M.DONE and all(w.state.visited) and w.state.recharges == 1


@pytest.mark.parametrize("at", [UavPhase.TAKING_OFF, UavPhase.FLYING, UavPhase.WAITING, UavPhase.DOCKING,
                                UavPhase.CHARGING])  # fmt: skip
def test_recover_from_everywhere(at: UavPhase) -> None:
    w = solo()
    w.fly(until=phase(0, at))
    w.wish("recover")
    w.fly(limit_s=120)
    assert w.state.phase is M.ABORTED and w.state.uavs[0].phase is UavPhase.DOWN
    assert not w.bodies["uav0"].airborne and w.sent(Disarm, "uav0") and w.sent(Disarm, "ugv0")


def test_recover_before_arming_leaves_nobody_armed() -> None:
    w = solo(auto_start=False, deaf={"uav0"})
    w.wish("checked")
    w.wish("arm")
    w.fly(limit_s=1.0)
    assert w.state.phase is M.CHECKED and w.bodies["ugv0"].armed
    w.wish("recover")
    assert w.state.phase is M.ABORTED and not w.bodies["ugv0"].armed


@pytest.mark.parametrize("at", list(UavPhase))
def test_stop_from_everywhere(at: UavPhase) -> None:
    w = solo(planner=nothing_works)
    if at is UavPhase.LOST:
        w.fly(until=phase(0, UavPhase.FLYING))
        w.mute.add("uav0")
        w.blind.add("uav0")
    w.fly(until=phase(0, at))
    w.wish("stop")
    assert w.state.phase is M.ABORTED
    assert {c.vehicle for c in w.sent(StopMotors)} == {"uav0", "ugv0"}
    w.mute.clear()
    for _ in range(50):
        w.turn()
        w.now_s += 0.1
    assert all(b.locked and not b.airborne for b in w.bodies.values())


def test_stop_is_obeyed_although_a_command_was_just_refused_and_the_link_is_bad() -> None:
    w = solo()
    w.fly(until=phase(0, UavPhase.FLYING))
    goto = GoTo("uav0", (100.0, 50.0, 10.0), 10.0)
    w.refusals = (fake_world.Refusal(goto, "test"),)
    w.deaf.add("uav0")
    w.wish("stop")
    w.deaf.clear()
    for _ in range(40):
        w.now_s += 0.1
        w.turn()
    assert w.bodies["uav0"].locked


def test_expired_checks_or_those_of_another_plan_do_not_arm() -> None:
    w = solo(auto_start=False)
    w.turn((fake_world.OperatorInput("checked", "another", math.inf),))
    assert w.state.phase is M.DISARMED
    w.turn((fake_world.OperatorInput("checked", w.plan.digest, 5.0),))
    assert w.state.phase is M.CHECKED
    w.now_s = 6.0
    w.turn((fake_world.OperatorInput("arm"),))
    w.fly(limit_s=3.0)
    assert w.state.phase is M.CHECKED and not w.commands
    assert "no effect" in w.events[-1].text
