"""Planning for what is really flown, with a margin above the reserve where a plan exists that keeps it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner.problem import Problem, Uav, Ugv

FULL = 0.995  # of capacity: more is not waited for
KEPT_TO_FLY = 0.5


def as_flown(problem: Problem, *, docking: bool = True) -> Problem:
    """The problem with what docks really cost: the planner's take time but no energy (design section 2).

    A UAV that leaves a dock has hovered up to its layer, and a charger ends a little short of full. One docking is kept
    above reserve, so that a plan does not land on less (``docking`` false leaves that out).
    """
    return replace(problem, uavs=flown_uavs(problem.uavs, problem.ugvs, docking=docking))


def flown_uavs(uavs: Sequence[Uav], ugvs: Sequence[Ugv], *, docking: bool = True) -> tuple[Uav, ...]:
    """The UAVs of ``as_flown``."""
    down_s = max((g.dock_s for g in ugvs), default=0.0) if docking else 0.0
    up_s = max((g.undock_s for g in ugvs), default=0.0)
    return tuple(
        replace(u, capacity_j=FULL * u.capacity_j - u.hover_w * up_s, reserve_j=_raised(u, u.hover_w * down_s))
        for u in uavs
    )


def with_margin(problem: Problem, margin: float) -> Problem:
    """``as_flown`` with each UAV's reserve raised by the share ``margin`` of its capacity besides."""
    flown = as_flown(problem)
    uavs = tuple(replace(u, reserve_j=_raised(u, margin * u.capacity_j)) for u in flown.uavs)
    return replace(flown, uavs=uavs)


def _raised(uav: Uav, more_j: float) -> float:
    """A higher reserve; a UAV with little energy keeps half of it to fly with, for it must still be planned for."""
    return max(uav.reserve_j, min(uav.reserve_j + more_j, KEPT_TO_FLY * uav.energy_j))


def landed_waiting(problem: Problem, extra_s: Sequence[float]) -> Problem:
    """The problem in which UAVs wait on the ground: what it costs to land and take off again is kept in reserve.

    Args:
        problem: with whatever way of waiting.
        extra_s: time of landing and taking off, per UAV.
    """
    uavs, ugvs = landed_team(problem.uavs, problem.ugvs, extra_s)
    return replace(problem, uavs=uavs, ugvs=ugvs)


def landed_team(
    uavs: Sequence[Uav], ugvs: Sequence[Ugv], extra_s: Sequence[float]
) -> tuple[tuple[Uav, ...], tuple[Ugv, ...]]:
    """The vehicles of ``landed_waiting``."""
    longest_s = max(extra_s)
    return tuple(
        replace(u, waiting="landed", reserve_j=max(u.reserve_j, min(u.reserve_j + u.hover_w * s, 0.7 * u.energy_j)))
        for u, s in zip(uavs, extra_s, strict=True)
    ), tuple(replace(g, dock_s=g.dock_s + longest_s) for g in ugvs)
