"""Checks of chance: how likely the plan is to hold, and whether a replan will come in time."""

from __future__ import annotations

import time
from collections.abc import Callable

from deploy.check_limits import CheckLimits
from deploy.check_report import CheckRow, Verdict, at_least, not_run
from deploy.montecarlo import Estimate, MonteCarloError, Overheads, Share, estimate
from deploy.settings import Settings
from planner.plan import Plan

CHANCE, PLAN = "chance", "plan"


def overheads_of(settings: Settings) -> Overheads:
    """What flying adds to the schedule, by the vehicles' speeds and accelerations; in mission s."""
    scale = settings.frame.time_scale
    deck_m = min((g.pad_height_m for g in settings.ugvs), default=0.0)
    return Overheads(
        # What service_s already holds for stopping at a task, dispatch does not hover as well.
        leg_s=tuple(
            max(0.0, u.speed_mps / u.accel_mps2 / scale - p.service_s)
            for u, p in zip(settings.uavs, settings.problem.uavs, strict=True)
        ),
        down_s=tuple((u.altitude_m - deck_m) / u.descent_mps / scale for u in settings.uavs),
        up_s=tuple((u.altitude_m - deck_m) / u.climb_mps / scale for u in settings.uavs),
        drive_s=tuple(g.speed_mps / g.accel_mps2 / scale for g in settings.ugvs),
    )


def chance_rows(settings: Settings, plan: Plan, limits: CheckLimits, seed: int) -> list[CheckRow]:
    """The Monte Carlo's rows; not run where the plan is infeasible."""
    names = ("success probability", "reserve probability", "late finish")
    if not plan.feasible:
        return [not_run(name, CHANCE, "the plan is infeasible") for name in names]
    try:
        found = estimate(
            settings.problem,
            plan.actions,
            limits.uncertainty,
            samples=limits.samples,
            seed=seed,
            makespan_limit_s=limits.makespan_limit_s,
            overheads=overheads_of(settings),
        )
    except MonteCarloError as error:
        return [not_run(name, CHANCE, str(error)) for name in names]
    return [_success(found, limits), _reserve(found, limits), _late(found, plan, limits)]


def _percent(share: Share) -> str:
    low, high = share.interval
    return f"{100 * share.estimate:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"


def _success(found: Estimate, limits: CheckLimits) -> CheckRow:
    text = f"in {_percent(found.success)} of {found.success.samples} samples the plan ends in time, no battery empty"
    if found.causes:
        text += f"; most often it fails by {found.causes[0][0]} ({100 * found.causes[0][1]:.3g} %)"
    return at_least(
        "success probability",
        CHANCE,
        found.success.estimate,
        "",
        warn=limits.success_probability_warn,
        fail=limits.success_probability_fail,
        text=text,
        remedy="that is without replans: raise replanning.margin, or set checks.uncertainty to what you measured",
    )


def _reserve(found: Estimate, limits: CheckLimits) -> CheckRow:
    text = f"in {_percent(found.success_reserve)} no UAV falls below its reserve"
    if found.causes_reserve:
        text += f"; first does {found.causes_reserve[0][0]} ({100 * found.causes_reserve[0][1]:.3g} %)"
    return at_least(
        "reserve probability",
        CHANCE,
        found.success_reserve.estimate,
        "",
        warn=limits.reserve_probability_warn,
        fail=None,
        text=text,
        remedy="expect a replan there: raise replanning.margin",
    )


def _late(found: Estimate, plan: Plan, limits: CheckLimits) -> CheckRow:
    s, limit = found.makespan_s, limits.makespan_limit_s
    text = (
        f"the last visit ends after {s.p5:.0f} to {s.p95:.0f} s in 90 % of samples, "
        f"in the middle {s.p50:.0f} s ({plan.makespan_s:.0f} s planned)"
    )
    if limit is not None and s.p95 > limit:
        text += "; one run in twenty is later than checks.makespan_limit_s: raise it or plan for longer"
        return CheckRow("late finish", CHANCE, Verdict.WARN, s.p95, "s", limit, text)
    return CheckRow("late finish", CHANCE, Verdict.PASS, s.p95, "s", limit, text)


def planner_row(
    plan_again: Callable[[], bool] | None, late_s: float, clock: Callable[[], float] = time.perf_counter
) -> CheckRow:
    """Whether a replan with the budget of flight comes in time.

    Args:
        plan_again: plans once as in flight and tells whether the result is feasible; None where it is not wanted.
        late_s: a replan that takes longer is late.
        clock: to measure it with.
    """
    name = "planner"
    if plan_again is None:
        return not_run(name, PLAN, "no planner was given", "s")
    begun = clock()
    feasible = plan_again()
    took = clock() - begun
    text = f"a replan took {took:.2f} s, {late_s:g} s are allowed"
    if took > late_s:
        text += "; lower planner.replan.time_s, close other programs or raise monitors.planner_late_s"
        return CheckRow(name, PLAN, Verdict.FAIL, took, "s", late_s, text)
    if not feasible:
        text += ", and found no feasible plan; raise planner.replan.time_s"
        return CheckRow(name, PLAN, Verdict.WARN, took, "s", late_s, text)
    if took > 0.5 * late_s:
        text += "; that leaves little room on a busy machine: lower planner.replan.time_s"
        return CheckRow(name, PLAN, Verdict.WARN, took, "s", late_s, text)
    return CheckRow(name, PLAN, Verdict.PASS, took, "s", late_s, text)
