"""How the simulated MAVLink vehicles move: a copter and a rover in the arena. Pure; east-north-up, m, s, rad."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from drivers.vehicle import Vec2, Vec3
from sim_backends.wire.world import Quaternion

GRAVITY = 9.81
CRASH_MPS = 3.0
"""Who comes down without motors faster than this lies on its back."""
VELOCITY_GAIN = 5.0
"""Acceleration per m/s of velocity error, 1/s."""
JERK_S = 0.25
"""Time in which a copter builds up its full acceleration."""
YAW_RATE = 1.5
"""rad/s."""
PIVOT_RAD = 0.6
"""A skid-steered rover turns on the spot while it looks further away from its way than this."""


def wrap(angle: float) -> float:
    """An angle within half a turn."""
    return math.atan2(math.sin(angle), math.cos(angle))


def quaternion(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Attitude x y z w from angles of forward-left-up axes."""
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    return (
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )


@dataclass
class Copter:
    """A copter that follows velocities within acceleration and jerk.

    Attributes:
        position, velocity, accel: of the body in the arena.
        yaw: counter-clockwise from x.
        max_accel: horizontally and vertically, m/s^2.
        landed: it stands.
        tumbled: it crashed.
        tilt: roll and pitch, forward-left-up.
    """

    position: Vec3
    yaw: float
    max_accel: float
    velocity: Vec3 = (0.0, 0.0, 0.0)
    accel: Vec3 = (0.0, 0.0, 0.0)
    landed: bool = True
    tumbled: bool = False
    tilt: Vec2 = field(default=(0.0, 0.0))

    @property
    def quaternion(self) -> Quaternion:
        """Attitude."""
        if self.tumbled:
            return quaternion(math.pi, 0.0, self.yaw)
        return quaternion(*self.tilt, self.yaw)

    def fly(self, dt: float, wanted: Vec3, yaw_rate: float, ground_m: float) -> None:
        """One step with turning motors.

        Args:
            dt: s.
            wanted: velocity.
            yaw_rate: rad/s.
            ground_m: height of what is below.
        """
        if self.landed and wanted[2] <= 0.02:
            self.rest(ground_m)
            return
        self.landed = False
        if abs(yaw_rate) > 0.0:
            self.yaw = wrap(self.yaw + max(-YAW_RATE, min(YAW_RATE, yaw_rate)) * dt)
        ax, ay, az = self.accel
        gx, gy, gz = (VELOCITY_GAIN * (w - v) for w, v in zip(wanted, self.velocity, strict=True))
        gx, gy = _clip(gx, gy, self.max_accel)
        gz = max(-self.max_accel, min(self.max_accel, gz))
        most = self.max_accel * dt / JERK_S
        jx, jy = _clip(gx - ax, gy - ay, most)
        ax, ay, az = ax + jx, ay + jy, az + max(-most, min(most, gz - az))
        self.accel = (ax, ay, az)
        self._move(dt)
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        forward, left = c * ax + s * ay, -s * ax + c * ay
        self.tilt = (-math.atan2(left, GRAVITY), math.atan2(forward, GRAVITY))
        if self.position[2] <= ground_m and self.velocity[2] <= 0.0:
            self.rest(ground_m)

    def fall(self, dt: float, ground_m: float) -> None:
        """One step without motors."""
        if self.landed:
            self.rest(ground_m)
            return
        self.accel = (0.0, 0.0, -GRAVITY)
        self._move(dt)
        if self.position[2] <= ground_m:
            self.tumbled = self.tumbled or self.velocity[2] < -CRASH_MPS
            self.rest(ground_m)

    def rest(self, ground_m: float) -> None:
        """Puts it down where it is."""
        self.position = (self.position[0], self.position[1], ground_m)
        self.velocity = self.accel = (0.0, 0.0, 0.0)
        self.tilt = (0.0, 0.0)
        self.landed = True

    def _move(self, dt: float) -> None:
        vx, vy, vz = (v + a * dt for v, a in zip(self.velocity, self.accel, strict=True))
        x, y, z = self.position
        self.velocity = (vx, vy, vz)
        self.position = (x + vx * dt, y + vy * dt, z + vz * dt)


def _clip(x: float, y: float, most: float) -> Vec2:
    size = math.hypot(x, y)
    return (x, y) if size <= most else (x * most / size, y * most / size)


@dataclass
class Rover:
    """A rover that turns towards the velocity it is given and drives along it.

    Attributes:
        position: on the floor.
        yaw: heading, counter-clockwise from x.
        max_accel: m/s^2.
        turn_radius: smallest of an Ackermann vehicle, m; 0: it turns on the spot.
        speed: forwards, m/s.
        yaw_rate: rad/s.
    """

    position: Vec2
    yaw: float
    max_accel: float
    turn_radius: float = 0.0
    speed: float = 0.0
    yaw_rate: float = 0.0

    @property
    def velocity(self) -> Vec3:
        """In the arena."""
        return (self.speed * math.cos(self.yaw), self.speed * math.sin(self.yaw), 0.0)

    def drive(self, dt: float, wanted: Vec2, turn: float = math.nan) -> None:
        """One step.

        Args:
            dt: s.
            wanted: velocity over ground.
            turn: yaw rate to keep instead of looking where it drives, rad/s; NaN: none.
        """
        goal = math.hypot(*wanted)
        aside = wrap(math.atan2(wanted[1], wanted[0]) - self.yaw) if goal > 0.01 else 0.0
        rate = 2.5 * aside if math.isnan(turn) else turn
        if self.turn_radius > 0.0:
            # it can only turn while it moves: slowly where the way is aside
            goal *= max(0.35, math.cos(aside)) if math.isnan(turn) else 1.0
        elif math.isnan(turn):
            goal = 0.0 if abs(aside) > PIVOT_RAD else goal * math.cos(aside)
        most = self.max_accel * dt
        self.speed += max(-most, min(most, goal - self.speed))
        limit = YAW_RATE if self.turn_radius <= 0.0 else min(YAW_RATE, abs(self.speed) / self.turn_radius)
        self.yaw_rate = max(-limit, min(limit, rate))
        self.yaw = wrap(self.yaw + self.yaw_rate * dt)
        x, y = self.position
        self.position = (x + self.velocity[0] * dt, y + self.velocity[1] * dt)

    def halt(self, dt: float, share: float = 1.0) -> None:
        """One step of braking, with ``share`` times the usual deceleration."""
        most = share * self.max_accel * dt
        self.speed -= max(-most, min(most, self.speed))
        self.yaw_rate = 0.0
        x, y = self.position
        self.position = (x + self.velocity[0] * dt, y + self.velocity[1] * dt)
