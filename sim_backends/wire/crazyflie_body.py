"""The body of one simulated Crazyflie in the shared world: it stands, flies or falls, drains and charges its battery.

Its origin is where it touches the ground. A UAV on a UGV rides along; on touch-down beside the contact it rides along
too, without charging.
"""

from __future__ import annotations

import math
import random
from array import array

from drivers.vehicle import Vec3
from sim_backends.wire.crazyflie_control import GRAVITY, Drive
from sim_backends.wire.crazyflie_dynamics import Dynamics
from sim_backends.wire.crazyflie_planner import wrap
from sim_backends.wire.physics import Ground, UavBattery, ground_under
from sim_backends.wire.world import BATTERY_EMPTY, DOCK_MISSED, FINE, MOTOR_FAILURE, Body, Modifiers, World

CRASH_MPS = 2.0
"""It survives an impact up to this speed, a fall from 0.2 m."""
LIFT_OFF = 1.05
"""Thrust over weight that lifts it off: what is left of a landing's braking must not make it hop."""
SCRAPE_MPS = 1.0
"""Sideways at touch-down."""
CRASH_TILT = math.radians(50.0)
WANDER_S, GUST_S = 2.0, 20.0
"""How long a deviation and a gust last."""
HOP_S = 1.0
"""Who hops and touches down again within that time still misses the same contact."""
AT_REST = array("d", bytes(6 * 8))
LOOK_STEPS = 5
"""Steps between two looks at the ground from well above it."""
SLIDE_MPS = 0.3
"""How fast a docking that has to miss slides off the contact."""
CALM_MPS = 0.2
"""Below this ground speed the wind fades out, so that a hovering UAV stays."""


class CrazyflieBody:
    """The state of the body and its step."""

    def __init__(self, world: World, row: int, variant: str, step_s: float) -> None:
        """Takes its place in the world.

        Args:
            world: the shared world.
            row: its row.
            variant: ``brushed`` or ``brushless``.
            step_s: length of a step.
        """
        self._world, self._row, self._step_s = world, row, step_s
        self.dynamics = Dynamics(variant, step_s)
        self.airframe = self.dynamics.airframe
        self.battery = UavBattery(world, row)
        self._config = world.config.uavs[row]
        self._random = random.Random(1000 * world.config.seed + row)
        start = world.body(row)
        x, y, z = map(float, start.position_m)
        self.dynamics.state[0:3] = array("d", (x, y, z))
        self.dynamics.state[5] = start.yaw_rad
        self.position_m: Vec3 = (x, y, z)
        self.velocity_mps: Vec3 = (0.0, 0.0, 0.0)
        self.accel_mps2: Vec3 = (0.0, 0.0, 0.0)
        self.standing, self.tumbled = True, False
        self.code = FINE
        self._broken = False
        self.faults = Modifiers()
        self.ground = ground_under(world, row, start.position_m)
        self._offset = self._on_ugv()
        self._slide_m = 0.0
        self._missed = 0
        self._looked = 0
        self._wander, self._gust = [0.0] * 6, 0.0
        self.read_faults()

    @property
    def rpy(self) -> Vec3:
        """Roll, pitch and yaw; yaw is not wrapped."""
        s = self.dynamics.state
        return (s[3], s[4], s[5])

    @property
    def wander_m(self) -> Vec3:
        """How far it is off its set-point because the air is never still."""
        return (self._wander[3], self._wander[4], self._wander[5])

    def read_faults(self) -> None:
        """Looks up what the faults do to it."""
        self.faults = self._world.modifiers(self._row)

    def step(self, drive: Drive, motors: bool) -> None:
        """One step.

        Args:
            drive: what the controller wants.
            motors: the supervisor lets them run.
        """
        self._broken |= self.faults.motor_fail
        if self._broken:
            motors, self.code = False, MOTOR_FAILURE
        elif self.battery.energy_j <= 0.0:
            motors = False
            self.code = self.code if self.standing else BATTERY_EMPTY
        lift_n = drive.thrust_n if motors else 0.0
        before = self.velocity_mps
        if self.standing and not self.tumbled and lift_n > LIFT_OFF * self.airframe.mass_kg * GRAVITY:
            self._lift_off()
        self._missed = max(0, self._missed - 1)
        if self.standing:
            self._stand()
        else:
            self._fly(drive, lift_n)
        h = self._step_s
        v = self.velocity_mps
        self.accel_mps2 = ((v[0] - before[0]) / h, (v[1] - before[1]) / h, (v[2] - before[2]) / h)
        air_mps = math.hypot(self.dynamics.state[6], self.dynamics.state[7])
        flying = not self.standing and lift_n > 0.0
        resting = self.ground if self.standing and lift_n <= 0.0 and not self.tumbled else None
        self.battery.step(h, flying, air_mps, resting, self.faults)

    def _lift_off(self) -> None:
        self.standing = False
        self.dynamics.state[6:8] = array("d", self.velocity_mps[:2])  # of the UGV that it leaves
        self._slide_m = 0.0
        self.code = FINE

    def _stand(self) -> None:
        s = self.dynamics.state
        if self.ground.ugv >= 0:
            if self._slide_m > 0.0:
                self._slide()
            carrier = self._world.body(self.ground.ugv)
            c, k = math.cos(carrier.yaw_rad), math.sin(carrier.yaw_rad)
            dx, dy, turn = self._offset
            s[0] = carrier.position_m[0] + c * dx - k * dy
            s[1] = carrier.position_m[1] + k * dx + c * dy
            s[5] += wrap(carrier.yaw_rad + turn - s[5])
            self.velocity_mps = carrier.velocity_mps
        else:
            self.velocity_mps = (0.0, 0.0, 0.0)
        s[2] = self.ground.height_m
        if not self.tumbled:
            s[3] = s[4] = 0.0
        s[6:12] = AT_REST
        self.position_m = (s[0], s[1], s[2])

    def _slide(self) -> None:
        step_m = min(self._slide_m, SLIDE_MPS * self._step_s)
        self._slide_m -= step_m
        dx, dy, turn = self._offset
        ox, oy = self._world.ugv(self.ground.ugv).dock_offsets_m[self.ground.dock]
        away = math.hypot(dx - ox, dy - oy)
        ux, uy = ((dx - ox) / away, (dy - oy) / away) if away > 1e-6 else (1.0, 0.0)
        self._offset = (dx + step_m * ux, dy + step_m * uy, turn)

    def _fly(self, drive: Drive, lift_n: float) -> None:
        s, h, air = self.dynamics.state, self._step_s, self.airframe
        x, y = s[0], s[1]
        tilt = air.tilt_gain
        if lift_n > 0.0:
            self.dynamics.step(
                tilt * drive.roll, tilt * drive.pitch, air.yaw_gain * drive.yaw, lift_n / air.thrust_gain
            )
        else:
            self.dynamics.step(0.0, 0.0, air.yaw_gain * s[5], 0.0)
        vx, vy, vz = s[6], s[7], s[8]
        speed = math.hypot((s[0] - x) / h, (s[1] - y) / h)
        lost = max(0.0, self.faults.wind_mps + self._gust) * min(1.0, speed / CALM_MPS)
        if lost > 0.0 and speed > 1e-6:
            vx, vy = vx * (1.0 - min(lost / speed, 0.9)), vy * (1.0 - min(lost / speed, 0.9))
            s[0], s[1] = x + vx * h, y + vy * h
        self.velocity_mps = (vx, vy, vz)
        self._blow(h)
        self._looked -= 1
        if self._looked <= 0 or s[2] < self.ground.height_m + 0.05:
            self._looked = LOOK_STEPS
            self.ground = ground_under(self._world, self._row, (s[0], s[1], s[2]))
        if s[2] <= self.ground.height_m and vz <= 0.0:
            self._touch(vz, math.hypot(vx, vy))
        self.position_m = (s[0], s[1], s[2])

    def _blow(self, dt_s: float) -> None:
        near = self.ground.ugv >= 0
        size = self._config.dock_noise_m if near else self._config.tracking_noise_m
        f = dt_s / WANDER_S
        kick = size * math.sqrt(4.0 * f)
        w = self._wander
        for i, part in enumerate((1.0, 1.0, 0.3)):
            w[i] += -f * w[i] + part * kick * self._random.gauss(0.0, 1.0)
            w[3 + i] += f * (w[i] - w[3 + i])
        if self._world.config.gust_mps > 0.0:
            kick = self._world.config.gust_mps * math.sqrt(2.0 * dt_s / GUST_S)
            self._gust += -dt_s / GUST_S * self._gust + kick * self._random.gauss(0.0, 1.0)

    def _touch(self, vz: float, level_mps: float) -> None:
        roll, pitch, _ = self.rpy
        ugv = self._world.body(self.ground.ugv).speed_mps if self.ground.ugv >= 0 else 0.0
        hard = -vz > CRASH_MPS or level_mps > SCRAPE_MPS + ugv or max(abs(roll), abs(pitch)) > CRASH_TILT
        self.standing = True
        self.dynamics.state[2] = self.ground.height_m
        if hard:
            self.tumbled = True
            self.dynamics.state[3] = math.pi
        self._offset = self._on_ugv()
        if self.ground.ugv >= 0 and self.ground.contact and (self.faults.dock_miss > 0 or self._missed > 0):
            if self._missed == 0:
                self._world.dock_missed(self._row)
            self._missed = round(HOP_S / self._step_s)
            self.ground = Ground(self.ground.height_m, self.ground.ugv, self.ground.dock, False)
            self._slide_m = 1.3 * self._world.config.dock_tolerance_m
        if self.ground.ugv >= 0 and not self.ground.contact and self.code == FINE:
            self.code = DOCK_MISSED
        self._stand()

    def _on_ugv(self) -> tuple[float, float, float]:
        """Its place and heading on the UGV."""
        if self.ground.ugv < 0:
            return (0.0, 0.0, 0.0)
        carrier, s = self._world.body(self.ground.ugv), self.dynamics.state
        c, k = math.cos(carrier.yaw_rad), math.sin(carrier.yaw_rad)
        x, y = s[0] - carrier.position_m[0], s[1] - carrier.position_m[1]
        return (c * x + k * y, -k * x + c * y, wrap(s[5] - carrier.yaw_rad))

    def put(self, armed: bool, locked: bool) -> None:
        """Writes its row."""
        self._world.put(
            self._row,
            Body(
                position_m=self.position_m,
                velocity_mps=self.velocity_mps,
                quaternion=quaternion(*self.rpy),
                on=self.ground.ugv if self.standing else -1,
                dock=self.ground.dock if self.standing else 0,
                armed=armed,
                airborne=not self.standing,
                tumbled=self.tumbled,
                locked=locked,
                charging=self.battery.charging,
                code=self.code,
                energy_j=self.battery.energy_j,
                used_j=self.battery.used_j,
                drawn_j=self.battery.drawn_j,
            ),
        )


def quaternion(roll: float, pitch: float, yaw: float) -> tuple[float, float, float, float]:
    """Attitude (x, y, z, w) from angles in rad, body to arena."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
