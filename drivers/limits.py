"""What a vehicle can do and what it carries, as its driver must know it; arena frame, m and s."""

from __future__ import annotations

import threading
from collections.abc import Iterable
from dataclasses import dataclass

from drivers.vehicle import Command, Dock, Drive, GoTo, Land, Pose, TakeOff, Vec2


@dataclass(frozen=True, slots=True)
class UavLimits:
    """Limits that a driver never exceeds, whatever it is told.

    Attributes:
        max_speed_mps: horizontal speed.
        accel_mps2: of starts and stops.
        climb_mps, descent_mps: vertical speeds.
        altitude_m: greatest altitude.
    """

    max_speed_mps: float
    accel_mps2: float
    climb_mps: float
    descent_mps: float
    altitude_m: float

    def limited(self, command: Command) -> Command:
        """``command`` with its speeds and altitudes cut down to these limits."""
        match command:
            case TakeOff(vehicle, altitude, speed):
                return TakeOff(vehicle, min(altitude, self.altitude_m), min(speed, self.climb_mps))
            case GoTo(vehicle, (x, y, z), speed):
                return GoTo(vehicle, (x, y, min(z, self.altitude_m)), min(speed, self.max_speed_mps))
            case Land(vehicle, speed):
                return Land(vehicle, min(speed, self.descent_mps))
            case Dock(vehicle, onto, dock, speed, abort):
                return Dock(vehicle, onto, dock, min(speed, self.descent_mps), min(abort, self.altitude_m))
        return command


@dataclass(frozen=True, slots=True)
class UgvLimits:
    """As ``UavLimits``, for what drives."""

    max_speed_mps: float
    accel_mps2: float

    def limited(self, command: Command) -> Command:
        """``command`` with the speed of a drive cut down to the limit."""
        if isinstance(command, Drive):
            return Drive(command.vehicle, command.path_m, min(command.speed_mps, self.max_speed_mps))
        return command


@dataclass(frozen=True, slots=True)
class Pads:
    """The docks on a UGV.

    Attributes:
        body: the UGV's name in motion capture.
        offsets_m: each dock relative to the body frame (x forward, y left).
        height_m: of the docks above the floor.
        tolerance_m: largest misalignment at touch-down.
    """

    body: str
    offsets_m: tuple[Vec2, ...]
    height_m: float
    tolerance_m: float


class PoseBook:
    """The newest trusted pose of each body; what a docking UAV knows of its UGV. Safe to share between threads.

    Every driver's ``feed_pose`` writes its own vehicle's pose here: the loop hands on only poses that it trusts.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, Pose] = {}

    def put(self, *poses: Pose) -> None:
        """Notes poses; an older one than is known is dropped."""
        self.put_all(poses)

    def put_all(self, poses: Iterable[Pose]) -> None:
        """As ``put``."""
        with self._lock:
            for pose in poses:
                known = self._newest.get(pose.body)
                if known is None or known.stamp_s <= pose.stamp_s:
                    self._newest[pose.body] = pose

    def get(self, body: str) -> Pose | None:
        """The newest pose of ``body``, however old; None when there was none."""
        with self._lock:
            return self._newest.get(body)
