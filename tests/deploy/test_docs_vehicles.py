"""The pages on preparing vehicles are true: their YAML is accepted, and what they name exists."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from pydantic import TypeAdapter

from deploy.localisation import Localisation
from deploy.mission_fleet import Fleet, fleet_of
from deploy.mission_model import FleetSection
from deploy.yaml_file import parse_yaml
from drivers import crazyflie_checks, limo_checks, mavlink_ardupilot, mavlink_checks, mavlink_px4, mocap_health
from drivers.mavlink_socket import FORMS
from drivers.mocap_options import TYPES

ROOT = Path(__file__).resolve().parents[2]
TYPES_OF_EVERY_PAGE = {
    "crazyflie": {"kind": "uav", "driver": "crazyflie"},
    "quad": {"kind": "uav", "driver": "mavlink"},
    "limo": {"kind": "ugv", "driver": "limo"},
}


def page(name: str) -> str:
    return (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8")


def blocks(name: str) -> list[dict[str, Any]]:
    return [yaml.safe_load(text) for text in re.findall(r"```yaml\n(.*?)```", page(name), re.DOTALL)]


def rows(name: str) -> set[str]:
    """Names of checks in the first column of the page's table of checks."""
    table = page(name).partition("## What the checks mean")[2].partition("\n## ")[0]
    return {n for cell in re.findall(r"^\| (`[^|]*)\|", table, re.MULTILINE) for n in re.findall(r"`([^`]+)`", cell)}


def fleet(data: dict[str, Any]) -> Fleet:
    types = {**TYPES_OF_EVERY_PAGE, **data.get("types", {})}
    vehicles = {"one": {"type": "crazyflie"}, **data.get("vehicles", {})}
    vehicles |= {f"a {name}".replace(" ", "-"): {"type": name} for name in data.get("types", {})}
    raw = yaml.safe_dump({"types": types, "vehicles": vehicles}, sort_keys=False).encode()
    document = parse_yaml(raw, Path("page.yaml"), "fleet")
    return fleet_of(TypeAdapter(FleetSection).validate_python(document.data), document, ())


@pytest.mark.parametrize(("name", "count"), [("crazyflie", 1), ("limo", 3), ("mavlink", 2)])
def test_fleets_of_the_pages_are_accepted(name: str, count: int) -> None:
    found = blocks(name)
    assert len(found) == count
    for data in found:
        made = fleet(data)
        assert set(data.get("vehicles", {})) <= set(made.vehicles)
        assert any(v.driver == name for v in made.vehicles.values())


def test_the_localisation_of_the_page_is_accepted() -> None:
    (data,) = blocks("motion-capture")
    assert Localisation.model_validate_json(json.dumps(data["localisation"])).mocap is not None
    table = page("motion-capture").partition("## OptiTrack")[0]
    assert set(re.findall(r"^\| `(\w+)` \|", table, re.MULTILINE)) - {"type"} == set(TYPES)


def test_checks_that_the_pages_explain_exist() -> None:
    sources = {
        "crazyflie": [crazyflie_checks],
        "limo": [limo_checks],
        "mavlink": [mavlink_checks, mavlink_px4, mavlink_ardupilot],
        "motion-capture": [mocap_health],
    }
    of_the_fleet = {"links", "radio budget"}
    for name, modules in sources.items():
        code = "".join(Path(str(module.__file__)).read_text(encoding="utf-8") for module in modules)
        named = rows(name) - of_the_fleet
        assert named, name
        assert not [row for row in named if f'"{row}"' not in code], name


def test_parameters_that_pre_flight_reads_are_in_the_page() -> None:
    text = page("mavlink")
    for dialect in (mavlink_px4.COPTER, mavlink_px4.ROVER, mavlink_ardupilot.COPTER, mavlink_ardupilot.ROVER):
        judged = {n for n in dialect.parameters if n not in ("COM_DISARM_LAND", "FS_TIMEOUT")}
        assert not [n for n in judged if f"`{n}`" not in text]


def test_every_form_of_endpoint_is_in_the_page() -> None:
    for scheme in ("udpin", "udpout", "tcp", "/dev/tty"):
        assert scheme in FORMS
        assert f"`{scheme}" in page("mavlink")
