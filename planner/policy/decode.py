"""Plans by network ``plus``: greedily, by sampling, or by a beam that the schedule judges. No torch.

Every plan is simulated exactly as it is decoded, and judged by its makespan, with small weights on what search counts
too (flown and driven time). At each decision a plain way to finish is worked out behind the option that is taken and
behind the few next best (``outline_kernel``); the best whole plan seen on the way counts, not only the one that the
network ends with. Where a way to finish was known from the start, the plan is feasible; ``Decoded.certain``
says so. Where not, some tasks may be left (``Decoded.complete``) and search has to take over.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from planner import kernel
from planner.arrays import decode as to_actions
from planner.errors import PlannerError
from planner.kernel import Codes, Floats, Work
from planner.order import canonical
from planner.plan import Action
from planner.policy import decode_kernel as dk
from planner.policy import tokens_kernel as tk
from planner.policy.blas import one_thread
from planner.policy.complete_kernel import copy_work
from planner.policy.config import PlusConfig
from planner.policy.decode_kernel import Desk
from planner.policy.domain import Domain
from planner.policy.features_kernel import fill_view
from planner.policy.plus_kernel import Weights, logits
from planner.policy.state import SYMMETRIES, State, clone, new_state
from planner.policy.weights import Tensors, plus_weights, read, room
from planner.problem import Problem

NEVER, SHUT = np.float32(-1e9), -1e8  # the logit of what is not offered, and what lies above it
THRIFTY = 5.0  # how much less likely (in logits) an option may be that spares a recharge
PROBES, PROBE = 6, 6.0  # how many options are probed beside the best, and how much less likely (in logits) they may be
FORCED = 0.05  # the probability that a forced decision counts with


@dataclass(frozen=True, slots=True)
class Decoded:
    """A plan.

    Attributes:
        codes: its visits and meetings in the order decided.
        makespan_s: end of the last visit.
        cost: what plans are compared by, in s; inf where it is not complete.
        complete: every task is visited and no rule is broken.
        certain: a way to finish was known at every step.
        decisions: of the network, over all attempts.
        refused: options that were turned down while the network's own plan was decoded (this one, or the one that a
            plain way to finish turned into this one).
        forced: decisions of the network's own plan that were taken from a known way to finish.
        chosen: decisions of that plan that the network took.
        log_p: log-probability of these.
        doubt: the least probability of a choice.
    """

    codes: Codes
    makespan_s: float
    cost: float
    complete: bool
    certain: bool
    decisions: int
    refused: int
    forced: int
    chosen: int
    log_p: float
    doubt: float

    @property
    def sure(self) -> float:
        """Geometric mean of the probabilities of its own plan's decisions; forced ones count as improbable."""
        n = self.chosen + self.forced
        return math.exp((self.log_p + self.forced * math.log(FORCED)) / n) if n else 1.0

    def actions(self, problem: Problem) -> tuple[Action, ...]:
        """The plan as joint actions in canonical order."""
        return canonical(problem, to_actions(problem, self.codes))


def _see(s: State, xy: Floats) -> int:
    """Whose turn it is, -1 if nobody's; its options and its view are filled in."""
    u = tk.acting(s.work, s.turn)
    if u >= 0:
        tk.offer(s.world, s.work, s.turn, u)
        fill_view(s.world, s.work, s.turn, u, xy, s.reach, s.view)
    return u


class _Seat:
    """One problem with all room to decode it; not to be shared between threads."""

    def __init__(self, policy: Policy, problem: Problem, off: tuple[Collection[int], Collection[int]]) -> None:
        one_thread()
        self.weights, self.look_ahead = policy.weights, policy.look_ahead
        self.s: State = new_state(problem, *off)
        w = self.s.world
        self.n_tasks, self.n_sites, self.n_ugvs = len(w.visited), w.road.shape[1], len(w.ugvs)
        self.desk = Desk(
            self.s.space,
            clone(self.s.work),
            np.zeros(len(w.uavs), np.int32),
            np.zeros(2, np.int64),
            self.s.way,
            np.zeros_like(self.s.way),
            np.zeros(2 * len(self.s.way), np.int64),
        )
        self.room = room(policy.config, self.n_tasks + self.n_sites + len(w.uavs) + self.n_ugvs)
        self.logits = np.zeros(self.n_tasks + self.n_ugvs * self.n_sites + 1, np.float32)
        self.report = np.zeros(dk.REPORT)

    def turned(self, symmetry: int) -> Floats:
        return self.s.xy if symmetry == 0 else np.ascontiguousarray(self.s.xy @ SYMMETRIES[symmetry])

    def take(self, u: int, option: int, *, force: bool = False, thrifty: bool = False) -> bool:
        s = self.s
        return dk.take(s.world, s.work, s.turn, self.desk, u, option, force, thrifty, s.acts, self.report)

    def begin(self) -> None:
        s = self.s
        tk.start(s.world, s.work, s.turn)
        self.report[:] = 0.0
        self.report[dk.D_DOUBT] = 1.0
        self.report[dk.D_ALONE_S] = self.report[dk.D_BEST_COST] = math.inf
        self.take(0, -1)

    @property
    def finished(self) -> bool:
        return bool(self.s.work.sums[kernel.S_LEFT] <= 0 or self.report[dk.D_ACTIONS] >= len(self.s.acts) - 1)

    def look(self, xy: Floats) -> tuple[int, NDArray[np.float32]]:
        """Whose turn it is, -1 if nobody's, and the logits of the options, tasks counted among those that are left."""
        s = self.s
        u = _see(s, xy)
        if u < 0:
            return u, self.logits[:0]
        left = int(s.view.counts[0])
        end = left + self.n_ugvs * self.n_sites
        some = self.logits[: end + 1]
        meet = some[left:end].reshape(self.n_ugvs, self.n_sites)
        logits(self.weights, self.room, s.view, some[:left], meet, some[end:])
        self.report[dk.D_DECISIONS] += 1
        return u, some

    def option(self, place: int) -> int:
        """The option at a place in ``look``'s logits."""
        left = int(self.s.view.counts[0])
        return int(self.s.view.tasks[place]) if place < left else place - left + self.n_tasks

    def _probe(self, u: int, some: NDArray[np.float32], taken: int) -> None:
        """Looks what ways to finish are behind the most probable options beside the one that is taken."""
        s = self.s
        least = max(SHUT, float(some.max()) - PROBE)
        for place in np.argsort(-some, kind="stable")[: 1 + PROBES].tolist():
            if some[place] <= least:
                return
            if place == taken:
                continue
            dk.probe(s.world, s.work, s.turn, self.desk, u, self.option(place), s.acts, self.report)

    def run(self, xy: Floats, heat: float = 0.0, rng: np.random.Generator | None = None) -> None:
        """Decodes from the present state to the end: the largest logits, or with Gumbel noise a sample."""
        report = self.report
        while not self.finished:
            u, some = self.look(xy)
            if u < 0:
                return
            values = some
            if rng is not None:
                values = some + heat * rng.gumbel(size=len(some)).astype(np.float32)
            total, thrifty = None, report[dk.D_ALONE_S] < math.inf
            whole, first = some.copy(), values.copy()
            if self.look_ahead:
                self._probe(u, some, int(values.argmax()))
            while True:
                place = int(values.argmax())
                if thrifty and (some[place] <= SHUT or some[place] < whole.max() - THRIFTY):
                    thrifty, some[:], values[:] = False, whole, first
                    continue
                if some[place] <= SHUT:
                    if not self.take(u, 0, force=True):
                        self.s.turn.done[u] = 1  # nothing is offered and no way is known: search has to take over
                    break
                if total is None:
                    best = float(some.max())
                    total = best + math.log(float(np.exp(some - best).sum()))
                value = float(some[place]) - total
                if self.take(u, self.option(place), thrifty=thrifty):
                    report[dk.D_CHOSEN] += 1
                    report[dk.D_LOG_P] += value
                    report[dk.D_DOUBT] = min(report[dk.D_DOUBT], math.exp(value))
                    break
                some[place] = values[place] = NEVER

    def result(self, sure: bool, *, whole: bool = True) -> Decoded:
        """The present plan; with ``whole`` a better one, if one was known on the way."""
        world, k, r = self.s.world, self.s.work, self.report
        codes = self.s.acts[: int(r[dk.D_ACTIONS])]
        kernel.total(world, k)
        if whole and self.look_ahead and r[dk.D_BEST_COST] < dk.cost_of(k.out):
            codes, k = self.desk.best[: int(r[dk.D_BEST_N])], self.s.space
            kernel.run(world, k, codes, len(codes), math.inf, self.s.turn.rows)
        cost = dk.cost_of(k.out)
        return Decoded(
            codes.copy(),
            float(k.out[kernel.O_MAKESPAN]),
            cost,
            cost < math.inf,
            sure,
            int(r[dk.D_DECISIONS]),
            int(r[dk.D_REFUSED]),
            int(r[dk.D_FORCED]),
            int(r[dk.D_CHOSEN]),
            float(r[dk.D_LOG_P]),
            float(r[dk.D_DOUBT]),
        )

    def plan(self, symmetry: int = 0, heat: float = 0.0, seed: int | None = None) -> Decoded:
        """A whole plan; with a seed a sample."""
        self.begin()
        sure = bool(self.report[dk.D_CERTAIN])
        self.run(self.turned(symmetry), heat, None if seed is None else np.random.default_rng(seed))
        return self.result(sure)

    def keep(self) -> _Node:
        """The present state, to come back to."""
        s = self.s
        return _Node(
            clone(s.work), s.turn.done.copy(), s.turn.row.copy(), s.acts[: int(self.report[dk.D_ACTIONS])].copy(),
            self.desk.way.copy(), self.desk.hint.copy(), self.report.copy(),
        )  # fmt: skip

    def back(self, node: _Node) -> None:
        """Comes back to a state."""
        s = self.s
        copy_work(node.work, s.work)
        s.turn.done[:], s.turn.row[:] = node.done, node.row
        s.acts[: len(node.acts)] = node.acts
        self.desk.way[:], self.desk.hint[:] = node.way, node.hint
        self.report[: dk.D_BEST_N] = node.report[: dk.D_BEST_N]  # the best plan known stays known


@dataclass(frozen=True, slots=True)
class _Node:
    """A plan half made: the state of all vehicles, the actions so far, a way to finish, and counts.

    Attributes:
        work, done, row, acts, way, hint, report: as in ``_Seat``, ``Turn`` and ``Desk``.
        cost: of the plan that greedy makes of it.
        end: all actions of that plan.
    """

    work: Work
    done: kernel.Flags
    row: kernel.Ints
    acts: Codes
    way: Codes
    hint: Codes
    report: Floats
    cost: float = math.inf
    end: Codes = field(default_factory=lambda: np.empty(0, np.int64))


class Policy:
    """Network ``plus`` with its weights, ready to plan. Threads may share it.

    Attributes:
        config: the network's.
        weights: as the kernel takes them.
        domain: what was seen in training.
        look_ahead: whether plain ways to finish count as plans; False leaves all to the network.
    """

    def __init__(self, config: PlusConfig, tensors: Tensors, domain: Domain | None = None) -> None:
        """Takes the weights as ``state_dict`` names them, and what was seen in training.

        Raises:
            PlannerError: where the weights do not fit ``config``.
        """
        self.config = config
        self.look_ahead = True
        self.weights: Weights = plus_weights(config, tensors)
        self.domain = domain

    def alone(self) -> Policy:
        """The same network, left alone: no plan but its own counts."""
        other = copy(self)
        other.look_ahead = False
        return other

    @classmethod
    def load(cls, path: Path, sha256: str | None = None) -> Policy:
        """Reads a weights file.

        Raises:
            PlannerError: where it is missing, damaged, or no network ``plus``.
        """
        config, tensors, about = read(path, sha256)
        if not isinstance(config, PlusConfig):
            raise PlannerError(f"{path}: this is no network plus")
        try:
            return cls(config, tensors, Domain.from_json(about["domain"]) if "domain" in about else None)
        except PlannerError as error:
            raise PlannerError(f"{path}: {error}") from error

    def outside(
        self, problem: Problem, *, exclude_uavs: Collection[int] = (), exclude_ugvs: Collection[int] = ()
    ) -> str | None:
        """In which respect the problem is unlike what the network was trained on, in words; None where it is like it.

        Raises:
            PlannerError: when an excluded vehicle does not exist.
        """
        if self.domain is None:
            return None
        s = new_state(problem, exclude_uavs, exclude_ugvs)
        tk.start(s.world, s.work, s.turn)
        return None if _see(s, s.xy) < 0 else self.domain.outside(s.view)

    def greedy(
        self,
        problem: Problem,
        *,
        symmetries: int = 1,
        exclude_uavs: Collection[int] = (),
        exclude_ugvs: Collection[int] = (),
    ) -> Decoded:
        """The most probable choice at each decision; with ``symmetries`` up to 8, the best of as many orientations.

        Raises:
            PlannerError: when an excluded vehicle does not exist.
        """
        seat = _Seat(self, problem, (exclude_uavs, exclude_ugvs))
        return _best_of([seat.plan(k) for k in range(symmetries)])

    def sample(
        self,
        problem: Problem,
        count: int,
        *,
        heat: float = 1.0,
        seed: int = 0,
        threads: int = 1,
        time_s: float = math.inf,
        exclude_uavs: Collection[int] = (),
        exclude_ugvs: Collection[int] = (),
    ) -> Decoded:
        """The best of ``count`` plans over all eight orientations; the first eight are greedy, the others samples.

        Args:
            problem: the problem.
            count: plans.
            heat: temperature of the samples.
            seed: the same seed and count give the same plan, with any number of threads.
            threads: at once.
            time_s: no plan is begun after that.
            exclude_uavs: indices of UAVs that take no part.
            exclude_ugvs: indices of UGVs that take no part.

        Raises:
            PlannerError: when an excluded vehicle does not exist.
        """
        begun = time.perf_counter()

        def some(part: int) -> list[tuple[int, Decoded]]:
            seat = _Seat(self, problem, (exclude_uavs, exclude_ugvs))
            found: list[tuple[int, Decoded]] = []
            for i in range(part, count, threads):
                if found and time.perf_counter() - begun > time_s:
                    break
                found.append((i, seat.plan(i % 8, heat, None if i < 8 else seed * 1_000_003 + i)))
            return found

        if threads <= 1:
            plans = some(0)
        else:
            with ThreadPoolExecutor(threads) as pool:
                plans = [x for part in pool.map(some, range(threads)) for x in part]
        return _best_of([plan for _, plan in sorted(plans, key=lambda x: x[0])])

    def beam(
        self,
        problem: Problem,
        width: int = 4,
        expand: int = 4,
        *,
        time_s: float = math.inf,
        symmetry: int = 0,
        exclude_uavs: Collection[int] = (),
        exclude_ugvs: Collection[int] = (),
    ) -> Decoded:
        """A beam whose members are judged by how a greedy end of each turns out (SGBS, arXiv 2207.06190).

        At every level each of ``width`` plans half made is continued by its ``expand`` most probable choices, each of
        these is finished greedily and simulated, and the ``width`` best go on. The best plan ever seen is the result.

        Args:
            problem: the problem.
            width: plans that are kept.
            expand: choices of each.
            time_s: no level is begun after that.
            symmetry: orientation, 0 to 7.
            exclude_uavs: indices of UAVs that take no part.
            exclude_ugvs: indices of UGVs that take no part.

        Raises:
            PlannerError: when an excluded vehicle does not exist.
        """
        begun = time.perf_counter()
        seat = _Seat(self, problem, (exclude_uavs, exclude_ugvs))
        xy = seat.turned(symmetry)
        seat.begin()
        sure = bool(seat.report[dk.D_CERTAIN])
        first = seat.keep()
        seat.run(xy)
        best = seat.result(sure, whole=False)
        nodes, decisions = [replace(first, cost=best.cost, end=best.codes)], best.decisions
        while nodes and time.perf_counter() - begun < time_s:
            children: dict[bytes, _Node] = {}
            for node in nodes:
                seat.back(node)
                if seat.finished:
                    continue
                u, some = seat.look(xy)
                decisions += 1
                if u < 0:
                    continue
                places = [p for p in np.argsort(-some, kind="stable")[:expand].tolist() if some[p] > SHUT]
                options = [seat.option(p) for p in places]
                found = 0
                for k in range(len(options) + 1):
                    force = k == len(options)
                    if force and found:
                        break  # the known way is for where nothing else is left
                    seat.back(node)
                    if not seat.take(u, 0 if force else options[k], force=force):
                        continue
                    found += 1
                    child = seat.keep()
                    key, n = child.acts.tobytes() + child.done.tobytes(), len(child.acts)
                    if key in children:
                        continue
                    if not force and n > len(node.acts) and np.array_equal(child.acts, node.end[:n]):
                        child = replace(child, cost=node.cost, end=node.end)  # what greedy does there is known
                    else:
                        seat.report[dk.D_DECISIONS] = 0
                        seat.run(xy)
                        end = seat.result(sure, whole=False)
                        decisions += end.decisions
                        best = min(best, end, key=lambda x: x.cost)
                        child = replace(child, cost=end.cost, end=end.codes)
                    children[key] = child
            nodes = sorted(children.values(), key=lambda x: x.cost)[:width]
        known = seat.result(sure)
        if known.cost < best.cost:  # how sure the network is, is still told of its own plan
            best = replace(
                best, codes=known.codes, makespan_s=known.makespan_s, cost=known.cost, complete=known.complete
            )
        return replace(best, decisions=decisions)


def _best_of(plans: list[Decoded]) -> Decoded:
    best = min(plans, key=lambda x: (x.cost, -len(x.codes)))
    return replace(best, decisions=sum(x.decisions for x in plans))
