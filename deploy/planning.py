"""Who answers the supervisor's replan requests: in the loop for the virtual clock, in a worker process in real time."""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

from deploy.margin import as_flown, landed_waiting, with_margin
from deploy.observation import PlanReply, PlanRequest
from planner.errors import PlannerError
from planner.plan import Plan, Visit
from planner.problem import Problem
from planner.schedule import evaluate, predict
from planner.solve import Params, Stop, solve, warm_up

LOADING = "loading the planner (compiled once after an installation or update, up to a minute)"
WORTH_THE_MARGIN = 0.95


@dataclass(frozen=True, slots=True)
class ReplanSettings:
    """How to replan.

    Attributes:
        method: of ``planner.solve``.
        time_s: wall-clock budget; on the virtual clock the reply takes that long, arena s.
        iterations: budget on the virtual clock, where results must not depend on the machine's speed.
        seed: of the search.
        options: of the method.
    """

    method: str = "search"
    time_s: float = 1.0
    iterations: int = 200_000
    seed: int = 0
    options: Mapping[str, Any] = field(default_factory=dict)


class Planner(Protocol):
    """Takes one request at a time."""

    def submit(self, request: PlanRequest, now_s: float) -> None:
        """Begins to plan; a newer request replaces an older one."""
        ...

    def poll(self, now_s: float) -> PlanReply | None:
        """The reply, once, when it is there."""
        ...

    def due_s(self) -> float | None:
        """When a virtual clock should look again; None where nobody knows."""
        ...

    def close(self) -> None:
        """Ends the worker."""
        ...


def plan_with_margin(problem: Problem, margin: float, stop: Stop, seed: int, params: Params) -> Plan:
    """A plan that keeps the margin if there is one; else, rather than leave out a task or a vehicle, one without.

    Args:
        problem: with the true reserves.
        margin: share of capacity.
        stop: budget of ``planner.solve``; used up to three times where no plan keeps the margin.
        seed: of ``planner.solve``.
        params: of ``planner.solve``.

    Returns:
        A plan whose schedule is that of ``problem``.

    Raises:
        PlannerError: as ``planner.solve``.
    """
    uavs, ugvs = params.options.get("exclude_uavs", ()), params.options.get("exclude_ugvs", ())
    plan = first = solve(with_margin(problem, margin), stop, seed, params).plan
    took_s = plan.planning_s or 0.0
    tighter = as_flown(problem), as_flown(problem, docking=False)
    for less in tighter if margin > 0 else tighter[1:]:
        if plan.feasible:
            break
        bare = solve(less, stop, seed, params).plan
        took_s += bare.planning_s or 0.0
        plan = bare if worth(problem, bare, params) > worth(problem, plan, params) else plan
    schedule = evaluate(problem, plan.actions, exclude_uavs=uavs, exclude_ugvs=ugvs)
    # What was proven of a problem with other reserves does not hold for this one.
    bound_s = plan.lower_bound_s if margin == 0 and plan is first else None
    return replace(plan, schedule=schedule, planning_s=took_s, lower_bound_s=bound_s)


def worth(problem: Problem, plan: Plan, params: Params) -> tuple[bool, int]:
    """What a plan is worth when none visits every task: nobody stranded first, then the number of tasks visited."""
    uavs, ugvs = params.options.get("exclude_uavs", ()), params.options.get("exclude_ugvs", ())
    survives = predict(problem, plan.actions, exclude_uavs=uavs, exclude_ugvs=ugvs).survives
    return survives, sum(isinstance(a, Visit) for a in plan.actions)


def answer(request: PlanRequest, settings: ReplanSettings, stop: Stop) -> PlanReply:
    """Plans, tasks that nobody can reach left out; never raises for a problem without a plan."""
    begun_s = time.perf_counter()
    try:
        options = {
            **settings.options,
            "allow_partial": True,
            "exclude_uavs": request.exclude_uavs,
            "exclude_ugvs": request.exclude_ugvs,
        }
        params = Params(settings.method, request.start, options)
        seed = settings.seed + request.number
        problem, landed = request.problem, False
        plan = plan_with_margin(problem, request.margin, stop, seed, params)
        if plan.feasible and request.margin > 0:
            tight = plan_with_margin(problem, 0.0, stop, seed, params)
            if tight.feasible and tight.makespan_s < WORTH_THE_MARGIN * plan.makespan_s:
                plan = tight  # in flight a margin is not worth any length of mission
        if not plan.feasible and request.landing_s:
            on_ground = landed_waiting(problem, request.landing_s)
            other = plan_with_margin(on_ground, request.margin, stop, seed, params)
            if worth(on_ground, other, params) > worth(problem, plan, params):
                plan, problem, landed = other, on_ground, True
        usable = worth(problem, plan, params)[0]
    except PlannerError as error:
        took_s = time.perf_counter() - begun_s
        return PlanReply(request.number, False, (), settings.method, took_s, str(error), usable=False)
    took_s = time.perf_counter() - begun_s
    return PlanReply(
        request.number, plan.feasible, plan.actions, plan.method, took_s, plan.schedule.violation, usable, landed,
        plan.note,
    )  # fmt: skip


class InlinePlanner:
    """Plans at once by an iteration budget and answers after the time that planning takes on the virtual clock."""

    def __init__(self, settings: ReplanSettings, extra_delay_s: Callable[[], float] = lambda: 0.0) -> None:
        self._settings = settings
        self._extra_delay_s = extra_delay_s
        self._reply: PlanReply | None = None
        self._due_s: float | None = None

    def submit(self, request: PlanRequest, now_s: float) -> None:
        """Plans; see ``Planner``."""
        self._reply = answer(request, self._settings, Stop(iterations=self._settings.iterations))
        self._due_s = now_s + self._settings.time_s + self._extra_delay_s()

    def poll(self, now_s: float) -> PlanReply | None:
        """See ``Planner``."""
        if self._due_s is None or now_s < self._due_s:
            return None
        reply, self._reply, self._due_s = self._reply, None, None
        return reply

    def due_s(self) -> float | None:
        """See ``Planner``."""
        return self._due_s

    def close(self) -> None:
        """Nothing to end."""


class ProcessPlanner:
    """Plans in one worker process by a time budget, so that the loop never waits."""

    def __init__(self, settings: ReplanSettings, extra_delay_s: Callable[[], float] = lambda: 0.0) -> None:
        self._settings, self._extra_delay_s = settings, extra_delay_s
        self._not_before_s = 0.0
        self._pool = _pool()
        self._future: Future[PlanReply] | None = None
        self._number = 0
        self._warm = self._pool.submit(warm_up, settings.method, dict(settings.options))

    def wait_warm(self, timeout_s: float) -> None:
        """Waits until the worker has started and compiled, at most ``timeout_s``; what fails shows in its replies."""
        wait([self._warm], timeout_s)

    def submit(self, request: PlanRequest, now_s: float) -> None:
        """Begins to plan; see ``Planner``."""
        if self._future is not None:
            self._future.cancel()
        self._number = request.number
        self._not_before_s = now_s + self._extra_delay_s()
        try:
            self._future = self._pool.submit(answer, request, self._settings, Stop(time_s=self._settings.time_s))
        except BrokenExecutor:
            self._restart()
            self._future = self._pool.submit(answer, request, self._settings, Stop(time_s=self._settings.time_s))

    def poll(self, now_s: float) -> PlanReply | None:
        """See ``Planner``; a worker that died is an answer too."""
        if self._future is None or not self._future.done() or now_s < self._not_before_s:
            return None
        future, self._future = self._future, None
        try:
            return future.result()
        except Exception as error:  # whatever goes wrong in the worker must not end the flight
            self._restart()
            why = f"the planner failed: {type(error).__name__} {error}"
            return PlanReply(self._number, False, (), self._settings.method, 0.0, why, usable=False)

    def due_s(self) -> float | None:
        """See ``Planner``."""
        return None

    def close(self) -> None:
        """Ends the worker, in the middle of planning too."""
        for process in list((getattr(self._pool, "_processes", None) or {}).values()):
            process.terminate()
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _restart(self) -> None:
        self._pool.shutdown(wait=False)
        self._pool = _pool()


def _pool() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=_end_with_parent)


def _end_with_parent() -> None:
    """In the worker: ends it when this program is killed; by itself it would wait for work for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None  # it is a worker

    def watch() -> None:
        parent.join()
        os._exit(0)

    threading.Thread(target=watch, name="end with parent", daemon=True).start()
