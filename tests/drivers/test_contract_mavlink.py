"""The drivers' contract over MAVLink: both autopilots, outdoors and by motion capture.

Every combination of these two has been flown through all of it; here each class has those in which it differs most.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drivers.contract import DockContract, Harness, UavContract, UgvContract
from tests.drivers.mavlink_team import team

pytestmark = pytest.mark.wire


class TestUav(UavContract):
    """Every UAV test."""

    @pytest.fixture(params=["px4-outdoors", "ardupilot-indoors"])
    def harness(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Harness]:
        autopilot, where = request.param.split("-")
        with team(tmp_path, autopilot, outdoors=where == "outdoors", vehicles=("uav0",)) as made:
            yield made.harness


class TestUgv(UgvContract):
    """Every UGV test; PX4's rover drives in ``test_mavlink_wire``."""

    @pytest.fixture
    def harness(self, tmp_path: Path) -> Iterator[Harness]:
        with team(tmp_path, "ardupilot", outdoors=True, vehicles=("ugv0",)) as made:
            yield made.harness


class TestDock(DockContract):
    """Every docking test."""

    @pytest.fixture(params=["px4-indoors", "ardupilot-outdoors"])
    def harness(self, request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Harness]:
        autopilot, where = request.param.split("-")
        with team(tmp_path, autopilot, outdoors=where == "outdoors") as made:
            yield made.harness
