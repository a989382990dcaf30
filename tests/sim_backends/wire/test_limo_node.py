"""The simulated Limo as any ROS 2 machine sees it: plain rclpy nodes drive it.

A busy machine may keep the station, the node or ROS waiting for a second. So the station speaks until something has
happened, times are told by the stamps of odometry and not by when it arrived, and what zeros do is tried where no pause
can be taken for it.
"""

from __future__ import annotations

import json
import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
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

PATIENCE_S = 20.0


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
        self.said_s = 0.0
        # deep enough for what arrives while this process has to wait
        self.node.create_subscription(Odometry, f"{names}/odom", self.odom.append, 500)
        self.node.create_subscription(Imu, f"{names}/imu", self.imu.append, 500)
        kind = status_type(Header)
        self.node.create_subscription(
            kind, f"{names}/limo_status", lambda b: self.status.append(decode(b)), 500, raw=True
        )
        self.publisher = self.node.create_publisher(Twist, f"{names}/cmd_vel", 10)
        self.until(lambda: bool(self.odom and self.status) and self.publisher.get_subscription_count() > 0)

    def until(self, condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> None:
        end_s = time.monotonic() + timeout_s
        while not condition():
            assert time.monotonic() < end_s, "it did not happen in time"
            self.executor.spin_once(timeout_sec=0.02)

    def spin(self, for_s: float) -> None:
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.02)

    def say(self, x: float, y: float = 0.0, turn: float = 0.0) -> None:
        twist = Twist()
        twist.linear.x, twist.linear.y, twist.angular.z = float(x), float(y), float(turn)
        self.said_s = time.time()
        self.publisher.publish(twist)

    def say_until(self, condition: Callable[[], bool], x: float, y: float = 0.0, turn: float = 0.0) -> None:
        """Says it 20 times a second, as long as it takes."""
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            assert time.monotonic() < end_s, "it did not happen in time"
            self.say(x, y, turn)
            self.spin(0.05)

    def keep_saying(self, for_s: float, x: float) -> None:
        for _ in range(round(for_s / 0.05)):
            self.say(x)
            self.spin(0.05)

    def odom_after(self, wall_s: float) -> list[Odometry]:
        """What was measured after that; stamps are the node's, on the clock that this process has, too."""
        return [o for o in self.odom if stamp_s(o) > wall_s]

    def heard_out(self, for_s: float = 0.0) -> None:
        """Until odometry has come that was measured so long after the last word."""
        due_s = self.said_s + for_s
        self.until(lambda: stamp_s(self.odom[-1]) > due_s)

    def close(self) -> None:
        self.node.destroy_node()
        self.context.try_shutdown()


def stamp_s(message: Odometry | Imu) -> float:
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)


class Bench:
    """A world with one Limo that a station drives."""

    def __init__(self, folder: Path, mode: Mode, *more: str) -> None:
        self.world = World.create(folder, lab())
        names = namespace(f"node_{mode}")
        self.node: Process = start(
            "--world", str(folder), "--vehicle", "ugv0", "--namespace", names, "--mode", mode, *more
        )  # fmt: skip
        self.station = Station(names)

    @property
    def at(self) -> tuple[float, float, float]:
        body = self.world.body(0)
        return (float(body.position_m[0]), float(body.position_m[1]), body.yaw_rad)

    @property
    def speed(self) -> float:
        return self.world.body(0).speed_mps

    def modify(self, **faults: float | bool) -> float:
        """Sets these faults alone; the wall-clock time at which they are surely in force."""
        self.world.modify(0, Modifiers(swap=0, **faults))  # type: ignore[arg-type]
        for _ in range(2):  # the turn under way may have looked before
            turn_s = self.world.body(0).time_s
            self.station.until(lambda before_s=turn_s: self.world.body(0).time_s != before_s)  # type: ignore[misc]
        return time.time()

    def close(self) -> None:
        self.station.close()
        took_s = self.node.end()
        assert self.node.popen.returncode == 0, "it ends by itself when it is asked to"
        assert took_s < 3.0


@pytest.fixture(scope="module", params=["differential", "ackermann", "mecanum"])
def any_bench(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp(request.param), request.param)
    yield bench
    bench.close()


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    bench = Bench(tmp_path_factory.mktemp("limo"), "differential")
    yield bench
    bench.close()


@pytest.fixture
def tireless(tmp_path: Path) -> Iterator[Bench]:
    """With steered wheels, and a firmware that never times out: nothing but a command stops it."""
    bench = Bench(tmp_path, "ackermann", "--command-timeout", "inf")
    yield bench
    bench.close()


def test_drives_by_cmd_vel_in_every_mode(any_bench: Bench, request: pytest.FixtureRequest) -> None:
    mode, station = request.node.callspec.params["any_bench"], any_bench.station
    assert any_bench.world.started_s is None
    assert station.status[-1].motion_mode == ["differential", "ackermann", "mecanum"].index(mode)
    station.say_until(lambda: any_bench.at[2] > 0.5, 0.4, 0.4, 0.4)
    x, y, yaw = any_bench.at
    # a circle of 1 m radius, whenever it is looked at; who drives sideways as fast as forward is on another
    circle = (math.sin(yaw), 1.0 - math.cos(yaw))
    if mode == "mecanum":
        circle = (circle[0] - circle[1], circle[1] + circle[0])
    assert (x, y) == pytest.approx(circle, abs=0.2)
    assert any_bench.world.started_s is not None
    station.until(lambda: any_bench.speed == 0.0)
    station.said_s = time.time()
    station.heard_out()
    at = station.odom[-1].pose.pose.position
    assert math.dist((at.x, at.y), any_bench.at[:2]) < 0.15


def test_speaks_at_the_real_rates_with_the_real_wrong_stamp(bench: Bench) -> None:
    station = bench.station

    def period_s(times: list[float], count: int) -> float:
        """The middle one of the newest: pauses of a busy machine are outliers."""
        gaps = [b - a for a, b in pairwise(times[-count - 1 :])]
        return statistics.median(gaps) if len(gaps) == count else math.inf

    for messages in (station.odom, station.imu):
        messages.clear()  # type: ignore[attr-defined]
    station.until(lambda: 0.018 < period_s([stamp_s(m) for m in station.odom], 50) < 0.028)
    station.until(lambda: 0.018 < period_s([stamp_s(m) for m in station.imu], 50) < 0.028)
    odom, status = len(station.odom), len(station.status)
    station.until(lambda: len(station.odom) >= odom + 150)
    assert (len(station.status) - status) / (len(station.odom) - odom) == pytest.approx(0.2, abs=0.05)
    assert station.odom[-1].header.frame_id == "odom"
    assert abs(stamp_s(station.odom[-1]) - time.time()) < PATIENCE_S
    assert station.imu[-1].linear_acceleration.z == pytest.approx(9.81, abs=0.5)
    status = station.status[-1]
    assert abs(status.stamp_ns - time.time()) < PATIENCE_S, "seconds where nanoseconds belong"
    assert (status.vehicle_state, status.control_mode, status.error_code) == (0, 1, 0)
    assert 12.0 < status.battery_v <= 12.6


def test_the_last_command_stays_in_force_for_half_a_second(bench: Bench) -> None:
    station = bench.station

    def braked_after_s() -> float:
        """From the last word to the first odometry that is slower."""
        station.say_until(lambda: station.odom[-1].twist.twist.linear.x > 0.39, 0.4)
        station.say(0.4)
        station.heard_out(0.5)
        station.until(lambda: bench.speed == 0.0)
        slower = [stamp_s(o) for o in station.odom_after(station.said_s) if o.twist.twist.linear.x < 0.38]
        return slower[0] - station.said_s

    # never sooner; later where the node had to wait for the word or for its turn
    for _ in range(5):
        took_s = braked_after_s()
        assert took_s > 0.5
        if took_s < 0.7:
            break
    else:
        pytest.fail(f"it braked only {took_s} s after the last word")


def test_stalled_it_does_not_move_and_a_dead_motor_is_reported(bench: Bench) -> None:
    bench.modify(slow=0.0)
    before = bench.at
    bench.station.keep_saying(0.5, 0.4)
    bench.station.heard_out(0.2)
    assert bench.at == before
    bench.modify(motor_fail=True)
    bench.station.until(lambda: bool(bench.station.status[-1].error_code))
    bench.station.keep_saying(0.5, 0.4)
    bench.station.heard_out(0.2)
    assert bench.at == before
    bench.modify()
    bench.station.until(lambda: not bench.station.status[-1].error_code)


def test_silent_it_hears_and_lost_it_does_not(bench: Bench) -> None:
    station = bench.station
    silent_s = bench.modify(silent=True)
    x, y, _ = bench.at
    station.say_until(lambda: math.dist(bench.at[:2], (x, y)) > 0.1, 0.4)
    bench.modify(lost=True)
    station.say_until(lambda: bench.speed == 0.0, 0.4)  # its firmware has stopped it
    station.keep_saying(0.5, 0.4)
    assert bench.speed == 0.0
    assert not station.odom_after(silent_s)
    back_s = time.time()
    bench.modify()
    station.until(lambda: bool(station.odom_after(back_s)))


def test_a_lossy_link_loses_messages_both_ways(bench: Bench) -> None:
    station = bench.station
    from_s = bench.modify(loss=0.5)
    station.odom.clear()
    station.imu.clear()
    # both are sent at the same moments and lost each by itself: of the moments of which one came, a third has both
    station.until(lambda: len(station.odom_after(from_s)) >= 100)
    odom, imu = ({stamp_s(m) for m in messages if stamp_s(m) > from_s} for messages in (station.odom, station.imu))
    assert 0.15 < len(odom & imu) / len(odom | imu) < 0.55
    bench.modify(loss=1.0)
    before = bench.at
    station.keep_saying(0.5, 0.4)
    assert bench.at == before
    bench.modify()


def test_driving_costs_energy_and_voltage(bench: Bench) -> None:
    station = bench.station
    bench.modify(drain=500.0)
    before = bench.world.body(0).energy_j
    station.say_until(lambda: bench.speed > 0.3 and bench.world.body(0).energy_j < before, 0.5)
    bench.modify(drain=1e9)
    station.say_until(lambda: bench.world.body(0).energy_j == 0.0, 0.5)
    bench.modify()
    station.until(lambda: station.status[-1].error_code & 0x1 > 0)
    assert station.status[-1].battery_v < 8.5
    station.until(lambda: bench.speed == 0.0)
    station.keep_saying(0.3, 0.5)
    station.heard_out(0.2)
    assert bench.speed == 0.0


def test_a_twist_of_zeros_does_not_stop_steered_wheels(tireless: Bench) -> None:
    station = tireless.station
    station.say_until(lambda: tireless.speed > 0.38, 0.4)
    for _ in range(6):
        station.say(0.0)
        station.heard_out(0.1)
    station.heard_out(1.0)  # more than it needs to brake
    assert tireless.speed > 0.38, "0 / 0 is no steering angle"
    station.say_until(lambda: tireless.speed == 0.0, 0.0004)


def test_stands_alone_and_ends_with_its_parent(tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    node = start("--vehicle", "mine", "--namespace", namespace("alone"), parent=parent.pid)
    assert node.first_line.startswith("ready limo mine differential")
    parent.kill()
    parent.wait()
    until(lambda: node.popen.poll() is not None)


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
