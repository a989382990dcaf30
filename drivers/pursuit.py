"""Regulated pure pursuit: from a path and the newest pose to the velocity to command now. Pure.

After Macenski et al., "Regulated Pure Pursuit for Robot Path Tracking" (2023): steer on the arc to a point a little
ahead on the path, slower in curves, near the end and off the path. Added: what each kind of drive does at corners that
it cannot round, speed limits that keep to the acceleration, and a second try where the end was missed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from drivers import pursuit_route as route
from drivers.errors import DriverError
from drivers.pursuit_route import Piece
from drivers.vehicle import Vec2

Mode = Literal["differential", "ackermann", "mecanum"]


class TuningError(DriverError, ValueError):
    """A number that does not do; a ``ValueError`` too, so that whoever reads it from a file can add where."""


@dataclass(frozen=True, slots=True)
class Tuning:
    """How it drives; the defaults suit a Limo followed by motion capture.

    Attributes:
        turning_radius_m: least, in Ackermann mode (Limo manual: 0.4 m).
        turn_rate_radps: on the spot, and at the most while driving.
        turn_accel_radps2: of the yaw rate.
        lookahead_s: looks so far ahead at its speed; shorter oscillates, longer cuts corners.
        lookahead_min_m: and at least so far: a Limo is 0.3 m long.
        arrive_m: near enough to the end; the noise of motion capture and a braking distance at crawling speed.
        settle_m: further off than this after stopping at the end, it tries again.
        latency_s: from a pose to the wheels: motion capture, one period of 50 ms, and the robot's own.
        crawl_mps: slowest speed that surely turns the wheels.
        off_path_m: further off the path it goes at half speed.
        tries: so often it tries again at the end.
    """

    turning_radius_m: float = 0.4
    turn_rate_radps: float = 1.0
    turn_accel_radps2: float = 3.0
    lookahead_s: float = 0.7
    lookahead_min_m: float = 0.2
    arrive_m: float = 0.015
    settle_m: float = 0.04
    latency_s: float = 0.12
    crawl_mps: float = 0.04
    off_path_m: float = 0.15
    tries: int = 3

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise TuningError(f"{name} is {value!r}; give a number above 0")


@dataclass(frozen=True, slots=True)
class Motion:
    """Velocities in the body frame: m/s forward and to the left, rad/s to the left."""

    forward_mps: float = 0.0
    left_mps: float = 0.0
    turn_radps: float = 0.0

    @property
    def still(self) -> bool:
        """Nothing is commanded to move."""
        return self.forward_mps == 0.0 and self.left_mps == 0.0 and self.turn_radps == 0.0


STILL = Motion()


def carried_on(x_m: float, y_m: float, yaw_rad: float, motion: Motion, age_s: float) -> tuple[float, float, float]:
    """Where a body is ``age_s`` after it was seen, if it has moved as commanded."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    x_m += age_s * (c * motion.forward_mps - s * motion.left_mps)
    y_m += age_s * (s * motion.forward_mps + c * motion.left_mps)
    return x_m, y_m, yaw_rad + age_s * motion.turn_radps


JOIN_M = 0.3
"""A path that begins nearer than this is joined where it is nearest; else its first point is driven to."""
_WINDOW_M = 1.0
_ROTATE_AT, _ROTATED = math.radians(35.0), math.radians(4.0)
_GEAR_AT = math.radians(100.0)
_SWING_AT, _SWUNG, _SWING_MPS = math.radians(60.0), math.radians(30.0), 0.2
_STEER_RATE = 4.0
"""How fast the steering is expected to change the curvature, 1/(m s)."""


def _toward(value: float, target: float, most: float) -> float:
    return value + min(max(target - value, -most), most)


class Pursuit:
    """Follows one path; asked once a period.

    Args:
        path: points in the arena frame, m.
        mode: the drive.
        max_speed_mps, accel_mps2: never exceeded.
        tuning: how it drives.
    """

    def __init__(
        self, path: Sequence[Vec2], mode: Mode, max_speed_mps: float, accel_mps2: float, tuning: Tuning | None = None
    ) -> None:
        self.path = tuple(path)
        self.speed_mps = max_speed_mps
        self.arrived = False
        self.missed_m: float | None = None
        self._mode: Mode = mode
        self._accel = accel_mps2
        self._t = tuning or Tuning()
        self._pieces: list[Piece] | None = None
        self._piece = 0
        self._at_m = self._off_m = 0.0
        self._tries = self._t.tries
        self._gear, self._way = 0, 1
        self._rotating = False
        self._swing = 0.0
        self._yaw_held: float | None = None
        # what was commanded last
        self._speed = self._turn = self._curvature = 0.0
        self._direction = 0.0

    @property
    def off_m(self) -> float:
        """How far off the path it was at the last step."""
        return self._off_m

    def take_over(self, other: Pursuit) -> None:
        """Goes on from the velocity that ``other`` has commanded last."""
        self._speed, self._turn, self._curvature = other._speed, other._turn, other._curvature
        self._direction, self._yaw_held = other._direction, other._yaw_held
        self._way = other._way
        self._gear = other._way if other._speed > 0.0 else 0

    def brake(self, dt_s: float, yaw_rad: float | None = None) -> Motion:
        """What to command in order to stop, on the arc that it is on; it can go on afterwards."""
        self._rotating, self._gear = False, self._gear if self._speed > 0.0 else 0
        self._speed = _toward(self._speed, 0.0, self._accel * dt_s)
        self._turn = _toward(self._turn, 0.0, self._t.turn_accel_radps2 * dt_s)
        if self._speed == 0.0 and (self._mode == "ackermann" or abs(self._turn) < 1e-6):
            self._turn = 0.0
        return self._motion(yaw_rad)

    def step(self, x_m: float, y_m: float, yaw_rad: float, dt_s: float) -> Motion:
        """The velocity for the next ``dt_s``.

        Args:
            x_m: position, arena frame.
            y_m: position, arena frame.
            yaw_rad: heading.
            dt_s: since the last step.
        """
        if self._pieces is None:
            self._begin(x_m, y_m)
        pieces = self._pieces or []
        if self.arrived or not pieces:
            self.arrived = True
            return self.brake(dt_s, yaw_rad)
        piece = pieces[self._piece]
        along_m, self._off_m = piece.locate(x_m, y_m, self._at_m, self._at_m + _WINDOW_M)
        self._at_m = min(max(self._at_m, along_m), piece.length_m)
        left_m = piece.length_m - along_m
        if left_m <= self._t.arrive_m:
            motion = self.brake(dt_s, yaw_rad)
            if motion.still:
                self._next(x_m, y_m, yaw_rad)
            return motion
        drive = {"differential": self._differential, "ackermann": self._ackermann, "mecanum": self._mecanum}
        return drive[self._mode](piece, x_m, y_m, yaw_rad, left_m, dt_s)

    def _begin(self, x_m: float, y_m: float) -> None:
        path: Sequence[Vec2] = self.path
        made = self._cut(path)
        if not made or made[0].locate(x_m, y_m, 0.0, JOIN_M)[1] > JOIN_M:
            path = ((x_m, y_m), *path)
            made = self._cut(path)
        self._pieces = made

    def _cut(self, path: Sequence[Vec2]) -> list[Piece]:
        if self._mode == "ackermann":
            return route.pieces(path, route.CUSP_TURN_RAD, 1.1 * self._t.turning_radius_m)
        return route.pieces(path, route.STOP_TURN_RAD, 0.5 * self._t.lookahead_min_m)

    def _next(self, x_m: float, y_m: float, yaw_rad: float) -> None:
        """It stands at the end of a piece: on to the next one, or another try, or arrived."""
        pieces = self._pieces or []
        self._at_m, self._gear, self._rotating = 0.0, 0, False
        if self._piece + 1 < len(pieces):
            self._piece += 1
            return
        end = pieces[-1].points[-1]
        off_m = math.dist(end, (x_m, y_m))
        if off_m <= self._t.settle_m or self._tries == 0:
            self.arrived = True
            self.missed_m = off_m if off_m > self._t.settle_m else None
            return
        self._tries -= 1
        again: list[Vec2] = [(x_m, y_m), end]
        if self._mode == "ackermann":
            # it cannot move sideways: back off so far that the arc to the end is one that it can drive
            c, s = math.cos(yaw_rad), math.sin(yaw_rad)
            ahead_m = (end[0] - x_m) * c + (end[1] - y_m) * s
            beside_m = abs((end[1] - y_m) * c - (end[0] - x_m) * s)
            room_m = 0.15 + math.sqrt(4.0 * beside_m * self._t.turning_radius_m)
            again.insert(1, (x_m + (ahead_m - room_m) * c, y_m + (ahead_m - room_m) * s))
        self._pieces = [Piece.of(pair) for pair in pairwise(again) if math.dist(*pair) > 1e-3]
        self._piece = 0

    def _limit(self, piece: Piece, left_m: float, curvature: float) -> float:
        """The speed from which it can still keep to everything that lies ahead."""
        t, brake = self._t, 0.6 * self._accel
        limit = self.speed_mps
        room_m = max(0.0, left_m - 0.5 * t.arrive_m - self._speed * t.latency_s)
        limit = min(limit, math.sqrt(2.0 * brake * room_m))
        if abs(curvature) > 1e-6:
            limit = min(limit, math.sqrt(0.5 * self._accel / abs(curvature)), t.turn_rate_radps / abs(curvature))
        for at_m, turn in zip(piece.at_m, piece.turn_rad, strict=True):
            ahead_m = at_m - self._at_m - self._speed * t.latency_s
            if turn > 0.0 and ahead_m > -0.05:
                # as if the corner were an arc over one look-ahead
                corner = math.sqrt(0.5 * self._accel * t.lookahead_min_m / turn)
                limit = min(limit, math.sqrt(corner**2 + 2.0 * brake * max(0.0, ahead_m)))
        if self._off_m > t.off_path_m:
            limit = min(limit, 0.5 * self.speed_mps)
        return max(limit, min(t.crawl_mps, self.speed_mps))

    def _carrot(self, piece: Piece) -> Vec2:
        ahead_m = max(self._t.lookahead_min_m, self._t.lookahead_s * self._speed)
        # what moves sideways need not look as far ahead in order not to swing
        return piece.point(self._at_m + (0.5 * ahead_m if self._mode == "mecanum" else ahead_m))

    def _differential(self, piece: Piece, x_m: float, y_m: float, yaw_rad: float, left_m: float, dt_s: float) -> Motion:
        cx, cy = self._carrot(piece)
        error = math.remainder(math.atan2(cy - y_m, cx - x_m) - yaw_rad, math.tau)
        if abs(error) > _ROTATE_AT and not self._rotating:
            motion = self.brake(dt_s)
            self._rotating = motion.still
            return motion
        if self._rotating:
            # proportional near the end, so that a late robot does not swing past it; the way round, once begun, is kept
            way = self._turn if self._turn and abs(error) > 0.5 * math.pi else error
            want = math.copysign(min(self._t.turn_rate_radps, 1.5 * abs(error)), way)
            self._rotating = abs(error) > _ROTATED
            self._turn = _toward(self._turn, want if self._rotating else 0.0, self._t.turn_accel_radps2 * dt_s)
            return Motion(0.0, 0.0, self._turn)
        curvature = 2.0 * math.sin(error) / math.hypot(cx - x_m, cy - y_m)
        self._speed = _toward(self._speed, self._limit(piece, left_m, curvature), self._accel * dt_s)
        self._turn = _toward(self._turn, self._speed * curvature, self._t.turn_accel_radps2 * dt_s)
        self._gear = 1
        return Motion(self._speed, 0.0, self._turn)

    def _ackermann(self, piece: Piece, x_m: float, y_m: float, yaw_rad: float, left_m: float, dt_s: float) -> Motion:
        cx, cy = self._carrot(piece)
        error = math.remainder(math.atan2(cy - y_m, cx - x_m) - yaw_rad, math.tau)
        if self._gear == 0:
            self._gear = 1 if abs(error) <= _GEAR_AT else -1
        if self._gear < 0:
            error = math.remainder(error + math.pi, math.tau)
        most = 1.0 / self._t.turning_radius_m
        if self._swing:
            return self._swung(error, most, dt_s)
        if abs(error) > _GEAR_AT:
            # the path lies behind: stop (which takes the gear out) and go on the other way round
            return self.brake(dt_s)
        if abs(error) > _SWING_AT and self._is_within_circle(error, math.hypot(cx - x_m, cy - y_m)):
            gear, motion = self._gear, self.brake(dt_s)
            if motion.still:
                self._swing, self._gear = math.copysign(1.0, error), gear
            return motion
        want = min(max(2.0 * math.sin(error) / math.hypot(cx - x_m, cy - y_m), -most), most)
        limit = self._limit(piece, left_m, want)
        self._way = self._gear
        self._curvature = _toward(self._curvature, self._gear * want, _STEER_RATE * dt_s)
        if abs(self._curvature - self._gear * want) > 0.4 * most:
            limit = min(limit, self._t.crawl_mps)
        self._speed = _toward(self._speed, limit, self._accel * dt_s)
        return self._motion(None, self._gear * want)

    def _is_within_circle(self, error: float, ahead_m: float) -> bool:
        """Whether a point lies where the tightest turn towards it circles around it."""
        r = self._t.turning_radius_m
        return math.hypot(ahead_m * math.cos(error), ahead_m * abs(math.sin(error)) - r) < 0.95 * r

    def _swung(self, error: float, most: float, dt_s: float) -> Motion:
        """Back on the opposite lock, as in a three-point turn, until the path lies ahead."""
        if abs(error) < _SWUNG or error * self._swing < 0.0:
            gear, motion = self._gear, self.brake(dt_s)
            self._gear = gear
            if motion.still:
                self._swing = 0.0
            return motion
        self._way = -self._gear
        self._curvature = _toward(self._curvature, self._way * self._swing * most, _STEER_RATE * dt_s)
        self._speed = _toward(self._speed, min(self.speed_mps, _SWING_MPS), self._accel * dt_s)
        return self._motion(None, self._way * self._swing * most)

    def _mecanum(self, piece: Piece, x_m: float, y_m: float, yaw_rad: float, left_m: float, dt_s: float) -> Motion:
        if self._yaw_held is None:
            self._yaw_held = yaw_rad
        cx, cy = self._carrot(piece)
        ahead_m = math.hypot(cx - x_m, cy - y_m)
        limit = self._limit(piece, left_m, 0.0)
        direction = math.atan2(cy - y_m, cx - x_m)
        if self._speed > self._t.crawl_mps and abs(math.remainder(direction - self._direction, math.tau)) > _ROTATE_AT:
            return self.brake(dt_s, yaw_rad)
        self._direction = direction
        self._speed = _toward(self._speed, limit if ahead_m > 0.0 else 0.0, self._accel * dt_s)
        error = math.remainder(self._yaw_held - yaw_rad, math.tau)
        want = min(max(1.5 * error, -self._t.turn_rate_radps), self._t.turn_rate_radps)
        self._turn = _toward(self._turn, want, self._t.turn_accel_radps2 * dt_s)
        return self._motion(yaw_rad)

    def _motion(self, yaw_rad: float | None, curvature: float | None = None) -> Motion:
        if self._mode == "mecanum":
            if yaw_rad is None or self._speed == 0.0:
                return Motion(0.0, 0.0, self._turn)
            at = self._direction - yaw_rad
            return Motion(self._speed * math.cos(at), self._speed * math.sin(at), self._turn)
        if self._mode == "ackermann":
            if self._speed == 0.0:
                return STILL
            steer = self._curvature if curvature is None else curvature
            forward = self._way * self._speed
            return Motion(forward, 0.0, forward * steer)
        return Motion(self._speed, 0.0, self._turn)
