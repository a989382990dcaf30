"""Plans by network ``plus``: greedily, by sampling, or by a beam that the schedule judges. No torch.

Every plan is simulated exactly as it is decoded, and judged by its makespan, with small weights on what search counts
too (flown and driven time). Where a way to finish was known from the start, the plan is feasible; ``Decoded.certain``
says so. Where not, some tasks may be left (``Decoded.complete``) and search has to take over.
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner import kernel
from planner.arrays import decode as to_actions
from planner.errors import PlannerError
from planner.kernel import Codes, Floats, Work
from planner.order import canonical
from planner.plan import Action
from planner.policy import decode_kernel as dk
from planner.policy import tokens_kernel as tk
from planner.policy.batches import SYMMETRIES
from planner.policy.complete_kernel import copy_work
from planner.policy.config import PlusConfig
from planner.policy.decode_kernel import Desk
from planner.policy.plus_kernel import Weights
from planner.policy.state import State, clone, new_state
from planner.policy.weights import Tensors, plus_weights, read, room
from planner.problem import Problem

FLY, DRIVE = 2e-3, 1e-3  # what a flown and a driven second count beside one of makespan


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
        refused: options of this plan that were turned down as no way to finish was found behind them.
        forced: decisions of this plan that were taken from that way.
        log_p: log-probability of a greedy plan.
        doubt: the least probability of a greedy choice.
    """

    codes: Codes
    makespan_s: float
    cost: float
    complete: bool
    certain: bool
    decisions: int
    refused: int
    forced: int
    log_p: float
    doubt: float

    def actions(self, problem: Problem) -> tuple[Action, ...]:
        """The plan as joint actions in canonical order."""
        return canonical(problem, to_actions(problem, self.codes))


class _Seat:
    """One problem with all room to decode it; not to be shared between threads."""

    def __init__(self, policy: Policy, problem: Problem, off: tuple[Collection[int], Collection[int]]) -> None:
        self.weights = policy.weights
        self.s: State = new_state(problem, *off)
        w = self.s.world
        n_tasks, n_sites, n_uavs, n_ugvs = len(w.visited), w.road.shape[1], len(w.uavs), len(w.ugvs)
        before = clone(self.s.work)
        self.desk = Desk(
            self.s.space,
            before,
            np.zeros(n_uavs, np.int32),
            np.zeros(n_tasks, np.float32),
            np.zeros((n_ugvs, n_sites), np.float32),
            np.zeros(1, np.float32),
            np.zeros(2, np.int64),
            self.s.way,
            np.zeros_like(self.s.way),
            room(policy.config, n_tasks + n_sites + n_uavs + n_ugvs),
            self.s.view,
        )
        self.report = np.zeros(dk.REPORT)
        self.rng = np.zeros(1, np.int64)

    def turned(self, symmetry: int) -> Floats:
        return self.s.xy if symmetry == 0 else np.ascontiguousarray(self.s.xy @ SYMMETRIES[symmetry])

    def begin(self) -> None:
        s = self.s
        tk.start(s.world, s.work, s.turn)
        self.report[:] = 0.0
        self.report[dk.D_DOUBT] = 1.0
        dk.ready(s.world, s.work, s.turn, self.desk, self.report)

    def run(self, xy: Floats, heat: float = 0.0, seed: int = 0) -> None:
        s = self.s
        self.rng[0] = seed
        dk.decode(s.world, s.work, s.turn, xy, s.reach, self.weights, self.desk, s.acts, heat, self.rng, self.report)

    def result(self, sure: bool) -> Decoded:
        w, k, r = self.s.world, self.s.work, self.report
        kernel.finish(w.dist, w.near, w.uavs, w.ugvs, w.uav_on, w.ugv_on, k.node, k.us, k.gs, k.sums, k.out)
        complete = k.out[kernel.O_CODE] == kernel.OK
        cost = k.out[kernel.O_MAKESPAN] + FLY * k.out[kernel.O_FLY_S] + DRIVE * k.out[kernel.O_DRIVE_S]
        return Decoded(
            self.s.acts[: int(r[dk.D_ACTIONS])].copy(),
            float(k.out[kernel.O_MAKESPAN]),
            float(cost) if complete else math.inf,
            bool(complete),
            sure,
            int(r[dk.D_DECISIONS]),
            int(r[dk.D_REFUSED]),
            int(r[dk.D_FORCED]),
            float(r[dk.D_LOG_P]),
            float(r[dk.D_DOUBT]),
        )

    def plan(self, symmetry: int = 0, heat: float = 0.0, seed: int = 0) -> Decoded:
        self.begin()
        sure = bool(self.report[dk.D_CERTAIN])
        self.run(self.turned(symmetry), heat, seed)
        return self.result(sure)


@dataclass(frozen=True, slots=True)
class _Node:
    """A plan half made: the state of all vehicles, the actions so far, a way to finish, the greedy end and its cost."""

    work: Work
    done: kernel.Flags
    row: kernel.Ints
    acts: Codes
    way: Codes
    report: Floats
    cost: float


class Policy:
    """Network ``plus`` with its weights, ready to plan. Threads may share it."""

    def __init__(self, config: PlusConfig, tensors: Tensors) -> None:
        """Takes the weights as ``state_dict`` names them.

        Raises:
            PlannerError: where they do not fit ``config``.
        """
        self.config = config
        self.weights: Weights = plus_weights(config, tensors)

    @classmethod
    def load(cls, path: Path, sha256: str | None = None) -> Policy:
        """Reads a weights file.

        Raises:
            PlannerError: where it is missing, damaged, or no network ``plus``.
        """
        config, tensors, _ = read(path, sha256)
        if not isinstance(config, PlusConfig):
            raise PlannerError(f"{path}: this is no network plus")
        return cls(config, tensors)

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
                found.append((i, seat.plan(i % 8, 0.0 if i < 8 else heat, seed * 1_000_003 + i)))
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
        s, desk, report = seat.s, seat.desk, seat.report
        xy = seat.turned(symmetry)
        seat.begin()
        sure = bool(report[dk.D_CERTAIN])
        nodes = [_keep(seat, math.inf)]
        seat.run(xy)
        best = seat.result(sure)
        decisions = best.decisions
        options = np.zeros(expand, np.int32)
        while nodes and time.perf_counter() - begun < time_s:
            children: dict[bytes, _Node] = {}
            for node in nodes:
                _back(seat, node)
                if s.work.sums[kernel.S_LEFT] <= 0:
                    continue
                u = dk.look(s.world, s.work, s.turn, xy, s.reach, seat.weights, desk, report)
                decisions += 1
                if u < 0:
                    continue
                n = dk.several(desk, int(desk.sight.counts[0]), options)
                tasks, counts = desk.sight.tasks.copy(), desk.sight.counts.copy()
                for option in [*options[:n].tolist(), -1]:
                    _back(seat, node)
                    desk.sight.tasks[:], desk.sight.counts[:] = tasks, counts
                    if option < 0:
                        if n and any(True for _ in children):
                            continue  # the known way is only for where nothing else is left
                        fine = dk.follow(s.world, s.work, s.turn, u, s.acts, desk, report)
                    else:
                        fine = dk.take(s.world, s.work, s.turn, u, option, s.acts, desk, report)
                    if not fine:
                        continue
                    child = _keep(seat, math.inf)
                    report[dk.D_DECISIONS] = 0
                    seat.run(xy)
                    end = seat.result(sure)
                    decisions += end.decisions
                    if end.cost < best.cost:
                        best = end
                    key = child.acts.tobytes() + child.done.tobytes()
                    children[key] = _Node(
                        child.work, child.done, child.row, child.acts, child.way, child.report, end.cost
                    )
            nodes = sorted(children.values(), key=lambda x: x.cost)[:width]
        return Decoded(best.codes, best.makespan_s, best.cost, best.complete, best.certain, decisions, best.refused,
                       best.forced, best.log_p, best.doubt)  # fmt: skip


def _keep(seat: _Seat, cost: float) -> _Node:
    s = seat.s
    n = int(seat.report[dk.D_ACTIONS])
    way = seat.desk.way.copy()
    return _Node(
        clone(s.work), s.turn.done.copy(), s.turn.row.copy(), s.acts[:n].copy(), way,
        seat.report.copy(), cost,
    )  # fmt: skip


def _back(seat: _Seat, node: _Node) -> None:
    s = seat.s
    copy_work(node.work, s.work)
    s.turn.done[:], s.turn.row[:] = node.done, node.row
    s.acts[: len(node.acts)] = node.acts
    seat.desk.way[:] = node.way
    seat.report[:] = node.report


def _best_of(plans: list[Decoded]) -> Decoded:
    best = min(plans, key=lambda x: (x.cost, -len(x.codes)))
    decisions = sum(x.decisions for x in plans)
    return Decoded(best.codes, best.makespan_s, best.cost, best.complete, best.certain, decisions, best.refused,
                   best.forced, best.log_p, best.doubt)  # fmt: skip
