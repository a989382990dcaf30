"""Set-points: what the controller is to do, and how the low-level ones arrive in packets.

Source: ``crtp_commander_generic.c`` and ``crtp_commander_rpyt.c`` of the firmware, ``cflib/crazyflie/commander.py``.
Angles are in rad here, in degrees on the wire; the wire's pitch is positive nose up, ours (x forward, y left, z up)
nose down.
"""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import Enum, auto

from drivers.vehicle import Vec3
from sim_backends.wire.crazyflie_planner import Goal
from sim_backends.wire.crtp_packets import decompress_quaternion, yaw_of

STOP, VELOCITY_LEGACY, ZDISTANCE_LEGACY, HOVER_LEGACY = 0, 1, 2, 5
FULL_STATE, POSITION, VELOCITY, ZDISTANCE, HOVER, MANUAL = 6, 7, 8, 9, 10, 11
_LEGACY = {VELOCITY_LEGACY: VELOCITY, ZDISTANCE_LEGACY: ZDISTANCE, HOVER_LEGACY: HOVER}


NOWHERE = Goal()


class Mode(Enum):
    """What of a set-point holds."""

    OFF = auto()
    GOAL = auto()
    VELOCITY = auto()
    HOVER = auto()
    ZDISTANCE = auto()
    ATTITUDE = auto()


@dataclass(frozen=True, slots=True)
class Setpoint:
    """One set-point.

    Attributes:
        mode: which of the following hold.
        goal: GOAL.
        velocity_mps: VELOCITY (arena), HOVER (x and y in the body's heading).
        height_m: HOVER, ZDISTANCE.
        roll_rad, pitch_rad: ZDISTANCE, ATTITUDE.
        yaw_rate: rad/s, all but GOAL.
        thrust: 0..1, ATTITUDE.
    """

    mode: Mode = Mode.OFF
    goal: Goal = NOWHERE
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)
    height_m: float = 0.0
    roll_rad: float = 0.0
    pitch_rad: float = 0.0
    yaw_rate: float = 0.0
    thrust: float = 0.0

    @property
    def finite(self) -> bool:
        """Whether all its numbers are."""
        g = self.goal
        numbers = (*g.position_m, *g.velocity_mps, *g.accel_mps2, g.yaw_rad, g.yaw_rate, *self.velocity_mps)
        more = (self.height_m, self.roll_rad, self.pitch_rad, self.yaw_rate, self.thrust)
        return all(map(math.isfinite, (*numbers, *more)))


def decode_generic(data: bytes) -> Setpoint | None:
    """A packet on the generic set-point port; None where it is none or its numbers are not finite."""
    try:
        setpoint = _generic(data)
    except struct.error:
        return None
    return setpoint if setpoint is not None and setpoint.finite else None


def _generic(data: bytes) -> Setpoint | None:
    if not data:
        return None
    sign = -1.0 if data[0] in _LEGACY else 1.0
    kind, rest = _LEGACY.get(data[0], data[0]), data[1:]
    if kind == STOP:
        return Setpoint()
    if kind == VELOCITY:
        vx, vy, vz, rate = struct.unpack_from("<ffff", rest)
        return Setpoint(Mode.VELOCITY, velocity_mps=(vx, vy, vz), yaw_rate=sign * math.radians(rate))
    if kind == ZDISTANCE:
        roll, pitch, rate, z = map(float, struct.unpack_from("<ffff", rest))
        tilt = (math.radians(roll), -math.radians(pitch), sign * math.radians(rate))
        return Setpoint(Mode.ZDISTANCE, roll_rad=tilt[0], pitch_rad=tilt[1], yaw_rate=tilt[2], height_m=z)
    if kind == HOVER:
        vx, vy, rate, z = struct.unpack_from("<ffff", rest)
        return Setpoint(Mode.HOVER, velocity_mps=(vx, vy, 0.0), yaw_rate=sign * math.radians(rate), height_m=z)
    if kind == POSITION:
        x, y, z, yaw = struct.unpack_from("<ffff", rest)
        return Setpoint(Mode.GOAL, Goal((x, y, z), yaw_rad=math.radians(yaw)))
    if kind == FULL_STATE:
        *v, packed, _, _, rate = struct.unpack_from("<hhhhhhhhhIhhh", rest)
        p, s, a = ((v[i] / 1000, v[i + 1] / 1000, v[i + 2] / 1000) for i in (0, 3, 6))
        yaw = yaw_of(*decompress_quaternion(packed))
        return Setpoint(Mode.GOAL, Goal(p, s, a, yaw, math.radians(rate / 1000)))
    if kind == MANUAL:
        roll, pitch, rate, thrust, _ = struct.unpack_from("<fffHB", rest)
        return _attitude(roll, pitch, rate, thrust)
    return None


def _attitude(roll: float, pitch: float, rate: float, thrust: int) -> Setpoint:
    tilt = (math.radians(roll), -math.radians(pitch))
    level = thrust / 65535
    return Setpoint(Mode.ATTITUDE, roll_rad=tilt[0], pitch_rad=tilt[1], yaw_rate=-math.radians(rate), thrust=level)


class RpytDecoder:
    """The classic port: roll, pitch, yaw rate and thrust; thrust is locked until it has been zero once."""

    def __init__(self) -> None:
        self._locked = True

    def decode(self, data: bytes) -> Setpoint | None:
        """The set-point in a packet; None where it is none."""
        try:
            roll, pitch, rate, thrust = struct.unpack_from("<fffH", data)
        except struct.error:
            return None
        if thrust == 0:
            self._locked = False
        if self._locked or thrust < 1000:
            return Setpoint()
        setpoint = _attitude(roll, pitch, rate, thrust)
        return setpoint if setpoint.finite else None
