"""Depot, path points and tasks of a mission, moved onto the roads and checked one by one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import shapely

from deploy.frames import Frame, Vec2
from deploy.maps import Array, LoadedMap, Region, Source, Ways
from deploy.mission_model import MissionConfig
from deploy.mission_points import draw_tasks, place_path_points, read_points, resolve
from deploy.mission_slots import Slots, best_turn
from deploy.settings import beside
from deploy.yaml_file import Document, KeyPath


@dataclass(frozen=True, eq=False)
class Sites:
    """Where things are.

    Attributes:
        ways: roads between path points and, last, the depot.
        tasks: (n_tasks, 2) in world m.
        task_names: as the file names them, else their numbers.
        slots: turned to fit the roads at the sites.
        beside: as in ``Settings``: on a road network the places at a site lie beside the road.
        sources: files read.
    """

    ways: Ways
    tasks: Array
    task_names: tuple[str, ...]
    slots: Slots
    beside: tuple[tuple[float, float], ...]
    sources: tuple[Source, ...]


ASIDE_STEPS = 10
ASIDE_TURNS = 32

RegionOf = Callable[[float], Region]


@dataclass(frozen=True, eq=False)
class SiteMaker:
    """What is needed to find the sites.

    Attributes:
        region: where things with a margin (arena m) may be.
        clear_m: how far from the middle of any road places must lie so that the lanes stay free, arena m.
    """

    config: MissionConfig
    document: Document
    map_: LoadedMap
    frame: Frame
    slots: Slots
    region: RegionOf
    clear_m: float = 0.0

    def make(self) -> Sites:
        """All sites.

        Raises:
            InputError: naming the point that cannot be, why, and the remedy.
        """
        metric = self.config.map.coordinates == "metric" or self.map_.project is None
        depot = resolve([self.config.depot], self.map_, self.document.path, "depot")
        ways = self.map_.make_ways(depot)
        self._check_site(depot[0], ways.sites[0], ("depot",), "the depot")
        points, point_source, point_keys = self._path_points(ways, metric)
        ways = ways.with_sites(np.vstack([points, depot]))
        for i, (given, snapped) in enumerate(zip(points, ways.sites[:-1], strict=True)):
            self._check_site(given, snapped, point_keys(i), f"path point {i}")
            if not np.isfinite(ways.distance_m[i, -1]):
                what = (
                    f"path point {i} at {_at(given)} cannot be reached by road from the depot; move it, or join roads"
                )
                raise self.document.error(what, point_keys(i))
        network = self.map_.geometry.image is None
        slots = self.slots if network else best_turn(self.slots, lambda offset: self._off_road_m(ways, offset))
        aside = tuple(self._aside(ways, site, slots) for site in ways.sites) if network else ()
        self._check_parks(ways, slots, point_keys)
        self._check_spacing(ways.sites, slots, aside, point_keys)
        tasks, names, task_source, task_keys = self._tasks(ways.sites, metric)
        self._check_tasks(tasks, names, ways.sites, task_keys)
        return Sites(ways, tasks, names, slots, aside, tuple(s for s in (point_source, task_source) if s is not None))

    def _file(self, name: str) -> Path:
        return self.document.path.parent / name

    def _path_points(self, ways: Ways, metric: bool) -> tuple[Array, Source | None, Callable[[int], KeyPath]]:
        section = self.config.path_points
        if section.points is not None:
            points = resolve(section.points, self.map_, self.document.path, "path_points.points")
            return points, None, lambda i: ("path_points", "points", i)
        if section.file is not None:
            points, _, source = read_points(self._file(section.file), "path_points", self.map_, metric)
            return points, source, lambda _: ("path_points", "file")
        assert section.place is not None
        region = self.region(self.slots.reach_m)
        x0, y0, x1, y1 = region.bounds
        candidates = ways.places(max(x1 - x0, y1 - y0) / 60)
        candidates = candidates[shapely.contains_xy(region, candidates[:, 0], candidates[:, 1])]
        reached = [bool(np.isfinite(ways.distances_from((float(x), float(y)))[0])) for x, y in candidates]
        candidates = candidates[np.array(reached, dtype=np.bool_)]
        separation = self.config.separation
        spacing = (2 * self.slots.reach_m + separation.horizontal_m + separation.buffer_m) / self.frame.scale
        candidates = candidates[np.hypot(*(candidates - ways.sites[0]).T) >= spacing]
        try:
            points = place_path_points(section.place, candidates, region, spacing)
        except ValueError as error:
            raise self.document.error(f"{error}; place fewer", ("path_points", "place")) from None
        return points, None, lambda _: ("path_points", "place")

    def _tasks(
        self, sites: Array, metric: bool
    ) -> tuple[Array, tuple[str, ...], Source | None, Callable[[int], KeyPath]]:
        section = self.config.tasks
        if section.points is not None:
            tasks = resolve(section.points, self.map_, self.document.path, "tasks.points")
            return tasks, _numbers(tasks), None, lambda i: ("tasks", "points", i)
        if section.file is not None:
            tasks, names, source = read_points(self._file(section.file), "tasks", self.map_, metric)
            return tasks, names, source, lambda _: ("tasks", "file")
        assert section.random is not None
        region = self.region(0.0)
        seed = section.random.seed if section.random.seed is not None else self.config.seed
        try:
            tasks = draw_tasks(section.random.count, seed, region, sites, section.max_distance_m)
        except ValueError as error:
            raise self.document.error(f"{error}; draw fewer or allow more", ("tasks", "random")) from None
        return tasks, _numbers(tasks), None, lambda _: ("tasks", "random")

    def _check_site(self, given: Array, snapped: Array, key: KeyPath, what: str) -> None:
        limit = self.config.map.max_offset_m
        x0, y0, x1, y1 = self.map_.geometry.bounds
        if not (x0 <= given[0] <= x1 and y0 <= given[1] <= y1):
            box = f"x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m"
            raise self.document.error(f"{what} at {_at(given)} is outside the map ({box}); move it", key)
        away = float(np.hypot(*(snapped - given)))
        if away > limit:
            text = f"{what} at {_at(given)} is {away:.4g} m from the nearest road, map.max_offset_m allows {limit:g} m"
            raise self.document.error(f"{text}; move it to a road", key)
        if not shapely.covers(self.region(self.slots.reach_m), shapely.Point(snapped)):
            text = (
                f"{what} at {_at(given)} lies outside the geofence or too close to it: places to land and stop reach "
                f"{self.slots.reach_m:.3g} m (arena) around it, within arena.soft_margin_m; move it or widen the fence"
            )
            raise self.document.error(text, key)

    def _off_road_m(self, ways: Ways, offset: Vec2) -> float:
        """Worst distance from the road (arena m) of the place with this offset, over all sites."""
        return max(ways.offset_m(self._place(site, offset)) for site in ways.sites) * self.frame.scale

    def _aside(self, ways: Ways, site: Array, slots: Slots) -> tuple[float, float]:
        """How far and into which direction the places at a site must be moved to leave every lane free."""
        clear_m = self.clear_m
        best = (0.0, 0.0, 0.0)
        for step in range(ASIDE_STEPS + 1):
            away_m = step * clear_m / 2
            for turn in range(ASIDE_TURNS):
                direction = 2 * math.pi * turn / ASIDE_TURNS
                free_m = min(
                    ways.offset_m(self._place(site, beside(place, away_m, direction))) * self.frame.scale
                    for place in (*slots.parks, *slots.pads)
                )
                if free_m > best[0] + 1e-6:
                    best = (free_m, away_m, direction)
            if best[0] >= clear_m:
                break
        return best[1], best[2]

    def _place(self, site: Array, offset: Vec2) -> Vec2:
        x, y = self.frame.to_arena((float(site[0]), float(site[1])))
        return self.frame.to_world((x + offset[0], y + offset[1]))

    def _check_parks(self, ways: Ways, slots: Slots, keys: Callable[[int], KeyPath]) -> None:
        """On an occupancy map a stopping place must not be in an obstacle; beside a road there is room."""
        image = self.map_.geometry.image
        if image is None:
            return
        for i, site in enumerate(ways.sites):
            worst = max((ways.offset_m(self._place(site, park)) for park in slots.parks), default=0.0)
            if worst > 2 * image.resolution_m:
                at_depot = i == len(ways.sites) - 1
                name = "the depot" if at_depot else f"path point {i}"
                text = (
                    f"{name} at {_at(site)} has no room for all UGVs side by side: "
                    f"one would stand {worst:.3g} m from where it may be (map.clearance_m); move it"
                )
                raise self.document.error(text, ("depot",) if at_depot else keys(i))

    def _check_spacing(
        self, sites: Array, slots: Slots, aside: tuple[tuple[float, float], ...], keys: Callable[[int], KeyPath]
    ) -> None:
        """Vehicles in their places at different sites must be apart as at one site."""
        separation = self.config.separation
        scale = self.frame.scale
        least = separation.horizontal_m + separation.buffer_m
        pushed_m = max((away_m for away_m, _ in aside), default=0.0)
        reach = (2 * (self.slots.reach_m + pushed_m) + max(least, separation.ugv_m)) / scale
        apart = np.hypot(*(sites[:, None] - sites[None]).transpose(2, 0, 1))
        standing = [(i, p, "uav") for i, p in enumerate(slots.pads)]
        standing += [(len(slots.pads) + i, p, "ugv") for i, p in enumerate(slots.parks)]

        def at(site: int, offset: Vec2) -> Vec2:
            return beside(offset, *aside[site]) if aside else offset

        for i, j in zip(*np.nonzero(np.triu(apart < reach, 1)), strict=True):
            a, b = (np.array(self.frame.to_arena((float(x), float(y)))) for x, y in (sites[i], sites[j]))
            if apart[i, j] < 1e-3:
                other = "the depot, which serves as one already" if j == len(sites) - 1 else f"path point {j}"
                text = f"path point {i} at {_at(sites[i])} is at the same place as {other}; remove it"
                raise self.document.error(text, keys(int(i)))
            for (n, p, p_kind), (m, q, q_kind) in product(standing, repeat=2):
                limit = separation.ugv_m if p_kind == q_kind == "ugv" else least
                apart_m = float(np.hypot(*(b + np.array(at(int(j), q)) - a - np.array(at(int(i), p)))))
                # Sites themselves must be apart, too: UGVs pass one on their way to the other.
                if n != m and min(apart_m, apart[i, j] * scale) < limit - 1e-9:
                    other = "the depot" if j == len(sites) - 1 else f"path point {j}"
                    text = (
                        f"path point {i} at {_at(sites[i])} is {apart[i, j]:.4g} m (world) from {other}, so vehicles "
                        f"at both would be closer than {limit:g} m (arena); move or remove one"
                    )
                    raise self.document.error(text, keys(int(i)))

    def _check_tasks(self, tasks: Array, names: tuple[str, ...], sites: Array, keys: Callable[[int], KeyPath]) -> None:
        x0, y0, x1, y1 = self.map_.geometry.bounds
        outside = (tasks[:, 0] < x0) | (tasks[:, 0] > x1) | (tasks[:, 1] < y0) | (tasks[:, 1] > y1)
        if outside.any():
            i = int(np.argmax(outside))
            box = f"x {x0:g} to {x1:g} m, y {y0:g} to {y1:g} m"
            raise self.document.error(
                f"task {names[i]} at {_at(tasks[i])} is outside the map ({box}); move it", keys(i)
            )
        inside = shapely.intersects_xy(self.region(0.0), tasks[:, 0], tasks[:, 1])
        if not inside.all():
            i = int(np.argmin(inside))
            text = f"task {names[i]} at {_at(tasks[i])} is outside the geofence or within its soft margin; move it"
            raise self.document.error(text, keys(i))
        limit = self.config.tasks.max_distance_m
        if limit is not None:
            away = np.hypot(*(tasks[:, None] - sites[None]).transpose(2, 0, 1)).min(axis=1)
            if (away > limit).any():
                i = int(np.argmax(away))
                text = (
                    f"task {names[i]} at {_at(tasks[i])} is {away[i]:.5g} m from the nearest path point or the depot, "
                    f"tasks.max_distance_m allows {limit:g} m; move it or add a path point"
                )
                raise self.document.error(text, keys(i))


def _numbers(tasks: Array) -> tuple[str, ...]:
    return tuple(str(i) for i in range(len(tasks)))


def _at(point: Array) -> str:
    return f"({point[0]:.10g}, {point[1]:.10g})"
