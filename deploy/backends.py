"""What executes a mission's commands: a simulated world made from the mission itself, or the real fleet."""

from __future__ import annotations

import time

from deploy.errors import InputError
from deploy.fleet import Fleet
from deploy.mission import Mission
from deploy.real_fleet import check_ready, fleet_of
from deploy.settings import UavSettings, UgvSettings
from deploy.wire import launch_mission, mocap_of, places_of
from drivers.clock import RealClock
from drivers.vehicle import Vec2
from planner.problem import Uav, Ugv, uav_power_w, ugv_power_w
from sim_backends.faults import Fault, random_faults
from sim_backends.kinematic import build
from sim_backends.world import UAV_POWER_W, UGV_POWER_W, SimUav, SimUgv, WorldConfig, line_power_w

AVAILABLE = "--backend sim --sim kinematic, --backend sim --sim wire or --backend real"


def require(backend: str, sim: str) -> None:
    """Checks that there is such a backend.

    Raises:
        InputError: saying what is available.
    """
    if backend not in ("sim", "real"):
        raise InputError(f"{backend!r} does not exist; use {AVAILABLE}", key="--backend")
    if sim not in ("kinematic", "wire"):
        raise InputError(f"{sim!r} does not exist; use {AVAILABLE}", key="--sim")


def require_ready(mission: Mission, backend: str, sim: str) -> None:
    """Checks, before anything is planned, that the mission says what its backend must know.

    Raises:
        InputError: no such backend, or the file and key that miss something.
    """
    require(backend, sim)
    if backend == "real":
        check_ready(mission)
    elif sim == "wire":
        check_ready(mission, elsewhere=True)


def connect(
    mission: Mission, backend: str = "sim", sim: str = "kinematic", seed: int | None = None, horizon_s: float = 3600.0
) -> Fleet:
    """Makes the fleet of ``mission``, not yet connected; a wire simulation is started.

    Args:
        mission: as loaded.
        backend: ``sim`` or ``real``.
        sim: ``kinematic`` or ``wire``; says nothing about real vehicles.
        seed: of the world's noise; default: the mission's.
        horizon_s: expected duration, mission s; drawn faults lie within.

    Raises:
        InputError: there is no such backend, or the mission does not say what it needs.
        SimulationError: a wire simulation cannot be started.
        DriverError: a driver's options are wrong.
    """
    require_ready(mission, backend, sim)
    if backend == "real":
        return fleet_of(mission, RealClock(), "real")
    world, faults = world_of(mission, mission.seed if seed is None else seed), faults_of(mission, horizon_s)
    if sim == "wire":
        return wire_fleet(mission, world, faults)
    kinematic = build(world, faults)
    return Fleet(
        vehicles=kinematic.vehicles,
        poses=kinematic.poses,
        clock=kinematic.clock,
        name="kinematic",
        virtual=True,
        truth=kinematic.truth,
        planner_delay_s=kinematic.planner_delay_s,
    )


def wire_fleet(mission: Mission, world: WorldConfig, faults: tuple[Fault, ...]) -> Fleet:
    """A wire simulation of ``world``, and the very drivers of the real fleet at its addresses.

    Raises:
        SimulationError, DriverError: as ``connect``.
    """
    clock = RealClock()
    simulation = launch_mission(mission, world, faults, zero_s=time.monotonic() - clock.now())
    try:
        fleet = fleet_of(mission, clock, "wire", places_of(simulation), mocap_of(simulation))
    except BaseException:
        simulation.close()
        raise
    fleet.truth, fleet.planner_delay_s = simulation.truth, simulation.planner_delay_s
    fleet.trouble, fleet.end = simulation.trouble, simulation.close
    return fleet


def faults_of(mission: Mission, horizon_s: float) -> tuple[Fault, ...]:
    """The mission's scripted faults and those that it has drawn; ``horizon_s`` in mission s."""
    drawn: tuple[Fault, ...] = ()
    settings = mission.settings
    if mission.random_faults is not None:
        drawn = random_faults(
            mission.random_faults.seed,
            mission.random_faults.count,
            horizon_s * settings.frame.time_scale,
            [u.id for u in settings.uavs],
            [g.id for g in settings.ugvs],
            speed_mps=settings.uavs[0].speed_mps,
            time_scale=settings.frame.time_scale,
        )
    return (*mission.faults, *drawn)


def world_of(mission: Mission, seed: int) -> WorldConfig:
    """The simulated world of a mission: its fleet at the depot, its limits for the audit, noise that fits its size."""
    s = mission.settings
    uavs, ugvs = mission.problem.uavs, mission.problem.ugvs
    # Vehicles are as large as the distance they must keep from each other says: 3 m for a field, 0.3 m for a lab.
    size_m = s.separation.horizontal_m
    depot = mission.problem.depot_index
    return WorldConfig(
        uavs=tuple(_uav(u, p, s.pad_m(i, depot), size_m) for i, (u, p) in enumerate(zip(s.uavs, uavs, strict=True))),
        ugvs=tuple(_ugv(g, p, s.park_m(i, depot), size_m) for i, (g, p) in enumerate(zip(s.ugvs, ugvs, strict=True))),
        scale=s.frame.scale,
        time_scale=s.frame.time_scale,
        seed=seed,
        step_s=0.1 if size_m >= 1.5 else 0.02,
        pose_noise_m=min(0.01, 0.003 * size_m),
        occlusions_per_s=0.001,
        telemetry_drop=0.01,
        command_drop=0.01,
        gust_mps=0.02 * max(u.speed_mps for u in s.uavs),
        dock_tolerance_m=min(mission.dock_tolerance_m.values(), default=0.3),
        dock_range_m=min(5.0, 1.7 * size_m),
        estimate_mps=min(2.0, size_m),
        collision_m=min(0.5, size_m / 3),
        separation_h_m=s.separation.horizontal_m,
        separation_v_m=s.separation.vertical_m,
        separation_ugv_m=s.separation.ugv_m,
        fence_m=s.geofence.polygon_m,
        ceiling_m=s.geofence.ceiling_m,
    )


def _uav(u: UavSettings, p: Uav, start_m: Vec2, size_m: float) -> SimUav:
    paper = (p.hover_w, p.cruise_w) == (uav_power_w(0.0), uav_power_w(p.speed_mps))
    return SimUav(
        id=u.id,
        body=u.body,
        start_m=start_m,
        max_speed_mps=u.max_speed_mps,
        accel_mps2=u.accel_mps2,
        climb_mps=u.climb_mps,
        descent_mps=u.descent_mps,
        tracking_noise_m=min(0.1, 0.03 * size_m),
        dock_noise_m=min(0.03, 0.01 * size_m),
        drift_mps=min(0.1, 0.03 * size_m),
        power_w=UAV_POWER_W if paper else line_power_w(p.hover_w, p.cruise_w, p.speed_mps),
        capacity_j=p.capacity_j,
        # the planner's UAV begins when it has climbed, with what is left then
        energy_j=min(p.capacity_j, p.energy_j + p.ready_s * p.hover_w),
    )


def _ugv(g: UgvSettings, p: Ugv, start_m: Vec2, size_m: float) -> SimUgv:
    return SimUgv(
        id=g.id,
        body=g.body,
        start_m=start_m,
        max_speed_mps=g.max_speed_mps,
        accel_mps2=g.accel_mps2,
        tracking_noise_m=min(0.05, 0.01 * size_m),
        power_w=UGV_POWER_W if p.drive_w == ugv_power_w(p.speed_mps) else (p.drive_w,),
        idle_w=p.idle_w,
        capacity_j=p.capacity_j,
        energy_j=p.energy_j,
        charge_s=p.charge_s,
        charge_w=p.charge_w,
        pad_height_m=g.pad_height_m,
        dock_offsets_m=g.dock_offsets_m,
    )
