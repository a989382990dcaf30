"""The moving reference that is streamed as set-points: rest to rest, within speed and acceleration. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.limits import UavLimits
from drivers.vehicle import Vec3

REST: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Reference:
    """Where the vehicle should be now, arena m and m/s."""

    position_m: Vec3
    velocity_mps: Vec3 = REST


def approach_mps(distance_m: float, accel_mps2: float, dt_s: float) -> float:
    """The fastest speed from which ``distance_m`` still suffices to stop, in steps of ``dt_s``."""
    if distance_m <= 0:
        return 0.0
    half = 0.5 * dt_s
    return min(accel_mps2 * (math.sqrt(half * half + 2.0 * distance_m / accel_mps2) - half), distance_m / dt_s)


def along(velocity: Vec3, goal: Vec3, most: float) -> Vec3:
    """``velocity`` changed towards ``goal`` by ``most`` at the most."""
    change = math.dist(velocity, goal)
    if change <= most:
        return goal
    f = most / change
    return (
        velocity[0] + f * (goal[0] - velocity[0]),
        velocity[1] + f * (goal[1] - velocity[1]),
        velocity[2] + f * (goal[2] - velocity[2]),
    )


def moved(reference: Reference, velocity: Vec3, dt_s: float) -> Reference:
    """The reference after ``dt_s`` at ``velocity``."""
    x, y, z = reference.position_m
    vx, vy, vz = velocity
    return Reference((x + vx * dt_s, y + vy * dt_s, z + vz * dt_s), velocity)


def brake(reference: Reference, accel_mps2: float, dt_s: float) -> Reference:
    """One step towards rest."""
    return moved(reference, along(reference.velocity_mps, REST, accel_mps2 * dt_s), dt_s)


def steer(reference: Reference, target_m: Vec3, speed_mps: float, limits: UavLimits, dt_s: float) -> Reference:
    """One step straight towards ``target_m``; exactly there and at rest in the end.

    Args:
        reference: now.
        target_m: where to rest.
        speed_mps: at the most.
        limits: climbing and descending have their own.
        dt_s: step.
    """
    distance = math.dist(reference.position_m, target_m)
    most = limits.accel_mps2 * dt_s
    speed_now = math.hypot(*reference.velocity_mps)
    if distance < 1e-3 and speed_now <= most:
        return Reference(target_m)
    goal = REST
    if distance > 0:
        dx, dy, dz = ((t - p) / distance for t, p in zip(target_m, reference.position_m, strict=True))
        speed = min(speed_mps, limits.max_speed_mps)
        vertical = limits.climb_mps if dz > 0 else limits.descent_mps
        if speed * abs(dz) > vertical:
            speed = vertical / abs(dz)
        speed = min(speed, approach_mps(distance, limits.accel_mps2, dt_s))
        goal = (dx * speed, dy * speed, dz * speed)
    return moved(reference, along(reference.velocity_mps, goal, most), dt_s)


def patience(lag_m: float, speed_mps: float) -> float:
    """Share of its speed at which the reference goes on while the vehicle is ``lag_m`` behind: it never runs away.

    A vehicle follows about 0.5 s behind; more than twice that (and 0.5 m of noise) is wind or weakness.
    """
    allowed_m = 0.5 + 0.5 * speed_mps
    return min(1.0, max(0.0, 2.0 - lag_m / allowed_m))
