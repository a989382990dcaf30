"""GeoJSON files: a road network with its surroundings, or a list of points."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deploy.errors import InputError
from deploy.maps import Area, Array, Bounds, LoadedMap, MapGeometry, Project, Source
from deploy.yaml_file import decode, read_bytes
from planner.road_network import RoadNetwork
from planner.roads import RoadError

MAX_BYTES = 50_000_000
_METRIC_HINT = 'say `"copcs_units": "m"` in the file, or `coordinates: metric` in the mission, where they are metres'


@dataclass
class Shapes:
    """What a GeoJSON file holds, in the file's coordinates.

    Attributes:
        points: (x, y) and the name of the feature, where it has one.
        lines: kind and vertices (n, 2).
        areas: kind and rings, outline first.
    """

    points: list[tuple[tuple[float, float], str | None]] = field(default_factory=list)
    lines: list[tuple[str, Array]] = field(default_factory=list)
    areas: list[tuple[str, list[Array]]] = field(default_factory=list)


def read_geojson(path: Path, role: str) -> tuple[dict[str, Any], Shapes, bytes]:
    """Reads a GeoJSON file: the object itself, what it holds, and its bytes.

    Raises:
        InputError: naming the file, the feature, the value and the remedy.
    """
    raw = read_bytes(path, MAX_BYTES, role)
    text = decode(raw, path)
    try:
        data = json.loads(text, parse_constant=partial(_no_constant, path))
    except json.JSONDecodeError as error:
        what = f"this is not JSON: {error.msg}; mend it, or export the {role} again"
        raise InputError(what, file=path, line=error.lineno) from None
    except RecursionError:
        raise InputError("nested too deeply for GeoJSON; export it again", file=path) from None
    except ValueError as error:
        raise InputError(f"holds a number that cannot be read: {error}; export it again", file=path) from None
    if not isinstance(data, dict) or "type" not in data:
        raise InputError("the top level is no GeoJSON object; export a FeatureCollection", file=path)
    shapes = Shapes()
    reader = _Reader(path, shapes)
    kind = data["type"]
    if kind == "FeatureCollection":
        features = data.get("features")
        if not isinstance(features, list):
            raise InputError(f"is {type(features).__name__}; give a list of features", file=path, key="features")
        for i, feature in enumerate(features):
            reader.feature(feature, f"features[{i}]")
    elif kind == "Feature":
        reader.feature(data, "")
    else:
        reader.geometry(data, "road", None, "")
    return data, shapes, raw


def load_geojson_map(path: Path, coordinates: str) -> LoadedMap:
    """A road network; ``coordinates`` is ``auto``, ``lonlat`` or ``metric``.

    Raises:
        InputError: naming the file, the feature, the value and the remedy.
    """
    data, shapes, raw = read_geojson(path, "map")
    lines = [line for kind, line in shapes.lines if kind == "road"]
    if not lines:
        raise InputError("holds no road; give at least one LineString (property kind absent or `road`)", file=path)
    metric = coordinates == "metric" or (coordinates == "auto" and _is_metric(data))
    everything = np.vstack([line for _, line in shapes.lines] + [r for _, rings in shapes.areas for r in rings])
    bounds = _bbox(data, path) or _bounds(everything)
    project: Project | None = None
    centre_deg: tuple[float, float] | None = None
    if not metric:
        _check_degrees(path, everything)
        lon, lat = 0.5 * (bounds[0] + bounds[2]), 0.5 * (bounds[1] + bounds[3])
        project, centre_deg = projection(lon, lat), (lat, lon)
        x0, y0, x1, y1 = bounds
        bounds = _bounds(project(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])))
    to_world: Project = project if project is not None else np.asarray
    roads = tuple(to_world(line) for line in lines)
    geometry = MapGeometry(
        bounds=bounds,
        roads=roads,
        lines=tuple((kind, to_world(line)) for kind, line in shapes.lines if kind != "road"),
        areas=tuple(
            Area(kind, to_world(rings[0]), tuple(to_world(hole) for hole in rings[1:])) for kind, rings in shapes.areas
        ),
    )
    try:
        base = RoadNetwork.from_lines(roads, np.zeros((0, 2)))
    except RoadError as error:
        raise InputError(str(error), file=path) from None
    return LoadedMap(geometry, base.with_sites, project, (Source("map", path, raw),), centre_deg=centre_deg)


def projection(lon: float, lat: float) -> Project:
    """Degrees to metres around (``lon``, ``lat``): azimuthal equidistant, WGS 84, x east, y north."""
    from pyproj import Transformer  # noqa: PLC0415  0.3 s that metric maps need not wait for

    transformer = Transformer.from_crs(
        "EPSG:4326", f"+proj=aeqd +lat_0={lat!r} +lon_0={lon!r} +datum=WGS84 +units=m", always_xy=True
    )

    def to_metres(degrees: Array) -> Array:
        x, y = transformer.transform(degrees[:, 0], degrees[:, 1])
        # A hundredth of a millimetre: the last bits may differ between machines, digests must not.
        return np.round(np.stack([x, y], axis=1), 5)

    return to_metres


class _Reader:
    def __init__(self, path: Path, shapes: Shapes) -> None:
        self.path, self.shapes = path, shapes

    def feature(self, feature: Any, at: str) -> None:
        if not isinstance(feature, dict) or feature.get("type") != "Feature":
            raise InputError(f"is no GeoJSON feature ({_shown(feature)}); export again", file=self.path, key=at)
        properties = feature.get("properties")
        properties = properties if isinstance(properties, dict) else {}
        kind = properties.get("kind", "road")
        if not isinstance(kind, str):
            raise InputError(f"is {_shown(kind)}; give text", file=self.path, key=f"{at}.properties.kind")
        name = feature.get("id", properties.get("id", properties.get("name")))
        geometry = feature.get("geometry")
        if geometry is not None:
            self.geometry(geometry, kind, None if name is None else str(name), f"{at}.geometry".lstrip("."))

    def geometry(self, geometry: Any, kind: str, name: str | None, at: str) -> None:
        if not isinstance(geometry, dict):
            raise InputError(f"is {_shown(geometry)}; give a geometry object", file=self.path, key=at)
        shape = geometry.get("type")
        if shape == "GeometryCollection":
            for i, part in enumerate(self._list(geometry.get("geometries"), f"{at}.geometries")):
                if isinstance(part, dict) and part.get("type") == "GeometryCollection":
                    raise InputError("a collection within a collection; export plain features", file=self.path, key=at)
                self.geometry(part, kind, name, f"{at}.geometries[{i}]")
            return
        at = f"{at}.coordinates".lstrip(".")
        coordinates = geometry.get("coordinates")
        if shape == "Point":
            self.shapes.points.append((self._vertex(coordinates, at), name))
        elif shape == "MultiPoint":
            for i, c in enumerate(self._list(coordinates, at)):
                self.shapes.points.append((self._vertex(c, f"{at}[{i}]"), name if i == 0 else None))
        elif shape == "LineString":
            self.shapes.lines.append((kind, self._line(coordinates, at, 2)))
        elif shape == "MultiLineString":
            for i, c in enumerate(self._list(coordinates, at)):
                self.shapes.lines.append((kind, self._line(c, f"{at}[{i}]", 2)))
        elif shape == "Polygon":
            self._polygon(coordinates, kind, at)
        elif shape == "MultiPolygon":
            for i, c in enumerate(self._list(coordinates, at)):
                self._polygon(c, kind, f"{at}[{i}]")
        else:
            raise InputError(f"type {_shown(shape)} is no GeoJSON geometry; export again", file=self.path, key=at)

    def _polygon(self, rings: Any, kind: str, at: str) -> None:
        lines = [self._line(ring, f"{at}[{i}]", 4) for i, ring in enumerate(self._list(rings, at))]
        if lines:
            self.shapes.areas.append((kind, lines))

    def _line(self, vertices: Any, at: str, least: int) -> Array:
        listed = self._list(vertices, at)
        if len(listed) < least:
            raise InputError(f"has {len(listed)} points; give at least {least}", file=self.path, key=at)
        return np.array([self._vertex(v, f"{at}[{i}]") for i, v in enumerate(listed)])

    def _vertex(self, value: Any, at: str) -> tuple[float, float]:
        if (
            not isinstance(value, list)
            or len(value) < 2
            or not all(isinstance(c, int | float) and not isinstance(c, bool) for c in value[:2])
        ):
            raise InputError(f"is {_shown(value)}; give [x, y]", file=self.path, key=at)
        try:
            x, y = float(value[0]), float(value[1])
        except OverflowError:
            x = y = math.inf
        if not (math.isfinite(x) and math.isfinite(y) and max(abs(x), abs(y)) < 1e9):
            raise InputError(f"is {_shown(value)}; give two finite numbers of map size", file=self.path, key=at)
        return x, y

    def _list(self, value: Any, at: str) -> list[Any]:
        if not isinstance(value, list):
            raise InputError(f"is {_shown(value)}; give a list", file=self.path, key=at)
        return value


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _no_constant(path: Path, name: str) -> float:
    raise InputError(f"holds {name}, which is no JSON number; give finite numbers", file=path)


def _is_metric(data: dict[str, Any]) -> bool:
    if data.get("copcs_units") == "m":
        return True
    crs = data.get("crs")
    properties = crs.get("properties") if isinstance(crs, dict) else None
    name = properties.get("name") if isinstance(properties, dict) else None
    return isinstance(name, str) and not any(word in name for word in ("CRS84", "4326"))


def _bbox(data: dict[str, Any], path: Path) -> Bounds | None:
    box = data.get("bbox")
    if box is None:
        return None
    numbers = isinstance(box, list) and all(isinstance(c, int | float) and not isinstance(c, bool) for c in box)
    if not numbers or len(box) != 4 or not all(abs(c) < 1e9 for c in box) or box[0] >= box[2] or box[1] >= box[3]:
        raise InputError(f"is {_shown(box)}; give [least x, least y, greatest x, greatest y]", file=path, key="bbox")
    return (float(box[0]), float(box[1]), float(box[2]), float(box[3]))


def _bounds(points: Array) -> Bounds:
    (x0, y0), (x1, y1) = points.min(axis=0), points.max(axis=0)
    return (float(x0), float(y0), float(x1), float(y1))


def _check_degrees(path: Path, points: Array) -> None:
    wrong = (np.abs(points[:, 0]) > 180) | (np.abs(points[:, 1]) > 90)
    if wrong.any():
        x, y = points[np.argmax(wrong)]
        raise InputError(f"coordinates ({x:g}, {y:g}) are no longitude and latitude; {_METRIC_HINT}", file=path)
