"""Path points and tasks: given, read from files, placed along the roads, or drawn."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import shapely

from deploy.errors import InputError
from deploy.maps import Array, LoadedMap, Region, Source
from deploy.maps_geojson import MAX_BYTES, read_geojson
from deploy.mission_model import LonLat
from deploy.yaml_file import decode, read_bytes

MAX_POINTS = 10_000


def read_points(path: Path, role: str, map_: LoadedMap, metric: bool) -> tuple[Array, tuple[str, ...], Source]:
    """Points of a CSV or GeoJSON file in world m, (n, 2), their names, and the file.

    Args:
        path: the file; its ending tells which.
        role: what the points are, for messages: ``tasks`` or ``path_points``.
        map_: for its projection.
        metric: GeoJSON coordinates are world m.

    Raises:
        InputError: naming the file, the line or feature, the value and the remedy.
    """
    if path.suffix.lower() == ".csv":
        points, names, geographic, raw = _read_csv(path, role)
    elif path.suffix.lower() in (".geojson", ".json"):
        data, shapes, raw = read_geojson(path, f"{role} file")
        points = [point for point, _ in shapes.points]
        names = [name or "" for _, name in shapes.points]
        geographic = not metric and data.get("copcs_units") != "m"
    else:
        raise InputError(f"ends in {path.suffix!r}; give a .csv, .geojson or .json file", file=path)
    if not points:
        raise InputError("holds no point; add at least one", file=path)
    if len(points) > MAX_POINTS:
        raise InputError(f"holds {len(points)} points; at most {MAX_POINTS} are possible", file=path)
    given = [name for name in names if name]
    twice = sorted({name for name in given if given.count(name) > 1}) if len(set(given)) < len(given) else []
    if twice:
        raise InputError(f"id {twice[0]!r} is given twice; give each point its own", file=path)
    array = np.array(points, dtype=np.float64)
    if geographic:
        array = to_world(array, map_, path)
    return array, tuple(name or str(i) for i, name in enumerate(names)), Source(role, path, raw)


def to_world(degrees: Array, map_: LoadedMap, path: Path, key: str | None = None) -> Array:
    """Longitude and latitude, (n, 2), in world m.

    Raises:
        InputError: when the map is not geographic, or a point is no longitude and latitude.
    """
    if map_.project is None:
        what = "points are given in degrees, but the map is not geographic; give [x, y] in m"
        raise InputError(what, file=path, key=key)
    wrong = (np.abs(degrees[:, 0]) > 180) | (np.abs(degrees[:, 1]) > 90)
    if wrong.any():
        lon, lat = degrees[np.argmax(wrong)]
        raise InputError(f"({lon:g}, {lat:g}) is no longitude and latitude; give degrees", file=path, key=key)
    projected = map_.project(degrees)
    if not np.isfinite(projected).all():
        raise InputError("a point lies on the far side of the earth from the map; check it", file=path, key=key)
    return projected


def resolve(places: Sequence[tuple[float, float] | LonLat], map_: LoadedMap, path: Path, key: str) -> Array:
    """Points as written in a mission in world m, (n, 2).

    Raises:
        InputError: for degrees on a map that is not geographic.
    """
    points = np.zeros((len(places), 2))
    for i, place in enumerate(places):
        if isinstance(place, LonLat):
            points[i] = to_world(np.array([[place.lon, place.lat]]), map_, path, key)[0]
        else:
            points[i] = place
    return points


def place_path_points(count: int, candidates: Array, region: Region, spacing_m: float) -> Array:
    """Chooses central, well spread places along the roads: a k-median of the region, always the same.

    Args:
        count: how many.
        candidates: (n, 2) in m, to choose from.
        region: what they should be close to.
        spacing_m: they are at least so far apart.

    Raises:
        ValueError: when there is no room for so many.
    """
    x0, y0, x1, y1 = region.bounds
    side = max(x1 - x0, y1 - y0) / 40
    grid = np.stack(np.meshgrid(np.arange(x0 + side / 2, x1, side), np.arange(y0 + side / 2, y1, side)), -1).reshape(
        -1, 2
    )
    grid = grid[shapely.contains_xy(region, grid[:, 0], grid[:, 1])]
    away = np.hypot(*(candidates[:, None] - grid[None]).transpose(2, 0, 1))  # (candidates, grid)
    apart = np.hypot(*(candidates[:, None] - candidates[None]).transpose(2, 0, 1)) >= spacing_m
    chosen: list[int] = []
    nearest = np.full(len(grid), np.inf)
    for _ in range(count):
        allowed = apart[:, chosen].all(axis=1)
        if not allowed.any():
            raise ValueError(
                f"there is room for {len(chosen)} path points that are {spacing_m:.3g} m apart, not for {count}"
            )
        total = np.where(allowed, np.minimum(away, nearest).sum(axis=1), np.inf)
        chosen.append(int(np.argmin(total)))
        nearest = np.minimum(nearest, away[chosen[-1]])
    for _ in range(5):  # the greedy choice, improved by moving one at a time
        before = list(chosen)
        for i in range(count):
            others = chosen[:i] + chosen[i + 1 :]
            rest = away[others].min(axis=0) if others else np.full(len(grid), np.inf)
            total = np.where(apart[:, others].all(axis=1), np.minimum(away, rest).sum(axis=1), np.inf)
            chosen[i] = int(np.argmin(total))
        if chosen == before:
            break
    points = candidates[chosen]
    return points[np.lexsort((points[:, 1], points[:, 0]))]


def draw_tasks(count: int, seed: int, region: Region, sites: Array, max_distance_m: float | None) -> Array:
    """Draws tasks uniformly from the part of ``region`` that is close enough to a site, (n, 2) in m.

    Raises:
        ValueError: when (almost) nothing of the region is close enough.
    """
    x0, y0, x1, y1 = region.bounds
    random = np.random.default_rng(seed)
    kept = np.zeros((0, 2))
    for _ in range(1000):
        points = random.uniform((x0, y0), (x1, y1), size=(max(64, 2 * count), 2))
        good = shapely.contains_xy(region, points[:, 0], points[:, 1])
        if max_distance_m is not None:
            good &= np.hypot(*(points[:, None] - sites[None]).transpose(2, 0, 1)).min(axis=1) <= max_distance_m
        kept = np.vstack([kept, points[good]])
        if len(kept) >= count:
            return np.round(kept[:count], 3)
    raise ValueError(f"no room for {count} tasks within {max_distance_m} m of a path point or the depot")


def _read_csv(path: Path, role: str) -> tuple[list[tuple[float, float]], list[str], bool, bytes]:
    raw = read_bytes(path, MAX_BYTES, f"{role} file")
    reader = csv.reader(io.StringIO(decode(raw, path), newline=""))
    try:
        rows = [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise InputError(f"this is not CSV: {error}; mend it", file=path, line=reader.line_num) from None
    if not rows:
        raise InputError("is empty; give a heading x,y or lon,lat and one line a point", file=path)
    heading = [cell.strip().lower() for cell in rows[0][1]]
    geographic = {"lon", "lat"} <= set(heading)
    if not geographic and not {"x", "y"} <= set(heading):
        what = f"the heading is {','.join(heading)[:80]!r}; give columns x and y (m), or lon and lat (degrees)"
        raise InputError(what, file=path, line=1)
    columns = [heading.index(name) for name in (("lon", "lat") if geographic else ("x", "y"))]
    name_column = heading.index("id") if "id" in heading else heading.index("name") if "name" in heading else None
    points, names = [], []
    for line, row in rows[1:]:
        point = []
        for column in columns:
            cell = row[column].strip() if column < len(row) else ""
            try:
                value = float(cell)
            except ValueError:
                value = math.nan
            if not math.isfinite(value) or abs(value) > 1e9:
                what = f"is {cell!r}; give a finite number"
                raise InputError(what, file=path, key=heading[column], line=line)
            point.append(value)
        points.append((point[0], point[1]))
        names.append(row[name_column].strip() if name_column is not None and name_column < len(row) else "")
    return points, names, geographic, raw
