"""Old firmware and firmware without some of its variables: degraded, never broken."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.vehicle import GoTo, Land, StopMotors
from tests.drivers.crazyflie_lab import MakeLab, labs_in, ready, verdicts

pytestmark = pytest.mark.wire


@pytest.fixture
def make(tmp_path: Path) -> Iterator[MakeLab]:
    with labs_in(tmp_path) as maker:
        yield maker


@pytest.mark.parametrize("protocol", ["7", "11"])
def test_old_firmware(make: MakeLab, protocol: str) -> None:
    lab = make("--protocol", protocol, "--variant", "brushless", "--clock-rate", "0.97")
    harness = ready(lab)
    assert verdicts(lab)["firmware"] == "warn"
    x, y, z = harness.fly()
    lab.uav.send(GoTo("uav0", (x + 1.2, y, z), 0.6))
    harness.wait_for(lambda: harness.distance("uav0", (x + 1.2, y, z)) < 0.1, 30.0)
    lab.uav.send(StopMotors("uav0"))
    harness.wait_for(lambda: harness.state("uav0").locked, 20.0)


def test_firmware_without_battery_radio_and_pose_telemetry(make: MakeLab) -> None:
    lab = make("--without", "pm,radio,locSrvZ,kalman,stabilizer")
    harness = ready(lab)
    found = verdicts(lab)
    assert found["log variables"] == "warn"
    assert found["battery telemetry"] == found["charger telemetry"] == found["estimator"] == "warn"
    assert found["radio"] == found["pose path"] == "not run"
    assert harness.state("uav0").battery is None
    harness.fly()


def test_firmware_without_supervisor_bits(make: MakeLab) -> None:
    lab = make("--without", "supervisor")
    harness = ready(lab)
    harness.fly()
    lab.uav.send(Land("uav0", 0.7))
    harness.wait_for(lambda: not harness.state("uav0").airborne, 30.0)
