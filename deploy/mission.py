"""Missions: ``load`` reads ``mission.yaml`` and everything it names into one frozen, checked object."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np

from deploy.check_limits import CheckLimits
from deploy.driver_options import DriverOptions
from deploy.errors import InputError
from deploy.localisation import Localisation, geo_frame
from deploy.maps import LoadedMap, MapGeometry, Region, Source
from deploy.maps_geojson import load_geojson_map
from deploy.maps_occupancy import load_occupancy_map
from deploy.mission_errors import validate
from deploy.mission_fleet import Fleet, fleet_of
from deploy.mission_model import Energy, FleetSection, MissionConfig, Planner, RandomFaults
from deploy.mission_schema import schema
from deploy.mission_settings import (
    altitudes_of,
    frame_of,
    geofence_of,
    lane_clearance_m,
    region_of,
    slots_of,
    uavs_of,
    ugvs_of,
)
from deploy.mission_sites import SiteMaker
from deploy.settings import Settings
from deploy.yaml_file import Document, KeyPath, read_yaml
from drivers.geodesy import GeoFrame
from planner.errors import PlannerError
from planner.problem import Problem
from planner.roads import Roads
from planner.solve import check_options
from sim_backends.errors import SimulationError
from sim_backends.faults import Fault, check_faults

__all__ = ["FleetVehicle", "Mission", "load", "schema"]


@dataclass(frozen=True, slots=True)
class FleetVehicle:
    """One vehicle of the fleet, for drivers and simulators.

    Attributes:
        id: its id.
        kind: ``uav`` or ``ugv``.
        body: its name in motion capture.
        driver: ``crazyflie``, ``limo`` or ``mavlink``; None where only simulators fly it.
        endpoint: radio URI, ROS namespace or MAVLink connection string; None likewise.
        sysid: MAVLink system id.
        options: of the driver; None: its defaults.
    """

    id: str
    kind: Literal["uav", "ugv"]
    body: str
    driver: str | None
    endpoint: str | None
    sysid: int | None
    options: DriverOptions | None = None


@dataclass(frozen=True, eq=False)
class Mission:
    """A mission as loaded.

    Attributes:
        path: the mission file.
        name, seed: as it says.
        config: the validated file, overrides included.
        problem: at the start; world frame.
        roads: between path points and depot; world frame.
        settings: for the pure core.
        geometry: the map, for pictures; world frame.
        task_names: as the tasks' file names them, else their numbers.
        planner: method, budget and options; its seed is set.
        energy: where energies come from.
        checks: what a plan must hold.
        faults: scripted ones, for simulators.
        random_faults: drawn ones, for simulators.
        fleet: all vehicles, UAVs then UGVs, in the problem's order.
        fleet_source: where they stand, for errors and files named beside them.
        localisation: who tells where the vehicles are; None where only simulators do.
        geo: the arena on the globe; None indoors.
        dock_tolerance_m: largest misalignment of a UAV on a dock, arena m, by UGV.
        sources: every file read, with its bytes.
        data: the mission file's plain data, overrides included, for the copy.
        map_data: a map_server file's plain data, likewise.
    """

    path: Path
    name: str
    seed: int
    config: MissionConfig
    problem: Problem
    roads: Roads
    settings: Settings
    geometry: MapGeometry
    task_names: tuple[str, ...]
    planner: Planner
    energy: Energy
    checks: CheckLimits
    faults: tuple[Fault, ...]
    random_faults: RandomFaults | None
    fleet: tuple[FleetVehicle, ...]
    fleet_source: Fleet
    localisation: Localisation | None
    geo: GeoFrame | None
    dock_tolerance_m: dict[str, float]
    sources: tuple[Source, ...]
    data: dict[str, Any]
    map_data: dict[str, Any] | None

    @property
    def files(self) -> tuple[Path, ...]:
        """Every file that was read."""
        return tuple(source.path for source in self.sources)

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all that decides how the mission runs; a copy has the same."""
        s = self.settings
        core = (
            s.frame,
            s.geofence,
            s.separation,
            s.monitors,
            s.replanning,
            s.uavs,
            s.ugvs,
            sorted(s.failsafe.items()),
            s.beside,
        )
        rest = (
            (self.seed, self.planner, self.checks, self.faults, self.random_faults, self.fleet),
            (self.localisation, sorted(self.dock_tolerance_m.items())),
        )
        return hashlib.sha256(repr((self.problem.digest, core, rest)).encode()).hexdigest()


def load(path: Path | str, overrides: Mapping[str, Any] | None = None) -> Mission:
    """Reads a mission.

    Args:
        path: the mission file.
        overrides: values by dotted key that replace the file's, ``{"planner.time_s": 2.0}``.

    Raises:
        InputError: the first mistake in any of the files: file, line, key, value, remedy.
    """
    path = Path(path)
    document = _override(read_yaml(path, "mission"), overrides or {})
    if document.data.get("version", 1) != 1:
        what = f"{document.data['version']!r} is not understood; this program reads version 1"
        raise document.error(what, ("version",))
    config = validate(MissionConfig, document.data, document)
    fleet, fleet_sources = _fleet(config, document)
    map_ = _map(config, document)
    frame = frame_of(config)
    geofence = geofence_of(config, map_.geometry, frame, document)
    altitudes = altitudes_of(config, fleet, document)
    slots = slots_of(config, fleet, document)

    @lru_cache
    def region(margin_m: float) -> Region:
        return region_of(geofence, map_.geometry, frame, margin_m)

    lanes = map_.geometry.image is None
    clear_m = lane_clearance_m(config, fleet) if lanes else 0.0
    sites = SiteMaker(config, document, map_, frame, slots, region, clear_m).make()
    ways = sites.ways
    depot = (float(ways.sites[-1, 0]), float(ways.sites[-1, 1]))
    try:
        uavs, uav_settings = uavs_of(config, fleet, frame, depot, altitudes, sites.slots)
        ugvs, ugv_settings = ugvs_of(config, fleet, frame, uav_settings, sites.slots, lanes)
        problem = Problem(depot, sites.tasks, ways.sites[:-1], np.array(ways.distance_m), uavs, ugvs)
    except PlannerError as error:
        raise document.error(str(error), ("fleet",)) from None
    try:
        if config.planner.options:
            check_options(config.planner.method, config.planner.options)
    except PlannerError as error:
        raise document.error(str(error), ("planner", "options")) from None
    try:
        check_faults(config.faults, [u.id for u in uavs], [g.id for g in ugvs])
    except SimulationError as error:
        raise document.error(str(error), ("faults",)) from None
    settings = Settings(
        frame=frame,
        geofence=geofence,
        separation=config.separation,
        monitors=config.monitors,
        replanning=config.replanning,
        uavs=uav_settings,
        ugvs=ugv_settings,
        problem=problem,
        roads=ways,
        failsafe=dict(config.failsafe),
        beside=sites.beside,
    )
    geo = None
    if config.localisation is not None and config.localisation.source == "vehicles":
        try:
            geo = geo_frame(frame, map_.centre_deg)
        except ValueError as error:
            raise document.error(str(error), ("localisation", "source")) from None
    seed = config.planner.seed if config.planner.seed is not None else config.seed
    return Mission(
        path=path,
        name=config.name,
        seed=config.seed,
        config=config,
        problem=problem,
        roads=ways,
        settings=settings,
        geometry=map_.geometry,
        task_names=sites.task_names,
        planner=config.planner.model_copy(update={"seed": seed}),
        energy=config.energy,
        checks=config.checks,
        faults=config.faults,
        random_faults=config.random_faults,
        fleet=_ordered(fleet),
        fleet_source=fleet,
        localisation=config.localisation,
        geo=geo,
        dock_tolerance_m=_dock_tolerances_m(config, fleet),
        sources=(Source("mission", path, document.raw), *fleet_sources, *map_.sources, *sites.sources),
        data=document.data,
        map_data=map_.data,
    )


def _override(document: Document, overrides: Mapping[str, Any]) -> Document:
    data = document.data
    lines = dict(document.lines)
    for dotted, value in overrides.items():
        parts = tuple(dotted.split("."))
        try:
            json.dumps(value)
        except (TypeError, ValueError):
            raise InputError(
                f"{value!r} cannot stand in a mission; give plain values", file=document.path, key=dotted
            ) from None
        data = _replaced(data, parts, 0, value, document)
        # The value does not come from the file any more, so neither does its line.
        lines = {key: line for key, line in lines.items() if key[: len(parts)] != parts}
    return Document(document.path, document.raw, data, lines)


def _replaced(data: Any, key: tuple[str, ...], depth: int, value: Any, document: Document) -> Any:
    if depth == len(key):
        return value
    if data is None:
        data = {}
    if not isinstance(data, dict):
        raise document.error(f"cannot be set, since {data!r} stands above it; check the dotted key", key)
    part = key[depth]
    return {**data, part: _replaced(data.get(part), key, depth + 1, value, document)}


def _fleet(config: MissionConfig, document: Document) -> tuple[Fleet, tuple[Source, ...]]:
    section = config.fleet
    if section.file is None:
        return fleet_of(section, document, ("fleet",)), ()
    if section.all or section.types or section.vehicles:
        what = f"file ({section.file}) and vehicles are both given; keep one"
        raise document.error(what, ("fleet", "file"))
    fleet_path = _named(document, section.file, ("fleet", "file"))
    fleet_document = read_yaml(fleet_path, "fleet")
    inner = validate(FleetSection, fleet_document.data, fleet_document)
    if inner.file is not None:
        raise fleet_document.error(f"a fleet file cannot name another ({inner.file}); copy its vehicles", ("file",))
    return fleet_of(inner, fleet_document, ()), (Source("fleet", fleet_path, fleet_document.raw),)


def _map(config: MissionConfig, document: Document) -> LoadedMap:
    path = _named(document, config.map.file, ("map", "file"))
    ending = path.suffix.lower()
    if ending in (".geojson", ".json"):
        return load_geojson_map(path, config.map.coordinates)
    if ending in (".yaml", ".yml"):
        return load_occupancy_map(path, config.map.clearance_m, config.map.unknown)
    what = f"{config.map.file!r} is no known map; give a .geojson (roads) or a map_server .yaml"
    raise document.error(what, ("map", "file"))


def _named(document: Document, name: str, key: KeyPath) -> Path:
    """The file that ``key`` names, relative to the document.

    Raises:
        InputError: when there is none, naming the key as well as the file.
    """
    path = document.path.parent / name
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        what = "is a folder" if "\0" not in name and path.is_dir() else "does not exist"
        raise document.error(f"{name!r} {what} (looked for {str(path)!r}); check the path", key)
    return path


def _ordered(fleet: Fleet) -> tuple[FleetVehicle, ...]:
    everyone = [*fleet.uavs.items(), *fleet.ugvs.items()]
    return tuple(FleetVehicle(n, v.kind, v.body or n, v.driver, v.endpoint, v.sysid, v.options) for n, v in everyone)


def _dock_tolerances_m(config: MissionConfig, fleet: Fleet) -> dict[str, float]:
    default_m = min(0.3, 0.1 * config.separation.horizontal_m)
    return {n: v.dock_tolerance_m if v.dock_tolerance_m is not None else default_m for n, v in fleet.ugvs.items()}
