"""The Limo's chassis without its wire: what its ROS driver and firmware make of a Twist, how it moves and measures.

Sources: ``limo_driver.cpp`` and ``limo_driver.h`` of agilexrobotics/limo_ros2 (conversion of the Twist, error bits,
odometry, the status' stamp); the Limo's manual (1 m/s, turning radius 0.4 m, 12.6 V full, 8.25 V cut-off). The ROS
driver has no watchdog. The Limo's manual is silent about its firmware; AgileX' manuals of the sister chassis with the
same frame 0x111 (Scout 2.0, Tracer Mini: "receive-timeout 500 ms") have it stop half a second after the last command,
and so does this one. ``command_timeout_s=inf`` is a firmware without one.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

Mode = Literal["differential", "ackermann", "mecanum"]

MOTION_MODES: dict[Mode, int] = {"differential": 0, "ackermann": 1, "mecanum": 2}
TOP_SPEED_MPS = 1.0
TURNING_RADIUS_M = 0.4
"""By the manual. The ROS driver's own limit, 28 degrees of the inner wheel, would be 0.46 m."""
TURN_RATE_RADPS = 1.5
"""Fastest turn on the spot."""
TURN_ACCEL_RADPS2 = 5.0
STEER_RATE = 5.0
"""How fast the steering changes the curvature, 1/(m s): lock to lock in a second."""
COMMAND_TIMEOUT_S = 0.5
FULL_V, CUT_OFF_V = 12.6, 8.25
SAG_V = 0.2
"""What the voltage falls by at full speed."""
BATTERY_EMPTY, MOTOR_1, DRIVE_STATUS = 0x0001, 0x0008, 0x0100
_SLIP_S = 1.0
_DISCHARGE = ((0.0, 2.75), (0.05, 3.2), (0.1, 3.38), (0.2, 3.52), (0.4, 3.65), (0.6, 3.8), (0.8, 3.97), (1.0, 4.2))


@dataclass(frozen=True, slots=True)
class Frame:
    """What the ROS driver sends down the serial line for one Twist.

    Attributes:
        forward_mps, left_mps: commanded velocity of the body.
        turn_radps: commanded yaw rate; 0 in Ackermann mode.
        curvature: steering in Ackermann mode, 1/m, left positive.
    """

    forward_mps: float = 0.0
    left_mps: float = 0.0
    turn_radps: float = 0.0
    curvature: float = 0.0


@dataclass(frozen=True, slots=True)
class Motion:
    """Where the chassis is and how it moves, in the arena frame."""

    x_m: float
    y_m: float
    yaw_rad: float
    vx_mps: float = 0.0
    vy_mps: float = 0.0
    turn_radps: float = 0.0


def _millis(value: float) -> float:
    """The serial frame carries whole mm/s and mrad/s, rounded towards 0."""
    return math.trunc(min(max(value, -32.0), 32.0) * 1000.0) / 1000.0


def frame_of(mode: Mode, linear_x: float, linear_y: float, angular_z: float) -> Frame | None:
    """What the ROS driver makes of a Twist; None where nothing comes of it.

    In Ackermann mode it divides linear by angular speed; 0 by 0 gives a steering angle that is not a number, converted
    to an integer, which C++ leaves undefined: here that frame is lost.
    """
    if not all(map(math.isfinite, (linear_x, linear_y, angular_z))):
        return None
    if mode == "differential":
        return Frame(_millis(linear_x), 0.0, _millis(angular_z))
    if mode == "mecanum":
        return Frame(_millis(linear_x), _millis(linear_y), _millis(angular_z))
    if linear_x == 0.0 and angular_z == 0.0:
        return None
    if angular_z == 0.0:
        return Frame(_millis(linear_x))
    # a radius below what the wheels can do (the extreme: turning on the spot) steers to the stop
    radius_m = linear_x / angular_z
    least_m = TURNING_RADIUS_M
    if abs(radius_m) < least_m:
        radius_m = math.copysign(least_m, radius_m if radius_m else angular_z)
    return Frame(_millis(linear_x), 0.0, 0.0, 1.0 / radius_m)


def battery_v(level: float, speed_mps: float) -> float:
    """Terminal voltage, in steps of 0.1 V, at charge ``level`` 0..1: three Li-ion cells in series."""
    cell = _DISCHARGE[-1][1]
    for (a, low), (b, high) in pairwise(_DISCHARGE):
        if level <= b:
            cell = low + (high - low) * (max(level, 0.0) - a) / (b - a)
            break
    return round(3.0 * cell - SAG_V * min(1.0, abs(speed_mps) / TOP_SPEED_MPS), 1)


def _toward(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)


class LimoBase:
    """A chassis that drives.

    Args:
        mode: as its hardware is set up.
        start: where it stands.
        max_speed_mps: at the most ``TOP_SPEED_MPS`` counts.
        accel_mps2: of starts and stops.
        slip_m: size of its disturbances while it drives: how far it wanders in a second.
        seed: of slip and odometry errors.
        command_timeout_s: the firmware stops so long after the last command.
    """

    def __init__(
        self,
        mode: Mode,
        start: Motion,
        *,
        max_speed_mps: float = TOP_SPEED_MPS,
        accel_mps2: float = 1.0,
        slip_m: float = 0.0,
        seed: int = 0,
        command_timeout_s: float = COMMAND_TIMEOUT_S,
    ) -> None:
        self.mode = mode
        self.motion = start
        self.forward_mps = self.left_mps = self.turn_radps = self.curvature = 0.0
        self._top_mps = min(max_speed_mps, TOP_SPEED_MPS)
        self._accel = accel_mps2
        self._timeout_s = command_timeout_s
        self._random = random.Random(seed)
        self._slip_m = slip_m
        self._slip_mps = 0.0
        self._frame = Frame()
        self._frame_s = -math.inf
        # its odometry: wheels that are not quite round, a gyroscope with a bias
        self._scale = 1.0 + self._random.gauss(0.0, 0.02)
        self._bias_radps = self._random.gauss(0.0, 0.003)
        self.odometry = Motion(0.0, 0.0, 0.0)

    def command(self, now_s: float, frame: Frame) -> None:
        """Takes a frame; it stays in force until the next one or the time-out."""
        self._frame, self._frame_s = frame, now_s

    def in_force(self, now_s: float) -> Frame:
        """The command that holds now; all 0 after the time-out, with the wheels where they were."""
        if now_s - self._frame_s <= self._timeout_s:
            return self._frame
        return Frame(curvature=self._frame.curvature)

    def step(self, now_s: float, dt_s: float, *, slow: float = 1.0, dead: bool = False) -> Motion:
        """Lets ``dt_s`` pass.

        Args:
            now_s: time at its end.
            dt_s: s.
            slow: factor of every speed; 0: stalled.
            dead: its motors do not turn.
        """
        want = Frame() if dead else self.in_force(now_s)
        forward, left, turn = want.forward_mps, want.left_mps, want.turn_radps
        speed = math.hypot(forward, left)
        factor = slow * min(1.0, self._top_mps / speed if speed > 0.0 else 1.0)
        most = self._accel * dt_s
        self.forward_mps = _toward(self.forward_mps, forward * factor, most)
        if self.mode == "mecanum":
            self.left_mps = _toward(self.left_mps, left * factor, most)
        if self.mode == "ackermann":
            if not dead:
                self.curvature = _toward(self.curvature, want.curvature, STEER_RATE * dt_s)
            self.turn_radps = self.forward_mps * self.curvature
        else:
            turn = min(max(turn, -TURN_RATE_RADPS), TURN_RATE_RADPS) * slow
            self.turn_radps = _toward(self.turn_radps, turn, TURN_ACCEL_RADPS2 * dt_s)
        self._move(dt_s)
        return self.motion

    def _move(self, dt_s: float) -> None:
        speed = math.hypot(self.forward_mps, self.left_mps)
        slip = 0.0
        if self._slip_m > 0.0 and speed > 1e-3:
            share = min(1.0, dt_s / _SLIP_S)
            self._slip_mps += -share * self._slip_mps + self._random.gauss(0.0, self._slip_m * math.sqrt(2.0 * share))
            slip = self._slip_mps * min(1.0, speed / 0.1)
        self.motion = _moved(self.motion, self.forward_mps, self.left_mps + slip, self.turn_radps, dt_s)
        self.odometry = _moved(
            self.odometry,
            self.forward_mps * self._scale,
            self.left_mps * self._scale,
            self.turn_radps + self._bias_radps,
            dt_s,
        )


def _moved(at: Motion, forward: float, left: float, turn: float, dt_s: float) -> Motion:
    middle = at.yaw_rad + 0.5 * turn * dt_s
    c, s = math.cos(middle), math.sin(middle)
    vx, vy = c * forward - s * left, s * forward + c * left
    yaw = math.remainder(at.yaw_rad + turn * dt_s, math.tau)
    return Motion(at.x_m + vx * dt_s, at.y_m + vy * dt_s, yaw, vx, vy, turn)
