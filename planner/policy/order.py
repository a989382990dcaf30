"""An expert's plan as the decoder would have said it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planner import kernel
from planner.arrays import encode_meets
from planner.errors import PlannerError
from planner.kernel import Codes
from planner.plan import Action
from planner.policy.features_kernel import Singles
from planner.policy.replay_kernel import replay
from planner.policy.state import State, new_state
from planner.problem import Problem


@dataclass(frozen=True, slots=True)
class Told:
    """A plan in the decoder's order.

    Attributes:
        options: the choices, numbered as in ``tokens_kernel``, (decisions,).
        codes: the actions, without ``done``, (n,).
        makespan_s: of the plan in this order; UGVs serve UAVs in the order of decisions, so it can differ.
        feasible: whether it is feasible in this order.
    """

    options: kernel.Ints
    codes: Codes
    makespan_s: float
    feasible: bool


def useful(codes: Codes) -> Codes:
    """The actions without any UAV's meetings after its last visit, which serve nothing."""
    visits = set()
    keep = []
    for code in codes.tolist()[::-1]:
        uav = code >> kernel.VEHICLE & kernel.MASK
        if code >> kernel.KIND == kernel.VISIT:
            visits.add(uav)
        if uav in visits:
            keep.append(code)
    return np.array(keep[::-1], dtype=np.int64)


def in_turns(problem: Problem, actions: Sequence[Action], state: State | None = None) -> Told:
    """``actions`` in the order in which UAVs become ready.

    Raises:
        PlannerError: where the plan does something that the decoder is not offered.
    """
    s = state or new_state(problem)
    codes = useful(encode_meets(problem, actions))
    size = len(codes) + len(problem.uavs)
    options, order = np.zeros((size, len(problem.uavs)), np.int32), np.zeros(size, np.int64)
    none = _nothing()
    n = replay(s.world, s.work, s.turn, s.xy, s.reach, codes, 0.0, options, order, *none, 0)
    if n < 0:
        raise PlannerError("the plan does something that the decoder is not offered")
    kernel.total(s.world, s.work)
    out = s.work.out
    return Told(
        options[:n, 0], order[:n][order[:n] >= 0], float(out[kernel.O_MAKESPAN]), out[kernel.O_CODE] == kernel.OK
    )


def _nothing() -> tuple[Singles, Singles, Singles, Singles, Singles, Singles, kernel.Ints, kernel.Ints]:
    f = np.float32
    three = np.zeros((0, 0, 0), f)
    return (three, three, three, three, np.zeros((0, 0, 0, 0), f), three, np.zeros((0, 0), np.int32),
            np.zeros((0, 0), np.int32))  # fmt: skip
