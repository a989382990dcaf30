"""The command gate: the last check of every command before it is sent. Pure, default deny.

It trusts nothing but observations and its own memory of what it let pass; it does not read the supervisor's state.
What makes things safer (hold, land, stop, disarm) always passes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import shapely

from deploy.fence import line_of, margin_m, path_inside
from deploy.flightpath import TimedPath, along, column, conflict, resting, straight
from deploy.observation import Observation, Refusal
from deploy.settings import Settings, UavSettings, UgvSettings
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    StopMotors,
    TakeOff,
    Vec2,
    Vec3,
    VehicleState,
)

TINY = 1e-6
DOCK_ASIDE = 3.0  # of the arrival distance: a dock further aside is not beneath the UAV


@dataclass(frozen=True, slots=True)
class GateState:
    """What the gate remembers: newest poses by body, newest snapshots by vehicle, each one's last path."""

    poses: Mapping[str, Pose] = field(default_factory=lambda: MappingProxyType({}))
    vehicles: Mapping[str, VehicleState] = field(default_factory=lambda: MappingProxyType({}))
    paths: Mapping[str, TimedPath] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class Verdict:
    """The gate's next state, the commands to send, and those refused with reasons."""

    state: GateState
    accepted: tuple[Command, ...]
    refused: tuple[Refusal, ...]


def judge(settings: Settings, state: GateState, observation: Observation, commands: tuple[Command, ...]) -> Verdict:
    """Judges the commands of one turn, in order: an accepted one counts when the next is judged."""
    state = _remember(state, observation)
    accepted: list[Command] = []
    refused: list[Refusal] = []
    for command in commands:
        path, reason = _check(settings, state, observation.now_s, command)
        if reason is not None:
            refused.append(Refusal(command, reason))
            continue
        accepted.append(_gently(settings, command))
        if path is not None:
            state = replace(state, paths=MappingProxyType({**state.paths, command.vehicle: path}))
    return Verdict(state, tuple(accepted), tuple(refused))


def _remember(state: GateState, observation: Observation) -> GateState:
    finite = (p for p in observation.poses if all(map(math.isfinite, (*p.position_m, p.yaw_rad, p.stamp_s))))
    poses = {**state.poses, **{p.body: p for p in finite}}
    vehicles = {**state.vehicles, **{v.vehicle: v for v in observation.vehicles}}
    return replace(state, poses=MappingProxyType(poses), vehicles=MappingProxyType(vehicles))


def _gently(settings: Settings, command: Command) -> Command:
    """A landing is never refused: one at a speed that the UAV does not have gets the UAV's own."""
    if not isinstance(command, Land):
        return command
    limit_mps = next(u.descent_mps for u in settings.uavs if u.id == command.vehicle)
    return command if 0 < command.speed_mps <= limit_mps + TINY else replace(command, speed_mps=limit_mps)


def _fresh(stamp_s: float, now_s: float, limit_s: float) -> bool:
    """Whether something is from about now; false for a stamp that is not a number."""
    return abs(now_s - stamp_s) <= limit_s


def _room(settings: Settings, state: GateState, now_s: float, uav: UavSettings) -> tuple[TimedPath, ...]:
    """What a UAV may take of the air: its path while under way, and then the place where it is seen as well."""
    path, pose, vehicle = state.paths.get(uav.id), state.poses.get(uav.body), state.vehicles.get(uav.id)
    down = vehicle is not None and not vehicle.airborne
    if path is not None:
        begun_s = path.knots[0][0]
        down = down and vehicle is not None and vehicle.stamp_s > begun_s + 1.0
        sinks = path.end_m[2] < path.knots[0][3]
        if now_s <= path.rests_from_s and not (down and sinks):
            return (path,)
    if down or (path is None and vehicle is None):
        return ()
    if pose is None:
        return () if path is None else (path,)
    here = resting(pose.position_m, now_s)
    # One told to stay is where it is seen: when it was told, its pose may have been false (two bodies swapped), and
    # it does not go back there.
    if path is None or path.end_m == path.knots[0][1:]:
        return (here,)
    return (here, straight(pose.position_m, path.end_m, now_s, uav.speed_mps, uav.accel_mps2))


def _check(settings: Settings, state: GateState, now_s: float, command: Command) -> tuple[TimedPath | None, str | None]:
    """The path that the command commits the vehicle to (None: none), and why it is refused (None: it is not)."""
    uav = next((u for u in settings.uavs if u.id == command.vehicle), None)
    ugv = next((g for g in settings.ugvs if g.id == command.vehicle), None)
    config: UavSettings | UgvSettings | None = uav if uav is not None else ugv
    if config is None:
        return None, f"{command.vehicle} is not in the fleet"
    pose = state.poses.get(config.body)
    if isinstance(command, StopMotors | Hold | Disarm) or (uav is not None and isinstance(command, Land)):
        return _safer(command, pose, uav, now_s), None
    vehicle = state.vehicles.get(command.vehicle)
    if vehicle is None or not _fresh(vehicle.stamp_s, now_s, settings.monitors.telemetry_stale_s):
        return None, "its telemetry is stale"
    if vehicle.locked or vehicle.tumbled:
        return None, "it is locked or tumbled"
    if isinstance(command, Arm):
        return None, None
    if not vehicle.armed:
        return None, "it is not armed"
    if pose is None or not _fresh(pose.stamp_s, now_s, settings.monitors.pose_stale_s):
        return None, "its pose is stale"
    if uav is not None and isinstance(command, TakeOff | GoTo | Dock):
        return _check_flight(settings, state, now_s, command, uav, pose)
    if ugv is not None and isinstance(command, Drive):
        return _check_drive(settings, state, now_s, command, ugv, pose)
    return None, f"{type(command).__name__} is not for this kind of vehicle"


def _safer(command: Command, pose: Pose | None, uav: UavSettings | None, now_s: float) -> TimedPath | None:
    """The path of a vehicle that stops: it rests where it was seen last, or sinks to the floor there."""
    if pose is None:
        return None
    if uav is not None and isinstance(command, Land):
        x, y, _ = pose.position_m
        return straight(pose.position_m, (x, y, 0.0), now_s, uav.descent_mps, uav.accel_mps2)
    return resting(pose.position_m, now_s)


def _check_flight(
    settings: Settings, state: GateState, now_s: float, command: TakeOff | GoTo | Dock, uav: UavSettings, pose: Pose
) -> tuple[TimedPath | None, str | None]:
    start = pose.position_m
    top_m = 0.0
    match command:
        case TakeOff(altitude_m=altitude_m):
            goal, limit_mps = (start[0], start[1], altitude_m), uav.climb_mps
        case GoTo(position_m=position_m):
            goal, limit_mps = position_m, uav.max_speed_mps
        case _:
            top_m = command.abort_altitude_m
            onto = next((g for g in settings.ugvs if g.id == command.onto), None)
            pad = state.poses.get(onto.body) if onto is not None else None
            if onto is None or not 0 <= command.dock < len(onto.dock_offsets_m):
                return None, f"there is no dock {command.dock} on {command.onto}"
            if pad is None or not _fresh(pad.stamp_s, now_s, settings.monitors.pose_stale_s):
                return None, f"the pose of {command.onto} is stale"
            aside_m = math.dist(start[:2], dock_m(pad, onto.dock_offsets_m[command.dock]))
            if aside_m > DOCK_ASIDE * settings.monitors.arrival_m:
                return None, f"dock {command.dock} of {command.onto} is {aside_m:.2f} m aside, not beneath it"
            if top_m < onto.pad_height_m:
                return None, f"it would abort to {top_m:.2f} m, below the dock at {onto.pad_height_m:g} m"
            goal, limit_mps = (start[0], start[1], onto.pad_height_m), uav.descent_mps
    if not all(map(math.isfinite, (*goal, top_m, command.speed_mps))):
        return None, "a number is not finite"
    if not 0 < command.speed_mps <= limit_mps + TINY:
        return None, f"speed {command.speed_mps:g} m/s is not within 0 and {limit_mps:g} m/s"
    if (reason := _outside(settings, start, goal, max(goal[2], top_m))) is not None:
        return None, reason
    path = straight(start, goal, now_s, command.speed_mps, uav.accel_mps2)
    separation = settings.separation
    for other in settings.uavs:
        if other.id == uav.id:
            continue
        for theirs in _room(settings, state, now_s, other):
            # Without the planning buffer: what dispatch planned with it must not fail here for a few centimetres.
            found = conflict(path, theirs, now_s, separation.horizontal_m, separation.vertical_m, slop_s=0.0)
            if found is not None:
                return None, (
                    f"it would come as near as {found.horizontal_m:.2f} m and {found.vertical_m:.2f} m in height"
                    f" to {other.id} in {found.time_s - now_s:.1f} s"
                )
    if isinstance(command, Dock):
        return column(goal, max(start[2], top_m), now_s), None  # it may abort and climb back
    return path, None


def dock_m(pad: Pose, offset_m: Vec2) -> Vec2:
    """Where a dock is, by the pose of its UGV."""
    c, s = math.cos(pad.yaw_rad), math.sin(pad.yaw_rad)
    x, y, _ = pad.position_m
    return (x + c * offset_m[0] - s * offset_m[1], y + s * offset_m[0] + c * offset_m[1])


def _outside(settings: Settings, start: Vec3, goal: Vec3, top_m: float) -> str | None:
    """Why the straight path leaves the geofence; a way back in from outside is allowed."""
    fence = settings.geofence
    if top_m > fence.ceiling_m + TINY or goal[2] < 0:
        return f"altitude {top_m if goal[2] >= 0 else goal[2]:.2f} m is not within 0 and {fence.ceiling_m:g} m"
    a, b = start[:2], goal[:2]
    if margin_m(fence.polygon_m, *b) < 0:
        return f"({b[0]:.2f}, {b[1]:.2f}) m is outside the geofence"
    if margin_m(fence.polygon_m, *a) >= 0 and not path_inside(fence.polygon_m, (a, b)):
        return f"the way to ({b[0]:.2f}, {b[1]:.2f}) m leaves the geofence"
    return None


def _check_drive(
    settings: Settings, state: GateState, now_s: float, command: Drive, ugv: UgvSettings, pose: Pose
) -> tuple[TimedPath | None, str | None]:
    points: tuple[Vec2, ...] = command.path_m
    if len(points) < 2 or not all(math.isfinite(c) for p in points for c in p):
        return None, "a drive needs at least two points with finite numbers"
    if not 0 < command.speed_mps <= ugv.max_speed_mps + TINY:
        return None, f"speed {command.speed_mps:g} m/s is not within 0 and {ugv.max_speed_mps:g} m/s"
    if not path_inside(settings.geofence.polygon_m, points):
        return None, "the drive leaves the geofence"
    off_m = float(shapely.distance(line_of(points), shapely.Point(pose.position_m[:2])))
    if off_m > settings.monitors.ugv_off_road_m:
        return None, f"the drive passes {off_m:.2f} m away from the vehicle"
    return along(points, 0.0, now_s, command.speed_mps), None
