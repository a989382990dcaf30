"""The pre-flight checks: everything that can be known before anybody moves. A run refuses to arm when one fails.

Each check, its limit and its remedy: ``docs/checks.md``.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from deploy.check_backend import BackendProbe, backend_rows, probe_backend
from deploy.check_chance import chance_rows, planner_row
from deploy.check_energy import energy_rows, plan_rows
from deploy.check_limits import CheckLimits, Uncertainty
from deploy.check_mission import mission_rows
from deploy.check_report import CheckReport, CheckRow, Verdict
from deploy.check_space import space_rows
from deploy.check_vehicles import vehicle_rows
from deploy.settings import Settings
from planner.plan import Plan
from planner.solve import Params, Stop, solve

if TYPE_CHECKING:
    from deploy.mission import Mission

__all__ = [
    "BackendProbe",
    "CheckLimits",
    "CheckReport",
    "CheckRow",
    "Uncertainty",
    "Verdict",
    "check_plan",
    "probe_backend",
    "run_checks",
]


def run_checks(
    mission: Mission, plan: Plan, *, now_s: float, probe: BackendProbe | None = None, replan: bool = True
) -> CheckReport:
    """Runs every check of a mission and its plan.

    Args:
        mission: as loaded.
        plan: its plan, scheduled for the mission's problem.
        now_s: on the wall clock by which the result will expire.
        probe: what the backend showed; without it the backend's checks are not run.
        replan: whether to try how long a replan takes (costs the replan's budget).
    """
    return check_plan(
        mission.settings,
        plan,
        mission.checks,
        now_s=now_s,
        probe=probe,
        seed=mission.seed,
        plan_again=_replan_of(mission, plan) if replan else None,
    )


def check_plan(
    settings: Settings,
    plan: Plan,
    limits: CheckLimits,
    *,
    now_s: float,
    probe: BackendProbe | None = None,
    seed: int = 0,
    plan_again: Callable[[], bool] | None = None,
) -> CheckReport:
    """As ``run_checks``, from the parts that it needs.

    Args:
        settings: of the mission.
        plan: scheduled for ``settings.problem``.
        limits: what to judge by.
        now_s: on the wall clock by which the result will expire.
        probe: what the backend showed, if it was looked at.
        seed: of the Monte Carlo.
        plan_again: plans once as in flight and tells whether the result is feasible, if that is wanted.
    """
    rows = [
        *mission_rows(settings),
        *plan_rows(settings.problem, plan, limits),
        planner_row(plan_again, settings.monitors.planner_late_s),
        *energy_rows(settings.problem, plan, limits),
        *space_rows(settings, plan),
        *chance_rows(settings, plan, limits, seed),
        *backend_rows(settings, limits, probe),
        *vehicle_rows(probe.findings if probe is not None else {}),
    ]
    return CheckReport(tuple(rows), settings.problem.digest, plan.digest, now_s, limits.validity_s)


def _replan_of(mission: Mission, plan: Plan) -> Callable[[], bool]:
    planner = mission.planner

    def plan_again() -> bool:
        stop = Stop(time_s=planner.replan.time_s, iterations=planner.replan.iterations)
        params = Params(method=planner.method, start=plan.actions, options=planner.options)
        return solve(mission.problem, stop, planner.seed or 0, params).plan.feasible

    return plan_again
