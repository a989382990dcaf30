"""The feeder of poses before the flight: one who fails keeps nobody else from being fed."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

import pytest

from deploy.feeding import PoseFeeder
from drivers.errors import DriverError
from drivers.vehicle import Pose


class Fed:
    """A vehicle that fails on ``state`` or ``feed_pose`` as told."""

    def __init__(self, failing: dict[str, Exception]) -> None:
        self.failing, self.poses = failing, 0

    def state(self) -> None:
        if "state" in self.failing:
            raise self.failing["state"]

    def feed_pose(self, pose: Pose) -> None:
        if "feed_pose" in self.failing:
            raise self.failing["feed_pose"]
        self.poses += 1


class Poses:
    def __init__(self) -> None:
        self.failing: Exception | None = None

    def read(self) -> Sequence[Pose]:
        if self.failing is not None:
            raise self.failing
        return [Pose(f"b{i}", (0.0, 0.0, 0.0), 0.0, time.monotonic()) for i in range(3)]


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


@pytest.mark.parametrize("where", ["state", "feed_pose"])
@pytest.mark.parametrize("error", [DriverError("not connected"), KeyError("pad")])
def test_one_that_fails_keeps_nobody_from_being_fed(where: str, error: Exception) -> None:
    vehicles: dict[str, Any] = {f"v{i}": Fed({where: error} if i == 1 else {}) for i in range(3)}
    feeder = PoseFeeder(vehicles, {f"b{i}": f"v{i}" for i in range(3)}, Poses())  # type: ignore[arg-type]
    try:
        feeder.poses_connected()
        until(lambda: vehicles["v0"].poses > 3 and vehicles["v2"].poses > 3)
        assert {p.body for p in feeder.read()} == {"b0", "b1", "b2"}
        found = feeder.timing()
        if isinstance(error, DriverError):
            assert found.verdict == "not run", "nothing to tell, and not looked at for long enough"
        else:
            assert found.verdict == "fail"
            assert "v1 failed with KeyError" in found.text
    finally:
        feeder.stop()


def test_motion_capture_that_fails_is_told_and_read_again() -> None:
    vehicles: dict[str, Any] = {"v0": Fed({})}
    poses = Poses()
    poses.failing = ValueError("half a frame")
    feeder = PoseFeeder(vehicles, {"b0": "v0"}, poses)  # type: ignore[arg-type]
    try:
        feeder.poses_connected()
        until(lambda: feeder.timing().verdict == "fail")
        assert "motion capture failed with ValueError (half a frame)" in feeder.timing().text
        poses.failing = None
        until(lambda: vehicles["v0"].poses > 0)
    finally:
        feeder.stop()
