"""When a virtual clock must run the next turn: the earliest moment at which time alone, or nearness, decides something.

What the world decides (an arrival, a flag, a pose that stays away) wakes the clock by itself. A test compares the
decisions with those of a loop that never skips a turn.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from deploy.estimate import charge_duration_s
from deploy.settings import Settings
from deploy.state import AIRBORNE, MissionPhase, State, UavPhase, UavState, UgvPhase, UgvState
from drivers.vehicle import Drive, GoTo, Hold, TakeOff

NEAR_S = 0.2  # turns at most this far apart where something is about to be reached or two vehicles are near one another
NEAR_SHARE = 0.15  # of the time in which a UAV stops from cruise, for small and nimble ones
SILENT_S = 0.03  # a pose older than this has not come in time


def wake_s(settings: Settings, state: State, now_s: float) -> float:
    """The time of the next turn at the latest, always later than ``now_s``."""
    if state.phase not in (MissionPhase.RUNNING, MissionPhase.HOLDING, MissionPhase.RECOVERING):
        return now_s + near_s(settings)
    earliest_s = min(t for t in _candidates(settings, state, now_s) if t > now_s)
    return min(earliest_s, now_s + settings.replanning.review_s)


def near_s(settings: Settings) -> float:
    """How far apart turns are where something is about to be reached."""
    return min(NEAR_S, NEAR_SHARE * min(u.speed_mps / u.accel_mps2 for u in settings.uavs))


def _candidates(settings: Settings, state: State, now_s: float) -> Iterator[float]:
    yield state.review_s + settings.replanning.review_s
    yield now_s + settings.replanning.review_s
    if state.pending is not None:
        yield state.pending.asked_s + settings.monitors.planner_late_s
    for uav in state.uavs:
        yield from _unit(settings, uav, now_s)
        yield from _uav(settings, uav, now_s)
    for ugv in state.ugvs:
        yield from _unit(settings, ugv, now_s)
        if ugv.phase is UgvPhase.DRIVING:
            yield ugv.progress_s + settings.monitors.ugv_stuck_s
    flying = [u for u in state.uavs if u.phase in AIRBORNE and u.track is not None]
    for i, a in enumerate(flying):
        for b in flying[i + 1 :]:
            if _near(settings, a, b):
                yield now_s + near_s(settings)
    for i, first in enumerate(state.ugvs):
        for second in state.ugvs[i + 1 :]:
            if UgvPhase.DRIVING in (first.phase, second.phase) and _near_on_the_road(settings, first, second):
                yield now_s + NEAR_S


def _unit(settings: Settings, unit: UavState | UgvState, now_s: float) -> Iterator[float]:
    m, order = settings.monitors, unit.order
    yield unit.retry_s
    if order is not None:
        yield order.sent_s + m.command_confirm_s * (2 if order.confirmed else 1)
        if unit.track is not None and _almost_there(settings, unit, order.command):
            yield now_s + near_s(settings)
    if unit.track is not None and now_s - unit.track.stamp_s > SILENT_S:
        yield unit.track.stamp_s + m.pose_stale_s + 1e-3
        yield unit.track.stamp_s + m.pose_lost_s + 1e-3
        yield unit.track.same_since_s + m.pose_frozen_s
        yield now_s + near_s(settings)
    if unit.telemetry is not None:
        yield unit.telemetry.stamp_s + m.telemetry_stale_s + 1e-3
        yield unit.telemetry.stamp_s + m.link_lost_s + 1e-3


def _almost_there(settings: Settings, unit: UavState | UgvState, command: object) -> bool:
    assert unit.track is not None  # the caller has asked
    p, arrival_m = unit.track.position_m, settings.monitors.arrival_m
    match command:
        case GoTo(position_m=goal):
            left_m = math.dist(p, goal)
        case TakeOff(altitude_m=altitude_m):
            left_m = abs(p[2] - altitude_m)
        case Drive(path_m=path_m):
            left_m = math.dist(p[:2], path_m[-1])
        case Hold():
            return unit.track.speed_mps > arrival_m / 2
        case _:
            return False
    # Until it has come to rest too: the estimate of its speed needs looks at it.
    resting = left_m <= arrival_m and unit.track.speed_mps <= arrival_m
    return not resting and left_m < 2 * arrival_m + 2 * unit.track.speed_mps


def _uav(settings: Settings, uav: UavState, now_s: float) -> Iterator[float]:
    m = settings.monitors
    if uav.work_until_s is not None:
        yield uav.work_until_s
    if uav.off_path_since_s is not None:
        yield uav.off_path_since_s + m.tracking_error_s
    if uav.phase is UavPhase.DOCKING:
        yield uav.since_s + m.dock_timeout_s + 1e-3
        yield now_s + near_s(settings)
    if uav.phase is UavPhase.CHARGING and uav.docked is not None:
        yield uav.since_s + m.charge_confirm_s + 1e-3
        if settings.uavs[uav.index].energy == "virtual":
            full_s = charge_duration_s(settings, uav.docked[0], uav.index, uav.charge_from_j)
            yield uav.since_s + full_s * settings.frame.time_scale


def _near_on_the_road(settings: Settings, a: UgvState, b: UgvState) -> bool:
    """Whether two UGVs, one of which drives, could come too near to each other before the next review or stop."""
    if a.track is None or b.track is None:
        return False
    config, other = settings.ugvs[a.index], settings.ugvs[b.index]
    stop_s = 1.0 + max(config.speed_mps / config.accel_mps2, other.speed_mps / other.accel_mps2)
    reach_m = settings.separation.ugv_m + (config.speed_mps + other.speed_mps) * (settings.replanning.review_s + stop_s)
    return math.dist(a.track.position_m[:2], b.track.position_m[:2]) < reach_m


def _near(settings: Settings, a: UavState, b: UavState) -> bool:
    """Whether two flying UAVs could come into each other's cylinder before the next review."""
    assert a.track is not None and b.track is not None  # the caller has asked
    s, speed_mps = settings.separation, settings.uavs[a.index].speed_mps + settings.uavs[b.index].speed_mps
    vertical_mps = settings.uavs[a.index].climb_mps + settings.uavs[b.index].climb_mps
    near_h_m = s.horizontal_m + s.buffer_m + 2 * speed_mps
    near_v_m = s.vertical_m + s.buffer_m + 2 * vertical_mps
    p, q = a.track.position_m, b.track.position_m
    return math.dist(p[:2], q[:2]) < near_h_m and abs(p[2] - q[2]) < near_v_m
