"""The Crazyflie driver when things go wrong: nobody there, losses, silence, death, old firmware, closing."""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.crazyflie import Crazyflie
from drivers.errors import DriverError
from drivers.limits import PoseBook
from drivers.vehicle import Arm, GoTo, Hold, Land, Pose, StopMotors, TakeOff
from sim_backends.wire.world import Modifiers
from tests.drivers.contract import Harness
from tests.drivers.crazyflie_lab import LIMITS, OPTIONS, Lab, LoopClock

pytestmark = pytest.mark.wire

MakeLab = Callable[..., Lab]


@pytest.fixture
def make(tmp_path: Path) -> Iterator[MakeLab]:
    labs: list[Lab] = []

    def one(*arguments: str, **kwargs: object) -> Lab:
        labs.append(Lab(tmp_path / str(len(labs)), *arguments, **kwargs))  # type: ignore[arg-type]
        return labs[-1]

    yield one
    for lab in labs:
        lab.close()


def ready(lab: Lab) -> Harness:
    harness = lab.harness()
    harness.connect()
    harness.wait_for(lambda: verdicts(lab)["estimator"] in ("pass", "warn"), 15.0)
    return harness


def verdicts(lab: Lab) -> dict[str, str]:
    return {c.name: c.verdict for c in lab.uav.self_checks()}


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def alone(uri: str, folder: Path) -> tuple[Crazyflie, LoopClock]:
    clock = LoopClock()
    options = replace(OPTIONS, cache=folder)
    made = Crazyflie("uav0", uri, body="cf0", limits=LIMITS, pads={}, book=PoseBook(), clock=clock, options=options)
    return made, clock


def test_a_wrong_uri_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=r"uav0.*http"):
        alone("http://somewhere", tmp_path)


def test_nobody_there_is_an_error_in_time(tmp_path: Path) -> None:
    vehicle, clock = alone(f"udp://127.0.0.1:{free_port()}", tmp_path)
    with pytest.raises(DriverError, match="uav0: cannot connect"):
        vehicle.connect(clock.now() + 2.0)
    assert 1.5 < clock.now() < 3.0
    vehicle.close()


def test_somebody_who_says_nothing_is_an_error_in_time(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as mute:
        mute.bind(("127.0.0.1", 0))
        vehicle, clock = alone(f"udp://127.0.0.1:{mute.getsockname()[1]}", tmp_path)
        with pytest.raises(DriverError, match="nothing answers"):
            vehicle.connect(clock.now() + 2.5)
        assert clock.now() < 3.5
        vehicle.close()


def test_no_radio_is_an_error_in_time(tmp_path: Path) -> None:
    vehicle, clock = alone("radio://0/80/2M/E7E7E7E7E7", tmp_path)
    with pytest.raises(DriverError, match="uav0: cannot connect"):
        vehicle.connect(clock.now() + 2.0)
    assert clock.now() < 4.0


def test_it_waits_for_a_vehicle_that_is_switched_on_later(make: MakeLab) -> None:
    lab = make()
    lab.kill()
    threading.Timer(1.0, lab.start).start()
    lab.uav.connect(lab.clock.now() + 10.0)
    assert lab.uav.state().link


def test_connecting_flying_and_stopping_with_a_third_of_the_packets_lost(make: MakeLab) -> None:
    lab = make()
    lab.world.modify(0, Modifiers(swap=0, loss=0.3))
    begun = lab.clock.now()
    harness = lab.harness(timeout_s=40.0)
    harness.connect()
    print(f"connected through 30 % loss in {lab.clock.now() - begun:.1f} s")
    harness.wait_for(lambda: verdicts(lab)["estimator"] == "pass", 15.0)
    x, y, z = harness.fly()
    lab.uav.send(GoTo("uav0", (x + 1.5, y, z), 0.6))
    harness.wait_for(lambda: harness.distance("uav0", (x + 1.5, y, z)) < 0.1, 15.0)
    lab.uav.send(Land("uav0", 0.5))
    harness.wait_for(lambda: not harness.state("uav0").airborne, 15.0)
    assert not harness.state("uav0").tumbled
    harness.fly()
    lab.uav.send(StopMotors("uav0"))
    harness.wait_for(lambda: harness.state("uav0").locked, 3.0)
    assert lab.world.body(0).locked


def test_silence_is_a_lost_link_and_its_end_is_noticed(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    there = harness.fly()
    lab.world.modify(0, Modifiers(swap=0, silent=True))
    begun = lab.clock.now()
    harness.wait_for(lambda: not harness.state("uav0").link, 5.0)
    print(f"silence shows after {lab.clock.now() - begun:.2f} s")
    stamp = harness.state("uav0").stamp_s
    harness.wait(6.0)
    assert harness.state("uav0").stamp_s == stamp
    assert lab.world.body(0).airborne
    assert harness.distance("uav0", there) < 0.15, "it hears its poses and hovers on"
    lab.world.modify(0, Modifiers(swap=0))
    harness.wait_for(lambda: harness.state("uav0").link, 2.0)
    lab.uav.send(Land("uav0", 0.5))
    harness.wait_for(lambda: not harness.state("uav0").airborne, 10.0)


def test_a_killed_vehicle_is_a_lost_link_and_comes_back(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    lab.kill()
    begun = lab.clock.now()
    harness.wait_for(lambda: not harness.state("uav0").link, 5.0)
    print(f"death shows after {lab.clock.now() - begun:.2f} s")
    for command in (Arm("uav0"), Hold("uav0"), StopMotors("uav0")):
        lab.uav.send(command)
    harness.wait(1.0)
    lab.start()
    harness.wait_for(lambda: harness.state("uav0").link, 10.0)
    print(f"it is back {lab.clock.now() - begun:.2f} s after it was killed")


def test_a_reboot_disarms_and_settles_again(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    harness.arm("uav0")
    lab.kill()
    lab.start()
    harness.wait_for(lambda: not harness.state("uav0").armed, 15.0)
    harness.wait_for(lambda: harness.state("uav0").link and verdicts(lab)["estimator"] == "pass", 15.0)
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
    harness.wait_for(lambda: verdicts(lab)["estimator"] == "pass", 15.0)
    harness.arm("uav0")
    assert harness.state("uav0").fault is None


@pytest.mark.parametrize("protocol", ["7", "11"])
def test_old_firmware(make: MakeLab, protocol: str) -> None:
    lab = make("--protocol", protocol, "--variant", "brushless", "--clock-rate", "0.97")
    harness = ready(lab)
    assert verdicts(lab)["firmware"] == "warn"
    x, y, z = harness.fly()
    lab.uav.send(GoTo("uav0", (x + 1.2, y, z), 0.6))
    harness.wait_for(lambda: harness.distance("uav0", (x + 1.2, y, z)) < 0.1, 15.0)
    lab.uav.send(StopMotors("uav0"))
    harness.wait_for(lambda: harness.state("uav0").locked, 3.0)


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
    harness.wait_for(lambda: not harness.state("uav0").airborne, 10.0)


def test_closing_in_the_air_lets_it_land_by_itself(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    harness.fly()
    lab.uav.close()
    end_s = time.monotonic() + 10.0
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
    time.sleep(0.3)
    assert not lab.world.body(0).armed
    end_s = time.monotonic() + 5.0
    while set(threading.enumerate()) - before and time.monotonic() < end_s:
        time.sleep(0.05)
    assert not set(threading.enumerate()) - before


def test_a_process_that_forgets_to_close_ends(make: MakeLab) -> None:
    lab = make()
    code = (
        "import sys; from pathlib import Path; from tests.drivers.test_crazyflie_wire import alone\n"
        f"v, c = alone('udp://127.0.0.1:{lab.port}', Path(sys.argv[1])); v.connect(c.now() + 10)\n"
        "print('connected', v.state().link)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(lab.folder / "c")], capture_output=True, text=True, timeout=20, check=False
    )
    assert done.stdout.strip() == "connected True", done.stderr
    assert done.returncode == 0
    assert done.stderr == ""


def test_it_reacts_and_passes_poses_on_quickly(make: MakeLab) -> None:
    lab = make()
    harness = ready(lab)
    link = lab.uav._link
    assert link is not None
    sent: dict[float, float] = {}
    send_pose = link.send_pose

    def note(pose: Pose, attitude: bool) -> None:
        send_pose(pose, attitude)
        sent[pose.stamp_s] = time.perf_counter()

    link.send_pose = note  # type: ignore[method-assign]
    delays = []
    for _ in range(200):
        pose = Pose("cf0", (0.0, 0.0, 0.0), 0.0, lab.clock.now())
        begun = time.perf_counter()
        lab.uav.feed_pose(pose)
        called = time.perf_counter() - begun
        time.sleep(0.02)
        if pose.stamp_s in sent:
            delays.append((sent[pose.stamp_s] - begun, called))
    link.send_pose = send_pose  # type: ignore[method-assign]
    delays.sort()
    print(f"pose to packet: median {1e3 * delays[len(delays) // 2][0]:.2f} ms, worst {1e3 * delays[-1][0]:.2f} ms")
    assert len(delays) > 190
    assert delays[len(delays) // 2][0] < 0.005
    assert sorted(c for _, c in delays)[len(delays) // 2] < 0.001

    x, y, z = harness.fly()
    harness.wait(1.0)
    order_s: list[float] = []
    send = link.send
    link.send = lambda order: (order_s.append(time.perf_counter()), send(order))[1]  # type: ignore[method-assign]
    begun = time.perf_counter()
    lab.uav.send(GoTo("uav0", (x + 1.5, y, z), 0.6))
    while lab.world.body(0).velocity_mps[0] < 0.05:
        harness.wait(0.005)
        assert time.perf_counter() - begun < 3.0
    moved = time.perf_counter() - begun
    print(f"GoTo to order {1e3 * (order_s[0] - begun):.1f} ms, to 5 cm/s {1e3 * moved:.0f} ms")
    assert order_s[0] - begun < 0.03
    lab.uav.send(TakeOff("uav0", z, 0.5))
