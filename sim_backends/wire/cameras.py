"""What simulated cameras see of the world: every body with noise, occlusions and the faults of motion capture."""

from __future__ import annotations

import math

import numpy as np

from drivers.vehicle import Vec3
from sim_backends.wire.natnet_packets import Seen
from sim_backends.wire.world import Body, Modifiers, Quaternion, World

_BLOCK = 4096  # numbers drawn at once; drawing each alone would cost more than all the rest


class Cameras:
    """The motion-capture system's eyes; looked through once a frame.

    Dropouts, occlusions and lost vehicles are not tracked; a frozen body repeats its last pose to the bit; a swapped
    one carries the pose of its partner.

    Args:
        world: whose bodies are seen.
        rate_hz: frames per second: how likely it is that a body gets occluded in one of them.
    """

    def __init__(self, world: World, rate_hz: float) -> None:
        self._world, self._config = world, world.config
        self._rate_hz = rate_hz
        self._random = np.random.default_rng(world.config.seed)
        self._block: list[float] = []
        self._occluded_to_s = [-math.inf] * len(world.ids)
        self._last: list[Seen | None] = [None] * len(world.ids)

    def look(self, now_s: float) -> list[Seen]:
        """All bodies by row, numbered from 1; ``now_s`` on any steady clock."""
        bodies = self._world.bodies()
        return [self._see(row, bodies, now_s) for row in range(len(bodies))]

    def _see(self, row: int, bodies: list[Body], now_s: float) -> Seen:
        faults = self._world.modifiers(row)
        hidden = self._occluded(row, now_s) or faults.dropout or faults.lost
        last = self._last[row]
        if last is None or not (hidden or faults.freeze):
            last = self._pose(row, bodies[faults.swap], faults)
            self._last[row] = last
        return Seen(last.number, last.position_m, last.quaternion, tracked=not hidden)

    def _occluded(self, row: int, now_s: float) -> bool:
        config = self._config
        if config.occlusions_per_s > 0 and self._random.random() < config.occlusions_per_s / self._rate_hz:
            length_s = config.occlusion_s * (0.5 + self._random.random())
            self._occluded_to_s[row] = max(self._occluded_to_s[row], now_s + length_s)
        return now_s <= self._occluded_to_s[row]

    def _pose(self, row: int, body: Body, faults: Modifiers) -> Seen:
        noise_m, noise_rad = self._config.pose_noise_m, self._config.pose_noise_rad
        x, y, z = body.position_m
        position_m: Vec3 = (
            x + faults.jump_x + noise_m * self._gauss(),
            y + faults.jump_y + noise_m * self._gauss(),
            z + noise_m * self._gauss(),
        )
        half = 0.5 * noise_rad
        turn = (half * self._gauss(), half * self._gauss(), half * self._gauss())
        return Seen(row + 1, position_m, _turned(body.quaternion, turn))

    def _gauss(self) -> float:
        if not self._block:
            self._block = self._random.standard_normal(_BLOCK).tolist()
        return self._block.pop()


def _turned(q: Quaternion, half_rad: Vec3) -> Quaternion:
    """``q`` after a small rotation, given as half its rotation vector in the body frame."""
    x, y, z, w = q
    a, b, c = half_rad
    turned = (
        x + w * a + y * c - z * b,
        y + w * b + z * a - x * c,
        z + w * c + x * b - y * a,
        w - x * a - y * b - z * c,
    )
    norm = math.sqrt(sum(part * part for part in turned))
    return (turned[0] / norm, turned[1] / norm, turned[2] / norm, turned[3] / norm)
