"""From a validated mission to the vehicles as planner and supervisor see them, and the space they fly in."""

from __future__ import annotations

import math

import numpy as np
import shapely

from deploy.frames import Frame
from deploy.maps import MapGeometry, Region
from deploy.mission_fleet import Fleet, UavConfig, UgvConfig
from deploy.mission_model import MissionConfig
from deploy.mission_slots import Slots, make_slots
from deploy.settings import Geofence, UavSettings, UgvSettings
from deploy.yaml_file import Document
from planner.problem import Point, Uav, Ugv


def frame_of(config: MissionConfig) -> Frame:
    """World frame to arena frame."""
    arena = config.arena
    return Frame(arena.scale, math.radians(arena.rotation_deg), arena.origin_m, arena.time_scale)


def geofence_of(config: MissionConfig, geometry: MapGeometry, frame: Frame, document: Document) -> Geofence:
    """The geofence in the arena: as given, or around the map.

    Raises:
        InputError: for a polygon that crosses itself or leaves nothing within its soft margin.
    """
    arena = config.arena
    key = ("arena", "geofence_m")
    if arena.geofence_m is None:
        x0, y0, x1, y1 = geometry.bounds
        corners = [frame.to_arena(corner) for corner in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
        box = shapely.Polygon(corners).buffer(arena.fence_margin_m, join_style="mitre")
        polygon = tuple((float(x), float(y)) for x, y in list(box.exterior.coords)[:-1])
    else:
        polygon = arena.geofence_m
        ring = shapely.Polygon(polygon)
        if not ring.is_valid or ring.area <= 0:
            reason = shapely.is_valid_reason(ring)
            raise document.error(f"{list(polygon)} is no simple polygon ({reason}); list its corners in turn", key)
    if shapely.Polygon(polygon).buffer(-arena.soft_margin_m).is_empty:
        what = f"soft_margin_m is {arena.soft_margin_m:g} m, which leaves nothing of the geofence; give less"
        raise document.error(what, ("arena", "soft_margin_m"))
    return Geofence(polygon, arena.ceiling_m, arena.soft_margin_m)


def region_of(fence: Geofence, geometry: MapGeometry, frame: Frame, margin_m: float = 0.0) -> Region:
    """Where tasks, or sites with ``margin_m`` (arena m) around them, may be: in map and soft geofence; world frame."""
    inner = shapely.Polygon(fence.polygon_m).buffer(-(fence.soft_margin_m + margin_m))
    world = shapely.transform(
        inner, lambda xy: np.array([frame.to_world((x, y)) for x, y in xy.tolist()]).reshape(-1, 2)
    )
    region = world.intersection(shapely.box(*geometry.bounds))
    shapely.prepare(region)
    return region


def altitudes_of(config: MissionConfig, fleet: Fleet, document: Document) -> list[float]:
    """Cruise altitude of each UAV, arena m.

    Raises:
        InputError: when not even one layer fits below the ceiling, or layers are closer than the separation.
    """
    layers, separation = config.arena.layers, config.separation
    least = separation.vertical_m + separation.buffer_m
    spacing = layers.spacing_m if layers.spacing_m is not None else least
    if spacing < least - 1e-9:
        what = (
            f"{spacing:g} m is less than separation.vertical_m + separation.buffer_m ({least:g} m), so layers "
            "would not separate; give at least that"
        )
        raise document.error(what, ("arena", "layers", "spacing_m"))
    room = config.arena.ceiling_m - config.arena.soft_margin_m - layers.lowest_m
    if room < 0:
        what = (
            f"{layers.lowest_m:g} m is above ceiling_m - soft_margin_m "
            f"({config.arena.ceiling_m - config.arena.soft_margin_m:g} m); lower it or raise the ceiling"
        )
        raise document.error(what, ("arena", "layers", "lowest_m"))
    for vehicle, v in fleet.ugvs.items():
        if v.pad_height_m >= layers.lowest_m:
            what = f"{layers.lowest_m:g} m is not above the docks of {vehicle!r} ({v.pad_height_m:g} m); raise it"
            raise document.error(what, ("arena", "layers", "lowest_m"))
    n = int(room / spacing + 1e-9) + 1
    return [round(layers.lowest_m + (i % n) * spacing, 6) for i in range(len(fleet.uavs))]


def slots_of(config: MissionConfig, fleet: Fleet, document: Document) -> Slots:
    """Landing and stopping places.

    Raises:
        InputError: when a spacing is less than the separation demands.
    """
    separation, arena = config.separation, config.arena
    pads, parks = separation.horizontal_m + separation.buffer_m, separation.ugv_m
    for name, given, least in (("pad", arena.pad_spacing_m, pads), ("parking", arena.parking_spacing_m, parks)):
        if given is not None and given < least - 1e-9:
            what = f"{given:g} m is less than the separation demands ({least:g} m); give at least that"
            raise document.error(what, ("arena", f"{name}_spacing_m"))
    docks = [v.offsets_m for v in fleet.ugvs.values()]
    return make_slots(len(fleet.uavs), docks, arena.pad_spacing_m or pads, arena.parking_spacing_m or parks)


def uavs_of(
    config: MissionConfig,
    fleet: Fleet,
    frame: Frame,
    depot: Point,
    altitudes_m: list[float],
    slots: Slots,
) -> tuple[tuple[Uav, ...], tuple[UavSettings, ...]]:
    """The UAVs as the planner and as the supervisor see them.

    The planner's UAV is ready when it has climbed, with the energy that is left then; its service at a task includes
    braking and speeding up.

    Raises:
        InputError: for a cruise speed above what the gate lets pass, or a battery too small to take off.
    """
    planned, flown = [], []
    for (name, v), altitude, pad in zip(fleet.uavs.items(), altitudes_m, slots.pads, strict=True):
        speed, limit = _speeds(name, v, frame, fleet)
        climb_s = (altitude / v.climb_mps + v.climb_mps / v.accel_mps2) / frame.time_scale
        energy = (v.energy_j if v.energy_j is not None else v.capacity_j) - climb_s * v.hover_power_w
        if energy <= v.reserve_fraction * v.capacity_j:
            what = (
                f"{name!r} has {energy / 1000:.3g} kJ after the climb of {climb_s:.3g} s, not above its reserve of "
                f"{v.reserve_fraction * v.capacity_j / 1000:.3g} kJ; give more energy, or less reserve"
            )
            raise fleet.error(name, "capacity_j", what)
        planned.append(
            Uav(
                id=name,
                position=depot,
                energy_j=energy,
                capacity_j=v.capacity_j,
                reserve_j=v.reserve_fraction * v.capacity_j,
                speed_mps=v.speed_mps,
                cruise_w=v.cruise_power_w,
                hover_w=v.hover_power_w,
                waiting=v.waiting,
                # Stopping at each task costs v/a against the planner's constant speed.
                service_s=v.service_s + speed / v.accel_mps2 / frame.time_scale,
                ready_s=climb_s,
            )
        )
        flown.append(
            UavSettings(
                id=name,
                body=v.body or name,
                altitude_m=altitude,
                speed_mps=speed,
                max_speed_mps=limit,
                accel_mps2=v.accel_mps2,
                climb_mps=v.climb_mps,
                descent_mps=v.descent_mps,
                pad_offset_m=pad,
                energy=config.energy.uavs,
            )
        )
    return tuple(planned), tuple(flown)


def ugvs_of(
    config: MissionConfig,
    fleet: Fleet,
    frame: Frame,
    uavs: tuple[UavSettings, ...],
    slots: Slots,
    lanes: bool,
) -> tuple[tuple[Ugv, ...], tuple[UgvSettings, ...]]:
    """The UGVs as the planner and as the supervisor see them; ``lanes``: the map has roads to keep right on.

    Raises:
        InputError: for a driving speed above what the gate lets pass.
    """
    planned, driven = [], []
    for (name, v), park in zip(fleet.ugvs.items(), slots.parks, strict=True):
        speed, limit = _speeds(name, v, frame, fleet)
        heights = [(u, u.altitude_m - v.pad_height_m) for u in uavs]
        # Braking from cruise costs v/a against the planner's constant speed; so do start and end of the descent.
        down = max(u.speed_mps / u.accel_mps2 + h / u.descent_mps + u.descent_mps / u.accel_mps2 for u, h in heights)
        up = max(h / u.climb_mps + u.climb_mps / u.accel_mps2 for u, h in heights)
        lane = lane_offset_m(config, v, lanes=lanes)
        charge_s = v.charge_s if v.charge_s is not None or v.charge_w is not None else 300.0
        planned.append(
            Ugv(
                id=name,
                path_point=None,
                energy_j=v.energy_j if v.energy_j is not None else v.capacity_j,
                capacity_j=v.capacity_j,
                speed_mps=v.speed_mps,
                drive_w=v.drive_power_w,
                idle_w=v.idle_w,
                charge_s=charge_s,
                charge_w=v.charge_w,
                dock_s=v.dock_s if v.dock_s is not None else round(down / frame.time_scale, 3),
                undock_s=v.undock_s if v.undock_s is not None else round(up / frame.time_scale, 3),
                docks=v.docks,
            )
        )
        driven.append(
            UgvSettings(
                id=name,
                body=v.body or name,
                speed_mps=speed,
                max_speed_mps=limit,
                accel_mps2=v.accel_mps2,
                lane_offset_m=lane,
                park_offset_m=park,
                pad_height_m=v.pad_height_m,
                dock_offsets_m=v.offsets_m,
                energy=config.energy.ugvs,
            )
        )
    return tuple(planned), tuple(driven)


def lane_offset_m(config: MissionConfig, v: UgvConfig, *, lanes: bool) -> float:
    """How far right of a road's middle the UGV drives, so that two can pass each other."""
    if v.lane_offset_m is not None:
        return v.lane_offset_m
    return 0.6 * config.separation.ugv_m if lanes else 0.0


def lane_clearance_m(config: MissionConfig, fleet: Fleet) -> float:
    """How far from a road's middle somebody must stand to be passed in the nearer lane."""
    lanes = [lane_offset_m(config, v, lanes=True) for v in fleet.ugvs.values()]
    return max(lanes, default=0.0) + 1.1 * config.separation.ugv_m


def _speeds(name: str, v: UavConfig | UgvConfig, frame: Frame, fleet: Fleet) -> tuple[float, float]:
    speed = frame.speed_to_arena(v.speed_mps)
    limit = v.max_speed_mps if v.max_speed_mps is not None else 1.5 * speed
    if speed > limit * (1 + 1e-9):
        what = (
            f"{name!r}: speed_mps {v.speed_mps:g} in the world is {speed:.3g} m/s in the arena, above "
            f"max_speed_mps {limit:g}; give less, or a larger arena.time_scale"
        )
        raise fleet.error(name, "speed_mps", what)
    return speed, limit
