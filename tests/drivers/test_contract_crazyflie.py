"""The drivers' contract over the wire: cflib against the simulated Crazyflie, which arms itself or has to be armed.

A vehicle that a test has left unlocked on the floor flies the next one, too: connecting and settling takes seconds.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.vehicle import Disarm, Land
from tests.drivers.contract import DockContract, Harness, UavContract
from tests.drivers.crazyflie_lab import Lab

pytestmark = pytest.mark.wire


class Labs:
    """At most one lab a variant."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.made, self.count = folder, dict[str, Lab](), 0

    def get(self, variant: str) -> Lab:
        if variant not in self.made:
            self.count += 1
            self.made[variant] = Lab(self.folder / str(self.count), "--variant", variant)
        return self.made[variant]

    def give_back(self, variant: str, harness: Harness) -> None:
        lab, state = self.made[variant], harness.state("uav0")
        if state.link and not state.locked and not state.charging:
            if state.airborne:
                harness.vehicles["uav0"].send(Land("uav0", 0.7))
            harness.wait_for(lambda: not harness.state("uav0").airborne, 40.0)
            harness.vehicles["uav0"].send(Disarm("uav0"))
            harness.wait_for(lambda: not harness.state("uav0").armed, 20.0)
            if harness.pose("uav0").position_m[2] < 0.1:  # not on the UGV
                return
        if state.link:
            lab.close()
            del self.made[variant]

    def close(self) -> None:
        for lab in self.made.values():
            lab.close()


@pytest.fixture(scope="module")
def labs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Labs]:
    made = Labs(tmp_path_factory.mktemp("labs"))
    yield made
    made.close()


@pytest.fixture
def variant() -> str:
    return "brushed"


@pytest.fixture
def harness(labs: Labs, variant: str) -> Iterator[Harness]:
    lab = labs.get(variant)
    made = lab.harness()
    made.connect()
    made.wait_for(lambda: any(c.name == "estimator" and c.verdict == "pass" for c in lab.uav.self_checks()), 30.0)
    yield made
    lab.poses.connect(0.0)
    labs.give_back(variant, made)


class TestUav(UavContract):
    """Every UAV test."""


class TestDock(DockContract):
    """Every docking test."""


class TestBrushless:
    """What differs for one that has to be armed."""

    @pytest.fixture
    def variant(self) -> str:
        return "brushless"

    test_arming = UavContract.test_arming_and_disarming_show_in_the_state
    test_again = UavContract.test_flies_again_after_a_landing
    test_stop = UavContract.test_emergency_stop_in_the_air_stops_the_motors

    @pytest.fixture
    def vehicle_id(self) -> str:
        return "uav0"

    def test_docks_and_takes_off_again(self, harness: Harness) -> None:
        DockContract().test_docks_charges_and_takes_off_again(harness)
