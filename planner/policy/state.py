"""A plan half made: the arrays that the policy's kernels work on, and how a problem becomes them."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from planner.arrays import arrays_of
from planner.kernel import Codes, Floats, Work, World
from planner.policy.features_kernel import N_PAIR, N_SITE, N_TASK, N_UAV, N_UGV, View, reach_m
from planner.policy.tokens_kernel import DETAILS, Outline, Turn
from planner.problem import Problem

SYMMETRIES = np.array(
    [[[a, 0], [0, b]] for a in (1, -1) for b in (1, -1)] + [[[0, a], [b, 0]] for a in (1, -1) for b in (1, -1)],
    dtype=np.float64,
)  # of the square, (8, 2, 2)


class State(NamedTuple):
    """Everything that decoding one problem needs; members as the kernels take them.

    Attributes:
        world: the problem.
        work: state of all vehicles.
        turn: whose turn it is, and what is offered.
        space: room for the state of another plan.
        xy: positions of nodes, (N + U + G, 2) in m.
        reach: range of each UAV per charge, (U,) in m.
        view: room for what the network sees.
        acts: the plan, (most actions,).
        way: a way to finish it, (most actions,).
    """

    world: World
    work: Work
    turn: Turn
    space: Work
    xy: Floats
    reach: Floats
    view: View
    acts: Codes
    way: Codes


def clone(work: Work) -> Work:
    """A copy of the state of all vehicles."""
    return Work._make(array.copy() for array in work)


def new_view(n_tasks: int, n_sites: int, n_uavs: int, n_ugvs: int) -> View:
    """Room for one decision."""
    f = np.float32
    return View(
        np.zeros((n_tasks, N_TASK), f),
        np.zeros((n_sites, N_SITE), f),
        np.zeros((n_uavs, N_UAV), f),
        np.zeros((n_ugvs, N_UGV), f),
        np.zeros((n_ugvs, n_sites, N_PAIR), f),
        np.zeros((n_sites + n_ugvs, n_sites), f),
        np.zeros(n_tasks, np.int32),
        np.zeros(5, np.int32),
    )


def new_turn(n_tasks: int, n_sites: int, n_uavs: int, n_ugvs: int) -> Turn:
    """Room for whose turn it is and what is offered."""
    return Turn(
        np.zeros(n_uavs, np.uint8),
        np.zeros(n_uavs, np.int32),
        np.zeros(n_tasks, np.uint8),
        np.zeros((n_ugvs, n_sites), np.uint8),
        np.zeros((n_ugvs, n_sites, DETAILS)),
        np.zeros(1, np.uint8),
        np.zeros(1, np.int64),
        np.empty((0, 9)),
        Outline(
            np.zeros((n_uavs, n_tasks + 1), np.int32),
            np.zeros(n_uavs, np.int32),
            np.zeros((n_uavs, 9)),
            np.zeros((n_uavs, 2)),
            np.zeros(n_tasks, np.int32),
            np.full(n_uavs, -1, np.int32),  # no UAV is there: the routes are of no state yet
            np.zeros((n_uavs, 2)),
            np.zeros(n_tasks, np.uint8),
            np.zeros(n_uavs, np.uint8),
        ),
    )


def positions(problem: Problem) -> Floats:
    """Positions of tasks, sites, UAVs' and UGVs' starts, (N + U + G, 2) in m.

    A UGV between path points whose position is not told counts as being at the site that is nearest by road.
    """
    ugvs = np.empty((len(problem.ugvs), 2))
    for i, g in enumerate(problem.ugvs):
        if g.distance_to_m is None:
            ugvs[i] = problem.sites[problem.depot_index if g.path_point is None else g.path_point]
        elif g.position is not None:
            ugvs[i] = g.position
        else:
            ugvs[i] = problem.sites[int(np.argmin(g.distance_to_m))]
    uavs = np.array([u.position for u in problem.uavs], dtype=np.float64)
    return np.concatenate([problem.tasks, problem.sites, uavs, ugvs])


def new_state(problem: Problem, exclude_uavs: Collection[int] = (), exclude_ugvs: Collection[int] = ()) -> State:
    """The arrays for ``problem``; its plan is not begun yet (``tokens_kernel.start``).

    Raises:
        PlannerError: when an excluded vehicle does not exist.
    """
    a = arrays_of(problem)
    world = a.world(exclude_uavs, exclude_ugvs)
    n_tasks, n_sites, n_uavs, n_ugvs = len(a.visited), a.road.shape[1], len(a.uavs), len(a.ugvs)
    size = 4 * n_tasks + 8 * n_uavs + 64
    return State(
        world,
        a.work(),
        new_turn(n_tasks, n_sites, n_uavs, n_ugvs),
        a.work(),
        positions(problem),
        np.array([reach_m(world, u) for u in range(n_uavs)]),
        new_view(n_tasks, n_sites, n_uavs, n_ugvs),
        np.zeros(size, np.int64),
        np.zeros(size, np.int64),
    )
