"""Docking over the wire: misses, a UGV that moves, a charger that does not answer, firmware without charger words."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.vehicle import Dock, GoTo
from sim_backends.wire.world import Modifiers
from tests.drivers.contract import Harness
from tests.drivers.crazyflie_lab import PAD_M, Lab

pytestmark = pytest.mark.wire

UP_M = 0.9
DOCK = Dock("uav0", "ugv0", 0, 0.5, UP_M)
SLOWLY = replace(DOCK, speed_mps=0.2)
"""For what has to happen on its way down, even where this process has to wait."""


@pytest.fixture
def lab(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Lab]:
    made = Lab(tmp_path, *getattr(request, "param", ()))
    yield made
    made.close()


@pytest.fixture
def harness(lab: Lab) -> Harness:
    """Hovering 3 cm beside the middle of the pad."""
    made = lab.harness()
    made.connect()
    made.wait_for(lambda: any(c.name == "estimator" and c.verdict in ("pass", "warn") for c in lab.uav.self_checks()))
    made.fly()
    over = (0.03, 1.5, 0.7)
    lab.uav.send(GoTo("uav0", over, 0.8))
    made.wait_for(lambda: made.distance("uav0", over) < 0.05)
    made.wait(0.5)
    return made


def move_ugv(lab: Lab, dx: float) -> None:
    body = lab.world.body(1)
    x, y, z = body.position_m
    lab.world.put(1, replace(body, position_m=(x + dx, y, z)))


def missed(lab: Lab, harness: Harness, timeout_s: float = 40.0) -> None:
    harness.wait_for(lambda: abs(harness.pose("uav0").position_m[2] - UP_M) < 0.05, timeout_s)
    harness.wait(1.0)
    state = harness.state("uav0")
    assert state.airborne
    assert not state.charging
    assert (state.fault or "").startswith("dock missed")


def docked(lab: Lab, harness: Harness) -> None:
    harness.wait_for(lambda: harness.state("uav0").charging, 40.0)
    assert not harness.state("uav0").airborne
    assert harness.state("uav0").fault is None
    assert abs(harness.pose("uav0").position_m[2] - PAD_M) < 0.02


def test_a_touch_down_beside_the_contact_lifts_off_and_the_next_attempt_docks(lab: Lab, harness: Harness) -> None:
    lab.world.modify(0, Modifiers(swap=0, dock_miss=1))
    lab.uav.send(DOCK)
    missed(lab, harness)
    lab.uav.send(DOCK)
    docked(lab, harness)


@pytest.mark.parametrize("lab", [("--variant", "brushless")], indirect=True)
def test_a_charger_that_does_not_answer_lifts_off(lab: Lab, harness: Harness) -> None:
    lab.world.modify(0, Modifiers(swap=0, charge_factor=0.0))
    lab.uav.send(DOCK)
    missed(lab, harness)


def test_a_ugv_that_drives_off_is_not_followed(lab: Lab, harness: Harness) -> None:
    lab.uav.send(SLOWLY)
    harness.wait_for(lambda: harness.pose("uav0").position_m[2] < 0.6)
    for _ in range(10):
        move_ugv(lab, 0.02)
        harness.wait(0.1)
    missed(lab, harness)


def test_a_ugv_that_is_nudged_is(lab: Lab, harness: Harness) -> None:
    lab.uav.send(SLOWLY)
    harness.wait_for(lambda: harness.pose("uav0").position_m[2] < 0.65)
    move_ugv(lab, 0.02)
    docked(lab, harness)


def test_losing_sight_of_the_ugv_aborts(lab: Lab, harness: Harness) -> None:
    lab.uav.send(SLOWLY)
    harness.wait_for(lambda: harness.pose("uav0").position_m[2] < 0.6)
    lab.poses.hidden = {"limo0"}
    missed(lab, harness)


@pytest.mark.parametrize("lab", [("--without", "pm")], indirect=True)
def test_without_charger_words_the_pose_counts(lab: Lab, harness: Harness) -> None:
    lab.uav.send(DOCK)
    docked(lab, harness)
    assert harness.state("uav0").battery is None


def test_a_third_of_the_packets_may_get_lost(lab: Lab, harness: Harness) -> None:
    lab.world.modify(0, Modifiers(swap=0, loss=0.3))
    lab.uav.send(DOCK)
    docked(lab, harness)
