"""The three 10 km maps: roads, water, blocks and buildings, as road network and as occupancy.

The GeoJSON files lie in ``mission_configs/maps`` (written by ``make_maps.py`` and ``make_towns.py`` there), so that
missions can use them, too.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from planner.errors import PlannerError
from planner.problem import Point
from planner.road_network import RoadNetwork

Array = NDArray[np.float64]

FOLDER = Path(__file__).parent.parent / "mission_configs" / "maps"  # installed beside this package

# Where the team starts; moved onto the nearest road. Each map has its own, as in the paper (section V-B).
DEPOTS: dict[str, Point] = {"rural": (5_000.0, 500.0), "suburban": (600.0, 4_600.0), "urban": (8_300.0, 9_500.0)}
IMPASSABLE = ("block", "water", "building")  # in the order of drawing: lakes lie in holes of blocks
ROAD_WIDTH_M = 40.0  # as drawn into the occupancy, and one cell more


@dataclass(frozen=True, eq=False)
class Terrain:
    """A map in m; the lower left corner is (0, 0).

    Attributes:
        name: ``rural``, ``suburban`` or ``urban``.
        side_m: it is square.
        depot: near where the team starts.
        roads: polylines from junction to junction, each (n, 2).
        areas: kind and shape; the kinds in ``IMPASSABLE`` are in the way of vehicles on the ground.
    """

    name: str
    side_m: float
    depot: Point
    roads: tuple[Array, ...]
    areas: tuple[tuple[str, shapely.Polygon], ...]

    @cached_property
    def centres(self) -> Array:
        """The central location of each road, (R, 2): half-way along it. Path points are chosen from these."""
        lines = np.array([shapely.linestrings(road) for road in self.roads])
        centres: Array = shapely.get_coordinates(shapely.line_interpolate_point(lines, 0.5, normalized=True))
        return centres

    @cached_property
    def network(self) -> RoadNetwork:
        """All roads with, as sites, every road's centre and, last, the depot; without what the depot cannot reach."""
        network = RoadNetwork.from_lines(self.roads, np.vstack([self.centres, self.depot]))
        if not np.isfinite(network.distance_m).all():
            raise PlannerError(f"map {self.name!r}: some road is not connected to the depot; mend the map")
        return network

    def roads_at(self, chosen: NDArray[np.int64]) -> tuple[Array, Array]:
        """Sites and road distances where the path points are the centres of the roads ``chosen``, (P,).

        Returns:
            Sites, (P + 1, 2) with the depot last, and distances, (P + 1, P + 1) in m.
        """
        rows = np.r_[chosen, len(self.roads)]
        # Rounded, so that another version of the geometry library makes the same instances.
        return self.network.sites[rows].round(3), self.network.distance_m[np.ix_(rows, rows)].round(3)

    @cache  # noqa: B019  (three maps exist, for good)
    def spread(self, count: int) -> NDArray[np.int64]:
        """The ``count`` roads whose centres serve the map best: least mean distance from anywhere to the nearest site.

        Greedy choice, then exchanges while one helps (k-median; Teitz and Bart 1968). The depot is a site already.

        Raises:
            PlannerError: when there are not that many roads.
        """
        if not 0 <= count <= len(self.roads):
            raise PlannerError(f"map {self.name!r} has {len(self.roads)} roads; {count} path points do not fit")
        ticks = (np.arange(25) + 0.5) * self.side_m / 25
        places = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        away = np.linalg.norm(places[:, None] - self.network.sites[None], axis=2)  # (places, roads + depot)
        home, away = away[:, -1], away[:, :-1]
        chosen: list[int] = []
        for _ in range(count):
            now = np.minimum(home, away[:, chosen].min(axis=1, initial=np.inf))
            chosen.append(int(np.minimum(now[:, None], away).mean(axis=0).argmin()))
        better = True
        while better:
            better = False
            for k in range(count):
                others = chosen[:k] + chosen[k + 1 :]
                now = np.minimum(home, away[:, others].min(axis=1, initial=np.inf))
                means = np.minimum(now[:, None], away).mean(axis=0)
                best = int(means.argmin())
                if means[best] < means[chosen[k]] - 1e-9:
                    chosen[k], better = best, True
        return np.array(sorted(chosen), dtype=np.int64)

    def occupancy(self, resolution_m: float = 20.0) -> NDArray[np.bool_]:
        """Cells that are free for vehicles on the ground, (rows, columns), the first row at the bottom.

        Water, blocks and buildings are not; a road is free wherever it leads, over bridges, too.
        """
        cells = max(1, round(self.side_m / resolution_m))
        picture = Image.new("1", (cells, cells), 1)
        draw = ImageDraw.Draw(picture)

        def pixels(points: Array) -> list[tuple[float, float]]:
            return [(float(x), float(y)) for x, y in points / resolution_m - 0.5]

        for obstacle in IMPASSABLE:
            for kind, shape in self.areas:
                if kind == obstacle:
                    draw.polygon(pixels(np.array(shape.exterior.coords)), fill=0)
                    for hole in shape.interiors:
                        draw.polygon(pixels(np.array(hole.coords)), fill=1)
        for road in self.roads:
            draw.line(pixels(road), fill=1, width=2 * round(0.5 * ROAD_WIDTH_M / resolution_m) + 1)
        return np.array(picture, dtype=np.bool_)


@cache
def terrain(name: str) -> Terrain:
    """Reads a map.

    Raises:
        PlannerError: for an unknown name.
    """
    if name not in DEPOTS:
        raise PlannerError(f"map {name!r} does not exist; there are {', '.join(DEPOTS)}")
    data = json.loads((FOLDER / f"{name}.geojson").read_text(encoding="utf-8"))
    roads, areas = [], []
    for feature in data["features"]:
        kind, coordinates = feature["properties"]["kind"], feature["geometry"]["coordinates"]
        if kind == "road":
            roads.append(np.array(coordinates))
        else:
            areas.append((kind, shapely.Polygon(coordinates[0], coordinates[1:])))
    return Terrain(name, float(data["bbox"][2]), DEPOTS[name], tuple(roads), tuple(areas))
