"""Bringing everybody down: at the end of the plan, or before it when the mission is called off."""

from __future__ import annotations

import math
from dataclasses import replace

from deploy.events import EventKind
from deploy.state import AIRBORNE, UAV_FINAL, MissionPhase, UgvPhase, UgvState
from deploy.turn import Turn

RECOVERY_LIMIT_S = 7200.0  # on the loop's clock; a UGV that does not move is given up long before


def enter(turn: Turn, phase: MissionPhase, why: str) -> None:
    """The mission enters another state."""
    turn.tell(EventKind.MISSION_STATE, f"{phase.value}: {why}")
    turn.state = replace(turn.state, phase=phase)


def call_off(turn: Turn, why: str) -> None:
    """Everybody in the air comes down at the nearest site, UGVs stop where they are."""
    _begin(turn, why)
    turn.uavs = [replace(u, site=None, work_until_s=None) if u.phase in AIRBORNE else u for u in turn.uavs]
    turn.ugvs = [replace(g, target=None) for g in turn.ugvs]


def finish(turn: Turn) -> None:
    """The plan is done: UAVs still in the air land at their sites, a UGV is sent to each path point with a UAV."""
    _begin(turn, f"{sum(turn.visited)} of {len(turn.visited)} tasks are visited")
    served = {turn.settings.problem.depot_index} | {g.site for g in turn.ugvs} | {g.target for g in turn.ugvs}
    busy = {u.docked[0] for u in turn.uavs if u.docked is not None}
    idle = [g.index for g in turn.ugvs if g.phase is UgvPhase.PARKED and not g.out and g.index not in busy]
    for uav in turn.uavs:
        if uav.phase in UAV_FINAL or uav.docked is not None or uav.track is None:
            continue
        site = uav.site if uav.site is not None else turn.nearest_site(uav.track.position_m)[0]
        turn.uavs[uav.index] = replace(uav, site=site)
        if site in served:
            continue
        roads = {g: _drive_m(turn, g, site) for g in idle}
        best = min(roads, key=lambda g: (roads[g], g), default=None)
        if best is not None and math.isfinite(roads[best]):
            idle.remove(best)
            served.add(site)
            turn.ugvs[best] = replace(turn.ugvs[best], target=site)


def _begin(turn: Turn, why: str) -> None:
    enter(turn, MissionPhase.RECOVERING, why)
    turn.state = replace(turn.state, recovering_since_s=turn.now_s, replan_reason=None, replan_urgent=False)
    turn.pending = None


def _drive_m(turn: Turn, ugv: int, site: int) -> float:
    """Road distance of a parked UGV to a site, in m; inf where its energy does not reach."""
    here = turn.ugvs[ugv].site
    assert here is not None  # it is parked
    distance_m = float(turn.settings.problem.road_distance_m[here, site])
    model = turn.settings.problem.ugvs[ugv]
    return distance_m if distance_m / model.speed_mps * model.drive_w <= turn.ugvs[ugv].energy_j else math.inf


def everybody_down(turn: Turn) -> bool:
    """Every UAV is on the ground or lost, every UGV has stopped (or takes too long to)."""
    if any(u.phase not in UAV_FINAL for u in turn.uavs):
        return False
    late = turn.now_s - turn.state.recovering_since_s > RECOVERY_LIMIT_S
    return late or all(_settled(g) for g in turn.ugvs)


def _settled(ugv: UgvState) -> bool:
    if ugv.out or ugv.stuck or ugv.phase is UgvPhase.LOST:
        return True
    return ugv.target is None and ugv.phase is not UgvPhase.DRIVING
