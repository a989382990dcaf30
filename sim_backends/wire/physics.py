"""What all simulated vehicles have in common: what they stand on, how their batteries empty and fill."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.vehicle import Vec3
from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav, SimUgv

ROOF = 3.0
"""Who comes down within so many docking tolerances of a dock stands on the UGV's roof, without contact."""


@dataclass(frozen=True, slots=True)
class Ground:
    """What lies beneath a UAV.

    Attributes:
        height_m: of the ground.
        ugv: row of the UGV it belongs to; -1: the floor.
        dock: nearest dock there.
        contact: near enough to the dock for charging.
    """

    height_m: float = 0.0
    ugv: int = -1
    dock: int = 0
    contact: bool = False


def ground_under(world: World, uav: int, at_m: Vec3) -> Ground:
    """The highest ground beneath a point, for the UAV in row ``uav``: a free dock, or the floor.

    A UGV's roof counts only for who is not clearly below it already.
    """
    tolerance_m = world.config.dock_tolerance_m
    taken = {(b.on, b.dock) for i, b in enumerate(world.bodies()[: world.n_uav]) if i != uav and b.on >= 0}
    found = Ground()
    nearest_m = ROOF * tolerance_m
    for row in range(world.n_uav, len(world.ids)):
        ugv = world.ugv(row)
        if at_m[2] < 0.7 * ugv.pad_height_m:
            continue
        for dock in range(len(ugv.dock_offsets_m)):
            x, y, z = world.pad_m(row, dock)
            off_m = math.hypot(at_m[0] - x, at_m[1] - y)
            if off_m <= nearest_m and (row, dock) not in taken:
                nearest_m = off_m
                found = Ground(z, row, dock, off_m <= tolerance_m)
    return found


def _watts(power_w: tuple[float, ...], speed_mps: float) -> float:
    return sum(c * speed_mps**n for n, c in enumerate(power_w))


class UavBattery:
    """A UAV's battery: drained by the world's power model, filled on a dock."""

    def __init__(self, world: World, row: int) -> None:
        self._world, self._row = world, row
        self._config: SimUav = world.config.uavs[row]
        self.capacity_j = self._config.capacity_j
        self.energy_j = world.body(row).energy_j
        self.used_j = self.drawn_j = 0.0
        self.charging = False
        self._charge_w = 0.0
        self._dock: tuple[int, int] | None = None

    @property
    def level(self) -> float:
        """Share of its capacity, 0..1."""
        return self.energy_j / self.capacity_j

    def step(self, dt_s: float, flying: bool, speed_mps: float, ground: Ground | None, faults: Modifiers) -> None:
        """Lets ``dt_s`` pass.

        Args:
            dt_s: arena s.
            flying: propellers carry it.
            speed_mps: air speed, arena m/s.
            ground: where it stands; None in the air.
            faults: of this UAV.
        """
        config = self._world.config
        mission_s = dt_s / config.time_scale
        self.charging = False
        if flying:
            self._dock = None
            watts = _watts(self._config.power_w, speed_mps * config.time_scale / config.scale)
            spent_j = min(max(0.0, watts) * faults.drain * mission_s, self.energy_j)
            self.energy_j -= spent_j
            self.used_j += spent_j
            return
        if ground is None or not ground.contact or faults.charge_factor <= 0.0:
            self._dock = None
            return
        carrier: SimUgv = self._world.ugv(ground.ugv)
        if self._world.body(ground.ugv).energy_j <= 0.0:
            return
        if self._dock != (ground.ugv, ground.dock):
            self._dock = (ground.ugv, ground.dock)
            missing_j = self.capacity_j - self.energy_j
            self._charge_w = carrier.charge_w if carrier.charge_w is not None else missing_j / (carrier.charge_s or 1.0)
        self.charging = True
        give_j = min(self._charge_w * faults.charge_factor * mission_s, self.capacity_j - self.energy_j)
        self.energy_j += give_j
        self.drawn_j += give_j
        if self.capacity_j - self.energy_j < 1e-6 * self.capacity_j:
            self.energy_j = self.capacity_j


class UgvBattery:
    """A UGV's battery: drained by driving, standing, and the UAVs that charge on it."""

    def __init__(self, world: World, row: int) -> None:
        self._world, self._row = world, row
        self._config = world.ugv(row)
        self.capacity_j = self._config.capacity_j
        self.energy_j = world.body(row).energy_j
        self.used_j = self.given_j = 0.0
        self._seen = [world.body(i).drawn_j for i in range(world.n_uav)]

    @property
    def level(self) -> float:
        """Share of its capacity, 0..1."""
        return self.energy_j / self.capacity_j

    def step(self, dt_s: float, speed_mps: float, faults: Modifiers) -> None:
        """Lets ``dt_s`` arena s pass at ``speed_mps`` arena m/s."""
        config = self._world.config
        watts = self._config.idle_w
        if speed_mps > 1e-3:
            watts = _watts(self._config.power_w, speed_mps * config.time_scale / config.scale)
        spent_j = min(max(0.0, watts) * faults.drain * dt_s / config.time_scale, self.energy_j)
        self.energy_j -= spent_j
        self.used_j += spent_j
        for i in range(self._world.n_uav):
            body = self._world.body(i)
            if body.on == self._row:
                give_j = min(max(0.0, body.drawn_j - self._seen[i]), self.energy_j)
                self.energy_j -= give_j
                self.given_j += give_j
            self._seen[i] = body.drawn_j
