"""What a simulated autopilot believes about where it is: by GPS, or by the poses that it is sent.

By GPS the local frame (NED) begins where the vehicle was switched on and its north is true north. By external vision
the frame is whatever the poses are in: position and heading follow them, and a frame that is turned against them makes
the vehicle fly in spirals, as it does in reality.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from drivers.geodesy import GeoFrame
from drivers.vehicle import Vec2, Vec3
from sim_backends.wire.mavlink_body import wrap

Source = Literal["gps", "vision"]

WANDER_S = 8.0
"""Time constant of the error of GPS."""
FAR_M = 1e5
"""An external pose further away than this is rubbish."""
BLEND = 0.3
"""Share of an external pose's innovation that the estimate takes on."""
FIRST_POSES = 10
"""So many external poses make a position (the filter's start takes a while)."""


@dataclass(frozen=True, slots=True)
class Quality:
    """How the estimate is made.

    Attributes:
        noise_m: standard deviation of GPS, per axis.
        timeout_s: without external poses for this long the position is not valid any more.
        drift_mps: how fast the position runs away until then.
        follow_mps: how fast it follows poses that jump.
    """

    noise_m: float = 0.02
    timeout_s: float = 5.0
    drift_mps: float = 0.1
    follow_mps: float = 2.0


class Estimate:
    """Position, velocity and heading in the local frame.

    Attributes:
        ned, velocity: m and m/s.
        yaw: clockwise from the local frame's north.
    """

    def __init__(
        self,
        source: Source,
        frame: GeoFrame,
        start_m: Vec3,
        quality: Quality,
        seed: str,
        accepts: Callable[[], bool] = lambda: True,
    ) -> None:
        """Starts at a place.

        Args:
            source: of the position.
            frame: of the arena on the globe.
            start_m: where it is switched on, arena.
            quality: of the estimate.
            seed: of its noise.
            accepts: whether the parameters allow external poses.
        """
        self._source: Source = source
        self._frame, self._quality, self._accepts = frame, quality, accepts
        self._random = random.Random(seed)
        self._error = [0.0, 0.0, 0.0]
        self._start_z = start_m[2]
        self._turn = 0.0
        self._poses = 0
        self._pose_s = -math.inf
        self._now_s = 0.0
        self._away = self._random.uniform(0.0, math.tau)
        self.local: GeoFrame | None = None
        if source == "gps":
            lat, lon = frame.to_globe((start_m[0], start_m[1]))
            self.local = GeoFrame(lat, lon)
        self.ned: Vec3 = (0.0, 0.0, 0.0)
        self.velocity: Vec3 = (0.0, 0.0, 0.0)
        self.yaw = 0.0

    @property
    def position_ok(self) -> bool:
        """The position may be flown by."""
        if self._source == "gps":
            return True
        return self._poses >= FIRST_POSES and self.pose_age_s < self._quality.timeout_s

    @property
    def pose_age_s(self) -> float:
        """Since the last external pose."""
        return self._now_s - self._pose_s

    @property
    def global_ok(self) -> bool:
        """The position is known on the globe."""
        return self.local is not None and self.position_ok

    def set_origin(self, lat_deg: float, lon_deg: float) -> bool:
        """Says where on the globe the local frame of external poses begins; once, as in both firmwares."""
        if self._source == "gps" or self.local is not None or not (abs(lat_deg) <= 90.0 and abs(lon_deg) <= 180.0):
            return False
        self.local = GeoFrame(lat_deg, lon_deg)
        return True

    def to_ned(self, lat_deg: float, lon_deg: float) -> Vec2:
        """A place of the globe in the local frame, (north, east)."""
        assert self.local is not None
        east, north = self.local.to_arena(lat_deg, lon_deg)
        return (north, east)

    def to_globe(self, ned: Vec3) -> tuple[float, float]:
        """A place of the local frame as (lat, lon)."""
        assert self.local is not None
        return self.local.to_globe((ned[1], ned[0]))

    def arena_velocity(self, ned: Vec3) -> Vec3:
        """What really happens when it steers a velocity of its local frame."""
        c, s = math.cos(-self._turn), math.sin(-self._turn)
        north, east = c * ned[0] - s * ned[1], s * ned[0] + c * ned[1]
        return (*self._rotated(east, north, self._frame.rotation_rad), -ned[2])

    @staticmethod
    def _rotated(x: float, y: float, angle: float) -> Vec2:
        c, s = math.cos(angle), math.sin(angle)
        return (c * x - s * y, s * x + c * y)

    def step(self, now_s: float, dt: float, position_m: Vec3, velocity_mps: Vec3, yaw_rad: float) -> None:
        """Lets time pass.

        Args:
            now_s: monotonic.
            dt: s.
            position_m: of the body, arena.
            velocity_mps: of the body, arena.
            yaw_rad: of the body, counter-clockwise from x.
        """
        self._now_s = now_s
        east, north = self._rotated(velocity_mps[0], velocity_mps[1], -self._frame.rotation_rad)
        c, s = math.cos(self._turn), math.sin(self._turn)
        self.velocity = (c * north - s * east, s * north + c * east, -velocity_mps[2])
        self.yaw = wrap(self._true_yaw(yaw_rad) + self._turn)
        if self._source == "gps":
            self._by_gps(dt, position_m)
            return
        n, e, d = (p + v * dt for p, v in zip(self.ned, self.velocity, strict=True))
        if self.pose_age_s > 0.5:
            run = self._quality.drift_mps * dt
            n, e = n + run * math.cos(self._away), e + run * math.sin(self._away)
        self.ned = (n, e, d)

    def _true_yaw(self, yaw_rad: float) -> float:
        return 0.5 * math.pi - (yaw_rad - self._frame.rotation_rad)

    def _by_gps(self, dt: float, position_m: Vec3) -> None:
        size = self._quality.noise_m * math.sqrt(2.0 * dt / WANDER_S)
        if size > 0.0:
            self._error = [e - e * dt / WANDER_S + self._random.gauss(0.0, size) for e in self._error]
        lat, lon = self._frame.to_globe((position_m[0], position_m[1]))
        n, e = self.to_ned(lat, lon)
        a, b, c = self._error
        self.ned = (n + a, e + b, self._start_z - position_m[2] + c)

    def pose(self, now_s: float, ned: Vec3, yaw: float, body_yaw_rad: float) -> None:
        """An external pose.

        Args:
            now_s: receipt.
            ned: position in the frame of the poses.
            yaw: heading in it; NaN: unknown.
            body_yaw_rad: the body's real heading in the arena, which the filter compares by its gyroscopes.
        """
        if self._source != "vision" or not self._accepts() or not all(abs(v) < FAR_M for v in ned):
            return
        dt = now_s - self._pose_s
        first = self._poses == 0 or dt > self._quality.timeout_s
        self._poses = 1 if first else self._poses + 1
        self._pose_s = self._now_s = now_s
        if math.isfinite(yaw):
            turn = wrap(yaw - self._true_yaw(body_yaw_rad))
            self._turn = turn if first else wrap(self._turn + BLEND * wrap(turn - self._turn))
        if first:
            self.ned = ned
            return
        step = [BLEND * (new - old) for new, old in zip(ned, self.ned, strict=True)]
        size, most = math.hypot(*step), self._quality.follow_mps * max(dt, 0.005)
        share = 1.0 if size <= most else most / size
        n, e, d = (old + share * s for old, s in zip(self.ned, step, strict=True))
        self.ned = (n, e, d)
