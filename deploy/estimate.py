"""From observations to estimates: which poses to trust, and how much energy is left."""

from __future__ import annotations

import math
from dataclasses import replace

from deploy.settings import Monitors, Settings, UavSettings, UgvSettings
from deploy.state import AIRBORNE, Track, UavPhase, UavState, UgvPhase, UgvState
from drivers.vehicle import Pose, VehicleState
from planner.problem import Uav

SPEED_SMOOTHING_S = 0.5


def first_track(pose: Pose) -> Track:
    """The track that begins with ``pose``."""
    return Track(pose.position_m, pose.yaw_rad, pose.stamp_s, 0.0, pose.position_m, pose.stamp_s, pose.stamp_s)


def follow(
    track: Track, pose: Pose, *, moving: bool, max_speed_mps: float, brake_mps2: float, limits: Monitors
) -> Track:
    """The track after ``pose``.

    A pose that repeats to the last bit does not renew the trusted one (it turns stale by itself). A pose further away
    than the vehicle can have moved is a jump and is not trusted; once a jump was seen, only a pose near the place where
    the vehicle must have come to rest is trusted again. A vehicle at rest on the ground may be carried about: there
    every pose is trusted.

    Args:
        track: before.
        pose: finite, stamped by receipt.
        moving: in the air or driving.
        max_speed_mps: of the vehicle.
        brake_mps2: how hard it brakes.
        limits: the thresholds.
    """
    if pose.stamp_s <= track.raw_stamp_s:
        return track
    if pose.position_m == track.raw_m:
        return replace(track, raw_stamp_s=pose.stamp_s)
    fresh = replace(track, raw_m=pose.position_m, raw_stamp_s=pose.stamp_s, same_since_s=pose.stamp_s)
    distance_m = math.dist(pose.position_m, track.position_m)
    dt_s = pose.stamp_s - track.stamp_s
    if moving:
        if track.jumped:
            reach_m = limits.pose_jump_m + track.speed_mps * limits.pose_stale_s + track.speed_mps**2 / (2 * brake_mps2)
        else:
            reach_m = limits.pose_jump_m + 1.2 * max_speed_mps * min(dt_s, limits.pose_lost_s)
        if distance_m > reach_m:
            return replace(fresh, jumped=True)
    weight = min(1.0, dt_s / SPEED_SMOOTHING_S)
    old, new, last = track.velocity_mps, pose.position_m, track.position_m
    velocity_mps = (
        old[0] + weight * ((new[0] - last[0]) / dt_s - old[0]),
        old[1] + weight * ((new[1] - last[1]) / dt_s - old[1]),
        old[2] + weight * ((new[2] - last[2]) / dt_s - old[2]),
    )
    return Track(
        position_m=new,
        yaw_rad=pose.yaw_rad,
        stamp_s=pose.stamp_s,
        speed_mps=min(math.hypot(*velocity_mps), max_speed_mps),
        raw_m=new,
        raw_stamp_s=pose.stamp_s,
        same_since_s=pose.stamp_s,
        velocity_mps=velocity_mps,
    )


def mark_swaps(tracks: dict[str, Track], limits: Monitors) -> dict[str, Track]:
    """Marks each jumped track whose raw pose lies where another jumped vehicle should be, and the other way round."""
    jumped = [v for v, t in tracks.items() if t.jumped]
    swapped = {
        v
        for v in jumped
        for w in jumped
        if v != w
        and math.dist(tracks[v].raw_m, tracks[w].position_m) <= 2 * limits.pose_jump_m
        and math.dist(tracks[w].raw_m, tracks[v].position_m) <= 2 * limits.pose_jump_m
    }
    return {v: replace(t, swapped=v in swapped) if (v in swapped) != t.swapped else t for v, t in tracks.items()}


def charge_duration_s(settings: Settings, ugv: int, uav: int, energy_j: float) -> float:
    """How long a recharge from ``energy_j`` takes by the model, in mission s (design section 2)."""
    g, u = settings.problem.ugvs[ugv], settings.problem.uavs[uav]
    if g.charge_s is not None:
        return g.charge_s
    assert g.charge_w is not None  # Problem guarantees one of the two
    return max(0.0, u.capacity_j - energy_j) / g.charge_w


def measured_j(telemetry: VehicleState | None, capacity_j: float) -> float | None:
    """What the battery says, in J; None where it says nothing, or no number."""
    battery = None if telemetry is None else telemetry.battery
    if battery is None or not math.isfinite(battery):
        return None
    return min(1.0, max(0.0, battery)) * capacity_j


def uav_energy(
    settings: Settings, uav: UavState, config: UavSettings, telemetry: VehicleState | None, now_s: float
) -> float:
    """Energy left, in J: measured where the battery says it, else by the planner's power model."""
    model = settings.problem.uavs[uav.index]
    if config.energy == "measured" and (told_j := measured_j(telemetry, model.capacity_j)) is not None:
        return told_j
    dt_s = max(0.0, now_s - uav.energy_s) / settings.frame.time_scale
    if uav.phase is UavPhase.CHARGING and uav.docked is not None:
        full_s = charge_duration_s(settings, uav.docked[0], uav.index, uav.charge_from_j)
        rate_w = (model.capacity_j - uav.charge_from_j) / full_s if full_s > 0 else math.inf
        return min(model.capacity_j, uav.energy_j + rate_w * dt_s) if dt_s > 0 else uav.energy_j
    if uav.phase in AIRBORNE:
        return max(0.0, uav.energy_j - flying_power_w(model, uav, config) * dt_s)
    return uav.energy_j


def flying_power_w(model: Uav, uav: UavState, config: UavSettings) -> float:
    """Power in the air at the observed speed over ground: between hovering and cruising power."""
    speed_mps = math.hypot(*uav.track.velocity_mps[:2]) if uav.track is not None else 0.0
    share = min(1.0, speed_mps / config.speed_mps)
    return model.hover_w + share * (model.cruise_w - model.hover_w)


def ugv_energy(
    settings: Settings, ugv: UgvState, config: UgvSettings, telemetry: VehicleState | None, now_s: float
) -> float:
    """Energy left, in J; the virtual one does not yet count what the UAVs took (``dispatch`` takes that off)."""
    model = settings.problem.ugvs[ugv.index]
    if config.energy == "measured" and (told_j := measured_j(telemetry, model.capacity_j)) is not None:
        return told_j
    dt_s = max(0.0, now_s - ugv.energy_s) / settings.frame.time_scale
    power_w = model.drive_w if ugv.phase is UgvPhase.DRIVING else model.idle_w
    return max(0.0, ugv.energy_j - power_w * dt_s)
