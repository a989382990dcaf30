"""How a mission wants to be planned, in the planner's words."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from deploy.mission import Mission, load
from deploy.planning import ReplanSettings
from planner.solve import Params, Stop


def first_plan(mission: Mission) -> tuple[Stop, int, Params]:
    """Budget, seed and method of the plan before the flight."""
    p = mission.planner
    return Stop(p.time_s, p.iterations), _seed(mission), Params(p.method, options=dict(p.options))


def replanning(mission: Mission) -> ReplanSettings:
    """Budget, seed and method of replans in flight; the warm start comes with each request."""
    p, defaults = mission.planner, ReplanSettings()
    return ReplanSettings(
        method=p.method,
        time_s=p.replan.time_s or defaults.time_s,
        iterations=p.replan.iterations or defaults.iterations,
        seed=_seed(mission),
        options=dict(p.options),
    )


def load_with(path: Path, planner: str | None = None, seed: int | None = None) -> Mission:
    """A mission with another method or seed than its file says.

    Raises:
        InputError: the first mistake in the mission.
    """
    overrides: dict[str, Any] = {}
    if planner is not None:
        overrides["planner.method"] = planner
    if seed is not None:
        overrides |= {"seed": seed, "planner.seed": seed}
    return load(path, overrides)


def _seed(mission: Mission) -> int:
    return mission.seed if mission.planner.seed is None else mission.planner.seed
