"""From a motion-capture system's axes to the arena's: pure."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from drivers.vehicle import Vec3

Quaternion = tuple[float, float, float, float]
"""x y z w, body to frame."""


def yaw_of(quaternion: Quaternion) -> float | None:
    """Heading about z in rad; None where the quaternion is none (zeros, not finite)."""
    x, y, z, w = quaternion
    norm2 = x * x + y * y + z * z + w * w
    if not (math.isfinite(norm2) and norm2 > 0.25):
        return None
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)


def to_arena(
    up: Literal["y", "z"], yaw_rad: float, translation_m: Vec3
) -> Callable[[Vec3, Quaternion], tuple[Vec3, float] | None]:
    """The transform of one system.

    Args:
        up: the axis that points up in its stream. For ``y`` its (x, y, z) is (x, -z, y) with z up, for positions and
            for the axes of bodies, as Motive defines both in the same frame.
        yaw_rad: of its x axis in the arena.
        translation_m: of its origin in the arena.

    Returns:
        a function from position and attitude to position and yaw; None where a number is not finite.
    """
    cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
    ox, oy, oz = translation_m

    def turn(position_m: Vec3, quaternion: Quaternion) -> tuple[Vec3, float] | None:
        x, y, z = position_m
        if up == "y":
            y, z = -z, y
            quaternion = (quaternion[0], -quaternion[2], quaternion[1], quaternion[3])
        yaw = yaw_of(quaternion)
        if yaw is None or not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            return None
        place = (ox + cos * x - sin * y, oy + sin * x + cos * y, oz + z)
        return place, math.remainder(yaw + yaw_rad, math.tau)

    return turn
