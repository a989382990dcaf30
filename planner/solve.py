"""The one entrance to every planning method: ``solve(problem, stop, seed, params) -> Result``."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

from planner.errors import PlannerError
from planner.plan import Action, Plan
from planner.problem import Problem


@dataclass(frozen=True, slots=True)
class Stop:
    """When to stop improving: wall-clock time in s, iterations, or whichever is first; at least one is given."""

    time_s: float | None = None
    iterations: int | None = None

    def __post_init__(self) -> None:
        if self.time_s is None and self.iterations is None:
            raise PlannerError("stop: give time_s, iterations or both")
        if self.time_s is not None and not self.time_s > 0:
            raise PlannerError(f"stop: time_s is {self.time_s}; give a number above 0")
        if self.iterations is not None and self.iterations < 0:
            raise PlannerError(f"stop: iterations is {self.iterations}; give a number of at least 0")


@dataclass(frozen=True, slots=True)
class Params:
    """Which method, and what it takes; unknown options are errors of the method.

    Attributes:
        method: name of the method.
        start: actions to start from (a warm start); used where feasible, repaired where not.
        options: the method's own.
    """

    method: str = "search"
    start: Sequence[Action] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Result:
    """The best plan found (feasible wherever one was found) and what it took."""

    plan: Plan
    iterations: int
    time_s: float


def solve(problem: Problem, stop: Stop, seed: int = 0, params: Params = Params()) -> Result:
    """Plans. The same seed and iteration budget give the same plan on the same machine.

    Raises:
        PlannerError: for an unknown method or a wrong option; never for a problem that has no feasible plan, which
            comes back as an infeasible plan with its violation in words.
    """
    method, _ = _method(params.method)
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 1 << 64:
        raise PlannerError(f"seed is {seed!r}; give a whole number from 0 to 2^64 - 1")
    begun = time.perf_counter()
    result = method(problem, stop, seed, params)
    took = time.perf_counter() - begun
    return replace(result, plan=replace(result.plan, method=params.method, planning_s=took), time_s=took)


def check_options(method: str, options: Mapping[str, Any]) -> None:
    """Says what is wrong with a method's options before anybody plans.

    Raises:
        PlannerError: for an unknown method or option, or a wrong value.
    """
    _method(method)[1](options)


def warm_up(method: str, options: Mapping[str, Any] | None = None) -> None:
    """Loads and compiles what a method needs, so that its next plan takes as long as all others.

    Never raises: what is wrong with the method or an option, planning itself says.

    Args:
        method: its name.
        options: those that it will be called with.
    """
    from planner.presets import preset  # noqa: PLC0415  (only here)

    given = {k: v for k, v in (options or {}).items() if k != "solve_s"}
    problem, stop, tries = preset("T15-P5"), Stop(0.05, 100), [given]
    with suppress(PlannerError):
        if method == "copcs":
            from planner.copcs import sample  # noqa: PLC0415  (only here)

            problem = sample(given)
            tries.append({**given, "polish": False})  # what its domain may not let on
    if method in ("copcs", "search", "milp"):  # by steps, since compiling alone would use up any time
        solve(problem, Stop(iterations=100), 0, Params("search"))
    for one in tries:
        with suppress(PlannerError):
            solve(problem, stop, 0, Params(method, options=one))


class Method(Protocol):
    """A planning method; ``solve`` fills in its name and the time that it took."""

    def __call__(self, problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
        """Plans; see ``solve``."""
        ...


METHODS = ("copcs", "search", "milp", "gls", "ts", "sa")
DEFAULT_METHOD = "copcs"  # where nobody chose one


def _method(name: str) -> tuple[Method, Callable[[Mapping[str, Any]], object]]:
    """The method and what reads its options, which raises where they are wrong."""
    # Methods are imported when first asked for: some will be slow to import.
    if name == "copcs":
        from planner import copcs  # noqa: PLC0415

        return copcs.copcs, copcs.split
    if name == "search":
        from planner import search  # noqa: PLC0415

        return search.search, search.Options.read
    if name == "milp":
        from planner import milp  # noqa: PLC0415

        return milp.milp, milp.Options.read
    if name in ("gls", "ts", "sa"):
        from planner import baselines  # noqa: PLC0415

        return baselines.baseline(name), partial(baselines.read_options, name)
    raise PlannerError(f"method {name!r} does not exist; there are {', '.join(METHODS)}")
