"""World frame and arena frame: a similarity in space and a scale in time (``docs/glossary.md``)."""

from __future__ import annotations

import math
from dataclasses import dataclass

Vec2 = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Frame:
    """``arena = origin + scale * R(rotation) * world``; ``arena seconds = time_scale * mission seconds``.

    Attributes:
        scale: arena metres per world metre.
        rotation_rad: from world to arena, counter-clockwise.
        origin_m: where the world's origin lies in the arena.
        time_scale: arena seconds per mission second.
    """

    scale: float = 1.0
    rotation_rad: float = 0.0
    origin_m: Vec2 = (0.0, 0.0)
    time_scale: float = 1.0

    def to_arena(self, world_m: Vec2) -> Vec2:
        """A point of the world in the arena."""
        c, s = math.cos(self.rotation_rad) * self.scale, math.sin(self.rotation_rad) * self.scale
        x, y = world_m
        return (self.origin_m[0] + c * x - s * y, self.origin_m[1] + s * x + c * y)

    def to_world(self, arena_m: Vec2) -> Vec2:
        """A point of the arena in the world."""
        c, s = math.cos(self.rotation_rad) / self.scale, math.sin(self.rotation_rad) / self.scale
        x, y = arena_m[0] - self.origin_m[0], arena_m[1] - self.origin_m[1]
        return (c * x + s * y, -s * x + c * y)

    def speed_to_arena(self, world_mps: float) -> float:
        """A speed over ground of the world in the arena."""
        return world_mps * self.scale / self.time_scale
