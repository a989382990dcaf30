"""What each UAV does next: a small state machine that starts an action when its preconditions are really met.

Nothing is started by the clock. The plan's order is kept per UAV, per UGV and per dock (an action dependency graph, as
in multi-agent path execution), so a delay makes others wait but never deadlocks them.
"""

from __future__ import annotations

import math
from dataclasses import replace

from deploy.estimate import charge_duration_s
from deploy.events import Action, EventKind
from deploy.failsafe import Situation, action_for
from deploy.flightpath import TimedPath, column, resting, straight
from deploy.margin import FULL
from deploy.monitors import climbed, energy_on_dock_j, only_landing_is_left, would_turn_back
from deploy.state import AIRBORNE, UAV_FINAL, MissionPhase, UavPhase, UavState
from deploy.turn import RESTING, Turn
from drivers.vehicle import Arm, Dock, GoTo, Hold, Land, StopMotors, TakeOff, Vec2, Vec3
from planner.plan import Recharge, Visit

RETRY_S = 1.0
OVERTIME = 2.0  # of the time that a charge should take
ON_THE_GROUND = 0.5  # of the cruise altitude: below it and not airborne counts as landed
P = UavPhase


def advance(turn: Turn, index: int) -> None:
    """Advances one UAV by one turn: changes its state, orders commands, tells events."""
    uav = turn.uavs[index]
    if uav.phase in AIRBORNE and uav.phase is not P.LANDING and _fell_out_of_the_air(turn, uav):
        name = turn.settings.uavs[index].id
        turn.tell(EventKind.UAV_DOWN, f"{name} has landed by itself; it is left out from now on", name)
        turn.want_replan(f"{name} has landed by itself", urgent=True)
        turn.uavs[index] = _to(turn, uav, P.DOWN, out=True, path=None, docked=None, action=None)
        return
    if uav.phase in (P.FLYING, P.WAITING, P.DOCKING) and only_landing_is_left(turn, uav):
        name = turn.settings.uavs[index].id
        text = f"{name} lands where it is: its energy is enough for nothing else"
        turn.tell(EventKind.ENERGY_NO_RETURN, text, name, Action.LAND_HERE)
        turn.uavs[index] = uav = apply(turn, uav, Action.LAND_HERE)
    turn.uavs[index] = _STEPS[uav.phase](turn, uav)


def _fell_out_of_the_air(turn: Turn, uav: UavState) -> bool:
    """Landed or switched off without being told to, by fresh telemetry that agrees with the pose."""
    telemetry, track = uav.telemetry, uav.track
    if uav.phase not in (P.FLYING, P.WAITING) or telemetry is None or track is None:
        return False
    settled = telemetry.stamp_s > uav.since_s + turn.settings.monitors.telemetry_stale_s
    return settled and not telemetry.airborne and not telemetry.armed


def _to(turn: Turn, uav: UavState, phase: UavPhase, **changes: object) -> UavState:
    return replace(uav, phase=phase, since_s=turn.now_s, **changes)  # type: ignore[arg-type]


def _running(turn: Turn) -> bool:
    return turn.state.phase is MissionPhase.RUNNING


def _may_move(turn: Turn, uav: UavState) -> bool:
    """Neither held nor asked to wait, with a pose to steer by."""
    return not uav.held and turn.now_s >= uav.retry_s and turn.fresh(uav)


def _position(uav: UavState) -> Vec3:
    assert uav.track is not None  # nothing moves before it has been seen
    return uav.track.position_m


def _name(turn: Turn, uav: UavState) -> str:
    return turn.settings.uavs[uav.index].id


# --- on the ground --------------------------------------------------------------------------------------------------


def _on_pad(turn: Turn, uav: UavState) -> UavState:
    if turn.state.phase is MissionPhase.RECOVERING or uav.out:
        return _to(turn, uav, P.DOWN, action=None)
    if not _running(turn):
        return uav
    k = turn.next_of_uav(uav.index)
    if k is None and (uav.docked is None or not _in_the_way_at_dock(turn, uav.docked[0])):
        return _finish_recharge(turn, uav) if uav.docked is not None else uav
    if k is not None and uav.docked is None and _waits_on_the_ground(turn, uav, k):
        return uav
    if not _may_move(turn, uav):
        return uav
    if uav.docked is None and k is not None and _too_empty(turn, uav, k):
        turn.want_replan(f"{_name(turn, uav)} has too little energy to take off", urgent=True)
        return replace(uav, out=_is_here(turn, uav, k))  # not even for the dock beside it: it stays where it is
    if uav.docked is not None and any(g.index != uav.index and g.phase in AIRBORNE for g in turn.guests(uav.docked[0])):
        return uav  # another UAV is in the column above this UGV
    if uav.telemetry is None or not uav.telemetry.armed:
        return turn.order(uav, Arm(_name(turn, uav)))
    config = turn.settings.uavs[uav.index]
    x, y, _ = _position(uav)
    path = straight(_position(uav), (x, y, config.altitude_m), turn.now_s, config.climb_mps, config.accel_mps2)
    if (blocker := turn.uav_in_the_way(uav.index, path)) is not None:
        return _wait(turn, uav, f"{config.id} waits on the ground for {blocker} to pass")
    uav = turn.order(uav, TakeOff(config.id, config.altitude_m, config.climb_mps))
    return _to(turn, uav, P.TAKING_OFF, path=path, active=uav.active - {EventKind.CONFLICT_HELD})


def _in_the_way_at_dock(turn: Turn, ugv: int) -> bool:
    """Whether the UGV still has something to do for which its dock or its freedom to move is needed."""
    return any(
        not done and getattr(a, "ugv", None) == ugv
        for a, done in zip(turn.plan.actions, turn.plan.done, strict=True)
        if not isinstance(a, Recharge) or a.uav not in {u.index for u in turn.guests(ugv)}
    )


def _is_here(turn: Turn, uav: UavState, k: int) -> bool:
    """Whether action ``k`` is a rendezvous where the UAV has landed."""
    return isinstance(turn.plan.actions[k], Recharge) and uav.site == turn.plan.sites[k]


def _too_empty(turn: Turn, uav: UavState, k: int) -> bool:
    if _is_here(turn, uav, k):
        return energy_on_dock_j(turn, climbed(turn, uav), k) <= 0
    return would_turn_back(turn, uav)


def _waits_on_the_ground(turn: Turn, uav: UavState, k: int) -> bool:
    """A UAV that has landed at its rendezvous stays down until it can dock."""
    return _is_here(turn, uav, k) and not turn.rendezvous_ready(k)


def _wait(turn: Turn, uav: UavState, text: str) -> UavState:
    if EventKind.CONFLICT_HELD not in uav.active:
        turn.tell(EventKind.CONFLICT_HELD, text, _name(turn, uav))
    return replace(uav, retry_s=turn.now_s + RETRY_S, active=uav.active | {EventKind.CONFLICT_HELD})


# --- in the air -----------------------------------------------------------------------------------------------------


def _taking_off(turn: Turn, uav: UavState) -> UavState:
    config = turn.settings.uavs[uav.index]
    if uav.held:
        return turn.order(uav, Hold(config.id))
    x, y, z = _position(uav)
    if turn.fresh(uav) and abs(z - config.altitude_m) <= turn.settings.monitors.arrival_m:
        uav = _finish_recharge(turn, uav)
        return _to(turn, uav, P.FLYING, path=resting((x, y, config.altitude_m), turn.now_s), docked=None, site=None)
    return turn.order(uav, TakeOff(config.id, config.altitude_m, config.climb_mps))


def _finish_recharge(turn: Turn, uav: UavState) -> UavState:
    """Marks the recharge that a full UAV has just left as done; an interrupted one stays in the plan."""
    if uav.docked is None or not uav.charge_seen:
        return replace(uav, action=None)
    name = _name(turn, uav)
    if uav.action is not None:
        turn.mark_done(uav.action)
    given_j = uav.energy_j - uav.charge_from_j
    ugv = turn.settings.ugvs[uav.docked[0]].id
    turn.tell(EventKind.RECHARGE_DONE, f"{name} is recharged by {ugv} ({max(given_j, 0) / 1e3:.1f} kJ)", name)
    return replace(uav, action=None, charge_seen=False, dock_attempts=0)


def _flying(turn: Turn, uav: UavState) -> UavState:
    if uav.held or (turn.state.phase is MissionPhase.HOLDING and not uav.diverting):
        return _hover(turn, replace(uav, work_until_s=None))
    k = turn.next_of_uav(uav.index) if _running(turn) and not uav.diverting else None
    if k is None:
        return _go_home(turn, uav)
    action = turn.plan.actions[k]
    if isinstance(action, Visit):
        x, y = turn.settings.problem.tasks[action.task]
        uav, there = _fly(turn, replace(uav, site=None), turn.settings.frame.to_arena((float(x), float(y))))
        return _serve(turn, uav, k, action.task) if there else replace(uav, work_until_s=None)
    assert isinstance(action, Recharge)  # a UAV's actions are visits and recharges
    site = turn.plan.sites[k]
    assert site is not None  # a feasible plan recharges only where the UGV stops
    uav, there = _fly(turn, uav, turn.pad_m(uav.index, site))
    return _to(turn, uav, P.WAITING, site=site) if there else uav


def _serve(turn: Turn, uav: UavState, k: int, task: int) -> UavState:
    name = _name(turn, uav)
    if uav.work_until_s is None:
        config = turn.settings.uavs[uav.index]
        service_s = turn.settings.problem.uavs[uav.index].service_s * turn.settings.frame.time_scale
        hover_s = max(0.0, service_s - config.speed_mps / config.accel_mps2)  # the rest is braking and speeding up
        uav = replace(uav, work_until_s=turn.now_s + hover_s)
    assert uav.work_until_s is not None
    if turn.now_s < uav.work_until_s:
        return uav
    turn.mark_done(k)
    turn.visited[task] = True
    turn.state = replace(turn.state, last_visit_s=turn.mission_s)
    turn.tell(EventKind.TASK_VISITED, f"{name} has visited task {task} ({sum(turn.visited)}/{len(turn.visited)})", name)
    return replace(uav, work_until_s=None)


def _go_home(turn: Turn, uav: UavState) -> UavState:
    """Flies to its own pad at the nearest site and lands there."""
    site = uav.site
    if site is None:
        site, _ = turn.nearest_site(_position(uav))
    uav, there = _fly(turn, replace(uav, site=site, work_until_s=None), turn.pad_m(uav.index, site))
    if not there or not _may_move(turn, uav):
        return uav
    config = turn.settings.uavs[uav.index]
    x, y, _ = _position(uav)
    path = straight(_position(uav), (x, y, 0.0), turn.now_s, config.descent_mps, config.accel_mps2)
    if (blocker := turn.uav_in_the_way(uav.index, path)) is not None:
        return _wait(turn, uav, f"{config.id} waits for {blocker} before it lands")
    return _land(turn, replace(uav, path=path))


def _land(turn: Turn, uav: UavState) -> UavState:
    config = turn.settings.uavs[uav.index]
    uav = turn.order(uav, Land(config.id, config.descent_mps))
    return _to(turn, uav, P.LANDING, active=uav.active - {EventKind.CONFLICT_HELD})


def _hover(turn: Turn, uav: UavState) -> UavState:
    if uav.order is None or not isinstance(uav.order.command, Hold):
        uav = replace(uav, path=_braking(turn, uav))
    return turn.order(uav, Hold(_name(turn, uav)))


def _braking(turn: Turn, uav: UavState) -> TimedPath:
    """The place where it comes to rest: on along its path for the braking distance."""
    config = turn.settings.uavs[uav.index]
    p = _position(uav)
    order = uav.order
    if order is None or not isinstance(order.command, GoTo) or uav.track is None:
        return resting(p, turn.now_s)
    goal = order.command.position_m
    left_m = math.dist(p, goal)
    brake_m = min(left_m, uav.track.speed_mps**2 / (2 * config.accel_mps2))
    f = brake_m / left_m if left_m > 0 else 0.0
    return resting((p[0] + f * (goal[0] - p[0]), p[1] + f * (goal[1] - p[1]), p[2] + f * (goal[2] - p[2])), turn.now_s)


def _fly(turn: Turn, uav: UavState, goal_m: Vec2) -> tuple[UavState, bool]:
    """Flies to ``goal_m`` in its own layer or, where that is not free, in another one; else hovers.

    Returns:
        The UAV, and whether it is there.
    """
    config, arrival_m = turn.settings.uavs[uav.index], turn.settings.monitors.arrival_m
    p = _position(uav)
    order = uav.order
    going = (
        order is not None
        and isinstance(order.command, GoTo)
        and math.dist(order.command.position_m[:2], goal_m) <= arrival_m / 2
    )
    if going:
        assert order is not None and isinstance(order.command, GoTo)
        if turn.fresh(uav) and math.dist(p, order.command.position_m) <= arrival_m:
            return uav, True
        return turn.order(uav, order.command), False
    own = (goal_m[0], goal_m[1], config.altitude_m)
    if turn.fresh(uav) and math.dist(p, own) <= arrival_m:
        return uav, True
    if not _may_move(turn, uav):
        return uav, False
    if uav.track is not None and uav.track.speed_mps > RESTING * config.speed_mps:
        return _hover(turn, uav), False  # flights go from rest to rest; one that is under way is stopped first
    blocker = None
    for altitude_m in _layers(turn, uav):
        goal = (goal_m[0], goal_m[1], altitude_m)
        path = straight(p, goal, turn.now_s, config.speed_mps, config.accel_mps2)
        found = turn.uav_in_the_way(uav.index, path)
        if found is None:
            uav = turn.order(uav, GoTo(config.id, goal, config.speed_mps))
            return replace(uav, path=path, active=uav.active - {EventKind.CONFLICT_HELD}), False
        blocker = blocker or found
    return _wait(turn, uav, f"{config.id} hovers until its way is free of {blocker}"), False


def _layers(turn: Turn, uav: UavState) -> list[float]:
    """The altitude layers to try, its own first, then by distance from it."""
    own = turn.settings.uavs[uav.index].altitude_m
    return sorted({u.altitude_m for u in turn.settings.uavs}, key=lambda a: (abs(a - own), a))


# --- at a rendezvous ------------------------------------------------------------------------------------------------


def _waiting(turn: Turn, uav: UavState) -> UavState:
    k = turn.next_of_uav(uav.index) if turn.state.phase is not MissionPhase.RECOVERING else None
    action = turn.plan.actions[k] if k is not None else None
    if k is None or not isinstance(action, Recharge) or uav.site != turn.plan.sites[k] or uav.diverting:
        return _to(turn, uav, P.FLYING, docked=None, site=uav.site if uav.diverting else None)
    if uav.held or turn.state.phase is MissionPhase.HOLDING:
        return _hover(turn, uav)
    if not turn.rendezvous_ready(k):
        uav = replace(uav, docked=None)
        landed = turn.plan.landed or turn.settings.problem.uavs[uav.index].waiting == "landed"
        return _go_home(turn, uav) if landed and _long_wait(turn, uav, action.ugv) else uav
    dock = turn.plan.docks[k] or 0
    uav, there = _fly(turn, replace(uav, docked=(action.ugv, dock)), turn.dock_m(action.ugv, dock))
    if not there or not _may_move(turn, uav):
        return uav
    config, ugv = turn.settings.uavs[uav.index], turn.settings.ugvs[action.ugv]
    x, y, z = _position(uav)
    path = straight((x, y, z), (x, y, ugv.pad_height_m), turn.now_s, config.descent_mps, config.accel_mps2)
    if (blocker := turn.uav_in_the_way(uav.index, path)) is not None:
        return _wait(turn, uav, f"{config.id} waits for {blocker} before it docks")
    uav = turn.order(uav, Dock(config.id, ugv.id, dock, config.descent_mps, config.altitude_m))
    uav = replace(uav, active=uav.active - {EventKind.CONFLICT_HELD})
    path = column((x, y, ugv.pad_height_m), max(z, config.altitude_m), turn.now_s)
    return _to(turn, uav, P.DOCKING, path=path, action=k, lowest_m=z, charge_seen=False)


def _long_wait(turn: Turn, uav: UavState, ugv: int) -> bool:
    """Whether landing and taking off again costs less time than the UGV still needs."""
    config, road = turn.settings.uavs[uav.index], turn.settings.ugvs[ugv]
    vertical_s = config.altitude_m / config.descent_mps + config.altitude_m / config.climb_mps
    driving = turn.ugvs[ugv]
    return driving.target is None or driving.left_m / road.speed_mps > 2 * vertical_s


def _docking(turn: Turn, uav: UavState) -> UavState:
    assert uav.docked is not None  # set on the way into this phase
    dock, config, ugv = uav.docked[1], turn.settings.uavs[uav.index], turn.settings.ugvs[uav.docked[0]]
    if uav.held:
        return turn.order(uav, Hold(config.id))
    z = _position(uav)[2]
    uav = replace(uav, lowest_m=min(uav.lowest_m, z))
    depth_m = config.altitude_m - ugv.pad_height_m
    if _landed(uav) and turn.fresh(uav) and z <= ugv.pad_height_m + ON_THE_GROUND * depth_m:
        return _to(turn, uav, P.CHARGING, path=None, charge_from_j=uav.energy_j, charge_seen=False)
    climbed = z > uav.lowest_m + ON_THE_GROUND * depth_m
    if climbed or turn.now_s - uav.since_s > turn.settings.monitors.dock_timeout_s:
        return _missed(turn, uav, EventKind.DOCK_MISSED, f"{config.id} has missed the dock of {ugv.id}")
    return turn.order(uav, Dock(config.id, ugv.id, dock, config.descent_mps, config.altitude_m))


def _landed(uav: UavState) -> bool:
    telemetry = uav.telemetry
    return telemetry is not None and not telemetry.airborne and telemetry.stamp_s > uav.since_s


def _missed(turn: Turn, uav: UavState, kind: EventKind, text: str) -> UavState:
    """Tries again as often as the mission allows, then does what the failsafe table says for a UAV in the air.

    The attempts are counted until a charge is confirmed, wherever they were made. A UAV that has used them up takes no
    further part: it would try until it falls.
    """
    attempts = uav.dock_attempts + 1
    last = attempts >= turn.settings.monitors.dock_attempts
    grounded = uav.phase is P.CHARGING
    situation = Situation.GROUND if grounded else Situation.AIR if last else Situation.DOCKING
    action = action_for(kind, situation, turn.settings.failsafe)
    then = "no attempt is left" if last else f"attempt {attempts + 1} follows"
    turn.tell(kind, f"{text}; {then}", _name(turn, uav), action)
    if last:
        turn.want_replan(f"{_name(turn, uav)} cannot dock", urgent=True)
    uav = replace(uav, dock_attempts=attempts, action=None, charge_seen=False, out=uav.out or last)
    if grounded:
        return _to(turn, uav, P.DOWN if last else P.ON_PAD)
    uav = _to(turn, uav, P.WAITING, docked=None, path=resting(_position(uav), turn.now_s))
    return apply(turn, uav, action) if last else uav


def _charging(turn: Turn, uav: UavState) -> UavState:
    assert uav.docked is not None and uav.telemetry is not None  # it has docked by its telemetry
    config, ugv = turn.settings.uavs[uav.index], turn.settings.ugvs[uav.docked[0]]
    model = turn.settings.problem.uavs[uav.index]
    if turn.state.phase is MissionPhase.RECOVERING:
        return _to(turn, uav, P.DOWN, action=None)
    if not uav.charge_seen:
        if uav.telemetry.charging and uav.telemetry.stamp_s > uav.since_s:
            text = f"{config.id} charges at {ugv.id} from {100 * uav.charge_from_j / model.capacity_j:.0f} %"
            turn.tell(EventKind.RECHARGE_STARTED, text, config.id)
            turn.state = replace(turn.state, recharges=turn.state.recharges + 1)
            return replace(uav, charge_seen=True, dock_attempts=0)
        if turn.now_s - uav.since_s > turn.settings.monitors.charge_confirm_s:
            text = f"{config.id} sits on {ugv.id} but does not charge"
            return _missed(turn, uav, EventKind.CHARGE_UNCONFIRMED, text)
        return uav
    full_s = charge_duration_s(turn.settings, uav.docked[0], uav.index, uav.charge_from_j)
    limit_s = OVERTIME * full_s * turn.settings.frame.time_scale + turn.settings.monitors.charge_confirm_s
    if uav.energy_j >= FULL * model.capacity_j or turn.now_s - uav.since_s > limit_s:
        return _to(turn, uav, P.ON_PAD)  # a charge that never ends would hold the UGV, too: it goes on with what it has
    return uav


# --- coming down ----------------------------------------------------------------------------------------------------


def _landing(turn: Turn, uav: UavState) -> UavState:
    config = turn.settings.uavs[uav.index]
    uav = turn.order(uav, Land(config.id, config.descent_mps))
    if not (_landed(uav) or _lies_still(turn, uav)):
        return uav
    where = "" if uav.site is None else f" at {site_name(turn, uav.site)}"
    turn.tell(EventKind.UAV_DOWN, f"{config.id} is on the ground{where}", config.id)
    final = uav.out or uav.site is None
    return _to(turn, uav, P.DOWN if final else P.ON_PAD, path=None, diverting=False, out=final, action=None)


def _lies_still(turn: Turn, uav: UavState) -> bool:
    """Down by its pose alone: for a UAV whose telemetry is gone."""
    telemetry, track = uav.telemetry, uav.track
    silent = telemetry is None or turn.now_s - telemetry.stamp_s > turn.settings.monitors.telemetry_stale_s
    low_m = turn.settings.monitors.arrival_m
    return (
        silent and track is not None and turn.fresh(uav) and track.position_m[2] <= low_m and track.speed_mps <= low_m
    )


def site_name(turn: Turn, site: int) -> str:
    """A site in words."""
    return "the depot" if site == turn.settings.problem.depot_index else f"path point {site}"


def _down(turn: Turn, uav: UavState) -> UavState:
    return uav


def _lost(turn: Turn, uav: UavState) -> UavState:
    """It is asked on and on to stop or to land: it may hear again."""
    if uav.order is not None and isinstance(uav.order.command, StopMotors | Land):
        return turn.order(uav, uav.order.command)
    return uav


def apply(turn: Turn, uav: UavState, action: Action) -> UavState:
    """Does to one UAV what the failsafe table says; actions for the whole team are the supervisor's."""
    name = _name(turn, uav)
    if uav.phase in UAV_FINAL and action is not Action.STOP_MOTORS:
        return uav
    match action:
        case Action.HOLD:
            return replace(uav, held=True)
        case Action.DIVERT if uav.phase is P.TAKING_OFF:  # it leaves its dock first
            return replace(uav, diverting=True)
        case Action.DIVERT if uav.phase in AIRBORNE and uav.phase is not P.LANDING and not uav.diverting:
            return _to(turn, uav, P.FLYING, diverting=True, docked=None, site=None, action=None, work_until_s=None)
        case Action.LAND_HERE if uav.phase in AIRBORNE and uav.phase is not P.LANDING:
            turn.want_replan(f"{name} has to land", urgent=True)
            x, y, z = _position(uav)
            path = straight((x, y, z), (x, y, 0.0), turn.now_s, turn.settings.uavs[uav.index].descent_mps, 1.0)
            docked = None if uav.phase is P.WAITING else uav.docked  # else it comes down on the UGV, which must stay
            return _land(turn, replace(uav, out=True, docked=docked, action=None, site=None, path=path, held=False))
        case Action.REPLAN_WITHOUT if not uav.out:
            turn.want_replan(f"{name} cannot take part", urgent=True)
            return replace(uav, out=True)
        case Action.STOP_MOTORS:
            turn.want_replan(f"{name} is lost", urgent=True)
            uav = turn.order(uav, StopMotors(name))
            return _to(turn, uav, P.LOST, out=True, path=None, action=None)
        case _:
            return uav


_STEPS = {
    P.ON_PAD: _on_pad,
    P.TAKING_OFF: _taking_off,
    P.FLYING: _flying,
    P.WAITING: _waiting,
    P.DOCKING: _docking,
    P.CHARGING: _charging,
    P.LANDING: _landing,
    P.DOWN: _down,
    P.LOST: _lost,
}
assert set(_STEPS) == set(UavPhase) and set(UAV_FINAL) <= set(_STEPS)


def refused(turn: Turn, uav: UavState) -> UavState:
    """Takes back what the gate refused: the UAV is where it was, under no order."""
    uav = replace(uav, order=None)
    match uav.phase:
        case P.TAKING_OFF if not (uav.telemetry is not None and uav.telemetry.airborne):
            return _to(turn, uav, P.ON_PAD, path=None)
        case P.DOCKING:
            return _to(turn, uav, P.WAITING, docked=None, action=None, path=resting(_position(uav), turn.now_s))
        case P.FLYING | P.WAITING | P.TAKING_OFF:
            return replace(uav, path=resting(_position(uav), turn.now_s))
        case _:
            return uav
