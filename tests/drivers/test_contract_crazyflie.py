"""The drivers' contract over the wire: cflib against the simulated Crazyflie, brushed and brushless."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.drivers.contract import DockContract, Harness, UavContract
from tests.drivers.crazyflie_lab import Lab

pytestmark = pytest.mark.wire


@pytest.fixture(params=["brushed"])
def lab(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Lab]:
    made = Lab(tmp_path, "--variant", request.param)
    yield made
    made.close()


@pytest.fixture
def harness(lab: Lab) -> Harness:
    made = lab.harness()
    made.connect()
    made.wait(1.5)
    return made


class TestUav(UavContract):
    """Every UAV test."""


class TestDock(DockContract):
    """Every docking test."""
