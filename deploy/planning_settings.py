"""How a mission wants to be planned, in the planner's words."""

from __future__ import annotations

from deploy.mission import Mission
from planner.solve import Params, Stop


def first_plan(mission: Mission) -> tuple[Stop, int, Params]:
    """Budget, seed and method of the plan before the flight."""
    p = mission.planner
    return Stop(p.time_s, p.iterations), _seed(mission), Params(p.method, options=dict(p.options))


def replan(mission: Mission) -> tuple[Stop, int, Params]:
    """Budget, seed and method of replans in flight; the warm start comes with each request."""
    p = mission.planner
    return Stop(p.replan.time_s, p.replan.iterations), _seed(mission), Params(p.method, options=dict(p.options))


def _seed(mission: Mission) -> int:
    return mission.seed if mission.planner.seed is None else mission.planner.seed
