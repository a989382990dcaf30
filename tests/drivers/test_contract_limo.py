"""The drivers' contract on the Limo driver, with a simulated Limo in its own process at the other end of ROS 2."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import pytest

from drivers.clock import RealClock
from drivers.limits import PoseBook, UgvLimits
from drivers.limo import Limo, LimoOptions
from drivers.limo_ros import RosRobot
from sim_backends.wire.world import World
from tests.drivers.contract import Harness, UgvContract
from tests.drivers.limo_wire import DOMAIN, TruePoses, lab, namespace, start

pytestmark = pytest.mark.wire


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    world = World.create(tmp_path_factory.mktemp("limo"), replace(lab(), seed=4))
    node = start("--world", str(world.folder), "--vehicle", "ugv0", "--namespace", namespace("contract"))
    # somebody else in the domain: it stays joined, and every test is spared a second of discovery
    stays = RosRobot("stays", namespace("stays"), DOMAIN, False, RealClock(), lambda: None)
    yield world
    stays.close()
    node.end()
    assert node.popen.returncode == 0, "it ends by itself when it is asked to"


@pytest.fixture
def harness(world: World) -> Iterator[Harness]:
    clock = RealClock()
    limo = Limo(
        "ugv0",
        namespace("contract"),
        body="limo0",
        limits=UgvLimits(max_speed_mps=0.6, accel_mps2=1.0),
        book=PoseBook(),
        clock=clock,
        options=LimoOptions(domain=DOMAIN),
    )
    made = Harness(
        {"ugv0": limo}, TruePoses(world, clock), clock, {"ugv0": "limo0"},
        leg_m=0.6, speed_mps=0.5, tolerance_m=0.08, pad_height_m=0.3, timeout_s=20.0,
    )  # fmt: skip
    made.connect()
    yield made
    limo.close()


class TestLimo(UgvContract):
    """Every UGV test; the Limo stays where the last one left it."""
