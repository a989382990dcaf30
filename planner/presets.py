"""Random instances of the paper's setups ``T15-P5`` and ``T45-P10`` (design section 2; paper, section V-A)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.problem import Problem, Uav, Ugv
from planner.roads import Roads

SIDE_M = 10_000.0
REACH_M = 6_500.0
DEPOT = (5_000.0, 0.0)
PRESETS: dict[str, tuple[int, int]] = {"T15-P5": (15, 5), "T45-P10": (45, 10)}  # tasks, path points
TEAMS = ((1, 1), (2, 1), (2, 2), (4, 2))  # UAVs, UGVs


def preset(
    name: str,
    team: tuple[int, int] = (2, 2),
    seed: int = 0,
    roads: Roads | None = None,
    uav: dict[str, Any] | None = None,
    ugv: dict[str, Any] | None = None,
) -> Problem:
    """A random instance: 10 km x 10 km, all vehicles full at one depot, tasks uniform within reach of a site.

    Args:
        name: ``T15-P5`` or ``T45-P10``.
        team: number of UAVs and UGVs.
        seed: of the tasks and, where ``roads`` is None, of the path points and roads.
        roads: path points and depot with their road distances; None draws a random connected network.
        uav: other values for every UAV (members of ``Uav``).
        ugv: other values for every UGV (members of ``Ugv``).

    Raises:
        PlannerError: for an unknown name, or roads with another number of path points.
    """
    if name not in PRESETS:
        raise PlannerError(f"preset {name!r} does not exist; there are {', '.join(PRESETS)}")
    n_tasks, n_points = PRESETS[name]
    rng = np.random.default_rng(seed)
    if roads is None:
        sites, distance = random_roads(n_points, rng)
    else:
        sites, distance = np.asarray(roads.sites, dtype=np.float64), np.asarray(roads.distance_m, dtype=np.float64)
        if len(sites) != n_points + 1:
            raise PlannerError(f"preset {name} has {n_points} path points, the roads have {len(sites) - 1}")
    tasks = np.empty((0, 2))
    while len(tasks) < n_tasks:
        drawn = rng.uniform(0.0, SIDE_M, (n_tasks, 2))
        away = np.linalg.norm(drawn[:, None] - sites[None], axis=2).min(axis=1)
        tasks = np.vstack([tasks, drawn[away <= REACH_M]])[:n_tasks]
    depot = (float(sites[-1, 0]), float(sites[-1, 1]))
    problem = Problem(
        depot=depot,
        tasks=tasks,
        path_points=sites[:-1],
        road_distance_m=distance,
        uavs=tuple(Uav(f"uav{i}", depot) for i in range(team[0])),
        ugvs=tuple(Ugv(f"ugv{i}") for i in range(team[1])),
    )
    return replace(
        problem,
        uavs=tuple(replace(u, **(uav or {})) for u in problem.uavs),
        ugvs=tuple(replace(g, **(ugv or {})) for g in problem.ugvs),
    )


def random_roads(
    n_points: int, rng: np.random.Generator, side_m: float = SIDE_M
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Uniform path points on a connected network of straight roads: a spanning tree and each site's nearest two.

    Returns:
        Sites, (n_points + 1, 2) with the depot last, and their shortest road distances, (n_points + 1, n_points + 1).
    """
    sites = np.vstack([rng.uniform(0.0, side_m, (n_points, 2)), np.array(DEPOT) * side_m / SIDE_M])
    straight = np.linalg.norm(sites[:, None] - sites[None], axis=2)
    road = np.full_like(straight, np.inf)
    np.fill_diagonal(road, 0.0)
    joined = [n_points]
    while len(joined) <= n_points:  # Prim's spanning tree
        rest = [i for i in range(n_points) if i not in joined]
        a, b = min(((i, j) for i in joined for j in rest), key=lambda pair: float(straight[pair]))
        road[a, b] = road[b, a] = straight[a, b]
        joined.append(b)
    for i in range(n_points + 1):
        for j in np.argsort(straight[i])[1:3]:
            road[i, j] = road[j, i] = straight[i, j]
    for k in range(n_points + 1):  # Floyd and Warshall's shortest paths
        road = np.minimum(road, road[:, k, None] + road[None, k, :])
    return sites, road
