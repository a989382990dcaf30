"""Draws the maps of this folder, always the same ones: ``python make_maps.py``.

``rural.geojson``: 10 km x 10 km, metres. ``farm.geojson``: about 1.6 km x 1.4 km, degrees (an invented
place). ``city_block.png`` and ``.yaml``: 400 m x 300 m, one pixel a metre. With ``--pictures DIR``
it draws them as PNG as well.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from pyproj import Transformer
from scipy.spatial import Delaunay

Array = NDArray[np.float64]
HERE = Path(__file__).parent
SEED = 2026
FARM_LON, FARM_LAT = 11.0, 48.0  # centre of the farm map


@dataclass
class Land:
    """One rural map in m."""

    width: float
    height: float
    roads: list[Array] = field(default_factory=list)
    water: list[shapely.Polygon] = field(default_factory=list)
    wood: list[shapely.Polygon] = field(default_factory=list)
    fields: list[shapely.Polygon] = field(default_factory=list)
    buildings: list[shapely.Polygon] = field(default_factory=list)


def wiggle(rng: np.random.Generator, start: Array, end: Array, amplitude: float, levels: int) -> Array:
    """A natural line between two points: midpoints displaced at random, less at each level, then rounded off."""
    line = np.array([start, end])
    for level in range(levels):
        middle = 0.5 * (line[1:] + line[:-1])
        along = line[1:] - line[:-1]
        normal = np.stack([-along[:, 1], along[:, 0]], axis=1)
        middle += normal * rng.normal(0, amplitude * 0.75**level, (len(middle), 1))
        woven = np.empty((len(line) + len(middle), 2))
        woven[0::2], woven[1::2] = line, middle
        line = woven
    for _ in range(2):  # Chaikin
        q, r = 0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]
        line = np.vstack([line[:1], np.stack([q, r], axis=1).reshape(-1, 2), line[-1:]])
    return line


def blob(rng: np.random.Generator, centre: Array, radius: float, rough: float) -> shapely.Polygon:
    """A natural closed shape: a circle with a few random waves."""
    angle = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    r = np.ones(72)
    for n in range(1, 7):
        r += rough / n**0.8 * rng.normal() * np.cos(n * angle + rng.uniform(0, 2 * np.pi))
    r = radius * np.clip(r, 0.35, 2.2)
    return shapely.Polygon(centre + np.stack([1.3 * r * np.cos(angle), 0.8 * r * np.sin(angle)], axis=1)).buffer(0)


def scatter(rng: np.random.Generator, land: Land, apart: float, margin: float, tries: int = 4000) -> Array:
    """Points at least ``apart`` from each other."""
    points: list[Array] = []
    for _ in range(tries):
        p = rng.uniform((margin, margin), (land.width - margin, land.height - margin))
        if all(np.hypot(*(p - q)) >= apart for q in points):
            points.append(p)
    return np.array(points)


def river(rng: np.random.Generator, start: Array, end: Array, width: float) -> shapely.Polygon:
    """A meandering river that grows wider downstream."""
    line = wiggle(rng, start, end, 0.22, 6)
    growth = np.linspace(0.6, 1.3, len(line) - 1)
    pieces = [shapely.LineString(line[i : i + 2]).buffer(0.5 * width * g) for i, g in enumerate(growth)]
    return shapely.unary_union(pieces).simplify(width / 12)


def gabriel(points: Array) -> list[tuple[int, int]]:
    """Edges between neighbours with nobody in between: how country roads connect villages."""
    edges = {
        tuple(sorted((int(t[i]), int(t[j])))) for t in Delaunay(points).simplices for i, j in ((0, 1), (1, 2), (0, 2))
    }
    kept = []
    for a, b in sorted(edges):
        middle, radius = 0.5 * (points[a] + points[b]), 0.5 * np.hypot(*(points[a] - points[b]))
        others = np.delete(points, [a, b], axis=0)
        if np.hypot(*(others - middle).T).min() > 0.97 * radius:
            kept.append((a, b))
    return kept


def houses(rng: np.random.Generator, land: Land, road: Array, n: int, size: tuple[float, float], near: Array) -> None:
    """Houses along a road, close to ``near``."""
    line = shapely.LineString(road)
    taken = shapely.unary_union([*land.water, *(shapely.LineString(r).buffer(6) for r in land.roads)])
    at = line.project(shapely.Point(near))
    for _ in range(n):
        s = float(np.clip(at + rng.normal(0, size[1] * np.sqrt(n) + 2 * size[0]), 5, line.length - 5))
        a, b = (np.array(line.interpolate(x).coords[0]) for x in (s - 3, s + 3))
        angle = float(np.arctan2(*(b - a)[::-1]))
        w, d = rng.uniform(*size), rng.uniform(0.6, 0.9) * size[0]
        away = rng.choice([-1, 1]) * (8 + d / 2 + abs(rng.normal(0, size[0])))
        centre = a + away * np.array([-np.sin(angle), np.cos(angle)])
        house = shapely.affinity.rotate(shapely.box(-w / 2, -d / 2, w / 2, d / 2), angle, use_radians=True)
        house = shapely.affinity.translate(house, *centre)
        if not house.intersects(taken) and all(house.distance(other) > 5 for other in land.buildings[-60:]):
            land.buildings.append(house)


def rural() -> Land:
    """The demo's map: villages, country roads, a river with a tributary, lakes and woods."""
    rng = np.random.default_rng(SEED)
    land = Land(10_000, 10_000)
    box = shapely.box(0, 0, land.width, land.height)
    main = river(rng, np.array([1800.0, 10_300]), np.array([10_300.0, 2600]), 90)
    side = river(rng, np.array([-300.0, 4300]), np.array([4080.0, 6720]), 45)
    lakes = [
        blob(rng, np.array(c), r, 0.16) for c, r in (((7900, 7800), 620), ((2300, 2500), 430), ((5300, 5350), 300))
    ]
    wet = shapely.unary_union([main, side, *lakes]).intersection(box)
    land.water = [p for p in shapely.get_parts(wet) if p.area > 2000]
    villages = scatter(rng, land, 1250, 350)
    lake = shapely.unary_union(lakes).buffer(120)
    villages = np.array([v for v in villages if not lake.contains(shapely.Point(v))])
    # Where the depot stands: the village closest to the middle of the south.
    south = int(np.argmin(np.hypot(*(villages - (5000, 500)).T)))
    villages[south] = (5000, 500)
    for a, b in gabriel(villages):
        road = wiggle(rng, villages[a], villages[b], 0.07, 4)
        line = shapely.LineString(road)
        if not line.intersects(lake) and box.contains(line) and line.length < 3200:
            land.roads.append(np.round(road, 1))
    for v in villages:
        for road in land.roads:
            if min(np.hypot(*(road[0] - v)), np.hypot(*(road[-1] - v))) < 1:
                houses(rng, land, road, int(rng.integers(3, 9)), (34, 70), v)
    streets = shapely.unary_union([shapely.LineString(r).buffer(60) for r in land.roads])
    for c in scatter(rng, land, 1500, 200):
        shape = (
            blob(rng, c, rng.uniform(250, 560), 0.2).difference(streets).difference(wet.buffer(40)).intersection(box)
        )
        land.wood += [p.simplify(8) for p in shapely.get_parts(shape) if p.area > 40_000]
    return land


def farm() -> Land:
    """The field mission's map: a village street, farm tracks between fields, a pond and a brook."""
    rng = np.random.default_rng(SEED + 1)
    land = Land(1600, 1400)
    box = shapely.box(0, 0, land.width, land.height)
    brook = river(rng, np.array([-50.0, 1050]), np.array([1650.0, 620]), 14)
    pond = blob(rng, np.array([1120.0, 330]), 75, 0.15)
    wet = shapely.unary_union([brook, pond]).intersection(box)
    land.water = [p for p in shapely.get_parts(wet) if p.area > 200]
    xs = [90, 430, 790, 1140, 1500]
    ys = [100, 420, 740, 1030, 1300]
    knots = {(i, j): np.array([x, y]) + rng.normal(0, 42, 2) for i, x in enumerate(xs) for j, y in enumerate(ys)}
    knots = {k: np.clip(p, 60, (1540, 1340)) for k, p in knots.items()}
    dropped = {
        ((0, 0), (1, 0)),
        ((3, 0), (3, 1)),
        ((3, 0), (4, 0)),
        ((1, 3), (2, 3)),
        ((4, 2), (4, 3)),
        ((0, 3), (0, 4)),
        ((2, 1), (2, 2)),
    }
    for (i, j), p in knots.items():
        for other in ((i + 1, j), (i, j + 1)):
            if other in knots and ((i, j), other) not in dropped:
                road = wiggle(rng, p, knots[other], 0.05, 3)
                if not shapely.LineString(road).intersects(pond.buffer(20)):
                    land.roads.append(np.round(road, 2))
    for near in ((1, 2), (2, 2), (2, 1)):
        for road in land.roads:
            if min(np.hypot(*(road[[0, -1]] - knots[near]).T)) < 1:
                houses(rng, land, road, 14, (10, 20), knots[near])
    streets = shapely.unary_union([shapely.LineString(r).buffer(9) for r in land.roads] + [wet.buffer(12)])
    built = shapely.unary_union([b.buffer(18) for b in land.buildings])
    for (i, j), p in knots.items():
        if (i + 1, j + 1) in knots:
            corners = [p, knots[i + 1, j], knots[i + 1, j + 1], knots[i, j + 1]]
            split = rng.uniform(0.35, 0.65)
            low, high = corners[0] + split * (corners[1] - corners[0]), corners[3] + split * (corners[2] - corners[3])
            for ring in ((corners[0], low, high, corners[3]), (low, corners[1], corners[2], high)):
                shape = shapely.Polygon(ring).buffer(-7).difference(streets).difference(built)
                target = land.wood if rng.uniform() < 0.16 else land.fields
                target += [q.simplify(1) for q in shapely.get_parts(shape) if q.area > 4000]
    return land


def city() -> NDArray[np.uint8]:
    """The lab's map: streets 52 m wide between blocks of houses, some with courtyards; 255 free, 0 occupied."""
    rng = np.random.default_rng(SEED + 2)
    image = Image.new("L", (400, 300), 254)
    draw = ImageDraw.Draw(image)
    columns = [(0, 33), (86, 173), (226, 313), (366, 399)]
    rows = [(0, 33), (86, 213), (266, 299)]
    for c, (x0, x1) in enumerate(columns):
        for r, (y0, y1) in enumerate(rows):
            parts = [(y0, y1)] if (c, r) != (2, 1) else [(y0, 123), (176, y1)]
            for top, bottom in parts:
                if (c, r) == (1, 1):
                    block(rng, draw, x0, top, x1, bottom, court=True)
                else:
                    block(rng, draw, x0, top, x1, bottom, court=False)
    pixels: NDArray[np.uint8] = np.array(image)
    return pixels


def block(rng: np.random.Generator, draw: ImageDraw.ImageDraw, x0: int, y0: int, x1: int, y1: int, court: bool) -> None:
    """Fills a block with houses of different depth; a courtyard with trees stays open inside."""
    if not court:
        x = x0
        while x <= x1:
            w = min(int(rng.integers(16, 30)), x1 - x + 1)
            w = x1 - x + 1 if x1 - x - w < 10 else w
            inset = rng.integers(0, 5, 4)
            draw.rectangle((x + (x > x0), y0 + inset[0], x + w - 2 * (x + w <= x1), y1 - inset[1]), fill=0)
            x += w
        return
    for x in range(x0, x1 - 9, 22):
        w = min(21, x1 - x)
        draw.rectangle((x, y0 + rng.integers(0, 4), x + w, y0 + 22 + rng.integers(-3, 4)), fill=0)
        draw.rectangle((x, y1 - 22 + rng.integers(-3, 4), x + w, y1 - rng.integers(0, 4)), fill=0)
    for y in range(y0 + 18, y1 - 18, 23):
        draw.rectangle((x0 + rng.integers(0, 4), y, x0 + 20 + rng.integers(-3, 4), y + 22), fill=0)
        draw.rectangle((x1 - 20 + rng.integers(-3, 4), y, x1 - rng.integers(0, 4), y + 22), fill=0)
    for _ in range(7):
        x, y, r = rng.uniform(x0 + 32, x1 - 32), rng.uniform(y0 + 34, y1 - 34), rng.uniform(2, 4)
        draw.ellipse((x - r, y - r, x + r, y + r), fill=0)


def write_geojson(path: Path, land: Land, geographic: bool) -> None:
    """Writes a map of this file."""
    kinds = [("field", land.fields), ("wood", land.wood), ("water", land.water), ("building", land.buildings)]
    write_areas(path, land, kinds, geographic)


def write_areas(path: Path, land: Land, kinds: list[tuple[str, list[shapely.Polygon]]], geographic: bool) -> None:
    """Areas of each kind in that order, then the roads; one feature a line, so that changes show in a diff."""
    back = Transformer.from_crs(
        f"+proj=aeqd +lat_0={FARM_LAT} +lon_0={FARM_LON} +datum=WGS84 +units=m", "EPSG:4326", always_xy=True
    )
    centre = np.array([land.width / 2, land.height / 2])

    def numbers(points: Array) -> list[list[float]]:
        if geographic:
            points = np.stack(back.transform(*(points - centre).T), axis=1)
        return [[round(float(x), 7 if geographic else 1), round(float(y), 7 if geographic else 1)] for x, y in points]

    features = []
    for kind, shapes in kinds:
        for shape in shapes:
            rings = [np.array(r.coords) for r in (shape.exterior, *shape.interiors)]
            features.append((kind, "Polygon", [numbers(r) for r in rings]))
    features += [("road", "LineString", numbers(road)) for road in land.roads]
    lines = [
        json.dumps(
            {"type": "Feature", "properties": {"kind": k}, "geometry": {"type": g, "coordinates": c}},
            separators=(",", ":"),
        )
        for k, g, c in features
    ]
    corners = numbers(np.array([[0, 0], [land.width, land.height]]))
    units = "" if geographic else '"copcs_units":"m",'
    head = f'{{"type":"FeatureCollection",{units}"bbox":{json.dumps(corners[0] + corners[1])},\n"features":[\n'
    path.write_text(head + ",\n".join(lines) + "\n]}\n", encoding="utf-8")


def picture(land: Land, path: Path) -> None:
    """Draws a map for a look at it."""
    import matplotlib.pyplot as plt  # noqa: PLC0415  only for pictures

    figure, axes = plt.subplots(figsize=(10, 10 * land.height / land.width))
    axes.set_facecolor("#f3f1ea")
    for shapes, colour in (
        (land.fields, "#e9e4c9"),
        (land.wood, "#cfe0c3"),
        (land.water, "#a9cfe6"),
        (land.buildings, "#9a8f86"),
    ):
        for shape in shapes:
            axes.fill(*np.array(shape.exterior.coords).T, color=colour, linewidth=0)
            for hole in shape.interiors:
                axes.fill(*np.array(hole.coords).T, color="#f3f1ea", linewidth=0)
    for road in land.roads:
        axes.plot(*road.T, color="#b9b2a6", linewidth=2.6, solid_capstyle="round")
        axes.plot(*road.T, color="white", linewidth=1.6, solid_capstyle="round")
    axes.set(xlim=(0, land.width), ylim=(0, land.height), aspect="equal")
    figure.savefig(path, dpi=80, bbox_inches="tight")


def main() -> None:
    """Writes the maps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--pictures", type=Path)
    arguments = parser.parse_args()
    lands = {"rural": rural(), "farm": farm()}
    write_geojson(HERE / "rural.geojson", lands["rural"], geographic=False)
    write_geojson(HERE / "farm.geojson", lands["farm"], geographic=True)
    Image.fromarray(city()).save(HERE / "city_block.png")
    (HERE / "city_block.yaml").write_text(
        "# ROS map_server file; made by make_maps.py.\n"
        "image: city_block.png\n"
        "resolution: 1.0              # m per pixel\n"
        "origin: [-200.0, -150.0, 0.0]  # lower left corner: x m, y m, yaw rad\n"
        "negate: 0                    # black is occupied\n"
        "occupied_thresh: 0.65        # darker than this is occupied\n"
        "free_thresh: 0.25            # lighter than this is free\n",
        encoding="utf-8",
    )
    if arguments.pictures:
        arguments.pictures.mkdir(parents=True, exist_ok=True)
        for name, land in lands.items():
            picture(land, arguments.pictures / f"{name}.png")
        Image.fromarray(city()).resize((1200, 900), Image.Resampling.NEAREST).save(
            arguments.pictures / "city_block.png"
        )


if __name__ == "__main__":
    main()
