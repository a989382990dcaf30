"""One docking: over the pad, down onto it while aligned, or up again. Pure; the flight machine calls it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

from drivers.limits import UavLimits
from drivers.mavlink_motion import Reference, along, approach_mps, moved
from drivers.vehicle import Dock, Vec2, Vec3

ALIGN_S = 10.0
"""Misaligned for longer: missed."""
CONTACT_S = 0.3
"""The vehicle must say "landed" for so long."""
BOTTOM_S = 5.0
"""PX4's land detector takes 1 to 2 s; without its word for so long at the bottom: missed."""
PAD_MPS = 0.2
"""A pad that moves faster cannot be docked on."""
RANGE = 10.0
"""Tolerances within which an attempt begins; half a metre at least."""
CONE = 0.3
"""Alignment that suffices, per m above the pad."""
PROBE_M = 0.4
"""The reference goes so far below the pad's height, so that it is pressed onto it and errors of height do not count."""
GENTLE_MPS = 0.25
"""Speed of the touch-down; 2 s before, at most as many m/s as half the m above."""
TRIM = 0.5
"""Per s: how fast a steady misalignment (wind, an estimator's offset) is steered out."""


class Outcome(Enum):
    """How an attempt stands."""

    GOING = "going"
    TOUCHED = "touched"
    MISSED = "missed"


@dataclass(frozen=True, slots=True)
class PadSeen:
    """A dock as its UGV's trusted poses show it.

    Attributes:
        position_m: of its surface.
        velocity_mps: of the UGV.
        tolerance_m: largest misalignment at touch-down.
    """

    position_m: Vec3
    velocity_mps: Vec2
    tolerance_m: float


@dataclass(frozen=True, slots=True)
class Attempt:
    """One docking under way.

    Attributes:
        command: what was asked for.
        blocked_s: misaligned without a break.
        landed_s: landed without a break.
        bottom_s: pressed down without contact.
        trim_m: added to the pad's place.
        why: of a miss.
    """

    command: Dock
    blocked_s: float = 0.0
    landed_s: float = 0.0
    bottom_s: float = 0.0
    trim_m: Vec2 = (0.0, 0.0)
    why: str = ""


def dock_step(
    attempt: Attempt,
    reference: Reference,
    pose_m: Vec3 | None,
    landed: bool,
    pad: PadSeen | None,
    limits: UavLimits,
    dt_s: float,
) -> tuple[Attempt, Reference, Outcome]:
    """One step of an attempt.

    Args:
        attempt: so far.
        reference: now.
        pose_m: where the UAV trustworthily is; None: stale.
        landed: the UAV says so.
        pad: None: stale.
        limits: of the UAV.
        dt_s: step.

    Returns:
        the attempt, with its reason where it is missed; the next reference; how it stands.
    """

    def missed(why: str) -> tuple[Attempt, Reference, Outcome]:
        return _with(attempt, why=why), reference, Outcome.MISSED

    if pose_m is None:
        return missed("its own pose is stale")
    if pad is None:
        return missed("the pad's pose is stale")
    px, py, pz = pad.position_m
    ex, ey = px - pose_m[0], py - pose_m[1]
    off, above = math.hypot(ex, ey), pose_m[2] - pz
    if off > max(RANGE * pad.tolerance_m, 0.5):
        return missed(f"the pad is {off:.2f} m aside")
    if math.hypot(*pad.velocity_mps) > PAD_MPS:
        return missed("the pad moves")
    aligned = off <= max(pad.tolerance_m, CONE * above)
    blocked_s = 0.0 if aligned else attempt.blocked_s + dt_s
    if blocked_s > ALIGN_S:
        return missed(f"{off:.2f} m beside the pad for {ALIGN_S:g} s")
    landed_s = attempt.landed_s + dt_s if landed else 0.0
    if landed_s >= CONTACT_S:
        if off > pad.tolerance_m:
            return missed(f"touched down {off:.2f} m beside the pad")
        if abs(above) > PROBE_M + 0.1:
            return missed(f"touched down {above:+.2f} m from the pad's height")
        return _with(attempt, landed_s=landed_s), Reference(reference.position_m), Outcome.TOUCHED
    x, y, z = reference.position_m
    at_bottom = z <= pz - PROBE_M + 0.05
    bottom_s = attempt.bottom_s + dt_s if at_bottom else 0.0
    if bottom_s > BOTTOM_S and not landed:
        return missed("no contact with the pad")
    # the trim only learns when the reference has arrived: else it winds up on the way
    tx, ty = attempt.trim_m
    if math.hypot(px + tx - x, py + ty - y) < pad.tolerance_m:
        tx, ty = _capped((tx + TRIM * dt_s * ex, ty + TRIM * dt_s * ey), max(3 * pad.tolerance_m, 0.1))
    dx, dy = px + tx - x, py + ty - y
    distance = math.hypot(dx, dy)
    gx, gy = pad.velocity_mps
    if distance > 0:
        level = min(limits.max_speed_mps, approach_mps(distance, limits.accel_mps2, dt_s))
        gx, gy = gx + dx / distance * level, gy + dy / distance * level
    down = 0.0
    if aligned and not at_bottom:
        down = min(attempt.command.speed_mps, limits.descent_mps, max(GENTLE_MPS, 0.5 * above))
    velocity = along(reference.velocity_mps, (gx, gy, -down), limits.accel_mps2 * dt_s)
    moving = moved(reference, velocity, dt_s)
    return (
        Attempt(attempt.command, blocked_s, landed_s, bottom_s, (tx, ty)),
        moving,
        Outcome.GOING,
    )


def _capped(v: Vec2, most: float) -> Vec2:
    size = math.hypot(*v)
    return v if size <= most else (v[0] * most / size, v[1] * most / size)


def _with(a: Attempt, why: str = "", landed_s: float | None = None) -> Attempt:
    return Attempt(a.command, a.blocked_s, a.landed_s if landed_s is None else landed_s, a.bottom_s, a.trim_m, why)
