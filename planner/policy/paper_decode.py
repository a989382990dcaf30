"""Plans by the paper's network (or its MLP baseline): greedy, equation (11), over what is offered. No torch.

As with network ``plus``, an action is taken only where a way to serve all that is left is known behind it
(``complete_kernel``), so a plan is feasible wherever such a way was known from the start.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner import kernel
from planner.errors import PlannerError
from planner.kernel import Work
from planner.plan import Move, Recharge, Visit
from planner.policy import tokens_kernel as tk
from planner.policy.complete_kernel import complete, copy_work
from planner.policy.config import PaperConfig
from planner.policy.decode import Decoded
from planner.policy.decode_kernel import cost_of
from planner.policy.graph import fits, graph, index_of, n_actions, nothing, numbering, renumbered, sizes
from planner.policy.paper_kernel import offer_all, say
from planner.policy.paper_numpy import PaperModel
from planner.policy.state import clone, new_state
from planner.policy.weights import Tensors, read
from planner.problem import Problem


class PaperPolicy:
    """The paper's network with its weights, for problems of one data set's sizes."""

    def __init__(self, config: PaperConfig, tensors: Tensors) -> None:
        """Takes the weights as ``state_dict`` names them.

        Raises:
            PlannerError: where they do not fit ``config``.
        """
        self.config = config
        try:
            self.model = PaperModel(config, tensors)
            logits = self.model.begin(self.model.encode(nothing(config))).next(None)
        except (KeyError, ValueError, IndexError) as error:
            raise PlannerError(f"weights of network paper: they do not fit its sizes: {error}") from error
        if len(logits) != n_actions(config):
            raise PlannerError(f"weights of network paper: {len(logits)} actions; it should be {n_actions(config)}")

    @classmethod
    def load(cls, path: Path, sha256: str | None = None) -> PaperPolicy:
        """Reads a weights file.

        Raises:
            PlannerError: where it is missing, damaged, or no network of this kind.
        """
        config, tensors, _ = read(path, sha256)
        if not isinstance(config, PaperConfig):
            raise PlannerError(f"{path}: this is no network paper")
        try:
            return cls(config, tensors)
        except PlannerError as error:
            raise PlannerError(f"{path}: {error}") from error

    def outside(self, problem: Problem) -> str | None:
        """In which respect the problem is unlike those that the network can plan for, in words; None where it can."""
        return None if fits(problem, self.config) else f"its data set has {sizes(self.config)}"

    def _number(self, code: int, work: Work) -> int:
        """The number of a way's next action in the list of actions."""
        vehicle, target = code >> kernel.VEHICLE & kernel.MASK, code & kernel.MASK
        if code >> kernel.KIND == kernel.VISIT:
            return index_of(Visit(vehicle, target), self.config)
        site = code >> kernel.SITE & kernel.MASK
        if work.site[target] == site:
            return index_of(Recharge(vehicle, target), self.config)
        return index_of(Move(target, None if site == self.config.n_points else site), self.config)

    def greedy(
        self, problem: Problem, *, exclude_uavs: Collection[int] = (), exclude_ugvs: Collection[int] = ()
    ) -> Decoded:
        """The most probable action at each step.

        Args:
            problem: the problem.
            exclude_uavs: indices of UAVs that take no part; the network sees them all the same.
            exclude_ugvs: likewise of UGVs.

        Raises:
            PlannerError: where the problem's sizes are not the network's, or an excluded vehicle does not exist.
        """
        if not self.config.by_place or not fits(problem, self.config):
            return self._greedy(problem, exclude_uavs, exclude_ugvs)
        order = numbering(problem)
        found = self._greedy(renumbered(problem, order), exclude_uavs, exclude_ugvs)
        codes = found.codes.copy()
        visits = codes >> kernel.KIND == kernel.VISIT
        codes[visits] += order[codes[visits] & kernel.MASK] - (codes[visits] & kernel.MASK)
        return replace(found, codes=codes)

    def _greedy(self, problem: Problem, exclude_uavs: Collection[int], exclude_ugvs: Collection[int]) -> Decoded:
        saying = self.model.begin(self.model.encode(graph(problem, self.config)))
        s = new_state(problem, exclude_uavs, exclude_ugvs)
        world, work, turn = s.world, s.work, s.turn
        tk.start(world, work, turn)
        before = clone(work)
        moved, offered = np.zeros(len(world.ugvs), np.uint8), np.zeros(len(self.model.w["out.weight"]), np.uint8)
        hint, spare = np.zeros(2, np.int64), np.zeros_like(s.way)
        found = complete(world, work, s.space, turn, hint, s.way)
        sure = known = found >= 0
        way = s.way[: max(found, 0)].tolist()
        codes: list[int] = []
        last: int | None = None
        refused = forced = chosen = decisions = 0
        log_p, doubt = 0.0, 1.0
        while work.sums[kernel.S_LEFT] > 0 and len(codes) < self.config.most:
            logits = saying.next(last)
            decisions += 1
            offer_all(world, work, turn, moved, offered)
            logits = np.where(offered != 0, logits, np.float32(-1e9))
            total = float(logits.max()) + math.log(float(np.exp(logits - logits.max()).sum()))
            copy_work(work, before)
            kept = turn.row.copy(), moved.copy()
            while (value := float(logits[last := int(logits.argmax())])) > -1e8:
                code = say(world, work, turn, moved, last)
                found = complete(world, work, s.space, turn, hint, spare)
                if found >= 0 or not known:
                    known = found >= 0
                    way = spare[: max(found, 0)].tolist()
                    codes.append(code)
                    chosen += 1
                    log_p += value - total
                    doubt = min(doubt, math.exp(value - total))
                    break
                refused += 1
                copy_work(before, work)
                turn.row[:], moved[:] = kept
                logits[last] = -1e9
            else:
                if not known:
                    break
                forced += 1
                # The way's next action, as the paper's list has it: a move first, where the UGV is elsewhere.
                last = self._number(way[0], work)
                code = say(world, work, turn, moved, last)
                codes.append(code)
                if code >> kernel.KIND != kernel.MOVE:
                    way.pop(0)
        kernel.total(world, work)
        cost = cost_of(work.out)
        return Decoded(
            np.array(codes, dtype=np.int64), float(work.out[kernel.O_MAKESPAN]), cost, cost < math.inf, sure,
            decisions, refused, forced, chosen, log_p, doubt,
        )  # fmt: skip
