"""A small mission that loads in milliseconds, to be broken in every way."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

ROADS = {
    "type": "FeatureCollection",
    "copcs_units": "m",
    "bbox": [0, 0, 1000, 800],
    "features": [
        {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": line}}
        for line in (
            [[0, 100], [1000, 100]],
            [[500, 0], [500, 700]],
            [[100, 600], [900, 600]],
            [[50, 750], [150, 750]],  # not joined to the others
        )
    ],
}
FLEET: dict[str, Any] = {
    "all": {"energy_j": None},
    "types": {"quad": {"kind": "uav", "driver": "mavlink"}, "rover": {"kind": "ugv"}},
    "vehicles": {
        "uav0": {"type": "quad", "endpoint": "udpin:0.0.0.0:14550", "sysid": 1},
        "uav1": {"type": "quad"},
        "ugv0": {"type": "rover"},
    },
}
MISSION: dict[str, Any] = {
    "version": 1,
    "name": "small",
    "map": {"file": "roads.geojson"},
    "depot": [500, 100],
    "path_points": {"points": [[200, 100], [500, 600]]},
    "tasks": {"points": [[300, 300], [700, 300], [700, 500]]},
    "fleet": {"file": "fleet.yaml"},
    "arena": {"fence_margin_m": 0},
}
MAP_SERVER: dict[str, Any] = {"image": "map.pgm", "resolution": 1.0, "origin": [0.0, 0.0, 0.0], "negate": 0}


def changed(data: dict[str, Any], key: str, value: Any) -> dict[str, Any]:
    """A copy with the value at a dotted key replaced; numbers are places in lists."""
    result = copy.deepcopy(data)
    here: Any = result
    *parents, last = key.split(".")
    for part in parents:
        here = here[int(part)] if isinstance(here, list) else here.setdefault(part, {})
    if isinstance(here, list):
        here[int(last)] = value
    else:
        here[last] = value
    return result


def write(folder: Path, **files: Any) -> Path:
    """Writes the small mission into ``folder`` with some of its files replaced; bytes and text go out as they are."""
    contents: dict[str, Any] = {
        "mission.yaml": files.get("mission", MISSION),
        "fleet.yaml": files.get("fleet", FLEET),
        "roads.geojson": files.get("roads", ROADS),
        "map.yaml": files.get("map", MAP_SERVER),
        "map.pgm": files.get("image", b"P5\n1000 800\n255\n" + b"\xff" * 800_000),
        "points.csv": files.get("csv", "id,x,y\na,300,300\nb,700,300\n"),
        "points.geojson": files.get("points", {"type": "FeatureCollection", "features": []}),
    }
    for name, content in contents.items():
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        elif isinstance(content, str):
            (folder / name).write_text(content, encoding="utf-8")
        elif content is not None:
            # JSON is YAML, one key a line so that line numbers mean something.
            (folder / name).write_text(json.dumps(content, indent=1), encoding="utf-8")
    return folder / "mission.yaml"
