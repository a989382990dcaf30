"""Maps: GeoJSON with degrees and metres, what is drawn, map_server pairs."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from mission_files import MAP_SERVER, MISSION, ROADS, changed, write
from PIL import Image

from deploy.maps_geojson import load_geojson_map, projection
from deploy.maps_occupancy import load_occupancy_map
from deploy.mission import load


def feature(kind: str | None, shape: str, coordinates: object) -> dict[str, object]:
    properties = {} if kind is None else {"kind": kind}
    return {"type": "Feature", "properties": properties, "geometry": {"type": shape, "coordinates": coordinates}}


SQUARE = [[[0, 0], [9, 0], [9, 9], [0, 0]], [[1, 1], [2, 1], [2, 2], [1, 1]]]


def test_geometry_by_kind(tmp_path: Path) -> None:
    features = [
        feature(None, "MultiLineString", [[[0, 0], [50, 0]], [[25, -20], [25, 20]]]),
        feature("road", "LineString", [[50, 0], [50, 50]]),
        feature("stream", "LineString", [[0, 5], [50, 5]]),
        feature("water", "Polygon", SQUARE),
        feature("building", "MultiPolygon", [SQUARE, SQUARE]),
        feature("sign", "Point", [1, 2]),
        {"type": "Feature", "properties": None, "geometry": None},
    ]
    write(tmp_path, roads={"type": "FeatureCollection", "copcs_units": "m", "features": features})
    map_ = load_geojson_map(tmp_path / "roads.geojson", "auto")
    assert map_.project is None
    assert len(map_.geometry.roads) == 3
    assert [kind for kind, _ in map_.geometry.lines] == ["stream"]
    assert [(area.kind, len(area.holes)) for area in map_.geometry.areas] == [
        ("water", 1),
        ("building", 1),
        ("building", 1),
    ]
    assert map_.geometry.bounds == (0, -20, 50, 50)
    ways = map_.make_ways(np.array([[0.0, 0], [25, 20]]))
    assert ways.distance_m[0, 1] == 45


def test_degrees_become_metres(tmp_path: Path) -> None:
    lines = [feature(None, "LineString", [[8.0, 47.0], [8.02, 47.0], [8.02, 47.01]])]
    write(tmp_path, roads={"type": "FeatureCollection", "features": lines})
    map_ = load_geojson_map(tmp_path / "roads.geojson", "auto")
    x0, y0, x1, y1 = map_.geometry.bounds
    # At 47 degrees a degree of longitude is 76.05 km and one of latitude 111.17 km (WGS 84).
    assert x1 - x0 == pytest.approx(0.02 * 76_050, rel=2e-3)
    assert y1 - y0 == pytest.approx(0.01 * 111_170, rel=2e-3)
    assert map_.project is not None
    assert np.abs(map_.project(np.array([[8.01, 47.005]]))).max() < 1e-3


def test_a_projection_keeps_distances_near_its_centre() -> None:
    points = projection(11.0, 48.0)(np.array([[11.0, 48.0], [11.0, 48.009]]))
    assert math.dist(points[0], points[1]) == pytest.approx(0.009 * 111_200, rel=1e-3)


def test_a_crs_or_the_mission_may_say_metres(tmp_path: Path) -> None:
    roads = {key: value for key, value in ROADS.items() if key != "copcs_units"}
    named = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::25832"}}
    write(tmp_path, roads={**roads, "crs": named})
    assert load_geojson_map(tmp_path / "roads.geojson", "auto").project is None
    write(tmp_path, roads=roads)
    assert load_geojson_map(tmp_path / "roads.geojson", "metric").geometry.bounds == (0, 0, 1000, 800)


def test_lon_lat_points_in_missions(tmp_path: Path) -> None:
    lines = [
        feature(None, "LineString", [[8.0, 47.0], [8.02, 47.0]]),
        feature(None, "LineString", [[8.01, 46.99], [8.01, 47.01]]),
    ]
    base = {
        **MISSION,
        "depot": {"lon": 8.01, "lat": 47.0},
        "path_points": {"points": [{"lon": 8.005, "lat": 47.0}]},
        "tasks": {"file": "points.csv"},
    }
    path = write(
        tmp_path, mission=base, roads={"type": "FeatureCollection", "features": lines}, csv="lon,lat\n8.01,47.002\n"
    )
    problem = load(path).problem
    assert problem.depot == pytest.approx((0, 0), abs=0.1)
    assert problem.road_distance_m[0, 1] == pytest.approx(0.005 * 76_050, rel=2e-3)
    assert problem.tasks[0] == pytest.approx([0, 0.002 * 111_170], abs=0.5)


def picture(pixels: np.ndarray, kind: str) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(pixels.astype(np.uint8)).save(buffer, kind)
    return buffer.getvalue()


@pytest.mark.parametrize(("kind", "negate"), [("PPM", 0), ("PNG", 0), ("PNG", 1)])
def test_map_server_pairs(kind: str, negate: int, tmp_path: Path) -> None:
    pixels = np.full((60, 100), 254)
    pixels[:30, 40:60] = 0  # rows count from the top: the wall stands in the upper half
    write(
        tmp_path,
        map={**MAP_SERVER, "negate": negate, "origin": [-50, -30, 0]},
        image=picture(254 - pixels if negate else pixels, kind),
    )
    map_ = load_occupancy_map(tmp_path / "map.yaml", 2.0, "blocked")
    assert map_.geometry.bounds == (-50, -30, 50, 30)
    ways = map_.make_ways(np.array([[-30.0, 20], [30, 20]]))
    assert ways.distance_m[0, 1] > 70
    assert ways.offset_m((0.0, 20.0)) > 5
    assert ways.offset_m((0.0, -20.0)) == 0


def test_unknown_cells(tmp_path: Path) -> None:
    pixels = np.full((60, 100), 254)
    pixels[:, 45:55] = 205  # what map_saver writes where it does not know
    write(tmp_path, map={**MAP_SERVER, "free_thresh": 0.19}, image=picture(pixels, "PPM"))
    sites = np.array([[20.0, 20], [80, 20]])
    blocked = load_occupancy_map(tmp_path / "map.yaml", 1.0, "blocked").make_ways(sites)
    free = load_occupancy_map(tmp_path / "map.yaml", 1.0, "free").make_ways(sites)
    assert np.isinf(blocked.distance_m[0, 1])
    assert free.distance_m[0, 1] == pytest.approx(60, abs=1)


def test_path_points_are_placed_on_occupancy_maps(tmp_path: Path) -> None:
    pixels = np.full((300, 400), 254)
    pixels[100:200, 100:300] = 0
    base = changed(changed(MISSION, "map.file", "map.yaml"), "path_points", {"place": 4})
    base = {**base, "depot": [50, 50], "tasks": {"random": {"count": 5}}}
    mission = load(write(tmp_path, mission=base, image=picture(pixels, "PPM")))
    assert len(mission.problem.path_points) == 4
    assert np.isfinite(mission.problem.road_distance_m).all()
    assert mission.settings.ugvs[0].lane_offset_m == 0
    assert mission.geometry.image is not None
    assert mission.geometry.image.pixels.shape == (300, 400)
