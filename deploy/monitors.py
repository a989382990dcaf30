"""The monitors: what is wrong right now. Pure and level-triggered; ``supervisor`` makes events and actions of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import shapely

from deploy.estimate import measured_j
from deploy.events import EventKind
from deploy.fence import line_of, margin_m
from deploy.flightpath import rest_to_rest_s
from deploy.settings import UavSettings
from deploy.state import AIRBORNE, Finding, Track, UavPhase, UavState, UgvPhase, UgvState
from deploy.turn import Turn
from drivers.vehicle import Drive, GoTo, Vec3, VehicleState
from planner.plan import Recharge

K = EventKind
LANDING_SPARE = 1.2  # times the energy of coming straight down


def findings(turn: Turn) -> list[Finding]:
    """Everything that is wrong right now, in the order of the vehicles."""
    found: list[Finding] = []
    for uav in turn.uavs:
        if uav.phase is not UavPhase.LOST:
            found.extend(_uav(turn, uav, turn.settings.uavs[uav.index]))
    for ugv in turn.ugvs:
        if ugv.phase is not UgvPhase.LOST:
            found.extend(_ugv(turn, ugv))
    found.extend(_separation(turn))
    late_s, limit_s = turn.observation.late_s, turn.settings.monitors.loop_late_s
    if late_s > limit_s:
        found.append(Finding(K.GROUND_OVERLOADED, None, f"the loop runs {late_s:.2f} s late (limit {limit_s:.2f} s)"))
    return found


def _poses(turn: Turn, name: str, track: Track | None, *, moving: bool) -> Iterator[Finding]:
    m, now_s = turn.settings.monitors, turn.now_s
    if track is None:
        yield Finding(K.POSE_STALE, name, f"{name} has not been seen by motion capture yet")
        return
    if track.swapped:
        yield Finding(K.POSE_SWAP, name, f"motion capture has exchanged {name} with another vehicle")
    elif track.jumped and moving:
        off_m = math.dist(track.raw_m, track.position_m)
        yield Finding(K.POSE_JUMP, name, f"the pose of {name} has jumped by {off_m:.2f} m")
    frozen_s = track.raw_stamp_s - track.same_since_s
    if frozen_s >= m.pose_frozen_s:
        yield Finding(K.POSE_FROZEN, name, f"the pose of {name} has been the same to the last bit for {frozen_s:.2f} s")
    age_s = now_s - track.stamp_s
    if age_s > m.pose_lost_s:
        yield Finding(K.POSE_LOST, name, f"no trusted pose of {name} for {m.pose_lost_s:g} s")
    elif age_s > m.pose_stale_s:
        yield Finding(K.POSE_STALE, name, f"no trusted pose of {name} for {m.pose_stale_s:g} s")


def _telemetry(turn: Turn, name: str, telemetry: VehicleState | None) -> Iterator[Finding]:
    m = turn.settings.monitors
    if telemetry is None:
        yield Finding(K.LINK_LOST, name, f"{name} has never reported")
        return
    age_s = turn.now_s - telemetry.stamp_s
    if not telemetry.link or age_s > m.link_lost_s:
        yield Finding(K.LINK_LOST, name, f"the link to {name} is lost (limit {m.link_lost_s:g} s of silence)")
    elif age_s > m.telemetry_stale_s:
        yield Finding(K.TELEMETRY_STALE, name, f"no telemetry of {name} for {m.telemetry_stale_s:g} s")
    if telemetry.tumbled:
        yield Finding(K.TUMBLED, name, f"{name} is tumbled or has crashed")
    elif telemetry.locked:
        yield Finding(K.COMMAND_FAILED, name, f"{name} is locked and follows nothing; reboot it before its next flight")


def _command(turn: Turn, name: str, unit: UavState | UgvState) -> Iterator[Finding]:
    m, order = turn.settings.monitors, unit.order
    # A drive that gets nowhere is stuck, a docking that turns back is missed: those have monitors of their own.
    if order is None or order.confirmed or unit.out or isinstance(order.command, Drive) or _turned_back(turn, unit):
        return
    if order.attempts >= m.command_attempts and turn.now_s - order.sent_s >= m.command_confirm_s:
        what = type(order.command).__name__
        yield Finding(K.COMMAND_FAILED, name, f"{name} does not follow {what} after {order.attempts} attempts")


def _turned_back(turn: Turn, unit: UavState | UgvState) -> bool:
    """Whether a docking UAV is higher than it has been: it climbs away from the dock."""
    if not isinstance(unit, UavState) or unit.phase is not UavPhase.DOCKING or unit.track is None:
        return False
    return unit.track.position_m[2] > unit.lowest_m + turn.settings.monitors.arrival_m


def _fence(turn: Turn, name: str, position_m: Vec3) -> Iterator[Finding]:
    fence = turn.settings.geofence
    x, y, z = position_m
    inside_m = min(margin_m(fence.polygon_m, x, y), fence.ceiling_m - z)
    if inside_m < 0:
        yield Finding(K.GEOFENCE_HARD, name, f"{name} has left the geofence at ({x:.2f}, {y:.2f}, {z:.2f}) m")
    elif inside_m < fence.soft_margin_m:
        yield Finding(K.GEOFENCE_SOFT, name, f"{name} is closer than {fence.soft_margin_m:g} m to the geofence")


def _uav(turn: Turn, uav: UavState, config: UavSettings) -> Iterator[Finding]:
    flying = uav.phase in AIRBORNE
    yield from _poses(turn, config.id, uav.track, moving=flying)
    yield from _telemetry(turn, config.id, uav.telemetry)
    yield from _command(turn, config.id, uav)
    if not flying or uav.track is None:
        return
    yield from _fence(turn, config.id, uav.track.position_m)
    off_s = None if uav.off_path_since_s is None else turn.now_s - uav.off_path_since_s
    if off_s is not None and off_s >= turn.settings.monitors.tracking_error_s:
        limit_m = turn.settings.monitors.tracking_error_m
        yield Finding(K.TRACKING_ERROR, config.id, f"{config.id} is more than {limit_m:g} m off its path")
    if not uav.diverting and not _about_to_dock(turn, uav):
        left_j, floor_j = energy_after_landing_j(turn, uav), _floor_j(turn, uav)
        if left_j < floor_j:
            text = (
                f"{config.id} would land at the nearest site with {max(left_j, 0) / 1e3:.1f} kJ"
                f" (least {floor_j / 1e3:.1f} kJ)"
            )
            yield Finding(K.ENERGY_NO_RETURN, config.id, text)


def _floor_j(turn: Turn, uav: UavState) -> float:
    return turn.settings.monitors.energy_margin * turn.settings.problem.uavs[uav.index].capacity_j


def _about_to_dock(turn: Turn, uav: UavState) -> bool:
    """Whether it can dock at once where it is going: then landing beside the dock would be the greater harm."""
    k = turn.next_of_uav(uav.index)
    if k is None or not isinstance(action := turn.plan.actions[k], Recharge) or not turn.rendezvous_ready(k):
        return False
    assert uav.track is not None  # asked only of UAVs that are seen
    dock_m = turn.dock_m(action.ugv, turn.plan.docks[k] or 0)
    beside_m = math.dist(dock_m, turn.site_m(turn.nearest_site((*dock_m, 0.0))[0]))
    distance_m = math.dist(uav.track.position_m[:2], dock_m)
    return energy_on_dock_j(turn, uav, k) > 0 and distance_m <= beside_m + 1.2 * (
        turn.nearest_site(uav.track.position_m)[1] + 2 * _pad_reach_m(turn, uav)
    )


def energy_on_dock_j(turn: Turn, uav: UavState, k: int) -> float:
    """Energy left after flying to the dock of recharge ``k`` and landing on it, in J; below 0 if it cannot."""
    action = turn.plan.actions[k]
    assert isinstance(action, Recharge) and uav.track is not None  # asked only of UAVs that are seen
    dock_m = turn.dock_m(action.ugv, turn.plan.docks[k] or 0)
    return uav.energy_j - _flight_j(turn, uav, math.dist(uav.track.position_m[:2], dock_m))


def climbed(turn: Turn, uav: UavState) -> UavState:
    """A UAV on the ground as it would be after taking off: at its altitude, with less energy."""
    assert uav.track is not None  # asked only of UAVs that are seen
    config, (x, y, z) = turn.settings.uavs[uav.index], uav.track.position_m
    climb_s = max(0.0, config.altitude_m - z) / config.climb_mps / turn.settings.frame.time_scale
    energy_j = uav.energy_j - turn.settings.problem.uavs[uav.index].hover_w * climb_s
    return replace(uav, track=replace(uav.track, position_m=(x, y, config.altitude_m)), energy_j=energy_j)


def would_turn_back(turn: Turn, uav: UavState) -> bool:
    """Whether a UAV on the ground has too little energy to take off for more than a dock beside it."""
    return energy_after_landing_j(turn, climbed(turn, uav)) < _floor_j(turn, uav)


def only_landing_is_left(turn: Turn, uav: UavState) -> bool:
    """Whether a UAV in the air must come down where it is, now: a little longer and it would fall.

    Here the battery is asked in ``virtual`` mode, too: whatever the model says, an empty one does not fly.
    """
    assert uav.track is not None  # asked only of UAVs that are seen
    model = turn.settings.problem.uavs[uav.index]
    config, height_m = turn.settings.uavs[uav.index], uav.track.position_m[2]
    if uav.phase is UavPhase.DOCKING and uav.docked is not None:  # it comes down on the UGV
        height_m = max(0.0, height_m - turn.settings.ugvs[uav.docked[0]].pad_height_m)
    descent_s = rest_to_rest_s(height_m, config.descent_mps, config.accel_mps2)
    told_j = measured_j(uav.telemetry, model.capacity_j)
    left_j = uav.energy_j if told_j is None else min(uav.energy_j, told_j)
    return left_j < LANDING_SPARE * model.hover_w * descent_s / turn.settings.frame.time_scale


def _pad_reach_m(turn: Turn, uav: UavState) -> float:
    return math.hypot(*turn.settings.uavs[uav.index].pad_offset_m)


def _flight_j(turn: Turn, uav: UavState, distance_m: float) -> float:
    """Energy of flying ``distance_m`` over ground in the arena, braking and landing there, in J."""
    config, model = turn.settings.uavs[uav.index], turn.settings.problem.uavs[uav.index]
    assert uav.track is not None  # asked only of UAVs that are seen
    cruise_s = distance_m / config.speed_mps
    other_s = 2 * config.speed_mps / config.accel_mps2 + uav.track.position_m[2] / config.descent_mps
    return (model.cruise_w * cruise_s + model.hover_w * other_s) / turn.settings.frame.time_scale


def energy_after_landing_j(turn: Turn, uav: UavState) -> float:
    """Energy left after flying to its pad at the nearest site and landing there, in J; below 0 if it cannot."""
    assert uav.track is not None  # asked only of UAVs that are seen
    site, _ = turn.nearest_site(uav.track.position_m)
    return uav.energy_j - _flight_j(turn, uav, math.dist(uav.track.position_m[:2], turn.pad_m(uav.index, site)))


def _ugv(turn: Turn, ugv: UgvState) -> Iterator[Finding]:
    config, m = turn.settings.ugvs[ugv.index], turn.settings.monitors
    driving = ugv.phase is UgvPhase.DRIVING
    yield from _poses(turn, config.id, ugv.track, moving=driving or ugv.phase is UgvPhase.HOLDING)
    yield from _telemetry(turn, config.id, ugv.telemetry)
    yield from _command(turn, config.id, ugv)
    if ugv.track is None or ugv.phase is UgvPhase.PARKED:
        return
    yield from _fence(turn, config.id, (ugv.track.position_m[0], ugv.track.position_m[1], 0.0))
    if len(ugv.route_m) > 1:
        off_m = float(shapely.distance(line_of(ugv.route_m), shapely.points(ugv.track.position_m[:2])))
        if off_m > m.ugv_off_road_m:
            yield Finding(K.UGV_OFF_ROAD, config.id, f"{config.id} is {off_m:.1f} m off its road")
    if driving and turn.now_s - ugv.progress_s >= m.ugv_stuck_s:
        yield Finding(K.UGV_STUCK, config.id, f"{config.id} has not moved for {m.ugv_stuck_s:g} s")


def _separation(turn: Turn) -> Iterator[Finding]:
    s = turn.settings.separation
    flying = [u for u in turn.uavs if u.phase in AIRBORNE and u.track is not None]
    for i, high in enumerate(flying):
        for low in flying[i + 1 :]:
            stops = low if _can_stop(low) or not _can_stop(high) else high
            config = turn.settings.uavs[stops.index]
            ahead_s = 1.0 + config.speed_mps / config.accel_mps2
            near = _soon_near(turn, high, low, ahead_s, *s.near_m)
            if near is not None:
                names = [turn.settings.uavs[u.index].id for u in (high, low)]
                text = f"{names[0]} and {names[1]} come as near as {near[0]:.1f} m and {near[1]:.1f} m in height"
                yield Finding(K.SEPARATION, config.id, text)
    moving = [g for g in turn.ugvs if g.track is not None]
    for i, first in enumerate(moving):
        for second in moving[i + 1 :]:
            driving = [g for g in (second, first) if g.phase is UgvPhase.DRIVING]
            driving.sort(key=lambda g: g.stuck)  # stopping one that does not move helps nobody
            if not driving:
                continue
            config_g = turn.settings.ugvs[driving[0].index]
            ahead_s = 0.5 + config_g.speed_mps / config_g.accel_mps2
            near = _soon_near(turn, first, second, ahead_s, s.ugv_m, math.inf)
            if near is not None:
                names = [turn.settings.ugvs[g.index].id for g in (first, second)]
                text = f"{names[0]} and {names[1]} come as near as {near[0]:.2f} m"
                yield Finding(K.SEPARATION, turn.settings.ugvs[driving[0].index].id, text)


def _can_stop(uav: UavState) -> bool:
    """Whether holding this UAV helps: it is on a straight flight rather than hovering or in a vertical motion."""
    return (
        uav.phase in (UavPhase.FLYING, UavPhase.WAITING)
        and uav.order is not None
        and isinstance(uav.order.command, GoTo)
    )


def _soon_near(
    turn: Turn, a: UavState | UgvState, b: UavState | UgvState, ahead_s: float, horizontal_m: float, vertical_m: float
) -> tuple[float, float] | None:
    """Whether both come into each other's cylinder within ``ahead_s`` while getting nearer: how near, or None."""
    assert a.track is not None and b.track is not None  # the caller has asked
    pa, pb = a.track.position_m, b.track.position_m
    va, vb = _ahead(turn, a, ahead_s), _ahead(turn, b, ahead_s)
    dx, dy, dz = pb[0] - pa[0], pb[1] - pa[1], pb[2] - pa[2]
    ex, ey, ez = vb[0] - va[0], vb[1] - va[1], vb[2] - va[2]
    ee, de = ex * ex + ey * ey, dx * ex + dy * ey
    inside_h = _below_zero(ee, de, dx * dx + dy * dy - horizontal_m**2)
    inside_v = _below_zero(ez * ez, dz * ez, dz * dz - vertical_m**2)
    if inside_h is None or inside_v is None:
        return None
    first, last = max(inside_h[0], inside_v[0]), min(inside_h[1], inside_v[1])
    if first > last:
        return None
    nearest = min(last, max(first, -de / ee)) if ee > 0 else last
    for f in (nearest, last):
        h_m, v_m = math.hypot(dx + f * ex, dy + f * ey), abs(dz + f * ez)
        if h_m < math.hypot(dx, dy) - 1e-6 or v_m < abs(dz) - 1e-6:
            return h_m, v_m
    return None


def _below_zero(a: float, b: float, c: float) -> tuple[float, float] | None:
    """The part of 0..1 where ``a f^2 + 2 b f + c`` is below 0, for a square's ``a`` >= 0 (0 where nothing moves)."""
    if a == 0:
        return (0.0, 1.0) if c < 0 else None
    under_root = b * b - a * c
    if under_root <= 0:
        return None
    root = math.sqrt(under_root)
    first, last = max(0.0, (-b - root) / a), min(1.0, (-b + root) / a)
    return (first, last) if first <= last else None


def _ahead(turn: Turn, unit: UavState | UgvState, ahead_s: float) -> Vec3:
    """How far the unit's committed path takes it within ``ahead_s``."""
    path = unit.path
    if path is None or (isinstance(unit, UgvState) and unit.stuck):
        return (0.0, 0.0, 0.0)
    begin_s = turn.now_s - turn.lateness_s(unit)
    now, then = path.at(begin_s), path.at(begin_s + ahead_s)
    return (then[0] - now[0], then[1] - now[1], then[2] - now[2])


def note_deviation(turn: Turn, uav: UavState) -> UavState:
    """Keeps since when a UAV has been off its straight path."""
    order = uav.order
    if uav.track is None or uav.path is None or order is None or not isinstance(order.command, GoTo):
        return uav if uav.off_path_since_s is None else replace(uav, off_path_since_s=None)
    a, b, p = uav.path.knots[0][1:], order.command.position_m, uav.track.position_m
    ab = tuple(bi - ai for ai, bi in zip(a, b, strict=True))
    length2 = sum(c * c for c in ab)
    f = (
        0.0
        if length2 == 0
        else min(1.0, max(0.0, sum((pi - ai) * c for pi, ai, c in zip(p, a, ab, strict=True)) / length2))
    )
    off_m = math.dist(p, tuple(ai + f * c for ai, c in zip(a, ab, strict=True)))
    if off_m <= turn.settings.monitors.tracking_error_m:
        return uav if uav.off_path_since_s is None else replace(uav, off_path_since_s=None)
    return uav if uav.off_path_since_s is not None else replace(uav, off_path_since_s=turn.now_s)
