"""``copcs-deploy simulate``: endpoints that speak the real protocols, for any program."""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import yaml

from deploy.backends import faults_of, require_ready, world_of
from deploy.cli_common import DONE, FAILED, orderly_end, show_rows
from deploy.errors import InputError
from deploy.mission import Mission, load
from deploy.mission_copy import save_copy
from deploy.wire import launch_mission, mocap_of, places_of
from sim_backends.wire.launch import WireSimulation

ENDPOINTS: dict[str, tuple[str, tuple[str, ...]]] = {
    "crazyflie": ("crazyflie_server", ()),
    "limo": ("limo_node", ()),
    "copter": ("mavlink_vehicle", ("--type", "copter")),
    "rover": ("mavlink_vehicle", ("--type", "rover")),
    "mocap": ("natnet_server", ()),
}
"""Module and options by the word on the command line."""
LOOK_S = 0.5


def simulate(target: str, options: Sequence[str]) -> int:
    """Starts one endpoint, or all of a mission; see ``cli.simulate``.

    Raises:
        InputError: when ``target`` is neither.
    """
    if target in ENDPOINTS:
        module, fixed = ENDPOINTS[target]
        root = str(Path(__file__).resolve().parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
        os.execve(sys.executable, [sys.executable, "-m", f"sim_backends.wire.{module}", *fixed, *options], env)
    if not Path(target).is_file():
        known = ", ".join(ENDPOINTS)
        raise InputError(f"{target!r} is neither one of {known} nor a mission file; give one of them", key="TARGET")
    parser = argparse.ArgumentParser(prog=f"copcs-deploy simulate {target}", exit_on_error=True)
    parser.add_argument("--save", type=Path, metavar="DIR", help="write a mission whose fleet is at the addresses")
    parser.add_argument("--seed", type=int, metavar="N", help="of the world's noise (default: the mission's)")
    chosen = parser.parse_args(options)
    mission = load(Path(target))
    require_ready(mission, "sim", "wire")
    world = world_of(mission, mission.seed if chosen.seed is None else chosen.seed)
    with orderly_end():
        simulation = launch_mission(mission, world, faults_of(mission, 3600.0))
        try:
            return _run(mission, simulation, chosen.save)
        except KeyboardInterrupt:
            return DONE
        finally:
            simulation.close()


def _run(mission: Mission, simulation: WireSimulation, save: Path | None) -> int:
    places = places_of(simulation)
    rows = []
    for name, place in places.items():
        more = [f"sysid {place.sysid}"] if place.sysid is not None else []
        more += [f"ROS domain {place.domain}"] if place.domain is not None else []
        rows.append((name, ", ".join([place.endpoint, *more])))
    if simulation.mocap_host is not None:
        rows.append(("motion capture", f"optitrack at {simulation.mocap_host}"))
    show_rows(rows)
    if save is not None:
        file = save_pointed(mission, simulation, save)
        print(f"fly it with: copcs-deploy run {file} --backend real")
    print("Ctrl-C ends the simulation", flush=True)
    while simulation.trouble() is None:
        time.sleep(LOOK_S)
    print(f"error: {simulation.trouble()}", file=sys.stderr)
    return FAILED


def save_pointed(mission: Mission, simulation: WireSimulation, folder: Path) -> Path:
    """Writes a copy of the mission whose vehicles and motion capture are those of the simulation.

    Args:
        mission: as loaded.
        simulation: of it, running.
        folder: created where missing.

    Returns:
        the mission file.

    Raises:
        InputError: when the folder cannot be written.
    """
    path = save_copy(mission, folder)
    data = yaml.safe_load(path.read_text(encoding="utf-8"))
    name = data["fleet"].get("file")
    fleet_path = folder / name if name else None
    fleet = yaml.safe_load(fleet_path.read_text(encoding="utf-8")) if fleet_path else data["fleet"]
    for vehicle, place in places_of(simulation).items():
        entry = fleet["vehicles"][vehicle]
        entry["endpoint"] = place.endpoint
        if place.sysid is not None:
            entry["sysid"] = place.sysid
        if place.domain is not None:
            known = next(v.options for v in mission.fleet if v.id == vehicle)
            entry["limo"] = {"mode": getattr(known, "mode", "differential"), "domain": place.domain}
    mocap = mocap_of(simulation)
    if mocap is not None:
        data["localisation"] = {
            **data.get("localisation", {}),
            "source": "mocap",
            "mocap": {"type": mocap.type, "hostname": mocap.hostname},
        }
    try:
        if fleet_path is not None:
            fleet_path.write_text(yaml.safe_dump(fleet, sort_keys=False), encoding="utf-8")
        path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    except OSError as error:
        raise InputError(f"cannot be written ({error.strerror}); choose another folder", file=folder) from None
    return path
