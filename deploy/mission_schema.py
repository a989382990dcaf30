"""JSON schemas of mission and fleet files, for editors; ``python -m deploy.mission_schema`` writes them and docs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from deploy.mission_fleet import UavConfig, UgvConfig
from deploy.mission_model import FleetSection, MissionConfig
from deploy.mission_reference import PAGE, page

FOLDER = Path(__file__).parent.parent / "mission_configs"


def schema() -> dict[str, Any]:
    """JSON schema of ``mission.yaml`` for editors; ``mission_configs/mission.schema.json`` holds it."""
    result = MissionConfig.model_json_schema()
    result["$defs"].update(_vehicle_definitions())
    _use_vehicle_keys(result["$defs"]["FleetSection"]["properties"])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **result}


def fleet_schema() -> dict[str, Any]:
    """JSON schema of fleet files for editors; ``mission_configs/fleet.schema.json`` holds it."""
    result = FleetSection.model_json_schema()
    result["$defs"] = _vehicle_definitions()
    del result["properties"]["file"]
    _use_vehicle_keys(result["properties"])
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **result}


def _vehicle_definitions() -> dict[str, Any]:
    properties: dict[str, Any] = {"type": {"type": "string", "description": "A name under `types`."}}
    options: dict[str, Any] = {}
    for model in (UgvConfig, UavConfig):
        full = model.model_json_schema()
        properties.update(full["properties"])
        options.update(full.get("$defs", {}))
    properties["kind"] = {"enum": ["uav", "ugv"], "description": "UAV or UGV."}
    for key, values in properties.items():
        if key not in ("type", "kind"):
            values.pop("default", None)  # UAVs and UGVs differ, an editor would show one of both
    keys = {"type": "object", "additionalProperties": False, "properties": properties}
    return {"VehicleKeys": keys, **options}


def _use_vehicle_keys(properties: dict[str, Any]) -> None:
    keys = {"$ref": "#/$defs/VehicleKeys"}
    properties["all"] = {**keys, "description": properties["all"]["description"]}
    for name in ("types", "vehicles"):
        properties[name]["additionalProperties"] = keys


def texts() -> dict[str, str]:
    """What the schema files hold, by file name."""
    both = {"mission.schema.json": schema(), "fleet.schema.json": fleet_schema()}
    return {name: json.dumps(content, indent=1, ensure_ascii=False) + "\n" for name, content in both.items()}


if __name__ == "__main__":
    for file_name, text in texts().items():
        (FOLDER / file_name).write_text(text, encoding="utf-8")
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
