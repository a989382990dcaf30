"""The paper's eight data sets on our maps: 1,000 instances each, made from their seeds (docs/instances.md).

Instance ``i`` of a data set is drawn from ``numpy.random.default_rng([SEED, tasks, path points, UAVs, UGVs, map, i])``.
It does not depend on other instances: any one is made alone, and indices from 1,000 on give more of the same kind.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.presets import PRESETS, REACH_M, TEAMS
from planner.problem import Problem, Uav, Ugv
from planner.terrain import DEPOTS, Terrain, terrain

SEED = 2026
SIZE = 1_000
TRAIN = range(800)
TEST = range(800, SIZE)
MAPS = tuple(DEPOTS)  # rural is for training, the others only for tests
APART_M = 1_200.0  # least distance between path points that are drawn


@dataclass(frozen=True, slots=True)
class DataSet:
    """One data set: setup, team and map.

    Attributes:
        setup: ``T15-P5`` or ``T45-P10``.
        team: numbers of UAVs and UGVs.
        map_name: ``rural``, ``suburban`` or ``urban``.
        drawn: every instance has path points of its own, drawn from the roads, instead of the map's fixed ones. This
            is not the paper's setup; it gives a learner more variety.
    """

    setup: str
    team: tuple[int, int]
    map_name: str = "rural"
    drawn: bool = False

    def __post_init__(self) -> None:
        if self.setup not in PRESETS:
            raise PlannerError(f"setup {self.setup!r} does not exist; there are {', '.join(PRESETS)}")
        if len(self.team) != 2 or min(self.team) < 0 or self.team[0] < 1:
            raise PlannerError(f"team is {self.team!r}; give the numbers of UAVs (at least 1) and UGVs")
        if self.map_name not in MAPS:
            raise PlannerError(f"map {self.map_name!r} does not exist; there are {', '.join(MAPS)}")

    @property
    def name(self) -> str:
        """Such as ``T15-P5_2-1``; other maps and drawn path points are named, too."""
        more = ("" if self.map_name == "rural" else f"_{self.map_name}") + ("_drawn" if self.drawn else "")
        return f"{self.setup}_{self.team[0]}-{self.team[1]}{more}"

    def seed(self, index: int) -> list[int]:
        """What instance ``index`` is drawn from."""
        return [SEED, *PRESETS[self.setup], *self.team, MAPS.index(self.map_name) + 3 * self.drawn, index]

    def instance(self, index: int) -> Problem:
        """The instance with that index, from 0; about 0.2 ms, and a second for the first one of a map.

        Raises:
            PlannerError: for a negative index.
        """
        if index < 0:
            raise PlannerError(f"instance {index} does not exist; give a number of at least 0")
        n_tasks, n_points = PRESETS[self.setup]
        land = terrain(self.map_name)
        rng = np.random.default_rng(self.seed(index))
        roads = _draw_roads(land, n_points, rng) if self.drawn else land.spread(n_points)
        sites, distance = land.roads_at(roads)
        depot = (float(sites[-1, 0]), float(sites[-1, 1]))
        return Problem(
            depot=depot,
            tasks=draw_tasks(sites, n_tasks, rng, land.side_m),
            path_points=sites[:-1],
            road_distance_m=distance,
            uavs=tuple(Uav(f"uav{i}", depot) for i in range(self.team[0])),
            ugvs=tuple(Ugv(f"ugv{i}") for i in range(self.team[1])),
        )

    def instances(self, indices: range = range(SIZE)) -> Iterator[Problem]:
        """The instances with these indices; ``TRAIN`` and ``TEST`` are the paper's 800 and 200."""
        return (self.instance(i) for i in indices)


DATA_SETS = tuple(DataSet(setup, team) for setup in PRESETS for team in TEAMS)


def data_set(name: str) -> DataSet:
    """The data set with that name, on any map.

    Raises:
        PlannerError: for an unknown name.
    """
    every = [DataSet(s, t, m, d) for s in PRESETS for t in TEAMS for m in MAPS for d in (False, True)]
    found = {one.name: one for one in every}
    if name not in found:
        raise PlannerError(f"data set {name!r} does not exist; there are {', '.join(x.name for x in DATA_SETS)}")
    return found[name]


def draw_tasks(sites: NDArray[np.float64], count: int, rng: np.random.Generator, side_m: float) -> NDArray[np.float64]:
    """Uniform task points that lie within ``REACH_M`` of a site, (count, 2) in m."""
    tasks = np.empty((0, 2))
    while len(tasks) < count:
        drawn = rng.uniform(0.0, side_m, (count, 2))
        away = np.linalg.norm(drawn[:, None] - sites[None], axis=2).min(axis=1)
        tasks = np.vstack([tasks, drawn[away <= REACH_M]])[:count]
    return tasks


def _draw_roads(land: Terrain, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Random roads, their centres apart from each other and from the depot where that works."""
    while True:
        chosen: list[int] = []
        for road in rng.permutation(len(land.roads)).tolist():
            others = land.network.sites[[*chosen, len(land.roads)]]
            if np.linalg.norm(others - land.network.sites[road], axis=1).min() >= APART_M:
                chosen.append(road)
            if len(chosen) == count:
                return np.array(sorted(chosen), dtype=np.int64)
