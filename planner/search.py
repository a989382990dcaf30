"""Method ``search``: a sound first plan, then simulated annealing over the joint action list, compiled.

Searching over the list that the evaluator decodes needs no bookkeeping of how routes depend on one another (Kira 2017).
"""

from __future__ import annotations

import time
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields, replace
from math import inf
from typing import Any

import numpy as np

from planner import kernel, ruin_kernel, search_kernel
from planner.arrays import arrays_of, decode, encode, encode_meets
from planner.construct import construct
from planner.errors import PlannerError
from planner.kernel import Codes, Work, World
from planner.moves_kernel import Around, Counts
from planner.order import canonical
from planner.plan import Action, Move, Plan, Recharge, Visit
from planner.problem import Problem
from planner.ruin_kernel import Tools
from planner.schedule import evaluate
from planner.search_kernel import Marks
from planner.solve import Params, Result, Stop

NEIGHBOURS = 16  # of each task, for the moves
CHUNK = 2_000  # steps between two looks at the clock and changes of the shortage's weight
UNVISITED_WALK_S = 2e4  # what a task left out costs on the walk, where leaving out is allowed
MOST_WORKERS = 64
DRIVE = 1e-3  # what a second that a UGV drives costs at least, in s of makespan ...
DRIVE_WALK = 1e-2  # ... and on the walk
WALK_STEPS = 16_000  # of one walk, for each task: more go into further walks from the start ...
MOST_WALKS = 8  # ... up to so many
MIN_TASKS = 10  # fewer count as that many
COOLER = 0.5  # first temperature of every other worker, as a share, where there is time for one walk only
THRIFT_FROM = 0.9  # from this share of the budget on, UGVs shall drive less within the makespan reached
THRIFT = 5e-2  # what a second that a UGV drives costs then, at least
SEEDS = 1 << 40  # from one worker's seed to the next
CLOCK_GUESS_PER_S = 400_000.0  # first guess of steps per second, only to shape the first chunks


@dataclass(frozen=True, slots=True)
class Options:
    """Options of method ``search``.

    Attributes:
        allow_partial: tasks that cannot be served are left out; the number of visits comes first, then the makespan.
        exclude_uavs: indices of UAVs that get no action and need no recovery.
        exclude_ugvs: indices of UGVs that get no action.
        hot: first temperature as a share of the best makespan so far.
        cold: last temperature as such a share.
        ruin: share of steps with a large move, see ``planner.ruin_kernel``.
        warm: first temperature from a given start, as a share of ``hot``: its structure is worth keeping.
        workers: walks at the same time, each in a thread of its own; the best one counts. Steps are shared out.
            Where there is time for one walk each, and no start is given that shall be kept, every other one begins at a
            lower temperature.
        drive: what a second that a UGV drives counts, in s of makespan. With 0 the shortest plan is wanted, and of
            those the one that drives least; with more, a longer plan may be better that drives less.
    """

    allow_partial: bool = False
    exclude_uavs: frozenset[int] = frozenset()
    exclude_ugvs: frozenset[int] = frozenset()
    hot: float = 0.08
    cold: float = 0.001
    ruin: float = 0.15
    warm: float = 0.15
    workers: int = 1
    drive: float = 0.0

    @classmethod
    def read(cls, options: Mapping[str, Any]) -> Options:
        """Reads ``Params.options``.

        Raises:
            PlannerError: for an unknown option or a wrong value.
        """
        known = [f.name for f in fields(cls)]
        if unknown := sorted(set(options) - set(known)):
            raise PlannerError(f"method 'search' has no option {unknown[0]!r}; there are {', '.join(known)}")
        values = dict(options)
        for name in ("exclude_uavs", "exclude_ugvs"):
            if name in values:
                given = values[name]
                if isinstance(given, str) or not isinstance(given, Iterable):
                    raise PlannerError(f"option {name} is {given!r}; give a set of indices")
                indices = list(given)
                if not all(type(i) is int for i in indices):
                    raise PlannerError(f"option {name} is {given!r}; give a set of indices")
                values[name] = frozenset(indices)
        if not isinstance(values.get("allow_partial", False), bool):
            raise PlannerError(f"option allow_partial is {values['allow_partial']!r}; give true or false")
        made = cls(**values)
        for name, most in (("hot", inf), ("cold", inf), ("warm", inf), ("ruin", 1.0)):
            value = getattr(made, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < most:
                limit = "" if most > 1.0 else " and below 1"
                raise PlannerError(f"option {name} is {value!r}; give a number above 0{limit}")
        drive = made.drive
        if isinstance(drive, bool) or not isinstance(drive, int | float) or not 0 <= drive < inf:
            raise PlannerError(f"option drive is {drive!r}; give a number, 0 or above")
        if type(made.workers) is not int or not 0 < made.workers <= MOST_WORKERS:
            raise PlannerError(f"option workers is {made.workers!r}; give a whole number from 1 to {MOST_WORKERS}")
        return made


class _Search:
    """What all walks of one search share, and the scoring of plans."""

    def __init__(self, problem: Problem, options: Options) -> None:
        self.problem, self.options = problem, options
        self.arrays = arrays_of(problem)
        self.visited = self.arrays.visited
        self.world = self.arrays.world(options.exclude_uavs, options.exclude_ugvs)
        self.work = self.arrays.work(unique=True)
        self.around = _around(self.world)
        self.rows = np.empty((0, 9))
        # Where tasks may be left out, no number of visits makes up for a vehicle that is lost.
        self.short_s = 1e9 if options.allow_partial else 1e3
        self.drive = max(DRIVE, float(options.drive))
        todo = int((self.visited == 0).sum())
        self.capacity = 4 * todo + 8 * len(self.world.uavs) + 64

    def pack(self, actions: Sequence[Action], fill: bool) -> _Draft:
        """``actions`` and a pool of what they do not visit; where ``fill``, the pool is put in at once."""
        codes = encode_meets(self.problem, actions)
        seen = {a.task for a in actions if isinstance(a, Visit)}
        pool = [m for m in np.flatnonzero(self.visited == 0).tolist() if m not in seen]
        acts = np.zeros(max(self.capacity, len(codes) + len(pool) + 64), np.int64)
        acts[: len(codes)] = codes
        acts[len(codes) : len(codes) + len(pool)] = pool
        draft = _Draft(acts, np.array([len(codes), len(pool)], dtype=np.int64))
        self.settle(draft, fill)
        return draft

    def settle(self, draft: _Draft, fill: bool) -> None:
        search_kernel.settle(
            draft.acts, draft.counts, self.world, self.work, self.rows, self.around.uavs, fill, self.short_s, self.drive
        )

    def score(self, draft: _Draft, work: Work | None = None) -> float:
        n, work = int(draft.counts[0]), work or self.work
        kernel.run(self.world, work, draft.acts, n, np.inf, self.rows)
        return search_kernel.score(work.out, n, self.short_s, search_kernel.UNVISITED_S, 0.0, self.drive)

    def sound(self, draft: _Draft) -> bool:
        """Whether every task is visited and nothing falls short."""
        self.score(draft)
        return bool(self.work.out[kernel.O_SHORT_S] == 0.0 and self.work.out[kernel.O_UNVISITED] == 0)


@dataclass(frozen=True, slots=True)
class _Draft:
    """A plan for the kernels: actions and tasks left out, and how many of each, see ``moves_kernel``."""

    acts: Codes
    counts: Counts

    def copy(self) -> _Draft:
        return _Draft(self.acts.copy(), self.counts.copy())


class _Budget:
    """How much of a walker's time or steps is used."""

    def __init__(self, stop: Stop, begun: float) -> None:
        self.stop, self.begun = stop, begun
        self.done = 0
        self.walked_s = 0.0

    def steps(self, end: float) -> int:
        """Steps up to the next look at the clock; 0 once the share ``end`` of the budget is used up."""
        if self.share() >= end:
            return 0
        if self.stop.iterations is None:
            return CHUNK
        return max(0, min(CHUNK, round(end * self.stop.iterations) - self.done))

    def share(self, more: int = 0) -> float:
        """The share of the budget that is used, or will be after ``more`` steps."""
        steps = (self.done + more) / max(1, self.stop.iterations) if self.stop.iterations is not None else 0.0
        used = 0.0
        if self.stop.time_s is not None:
            spent = time.perf_counter() - self.begun
            used = (spent + more * self.pace()) / self.stop.time_s
        return min(1.0, max(steps, used))

    def pace(self) -> float:
        """Seconds for a step."""
        return self.walked_s / self.done if self.done else 1.0 / CLOCK_GUESS_PER_S

    def left(self) -> float:
        """About how many steps there are."""
        by_time = (
            inf if self.stop.time_s is None else (self.begun + self.stop.time_s - time.perf_counter()) / self.pace()
        )
        return by_time if self.stop.iterations is None else min(by_time, self.stop.iterations - self.done)


class _Walker:
    """Walks one after the other, in one thread; its random numbers and work space are its own."""

    def __init__(self, s: _Search, seed: int, budget: _Budget, size: int, cooler: float) -> None:
        self.s, self.budget, self.cooler = s, budget, cooler
        self.work = s.arrays.work(unique=True)
        self.tools, self.marks = _space(s.world, self.work, size)
        # xorshift's state may not be 0; the multiplication spreads small seeds over all bits
        self.rng = np.array([(seed * 0x9E3779B97F4A7C15 + 0xD1B54A32D192ED03) & (1 << 64) - 1 or 1], dtype=np.uint64)

    def walks(self, first: _Draft, warm: bool) -> _Draft:
        """The best plan on some walks from ``first``, the last of them for thrift from the best so far."""
        n, heat = 1, self.s.options.warm if warm else 1.0
        if heat >= 1.0:  # the start may be left far behind
            length = WALK_STEPS * max(MIN_TASKS, int((self.s.visited == 0).sum()))
            if self.budget.stop.time_s is not None and self.budget.left() > 0.5 * length:  # it might be several walks
                self._anneal(first.copy(), first.copy(), self.budget.steps(1.0), 1.0, 1.0, 0.0)  # how fast does it go?
            n = int(self.budget.left() / length)
            n = max(1, min(MOST_WALKS, n))
            heat *= self.cooler if n == 1 else 1.0
        begin = self.budget.share()
        found = []
        for k in range(n):
            share = (THRIFT_FROM - begin) / n
            found.append(self._walk(first, begin + share * k, begin + share * (k + 1), heat))
        best = min(found, key=self._score)
        return self._walk(best, THRIFT_FROM, 1.0, 0.0, cap_s=self._span(best) + 1e-6)

    def _score(self, draft: _Draft) -> float:
        return self.s.score(draft, self.work)

    def _span(self, draft: _Draft) -> float:
        self.s.score(draft, self.work)
        return max(1.0, float(self.work.out[kernel.O_MAKESPAN]))

    def _walk(self, first: _Draft, begin: float, end: float, heat: float, cap_s: float = 0.0) -> _Draft:
        """The best plan between two shares of the budget; ``heat`` scales the first temperature."""
        o, best, current = self.s.options, first.copy(), first.copy()
        least, most = (200.0, 1e5) if o.allow_partial else (2.0, 1e3)
        weight = 5.0 * least
        while (steps := self.budget.steps(end)) > 0:
            now = (self.budget.share() - begin) / (end - begin)
            then = max(now, (self.budget.share(steps) - begin) / (end - begin))
            scale = self._span(best)  # the first plan may be far longer than what soon is found
            hot = max(o.hot * heat, o.cold) * scale
            cold = o.cold * scale
            hot_s, cold_s = (hot * (cold / hot) ** min(1.0, max(0.0, x)) for x in (now, then))
            fine = self._anneal(best, current, steps, hot_s, cold_s, weight, cap_s)
            if fine < 0.4:
                weight = min(weight * 1.25, most)
            elif fine > 0.7:
                weight = max(weight / 1.25, least)
        return best

    def _anneal(
        self, best: _Draft, current: _Draft, steps: int, hot_s: float, cold_s: float, weight: float, cap_s: float = 0.0
    ) -> float:
        s, begun = self.s, time.perf_counter()
        drive = max(THRIFT if cap_s > 0.0 else DRIVE_WALK, s.drive)
        fine = search_kernel.anneal(
            best.acts, best.counts, current.acts, current.counts, s.world, self.work, s.around, self.tools,
            self.marks, s.rows, s.options.allow_partial, self.rng, steps, hot_s, cold_s, weight, UNVISITED_WALK_S,
            s.short_s, s.options.ruin, cap_s, drive, drive if cap_s > 0.0 else s.drive,
        )  # fmt: skip
        self.budget.done += steps
        self.budget.walked_s += time.perf_counter() - begun
        return fine


def search(problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
    """Plans by a constructive start and simulated annealing; see ``planner.solve.solve``.

    Raises:
        PlannerError: for an unknown option, or a start that names something that does not exist.
    """
    begun = time.perf_counter()
    options = Options.read(params.options)
    s = _Search(problem, options)
    if len(s.around.uavs) == 0 or bool(problem.visited.all()):
        return _result(problem, (), options, 0)
    drafts: list[_Draft] = []
    fill = not options.allow_partial
    if params.start is not None:
        drafts.append(s.pack(_repair(problem, params.start, options), fill))
    if not drafts or not s.sound(drafts[0]):  # a first plan takes tens of ms for 45 tasks: too long for a replan
        drafts += [s.pack(actions, fill) for actions in construct(problem, options.exclude_uavs, options.exclude_ugvs)]
    first = min(drafts, key=s.score)
    warm = params.start is not None and first is drafts[0]
    n = options.workers
    each = stop if stop.iterations is None else replace(stop, iterations=-(-stop.iterations // n))
    size = len(first.acts)
    walkers = [_Walker(s, seed + SEEDS * k, _Budget(each, begun), size, COOLER if k % 2 else 1.0) for k in range(n)]
    with ThreadPoolExecutor(n) as pool:  # the kernels free the GIL
        found = list(pool.map(lambda w: w.walks(first, warm), walkers))
    best = min(found, key=s.score)
    s.settle(best, fill=not options.allow_partial)
    done = sum(w.budget.done for w in walkers)
    return _result(problem, decode(problem, best.acts[: int(best.counts[0])]), options, done)


def _space(world: World, work: Work, size: int) -> tuple[Tools, Marks]:
    """Work space for plans of up to ``size`` actions and tasks left out."""
    n_tasks, n_uavs, n_ugvs = len(world.visited), len(world.uavs), len(world.ugvs)
    tools = Tools(
        np.zeros(n_tasks, np.uint8),
        np.empty(ruin_kernel.MOST, np.int32),
        np.empty(size),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size, np.int32),
        np.empty(size + n_uavs),
        np.empty(n_uavs, np.int32),
        np.empty(n_uavs, np.int32),
        np.empty(n_uavs),
    )
    k = size // search_kernel.EVERY + 1
    marks = Marks(
        np.empty((k, n_uavs), np.int32),
        np.empty((k, n_uavs, 2)),
        np.empty((k, n_ugvs), np.int32),
        np.empty((k, n_ugvs, 4)),
        np.empty((k, *work.docks.shape)),
        np.empty((k, *work.sums.shape)),
    )
    return tools, marks


def _around(world: World) -> Around:
    n_tasks, n_sites = len(world.visited), world.road.shape[1]
    todo = np.flatnonzero(world.visited == 0)
    between = world.dist[:n_tasks, :n_tasks][:, todo].copy()
    between[todo, np.arange(len(todo))] = np.inf
    k = max(0, min(NEIGHBOURS, len(todo) - 1))
    tasks = todo[np.argsort(between, axis=1, kind="stable")[:, :k]]
    sites = np.argsort(world.dist[:n_tasks, n_tasks : n_tasks + n_sites], axis=1, kind="stable")
    return Around(
        np.ascontiguousarray(tasks, np.int32),
        np.ascontiguousarray(sites, np.int32),
        np.flatnonzero(world.uav_on).astype(np.int32),
        np.flatnonzero(world.ugv_on).astype(np.int32),
    )


def _repair(problem: Problem, start: Sequence[Action], options: Options) -> list[Action]:
    """What of ``start`` still makes sense: no task twice, no excluded vehicle."""
    encode(problem, start)
    seen = set(np.flatnonzero(problem.visited).tolist())
    kept: list[Action] = []
    for act in start:
        if isinstance(act, Visit | Recharge) and act.uav in options.exclude_uavs:
            continue
        if isinstance(act, Move | Recharge) and act.ugv in options.exclude_ugvs:
            continue
        if isinstance(act, Visit):
            if act.task in seen:
                continue
            seen.add(act.task)
        kept.append(act)
    return kept


def _result(problem: Problem, actions: Collection[Action], options: Options, iterations: int) -> Result:
    ordered = canonical(problem, tuple(actions))
    schedule = evaluate(problem, ordered, exclude_uavs=options.exclude_uavs, exclude_ugvs=options.exclude_ugvs)
    return Result(Plan(ordered, schedule, "search"), iterations, 0.0)
