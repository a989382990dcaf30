"""The paper's graph G = {T, E^intra, E^uav, E^ugv} and its list of actions (section "Approach", problem definition).

A data set fixes the numbers of tasks, path points, UAVs and UGVs, and so the list of actions and the size of a UGV's
feature: [own position, positions of all UAVs in order of index]. A team of another size needs another network; ``plus``
has no such limit, as each UAV is a node there that UGVs attend to. The depot is a path point, the last one. Positions
are relative to the middle of all tasks and sites, in units of the larger side of their bounding box; energy is a share
of the capacity.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.plan import Action, Move, Recharge, Visit
from planner.policy.config import PaperConfig
from planner.policy.state import positions
from planner.problem import Problem

Singles = NDArray[np.float32]
TASK, POINT, UAV, UGV = range(4)


class Graph(NamedTuple):
    """Node attributes t and edges of one problem, or with a first axis of several; N = M + S + U + G nodes.

    Attributes:
        task: [x, y, visited], (M, 3).
        point: [x, y], (S, 2).
        uav: [x, y, energy], (U, 3).
        ugv: [x, y, positions of the UAVs], (G, 2 + 2 U).
        intra: edges between nodes of one type, (N, N) bool: row i receives from column j.
        uav_edges: to UAVs from tasks and UGVs, (N, N) bool.
        ugv_edges: to UGVs from UAVs and path points, never from tasks, (N, N) bool.
    """

    task: Singles
    point: Singles
    uav: Singles
    ugv: Singles
    intra: NDArray[np.bool_]
    uav_edges: NDArray[np.bool_]
    ugv_edges: NDArray[np.bool_]


def fits(problem: Problem, config: PaperConfig) -> bool:
    """Whether a problem has the sizes of the network's data set."""
    mine = (problem.n_tasks, len(problem.path_points), len(problem.uavs), len(problem.ugvs))
    return mine == (config.n_tasks, config.n_points, config.n_uavs, config.n_ugvs)


def sizes(config: PaperConfig) -> str:
    """The sizes of the network's data set, in words."""
    c = config
    return f"{c.n_tasks} tasks, {c.n_points} path points, {c.n_uavs} UAVs and {c.n_ugvs} UGVs"


def numbering(problem: Problem) -> NDArray[np.int64]:
    """Tasks in order of place, (M,): strips from west to east of about as many tasks each, up and down in turn."""
    n = problem.n_tasks
    strips = max(1, round(n**0.5))
    order: list[int] = []
    for k, strip in enumerate(np.array_split(np.argsort(problem.tasks[:, 0], kind="stable"), strips)):
        north = np.argsort(problem.tasks[strip, 1], kind="stable")
        order += strip[north if k % 2 == 0 else north[::-1]].tolist()
    return np.array(order, dtype=np.int64)


def renumbered(problem: Problem, order: NDArray[np.int64]) -> Problem:
    """The problem with task ``order[k]`` as its ``k``-th."""
    return replace(problem, tasks=problem.tasks[order], visited=problem.visited[order])


def graph(problem: Problem, config: PaperConfig, turn: NDArray[np.float64] | None = None) -> Graph:
    """The graph of a problem; ``turn`` is a symmetry of the square, (2, 2).

    Raises:
        PlannerError: where the problem's sizes are not those of the network's data set.
    """
    if not fits(problem, config):
        raise PlannerError(f"this network plans for {sizes(config)} only; use network plus, or method search")
    xy = positions(problem)
    m, s, u = problem.n_tasks, len(problem.sites), len(problem.uavs)
    low, high = xy[: m + s].min(axis=0), xy[: m + s].max(axis=0)
    xy = (xy - 0.5 * (low + high)) / max(1.0, float((high - low).max()))
    if turn is not None:
        xy = xy @ turn
    uavs, ugvs = xy[m + s : m + s + u], xy[m + s + u :]
    energy = np.array([[v.energy_j / v.capacity_j] for v in problem.uavs])
    kind = np.repeat(np.arange(4), [m, s, u, len(ugvs)])
    close = np.linalg.norm(xy[:, None] - xy[None], axis=2) <= config.radius
    to, of = kind[:, None], kind[None, :]
    f = np.float32
    return Graph(
        np.hstack([xy[:m], problem.visited[:, None]]).astype(f),
        xy[m : m + s].astype(f),
        np.hstack([uavs, energy]).astype(f),
        np.hstack([ugvs, np.broadcast_to(uavs.ravel(), (len(ugvs), 2 * u))]).astype(f),
        close & (to == of),
        close & (to == UAV) & ((of == TASK) | (of == UGV)) & config.uav_edges,
        close & (to == UGV) & ((of == UAV) | (of == POINT)) & config.ugv_edges,
    )


def nothing(config: PaperConfig) -> Graph:
    """A graph of the network's sizes with zeros for attributes and no edges."""
    m, s, u, g = config.n_tasks, config.n_points + 1, config.n_uavs, config.n_ugvs
    f, none = np.float32, np.zeros((m + s + u + g, m + s + u + g), np.bool_)
    return Graph(np.zeros((m, 3), f), np.zeros((s, 2), f), np.zeros((u, 3), f), np.zeros((g, 2 + 2 * u), f),
                 none, none, none)  # fmt: skip


def n_actions(config: PaperConfig) -> int:
    """Size of the list of actions: A^uav (U x M), A^ugv (G x (P + 1)), A^recharge (U x G)."""
    u, g = config.n_uavs, config.n_ugvs
    return u * config.n_tasks + g * (config.n_points + 1) + u * g


def index_of(action: Action, config: PaperConfig) -> int:
    """An action's number in the list."""
    m, s, u, g = config.n_tasks, config.n_points + 1, config.n_uavs, config.n_ugvs
    if isinstance(action, Visit):
        return action.uav * m + action.task
    if isinstance(action, Move):
        return u * m + action.ugv * s + (s - 1 if action.path_point is None else action.path_point)
    return u * m + g * s + action.uav * g + action.ugv


def action_of(index: int, config: PaperConfig) -> Action:
    """The action with that number."""
    m, s, u, g = config.n_tasks, config.n_points + 1, config.n_uavs, config.n_ugvs
    if index < u * m:
        return Visit(index // m, index % m)
    index -= u * m
    if index < g * s:
        point = index % s
        return Move(index // s, None if point == s - 1 else point)
    index -= g * s
    return Recharge(index // g, index % g)


def spoken(actions: tuple[Action, ...]) -> list[Action]:
    """The actions without moves that nobody recharges after, and recharges after a UAV's last visit."""
    kept: list[Action] = []
    visits: set[int] = set()
    needed: set[int] = set()
    for act in reversed(actions):
        if isinstance(act, Visit):
            visits.add(act.uav)
        elif isinstance(act, Recharge):
            if act.uav not in visits:
                continue
            needed.add(act.ugv)
        elif act.ugv in needed:
            needed.discard(act.ugv)
        else:
            continue
        kept.append(act)
    return kept[::-1]
