"""The supervisor: ``step(settings, state, observation) -> state, commands, events``. Pure; stops are judged first."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from deploy import dispatch, dispatch_ugv, estimate, monitors, recovery, replanning
from deploy.events import Action, Event, EventKind, Severity
from deploy.failsafe import UAV_SITUATION, UGV_SITUATION, Situation, action_for, severity_of
from deploy.observation import Observation, OperatorInput, PlanRequest
from deploy.retime import plan_state
from deploy.settings import Settings
from deploy.state import (
    AIRBORNE,
    Finding,
    MissionPhase,
    State,
    Track,
    UavPhase,
    UavState,
    UgvPhase,
    UgvState,
)
from deploy.turn import Adopted, Turn, Unit
from drivers.vehicle import Arm, Command, Disarm, Pose
from planner.plan import Plan

M = MissionPhase
WORSE = {EventKind.POSE_STALE: EventKind.POSE_LOST, EventKind.TELEMETRY_STALE: EventKind.LINK_LOST}
"""What a condition becomes that lasts."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one step gives: the next state, commands in order, events, a replan asked for and a plan adopted."""

    state: State
    commands: tuple[Command, ...]
    events: tuple[Event, ...]
    request: PlanRequest | None
    adopted: Adopted | None


def initial(settings: Settings, plan: Plan) -> State:
    """The state before the first step: everybody on the ground at the depot, disarmed.

    Args:
        settings: of the mission.
        plan: for ``settings.problem``.
    """
    problem = settings.problem
    depot = problem.depot_index
    return State(
        phase=M.DISARMED,
        # the planner's UAV begins when it has climbed, with what is left then
        uavs=tuple(
            UavState(i, energy_j=min(u.capacity_j, u.energy_j + u.ready_s * u.hover_w), site=depot)
            for i, u in enumerate(problem.uavs)
        ),
        ugvs=tuple(
            UgvState(i, energy_j=g.energy_j, site=depot if g.path_point is None else g.path_point)
            for i, g in enumerate(problem.ugvs)
        ),
        plan=plan_state(settings, problem, plan.actions, number=0, at_s=0.0),
        plan_digest=plan.digest,
        visited=tuple(bool(v) for v in problem.visited),
    )


def step(settings: Settings, state: State, observation: Observation) -> Step:
    """One turn: judges stops, looks, decides, dispatches.

    Args:
        settings: of the mission.
        state: from ``initial`` or the last step.
        observation: what was seen since.

    The same arguments always give the same result: no I/O, no clock, no randomness.
    """
    turn = Turn(settings, observation, state, list(state.uavs), list(state.ugvs), state.plan, list(state.visited))
    turn.pending = state.pending
    for wish in sorted(observation.operator, key=lambda w: w.wish != "stop"):
        _operator(turn, wish)
    _look(turn)
    _judge(turn)
    _refusals(turn)
    if turn.state.phase is M.RUNNING:
        replanning.review(turn)
    for ugv in range(len(turn.ugvs)):
        dispatch_ugv.advance(turn, ugv)
    for uav in range(len(turn.uavs)):
        dispatch.advance(turn, uav)
    _mission(turn)
    final = replace(
        turn.state,
        uavs=tuple(turn.uavs),
        ugvs=tuple(turn.ugvs),
        plan=turn.plan,
        visited=tuple(turn.visited),
        pending=turn.pending,
    )
    return Step(final, tuple(turn.commands), tuple(turn.events), turn.request, turn.adopted)


# --- the operator ---------------------------------------------------------------------------------------------------


def _operator(turn: Turn, wish: OperatorInput) -> None:
    phase = turn.state.phase
    if wish.wish == "stop":  # also when it is over: a lost vehicle may still move
        turn.tell(EventKind.OPERATOR_STOP, "the operator stops all motors", action=Action.STOP_MOTORS)
        _stop_everybody(turn)
    elif wish.wish == "recover" and phase in (M.ARMED, M.RUNNING, M.HOLDING):
        turn.tell(EventKind.OPERATOR_RECOVER, "the operator brings everybody down", action=Action.TEAM_RECOVERY)
        turn.state = replace(turn.state, aborting=True)
        recovery.call_off(turn, "everybody comes down")
    elif wish.wish == "recover" and phase in (M.DISARMED, M.CHECKED):
        _call_off_on_the_ground(turn, "the operator calls it off before the start")
    elif wish.wish == "hold" and phase is M.RUNNING:
        turn.tell(EventKind.OPERATOR_HOLD, "the operator holds the mission", action=Action.HOLD)
        recovery.enter(turn, M.HOLDING, "everybody stops where they are")
        if turn.pending is not None:  # what it would be told while held is of no use afterwards: it will ask again
            turn.want_replan(turn.pending.reason, urgent=turn.pending.urgent)
            turn.pending = None
    elif wish.wish == "resume" and phase is M.HOLDING:
        recovery.enter(turn, M.RUNNING, "the mission goes on")
        turn.want_replan("the mission was held", urgent=False)
    elif wish.wish == "checked" and phase is M.DISARMED and wish.plan_digest == turn.state.plan_digest:
        turn.state = replace(turn.state, valid_until_s=wish.valid_until_s)
        recovery.enter(turn, M.CHECKED, "the checks of this plan have passed")
    elif wish.wish == "arm" and phase is M.CHECKED and _checks_valid(turn):
        turn.state = replace(turn.state, valid_until_s=math.inf)
        turn.uavs = [turn.order(u, Arm(c.id)) for u, c in zip(turn.uavs, turn.settings.uavs, strict=True)]
        turn.ugvs = [turn.order(g, Arm(c.id)) for g, c in zip(turn.ugvs, turn.settings.ugvs, strict=True)]
    elif wish.wish == "start" and phase is M.ARMED:
        turn.state = replace(turn.state, start_s=turn.now_s)
        recovery.enter(turn, M.RUNNING, "the mission starts")
    else:
        turn.events.append(
            Event(
                turn.now_s,
                EventKind.MISSION_STATE,
                Severity.WARNING,
                None,
                Action.NOTE,
                f"{wish.wish!r} has no effect while {phase.value} (or its checks do not hold for this plan any more)",
            )
        )


def _checks_valid(turn: Turn) -> bool:
    limit_s = turn.state.valid_until_s
    return limit_s is not None and turn.now_s <= limit_s


def _call_off_on_the_ground(turn: Turn, why: str) -> None:
    turn.state = replace(turn.state, aborting=True)
    turn.commands.extend(Disarm(c.id) for c in turn.settings.vehicles)
    recovery.enter(turn, M.ABORTED, why)


def _stop_everybody(turn: Turn) -> None:
    turn.state = replace(turn.state, aborting=True)
    turn.uavs = [dispatch.apply(turn, u, Action.STOP_MOTORS) for u in turn.uavs]
    turn.ugvs = [dispatch_ugv.apply(turn, g, Action.STOP_MOTORS) for g in turn.ugvs]
    turn.state = replace(turn.state, replan_reason=None, replan_urgent=False)
    turn.pending = None
    recovery.enter(turn, M.ABORTED, "all motors are stopped")


# --- looking --------------------------------------------------------------------------------------------------------


def _look(turn: Turn) -> None:
    settings = turn.settings
    poses = {
        p.body: p for p in turn.observation.poses if all(map(math.isfinite, (*p.position_m, p.yaw_rad, p.stamp_s)))
    }
    news = {v.vehicle: v for v in turn.observation.vehicles}
    tracks: dict[str, Track] = {}
    for uav, config in zip(turn.uavs, settings.uavs, strict=True):
        track = _follow(
            turn, uav.track, poses.get(config.body), uav.phase in AIRBORNE, config.max_speed_mps, config.accel_mps2
        )
        if track is not None:
            tracks[config.id] = track
    for ugv, road in zip(turn.ugvs, settings.ugvs, strict=True):
        under_way = ugv.phase in (UgvPhase.DRIVING, UgvPhase.HOLDING)  # one held for a jump must not trust it then
        track = _follow(turn, ugv.track, poses.get(road.body), under_way, road.max_speed_mps, road.accel_mps2)
        if track is not None:
            tracks[road.id] = track
    tracks = estimate.mark_swaps(tracks, settings.monitors)
    for i, config in enumerate(settings.uavs):
        uav = turn.uavs[i]
        telemetry = news.get(config.id, uav.telemetry)
        energy_j = estimate.uav_energy(settings, uav, config, telemetry, turn.now_s)
        track = tracks.get(config.id)
        uav = replace(uav, track=track, telemetry=telemetry, energy_j=energy_j, energy_s=turn.now_s)
        turn.uavs[i] = monitors.note_deviation(turn, turn.confirm(uav, config.speed_mps))
    for j, road in enumerate(settings.ugvs):
        ugv = turn.ugvs[j]
        telemetry = news.get(road.id, ugv.telemetry)
        energy_j = estimate.ugv_energy(settings, ugv, road, telemetry, turn.now_s)
        track = tracks.get(road.id)
        ugv = replace(ugv, track=track, telemetry=telemetry, energy_j=energy_j, energy_s=turn.now_s)
        ugv = dispatch_ugv.observe(turn, ugv)
        turn.ugvs[j] = turn.confirm(ugv, road.speed_mps)
    # What a virtual UAV battery has gained, a virtual UGV battery has lost.
    for i, before in enumerate(turn.state.uavs):
        after = turn.uavs[i]
        if after.phase is UavPhase.CHARGING and after.docked is not None and settings.uavs[i].energy == "virtual":
            ugv = turn.ugvs[after.docked[0]]
            gained_j = max(0.0, after.energy_j - before.energy_j)
            turn.ugvs[after.docked[0]] = replace(ugv, energy_j=max(0.0, ugv.energy_j - gained_j))


def _follow(
    turn: Turn, track: Track | None, pose: Pose | None, moving: bool, speed_mps: float, brake: float
) -> Track | None:
    if pose is None:
        return track
    if track is None:
        return estimate.first_track(pose)
    return estimate.follow(
        track, pose, moving=moving, max_speed_mps=speed_mps, brake_mps2=brake, limits=turn.settings.monitors
    )


# --- judging --------------------------------------------------------------------------------------------------------


def _judge(turn: Turn) -> None:
    """Turns findings into events (once each) and actions (as long as they hold)."""
    by_vehicle: dict[str | None, list[Finding]] = {}
    for finding in monitors.findings(turn):
        by_vehicle.setdefault(finding.vehicle, []).append(finding)
    armed = turn.state.phase not in (M.DISARMED, M.CHECKED) and not turn.state.over
    for i, config in enumerate(turn.settings.uavs):
        uav = turn.uavs[i]
        found = by_vehicle.get(config.id, [])
        situation = UAV_SITUATION[uav.phase]
        actions = _tell(turn, config.id, uav.active, found, situation, armed)
        lost = {EventKind.LINK_LOST, EventKind.POSE_LOST} <= {f.kind for f in found}
        if found or uav.held or uav.active:
            uav = replace(uav, active=_active(uav.active, found), held=False)
        for action in actions if armed else ():
            uav = dispatch.apply(turn, uav, action)
        if lost and armed and uav.phase in AIRBORNE:
            turn.want_replan(f"{config.id} can be neither seen nor commanded", urgent=True)
            uav = replace(uav, phase=UavPhase.LOST, since_s=turn.now_s, out=True, path=None, docked=None, action=None)
        turn.uavs[i] = uav
    for j, road in enumerate(turn.settings.ugvs):
        ugv = turn.ugvs[j]
        found = by_vehicle.get(road.id, [])
        actions = _tell(turn, road.id, ugv.active, found, UGV_SITUATION[ugv.phase], armed)
        if found or ugv.held or ugv.active:
            ugv = replace(ugv, active=_active(ugv.active, found), held=False)
        for action in actions if armed else ():
            ugv = dispatch_ugv.apply(turn, ugv, action)
        turn.ugvs[j] = ugv
    found = by_vehicle.get(None, [])
    _tell(turn, None, turn.state.active, found, Situation.MISSION, armed)
    turn.state = replace(turn.state, active=_active(turn.state.active, found))


def _active(before: frozenset[EventKind], found: list[Finding]) -> frozenset[EventKind]:
    return frozenset(f.kind for f in found) | (before & {EventKind.CONFLICT_HELD})


def _tell(
    turn: Turn,
    vehicle: str | None,
    before: frozenset[EventKind],
    found: list[Finding],
    situation: Situation,
    armed: bool,
) -> list[Action]:
    """Tells what has begun and ended, and returns the actions that hold now, mildest first."""
    actions = []
    now = {f.kind for f in found}
    for finding in found:
        action = action_for(finding.kind, situation, turn.settings.failsafe)
        actions.append(action)
        if finding.kind not in before and armed:
            turn.tell(finding.kind, finding.text, vehicle, action)
    for kind in sorted(before - now - {EventKind.CONFLICT_HELD}):
        # nobody looks after a lost vehicle any more, and what has become worse is not over
        over = situation is not Situation.GONE and WORSE.get(kind) not in now
        if armed and over and severity_of(kind) >= Severity.WARNING:
            turn.tell(EventKind.RECOVERED_FROM, f"{kind.value.replace('_', ' ')} is over", vehicle)
    return sorted(actions)


def _refusals(turn: Turn) -> None:
    """A refused command was not sent: the vehicle stays as it is, and is asked again a little later."""
    for refusal in turn.observation.refusals:
        name = refusal.command.vehicle
        what = type(refusal.command).__name__
        text = f"{what} for {name} was refused: {refusal.reason}"
        retry_s = turn.now_s + dispatch.RETRY_S
        for i, uav in enumerate(turn.uavs):
            if turn.settings.uavs[i].id == name:
                turn.uavs[i] = _told_of(turn, uav, name, text)
                if _is_under(uav, refusal.command):
                    turn.uavs[i] = dispatch.refused(turn, replace(turn.uavs[i], retry_s=retry_s))
        for j, ugv in enumerate(turn.ugvs):
            if turn.settings.ugvs[j].id == name:
                turn.ugvs[j] = _told_of(turn, ugv, name, text)
                if _is_under(ugv, refusal.command):
                    turn.ugvs[j] = dispatch_ugv.refused(turn, replace(turn.ugvs[j], retry_s=retry_s))


def _told_of(turn: Turn, unit: Unit, name: str, text: str) -> Unit:
    """Tells a refusal unless it is the one told last."""
    if text == unit.refused:
        return unit
    turn.tell(EventKind.GATE_REFUSED, text, name)
    return replace(unit, refused=text)


def _is_under(unit: UavState | UgvState, command: Command) -> bool:
    """Whether the refused command is still the one wanted: a stop ordered since must not be taken back."""
    return unit.order is not None and unit.order.command == command


# --- the mission as a whole -----------------------------------------------------------------------------------------


def _mission(turn: Turn) -> None:
    phase = turn.state.phase
    if phase is M.CHECKED and turn.state.valid_until_s == math.inf and _all_armed(turn):
        recovery.enter(turn, M.ARMED, "every vehicle is armed")
    elif phase is M.CHECKED and turn.state.valid_until_s == math.inf and _arming_failed(turn):
        _call_off_on_the_ground(turn, f"{', '.join(_arming_failed(turn))} cannot be armed")
    elif phase is M.CHECKED and turn.state.valid_until_s == math.inf:
        turn.uavs = [turn.order(u, Arm(c.id)) for u, c in zip(turn.uavs, turn.settings.uavs, strict=True)]
        turn.ugvs = [turn.order(g, Arm(c.id)) for g, c in zip(turn.ugvs, turn.settings.ugvs, strict=True)]
    elif phase is M.RUNNING and replanning.finished(turn):
        recovery.finish(turn)
    elif phase is M.RECOVERING and recovery.everybody_down(turn):
        turn.state = replace(turn.state, end_s=turn.now_s)
        turn.commands.extend(Disarm(c.id) for c in turn.settings.vehicles)
        recovery.enter(turn, M.ABORTED if turn.state.aborting else M.DONE, "everybody is down")


def _arming_failed(turn: Turn) -> list[str]:
    units: list[UavState | UgvState] = [*turn.uavs, *turn.ugvs]
    return [c.id for c, v in zip(turn.settings.vehicles, units, strict=True) if EventKind.COMMAND_FAILED in v.active]


def _all_armed(turn: Turn) -> bool:
    units: list[UavState | UgvState] = [*turn.uavs, *turn.ugvs]
    return all(v.telemetry is not None and v.telemetry.armed for v in units)
