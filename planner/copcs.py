"""Method ``copcs``: a plan by the learned policy, polished by search for the time that is left.

Where the policy has no say (its weights cannot be read, the problem is unlike what it was trained on) or is unsure of
its plan, search takes over, and ``Plan.note`` says why.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf
from pathlib import Path
from typing import Any

from planner.errors import PlannerError
from planner.plan import Action, Plan, Visit
from planner.policy.decode import Decoded
from planner.policy.networks import network
from planner.policy.paper_decode import PaperPolicy
from planner.policy.shipped import shipped
from planner.presets import PRESETS, preset
from planner.problem import Problem
from planner.schedule import evaluate
from planner.search import Options as SearchOptions
from planner.search import search
from planner.solve import Params, Result, Stop

DECODERS = ("greedy", "sample", "beam")
UNSURE = 0.25  # the geometric mean of the decisions' probabilities below which search takes over
SHARE = 0.2  # of the time, at most, for sampling and for the beam where search follows
SAMPLES = 64
BEAM = (2, 3)  # plans kept, options of each
WARM = 1.0  # of search's first temperature, from the policy's plan: unlike one being flown, it may be left behind
LEAST_S = 1e-3  # what search is given when time is up


@dataclass(frozen=True, slots=True)
class Options:
    """Options of method ``copcs`` beside those of ``search``, which it hands on.

    Attributes:
        decode: ``greedy``, ``sample`` (the best of some plans) or ``beam`` (the schedule judges half-made plans).
        polish: whether search goes on from the policy's plan. Without, the plan is the policy's whatever it is worth.
        look_ahead: whether plain ways to finish behind the network's options count as plans; False leaves all to it.
        weights: a weights file instead of the one shipped; "" is that one. The paper's networks plan ``greedy`` only,
            and do not look ahead.
    """

    decode: str = "greedy"
    polish: bool = True
    look_ahead: bool = True
    weights: str = ""

    def __post_init__(self) -> None:
        if self.decode not in DECODERS:
            raise PlannerError(f"option decode is {self.decode!r}; choose one of {', '.join(DECODERS)}")
        for name in ("polish", "look_ahead"):
            if not isinstance(getattr(self, name), bool):
                raise PlannerError(f"option {name} is {getattr(self, name)!r}; give true or false")
        if not isinstance(self.weights, str):
            raise PlannerError(f"option weights is {self.weights!r}; give a file")


def split(options: Mapping[str, Any]) -> tuple[Options, dict[str, Any], SearchOptions]:
    """The options of this method, and the others, which are those of ``search``, plain and read.

    Raises:
        PlannerError: for an unknown option or a wrong value.
    """
    mine = {k: v for k, v in options.items() if k in Options.__slots__}
    others = {k: v for k, v in options.items() if k not in mine}
    try:
        off = SearchOptions.read(others)
    except PlannerError as error:
        raise PlannerError(str(error).replace("method 'search'", "method 'copcs'")) from error
    return Options(**mine), others, off


def sample(options: Mapping[str, Any]) -> Problem:
    """A problem that the network can plan for, to try it on: of the paper's setups.

    Raises:
        PlannerError: for an unknown option or a wrong value, and where the weights cannot be read.
    """
    weights = split(options)[0].weights
    policy = network(Path(weights)) if weights else shipped()
    if isinstance(policy, PaperPolicy):
        c = policy.config
        for name, sizes in PRESETS.items():
            if sizes == (c.n_tasks, c.n_points):
                return preset(name, (c.n_uavs, c.n_ugvs))
    return preset("T15-P5")


def copcs(problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
    """Plans by the policy, then by search from its plan; see ``planner.solve.solve``.

    Raises:
        PlannerError: for an unknown option, one that the network does not have, or a start that names something that
            does not exist. Weights that cannot be read are an error only without ``polish``: else search takes over.
    """
    begun = time.perf_counter()
    options, others, off = split(params.options)
    excluded = {"exclude_uavs": off.exclude_uavs, "exclude_ugvs": off.exclude_ugvs}
    found, why_not = _policy_plan(problem, stop, seed, options, excluded)
    if not options.polish:
        if found is None:
            raise PlannerError(f"method 'copcs' without polish has nothing to plan with: {why_not}")
        actions = found.actions(problem)
        return Result(Plan(actions, evaluate(problem, actions, **excluded), "copcs", note=why_not), 0, 0.0)
    start = params.start
    if found is not None and why_not is None:
        mine = found.actions(problem)
        start = _better(problem, mine, start, excluded)
        if start is mine:
            others = {"warm": WARM, **others}
    rest = stop
    if stop.time_s is not None:
        rest = replace(stop, time_s=max(LEAST_S, stop.time_s - (time.perf_counter() - begun)))
    result = search(problem, rest, seed, Params("search", start, others))
    note = None if why_not is None else f"search took over: {why_not}"
    return replace(result, plan=replace(result.plan, note=note))


def _policy_plan(
    problem: Problem, stop: Stop, seed: int, options: Options, excluded: Mapping[str, Any]
) -> tuple[Decoded | None, str | None]:
    """The policy's plan, and why search should take over, if it should."""
    try:
        policy = network(Path(options.weights)) if options.weights else shipped()
    except PlannerError as error:
        return None, str(error)
    if isinstance(policy, PaperPolicy):
        if options.decode != "greedy":
            raise PlannerError(f"option decode is {options.decode!r}; the paper's network plans greedy only")
        outside = policy.outside(problem)
        if outside is not None:
            return None, f"the network was trained on other problems ({outside})"
        return _judged(policy.greedy(problem, **excluded))
    if not options.look_ahead:
        policy = policy.alone()
    outside = policy.outside(problem, **excluded)
    why_not = None if outside is None else f"the network was trained on other problems ({outside})"
    if why_not is not None and options.polish:
        return None, why_not
    share_s = inf if stop.time_s is None else stop.time_s * (SHARE if options.polish else 1.0)
    if options.decode == "beam":
        found = policy.beam(problem, *BEAM, time_s=share_s, **excluded)
    elif options.decode == "sample":
        found = policy.sample(problem, SAMPLES, seed=seed, time_s=share_s, **excluded)
    else:
        found = policy.greedy(problem, **excluded)
    return _judged(found, why_not)


def _judged(found: Decoded, why_not: str | None = None) -> tuple[Decoded, str | None]:
    """A plan, and why search should take over, if it should."""
    if not found.complete:
        why_not = "the network's plan leaves tasks out"
    elif not found.sure >= UNSURE:
        why_not = f"the network is unsure of its plan ({found.sure:.0%} a decision, least {UNSURE:.0%})"
    return found, why_not


def _better(
    problem: Problem, mine: Sequence[Action], start: Sequence[Action] | None, excluded: Mapping[str, Any]
) -> Sequence[Action]:
    """The policy's plan or the one given, whichever visits more tasks or else ends sooner."""
    if start is None:
        return mine

    def worth(actions: Sequence[Action]) -> tuple[bool, int, float]:
        schedule = evaluate(problem, actions, **excluded)
        return schedule.feasible, sum(isinstance(a, Visit) for a in actions), -schedule.makespan_s

    return mine if worth(mine) > worth(start) else start
