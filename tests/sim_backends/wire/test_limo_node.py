"""The simulated Limo as any ROS 2 machine sees it: plain rclpy nodes drive it."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import Imu
from std_msgs.msg import Header

from drivers.limo_status import LimoStatus, decode
from drivers.limo_typesupport import status_type
from sim_backends.wire.limo_base import Mode
from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav
from tests.drivers.limo_wire import DOMAIN, Process, lab, namespace, start, until

pytestmark = pytest.mark.wire


class Station:
    """A plain rclpy node with an executor, as somebody's own program would be."""

    def __init__(self, names: str) -> None:
        self.context = Context()
        self.context.init(args=[], domain_id=DOMAIN)
        self.node = rclpy.create_node("station", context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.odom: list[Odometry] = []
        self.imu: list[Imu] = []
        self.status: list[LimoStatus] = []
        self.node.create_subscription(Odometry, f"{names}/odom", self.odom.append, 10)
        self.node.create_subscription(Imu, f"{names}/imu", self.imu.append, 10)
        kind = status_type(Header)
        self.node.create_subscription(
            kind, f"{names}/limo_status", lambda b: self.status.append(decode(b)), 10, raw=True
        )
        self.publisher = self.node.create_publisher(Twist, f"{names}/cmd_vel", 10)
        self.spin_until(lambda: bool(self.odom and self.status) and self.publisher.get_subscription_count() > 0, 15.0)

    def spin(self, for_s: float) -> None:
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def spin_until(self, condition: Callable[[], bool], timeout_s: float = 5.0) -> None:
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, "it did not happen in time"
            self.executor.spin_once(timeout_sec=0.02)

    def say(self, x: float, y: float = 0.0, turn: float = 0.0) -> None:
        twist = Twist()
        twist.linear.x, twist.linear.y, twist.angular.z = float(x), float(y), float(turn)
        self.publisher.publish(twist)

    def keep_saying(self, for_s: float, x: float, y: float = 0.0, turn: float = 0.0) -> None:
        for _ in range(round(for_s / 0.05)):
            self.say(x, y, turn)
            self.spin(0.05)

    def close(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()


class Bench:
    """A world with one Limo that a station drives."""

    def __init__(self, folder: Path, mode: Mode) -> None:
        self.world = World.create(folder, lab())
        names = namespace(f"node_{mode}")
        self.node: Process = start(
            "--world", str(folder), "--vehicle", "ugv0", "--namespace", names, "--mode", mode
        )  # fmt: skip
        self.station = Station(names)

    @property
    def at(self) -> tuple[float, float, float]:
        body = self.world.body(0)
        return (float(body.position_m[0]), float(body.position_m[1]), body.yaw_rad)

    @property
    def speed(self) -> float:
        return self.world.body(0).speed_mps

    def close(self) -> None:
        self.station.close()
        assert self.node.end() < 1.0


@pytest.fixture(scope="module", params=["differential", "ackermann", "mecanum"])
def any_bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp(request.param), request.param)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp("limo"), "differential")
    yield bench
    bench.world.modify(0, Modifiers(swap=0))
    bench.close()


@pytest.fixture
def ackermann(tmp_path: Path) -> Iterator[Bench]:
    bench = Bench(tmp_path, "ackermann")
    yield bench
    bench.close()


def test_drives_by_cmd_vel_in_every_mode(any_bench: Bench, request: pytest.FixtureRequest) -> None:
    mode, station = request.node.callspec.params["any_bench"], any_bench.station
    assert any_bench.world.started_s is None
    assert station.status[-1].motion_mode == ["differential", "ackermann", "mecanum"].index(mode)
    station.keep_saying(1.5, 0.4, 0.4, 0.4)
    x, y, yaw = any_bench.at
    assert 0.3 < x < 0.75
    assert yaw == pytest.approx(0.4 * 1.4, abs=0.35)
    assert (y > 0.45) == (mode == "mecanum"), "only this one drives sideways"
    assert any_bench.world.started_s is not None
    at = station.odom[-1].pose.pose.position
    assert math.dist((at.x, at.y), (x, y)) < 0.15
    station.spin_until(lambda: any_bench.speed == 0.0)


def test_speaks_at_the_real_rates_with_the_real_wrong_stamp(bench: Bench) -> None:
    station = bench.station
    for messages in (station.odom, station.imu, station.status):
        messages.clear()  # type: ignore[attr-defined]
    station.spin(2.0)
    assert 70 <= len(station.odom) <= 115
    assert 70 <= len(station.imu) <= 115
    assert 15 <= len(station.status) <= 32
    assert station.odom[-1].header.frame_id == "odom"
    assert abs(station.odom[-1].header.stamp.sec - time.time()) < 2
    assert station.imu[-1].linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    status = station.status[-1]
    assert abs(status.stamp_ns - time.time()) < 2, "seconds where nanoseconds belong"
    assert (status.vehicle_state, status.control_mode, status.error_code) == (0, 1, 0)
    assert 12.0 < status.battery_v <= 12.6


def test_the_last_command_stays_in_force_for_half_a_second(bench: Bench) -> None:
    bench.station.keep_saying(1.0, 0.4)
    said_s = time.monotonic()
    bench.station.spin(0.35)
    assert bench.speed > 0.35
    bench.station.spin_until(lambda: bench.speed == 0.0)
    assert 0.7 < time.monotonic() - said_s < 1.5, "half a second and the braking"


def test_stalled_it_does_not_move_and_a_dead_motor_is_reported(bench: Bench) -> None:
    bench.world.modify(0, Modifiers(swap=0, slow=0.0))
    before = bench.at
    bench.station.keep_saying(0.5, 0.4)
    assert bench.at == before
    bench.world.modify(0, Modifiers(swap=0, motor_fail=True))
    bench.station.spin_until(lambda: bool(bench.station.status[-1].error_code))
    bench.station.keep_saying(0.5, 0.4)
    assert bench.at == before
    bench.world.modify(0, Modifiers(swap=0))
    bench.station.spin_until(lambda: not bench.station.status[-1].error_code)


def test_silent_it_hears_and_lost_it_does_not(bench: Bench) -> None:
    station = bench.station
    bench.world.modify(0, Modifiers(swap=0, silent=True))
    station.spin(0.2)
    station.odom.clear()
    x = bench.at[0]
    station.keep_saying(0.8, 0.4)
    assert not station.odom
    assert math.dist(bench.at[:2], (x, bench.at[1])) > 0.1
    bench.world.modify(0, Modifiers(swap=0, lost=True))
    station.keep_saying(1.2, 0.4)
    assert bench.speed == 0.0, "its firmware has stopped it"
    bench.world.modify(0, Modifiers(swap=0))
    station.spin_until(lambda: bool(station.odom))


def test_a_lossy_link_loses_messages_both_ways(bench: Bench) -> None:
    station = bench.station
    bench.world.modify(0, Modifiers(swap=0, loss=0.5))
    station.spin(0.2)
    station.odom.clear()
    station.spin(2.0)
    assert 25 <= len(station.odom) <= 75
    bench.world.modify(0, Modifiers(swap=0, loss=1.0))
    before = bench.at
    station.keep_saying(0.3, 0.4)
    assert bench.at == before
    bench.world.modify(0, Modifiers(swap=0))


def test_driving_costs_energy_and_voltage(bench: Bench) -> None:
    bench.world.modify(0, Modifiers(swap=0, drain=500.0))
    before = bench.world.body(0).energy_j
    bench.station.keep_saying(1.0, 0.5)
    assert bench.world.body(0).energy_j < before
    bench.world.modify(0, Modifiers(swap=0, drain=1e9))
    bench.station.keep_saying(0.5, 0.5)
    bench.world.modify(0, Modifiers(swap=0))
    assert bench.world.body(0).energy_j == 0.0
    bench.station.spin_until(lambda: bench.station.status[-1].error_code & 0x1 > 0)
    assert bench.station.status[-1].battery_v < 8.5
    bench.station.spin_until(lambda: bench.speed == 0.0)
    bench.station.keep_saying(0.3, 0.5)
    assert bench.speed == 0.0


def test_a_twist_of_zeros_does_not_stop_steered_wheels(ackermann: Bench) -> None:
    ackermann.station.keep_saying(1.0, 0.4)
    ackermann.station.keep_saying(0.3, 0.0)
    assert ackermann.speed > 0.35, "0 / 0 is no steering angle"
    ackermann.station.say(0.0004)
    ackermann.station.spin(0.5)
    assert ackermann.speed < 0.1


def test_stands_alone_and_ends_with_its_parent(tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    node = start("--vehicle", "mine", "--namespace", namespace("alone"), parent=parent.pid)
    assert node.first_line.startswith("ready limo mine differential")
    parent.kill()
    parent.wait()
    assert until(lambda: node.popen.poll() is not None, 5.0) < 2.0


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--world", "nowhere"], "holds no simulated world"),
        (["--vehicle", "nobody", "--world", "@"], "'nobody'"),
        (["--vehicle", "uav0", "--world", "@"], "needs a UGV"),
        (["--namespace", "not a name"], "is no ROS namespace"),
    ],
)
def test_mistakes_are_one_line(tmp_path: Path, arguments: list[str], words: str) -> None:
    World.create(tmp_path, replace(lab(), uavs=(SimUav("uav0", "cf0", (5.0, 5.0)),)))
    arguments = [str(tmp_path) if a == "@" else a for a in arguments]
    command = [sys.executable, "-m", "sim_backends.wire.limo_node", *arguments, "--domain", str(DOMAIN)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=False, cwd=Path.cwd())
    assert done.returncode == 1, json.dumps([done.stdout, done.stderr])
    assert words in done.stderr
    assert "Traceback" not in done.stderr
