"""A problem and its actions as plain arrays, as the compiled evaluator and search take them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from planner import kernel
from planner.errors import PlannerError
from planner.kernel import Codes, Flags, Floats, Ints, Work, World
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem

MAX_COUNT = 4096  # an action packs the vehicle and its target into 12 bits each


@dataclass(frozen=True, slots=True)
class Arrays:
    """A problem for the kernels; see ``planner.kernel.World``. ``near_site`` is the index of the nearest site."""

    dist: Floats
    near: Floats
    near_site: NDArray[np.intp]
    road: Floats
    uavs: Floats
    ugvs: Floats
    site0: Ints
    docks0: Floats
    visited: Flags

    def world(self, exclude_uavs: Collection[int] = (), exclude_ugvs: Collection[int] = ()) -> World:
        """The problem without the excluded vehicles.

        Raises:
            PlannerError: when an excluded vehicle does not exist.
        """
        return World(
            self.dist,
            self.near,
            self.road,
            self.uavs,
            self.ugvs,
            self.site0,
            self.docks0,
            self.visited,
            switched_on("uav", len(self.uavs), exclude_uavs),
            switched_on("ugv", len(self.ugvs), exclude_ugvs),
        )

    def work(self, *, unique: bool = False) -> Work:
        """Fresh work space; with ``unique`` the caller vouches that no plan visits a task twice."""
        return new_work(self.world(), unique=unique)


def new_work(world: World, *, unique: bool = False) -> Work:
    """Fresh work space; with ``unique`` the caller vouches that no plan visits a task twice."""
    n_uavs, n_ugvs = len(world.uavs), len(world.ugvs)
    return Work(
        np.empty(n_uavs, np.int32),
        np.empty((n_uavs, 2)),
        np.empty(n_ugvs, np.int32),
        np.empty((n_ugvs, 4)),
        np.empty(world.docks0.shape),
        np.empty(0 if unique else len(world.visited), np.uint8),
        np.empty(kernel.SUMS_SIZE),
        np.empty(kernel.OUT_SIZE),
    )


_CACHE: WeakKeyDictionary[Problem, Arrays] = WeakKeyDictionary()


def arrays_of(problem: Problem) -> Arrays:
    """The arrays of ``problem``, made once per problem (about 0.1 ms for 6 vehicles and 15 tasks)."""
    found = _CACHE.get(problem)
    if found is None:
        found = _CACHE[problem] = _make(problem)
    return found


def _make(problem: Problem) -> Arrays:
    tasks, sites, uavs, ugvs = problem.tasks, problem.sites, problem.uavs, problem.ugvs
    if max(len(tasks), len(sites) + len(ugvs), len(uavs)) >= MAX_COUNT:
        raise PlannerError(f"the problem is too large: at most {MAX_COUNT - 1} tasks, path points and vehicles each")
    n_tasks, n_sites = len(tasks), len(sites)
    nodes = np.concatenate([tasks, sites, np.array([u.position for u in uavs], dtype=np.float64)])
    step = nodes[:, None, :] - nodes[None, : n_tasks + n_sites, :]
    dist = np.sqrt(step[..., 0] ** 2 + step[..., 1] ** 2)
    to_sites = dist[:, n_tasks:]
    near_site = to_sites.argmin(axis=1)
    road = np.empty((n_sites + len(ugvs), n_sites))
    road[:n_sites] = problem.road_distance_m
    site0 = np.empty(len(ugvs), np.int32)
    docks0 = np.full((len(ugvs), max((g.docks for g in ugvs), default=1)), np.inf)
    for i, g in enumerate(ugvs):
        at = n_sites - 1 if g.path_point is None else g.path_point
        site0[i] = at if g.distance_to_m is None else n_sites + i
        road[n_sites + i] = problem.road_distance_m[at] if g.distance_to_m is None else g.distance_to_m
        docks0[i, : g.docks] = 0.0
        docks0[i, : len(g.dock_ready_s)] = g.dock_ready_s
    uav_rows = [
        (
            u.energy_j,
            u.capacity_j,
            u.reserve_j,
            u.speed_mps,
            u.cruise_w,
            u.hover_w,
            u.hover_w if u.waiting == "hover" else 0.0,
            u.service_s,
            u.ready_s,
        )
        for u in uavs
    ]
    ugv_rows = [
        (
            g.energy_j,
            g.speed_mps,
            g.drive_w,
            g.idle_w,
            g.charge_s or 0.0,
            g.charge_w or 0.0,
            g.dock_s,
            g.undock_s,
            g.ready_s,
        )
        for g in ugvs
    ]
    return Arrays(
        dist=np.ascontiguousarray(dist),
        near=np.ascontiguousarray(to_sites.min(axis=1)),
        near_site=near_site,
        road=road,
        uavs=np.array(uav_rows, dtype=np.float64),
        ugvs=np.array(ugv_rows, dtype=np.float64).reshape(-1, 9),
        site0=site0,
        docks0=docks0,
        visited=problem.visited.astype(np.uint8),
    )


def encode(problem: Problem, actions: Sequence[Action]) -> Codes:
    """The actions as the kernels take them, (n,).

    Raises:
        PlannerError: when an action names a task, path point or vehicle that does not exist.
    """
    return np.array([_code(problem, i, act) for i, act in enumerate(actions)], dtype=np.int64)


def encode_meets(problem: Problem, actions: Sequence[Action]) -> Codes:
    """The actions as visits and meetings (``kernel.MEET``), (n,); moves to where nobody recharges are left out.

    A recharge at a UGV that is between path points is left out, too: there is no place to meet.

    Raises:
        PlannerError: as ``encode``.
    """
    n_sites = len(problem.sites)
    site = arrays_of(problem).site0.tolist()
    codes = []
    for i, act in enumerate(actions):
        code = _code(problem, i, act)
        if isinstance(act, Move):
            site[act.ugv] = code & kernel.MASK
            continue
        if isinstance(act, Recharge):
            if site[act.ugv] >= n_sites:
                continue
            code = meet(act.uav, act.ugv, site[act.ugv])
        codes.append(code)
    return np.array(codes, dtype=np.int64)


def meet(uav: int, ugv: int, site: int) -> int:
    """The code of a meeting."""
    return kernel.MEET << kernel.KIND | uav << kernel.VEHICLE | site << kernel.SITE | ugv


def _code(problem: Problem, i: int, act: Action) -> int:
    n_points, n_uavs, n_ugvs = len(problem.path_points), len(problem.uavs), len(problem.ugvs)
    if isinstance(act, Visit):
        _exists(i, "uav", act.uav, n_uavs)
        _exists(i, "task", act.task, len(problem.tasks))
        return kernel.VISIT << kernel.KIND | act.uav << kernel.VEHICLE | act.task
    if isinstance(act, Recharge):
        _exists(i, "uav", act.uav, n_uavs)
        _exists(i, "ugv", act.ugv, n_ugvs)
        return kernel.RECHARGE << kernel.KIND | act.uav << kernel.VEHICLE | act.ugv
    if isinstance(act, Move):
        _exists(i, "ugv", act.ugv, n_ugvs)
        point = n_points
        if act.path_point is not None:
            point = act.path_point
            _exists(i, "path point", point, n_points)
        return kernel.MOVE << kernel.KIND | act.ugv << kernel.VEHICLE | point
    raise PlannerError(f"actions[{i}] is {act!r}; give a Visit, Move or Recharge")


def _exists(action: int, what: str, index: int, count: int) -> None:
    if not 0 <= index < count:
        raise PlannerError(f"actions[{action}]: {what} {index} does not exist; there are {count}")


def decode(problem: Problem, codes: Codes) -> tuple[Action, ...]:
    """The actions that ``codes`` stand for; a meeting is a recharge, after a move where the UGV is elsewhere."""
    actions: list[Action] = []
    site = arrays_of(problem).site0.tolist()
    for code in codes.tolist():
        kind, vehicle, target = code >> kernel.KIND, code >> kernel.VEHICLE & kernel.MASK, code & kernel.MASK
        if kind == kernel.VISIT:
            actions.append(Visit(vehicle, target))
        elif kind == kernel.RECHARGE:
            actions.append(Recharge(vehicle, target))
        elif kind == kernel.MOVE:
            actions.append(_move(problem, vehicle, target))
            site[vehicle] = target
        else:
            where = code >> kernel.SITE & kernel.MASK
            if site[target] != where:
                actions.append(_move(problem, target, where))
                site[target] = where
            actions.append(Recharge(vehicle, target))
    return tuple(actions)


def _move(problem: Problem, ugv: int, site: int) -> Move:
    return Move(ugv, None if site == problem.depot_index else site)


def switched_on(what: str, count: int, excluded: Collection[int]) -> NDArray[np.uint8]:
    """One flag per vehicle, 0 where it is excluded, (count,).

    Raises:
        PlannerError: when an excluded vehicle does not exist.
    """
    flags = np.ones(count, np.uint8)
    for index in excluded:
        if not 0 <= index < count:
            raise PlannerError(f"excluded {what} {index} does not exist; there are {count}")
        flags[index] = 0
    return flags
