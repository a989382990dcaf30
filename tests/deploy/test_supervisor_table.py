"""Every phase of a vehicle against every event, every phase of the mission against every wish: what becomes of it."""

from __future__ import annotations

import math
from dataclasses import fields, is_dataclass, replace

import pytest
import world

from deploy import dispatch, dispatch_ugv, supervisor
from deploy.events import Action, EventKind, Severity
from deploy.failsafe import UAV_SITUATION, UGV_SITUATION, Situation, action_for
from deploy.flightpath import resting, straight
from deploy.observation import Observation, OperatorInput, PlanReply, Refusal
from deploy.settings import Settings
from deploy.state import AIRBORNE, MissionPhase, Order, State, UavPhase, UavState, UgvPhase, UgvState
from drivers.vehicle import Arm, Disarm, Dock, Drive, GoTo, Hold, Land, StopMotors, TakeOff
from planner.plan import Move, Recharge, Visit

K, M, P, G = EventKind, MissionPhase, UavPhase, UgvPhase
NOW = 100.0
ACTIONS = (Move(0, 0), Visit(0, 0), Visit(1, 1), Recharge(0, 0), Visit(0, 2))
MOTION = TakeOff | GoTo | Dock | Drive
HIGH = (50.0, 25.0, 10.0)
SETTINGS = world.settings(n_uavs=2, n_ugvs=2)

UAV_CONDITIONS = (
    K.POSE_STALE, K.POSE_LOST, K.POSE_FROZEN, K.POSE_JUMP, K.POSE_SWAP, K.TELEMETRY_STALE, K.LINK_LOST,
    K.TRACKING_ERROR, K.GEOFENCE_SOFT, K.GEOFENCE_HARD, K.SEPARATION, K.TUMBLED, K.COMMAND_FAILED,
    K.ENERGY_NO_RETURN,
)  # fmt: skip
UGV_CONDITIONS = (
    K.POSE_STALE, K.POSE_LOST, K.POSE_FROZEN, K.POSE_JUMP, K.POSE_SWAP, K.TELEMETRY_STALE, K.LINK_LOST,
    K.GEOFENCE_SOFT, K.GEOFENCE_HARD, K.SEPARATION, K.TUMBLED, K.UGV_OFF_ROAD, K.UGV_STUCK, K.COMMAND_FAILED,
)  # fmt: skip


def uav_in(phase: P, at=None) -> UavState:
    """UAV 0, well and in ``phase``."""
    ground = phase in (P.ON_PAD, P.CHARGING, P.DOWN)
    low = (50.0, 25.0, 5.0) if phase is P.TAKING_OFF else HIGH
    at = at or ((99.0, 0.0, 0.0) if phase is P.CHARGING else (50.0, 25.0, 0.0) if ground else low)
    command = {
        P.TAKING_OFF: TakeOff("uav0", 10.0, 2.0), P.FLYING: GoTo("uav0", (100.0, 50.0, 10.0), 10.0),
        P.WAITING: GoTo("uav0", (100.0, 0.0, 10.0), 10.0), P.DOCKING: Dock("uav0", "ugv0", 0, 1.5, 10.0),
        P.LANDING: Land("uav0", 1.5),
    }.get(phase)  # fmt: skip
    goal = command.position_m if isinstance(command, GoTo) else at
    return world.uav(
        0,
        at,
        NOW,
        phase=phase,
        since_s=NOW - 5.0,
        telemetry=world.report("uav0", NOW, airborne=not ground, charging=phase is P.CHARGING),
        order=None if command is None else Order(command, NOW - 1.0, NOW - 1.0),
        path=None if ground or phase is P.LOST else straight(at, goal, NOW - 1.0, 10.0, 2.0),
        docked=(0, 0) if phase in (P.DOCKING, P.CHARGING) else None,
        action=3 if phase in (P.DOCKING, P.CHARGING) else None,
        charge_from_j=20_000.0,
        energy_j=30_000.0,
        lowest_m=10.0,
        site=0 if phase is P.WAITING else None,
        out=phase in (P.DOWN, P.LOST),
    )


def ugv_in(phase: G, index: int = 0) -> UgvState:
    """UGV 0, well and in ``phase``, on the road."""
    way = phase in (G.DRIVING, G.HOLDING)
    x = 40.0 if way else 100.0
    route = ((20.0, 0.0), (100.0, 0.0))
    return world.ugv(
        index,
        (x, 0.0, 0.0),
        NOW,
        phase=phase,
        since_s=NOW - 5.0,
        site=None if way else 0,
        target=0 if way else None,
        route_m=route if way else (),
        left_m=100.0 - x,
        progress_m=100.0 - x,
        path=straight((x, 0.0, 0.0), (100.0, 0.0, 0.0), NOW, 5.0, 1.0) if phase is G.DRIVING else None,
        order=Order(Drive("ugv0", route, 5.0), NOW - 1.0, NOW - 1.0) if phase is G.DRIVING else None,
        out=phase is G.LOST,
    )


def scene(of: Settings, uav: UavState, ugv: UgvState, phase: M = M.RUNNING, done: int = 0) -> State:
    """Both in the middle of a mission; UAV 1 and UGV 1 stand aside, well."""
    first = world.state(of, ACTIONS)
    done = 3 if uav.phase in (P.WAITING, P.DOCKING, P.CHARGING) else done
    other = world.uav(1, (0.0, 6.0, 0.0), NOW, site=3, energy_j=50_000.0)
    aside = world.ugv(1, (0.0, -4.0, 0.0), NOW, site=3)
    return replace(
        first,
        phase=phase,
        start_s=0.0,
        uavs=(uav, other),
        ugvs=(ugv, aside),
        plan=replace(first.plan, done=tuple(k < done for k in range(len(ACTIONS)))),
        last_request_s=NOW,
        review_s=NOW,
        valid_until_s=math.inf,
    )


def seen(state: State, of: Settings = SETTINGS, **members) -> Observation:
    """Everybody is seen and heard where the state says they are."""
    units = (*state.uavs, *state.ugvs)
    names = [c.id for c in (*of.uavs, *of.ugvs)]
    poses = tuple(
        world.pose(n, (v.track.position_m[0] + 1e-6, *v.track.position_m[1:]), NOW + 0.1)
        for n, v in zip(names, units, strict=True)
    )
    news = tuple(replace(v.telemetry, stamp_s=NOW + 0.1) for v in units)
    return replace(Observation(NOW + 0.1, poses, news), **members)


def without(observation: Observation, name: str, *, pose: bool = False, news: bool = False) -> Observation:
    poses = tuple(p for p in observation.poses if not (pose and p.body == f"body-{name}"))
    vehicles = tuple(v for v in observation.vehicles if not (news and v.vehicle == name))
    return replace(observation, poses=poses, vehicles=vehicles)


def aged(observation: Observation, unit, name: str, *, pose_s: float = 0.0, news_s: float = 0.0):
    """The vehicle has not been seen or heard for so long."""
    if pose_s:
        unit = replace(unit, track=replace(unit.track, stamp_s=observation.now_s - pose_s,
                                           raw_stamp_s=observation.now_s - pose_s))  # fmt: skip
    if news_s:
        unit = replace(unit, telemetry=replace(unit.telemetry, stamp_s=observation.now_s - news_s))
    return without(observation, name, pose=bool(pose_s), news=bool(news_s)), unit


def cause(kind: K, unit, of: Settings):
    """What must be true and be seen for ``kind`` to be found on vehicle 0: the unit, the other one, the observation."""
    uav = isinstance(unit, UavState)
    name = "uav0" if uav else "ugv0"
    ugv, flyer = (ugv_in(G.PARKED), unit) if uav else (unit, uav_in(P.ON_PAD))
    other = world.uav(1, (0.0, 6.0, 0.0), NOW, site=3, energy_j=50_000.0)
    track = unit.track
    swap = None
    beside = world.ugv(1, (0.0, -4.0, 0.0), NOW, site=3)
    changes: dict = {}
    pose = news = 0.0
    match kind:
        case K.POSE_STALE:
            pose = 1.0
        case K.POSE_LOST:
            pose = 4.0
        case K.POSE_FROZEN:
            changes["track"] = replace(track, same_since_s=NOW - 1.0)
            swap = "frozen"
        case K.POSE_JUMP:
            swap = (track.position_m[0] + 60.0, *track.position_m[1:])
        case K.POSE_SWAP:
            changes["track"] = replace(track, jumped=True, raw_m=(0.0, 6.0, 0.0), raw_stamp_s=NOW + 1)
            other = replace(other, track=replace(other.track, jumped=True, raw_m=track.position_m, raw_stamp_s=NOW + 1))
        case K.TELEMETRY_STALE:
            news = 2.0
        case K.LINK_LOST:
            news = 6.0
        case K.TRACKING_ERROR:
            off = (unit.path or resting(track.position_m, NOW)).knots[0][1:]
            changes["track"] = world.track((off[0], off[1] + 9.0, off[2]), NOW)
            changes["off_path_since_s"] = NOW - 2.0
        case K.GEOFENCE_SOFT | K.GEOFENCE_HARD:
            x, y = track.position_m[:2]
            edge = y + (2.0 if kind is K.GEOFENCE_SOFT else -2.0)
            polygon = ((-60.0, -60.0), (1000.0, -60.0), (1000.0, edge), (-60.0, edge))
            of = replace(of, geofence=replace(of.geofence, polygon_m=polygon))
        case K.SEPARATION if uav:
            x, y, z = track.position_m
            other = replace(other, phase=P.FLYING, track=world.track((x + 6.0, y, z), NOW),
                            telemetry=world.report("uav1", NOW, airborne=True),
                            path=straight((x + 6.0, y, z), (x - 50.0, y, z), NOW, 10.0, 2.0))  # fmt: skip
        case K.SEPARATION:
            x, y, z = track.position_m
            beside = world.ugv(1, (x + 3.0, y, 0.0), NOW, site=3)
        case K.TUMBLED:
            changes["telemetry"] = replace(unit.telemetry, tumbled=True)
        case K.COMMAND_FAILED:
            command = unit.order.command if unit.order and uav else Arm(name)
            if not uav and unit.phase in (G.DRIVING, G.HOLDING):
                command = Hold(name)
            if isinstance(command, Arm):
                changes["telemetry"] = replace(unit.telemetry, armed=False)
            changes["order"] = Order(command, NOW - 20, NOW - 3.0, attempts=5)
            if isinstance(command, Hold):
                changes["track"] = replace(track, speed_mps=5.0)
        case K.ENERGY_NO_RETURN:
            changes["energy_j"] = 5_000.0
        case K.UGV_OFF_ROAD:
            changes["route_m"] = ((20.0, 30.0), (100.0, 30.0))
        case K.UGV_STUCK:
            changes["progress_s"] = NOW - 100.0
    unit = replace(unit, **changes)
    ugv, flyer = (ugv, unit) if uav else (unit, flyer)
    state = replace(scene(of, flyer, ugv), uavs=(flyer, other), ugvs=(ugv, beside))
    observation = seen(state, of)
    observation, unit = aged(observation, unit, name, pose_s=pose, news_s=news)
    if kind is K.COMMAND_FAILED:
        observation = without(observation, name, pose=True)  # nothing new about how fast it is
    if kind is K.POSE_SWAP:
        observation = without(without(observation, name, pose=True), "uav1", pose=True)
    if swap is not None:
        body = f"body-{name}"
        at = track.position_m if swap == "frozen" else swap
        observation = replace(observation, poses=tuple(
            replace(p, position_m=at) if p.body == body else p for p in observation.poses))  # fmt: skip
    flyer, ugv = (unit, ugv) if uav else (flyer, unit)
    return of, replace(state, uavs=(flyer, other), ugvs=(ugv, beside)), observation


def mine(result: supervisor.Step, name: str) -> list:
    return [c for c in result.commands if c.vehicle == name]


# --- UAVs -----------------------------------------------------------------------------------------------------------


def test_the_table_names_every_phase_and_every_action_is_known() -> None:
    assert set(UAV_SITUATION) == set(P) and set(UGV_SITUATION) == set(G)
    assert set(dispatch._STEPS) == set(P) and set(dispatch_ugv._STEPS) == set(G)


@pytest.mark.parametrize("phase", P)
@pytest.mark.parametrize("kind", UAV_CONDITIONS)
def test_every_uav_phase_in_every_condition(kind: K, phase: P) -> None:
    of, state, observation = cause(kind, uav_in(phase), SETTINGS)
    result = supervisor.step(of, state, observation)
    after, told = result.state.uavs[0], [e for e in result.events if e.kind is kind and e.vehicle == "uav0"]
    action = action_for(kind, UAV_SITUATION[phase])
    if told:
        assert told[0].action is action
    sent = mine(result, "uav0")
    if phase in (P.DOWN, P.LOST) and not (phase is P.DOWN and kind is K.TUMBLED):
        assert after.phase is phase and not [c for c in sent if isinstance(c, MOTION)]
        return
    in_the_air = {K.TRACKING_ERROR, K.GEOFENCE_SOFT, K.GEOFENCE_HARD, K.SEPARATION, K.ENERGY_NO_RETURN, K.POSE_JUMP}
    if phase not in AIRBORNE and kind in in_the_air:
        assert not told
        return
    if kind is K.TRACKING_ERROR and phase not in (P.FLYING, P.WAITING):
        return  # only straight flights have a path to leave
    if kind is K.ENERGY_NO_RETURN and phase is P.WAITING:
        assert not told and not after.diverting  # its dock is free: to land beside it would be the greater harm
        return
    if kind is K.SEPARATION and told == [] and phase in (P.LANDING, P.TAKING_OFF, P.DOCKING):
        return  # the other one is held: this one cannot stop
    if kind is K.POSE_SWAP and phase is P.CHARGING:
        pytest.skip("its place cannot be exchanged in this scene") if not told else None
    assert told, f"{kind} was not found in {phase}"
    match action:
        case Action.STOP_MOTORS:
            assert after.phase is P.LOST and sent == [StopMotors("uav0")]
        case Action.LAND_HERE:
            assert after.phase is P.LANDING and after.out and sent[-1] == Land("uav0", 1.5)
        case Action.DIVERT:
            assert after.diverting and (after.phase is P.TAKING_OFF or after.phase is P.FLYING)
        case Action.HOLD if phase in (P.TAKING_OFF, P.FLYING, P.WAITING, P.DOCKING):
            assert after.held and after.phase is phase and sent == [Hold("uav0")]
        case Action.REPLAN_WITHOUT:
            assert after.out and result.state.replan_reason is not None
        case _:
            assert after.phase not in (P.LOST, P.LANDING) or phase is P.LANDING
    if action > Action.REPLAN_WITHOUT or kind in (K.POSE_STALE, K.TUMBLED):
        assert not [c for c in sent if isinstance(c, MOTION) and action is not Action.DIVERT]


@pytest.mark.parametrize("phase", P)
@pytest.mark.parametrize("action", Action)
def test_every_action_on_every_uav_phase(action: Action, phase: P) -> None:
    uav = uav_in(phase)
    turn = world.turn(SETTINGS, now_s=NOW, uavs=(uav, world.uav(1)), ugvs=(ugv_in(G.PARKED), ugv_in(G.PARKED, 1)))
    after = dispatch.apply(turn, uav, action)
    flying = phase in AIRBORNE - {P.LANDING}
    expected = {
        Action.STOP_MOTORS: P.LOST,
        Action.LAND_HERE: P.LANDING if flying else phase,
        Action.DIVERT: P.FLYING if flying and phase is not P.TAKING_OFF else phase,
    }.get(action, phase)
    assert after.phase is expected
    assert not [c for c in turn.commands if isinstance(c, MOTION)]
    assert after.diverting is (action is Action.DIVERT and flying)
    if action in (Action.LAND_HERE, Action.DIVERT) and phase is P.DOCKING:
        assert (after.docked is not None) is (action is Action.LAND_HERE)  # it comes down on the UGV, or leaves it


@pytest.mark.parametrize("phase", P)
def test_a_uav_lost_to_sight_and_hearing_is_lost(phase: P) -> None:
    of, state, observation = cause(K.LINK_LOST, uav_in(phase), SETTINGS)
    observation, uav = aged(observation, state.uavs[0], "uav0", pose_s=5.0)
    result = supervisor.step(of, replace(state, uavs=(uav, state.uavs[1])), observation)
    after = result.state.uavs[0]
    assert (after.phase is P.LOST) is (phase in AIRBORNE or phase is P.LOST)
    assert after.phase is not P.LOST or after.out
    assert not [c for c in mine(result, "uav0") if isinstance(c, MOTION)]


@pytest.mark.parametrize("phase", P)
def test_a_refusal_in_every_uav_phase(phase: P) -> None:
    uav = uav_in(phase)
    order = uav.order or Order(Arm("uav0"), NOW, NOW)
    uav = replace(uav, order=order, telemetry=replace(uav.telemetry, airborne=phase in AIRBORNE - {P.TAKING_OFF}))
    state = scene(SETTINGS, uav, ugv_in(G.PARKED))
    result = supervisor.step(SETTINGS, state, seen(state, refusals=(Refusal(order.command, "test"),)))
    after = result.state.uavs[0]
    assert next(e.kind for e in result.events if e.vehicle == "uav0") is K.GATE_REFUSED
    assert after.phase in {P.TAKING_OFF: {P.ON_PAD}, P.DOCKING: {P.WAITING, P.FLYING}}.get(phase, {phase, P.FLYING})
    assert after.retry_s > NOW
    if phase not in (P.LANDING, P.DOWN, P.LOST, P.CHARGING):
        assert not [c for c in mine(result, "uav0") if isinstance(c, MOTION)]


def test_a_refused_take_off_of_a_uav_that_has_left_the_ground_is_asked_for_again() -> None:
    uav = uav_in(P.TAKING_OFF, (50.0, 25.0, 5.0))
    state = scene(SETTINGS, uav, ugv_in(G.PARKED))
    result = supervisor.step(SETTINGS, state, seen(state, refusals=(Refusal(uav.order.command, "test"),)))
    assert result.state.uavs[0].phase is P.TAKING_OFF and mine(result, "uav0") == [uav.order.command]


# --- UGVs -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", G)
@pytest.mark.parametrize("kind", UGV_CONDITIONS)
def test_every_ugv_phase_in_every_condition(kind: K, phase: G) -> None:
    of, state, observation = cause(kind, ugv_in(phase), SETTINGS)
    result = supervisor.step(of, state, observation)
    after, told = result.state.ugvs[0], [e for e in result.events if e.kind is kind and e.vehicle == "ugv0"]
    action = action_for(kind, UGV_SITUATION[phase])
    sent = mine(result, "ugv0")
    if phase is G.LOST:
        assert after.phase is G.LOST and not told and all(isinstance(c, StopMotors) for c in sent)
        return
    moving = {K.GEOFENCE_SOFT, K.GEOFENCE_HARD, K.UGV_OFF_ROAD}
    moving |= {K.POSE_JUMP}  # one that stands between sites because it jumped must not believe the jump then
    driving = {K.SEPARATION, K.UGV_STUCK}
    if (phase is G.PARKED and kind in moving) or (phase is not G.DRIVING and kind in driving):
        assert not told
        return
    assert told and told[0].action is action
    match action:
        case Action.STOP_MOTORS:
            assert after.phase is G.LOST and after.out and StopMotors("ugv0") in sent
        case Action.REPLAN_WITHOUT:
            assert after.out is (kind is not K.UGV_STUCK) and after.stuck is (kind is K.UGV_STUCK)
            assert kind is K.UGV_STUCK or after.phase is not G.DRIVING
        case Action.HOLD:
            assert after.held and after.phase in (G.HOLDING, phase) and after.phase is not G.DRIVING
    if action in (Action.HOLD, Action.STOP_MOTORS) or after.out:
        assert not [c for c in sent if isinstance(c, Drive)]


@pytest.mark.parametrize("phase", G)
@pytest.mark.parametrize("action", Action)
def test_every_action_on_every_ugv_phase(action: Action, phase: G) -> None:
    ugv = ugv_in(phase)
    turn = world.turn(SETTINGS, now_s=NOW, uavs=(uav_in(P.ON_PAD), world.uav(1)), ugvs=(ugv, ugv_in(G.PARKED, 1)))
    after = dispatch_ugv.apply(turn, ugv, action)
    assert after.phase is (G.LOST if action is Action.STOP_MOTORS else phase)
    lost = phase is G.LOST
    assert after.held is (action in (Action.HOLD, Action.DIVERT, Action.LAND_HERE) and not lost)
    assert after.out is (lost or action in (Action.REPLAN_WITHOUT, Action.STOP_MOTORS))
    assert not [c for c in turn.commands if isinstance(c, MOTION)]


@pytest.mark.parametrize("phase", G)
def test_a_refusal_in_every_ugv_phase(phase: G) -> None:
    ugv = ugv_in(phase)
    order = ugv.order or Order(Drive("ugv0", ((0.0, 0.0), (1.0, 0.0)), 5.0), NOW, NOW)
    state = scene(SETTINGS, uav_in(P.ON_PAD), replace(ugv, order=order), done=1)
    result = supervisor.step(SETTINGS, state, seen(state, refusals=(Refusal(order.command, "test"),)))
    after = result.state.ugvs[0]
    assert after.phase is (G.HOLDING if phase is G.DRIVING else phase)
    assert not [c for c in mine(result, "ugv0") if isinstance(c, Drive)]


# --- the mission ----------------------------------------------------------------------------------------------------

WISHES = ("checked", "arm", "start", "hold", "resume", "recover", "stop")
BECOMES = {
    (M.DISARMED, "checked"): M.CHECKED,
    (M.CHECKED, "arm"): M.CHECKED,  # until everybody is armed
    (M.ARMED, "start"): M.RUNNING,
    (M.RUNNING, "hold"): M.HOLDING,
    (M.HOLDING, "resume"): M.RUNNING,
    (M.DISARMED, "recover"): M.ABORTED,
    (M.CHECKED, "recover"): M.ABORTED,
    (M.ARMED, "recover"): M.ABORTED,  # everybody is on the ground
    (M.RUNNING, "recover"): M.RECOVERING,
    (M.HOLDING, "recover"): M.RECOVERING,
    **{(phase, "stop"): M.ABORTED for phase in M},
}


@pytest.mark.parametrize("phase", M)
@pytest.mark.parametrize("wish", WISHES)
def test_every_mission_phase_and_every_wish(wish: str, phase: M) -> None:
    ground = phase in (M.DISARMED, M.CHECKED, M.ARMED)
    uav = uav_in(P.ON_PAD) if ground else uav_in(P.DOWN if phase in (M.DONE, M.ABORTED) else P.FLYING)
    state = replace(scene(SETTINGS, replace(uav, energy_j=60_000.0), ugv_in(G.PARKED), phase), valid_until_s=1e6)
    if phase is M.CHECKED:
        state = replace(state, uavs=tuple(replace(u, telemetry=replace(u.telemetry, armed=False)) for u in state.uavs))
    if wish == "resume":
        state = replace(state, review_s=NOW + 1)
    digest = state.plan_digest
    result = supervisor.step(SETTINGS, state, seen(state, operator=(OperatorInput(wish, digest, 1e6),)))
    assert result.state.phase is BECOMES.get((phase, wish), phase)
    answered = (phase, wish) in BECOMES
    assert answered is not any("has no effect" in e.text and e.severity is Severity.WARNING for e in result.events)
    if wish == "stop":
        assert {c.vehicle for c in result.commands if isinstance(c, StopMotors)} == {"uav0", "uav1", "ugv0", "ugv1"}
        assert all(isinstance(c, StopMotors) for c in result.commands)
        assert all(u.phase is P.LOST for u in result.state.uavs) and all(g.phase is G.LOST for g in result.state.ugvs)
        assert result.events[0].kind is K.OPERATOR_STOP
    if ground and wish != "stop":
        assert all(isinstance(c, Arm | Disarm) for c in result.commands) or result.state.phase is M.RUNNING


def test_stop_is_judged_first_and_what_else_is_wished_then_has_no_effect() -> None:
    state = scene(SETTINGS, uav_in(P.FLYING), ugv_in(G.DRIVING))
    wishes = tuple(OperatorInput(w) for w in ("hold", "recover", "stop"))
    reply = PlanReply(1, True, (), "test", 0.1)
    result = supervisor.step(SETTINGS, state, seen(state, operator=wishes, plan_reply=reply))
    assert result.state.phase is M.ABORTED and result.events[0].kind is K.OPERATOR_STOP
    assert {type(c) for c in result.commands} == {StopMotors} and len(result.commands) == 4


@pytest.mark.parametrize("phase", P)
@pytest.mark.parametrize("mission", [M.HOLDING, M.RECOVERING, M.DONE, M.ABORTED])
def test_no_uav_flies_on_while_the_mission_does_not(mission: M, phase: P) -> None:
    state = scene(SETTINGS, uav_in(phase), ugv_in(G.PARKED), mission)
    result = supervisor.step(SETTINGS, state, seen(state))
    tasks = {(100.0 * (m + 1), 50.0) for m in range(3)}
    assert not [c for c in mine(result, "uav0") if isinstance(c, GoTo) and c.position_m[:2] in tasks]
    after = result.state.uavs[0].phase
    if mission is M.RECOVERING and phase in (P.ON_PAD, P.CHARGING):
        assert after is P.DOWN
    if mission is M.HOLDING and phase is P.FLYING:
        assert mine(result, "uav0") == [Hold("uav0")]


@pytest.mark.parametrize("mission", M)
@pytest.mark.parametrize("phase", G)
def test_no_ugv_drives_unless_the_mission_is_under_way(mission: M, phase: G) -> None:
    state = scene(SETTINGS, uav_in(P.DOWN), ugv_in(phase), mission)
    result = supervisor.step(SETTINGS, state, seen(state))
    if mission not in (M.RUNNING, M.RECOVERING):
        assert not [c for c in mine(result, "ugv0") if isinstance(c, Drive)]
        assert result.state.ugvs[0].phase is not G.DRIVING


# --- purity ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", P)
def test_the_same_arguments_give_the_same_result(phase: P) -> None:
    state = scene(SETTINGS, uav_in(phase), ugv_in(G.PARKED))
    observation = seen(state)
    before = repr(state)
    first, second = (supervisor.step(SETTINGS, state, observation) for _ in range(2))
    assert first.state == second.state and first.commands == second.commands and first.events == second.events
    assert repr(state) == before
    assert hash(first.state) == hash(second.state)


def test_everything_in_the_state_is_frozen() -> None:
    def check(value: object) -> None:
        if is_dataclass(value):
            assert type(value).__dataclass_params__.frozen, type(value)
            for f in fields(value):
                check(getattr(value, f.name))
        elif isinstance(value, tuple):
            for v in value:
                check(v)
        else:
            assert not isinstance(value, list | dict | set)

    check(scene(SETTINGS, uav_in(P.FLYING), ugv_in(G.DRIVING)))


def test_situations_cover_what_can_be_overridden() -> None:
    assert {UAV_SITUATION[p] for p in P} | {UGV_SITUATION[p] for p in G} | {Situation.MISSION} == set(Situation)


def test_a_refusal_of_what_a_ugv_is_not_under_any_more_changes_nothing_but_is_told() -> None:
    state = scene(SETTINGS, uav_in(P.ON_PAD), ugv_in(G.DRIVING), done=1)
    before = state.ugvs[0]
    assert before.order is not None
    result = supervisor.step(SETTINGS, state, seen(state, refusals=(Refusal(Arm("ugv0"), "test"),)))
    after = result.state.ugvs[0]
    assert after.phase is G.DRIVING and after.order is not None and after.order.command == before.order.command
    assert [e.kind for e in result.events if e.kind is K.GATE_REFUSED] == [K.GATE_REFUSED]
    again = supervisor.step(SETTINGS, result.state, seen(result.state, refusals=(Refusal(Arm("ugv0"), "test"),)))
    assert not [e for e in again.events if e.kind is K.GATE_REFUSED]
