"""A small world to test the pure core in: one straight road along the x axis, frame 1:1, everything by keyword.

The depot is at (0, 0), path point i at (100 * (i + 1), 0), task m at (100 * (m + 1), 50). UAV i cruises at 10 + 6 i m
and lands 6 i m north of any site, UGV j parks 4 j m south of it. Speeds are round: UAVs 10 m/s, UGVs 5 m/s.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from deploy import supervisor
from deploy.frames import Frame
from deploy.observation import Observation
from deploy.settings import Geofence, Monitors, Replanning, Separation, Settings, UavSettings, UgvSettings
from deploy.state import State, Track, UavState, UgvState
from deploy.turn import Turn
from drivers.vehicle import Pose, VehicleState
from planner.plan import Action, Move, Plan, Recharge, Visit
from planner.problem import Problem, Uav, Ugv
from planner.roads import RoadError
from planner.schedule import evaluate

STEP_M = 100.0
FENCE = ((-60.0, -60.0), (1000.0, -60.0), (1000.0, 200.0), (-60.0, 200.0))


class LineRoads:
    """The x axis is the only road. ``cut_beyond_m``: from there on it is closed."""

    def __init__(self, n_points: int, cut_beyond_m: float = np.inf) -> None:
        self.sites = np.array([*((STEP_M * (i + 1), 0.0) for i in range(n_points)), (0.0, 0.0)])
        self.distance_m = np.abs(self.sites[:, None, 0] - self.sites[None, :, 0])
        self.cut_beyond_m = cut_beyond_m

    def distances_from(self, point):
        return np.abs(self.sites[:, 0] - point[0])

    def route(self, start, site):
        if self.sites[site][0] > self.cut_beyond_m:
            raise RoadError(f"no road leads to site {site}")
        return np.array([(start[0], 0.0), tuple(self.sites[site])])

    def offset_m(self, point):
        return abs(float(point[1]))


def problem(
    *,
    n_uavs: int = 2,
    n_ugvs: int = 1,
    n_tasks: int = 3,
    n_points: int = 3,
    capacity_j: float = 60_000.0,
    reserve_j: float = 6_000.0,
    service_s: float = 0.0,
    charge_s: float | None = 60.0,
    charge_w: float | None = None,
    docks: int = 2,
    uav: Mapping[str, Any] | None = None,
    ugv: Mapping[str, Any] | None = None,
) -> Problem:
    """The team at the depot, UAVs full. ``uav`` and ``ugv`` give further members of every UAV and UGV."""
    return Problem(
        depot=(0.0, 0.0),
        tasks=np.array([(STEP_M * (m + 1), 50.0) for m in range(n_tasks)]).reshape(-1, 2),
        path_points=LineRoads(n_points).sites[:-1],
        road_distance_m=LineRoads(n_points).distance_m,
        uavs=tuple(
            Uav(
                **{
                    "id": f"uav{i}",
                    "position": (0.0, 0.0),
                    "energy_j": capacity_j,
                    "capacity_j": capacity_j,
                    "reserve_j": reserve_j,
                    "speed_mps": 10.0,
                    "cruise_w": 200.0,
                    "hover_w": 230.0,
                    "waiting": "hover",
                    "service_s": service_s,
                    **(uav or {}),
                }
            )
            for i in range(n_uavs)
        ),
        ugvs=tuple(
            Ugv(
                **{
                    "id": f"ugv{j}",
                    "energy_j": 1e6,
                    "capacity_j": 1e6,
                    "speed_mps": 5.0,
                    "drive_w": 2000.0,
                    "charge_s": charge_s if charge_w is None else None,
                    "charge_w": charge_w,
                    "docks": docks,
                    **(ugv or {}),
                }
            )
            for j in range(n_ugvs)
        ),
    )


def settings(
    *,
    n_uavs: int = 2,
    n_ugvs: int = 1,
    of: Problem | None = None,
    frame: Frame | None = None,
    fence: Sequence[tuple[float, float]] = FENCE,
    ceiling_m: float = 60.0,
    soft_margin_m: float = 5.0,
    separation: Separation | None = None,
    monitors: Mapping[str, Any] | None = None,
    replanning: Mapping[str, Any] | None = None,
    uav: Mapping[str, Any] | None = None,
    ugv: Mapping[str, Any] | None = None,
    failsafe: Mapping[str, str] | None = None,
    roads: LineRoads | None = None,
) -> Settings:
    """Settings for ``of`` (default: ``problem`` of that team). ``uav``, ``ugv``: other values for every vehicle;
    ``monitors``, ``replanning``: other thresholds.
    """
    of = of if of is not None else problem(n_uavs=n_uavs, n_ugvs=n_ugvs)
    return Settings(
        frame=frame or Frame(),
        geofence=Geofence(tuple(fence), ceiling_m, soft_margin_m),
        separation=separation or Separation(),
        monitors=Monitors(**(monitors or {})),
        replanning=Replanning(**(replanning or {})),
        uavs=tuple(
            replace(
                UavSettings(
                    id=model.id,
                    body=f"body-{model.id}",
                    altitude_m=10.0 + 6.0 * i,
                    speed_mps=10.0,
                    max_speed_mps=12.0,
                    accel_mps2=2.0,
                    climb_mps=2.0,
                    descent_mps=1.5,
                    pad_offset_m=(0.0, 6.0 * i),
                    energy="virtual",
                ),
                **(uav or {}),
            )
            for i, model in enumerate(of.uavs)
        ),
        ugvs=tuple(
            replace(
                UgvSettings(
                    id=model.id,
                    body=f"body-{model.id}",
                    speed_mps=5.0,
                    max_speed_mps=6.0,
                    accel_mps2=1.0,
                    lane_offset_m=0.0,
                    park_offset_m=(0.0, -4.0 * j),
                    pad_height_m=0.5,
                    dock_offsets_m=((-1.0, 0.0), (1.0, 0.0)),
                    energy="virtual",
                ),
                **(ugv or {}),
            )
            for j, model in enumerate(of.ugvs)
        ),
        problem=of,
        roads=roads or LineRoads(len(of.path_points)),
        failsafe=dict(failsafe or {}),
    )


ACTIONS: tuple[Action, ...] = (Move(0, 0), Visit(0, 0), Visit(1, 1), Recharge(0, 0), Visit(0, 2))
"""A plan for the default team: UAV 0 visits, recharges at path point 0, visits again; UAV 1 visits once."""


def plan(of: Settings, actions: Sequence[Action] = ACTIONS) -> Plan:
    """A plan with its schedule."""
    return Plan(tuple(actions), evaluate(of.problem, tuple(actions)), "test", 0.1)


def state(of: Settings, actions: Sequence[Action] = ACTIONS, **members: Any) -> State:
    """The supervisor's first state for ``actions``; ``members`` replace any of its members."""
    return replace(supervisor.initial(of, plan(of, actions)), **members)


def pose(body: str, at: tuple[float, float, float], stamp_s: float = 0.0, yaw_rad: float = 0.0) -> Pose:
    """A pose of a vehicle id or body name."""
    return Pose(body if body.startswith("body-") else f"body-{body}", at, yaw_rad, stamp_s)


def report(vehicle: str, stamp_s: float = 0.0, **members: Any) -> VehicleState:
    """Telemetry of a healthy, armed vehicle; ``members`` replace any of its members."""
    return VehicleState(**{"vehicle": vehicle, "stamp_s": stamp_s, "link": True, "armed": True, **members})


def observation(now_s: float = 0.0, **members: Any) -> Observation:
    """An observation of nothing but ``members``."""
    return Observation(now_s=now_s, **members)


def seen(of: Settings, now_s: float, places: Mapping[str, tuple[float, float, float]], **members: Any) -> Observation:
    """Everybody in ``places`` (by id) reports and is seen there right now; who is above 1 m is airborne.

    ``members`` replace any member of the observation.
    """
    known = {c.id for c in (*of.uavs, *of.ugvs)}
    assert set(places) <= known, set(places) - known
    return replace(
        Observation(
            now_s=now_s,
            poses=tuple(pose(v, at, now_s) for v, at in places.items()),
            vehicles=tuple(report(v, now_s, airborne=at[2] > 1.0) for v, at in places.items()),
        ),
        **members,
    )


def track(at: tuple[float, float, float] = (0.0, 0.0, 0.0), stamp_s: float = 0.0, **members: Any) -> Track:
    """A trusted track at rest."""
    return replace(Track(at, 0.0, stamp_s, 0.0, at, stamp_s, stamp_s), **members)


def uav(
    index: int = 0, at: tuple[float, float, float] = (0.0, 0.0, 0.0), now_s: float = 0.0, **members: Any
) -> UavState:
    """A healthy UAV seen at ``at`` just now; on the pad with 60 kJ unless ``members`` say otherwise."""
    first = UavState(index, track=track(at, now_s), telemetry=report(f"uav{index}", now_s), energy_j=60_000.0)
    return replace(first, **{"energy_s": now_s, **members})


def ugv(
    index: int = 0, at: tuple[float, float, float] = (0.0, 0.0, 0.0), now_s: float = 0.0, **members: Any
) -> UgvState:
    """A healthy UGV seen at ``at`` just now; parked with 1 MJ unless ``members`` say otherwise."""
    first = UgvState(index, track=track(at, now_s), telemetry=report(f"ugv{index}", now_s), energy_j=1e6)
    return replace(first, **{"energy_s": now_s, "progress_s": now_s, **members})


def turn(
    of: Settings,
    *,
    now_s: float = 0.0,
    uavs: Sequence[UavState] | None = None,
    ugvs: Sequence[UgvState] | None = None,
    actions: Sequence[Action] = ACTIONS,
    seen: Observation | None = None,
    **members: Any,
) -> Turn:
    """A turn's working copy: ``uavs`` and ``ugvs`` replace the first state's, ``members`` any other part of it."""
    first = state(of, actions, **members)
    return Turn(
        of,
        seen if seen is not None else Observation(now_s),
        first,
        list(first.uavs if uavs is None else uavs),
        list(first.ugvs if ugvs is None else ugvs),
        first.plan,
        list(first.visited),
    )
