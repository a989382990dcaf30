"""Every mistake is one sentence: file, key, value, remedy."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from mission_files import FLEET, MAP_SERVER, MISSION, ROADS, changed, write

from deploy.errors import InputError
from deploy.mission import load

OCCUPANCY = changed(MISSION, "map.file", "map.yaml")
DARK = b"\0" * 1000
POINT_LIKE = {"type": "Feature", "geometry": {"type": "LineString", "coordinates": [[1, 1], [1, 1]]}}
LINE = {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": [[0, 0], [1, "a"]]}}


def mission(key: str, value: Any, base: dict[str, Any] = MISSION) -> dict[str, Any]:
    return {"mission": changed(base, key, value)}


def fleet(key: str, value: Any) -> dict[str, Any]:
    return {"fleet": changed(FLEET, key, value)}


def without(key: str) -> dict[str, Any]:
    return {"mission": {k: v for k, v in MISSION.items() if k != key}}


def huge_png() -> bytes:
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)
    chunk = b"IHDR" + header
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + chunk + struct.pack(">I", zlib.crc32(chunk))


BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(ord('a') + i)}: &{chr(ord('a') + i)} [{','.join(['*' + chr(ord('a') + i - 1)] * 10)}]\n" for i in range(1, 9)
)
DEEPER = "a0: &a0 " + "[" * 30 + "1" + "]" * 30 + "\na1: " + "[" * 30 + "*a0" + "]" * 30 + "\n"

# name: (files, file named, key named, words in the message)
CASES: dict[str, tuple[dict[str, Any], str, str, tuple[str, ...]]] = {
    # the mission file as such
    "empty": ({"mission": ""}, "mission.yaml", "", ("empty",)),
    "a list": ({"mission": "- 1\n"}, "mission.yaml", "", ("key: value", "[1]")),
    "not YAML": ({"mission": "a: [1\nb: 2"}, "mission.yaml:2", "", ("not YAML",)),
    "tab": ({"mission": "a:\n\t- 1"}, "mission.yaml:2", "", ("not YAML",)),
    "not UTF-8": ({"mission": b"name: f\xfcr\n"}, "mission.yaml:1", "", ("0xfc", "UTF-8")),
    "control character": ({"mission": b"name: a\x00b\n"}, "mission.yaml", "", ("not YAML",)),
    "key twice": ({"mission": "version: 1\nname: a\nname: b\n"}, "mission.yaml:3", "name", ("twice", "line 2")),
    "key is a list": ({"mission": "? [1]\n: 2\n"}, "mission.yaml:1", "", ("key",)),
    "two documents": ({"mission": "a: 1\n---\nb: 2\n"}, "mission.yaml", "", ("second document",)),
    "tag": ({"mission": "a: !!python/object/apply:os.system [ls]\n"}, "mission.yaml:1", "", ("tag", "os.system")),
    "alias bomb": ({"mission": BOMB}, "mission.yaml", "", ("100000 values",)),
    "text bomb": ({"mission": f"a: &a {'x' * 9000}\nb: [{','.join(['*a'] * 9000)}]"}, "mission.yaml", "", ("values",)),
    "alias of itself": ({"mission": "a: &a [*a]\n"}, "mission.yaml:1", "", ("*a",)),
    "unknown alias": ({"mission": "a: *b\n"}, "mission.yaml:1", "", ()),
    "deep": ({"mission": "a: " + "[" * 5000 + "]" * 5000}, "mission.yaml", "", ("40 levels",)),
    "deep by alias": ({"mission": DEEPER}, "mission.yaml:2", "", ("40 levels",)),
    "huge": ({"mission": b"a: 1 #" + b"x" * 1_100_000}, "mission.yaml", "", ("1000000 bytes",)),
    # keys and types
    "version": (mission("version", 2), "mission.yaml", "version", ("2", "version 1")),
    "version missing": (without("version"), "mission.yaml", "version", ("missing",)),
    "map missing": (without("map"), "mission.yaml", "map", ("missing",)),
    "unknown key": (mission("tsks", 1), "mission.yaml", "tsks", ("'tsks'", "did you mean 'tasks'")),
    "unknown in section": (mission("arena.ceilng_m", 1), "mission.yaml", "arena.ceilng_m", ("'ceiling_m'",)),
    "unknown in dataclass": (
        mission("monitors.pose_stle_s", 1),
        "mission.yaml",
        "monitors.pose_stle_s",
        ("pose_stale_s",),
    ),
    "unknown in fault": (
        mission("faults", [{"kind": "ugv_stall", "vehicel": "ugv0"}]),
        "mission.yaml",
        "faults[0].vehicel",
        ("did you mean 'vehicle'",),
    ),
    "text for number": (mission("arena.scale", "one"), "mission.yaml", "arena.scale", ("'one'", "a number")),
    "bool for number": (mission("arena.scale", True), "mission.yaml", "arena.scale", ("true", "a number")),
    "number for text": (mission("name", 7), "mission.yaml", "name", ("7", "text")),
    "fraction for count": (
        mission("tasks", {"random": {"count": 2.5}}),
        "mission.yaml",
        "tasks.random.count",
        ("2.5",),
    ),
    "list for section": (mission("arena", [1]), "mission.yaml", "arena", ("[1]",)),
    "null for section": (mission("arena", None), "mission.yaml", "arena", ("null",)),
    "nan": ({"mission": '{"version": 1, "depot": [.nan, 0]}'}, "mission.yaml", "depot[0]", ("nan",)),
    "infinity": (mission("arena.ceiling_m", float("inf")), "mission.yaml", "arena.ceiling_m", ()),
    "huge number": (mission("arena.scale", 10**400), "mission.yaml", "arena.scale", ()),
    "negative scale": (mission("arena.scale", -1), "mission.yaml", "arena.scale", ("-1", "above 0")),
    "point of three": (mission("depot", [1, 2, 3]), "mission.yaml", "depot", ()),
    "point is text": (mission("depot", "home"), "mission.yaml", "depot", ("'home'",)),
    "lon without lat": (mission("depot", {"lon": 8}), "mission.yaml", "depot.lat", ("missing",)),
    "degrees on a metric map": (mission("depot", {"lon": 8, "lat": 47}), "mission.yaml", "depot", ("degrees",)),
    "no tasks": (mission("tasks", {}), "mission.yaml", "tasks", ("exactly one", "none")),
    "tasks twice": (mission("tasks.file", "points.csv"), "mission.yaml", "tasks", ("points, file",)),
    "tasks empty": (mission("tasks.points", []), "mission.yaml", "tasks.points", ("[]",)),
    "failsafe event": (
        mission("failsafe", {"pose_stal": "hold"}),
        "mission.yaml",
        "failsafe",
        ("'pose_stal'", "pose_stale"),
    ),
    "failsafe situation": (
        mission("failsafe", {"link_lost/flying": "hold"}),
        "mission.yaml",
        "failsafe",
        ("'flying'", "air, docking"),
    ),
    "failsafe fixed": (mission("failsafe", {"tumbled": "note"}), "mission.yaml", "failsafe", ("tumbled", "cannot")),
    "failsafe action": (mission("failsafe", {"pose_stale": "stop"}), "mission.yaml", "failsafe", ("'stop'", "hold")),
    "no budget": (mission("planner", {"time_s": None}), "mission.yaml", "planner", ("time_s", "never end")),
    "option": (
        mission("planner.options", {"drive": -1}),
        "mission.yaml",
        "planner.options",
        ("drive is -1", "0 or above"),
    ),
    **{
        f"option of {method}": (
            mission("planner", {"method": method, "options": {"hott": 1}}),
            "mission.yaml",
            "planner.options",
            (f"method '{method}' has no option 'hott'", "there are"),
        )
        for method in ("copcs", "search", "milp", "gls", "ts", "sa")
    },
    "method": (mission("planner.method", "serch"), "mission.yaml", "planner.method", ("'serch'", "'search'")),
    "margins": (mission("checks.energy_margin_fail", 0.5), "mission.yaml", "checks", ("0.5",)),
    "fault kind": (mission("faults", [{"kind": "rain"}]), "mission.yaml", "faults[0].kind", ("'rain'",)),
    "fault time": (
        mission("faults", [{"kind": "ugv_stall", "vehicle": "ugv0", "at_s": -1}]),
        "mission.yaml",
        "faults[0]",
        ("-1",),
    ),
    "fault vehicle": (
        mission("faults", [{"kind": "ugv_stall", "vehicle": "ugv7"}]),
        "mission.yaml",
        "faults",
        ("'ugv7'", "ugv0"),
    ),
    # files that it names
    "map file": (mission("map.file", "no.geojson"), "mission.yaml", "map.file", ("'no.geojson'", "not exist")),
    "map is a folder": (mission("map.file", "."), "mission.yaml", "map.file", ("'.'", "folder")),
    "map ending": (mission("map.file", "points.csv"), "mission.yaml", "map.file", ("points.csv",)),
    "fleet file": (mission("fleet.file", "no.yaml"), "mission.yaml", "fleet.file", ("'no.yaml'",)),
    "fleet twice": (mission("fleet.all", {"sysid": 1}), "mission.yaml", "fleet.file", ("fleet.yaml",)),
    "tasks file": (mission("tasks", {"file": "no.csv"}), "no.csv", "", ("not exist",)),
    "tasks ending": (mission("tasks", {"file": "map.pgm"}), "map.pgm", "", (".csv",)),
    # places
    "task outside map": (
        mission("tasks.points.1", [5000, 1]),
        "mission.yaml",
        "tasks.points[1]",
        ("5000", "outside the map"),
    ),
    "task at the fence": (
        mission("tasks.points.1", [5, 400]),
        "mission.yaml",
        "tasks.points[1]",
        ("(5, 400)", "geofence"),
    ),
    "task too far": (mission("tasks.max_distance_m", 150), "mission.yaml", "tasks.points", ("150",)),
    "no room to draw": (
        mission("tasks", {"random": {"count": 5}, "max_distance_m": 1e-9}),
        "mission.yaml",
        "tasks.random",
        ("5 tasks",),
    ),
    "path point off road": (
        mission("path_points.points.0", [200, 300]),
        "mission.yaml",
        "path_points.points[0]",
        ("200 m",),
    ),
    "path point outside": (
        mission("path_points.points.0", [-9, 100]),
        "mission.yaml",
        "path_points.points[0]",
        ("-9",),
    ),
    "path point unreachable": (
        mission("path_points.points.0", [100, 750]),
        "mission.yaml",
        "path_points.points[0]",
        ("(100, 750)", "cannot be reached"),
    ),
    "path points too close": (
        mission("path_points.points.0", [500, 598]),
        "mission.yaml",
        "path_points.points[0]",
        ("2 m",),
    ),
    "path point at depot": (
        mission("path_points.points.0", [500, 100]),
        "mission.yaml",
        "path_points.points[0]",
        ("depot",),
    ),
    "no room for path points": (mission("path_points", {"place": 200}), "mission.yaml", "path_points.place", ("200",)),
    "depot off road": (mission("depot", [300, 300]), "mission.yaml", "depot", ("(300, 300)", "nearest road")),
    "depot at the fence": (mission("depot", [2, 100]), "mission.yaml", "depot", ("(2, 100)", "geofence")),
    "fence crosses itself": (
        mission("arena.geofence_m", [[0, 0], [9, 9], [9, 0], [0, 9]]),
        "mission.yaml",
        "arena.geofence_m",
        ("simple",),
    ),
    "soft margin": (mission("arena.soft_margin_m", 500), "mission.yaml", "arena.soft_margin_m", ("500",)),
    "layer above ceiling": (mission("arena.layers.lowest_m", 119), "mission.yaml", "arena.layers.lowest_m", ("119",)),
    "layers too close": (mission("arena.layers.spacing_m", 1), "mission.yaml", "arena.layers.spacing_m", ("1 m",)),
    "pads too close": (mission("arena.pad_spacing_m", 1), "mission.yaml", "arena.pad_spacing_m", ("1 m",)),
    # the fleet
    "no vehicles": (fleet("vehicles", {}), "fleet.yaml", "vehicles", ("no vehicles",)),
    "no UAV": (fleet("vehicles", {"g": {"type": "rover"}}), "fleet.yaml", "vehicles", ("no UAV",)),
    "vehicle id": (fleet("vehicles", {"a b": {"type": "quad"}}), "fleet.yaml", "vehicles.a b", ("'a b'",)),
    "vehicle twice": (
        {"fleet": "types: {q: {kind: uav}}\nvehicles:\n  a: {type: q}\n  a: {type: q}\n"},
        "fleet.yaml:4",
        "vehicles.a",
        ("twice",),
    ),
    "type": (fleet("vehicles.uav0.type", "qad"), "fleet.yaml", "vehicles.uav0.type", ("'qad'", "'quad'")),
    "kind": (fleet("types.quad.kind", "boat"), "fleet.yaml", "types.quad.kind", ("'boat'", "uav or ugv")),
    "other kind": (fleet("vehicles.uav0.kind", "ugv"), "fleet.yaml", "vehicles.uav0.kind", ("'ugv'",)),
    "vehicle key": (fleet("vehicles.uav0.sped_mps", 1), "fleet.yaml", "vehicles.uav0.sped_mps", ("'speed_mps'",)),
    "type key": (fleet("types.quad.dockss", 1), "fleet.yaml", "types.quad.dockss", ("'dockss'",)),
    "all key": (fleet("all.reserve", 1), "fleet.yaml", "all.reserve", ("'reserve'",)),
    "negative speed": (fleet("types.quad.speed_mps", -3), "fleet.yaml", "types.quad.speed_mps", ("-3", "above 0")),
    "negative power": (fleet("types.quad.power_w", [-1]), "fleet.yaml", "vehicles.uav0", ("-1 W",)),
    "too fast": (
        fleet("types.quad.max_speed_mps", 2),
        "fleet.yaml",
        "vehicles.uav0.speed_mps",
        ("10", "max_speed_mps 2"),
    ),
    "no energy": (fleet("types.quad.energy_j", 50), "fleet.yaml", "capacity_j", ("uav0", "reserve")),
    "energy over capacity": (fleet("types.quad.energy_j", 1e9), "fleet.yaml", "vehicles.uav0", ("1e+09", "capacity_j")),
    "charging twice": (
        fleet("types.rover", {"kind": "ugv", "charge_s": 9, "charge_w": 8}),
        "fleet.yaml",
        "ugv0",
        ("9", "8"),
    ),
    "endpoint": (fleet("vehicles.uav0.endpoint", "radio://0"), "fleet.yaml", "vehicles.uav0", ("'radio://0'", "udpin")),
    "endpoint twice": (
        fleet("vehicles.uav1", FLEET["vehicles"]["uav0"]),
        "fleet.yaml",
        "vehicles.uav1.endpoint",
        ("'udpin:0.0.0.0:14550'", "'uav0'"),
    ),
    "body twice": (fleet("vehicles.uav1.body", "uav0"), "fleet.yaml", "vehicles.uav1.body", ("'uav0'",)),
    "kind missing": (fleet("types.quad", {}), "fleet.yaml", "types.quad.kind", ("missing",)),
    "fleet names a file": (fleet("file", "x.yaml"), "fleet.yaml", "file", ("x.yaml",)),
    "endpoint without driver": (
        fleet("vehicles.ugv0.endpoint", "/a"),
        "fleet.yaml",
        "vehicles.ugv0",
        ("'/a'", "driver"),
    ),
    "sysid without MAVLink": (fleet("vehicles.ugv0.sysid", 3), "fleet.yaml", "vehicles.ugv0", ("3", "mavlink")),
    "dock offsets": (fleet("types.rover.dock_offsets_m", [[0, 0]]), "fleet.yaml", "vehicles.ugv0", ("1 entries", "2")),
    "driving power": (fleet("types.rover.power_w", [-5]), "fleet.yaml", "vehicles.ugv0", ("-5 W",)),
    "docks above layers": (
        fleet("types.rover.pad_height_m", 30),
        "mission.yaml",
        "arena.layers.lowest_m",
        ("30 m", "ugv0"),
    ),
    # maps
    "collection": (
        {"roads": {"type": "GeometryCollection", "geometries": [{"type": "GeometryCollection", "geometries": []}]}},
        "roads.geojson",
        "",
        ("collection within",),
    ),
    "features": ({"roads": {"type": "FeatureCollection", "features": 3}}, "roads.geojson", "features", ("int",)),
    "feature": ({"roads": changed(ROADS, "features.2", 7)}, "roads.geojson", "features[2]", ("7",)),
    "kind of feature": (
        {"roads": changed(ROADS, "features.2.properties.kind", 7)},
        "roads.geojson",
        "features[2].properties.kind",
        ("7",),
    ),
    "geometry": ({"roads": changed(ROADS, "features.2.geometry", 7)}, "roads.geojson", "features[2].geometry", ("7",)),
    "geometry type": (
        {"roads": changed(ROADS, "features.2.geometry.type", "Circle")},
        "roads.geojson",
        "features[2].geometry",
        ("'Circle'",),
    ),
    "one vertex": (
        {"roads": changed(ROADS, "features.2.geometry.coordinates", [[1, 2]])},
        "roads.geojson",
        "features[2].geometry.coordinates",
        ("at least 2",),
    ),
    "no list": (
        {"roads": changed(ROADS, "features.2.geometry.coordinates", "x")},
        "roads.geojson",
        "features[2].geometry.coordinates",
        ("'x'",),
    ),
    "road without length": (
        {"roads": changed(ROADS, "features", [POINT_LIKE])},
        "roads.geojson",
        "",
        ("no length",),
    ),
    "origin": (
        {"mission": OCCUPANCY, "map": changed(MAP_SERVER, "origin", [1e12, 0, 0])},
        "map.yaml",
        "",
        ("1e9",),
    ),
    "no room to park": (
        {
            "mission": {
                **changed(OCCUPANCY, "separation.ugv_m", 10),
                "depot": [500, 400],
                "path_points": {"points": [[600, 400]]},
            },
            "fleet": changed(FLEET, "vehicles.ugv1", {"type": "rover"}),
            # A street, 4 m wide, that ends at the depot.
            "image": b"P5\n1000 800\n255\n" + DARK * 398 + (b"\0" * 498 + b"\xff" * 502) * 4 + DARK * 398,
        },
        "mission.yaml",
        "",
        ("no room for all UGVs", "4 m"),
    ),
    "no room for sites": (
        mission("arena.geofence_m", [[0, 88], [1000, 88], [1000, 112], [0, 112]]),
        "mission.yaml",
        "",
        ("geofence",),
    ),
    "no JSON": ({"roads": "{"}, "roads.geojson:1", "", ("not JSON",)),
    "JSON nan": ({"roads": '{"type": NaN}'}, "roads.geojson", "", ("NaN",)),
    "deep JSON": ({"roads": "[" * 200_000}, "roads.geojson", "", ()),
    "no GeoJSON": ({"roads": "[]"}, "roads.geojson", "", ("GeoJSON",)),
    "no road": ({"roads": {"type": "FeatureCollection", "features": []}}, "roads.geojson", "", ("no road",)),
    "vertex": (
        {"roads": changed(ROADS, "features.1", LINE)},
        "roads.geojson",
        "features[1].geometry.coordinates[1]",
        ("'a'",),
    ),
    "far vertex": (
        {"roads": changed(ROADS, "features.0.geometry.coordinates.0", [1e300, 0])},
        "roads.geojson",
        "features[0].geometry.coordinates[0]",
        ("1e+300",),
    ),
    "bbox": ({"roads": changed(ROADS, "bbox", [1, 2, 1, 2])}, "roads.geojson", "bbox", ("[1, 2, 1, 2]",)),
    "metres as degrees": ({"roads": changed(ROADS, "copcs_units", "?")}, "roads.geojson", "", ("(0, 100)", "metric")),
    "no image": (
        {"mission": OCCUPANCY, "map": changed(MAP_SERVER, "image", "x.pgm")},
        "map.yaml:2",
        "image",
        ("x.pgm",),
    ),
    "resolution": (
        {"mission": OCCUPANCY, "map": changed(MAP_SERVER, "resolution", 0)},
        "map.yaml:3",
        "resolution",
        ("0",),
    ),
    "mode": (
        {"mission": OCCUPANCY, "map": changed(MAP_SERVER, "mode", "raw")},
        "map.yaml",
        "mode",
        ("'raw'", "trinary"),
    ),
    "thresholds": ({"mission": OCCUPANCY, "map": changed(MAP_SERVER, "free_thresh", 0.9)}, "map.yaml", "", ("0.9",)),
    "malformed image": ({"mission": OCCUPANCY, "image": b"P5 hello"}, "map.pgm", "", ("cannot be read",)),
    "truncated image": (
        {"mission": OCCUPANCY, "image": b"P5\n1000 800\n255\n" + b"\xff" * 90},
        "map.pgm",
        "",
        ("read",),
    ),
    "image bomb": ({"mission": OCCUPANCY, "image": huge_png()}, "map.pgm", "", ()),
    "blocked map": (
        {"mission": OCCUPANCY, "image": b"P5\n50 40\n255\n" + b"\0" * 2000},
        "map.yaml",
        "",
        ("clearance",),
    ),
    # points from files
    "csv heading": (mission("tasks", {"file": "points.csv"}) | {"csv": "a,b\n1,2\n"}, "points.csv:1", "", ("a,b",)),
    "csv number": (
        mission("tasks", {"file": "points.csv"}) | {"csv": "x,y\n1,2\n3,nan\n"},
        "points.csv:3",
        "y",
        ("'nan'",),
    ),
    "csv short": (mission("tasks", {"file": "points.csv"}) | {"csv": "x,y\n1\n"}, "points.csv:2", "y", ("''",)),
    "csv empty": (mission("tasks", {"file": "points.csv"}) | {"csv": ""}, "points.csv", "", ("empty",)),
    "csv without points": (
        mission("tasks", {"file": "points.csv"}) | {"csv": "x,y\n"},
        "points.csv",
        "",
        ("no point",),
    ),
    "csv id twice": (
        mission("tasks", {"file": "points.csv"}) | {"csv": "id,x,y\na,300,300\na,310,300\n"},
        "points.csv",
        "",
        ("'a'", "twice"),
    ),
    "geojson without points": (mission("tasks", {"file": "points.geojson"}), "points.geojson", "", ("no point",)),
}


@pytest.mark.parametrize("name", CASES)
def test_one_clear_error(name: str, tmp_path: Path) -> None:
    files, file, key, words = CASES[name]
    with pytest.raises(InputError) as caught:
        load(write(tmp_path, **files))
    message = str(caught.value)
    assert file in message
    assert key in message
    for word in words:
        assert word in message
    assert "\n" not in message
    assert len(message) < 600


def test_the_small_mission_itself_is_right(tmp_path: Path) -> None:
    assert load(write(tmp_path)).problem.n_tasks == 3


@pytest.mark.parametrize(
    ("name", "words"), [("no.yaml", "does not exist"), (".", "folder"), ("a\0b", "cannot be read")]
)
def test_the_mission_file_itself(name: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=words):
        load(tmp_path / name)


def test_line_numbers_are_those_of_the_mistake(tmp_path: Path) -> None:
    path = write(tmp_path, mission="version: 1\nmap: {file: roads.geojson}\narena:\n  scale: 1\n  ceiling_m: -4\n")
    with pytest.raises(InputError, match=r"mission\.yaml:5: arena\.ceiling_m: -4 is out of range") as caught:
        load(path)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize(("key", "value"), [("planner.time_s", -1), ("name.x", 1), ("depot", {1, 2})])
def test_overrides_are_checked_as_the_file_is(key: str, value: object, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=key):
        load(write(tmp_path), overrides={key: value})
