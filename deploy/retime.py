"""From the observed state back to a planning problem: re-timing the plan's rest, and asking for replans."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from deploy.estimate import charge_duration_s
from deploy.flightpath import rest_to_rest_s
from deploy.margin import FULL, flown_uavs, landed_team
from deploy.monitors import would_turn_back
from deploy.settings import Settings
from deploy.state import UAV_FINAL, PlanState, UavPhase, UavState, UgvPhase
from deploy.turn import Turn
from planner.plan import Action, Move, Visit
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate

RESCUE_SHARE = 0.5
RESCUE_BELOW = 1.02


def excluded(turn: Turn) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """UAVs and UGVs that can take no part in any plan."""
    uavs = tuple(u.index for u in turn.uavs if u.out or u.phase in UAV_FINAL or u.track is None)
    ugvs = tuple(g.index for g in turn.ugvs if g.out or g.stuck or g.phase is UgvPhase.LOST or g.track is None)
    return uavs, ugvs


def remaining(turn: Turn) -> tuple[Action, ...]:
    """The plan's actions that have not begun at a dock and are not done, without those of excluded vehicles."""
    uavs, ugvs = excluded(turn)
    at_dock = {u.action for u in turn.uavs if u.action is not None}
    return tuple(
        a
        for k, a in enumerate(turn.plan.actions)
        if not turn.plan.done[k] and k not in at_dock and not _involves(a, uavs, ugvs)
    )


def _involves(action: Action, uavs: Sequence[int], ugvs: Sequence[int]) -> bool:
    match action:
        case Visit(uav=u):
            return u in uavs
        case Move(ugv=g):
            return g in ugvs
        case _:
            return action.uav in uavs or action.ugv in ugvs


def landing_s(settings: Settings) -> tuple[float, ...]:
    """Mission time that each UAV needs to land from its layer and take off to it again."""
    return tuple(
        (
            rest_to_rest_s(u.altitude_m, u.descent_mps, u.accel_mps2)
            + rest_to_rest_s(u.altitude_m, u.climb_mps, u.accel_mps2)
        )
        / settings.frame.time_scale
        for u in settings.uavs
    )


def problem_now(
    turn: Turn, given_up: frozenset[int] = frozenset(), tolerance: float = 0.0, *, landed: bool = False
) -> Problem:
    """The problem that is left, its time 0 being now (design section 4: replans start from the observed state).

    Args:
        turn: the working copy, estimates updated.
        given_up: tasks to treat as visited.
        tolerance: share of capacity by which reserves are lowered, to judge the plan in force.
        landed: UAVs wait on the ground.
    """
    base = turn.settings.problem
    ready = {
        u.index: _docked_until_s(turn, u) for u in turn.uavs if u.docked is not None and u.phase is not UavPhase.WAITING
    }
    uavs = tuple(_uav(turn, u, ready.get(u.index), tolerance) for u in turn.uavs)
    ugvs = tuple(_ugv(turn, g.index, ready) for g in turn.ugvs)
    if landed:
        uavs, ugvs = landed_team(uavs, ugvs, landing_s(turn.settings))
    if tolerance > 0:
        uavs = flown_uavs(uavs, ugvs)
    visited = np.array([v or m in given_up for m, v in enumerate(turn.visited)])
    return replace(base, uavs=uavs, ugvs=ugvs, visited=visited)


def _docked_until_s(turn: Turn, uav: UavState) -> float:
    """Mission seconds until a UAV at a dock is full and clear of it."""
    assert uav.docked is not None  # the caller has asked
    settings, scale = turn.settings, turn.settings.frame.time_scale
    ugv, model = settings.problem.ugvs[uav.docked[0]], settings.problem.uavs[uav.index]
    if uav.phase is UavPhase.DOCKING:
        return ugv.dock_s + charge_duration_s(settings, uav.docked[0], uav.index, uav.energy_j) + ugv.undock_s
    if uav.phase is not UavPhase.CHARGING:
        return ugv.undock_s
    elapsed_s = (turn.now_s - uav.since_s) / scale
    full_s = charge_duration_s(settings, uav.docked[0], uav.index, uav.charge_from_j)
    left_s = max(0.0, full_s - elapsed_s)
    gained_j = uav.energy_j - uav.charge_from_j
    if settings.uavs[uav.index].energy == "measured" and elapsed_s > 0.1 * full_s and gained_j > 0:
        left_s = elapsed_s * (model.capacity_j - uav.energy_j) / gained_j
    return left_s + ugv.undock_s


def _uav(turn: Turn, uav: UavState, docked_until_s: float | None, tolerance: float) -> Uav:
    model, config = turn.settings.problem.uavs[uav.index], turn.settings.uavs[uav.index]
    reserve_j = max(0.0, model.reserve_j - tolerance * model.capacity_j)
    if uav.track is None:
        return replace(model, reserve_j=reserve_j)
    position = turn.settings.frame.to_world(uav.track.position_m[:2])
    if docked_until_s is not None:
        assert uav.docked is not None
        site = turn.ugvs[uav.docked[0]].site
        if site is not None:
            x, y = turn.settings.problem.sites[site]
            position = (float(x), float(y))
        full = uav.phase in (UavPhase.DOCKING, UavPhase.CHARGING) or uav.charge_seen
        leaving_j = model.hover_w * turn.settings.problem.ugvs[uav.docked[0]].undock_s
        energy_j = max(0.0, (FULL * model.capacity_j if full else uav.energy_j) - leaving_j)
        return replace(model, position=position, energy_j=energy_j, reserve_j=reserve_j, ready_s=docked_until_s)
    ready_s = 0.0
    if uav.phase in (UavPhase.ON_PAD, UavPhase.TAKING_OFF, UavPhase.LANDING):
        climb_m = max(0.0, config.altitude_m - uav.track.position_m[2])
        ready_s = rest_to_rest_s(climb_m, config.climb_mps, config.accel_mps2) / turn.settings.frame.time_scale
    energy_j = max(0.0, uav.energy_j - model.hover_w * ready_s)  # the planner's UAV begins when it has climbed
    if energy_j < RESCUE_BELOW * turn.settings.problem.uavs[uav.index].reserve_j:
        # A UAV that has come below its reserve may use a part of it to be rescued; else no plan would exist. Judged
        # without the tolerance: what the planner may use when asked, its answer may use when it comes.
        reserve_j = RESCUE_SHARE * energy_j
    if uav.phase is UavPhase.ON_PAD and uav.site is not None and would_turn_back(turn, uav):
        # It may not fly anywhere: a UGV must come to where it stands.
        x, y = turn.settings.problem.sites[uav.site]
        position, reserve_j = (float(x), float(y)), (1 - 1e-6) * energy_j
    return replace(model, position=position, energy_j=energy_j, reserve_j=reserve_j, ready_s=ready_s)


def _ugv(turn: Turn, index: int, ready: dict[int, float]) -> Ugv:
    model, ugv = turn.settings.problem.ugvs[index], turn.ugvs[index]
    docks = [0.0] * model.docks
    for guest in turn.guests(index):
        assert guest.docked is not None
        docks[guest.docked[1]] = ready.get(guest.index, 0.0)
    if ugv.track is None:
        return model
    at, position, distances = None, None, None
    if ugv.site is None:
        position = turn.settings.frame.to_world(ugv.track.position_m[:2])
        distances = tuple(turn.settings.roads.distances_from(position).tolist())
    elif ugv.site != turn.settings.problem.depot_index:
        at = ugv.site
    return replace(
        model,
        energy_j=ugv.energy_j,
        ready_s=0.0,
        dock_ready_s=tuple(docks),
        path_point=at,
        position=position,
        distance_to_m=distances,
    )


def plan_state(
    settings: Settings,
    problem: Problem,
    actions: Sequence[Action],
    *,
    number: int,
    at_s: float,
    exclude: tuple[Sequence[int], Sequence[int]] = ((), ()),
    given_up: frozenset[int] = frozenset(),
    landed: bool = False,
) -> PlanState:
    """The plan in force from its actions.

    Args:
        settings: of the mission.
        problem: that the actions refer to; its time 0 is mission time ``at_s``.
        actions: joint actions in decision order.
        number: of the plan.
        at_s: mission time.
        exclude: indices of UAVs and UGVs that take no part.
        given_up: tasks that the plan leaves out.
        landed: it counts on waiting on the ground.
    """
    schedule = evaluate(problem, actions, exclude_uavs=exclude[0], exclude_ugvs=exclude[1])
    at: dict[int, int | None] = {}
    for i, g in enumerate(problem.ugvs):
        depot = problem.depot_index if g.path_point is None else g.path_point
        at[i] = None if g.distance_to_m is not None else depot
    sites: list[int | None] = []
    for action in actions:
        if isinstance(action, Move):
            at[action.ugv] = problem.depot_index if action.path_point is None else action.path_point
        sites.append(None if isinstance(action, Visit) else at[action.ugv])
    return PlanState(
        number=number,
        actions=tuple(actions),
        done=(False,) * len(actions),
        docks=tuple(row.dock for row in schedule.actions),
        sites=tuple(sites),
        slack_s=tuple(row.slack_s for row in schedule.actions),
        baseline_s=at_s + schedule.makespan_s,
        planned_s=at_s + schedule.makespan_s,
        predicted_s=at_s + schedule.makespan_s,
        violation=None if schedule.feasible or given_up else schedule.violation,
        given_up=given_up,
        landed=landed,
    )
