"""Poses by the vehicles' own satellite receivers, for missions outdoors."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from drivers.errors import DriverError
from drivers.mavlink_vehicle import MavlinkVehicle
from drivers.vehicle import Pose, Vec3

APART_M = 1e-6


class TelemetryPoses:
    """The vehicles' own estimates as a source of poses, for missions outdoors.

    Args:
        vehicles: MAVLink vehicles with a ``GeoFrame``; they are connected by whoever owns them.

    Raises:
        DriverError: when one of them is flown by motion capture.
    """

    def __init__(self, vehicles: Sequence[MavlinkVehicle]) -> None:
        inside = [v.id for v in vehicles if not v.outdoors]
        if inside:
            raise DriverError(f"{', '.join(inside)}: no place on the globe; such vehicles need motion capture")
        self._vehicles = tuple(vehicles)
        self._read = dict.fromkeys((v.body for v in vehicles), -math.inf)
        self._told: dict[str, Vec3] = {}
        self._connected = False

    def connect(self, deadline_s: float) -> None:
        """Nothing to connect: poses come over the vehicles' links."""
        self._connected = True

    def read(self) -> Sequence[Pose]:
        """The newest pose of each vehicle received since the last call.

        Raises:
            DriverError: when it is not connected.
        """
        if not self._connected:
            raise DriverError("poses by telemetry: not connected; call connect first")
        found = []
        for vehicle in self._vehicles:
            pose = vehicle.own_pose()
            if pose is not None and pose.stamp_s > self._read[pose.body]:
                self._read[pose.body] = pose.stamp_s
                found.append(self._told_apart(pose))
        return tuple(found)

    def _told_apart(self, pose: Pose) -> Pose:
        """``pose``, a micrometre beside the last one where they are equal.

        Autopilots send positions in 1e-7 degrees, about a centimetre: a vehicle at rest repeats itself to the last bit.
        Each message is a measurement of its own all the same, and not the sign of a frozen camera that it would be in
        motion capture.
        """
        x, y, z = pose.position_m
        if self._told.get(pose.body) == pose.position_m:
            pose = replace(pose, position_m=(x, y, z + APART_M))
        self._told[pose.body] = pose.position_m
        return pose

    def close(self) -> None:
        """Stops reading; again does nothing."""
        self._connected = False
