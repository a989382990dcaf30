"""The drivers' contract over MAVLink: copters and rovers of both autopilots, outdoors and by motion capture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drivers.contract import DockContract, Harness, UavContract, UgvContract
from tests.drivers.mavlink_team import team

pytestmark = pytest.mark.wire
SETUPS = {
    "px4-globe": ("px4", True),
    "ardupilot-capture": ("ardupilot", False),
    "px4-capture": ("px4", False),
    "ardupilot-globe": ("ardupilot", True),
}
# the other two differ from these in combinations that the pure tests cover: once in a while is enough
SLOW = ("px4-capture", "ardupilot-globe")


@pytest.fixture(params=[pytest.param(s, marks=pytest.mark.slow if s in SLOW else ()) for s in SETUPS])
def setup(request: pytest.FixtureRequest) -> tuple[str, bool]:
    return SETUPS[request.param]


class TestUav(UavContract):
    """Every UAV test."""

    @pytest.fixture
    def harness(self, setup: tuple[str, bool], tmp_path: Path) -> Iterator[Harness]:
        with team(tmp_path, setup[0], outdoors=setup[1], vehicles=("uav0",)) as made:
            yield made.harness


class TestUgv(UgvContract):
    """Every UGV test."""

    @pytest.fixture
    def harness(self, setup: tuple[str, bool], tmp_path: Path) -> Iterator[Harness]:
        with team(tmp_path, setup[0], outdoors=setup[1], vehicles=("ugv0",)) as made:
            yield made.harness


class TestDock(DockContract):
    """Every docking test."""

    @pytest.fixture
    def harness(self, setup: tuple[str, bool], tmp_path: Path) -> Iterator[Harness]:
        with team(tmp_path, setup[0], outdoors=setup[1]) as made:
            yield made.harness
