"""Corners of dispatch, re-timing and waking that no mission passes by itself."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import world
from test_supervisor_table import ACTIONS, NOW, SETTINGS, G, P, scene, seen, uav_in, ugv_in

from deploy import dispatch, dispatch_ugv, monitors, replanning, retime, supervisor
from deploy.events import Action, EventKind
from deploy.flightpath import along, resting, straight
from deploy.settings import Separation
from deploy.state import MissionPhase, Order
from deploy.wake import wake_s
from drivers.vehicle import Arm, Disarm, Drive, GoTo, Hold, Land, TakeOff
from planner.plan import Move, Recharge, Visit


def turn_of(*uavs, ugvs=None, actions=ACTIONS, **members):
    return world.turn(
        SETTINGS, now_s=NOW, uavs=uavs or (world.uav(0, now_s=NOW), world.uav(1, now_s=NOW)),
        ugvs=ugvs or (ugv_in(G.PARKED), ugv_in(G.PARKED, 1)), actions=actions, phase=MissionPhase.RUNNING, **members,
    )  # fmt: skip


def test_a_uav_with_energy_for_nothing_else_lands_where_it_is() -> None:
    state = scene(SETTINGS, replace(uav_in(P.FLYING), energy_j=1_500.0, diverting=True), ugv_in(G.PARKED))
    result = supervisor.step(SETTINGS, state, seen(state))
    told = [e for e in result.events if e.kind is EventKind.ENERGY_NO_RETURN]
    assert told[-1].action is Action.LAND_HERE and result.state.uavs[0].phase is P.LANDING
    assert Land("uav0", 1.5) in result.commands


@pytest.mark.parametrize(("energy_j", "lands"), [(1_800.0, True), (2_100.0, False)])
def test_a_docking_that_does_not_come_down_ends_in_a_landing_before_it_falls(energy_j: float, lands: bool) -> None:
    docking = replace(uav_in(P.DOCKING, (99.0, 0.0, 10.0)), docked=(0, 0), energy_j=energy_j)  # 9.5 m above the dock
    turn = turn_of(docking, world.uav(1, now_s=NOW))
    dispatch.advance(turn, 0)
    assert (turn.uavs[0].phase is P.LANDING) is lands and (Land("uav0", 1.5) in turn.commands) is lands


def test_a_landing_waits_for_the_uav_below() -> None:
    above = replace(uav_in(P.FLYING, (0.0, 0.0, 10.0)), order=None)
    below = replace(uav_in(P.FLYING, (1.0, 0.0, 4.0)), index=1)
    turn = turn_of(above, replace(below, path=resting((1.0, 0.0, 4.0), NOW)), actions=(Visit(1, 1),))
    dispatch.advance(turn, 0)
    assert turn.uavs[0].phase is P.FLYING and not turn.commands
    assert EventKind.CONFLICT_HELD in turn.uavs[0].active and turn.uavs[0].retry_s > NOW


JUST_APART = replace(SETTINGS, separation=Separation(vertical_m=5.0, buffer_m=1.0))  # the layers are 6 m apart


@pytest.mark.parametrize(
    "order", [GoTo("uav0", (60.0, 50.0, 10.0), 10.0), TakeOff("uav0", 10.0, 2.0), Hold("uav0"), None]
)
@pytest.mark.parametrize(
    ("low_m", "high_m", "path_m", "goes"),
    [
        (0.0, 0.0, 0.0, True),
        (0.3, 0.0, 0.0, True),
        (0.3, -0.1, 0.0, True),
        (0.0, -0.4, -0.4, True),  # it was told to hold where it was
        (-0.6, 0.0, 0.0, True),
        (0.45, -0.1, 0.0, False),  # as near as flights are stopped at
        (0.3, -0.3, -0.3, False),
        (0.6, 0.0, 0.0, False),
        (0.0, -0.6, 0.0, False),
        (0.0, 0.0, -0.6, False),
    ],
)
def test_a_uav_passes_below_one_that_hovers_as_far_as_flights_are_not_stopped(
    order, low_m: float, high_m: float, path_m: float, goes: bool
) -> None:
    at, above = (60.0, 50.0, 10.0 + low_m), (65.0, 50.0, 16.0 + high_m)
    given = None if order is None else Order(order, NOW - 9.0, NOW - 9.0)
    low = replace(uav_in(P.FLYING, at), order=given, path=resting(at, NOW - 9.0))
    high = replace(uav_in(P.FLYING, above), index=1, path=resting((65.0, 50.0, 16.0 + path_m), NOW - 9.0))
    turn = world.turn(
        JUST_APART, now_s=NOW, uavs=(low, high), ugvs=(ugv_in(G.PARKED), ugv_in(G.PARKED, 1)), actions=(Visit(0, 0),),
        phase=MissionPhase.RUNNING,
    )  # fmt: skip
    dispatch.advance(turn, 0)
    assert (GoTo("uav0", (100.0, 50.0, 10.0), 10.0) in turn.commands) is goes
    assert (EventKind.CONFLICT_HELD in turn.uavs[0].active) is not goes


def test_a_flight_below_one_that_moves_keeps_the_whole_buffer() -> None:
    low = replace(uav_in(P.FLYING, (60.0, 50.0, 10.3)), order=None)
    high = replace(
        uav_in(P.FLYING, (100.0, 50.0, 16.0)), index=1,
        path=straight((100.0, 50.0, 16.0), (60.0, 50.0, 16.0), NOW, 10.0, 4.0),
    )  # fmt: skip
    turn = world.turn(
        JUST_APART, now_s=NOW, uavs=(low, high), ugvs=(ugv_in(G.PARKED), ugv_in(G.PARKED, 1)), actions=(Visit(0, 0),),
        phase=MissionPhase.RUNNING,
    )  # fmt: skip
    dispatch.advance(turn, 0)
    assert EventKind.CONFLICT_HELD in turn.uavs[0].active


def test_a_uav_off_its_path_wakes_when_it_counts() -> None:
    state = scene(SETTINGS, replace(uav_in(P.FLYING), off_path_since_s=NOW - 0.9, order=None), ugv_in(G.PARKED))
    assert wake_s(SETTINGS, replace(state, review_s=NOW), NOW) == pytest.approx(NOW + 0.1)


def test_a_uav_on_a_dock_waits_for_the_column_above_it() -> None:
    full = world.uav(0, (99.0, 0.0, 0.5), NOW, docked=(0, 0), site=0, action=None)
    coming = replace(uav_in(P.DOCKING), index=1, docked=(0, 1))
    turn = turn_of(full, coming, actions=(Visit(0, 0), Visit(1, 1), Move(0, 1)))
    dispatch.advance(turn, 0)
    assert turn.uavs[0].phase is P.ON_PAD and not turn.commands


def test_a_ugv_that_is_not_armed_is_armed_before_it_drives() -> None:
    ugv = replace(world.ugv(0, now_s=NOW, site=3), telemetry=world.report("ugv0", NOW, armed=False))
    turn = turn_of(ugvs=(ugv, ugv_in(G.PARKED, 1)))
    dispatch_ugv.advance(turn, 0)
    assert turn.commands == [Arm("ugv0")] and turn.ugvs[0].phase is G.PARKED


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ([(0.0, 0.0), (10.0, 0.0)], [(0.0, -2.0), (10.0, -2.0)]),
        ([(0.0, 0.0), (10.0, 0.0), (10.0, 10.0)], [(0.0, -2.0), (12.0, -2.0), (12.0, 10.0)]),
        ([(0.0, 0.0), (0.0, 0.0)], [(0.0, 0.0), (0.0, 0.0)]),
        ([(0.0, 0.0), (0.0, 0.0), (10.0, 0.0)], [(0.0, -2.0), (10.0, -2.0)]),
        ([(3.0, 4.0)], [(3.0, 4.0)]),
    ],
)
def test_keeping_right(line, expected) -> None:
    assert dispatch_ugv.keep_right(line, 2.0) == [pytest.approx(p) for p in expected]
    assert dispatch_ugv.keep_right(line, 0.0) == line


def test_the_way_left_on_a_route_with_a_point_given_twice() -> None:
    assert dispatch_ugv.left_on_route_m(((0.0, 0.0), (0.0, 0.0), (10.0, 0.0)), (4.0, 1.0)) == pytest.approx(6.0)


def test_units_never_seen_are_planned_as_the_mission_says() -> None:
    turn = turn_of(world.uav(0, now_s=NOW), replace(world.uav(1, now_s=NOW), track=None),
                   ugvs=(ugv_in(G.DRIVING), replace(ugv_in(G.PARKED, 1), track=None)))  # fmt: skip
    problem = retime.problem_now(turn)
    assert problem.uavs[1].position == (0.0, 0.0) and problem.ugvs[1].energy_j == 1e6
    assert problem.ugvs[0].distance_to_m is not None
    assert retime.excluded(turn) == ((1,), (1,))


def test_a_uav_docked_at_a_ugv_between_sites_is_where_it_is_seen() -> None:
    turn = turn_of(uav_in(P.CHARGING), world.uav(1, now_s=NOW), ugvs=(ugv_in(G.HOLDING), ugv_in(G.PARKED, 1)))
    assert retime.problem_now(turn).uavs[0].position == (99.0, 0.0)


def test_an_earlier_move_or_guest_keeps_a_rendezvous_from_being_ready() -> None:
    actions = (Move(0, 0), Recharge(0, 0), Recharge(1, 0))
    turn = turn_of(actions=actions)
    assert not turn.rendezvous_ready(1)  # the move is not done yet
    turn.mark_done(0)
    assert turn.rendezvous_ready(1)
    parked = turn.ugvs[0]
    assert parked.track is not None and turn.in_its_place(parked)
    x, y, z = parked.track.position_m
    away_m = turn.settings.monitors.ugv_off_road_m + 0.1
    turn.ugvs[0] = replace(parked, track=replace(parked.track, position_m=(x + away_m, y, z)))
    assert not turn.rendezvous_ready(1)  # a false pose: the UGV stopped elsewhere
    assert not turn.in_its_place(replace(parked, site=None)) and not turn.in_its_place(replace(parked, track=None))
    turn.ugvs[0] = parked
    turn.uavs[1] = replace(uav_in(P.DOCKING), index=1, docked=(0, 1))
    assert not turn.rendezvous_ready(1)


@pytest.mark.parametrize(("armed", "seen_it"), [(False, True), (True, False)])
def test_a_disarming_is_confirmed_by_telemetry(armed: bool, seen_it: bool) -> None:
    uav = replace(world.uav(0, now_s=NOW), telemetry=world.report("uav0", NOW, armed=armed),
                  order=Order(Disarm("uav0"), NOW, NOW))  # fmt: skip
    assert turn_of().confirm(uav, 10.0).order.confirmed is seen_it


def test_nothing_is_confirmed_before_it_has_been_heard() -> None:
    uav = replace(world.uav(0, now_s=NOW), telemetry=None, order=Order(Hold("uav0"), NOW, NOW))
    assert not turn_of().confirm(uav, 10.0).order.confirmed


def test_a_command_without_effect_is_given_up_but_hold_land_and_drive_are_not() -> None:
    for command, goes_on in ((Arm("uav0"), False), (Hold("uav0"), True), (Land("uav0", 1.0), True)):
        turn = turn_of()
        turn.order(replace(turn.uavs[0], order=Order(command, NOW - 20, NOW - 3, attempts=5)), command)
        assert bool(turn.commands) is goes_on
    turn = turn_of()
    drive = Drive("ugv0", ((0.0, 0.0), (9.0, 0.0)), 5.0)
    turn.order(replace(turn.ugvs[0], order=Order(drive, NOW - 20, NOW - 3, attempts=9)), drive)
    assert turn.commands == [drive]


def test_drift_may_be_only_noted() -> None:
    of = replace(SETTINGS, failsafe={"schedule_drift": "note"})
    turn = world.turn(of, now_s=NOW, uavs=(world.uav(0, now_s=NOW), world.uav(1, now_s=NOW)),
                      ugvs=(world.ugv(0, now_s=NOW, site=3), world.ugv(1, now_s=NOW, site=3)),
                      phase=MissionPhase.RUNNING, start_s=-1000.0)  # fmt: skip
    replanning.review(turn)
    assert EventKind.SCHEDULE_DRIFT in [e.kind for e in turn.events] and turn.request is None


def test_waking_for_units_that_were_never_seen_or_heard_and_for_a_service() -> None:
    uav = replace(uav_in(P.FLYING), work_until_s=NOW + 0.4, track=None, telemetry=None, order=None)
    state = replace(scene(SETTINGS, uav, ugv_in(G.PARKED)), review_s=NOW)
    assert wake_s(SETTINGS, state, NOW) == pytest.approx(NOW + 0.4)


def test_a_step_before_anybody_was_seen() -> None:
    state = world.state(SETTINGS)
    result = supervisor.step(SETTINGS, state, world.observation(1.0))
    assert result.state.uavs[0].track is None and not result.commands and not math.isnan(result.state.uavs[0].energy_j)
    assert state.units == (*state.uavs, *state.ugvs)


def test_the_first_climb_is_counted_once() -> None:
    of = world.settings(of=world.problem(uav={"energy_j": 58_850.0, "ready_s": 5.0}))
    assert supervisor.initial(of, world.plan(of)).uavs[0].energy_j == pytest.approx(60_000)


@pytest.mark.parametrize(("energy_j", "rescued"), [(30_000.0, False), (8_000.0, False), (7_000.0, True)])
def test_a_replan_counts_the_climb_and_may_use_the_same_reserve_when_it_comes(energy_j: float, rescued: bool) -> None:
    turn = turn_of(world.uav(0, now_s=NOW, energy_j=energy_j, site=None), world.uav(1, now_s=NOW))
    asked, judged = retime.problem_now(turn).uavs[0], retime.problem_now(turn, tolerance=0.02).uavs[0]
    climb_j = 230 * 6.0  # 10 m at 2 m/s, from rest to rest
    assert asked.ready_s == pytest.approx(6.0) and asked.energy_j == pytest.approx(energy_j - climb_j)
    assert asked.reserve_j == pytest.approx((energy_j - climb_j) / 2 if rescued else 6_000)
    assert judged.reserve_j <= asked.reserve_j


def test_when_all_is_done_no_replan_keeps_the_mission_from_ending() -> None:
    turn = turn_of(actions=(), visited=(True,) * len(SETTINGS.problem.tasks))
    turn.want_replan("a wish that came too late", urgent=True)
    replanning.review(turn)
    assert turn.request is None and turn.state.replan_reason is None and replanning.finished(turn)


def driving(at_m: float, left_m: float, index: int = 0, **members):
    route = ((0.0, -4.0 * index), (100.0, -4.0 * index))
    path = along(route, 0.0, NOW - 20.0, 5.0)  # by the clock it has just arrived
    drive = Order(Drive(f"ugv{index}", route, 5.0), NOW - 20.0, NOW)
    ugv = world.ugv(index, (at_m, -4.0 * index, 0.0), NOW, phase=G.DRIVING, site=None, target=0, route_m=route)
    return replace(ugv, path=path, left_m=left_m, order=drive, **members)


def test_a_ugv_that_is_late_is_in_the_way_where_it_is() -> None:
    for late in (driving(60.0, 40.0), driving(60.0, 40.0, stuck=True)):
        turn = turn_of(ugvs=(late, world.ugv(1, (40.0, 0.0, 0.0), NOW, site=None, phase=G.HOLDING)))
        way = turn.way_of(late)
        assert way is not None and way.at(NOW) == pytest.approx((60.0, 0.0, 0.0))
        assert way.end_m[0] == (60.0 if late.stuck else 100.0)
        assert turn.ugv_in_the_way(1, along(((40.0, 0.0), (62.0, 0.0)), 0.0, NOW, 5.0)) == "ugv0"


def test_of_two_ugvs_too_near_the_one_that_moves_stops() -> None:
    stuck = driving(60.0, 40.0, stuck=True)
    mover = replace(driving(55.0, 45.0, 1), track=world.track((55.0, 0.0, 0.0), NOW))
    mover = replace(mover, path=along(((55.0, 0.0), (100.0, 0.0)), 0.0, NOW, 5.0))
    for pair in ((stuck, mover), (replace(mover, index=0), replace(stuck, index=1))):
        turn = turn_of(ugvs=pair)
        named = [f.vehicle for f in monitors.findings(turn) if f.kind is EventKind.SEPARATION]
        assert named == [f"ugv{next(g.index for g in pair if not g.stuck)}"]


def test_a_uav_that_is_late_is_in_the_way_where_it_is() -> None:
    late = replace(
        uav_in(P.FLYING, (40.0, 0.0, 10.0)), path=straight((0.0, 0.0, 10.0), (100.0, 0.0, 10.0), NOW - 15, 10.0, 2.0)
    )
    late = replace(late, order=Order(GoTo("uav0", (100.0, 0.0, 10.0), 10.0), NOW - 15, NOW))
    turn = turn_of(late, world.uav(1, (40.0, 6.0, 10.0), NOW))
    assert turn.way_of(late).at(NOW) == pytest.approx((40.0, 0.0, 10.0))
    assert turn.uav_in_the_way(1, resting((42.0, 0.0, 10.0), NOW)) == "uav0"
    there = replace(late, path=resting((100.0, 0.0, 10.0), NOW))
    assert turn.way_of(there) is not None


def test_a_drive_near_another_ugv_is_looked_at_often() -> None:
    mover = replace(driving(60.0, 40.0), order=None, path=None, progress_s=NOW)
    for other, soon in ((world.ugv(1, (70.0, 0.0, 0.0), NOW), True), (world.ugv(1, (400.0, 0.0, 0.0), NOW), False)):
        turn = turn_of(ugvs=(mover, other), review_s=NOW)
        woken = wake_s(SETTINGS, replace(turn.state, ugvs=(mover, other), uavs=tuple(turn.uavs)), NOW)
        assert woken == pytest.approx(NOW + (0.2 if soon else 1.0))
    unseen = replace(world.ugv(1), track=None)
    assert wake_s(SETTINGS, replace(turn.state, ugvs=(mover, unseen), uavs=tuple(turn.uavs)), NOW) > NOW + 0.2


def test_a_drive_to_where_it_stands_is_an_arrival() -> None:
    settings = world.settings(n_uavs=2, n_ugvs=2, ugv={"park_offset_m": (0.0, 0.0)})
    standing = world.ugv(0, (*settings.park_m(0, 0), 0.0), NOW, phase=G.HOLDING, site=None, target=0)
    turn = world.turn(
        settings, now_s=NOW, uavs=(world.uav(0, now_s=NOW), world.uav(1, now_s=NOW)),
        ugvs=(standing, ugv_in(G.PARKED, 1)), actions=(Move(0, 0),), phase=MissionPhase.RUNNING,
    )  # fmt: skip
    dispatch_ugv.advance(turn, 0)
    assert turn.ugvs[0].phase is G.PARKED and turn.ugvs[0].site == 0 and turn.plan.done == (True,)
    assert not [c for c in turn.commands if isinstance(c, Drive)]


def test_a_plan_that_counts_on_landed_waiting_is_judged_with_it() -> None:
    turn = turn_of()
    hovering, landed = retime.problem_now(turn), retime.problem_now(turn, landed=True)
    assert {u.waiting for u in landed.uavs} == {"landed"}
    up_and_down_s = max(retime.landing_s(turn.settings))
    assert landed.ugvs[0].dock_s == pytest.approx(hovering.ugvs[0].dock_s + up_and_down_s)
    assert landed.uavs[0].reserve_j > hovering.uavs[0].reserve_j
