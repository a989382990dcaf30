"""Hypothesis strategies: small problems in any mid-mission state, and action lists of every quality."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import strategies as st

from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem, Uav, Ugv

coordinate = st.integers(0, 60).map(lambda v: v * 100.0)
point = st.tuples(coordinate, coordinate)


@st.composite
def uavs(draw: st.DrawFn, i: int, fresh: bool) -> Uav:
    capacity = draw(st.sampled_from([150e3, 287.7e3]))
    reserve = draw(st.sampled_from([0.0, 0.15]))
    energy = 1.0 if fresh else draw(st.floats(0.05, 1.0))
    return Uav(
        f"uav{i}",
        (0.0, 0.0) if fresh else draw(point),
        energy_j=energy * capacity,
        capacity_j=capacity,
        reserve_j=reserve * capacity,
        speed_mps=draw(st.sampled_from([8.0, 10.0])),
        waiting=draw(st.sampled_from(["landed", "hover"])),
        service_s=draw(st.sampled_from([0.0, 20.0])),
        ready_s=0.0 if fresh else draw(st.sampled_from([0.0, 90.0])),
    )


@st.composite
def ugvs(draw: st.DrawFn, i: int, n_points: int, fresh: bool) -> Ugv:
    docks = draw(st.integers(1, 3))
    constant = draw(st.booleans())
    more: dict[str, object] = {}
    if not fresh:
        more["path_point"] = draw(st.one_of(st.none(), st.integers(0, n_points - 1))) if n_points else None
        more["ready_s"] = draw(st.sampled_from([0.0, 150.0]))
        more["dock_ready_s"] = tuple(draw(st.lists(st.sampled_from([0.0, 50.0, 400.0]), max_size=docks)))
        if draw(st.integers(0, 3)) == 0:
            metres = st.one_of(st.integers(0, 60).map(lambda v: v * 100.0), st.just(math.inf))
            more["distance_to_m"] = tuple(draw(st.lists(metres, min_size=n_points + 1, max_size=n_points + 1)))
    return Ugv(
        f"ugv{i}",
        energy_j=draw(st.sampled_from([36.81e6, 36.81e6, 2e6])),
        idle_w=draw(st.sampled_from([0.0, 100.0])),
        charge_s=300.0 if constant else None,
        charge_w=None if constant else draw(st.sampled_from([500.0, 2000.0])),
        dock_s=draw(st.sampled_from([0.0, 15.0])),
        undock_s=draw(st.sampled_from([0.0, 10.0])),
        docks=docks,
        **more,  # type: ignore[arg-type]
    )


@st.composite
def problems(draw: st.DrawFn, max_tasks: int = 5, fresh: bool | None = None, holes: bool = True) -> Problem:
    fresh = draw(st.booleans()) if fresh is None else fresh
    n_points = draw(st.integers(0, 4))
    points = draw(st.lists(point, min_size=n_points, max_size=n_points))
    tasks = draw(st.lists(point, min_size=0, max_size=max_tasks))
    sites = np.array([*points, (0.0, 0.0)])
    road = 1.2 * np.linalg.norm(sites[:, None] - sites[None], axis=2)
    if holes and n_points and draw(st.integers(0, 3)) == 0:
        cut = draw(st.integers(0, n_points - 1))
        road[cut, :] = road[:, cut] = np.inf
        road[cut, cut] = 0.0
    return Problem(
        depot=(0.0, 0.0),
        tasks=np.array(tasks).reshape(-1, 2),
        path_points=np.array(points).reshape(-1, 2),
        road_distance_m=road,
        uavs=tuple(draw(uavs(i, fresh)) for i in range(draw(st.integers(1, 3)))),
        ugvs=tuple(draw(ugvs(i, n_points, fresh)) for i in range(draw(st.integers(0, 2)))),
        visited=np.array([False if fresh else draw(st.integers(0, 3)) == 0 for _ in tasks], dtype=bool),
    )


@st.composite
def action_lists(draw: st.DrawFn, problem: Problem, max_size: int = 12) -> list[Action]:
    kinds: list[st.SearchStrategy[Action]] = []
    uav = st.integers(0, len(problem.uavs) - 1)
    if problem.n_tasks:
        kinds += [st.builds(Visit, uav, st.integers(0, problem.n_tasks - 1))] * 2
    if problem.ugvs:
        ugv = st.integers(0, len(problem.ugvs) - 1)
        n_points = len(problem.path_points)
        where = st.one_of(st.none(), st.integers(0, n_points - 1)) if n_points else st.none()
        kinds += [st.builds(Recharge, uav, ugv), st.builds(Move, ugv, where)]
    if not kinds:
        return []
    actions = draw(st.lists(st.one_of(kinds), max_size=max_size))
    if draw(st.booleans()):  # a plan that visits every task once
        seen = {m for m in range(problem.n_tasks) if problem.visited[m]}
        kept = []
        for a in actions:
            if isinstance(a, Visit):
                if a.task in seen:
                    continue
                seen.add(a.task)
            kept.append(a)
        actions = kept + [Visit(draw(uav), m) for m in range(problem.n_tasks) if m not in seen]
    return actions
