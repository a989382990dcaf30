"""What a Crazyflie's driver makes of silence, death, reboots and missing poses, and how it closes."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.vehicle import Arm, Hold, Land, StopMotors
from sim_backends.wire.world import Modifiers
from tests.drivers.crazyflie_lab import MakeLab, labs_in, ready, verdicts

pytestmark = pytest.mark.wire


@pytest.fixture
def make(tmp_path: Path) -> Iterator[MakeLab]:
    with labs_in(tmp_path) as maker:
        yield maker


def test_silence_is_a_lost_link_and_its_end_is_noticed(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    there = harness.fly()
    lab.world.modify(0, Modifiers(swap=0, silent=True))
    begun = lab.clock.now()
    harness.wait_for(lambda: not harness.state("uav0").link, 20.0)
    print(f"silence shows after {lab.clock.now() - begun:.2f} s")
    stamp = harness.state("uav0").stamp_s
    harness.wait(6.0)
    assert harness.state("uav0").stamp_s == stamp
    assert lab.world.body(0).airborne
    assert harness.distance("uav0", there) < 0.15, "it hears its poses and hovers on"
    lab.world.modify(0, Modifiers(swap=0))
    harness.wait_for(lambda: harness.state("uav0").link, 20.0)
    lab.uav.send(Land("uav0", 0.5))
    harness.wait_for(lambda: not harness.state("uav0").airborne, 30.0)


def test_a_killed_vehicle_is_a_lost_link_and_comes_back(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    lab.kill()
    begun = lab.clock.now()
    harness.wait_for(lambda: not harness.state("uav0").link, 20.0)
    print(f"death shows after {lab.clock.now() - begun:.2f} s")
    for command in (Arm("uav0"), Hold("uav0"), StopMotors("uav0")):
        lab.uav.send(command)
    harness.wait(1.0)
    lab.start()
    harness.wait_for(lambda: harness.state("uav0").link, 30.0)
    print(f"it is back {lab.clock.now() - begun:.2f} s after it was killed")


def test_a_reboot_disarms_and_settles_again(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    harness.arm("uav0")
    lab.kill()
    lab.start()
    harness.wait_for(lambda: not harness.state("uav0").armed, 30.0)
    harness.wait_for(lambda: harness.state("uav0").link and verdicts(lab)["estimator"] == "pass", 30.0)
    harness.fly()


def test_poses_that_stop_forbid_arming(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    lab.poses.hidden = {"cf0"}
    harness.wait(2.0)
    lab.uav.send(Arm("uav0"))
    harness.wait(1.0)
    assert not harness.state("uav0").armed
    assert "poses" in (harness.state("uav0").fault or "")
    lab.poses.hidden = set()
    harness.wait_for(lambda: verdicts(lab)["estimator"] == "pass", 30.0)
    harness.arm("uav0")
    assert harness.state("uav0").fault is None


@pytest.mark.parametrize("silent", [False, True])
def test_the_emergency_stop_is_quick_and_says_when_it_is_not_confirmed(make: MakeLab, silent: bool) -> None:
    lab = make()
    harness = ready(lab)
    harness.fly()
    lab.world.modify(0, Modifiers(swap=0, silent=silent))
    time.sleep(0.1)
    begun = time.monotonic()
    lab.uav.send(StopMotors("uav0"))
    while not lab.world.body(0).locked and time.monotonic() - begun < 3.0:
        time.sleep(0.001)
    stopped_s = time.monotonic() - begun
    assert stopped_s < 1.0
    assert not harness.state("uav0").armed
    if silent:
        harness.wait_for(lambda: "emergency stop" in (harness.state("uav0").fault or ""), 20.0)
        return
    harness.wait_for(lambda: harness.state("uav0").locked, 20.0)
    print(f"motors off after {1e3 * stopped_s:.0f} ms, confirmed after {1e3 * (time.monotonic() - begun):.0f} ms")


def test_closing_in_the_air_lets_it_land_by_itself(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    harness.fly()
    lab.uav.close()
    end_s = time.monotonic() + 30.0
    while lab.world.body(0).airborne and time.monotonic() < end_s:
        time.sleep(0.05)
    body = lab.world.body(0)
    assert not body.airborne
    assert not body.tumbled
    assert not body.locked


def test_closing_on_the_ground_disarms_and_leaves_no_thread(make: MakeLab) -> None:
    lab = make("--variant", "brushless")
    before = set(threading.enumerate())
    harness = ready(lab)
    harness.arm("uav0")
    lab.uav.close()
    end_s = time.monotonic() + 20.0
    while lab.world.body(0).armed and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not lab.world.body(0).armed
    while set(threading.enumerate()) - before and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not set(threading.enumerate()) - before
