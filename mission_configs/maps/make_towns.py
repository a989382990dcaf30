"""Draws ``suburban.geojson`` and ``urban.geojson``, always the same ones: ``python make_towns.py``.

Both are 10 km x 10 km, metres, in the form of ``rural.geojson``, with a further kind of area: ``block``, built-up land
that no vehicle drives through.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely
from make_maps import Array, Land, blob, river, wiggle, write_areas

HERE = Path(__file__).parent
SEED = 2027
SIDE = 10_000.0


def suburban() -> tuple[Land, list[shapely.Polygon]]:
    """Main roads in a loose grid, winding residential streets with dead ends, lakes and a creek; and its blocks."""
    rng = np.random.default_rng(SEED)
    land = Land(SIDE, SIDE)
    box = shapely.box(0, 0, SIDE, SIDE)
    creek = river(rng, np.array([-300.0, 7600]), np.array([10_300.0, 4700]), 40)
    lakes = [
        blob(rng, np.array(c), r, 0.18) for c, r in (((2700, 5000), 520), ((7300, 8400), 430), ((6500, 2600), 640))
    ]
    wet = shapely.unary_union([creek, *lakes]).intersection(box)
    land.water = [p for p in shapely.get_parts(wet) if p.area > 2000]
    shore = shapely.unary_union(lakes).buffer(80)
    steps = np.linspace(350, SIDE - 350, 8)
    knots = {(i, j): np.array([x, y]) + rng.normal(0, 135, 2) for i, x in enumerate(steps) for j, y in enumerate(steps)}
    knots = {k: np.clip(p, 200, SIDE - 200) for k, p in knots.items()}

    def build(start: Array, end: Array, amplitude: float, over: bool) -> bool:
        road = wiggle(rng, start, end, amplitude, 2)
        line = shapely.LineString(road)
        blocked = shore if over else shapely.unary_union([shore, creek.buffer(30)])
        if line.intersects(blocked) or not box.buffer(-60).contains(line):
            return False
        land.roads.append(np.round(road, 1))
        return True

    for (i, j), p in knots.items():
        for other in ((i + 1, j), (i, j + 1)):
            if other in knots and rng.uniform() > 0.08:
                build(p, knots[other], 0.05, over=True)
    main = list(land.roads)
    for (i, j), p in knots.items():
        if (i + 1, j + 1) not in knots:
            continue
        corners = np.array([p, knots[i + 1, j], knots[i + 1, j + 1], knots[i, j + 1]])
        middle = corners.mean(axis=0) + rng.normal(0, 90, 2)
        if shore.contains(shapely.Point(middle)):
            continue
        # A street from main road to main road through the middle, and dead ends off it.
        turn = int(rng.integers(2))
        for a in (turn, turn + 2):
            edge = 0.5 * (corners[a] + corners[(a + 1) % 4])
            gate = _nearest(main, edge)
            if np.hypot(*(gate - middle)) < 1100 and build(gate, middle, 0.1, over=False):
                for share in rng.uniform(0.3, 0.9, 2):
                    street = land.roads[-1]
                    start = street[int(share * (len(street) - 1))]
                    along = street[-1] - street[0]
                    side = np.array([-along[1], along[0]]) / np.hypot(*along) * rng.choice([-1, 1])
                    build(start, start + side * rng.uniform(220, 380), 0.12, over=False)
    _keep_connected(land)
    return land, _blocks(rng, land, wet, verge=32, built=0.68, wood=0.2)


def urban() -> tuple[Land, list[shapely.Polygon]]:
    """A dense grid, turned and bent, two avenues across it, parks, and a river with few bridges; and its blocks."""
    rng = np.random.default_rng(SEED + 1)
    land = Land(SIDE, SIDE)
    box = shapely.box(0, 0, SIDE, SIDE)
    stream = river(rng, np.array([3300.0, -300]), np.array([6900.0, 10_300]), 210)
    basin = blob(rng, np.array([8700.0, 1500.0]), 480, 0.12)
    wet = shapely.unary_union([stream, basin]).intersection(box)
    land.water = [p for p in shapely.get_parts(wet) if p.area > 2000]
    parks = [blob(rng, np.array(c), r, 0.1) for c, r in (((2100, 7200), 560), ((7600, 6100), 480), ((1500, 1900), 380))]
    land.wood = [p.difference(wet) for p in parks]
    xs = np.linspace(220, SIDE - 220, 18) + rng.normal(0, 45, 18)
    ys = np.linspace(220, SIDE - 220, 16) + rng.normal(0, 55, 16)
    knots = {}
    for i, x in enumerate(xs):
        for j, y in enumerate(ys):
            u, v = (x - 5000) / 5000, (y - 5000) / 5000
            bend = np.array([180 * v * (1 - u**2), 140 * np.sin(2.2 * u) * (1 - v**2)])
            knots[i, j] = np.round(np.clip(np.array([x, y]) + bend + rng.normal(0, 12, 2), 80, SIDE - 80), 1)
    for (i, j), p in knots.items():
        for other in ((i + 1, j), (i, j + 1)):
            if other not in knots:
                continue
            line = shapely.LineString([p, knots[other]])
            across = line.intersects(stream.buffer(15))
            bridge = across and other[0] > i and j % 4 == 2
            if (across and not bridge) or line.intersects(basin.buffer(30)):
                continue
            if any(line.intersects(park.buffer(-60)) for park in parks) or (not bridge and rng.uniform() < 0.06):
                continue
            land.roads.append(np.array([p, knots[other]]))
    for start, end in (((1, 1), (7, 13)), ((10, 14), (16, 4))):  # avenues cut through blocks, knot by knot
        steps = max(abs(end[0] - start[0]), abs(end[1] - start[1]))
        way = [
            (start[0] + round(k * (end[0] - start[0]) / steps), start[1] + round(k * (end[1] - start[1]) / steps))
            for k in range(steps + 1)
        ]
        for a, b in pairwise(way):
            line = shapely.LineString([knots[a], knots[b]])
            blocked = line.intersects(wet.buffer(15)) or any(line.intersects(p.buffer(-60)) for p in parks)
            if not blocked and a[0] != b[0] and a[1] != b[1]:
                land.roads.append(np.array([knots[a], knots[b]]))
    _keep_connected(land)
    return land, _blocks(rng, land, wet, verge=22, built=0.93, wood=0.03)


def _nearest(roads: list[Array], point: Array) -> Array:
    vertices = np.vstack(roads)
    nearest: Array = vertices[int(np.argmin(np.hypot(*(vertices - point).T)))]
    return nearest


def _keep_connected(land: Land) -> None:
    """Drops roads that lead nowhere else."""
    lines = [shapely.LineString(r).buffer(1.0) for r in land.roads]
    parts = shapely.get_parts(shapely.unary_union(lines))
    largest = max(parts, key=lambda p: p.area)
    land.roads = [r for r, line in zip(land.roads, lines, strict=True) if line.intersects(largest)]


def _blocks(
    rng: np.random.Generator, land: Land, wet: shapely.Geometry, *, verge: float, built: float, wood: float
) -> list[shapely.Polygon]:
    """What lies between the roads: built-up blocks, some woods, the rest open."""
    lines = shapely.unary_union([shapely.LineString(r) for r in land.roads])
    streets = lines.buffer(verge)
    frame = shapely.box(0, 0, SIDE, SIDE).exterior
    keep_out = shapely.unary_union([streets, wet.buffer(25), *land.wood])
    blocks = []
    for face in shapely.get_parts(shapely.polygonize([*shapely.get_parts(lines), *shapely.get_parts(frame)])):
        kind = rng.uniform()
        for part in shapely.get_parts(face.difference(keep_out)):
            shape = part.buffer(-8).buffer(8).simplify(6)
            if shape.area < 6000:
                continue
            if kind < built:
                blocks += [p for p in shapely.get_parts(shape) if p.geom_type == "Polygon"]
            elif kind < built + wood:
                land.wood += [p for p in shapely.get_parts(shape) if p.geom_type == "Polygon"]
    return blocks


def main() -> None:
    """Writes the maps."""
    for name, (land, blocks) in {"suburban": suburban(), "urban": urban()}.items():
        woods: list[tuple[str, list[shapely.Polygon]]] = [("wood", land.wood), ("water", land.water)]
        write_areas(HERE / f"{name}.geojson", land, [*woods, ("block", blocks)], geographic=False)


if __name__ == "__main__":
    main()
