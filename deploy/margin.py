"""Planning with a margin above the reserve, and without it where no plan exists otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from planner.plan import Plan, Visit
from planner.problem import Problem
from planner.schedule import evaluate, predict
from planner.solve import Params, Stop, solve


def with_margin(problem: Problem, margin: float) -> Problem:
    """The problem with each UAV's reserve raised by the share ``margin`` of its capacity.

    A UAV that has little already keeps half of what it has to fly with: it must still be able to be planned for.
    """
    uavs = tuple(
        replace(u, reserve_j=max(u.reserve_j, min(u.reserve_j + margin * u.capacity_j, 0.5 * u.energy_j)))
        for u in problem.uavs
    )
    return replace(problem, uavs=uavs)


def landed_waiting(problem: Problem, extra_s: Sequence[float]) -> Problem:
    """The problem in which UAVs wait on the ground: what it costs to land and take off again is kept in reserve.

    Args:
        problem: with whatever way of waiting.
        extra_s: time of landing and taking off, per UAV.
    """
    uavs = tuple(
        replace(u, waiting="landed", reserve_j=max(u.reserve_j, min(u.reserve_j + u.hover_w * s, 0.7 * u.energy_j)))
        for u, s in zip(problem.uavs, extra_s, strict=True)
    )
    longest_s = max(extra_s)
    return replace(problem, uavs=uavs, ugvs=tuple(replace(g, dock_s=g.dock_s + longest_s) for g in problem.ugvs))


def plan_with_margin(problem: Problem, margin: float, stop: Stop, seed: int, params: Params) -> Plan:
    """A plan that keeps the margin if there is one; else, rather than leave out a task or a vehicle, one without.

    Args:
        problem: with the true reserves.
        margin: share of capacity.
        stop: budget of ``planner.solve``; used twice where no plan keeps the margin.
        seed: of ``planner.solve``.
        params: of ``planner.solve``.

    Returns:
        A plan whose schedule is that of ``problem``.

    Raises:
        PlannerError: as ``planner.solve``.
    """
    uavs, ugvs = params.options.get("exclude_uavs", ()), params.options.get("exclude_ugvs", ())
    plan = solve(with_margin(problem, margin) if margin > 0 else problem, stop, seed, params).plan
    took_s = plan.planning_s or 0.0
    if margin > 0 and not plan.feasible:
        bare = solve(problem, stop, seed, params).plan
        took_s += bare.planning_s or 0.0
        plan = bare if worth(problem, bare, params) > worth(problem, plan, params) else plan
    schedule = evaluate(problem, plan.actions, exclude_uavs=uavs, exclude_ugvs=ugvs)
    return replace(plan, schedule=schedule, planning_s=took_s)


def worth(problem: Problem, plan: Plan, params: Params) -> tuple[bool, int]:
    """What a plan is worth when none visits every task: nobody stranded first, then the number of tasks visited."""
    uavs, ugvs = params.options.get("exclude_uavs", ()), params.options.get("exclude_ugvs", ())
    survives = predict(problem, plan.actions, exclude_uavs=uavs, exclude_ugvs=ugvs).survives
    return survives, sum(isinstance(a, Visit) for a in plan.actions)
