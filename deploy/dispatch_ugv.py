"""What each UGV does next: it drives when everything listed before the move is done and nobody is at its docks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import shapely

from deploy.events import Action, EventKind
from deploy.fence import line_of
from deploy.flightpath import along
from deploy.state import UAV_FINAL, MissionPhase, UgvPhase, UgvState
from deploy.turn import Turn
from drivers.vehicle import Arm, Drive, Hold, StopMotors, Vec2
from planner.errors import PlannerError
from planner.plan import Move

RETRY_S = 1.0
HOLD_S = 3.0  # a UGV that had to stop stands at least this long
P = UgvPhase


def advance(turn: Turn, index: int) -> None:
    """Advances one UGV by one turn."""
    ugv = turn.ugvs[index]
    if not ugv.out and any(u.phase in UAV_FINAL for u in turn.guests(index)):
        turn.want_replan(f"{_name(turn, ugv)} cannot drive with the UAV that will not leave its dock", urgent=True)
        ugv = replace(ugv, out=True)
    turn.ugvs[index] = _STEPS[ugv.phase](turn, ugv)


def observe(turn: Turn, ugv: UgvState) -> UgvState:
    """Updates how far it has come on its route, and whether it is stuck."""
    if ugv.phase is not P.DRIVING or ugv.track is None:
        return ugv
    left_m = left_on_route_m(ugv.route_m, ugv.track.position_m[:2])
    if left_m > ugv.progress_m - turn.settings.monitors.ugv_stuck_m:
        return replace(ugv, left_m=left_m)
    if ugv.stuck:
        name = turn.settings.ugvs[ugv.index].id
        turn.tell(EventKind.RECOVERED_FROM, f"{name} moves again", name)
        turn.want_replan(f"{name} moves again", urgent=False)
    return replace(ugv, left_m=left_m, progress_m=left_m, progress_s=turn.now_s, stuck=False)


def left_on_route_m(route_m: tuple[Vec2, ...], position_m: Vec2) -> float:
    """Way left from the route's point nearest to ``position_m`` to its end, in m."""
    line = line_of(route_m)
    return line.length - float(shapely.line_locate_point(line, shapely.points(position_m)))


def route_to(turn: Turn, ugv: UgvState, site: int) -> tuple[Vec2, ...]:
    """The drive from where the UGV is to its own place at ``site``, on its lane, in the arena.

    Raises:
        PlannerError: when no road leads there.
    """
    assert ugv.track is not None  # nothing moves before it has been seen
    frame, config = turn.settings.frame, turn.settings.ugvs[ugv.index]
    here = ugv.track.position_m[:2]
    world = turn.settings.roads.route(frame.to_world(here), site)
    centre = [frame.to_arena((float(x), float(y))) for x, y in world]
    lane = keep_right(centre, config.lane_offset_m)
    # From its parking place straight to the lane and back: that way it passes nobody parked at the same site.
    points = [here, *(lane if ugv.site is not None else lane[1:]), turn.park_m(ugv.index, site)]
    return tuple(p for i, p in enumerate(points) if i == 0 or math.dist(p, points[i - 1]) > 1e-6)


def keep_right(line: Sequence[Vec2], offset_m: float) -> list[Vec2]:
    """The polyline moved to its right by ``offset_m``, with mitred corners of at most twice the offset."""
    if offset_m == 0 or len(line) < 2:
        return list(line)
    points = np.array(line, dtype=np.float64)
    steps = np.diff(points, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    keep = lengths > 0
    if not keep.any():
        return list(line)
    points = np.vstack([points[0], points[1:][keep]])
    normals = np.column_stack([steps[keep, 1], -steps[keep, 0]]) / lengths[keep, None]
    before, after = np.vstack([normals[:1], normals]), np.vstack([normals, normals[-1:]])
    share = np.maximum(0.5, (1.0 + (before * after).sum(axis=1)) / 2)
    moved = points + offset_m * (before + after) / 2 / share[:, None]
    return [(float(x), float(y)) for x, y in moved]


def _may_move(turn: Turn, ugv: UgvState) -> bool:
    free = next(turn.guests(ugv.index), None) is None
    return free and not ugv.held and not ugv.out and turn.now_s >= ugv.retry_s and turn.fresh(ugv)


def _name(turn: Turn, ugv: UgvState) -> str:
    return turn.settings.ugvs[ugv.index].id


def _parked(turn: Turn, ugv: UgvState) -> UgvState:
    if turn.state.phase is MissionPhase.RUNNING:
        k = turn.next_of_ugv(ugv.index)
        if k is None:
            return ugv
        target = _target_of(turn, k)
        if target == ugv.site:
            turn.mark_done(k)
            return ugv
    elif turn.state.phase is MissionPhase.RECOVERING and ugv.target is not None:
        target = ugv.target
    else:
        return ugv
    return _drive(turn, ugv, target) if _may_move(turn, ugv) and turn.in_its_place(ugv) else ugv


def _target_of(turn: Turn, k: int) -> int:
    action = turn.plan.actions[k]
    assert isinstance(action, Move)  # next_of_ugv returns moves
    return turn.settings.problem.depot_index if action.path_point is None else action.path_point


def _drive(turn: Turn, ugv: UgvState, target: int) -> UgvState:
    name, config = _name(turn, ugv), turn.settings.ugvs[ugv.index]
    if ugv.telemetry is None or not ugv.telemetry.armed:
        return turn.order(ugv, Arm(name))
    try:
        route_m = route_to(turn, ugv, target)
    except PlannerError as error:
        turn.want_replan(f"{name}: {error}", urgent=True)
        later = ugv.target if turn.state.phase is MissionPhase.RUNNING else None
        return replace(ugv, retry_s=turn.now_s + RETRY_S, target=later)
    path = along(route_m, 0.0, turn.now_s, config.speed_mps) if len(route_m) > 1 else None
    if path is None:
        return _arrive(turn, replace(ugv, target=target))
    if (blocker := turn.ugv_in_the_way(ugv.index, path)) is not None:
        return _wait(turn, ugv, f"{name} waits for {blocker} to pass")
    again = ugv.phase is P.HOLDING and ugv.target == target  # one that is stopped again and again makes no progress
    ugv = turn.order(ugv, Drive(name, route_m, config.speed_mps))
    left_m = left_on_route_m(route_m, route_m[0])
    return replace(
        ugv,
        phase=P.DRIVING,
        since_s=turn.now_s,
        site=None,
        target=target,
        route_m=route_m,
        path=path,
        left_m=left_m,
        progress_m=ugv.progress_m if again else left_m,
        progress_s=ugv.progress_s if again else turn.now_s,
        active=ugv.active - {EventKind.CONFLICT_HELD},
    )


def _wait(turn: Turn, ugv: UgvState, text: str) -> UgvState:
    if EventKind.CONFLICT_HELD not in ugv.active:
        turn.tell(EventKind.CONFLICT_HELD, text, _name(turn, ugv))
        ugv = replace(ugv, progress_s=turn.now_s if ugv.phase is P.PARKED else ugv.progress_s)
    elif not ugv.stuck and turn.now_s - ugv.progress_s >= turn.settings.monitors.ugv_stuck_s:
        turn.want_replan(text, urgent=True)
        ugv = replace(ugv, stuck=True)
    return replace(ugv, retry_s=turn.now_s + RETRY_S, active=ugv.active | {EventKind.CONFLICT_HELD})


def _driving(turn: Turn, ugv: UgvState) -> UgvState:
    under_way = turn.state.phase in (MissionPhase.RUNNING, MissionPhase.RECOVERING)
    if ugv.held or ugv.out or ugv.target is None or not under_way:
        ugv = turn.order(ugv, Hold(_name(turn, ugv)))
        return replace(ugv, phase=P.HOLDING, since_s=turn.now_s, path=None, retry_s=turn.now_s + HOLD_S)
    assert ugv.track is not None  # it could not have begun to drive
    k = turn.next_of_ugv(ugv.index) if turn.state.phase is MissionPhase.RUNNING else None
    if k is not None and _target_of(turn, k) != ugv.target and not ugv.stuck and turn.now_s >= ugv.retry_s:
        return _drive(turn, ugv, _target_of(turn, k))
    end = ugv.route_m[-1]
    if turn.fresh(ugv) and math.dist(ugv.track.position_m[:2], end) <= turn.settings.monitors.arrival_m:
        return _arrive(turn, ugv)
    order = ugv.order
    return turn.order(ugv, order.command) if order is not None else ugv


def _arrive(turn: Turn, ugv: UgvState) -> UgvState:
    assert ugv.target is not None  # set when it began to drive
    name = _name(turn, ugv)
    k = turn.next_of_ugv(ugv.index)
    if k is not None and _target_of(turn, k) == ugv.target:
        turn.mark_done(k)
    at = "the depot" if ugv.target == turn.settings.problem.depot_index else f"path point {ugv.target}"
    turn.tell(EventKind.UGV_ARRIVED, f"{name} is parked at {at}", name)
    if ugv.stuck:
        turn.want_replan(f"{name} has arrived after all", urgent=False)
    return replace(
        ugv, phase=P.PARKED, since_s=turn.now_s, site=ugv.target, target=None, path=None, route_m=(), stuck=False
    )


def _holding(turn: Turn, ugv: UgvState) -> UgvState:
    name = _name(turn, ugv)
    ugv = turn.order(ugv, Hold(name)) if ugv.order is None or not isinstance(ugv.order.command, Arm) else ugv
    if turn.state.phase is MissionPhase.HOLDING:
        ugv = replace(ugv, progress_s=turn.now_s)
    running = turn.state.phase in (MissionPhase.RUNNING, MissionPhase.RECOVERING)
    if not running or ugv.target is None or not _may_move(turn, ugv):
        return ugv
    k = turn.next_of_ugv(ugv.index) if turn.state.phase is MissionPhase.RUNNING else None
    return _drive(turn, ugv, ugv.target if k is None else _target_of(turn, k))


def _lost(turn: Turn, ugv: UgvState) -> UgvState:
    return turn.order(ugv, StopMotors(_name(turn, ugv)))


def apply(turn: Turn, ugv: UgvState, action: Action) -> UgvState:
    """Does to one UGV what the failsafe table says; what only UAVs can do means holding for a UGV."""
    name = _name(turn, ugv)
    if ugv.phase is P.LOST:
        return ugv
    match action:
        case Action.HOLD | Action.DIVERT | Action.LAND_HERE:
            return replace(ugv, held=True)
        case Action.REPLAN_WITHOUT if EventKind.UGV_STUCK in ugv.active and not ugv.stuck:
            turn.want_replan(f"{name} is stuck", urgent=True)
            return replace(ugv, stuck=True)
        case Action.REPLAN_WITHOUT if not ugv.out and not ugv.stuck:
            turn.want_replan(f"{name} cannot take part", urgent=True)
            return replace(ugv, out=True)
        case Action.STOP_MOTORS:
            turn.want_replan(f"{name} is lost", urgent=True)
            ugv = turn.order(ugv, StopMotors(name))
            return replace(ugv, phase=P.LOST, since_s=turn.now_s, out=True, path=None)
        case _:
            return ugv


_STEPS = {P.PARKED: _parked, P.DRIVING: _driving, P.HOLDING: _holding, P.LOST: _lost}


def refused(turn: Turn, ugv: UgvState) -> UgvState:
    """Takes back a drive that the gate refused: the UGV stands where it was."""
    ugv = replace(ugv, order=None)
    if ugv.phase is not P.DRIVING:
        return ugv
    return replace(ugv, phase=P.HOLDING, since_s=turn.now_s, path=None)
