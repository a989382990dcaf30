"""Poses by telemetry: each message is a measurement of its own."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import pytest

from drivers.errors import DriverError
from drivers.mavlink import TelemetryPoses
from drivers.vehicle import Pose


@dataclass
class Outdoors:
    """A vehicle that tells its place."""

    pose: Pose | None = None
    id: str = "rover"
    body: str = "rover"
    outdoors: bool = True

    def own_pose(self) -> Pose | None:
        return self.pose


def test_equal_positions_at_rest_are_told_apart_by_a_micrometre() -> None:
    rover = Outdoors()
    poses = TelemetryPoses([rover])  # type: ignore[list-item]
    poses.connect(1.0)
    read = []
    for k in range(6):
        rover.pose = Pose("rover", (1.0, 2.0, 0.0), 0.3, float(k + 1))
        read += poses.read()
    assert len(read) == 6
    assert all(a.position_m != b.position_m for a, b in pairwise(read))
    assert all(p.position_m == pytest.approx((1.0, 2.0, 0.0), abs=2e-6) for p in read)


def test_no_new_message_is_no_new_pose() -> None:
    rover = Outdoors(Pose("rover", (1.0, 2.0, 0.0), 0.3, 5.0))
    poses = TelemetryPoses([rover])  # type: ignore[list-item]
    with pytest.raises(DriverError, match="not connected"):
        poses.read()
    poses.connect(1.0)
    assert len(poses.read()) == 1
    assert poses.read() == ()


def test_who_is_flown_by_motion_capture_has_no_place_on_the_globe() -> None:
    with pytest.raises(DriverError, match="rover: no place on the globe"):
        TelemetryPoses([Outdoors(outdoors=False)])  # type: ignore[list-item]
