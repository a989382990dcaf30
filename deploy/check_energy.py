"""Checks of the plan: feasible, in time, and with energy to spare at every rendezvous and landing."""

from __future__ import annotations

import math

from deploy.check_limits import CheckLimits
from deploy.check_report import CheckRow, Verdict, at_least, not_run
from deploy.montecarlo import ordinal
from planner.plan import Move, Plan, Recharge, ScheduledAction
from planner.problem import Problem

ENERGY, PLAN = "energy", "plan"


def plan_rows(problem: Problem, plan: Plan, limits: CheckLimits) -> list[CheckRow]:
    """Feasibility and makespan."""
    schedule = plan.schedule
    count = int((~problem.visited).sum())
    if not schedule.feasible:
        text = f"the plan cannot be flown: {schedule.violation}; plan for longer, or change the mission"
        feasible = CheckRow("feasible", PLAN, Verdict.FAIL, None, "tasks", float(count), text)
    else:
        recharges = sum(isinstance(a, Recharge) for a in plan.actions)
        text = f"the plan visits all {count} tasks with {recharges} recharge{'' if recharges == 1 else 's'}"
        feasible = CheckRow("feasible", PLAN, Verdict.PASS, float(count), "tasks", float(count), text)
    return [feasible, _makespan(plan, limits)]


def _makespan(plan: Plan, limits: CheckLimits) -> CheckRow:
    span, limit = plan.makespan_s, limits.makespan_limit_s
    text = f"the last visit ends after {span:.0f} s of mission time"
    if not math.isfinite(span):
        return not_run("makespan", PLAN, "there is no makespan without a feasible plan", "s")
    if limit is None:
        return CheckRow("makespan", PLAN, Verdict.PASS, span, "s", None, text)
    if span > limit:
        text += f", {span - limit:.0f} s too late; plan for longer, add vehicles or raise checks.makespan_limit_s"
    return CheckRow("makespan", PLAN, Verdict.FAIL if span > limit else Verdict.PASS, span, "s", limit, text)


def energy_rows(problem: Problem, plan: Plan, limits: CheckLimits) -> list[CheckRow]:
    """Energies of the schedule; not run where the plan is infeasible, for then they mean nothing."""
    names = ("rendezvous energy", "landing energy", "ugv energy", "waiting slack")
    if not plan.feasible:
        return [not_run(name, ENERGY, "the plan is infeasible") for name in names]
    return [
        _rendezvous(problem, plan, limits),
        _landing(problem, plan, limits),
        _ugvs(problem, plan, limits),
        _slack(problem, plan, limits),
    ]


def _recharges(problem: Problem, plan: Plan) -> list[tuple[ScheduledAction, Recharge, str]]:
    rows = {row.action: row for row in plan.schedule.actions}
    count = [0] * len(problem.uavs)
    found = []
    for i, act in enumerate(plan.actions):
        if isinstance(act, Recharge):
            count[act.uav] += 1
            where = (
                f"{problem.uavs[act.uav].id} at its {ordinal(count[act.uav])} rendezvous ({problem.ugvs[act.ugv].id})"
            )
            found.append((rows[i], act, where))
    return found


def _judged(name: str, share: float, limits: CheckLimits, text: str, remedy: str) -> CheckRow:
    return at_least(
        name,
        ENERGY,
        share,
        "of capacity",
        # A plan that uses a limit to the last joule keeps it: the margin is for rounding.
        warn=limits.energy_margin_warn - 1e-9,
        fail=limits.energy_margin_fail - 1e-9,
        text=text,
        remedy=remedy,
    )


def _rendezvous(problem: Problem, plan: Plan, limits: CheckLimits) -> CheckRow:
    """Least energy at docking above reserve, as a share of capacity."""
    found = []
    for row, act, where in _recharges(problem, plan):
        uav = problem.uavs[act.uav]
        found.append(((row.energy_arrive_j - uav.reserve_j) / uav.capacity_j, where))
    if not found:
        text = "the plan has no rendezvous"
        return CheckRow("rendezvous energy", ENERGY, Verdict.PASS, None, "of capacity", None, text)
    share, where = min(found)
    text = f"{where} has {100 * share:.1f} % of its capacity above reserve"
    remedy = "raise replanning.margin, plan for longer, or path points nearer to the tasks"
    return _judged("rendezvous energy", share, limits, text, remedy)


def _landing(problem: Problem, plan: Plan, limits: CheckLimits) -> CheckRow:
    """Least energy at the landing after the last action, above reserve, as a share of capacity."""
    found = []
    for r in plan.schedule.recovery:
        uav = problem.uavs[r.uav]
        site = "the depot" if r.site is None else f"path point {r.site}"
        found.append(((r.energy_end_j - uav.reserve_j) / uav.capacity_j, f"{uav.id} lands at {site}"))
    if not found:
        text = "no UAV has to land"
        return CheckRow("landing energy", ENERGY, Verdict.PASS, None, "of capacity", None, text)
    share, where = min(found)
    text = f"{where} after its last action with {100 * share:.1f} % of its capacity above reserve"
    remedy = "raise replanning.margin, plan for longer, or path points nearer to the last tasks"
    return _judged("landing energy", share, limits, text, remedy)


def _ugvs(problem: Problem, plan: Plan, limits: CheckLimits) -> CheckRow:
    """Least energy of a UGV when the plan's last action ends, as a share of its capacity."""
    if not problem.ugvs:
        return CheckRow("ugv energy", ENERGY, Verdict.PASS, None, "of capacity", None, "there are no UGVs")
    end_s = max((row.end_s for row in plan.schedule.actions), default=0.0)
    left = [g.energy_j for g in problem.ugvs]
    driven = [0.0] * len(left)
    for row in plan.schedule.actions:
        act = plan.actions[row.action]
        if isinstance(act, Recharge):
            left[act.ugv] -= row.energy_end_j - row.energy_arrive_j
        elif isinstance(act, Move):
            driven[act.ugv] += row.end_s - row.start_s
    shares = []
    for g, ugv in enumerate(problem.ugvs):
        stand_s = max(0.0, end_s - ugv.ready_s - driven[g])
        rest = left[g] - ugv.drive_w * driven[g] - ugv.idle_w * stand_s
        shares.append((rest / ugv.capacity_j, ugv.id))
    share, who = min(shares)
    text = f"{who} ends with {100 * share:.1f} % of its capacity"
    remedy = "charge it, add a UGV, or let it drive less (fewer or nearer path points)"
    return _judged("ugv energy", share, limits, text, remedy)


def _slack(problem: Problem, plan: Plan, limits: CheckLimits) -> CheckRow:
    """Longest wait that every rendezvous bears: how long a UAV can hover there before it falls below reserve."""
    found = []
    for row, act, where in _recharges(problem, plan):
        uav = problem.uavs[act.uav]
        if uav.waiting == "hover" and uav.hover_w > 0:
            found.append(((row.energy_arrive_j - uav.reserve_j) / uav.hover_w, where))
    tight = sum(row.total_slack_s < 1.0 for row in plan.schedule.actions)
    critical = f"{tight} of {len(plan.actions)} actions are critical: late there is late in the end"
    if not found:
        text = f"no UAV hovers while it waits; {critical}"
        return CheckRow("waiting slack", ENERGY, Verdict.PASS, None, "s", limits.slack_warn_s, text)
    slack, where = min(found)
    return at_least(
        "waiting slack",
        ENERGY,
        slack,
        "s",
        warn=limits.slack_warn_s,
        fail=None,
        text=f"{where} may be kept waiting {slack:.0f} s longer; {critical}",
        remedy="a late UGV soon costs a replan: raise replanning.margin, or set waiting: landed where UAVs can land",
    )
