"""A mission that is planned, checked and flown in a second or two."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

ROADS = {
    "type": "FeatureCollection",
    "copcs_units": "m",
    "bbox": [0, 0, 1000, 800],
    "features": [
        {"type": "Feature", "properties": {}, "geometry": {"type": "LineString", "coordinates": line}}
        for line in ([[0, 100], [1000, 100]], [[500, 0], [500, 700]])
    ],
}
MISSION: dict[str, Any] = {
    "version": 1,
    "name": "small",
    "map": {"file": "roads.geojson"},
    "depot": [500, 100],
    "path_points": {"points": [[200, 100], [500, 600]]},
    "tasks": {"points": [[300, 300], [700, 300], [700, 500]]},
    "fleet": {
        "types": {"quad": {"kind": "uav"}, "rover": {"kind": "ugv"}},
        "vehicles": {"uav0": {"type": "quad"}, "uav1": {"type": "quad"}, "ugv0": {"type": "rover"}},
    },
    "planner": {"time_s": None, "iterations": 2000, "replan": {"time_s": 1.0, "iterations": 2000}},
}


def write(folder: Path, **changes: Any) -> Path:
    """Writes the mission with some of its sections replaced; returns its file."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "roads.geojson").write_text(json.dumps(ROADS), encoding="utf-8")
    path = folder / "small.yaml"
    path.write_text(json.dumps({**MISSION, **changes}), encoding="utf-8")  # JSON is YAML
    return path
