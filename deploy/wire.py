"""A mission as a wire simulation: which endpoint plays which of its vehicles, and where its drivers reach them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from deploy.mission import FleetVehicle, Mission
from deploy.real_fleet import Place
from drivers.mocap_options import MocapOptions
from sim_backends.faults import Fault
from sim_backends.wire.endpoints import CrazyflieEndpoint, Endpoint, LimoEndpoint, MavlinkEndpoint
from sim_backends.wire.launch import WireSimulation, launch
from sim_backends.world import WorldConfig


def launch_mission(
    mission: Mission, world: WorldConfig, faults: Sequence[Fault], *, zero_s: float | None = None
) -> WireSimulation:
    """Starts the simulation of a mission's fleet.

    Args:
        mission: whose vehicles all have a driver.
        world: made of it.
        faults: that happen.
        zero_s: ``time.monotonic()`` at which the truth's times begin.

    Raises:
        SimulationError: as ``launch``.
    """
    return launch(world, faults, endpoints_of(mission), mocap=mission.geo is None, zero_s=zero_s)


def endpoints_of(mission: Mission) -> tuple[Endpoint, ...]:
    """Who plays each vehicle; a fleet file's own addresses are the real vehicles' and not used."""
    return tuple(_endpoint(mission, v) for v in mission.fleet)


def _endpoint(mission: Mission, vehicle: FleetVehicle) -> Endpoint:
    if vehicle.driver == "crazyflie":
        return CrazyflieEndpoint(vehicle.id)
    if vehicle.driver == "limo":
        mode = getattr(vehicle.options, "mode", None)
        return LimoEndpoint(vehicle.id, mode=mode or "differential")
    uav = vehicle.kind == "uav"
    sysid = vehicle.sysid or 1 + [v.id for v in mission.fleet].index(vehicle.id)
    origin = None
    if mission.geo is not None:
        lat, lon = mission.geo.to_globe((0.0, 0.0))
        origin = (lat, lon, math.degrees(mission.geo.rotation_rad))
    # one of each dialect: PX4 is what most research copters fly, ArduPilot what most rovers drive
    return MavlinkEndpoint(
        vehicle.id, "copter" if uav else "rover", "px4" if uav else "ardupilot", sysid=sysid, origin=origin
    )


def places_of(simulation: WireSimulation) -> dict[str, Place]:
    """Where drivers reach each vehicle of a simulation."""
    return {name: Place(a.endpoint, a.sysid, a.domain) for name, a in simulation.addresses.items()}


def mocap_of(simulation: WireSimulation) -> MocapOptions | None:
    """How its motion capture is reached; None where it has none."""
    return None if simulation.mocap_host is None else MocapOptions("optitrack", hostname=simulation.mocap_host)
