"""Method ``search``: a sound first plan, then simulated annealing over the joint action list, compiled.

Searching over the list that the evaluator decodes needs no bookkeeping of how routes depend on one another (Kira 2017).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner import kernel, search_kernel
from planner.arrays import Arrays, arrays_of, decode, encode, switched_on
from planner.construct import construct
from planner.errors import PlannerError
from planner.kernel import Ints
from planner.order import canonical
from planner.plan import Action, Move, Plan, Recharge, Visit
from planner.problem import Problem
from planner.schedule import evaluate
from planner.solve import Params, Result, Stop

# With some thirty arguments each, unpacked from tuples, the kernels' signatures are beyond the type checker.
_run: Callable[..., bool] = kernel.run
_settle: Callable[..., None] = search_kernel.settle
_anneal_steps: Callable[..., float] = search_kernel.anneal

CHUNK = 2_000  # steps between two looks at the clock and changes of the shortage's weight
UNVISITED_WALK_S = 2e4  # what a task left out costs on the walk, where leaving out is allowed
WARM = 0.15  # share of the first temperature for a warm start: its structure is worth keeping
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
    """

    allow_partial: bool = False
    exclude_uavs: frozenset[int] = frozenset()
    exclude_ugvs: frozenset[int] = frozenset()
    hot: float = 0.08
    cold: float = 0.0005

    @classmethod
    def read(cls, options: Mapping[str, Any]) -> Options:
        """Reads ``Params.options``.

        Raises:
            PlannerError: for an unknown option or a wrong value.
        """
        known = ("allow_partial", "exclude_uavs", "exclude_ugvs", "hot", "cold")
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
        for name in ("hot", "cold"):
            value = getattr(made, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < float("inf"):
                raise PlannerError(f"option {name} is {value!r}; give a number above 0")
        return made


class _Search:
    """The state of one search: arrays for the kernels, the current and the best plan."""

    def __init__(self, problem: Problem, seed: int, options: Options) -> None:
        self.problem, self.options = problem, options
        a = self.arrays = arrays_of(problem)
        self.uav_on = switched_on("uav", len(a.uavs), options.exclude_uavs)
        self.ugv_on = switched_on("ugv", len(a.ugvs), options.exclude_ugvs)
        self.uav_list = np.flatnonzero(self.uav_on).astype(np.int32)
        self.ugv_list = np.flatnonzero(self.ugv_on).astype(np.int32)
        self.near_tasks, self.near_sites = _neighbours(a)
        self.scratch = a.scratch()
        self.rows = np.empty((0, 9))
        # Where tasks may be left out, no number of visits makes up for a vehicle that is lost.
        self.short_s = 1e9 if options.allow_partial else 1e3
        todo = int((a.visited == 0).sum())
        self.capacity = 4 * todo + 8 * len(a.uavs) + 64
        # xorshift's state may not be 0; the multiplication spreads small seeds over all bits
        self.rng = np.array([(seed * 0x9E3779B97F4A7C15 + 0xD1B54A32D192ED03) & (1 << 64) - 1 or 1], dtype=np.uint64)

    @property
    def fixed(self) -> tuple[Any, ...]:
        return (*self.arrays.fixed, self.uav_on, self.ugv_on)

    def pack(self, actions: Sequence[Action], fill: bool) -> tuple[Ints, NDArray[np.int64]]:
        """``actions`` and a pool of what they do not visit; where ``fill``, the pool is put in at once."""
        codes = encode(self.problem, actions)
        seen = {a.task for a in actions if isinstance(a, Visit)}
        pool = [m for m in np.flatnonzero(self.arrays.visited == 0).tolist() if m not in seen]
        acts = np.zeros(max(self.capacity, len(codes) + len(pool) + 64), np.int32)
        acts[: len(codes)] = codes
        acts[len(codes) : len(codes) + len(pool)] = pool
        counts = np.array([len(codes), len(pool)], dtype=np.int64)
        self.settle(acts, counts, fill)
        return acts, counts

    def settle(self, acts: Ints, counts: NDArray[np.int64], fill: bool) -> None:
        _settle(acts, counts, *self.fixed, self.rows, *self.scratch, self.uav_list, fill, self.short_s)

    def score(self, acts: Ints, counts: NDArray[np.int64]) -> float:
        n = int(counts[0])
        node, us, site, gs, docks, seen, out = self.scratch
        _run(acts, n, *self.fixed, np.inf, self.rows, node, us, site, gs, docks, seen, out)
        return search_kernel.score(out, n, self.short_s, search_kernel.UNVISITED_S)

    def makespan(self, acts: Ints, counts: NDArray[np.int64]) -> float:
        self.score(acts, counts)
        return max(1.0, float(self.scratch[-1][kernel.O_MAKESPAN]))


def search(problem: Problem, stop: Stop, seed: int, params: Params) -> Result:
    """Plans by a constructive start and simulated annealing; see ``planner.solve.solve``.

    Raises:
        PlannerError: for an unknown option, or a start that names something that does not exist.
    """
    begun = time.perf_counter()
    options = Options.read(params.options)
    s = _Search(problem, seed, options)
    if len(s.uav_list) == 0 or bool(problem.visited.all()):
        return _result(problem, (), options, 0)
    starts: list[Sequence[Action]] = []
    if params.start is not None:
        starts.append(_repair(problem, params.start, options))
    starts += construct(problem, options.exclude_uavs, options.exclude_ugvs)
    packed = [s.pack(actions, fill=not options.allow_partial) for actions in starts]
    best, best_counts = min(packed, key=lambda x: s.score(*x))
    warm = params.start is not None and best is packed[0][0]
    size = max(len(acts) for acts, _ in packed)
    best = np.concatenate([best, np.zeros(size - len(best), np.int32)])
    done = _anneal(s, best, best_counts, stop, begun, WARM if warm else 1.0)
    s.settle(best, best_counts, fill=not options.allow_partial)
    return _result(problem, decode(problem, best[: int(best_counts[0])]), options, done)


def _anneal(s: _Search, best: Ints, best_counts: NDArray[np.int64], stop: Stop, begun: float, heat: float) -> int:
    """Improves ``best`` in place until ``stop``; how many steps it took. ``heat`` scales the first temperature."""
    current, counts = best.copy(), best_counts.copy()
    least, most = (200.0, 1e5) if s.options.allow_partial else (2.0, 1e3)
    weight = 5.0 * least
    done = 0
    share = 0.0
    while True:
        steps = CHUNK if stop.iterations is None else min(CHUNK, stop.iterations - done)
        if steps <= 0:
            return done
        after = (done + steps) / stop.iterations if stop.iterations is not None else 0.0
        if stop.time_s is not None:
            used = time.perf_counter() - begun
            if used >= stop.time_s:
                return done
            share = max(share, used / stop.time_s)
            pace = used / done if done else 1.0 / CLOCK_GUESS_PER_S
            after = max(after, (used + steps * pace) / stop.time_s)
        after = min(max(after, share), 1.0)
        scale = s.makespan(best, best_counts)  # the first plan may be far longer than what soon is found
        hot = max(s.options.hot * heat, s.options.cold) * scale
        cold = s.options.cold * scale
        fine = _anneal_steps(
            best, best_counts, current, counts, *s.fixed, s.rows, *s.scratch,
            s.near_tasks, s.near_sites, s.uav_list, s.ugv_list, s.options.allow_partial, s.rng,
            steps, hot * (cold / hot) ** share, hot * (cold / hot) ** after, weight,
            UNVISITED_WALK_S, s.short_s,
        )  # fmt: skip
        if fine < 0.4:
            weight = min(weight * 1.25, most)
        elif fine > 0.7:
            weight = max(weight / 1.25, least)
        done += steps
        if stop.iterations is not None:
            share = max(share, done / stop.iterations)


def _neighbours(a: Arrays) -> tuple[Ints, Ints]:
    """Nearest unvisited tasks of each task, (n_tasks, K), and its sites, nearest first, (n_tasks, P + 1)."""
    n_tasks, n_sites = len(a.visited), a.road.shape[1]
    todo = np.flatnonzero(a.visited == 0)
    between = a.dist[:n_tasks, :n_tasks][:, todo].copy()
    between[todo, np.arange(len(todo))] = np.inf
    k = max(0, min(8, len(todo) - 1))
    near_tasks = todo[np.argsort(between, axis=1, kind="stable")[:, :k]]
    near_sites = np.argsort(a.dist[:n_tasks, n_tasks : n_tasks + n_sites], axis=1, kind="stable")
    return np.ascontiguousarray(near_tasks, np.int32), np.ascontiguousarray(near_sites, np.int32)


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
