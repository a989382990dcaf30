"""The controller: from a set-point and the estimate to commanded angles and thrust.

A position loop with feed-forward and a slow integral, as the firmware's Mellinger controller has it, on top of the
attitude loop that is already part of the identified model.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from drivers.vehicle import Vec3
from sim_backends.wire.crazyflie_dynamics import Airframe
from sim_backends.wire.crazyflie_planner import wrap
from sim_backends.wire.crazyflie_setpoints import Mode, Setpoint

GRAVITY = 9.81
KP, KV, KI = 6.0, 4.0, 2.0
"""Of the position loop, 1/s^2, 1/s, 1/s^3."""
MAX_TILT = math.radians(30.0)
MAX_ERROR_M = 1.0
MAX_INTEGRAL = 2.0
IDLE = 0.15
"""Share of the weight below which the motors do not count as running."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the controller knows: position m, velocity m/s, heading rad (not wrapped)."""

    position_m: Vec3
    velocity_mps: Vec3
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Drive:
    """What the controller wants: angles in rad, collective thrust in N."""

    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    thrust_n: float = 0.0


@dataclass
class Controller:
    """The loop with its memory."""

    airframe: Airframe
    _integral: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    _yaw: float = 0.0
    _hold: Vec3 | None = None
    _was: Mode = Mode.OFF

    def step(self, setpoint: Setpoint, estimate: Estimate, level_out: bool, dt_s: float) -> Drive:
        """One step.

        Args:
            setpoint: what to do.
            estimate: on what it relies.
            level_out: the client has been silent: keep the height, hold level.
            dt_s: length of the step.
        """
        mode = setpoint.mode
        if mode is Mode.OFF:
            self._integral = [0.0, 0.0, 0.0]
            self._yaw, self._was, self._hold = estimate.yaw_rad, mode, None
            return Drive(yaw=estimate.yaw_rad)
        if mode is not self._was:
            self._yaw, self._was, self._hold = estimate.yaw_rad, mode, None
        if mode is Mode.GOAL:
            self._yaw = estimate.yaw_rad + wrap(setpoint.goal.yaw_rad - estimate.yaw_rad)
        elif not level_out:
            self._yaw += setpoint.yaw_rate * dt_s
        weight_n = self.airframe.mass_kg * GRAVITY
        if mode is Mode.ATTITUDE:
            roll, pitch = (0.0, 0.0) if level_out else (setpoint.roll_rad, setpoint.pitch_rad)
            return Drive(roll, pitch, self._yaw, setpoint.thrust * self.airframe.thrust_n)
        ax, ay, az = self._accel(setpoint, estimate, dt_s)
        thrust_n = self.airframe.mass_kg * math.hypot(ax, ay, az + GRAVITY)
        if level_out or mode is Mode.ZDISTANCE:
            thrust_n = weight_n * max(0.0, 1.0 + az / GRAVITY)
            roll, pitch = (0.0, 0.0) if level_out else (setpoint.roll_rad, setpoint.pitch_rad)
        else:
            up = max(az + GRAVITY, 0.3 * GRAVITY)
            c, s = math.cos(estimate.yaw_rad), math.sin(estimate.yaw_rad)
            forward, left = c * ax + s * ay, -s * ax + c * ay
            pitch = _limit(math.atan2(forward, up), MAX_TILT)
            roll = _limit(-math.atan2(left, up), MAX_TILT)
            if az + GRAVITY <= 0.3 * GRAVITY:
                thrust_n = min(thrust_n, 0.3 * weight_n)
        return Drive(roll, pitch, self._yaw, min(thrust_n, self.airframe.thrust_n))

    def _accel(self, setpoint: Setpoint, estimate: Estimate, dt_s: float) -> Vec3:
        if setpoint.mode is Mode.GOAL:
            goal = setpoint.goal
            return self._follow(goal.position_m, goal.velocity_mps, goal.accel_mps2, estimate, dt_s)
        # velocity modes: the position to hold moves along with the commanded velocity
        vx, vy, vz = setpoint.velocity_mps
        if setpoint.mode is Mode.HOVER:
            c, s = math.cos(estimate.yaw_rad), math.sin(estimate.yaw_rad)
            vx, vy = c * vx - s * vy, s * vx + c * vy
        x, y, z = self._hold or estimate.position_m
        px, py, pz = estimate.position_m
        lead = 0.3  # m: a held point never runs away from a vehicle that cannot follow
        x = px + _limit(x + vx * dt_s - px, lead)
        y = py + _limit(y + vy * dt_s - py, lead)
        z = pz + _limit(z + vz * dt_s - pz, lead)
        if setpoint.mode is not Mode.VELOCITY:
            z = setpoint.height_m
        self._hold = (x, y, z)
        return self._follow(self._hold, (vx, vy, vz), (0.0, 0.0, 0.0), estimate, dt_s)

    def _follow(self, at: Vec3, speed: Vec3, accel: Vec3, estimate: Estimate, dt_s: float) -> Vec3:
        out = [0.0, 0.0, 0.0]
        for i in range(3):
            error = _limit(at[i] - estimate.position_m[i], MAX_ERROR_M)
            if abs(error) < 0.3:
                self._integral[i] = _limit(self._integral[i] + KI * error * dt_s, MAX_INTEGRAL)
            out[i] = accel[i] + KP * error + KV * (speed[i] - estimate.velocity_mps[i]) + self._integral[i]
        return (out[0], out[1], out[2])


def _limit(value: float, most: float) -> float:
    return max(-most, min(most, value))
