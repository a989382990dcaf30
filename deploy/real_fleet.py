"""The drivers of a mission's vehicles, built from the fleet file, or from other addresses for the same vehicles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from deploy.errors import InputError
from deploy.fleet import Fleet
from deploy.mission import FleetVehicle, Mission
from drivers.clock import Clock
from drivers.crazyflie_options import CrazyflieOptions
from drivers.crazyflie_radio_budget import radio_checks
from drivers.limits import Pads, PoseBook, UavLimits, UgvLimits
from drivers.limo import Limo, LimoOptions
from drivers.mavlink_options import MavlinkOptions
from drivers.mocap import Mocap, MocapOptions
from drivers.vehicle import PoseSource, SelfCheck, Vehicle


@dataclass(frozen=True)
class Place:
    """Where a vehicle is reached, where that is not what the fleet file says.

    Attributes:
        endpoint: as in a fleet file.
        sysid: MAVLink system id.
        domain: ROS domain; None: the driver's own choice.
    """

    endpoint: str
    sysid: int | None = None
    domain: int | None = None


def fleet_of(
    mission: Mission,
    clock: Clock,
    name: str,
    places: Mapping[str, Place] | None = None,
    mocap: MocapOptions | None = None,
) -> Fleet:
    """The fleet of a mission behind its drivers, not yet connected.

    Args:
        mission: as loaded.
        clock: of the loop.
        name: of the backend, for recordings.
        places: other addresses than the fleet file's, by vehicle id.
        mocap: another motion-capture system than the mission's.

    Raises:
        InputError, DriverError: as ``build_vehicles``.
    """
    vehicles = build_vehicles(mission, clock, places)
    poses = build_poses(mission, vehicles, clock, mocap)
    assert mission.localisation is not None  # build_vehicles has checked it

    def more_checks() -> Sequence[SelfCheck]:
        crazyflies = (v for v in mission.fleet if v.driver == "crazyflie")
        uris = {v.id: (places[v.id].endpoint if places else v.endpoint) or "" for v in crazyflies}
        about_poses = poses.checks() if isinstance(poses, Mocap) else ()
        return (*radio_checks(uris), *about_poses)

    return Fleet(
        vehicles=vehicles,
        poses=poses,
        clock=clock,
        name=name,
        virtual=False,
        bodies={v.body: v.id for v in mission.fleet},
        connect_s=mission.localisation.connect_s,
        more_checks=more_checks,
    )


def build_vehicles(mission: Mission, clock: Clock, places: Mapping[str, Place] | None = None) -> dict[str, Vehicle]:
    """The drivers by vehicle id, UAVs first; nothing is connected yet.

    Args:
        mission: as loaded.
        clock: of the loop.
        places: other addresses than the fleet file's, by vehicle id; default: the fleet file's.

    Raises:
        InputError: a vehicle has no driver or no endpoint, or the mission does not say where vehicles are localised;
            named by file and key.
        DriverError: an option of a driver is wrong.
    """
    check_ready(mission, elsewhere=places is not None)
    book = PoseBook()
    return {v.id: _vehicle(mission, v, clock, book, (places or {}).get(v.id)) for v in mission.fleet}


def check_ready(mission: Mission, *, elsewhere: bool = False) -> None:
    """Checks that the mission says all that drivers must know.

    Args:
        mission: as loaded.
        elsewhere: its vehicles are not reached at the fleet file's addresses.

    Raises:
        InputError: as ``build_vehicles``.
    """
    for vehicle in mission.fleet:
        if vehicle.driver is None:
            what = f"{vehicle.id!r} has no driver; give crazyflie, limo or mavlink to fly it by its own protocol"
            raise mission.fleet_source.error(vehicle.id, "driver", what)
        if vehicle.endpoint is None and not elsewhere:
            what = f"{vehicle.id!r} has no endpoint; give the address of the real vehicle"
            raise mission.fleet_source.error(vehicle.id, "endpoint", what)
        if vehicle.driver == "crazyflie" and vehicle.kind == "ugv":
            raise mission.fleet_source.error(vehicle.id, "driver", "a Crazyflie is no UGV; give limo or mavlink")
        if vehicle.driver == "limo" and vehicle.kind == "uav":
            raise mission.fleet_source.error(vehicle.id, "driver", "a Limo is no UAV; give crazyflie or mavlink")
        if vehicle.driver != "mavlink" and mission.geo is not None:
            what = (
                f"{vehicle.id!r} has driver {vehicle.driver}, which knows no GPS, but localisation.source is vehicles; "
                "use source: mocap"
            )
            raise mission.fleet_source.error(vehicle.id, "driver", what)
    if mission.localisation is None:
        what = "is missing; say who tells where the vehicles are: source: mocap with mocap.type and mocap.hostname, or "
        raise InputError(what + "source: vehicles (GPS)", file=mission.path, key="localisation")


def build_poses(
    mission: Mission, vehicles: Mapping[str, Vehicle], clock: Clock, options: MocapOptions | None = None
) -> PoseSource:
    """Who tells where the vehicles are: motion capture, or the vehicles themselves.

    Args:
        mission: with ``localisation``; see ``check_ready``.
        vehicles: by id.
        clock: of the loop.
        options: another motion-capture system than the mission's.
    """
    if mission.geo is not None:
        from drivers.mavlink import TelemetryPoses  # noqa: PLC0415  loads pymavlink
        from drivers.mavlink_vehicle import MavlinkVehicle  # noqa: PLC0415

        return TelemetryPoses([v for v in vehicles.values() if isinstance(v, MavlinkVehicle)])
    if options is None:
        assert mission.localisation is not None and mission.localisation.mocap is not None  # checked on loading
        options = mission.localisation.mocap
    return Mocap(options, [v.body for v in mission.fleet], clock)


def _vehicle(mission: Mission, vehicle: FleetVehicle, clock: Clock, book: PoseBook, place: Place | None) -> Vehicle:
    """One driver. SDKs load here, so that simulated missions need not wait for them."""
    endpoint = place.endpoint if place is not None else vehicle.endpoint
    assert endpoint is not None
    options = vehicle.options
    # where the fleet file says nothing about it, a link is lost when the mission's monitors say so, and not earlier
    lost_s = mission.settings.monitors.link_lost_s
    if vehicle.driver == "crazyflie":
        from drivers.crazyflie import Crazyflie  # noqa: PLC0415

        crazyflie = options if isinstance(options, CrazyflieOptions) else CrazyflieOptions(telemetry_s=lost_s)
        return Crazyflie(
            vehicle.id, endpoint, body=vehicle.body, limits=uav_limits(mission, vehicle.id), pads=pads_of(mission),
            book=book, clock=clock, options=crazyflie,
        )  # fmt: skip
    if vehicle.driver == "limo":
        limo = options if isinstance(options, LimoOptions) else LimoOptions(link_stale_s=lost_s)
        if place is not None and place.domain is not None:
            limo = replace(limo, domain=place.domain)
        return Limo(
            vehicle.id, endpoint, body=vehicle.body, limits=ugv_limits(mission, vehicle.id), book=book, clock=clock,
            options=limo,
        )  # fmt: skip
    from drivers.mavlink import MavlinkUav, MavlinkUgv  # noqa: PLC0415

    mavlink = options if isinstance(options, MavlinkOptions) else MavlinkOptions(link_timeout_s=lost_s)
    if mavlink.signing_key_file is not None:
        mavlink = replace(mavlink, signing_key_file=_beside(mission, mavlink.signing_key_file))
    sysid = place.sysid if place is not None else vehicle.sysid
    if vehicle.kind == "uav":
        return MavlinkUav(
            vehicle.id, endpoint, body=vehicle.body, sysid=sysid or 1, limits=uav_limits(mission, vehicle.id),
            pads=pads_of(mission), book=book, frame=mission.geo, clock=clock, options=mavlink,
        )  # fmt: skip
    return MavlinkUgv(
        vehicle.id, endpoint, body=vehicle.body, sysid=sysid or 1, limits=ugv_limits(mission, vehicle.id), book=book,
        frame=mission.geo, clock=clock, options=mavlink,
    )  # fmt: skip


def _beside(mission: Mission, path: Path) -> Path:
    """A file that the fleet names, relative to the file in which the fleet stands."""
    return mission.fleet_source.document.path.parent / path


def uav_limits(mission: Mission, vehicle: str) -> UavLimits:
    """What a UAV's driver never exceeds."""
    u = next(u for u in mission.settings.uavs if u.id == vehicle)
    ceiling_m = mission.settings.geofence.ceiling_m
    return UavLimits(u.max_speed_mps, u.accel_mps2, u.climb_mps, u.descent_mps, ceiling_m)


def ugv_limits(mission: Mission, vehicle: str) -> UgvLimits:
    """What a UGV's driver never exceeds."""
    g = next(g for g in mission.settings.ugvs if g.id == vehicle)
    return UgvLimits(g.max_speed_mps, g.accel_mps2)


def pads_of(mission: Mission) -> dict[str, Pads]:
    """The docks by UGV id."""
    return {
        g.id: Pads(g.body, g.dock_offsets_m, g.pad_height_m, mission.dock_tolerance_m[g.id])
        for g in mission.settings.ugvs
    }
