"""The Limo driver over ROS 2: what it sends and when, what it notices, what it says when something is missing.

A busy machine may keep everybody here waiting for a second: no test counts on something having happened by then.
"""

from __future__ import annotations

import math
import statistics
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import pytest
import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from drivers import limo_ros
from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.limits import PoseBook, UgvLimits
from drivers.limo import Limo, LimoOptions
from drivers.pursuit import Mode
from drivers.vehicle import Arm, Disarm, Drive, Hold, Pose, StopMotors, Vec2
from sim_backends.wire.world import Modifiers, World
from tests.drivers.limo_wire import DOMAIN, Process, TruePoses, lab, namespace, start, until

pytestmark = pytest.mark.wire

LIMITS = UgvLimits(max_speed_mps=0.5, accel_mps2=1.0)


def limo(vehicle: str, names: str, **options: object) -> Limo:
    made = LimoOptions(domain=DOMAIN, **options)  # type: ignore[arg-type]
    clock = RealClock()
    return Limo(vehicle, names, body=f"{vehicle}-body", limits=LIMITS, book=PoseBook(), clock=clock, options=made)


class Robot:
    """Any ROS 2 robot: hears ``cmd_vel`` and tells ``odom``, at 50 Hz, in a thread; notes every Twist with its time."""

    def __init__(self, names: str) -> None:
        self.heard: list[tuple[float, float, float, float]] = []
        self._context = Context()
        self._context.init(args=[], domain_id=DOMAIN)
        self._node = rclpy.create_node("robot", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(Twist, f"{names}/cmd_vel", self._hear, 10)
        odom = self._node.create_publisher(Odometry, f"{names}/odom", 10)
        self._node.create_timer(0.02, lambda: odom.publish(Odometry()))
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    def _hear(self, twist: Twist) -> None:
        self.heard.append((time.monotonic(), twist.linear.x, twist.linear.y, twist.angular.z))

    @property
    def forward_mps(self) -> float:
        """As it was told last; not a number before."""
        return self.heard[-1][1] if self.heard else math.nan

    def silent_s(self) -> float:
        return time.monotonic() - self.heard[-1][0]

    def close(self) -> None:
        self._executor.shutdown()
        self._thread.join(2.0)
        self._node.destroy_node()
        self._context.try_shutdown()


@pytest.fixture
def robot() -> Iterator[Robot]:
    robot = Robot(namespace("any"))
    yield robot
    robot.close()


def feed_until(driver: Limo, condition: Callable[[], bool], at: Callable[[], Vec2] = lambda: (0.0, 0.0)) -> float:
    """Feeds poses at 50 Hz until it holds; when it began to feed the last one, s."""
    fed_s = time.monotonic()
    end_s = fed_s + 20.0
    while not condition():
        assert time.monotonic() < end_s, "it did not happen in time"
        fed_s = time.monotonic()
        driver.feed_pose(Pose(driver._body, (*at(), 0.0), 0.0, driver._clock.now()))
        time.sleep(0.02)
    return fed_s


@dataclass
class Team:
    """Simulated Limos, their drivers, and a loop that feeds poses at 50 Hz in a thread."""

    world: World
    nodes: list[Process]
    limos: list[Limo]
    poses: TruePoses

    def feed(self) -> None:
        for pose in self.poses.read():
            row = [g.body for g in self.world.config.ugvs].index(pose.body)
            self.limos[row].feed_pose(Pose(f"ugv{row}-body", pose.position_m, pose.yaw_rad, pose.stamp_s))

    def run(self, for_s: float) -> None:
        end_s = time.monotonic() + for_s
        while time.monotonic() < end_s:
            self.feed()
            time.sleep(0.02)

    def run_until(self, condition: Callable[[], bool], timeout_s: float = 20.0) -> float:
        start_s = time.monotonic()
        while not condition():
            assert time.monotonic() - start_s < timeout_s, "it did not happen in time"
            self.run(0.02)
        return time.monotonic() - start_s

    def at(self, row: int = 0) -> Vec2:
        x, y, _ = self.world.body(row).position_m
        return (float(x), float(y))

    def modify(self, row: int = 0, **faults: float | bool) -> None:
        self.world.modify(row, Modifiers(swap=row, **faults))  # type: ignore[arg-type]

    def drive(self, path: tuple[Vec2, ...], row: int = 0) -> None:
        ugv = f"ugv{row}"
        self.limos[row].send(Arm(ugv))
        self.limos[row].send(Drive(ugv, path, 0.4))


def team(folder: Path, mode: Mode, name: str, ugvs: int = 1, arguments: Sequence[str] = ()) -> Team:
    world = World.create(folder, lab(ugvs))
    names = [namespace(f"{name}{k}") for k in range(ugvs)]
    nodes = [
        start("--world", str(folder), "--vehicle", f"ugv{k}", "--namespace", names[k], "--mode", mode, *arguments)
        for k in range(ugvs)
    ]
    clock = RealClock()
    limos = [
        Limo(
            f"ugv{k}", names[k], body=f"ugv{k}-body", limits=LIMITS, book=PoseBook(), clock=clock,
            options=LimoOptions(domain=DOMAIN, mode=mode),
        )
        for k in range(ugvs)
    ]  # fmt: skip
    for one in limos:
        one.connect(clock.now() + 15.0)
    return Team(world, nodes, limos, TruePoses(world, clock))


@pytest.fixture
def ackermann(tmp_path: Path) -> Iterator[Team]:
    """Its firmware never times out: nothing but a command stops it."""
    made = team(tmp_path, "ackermann", "acker", arguments=("--command-timeout", "inf"))
    yield made
    close(made)


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Team]:
    made = team(tmp_path_factory.mktemp("pair"), "differential", "pair", 2)
    yield made
    close(made)


def close(made: Team) -> None:
    for one in made.limos:
        one.close()
    for node in made.nodes:
        node.end()


def test_drives_any_robot_at_20_hz_stops_explicitly_and_is_silent_when_idle(robot: Robot) -> None:
    driver, clock = limo("ugv0", namespace("any"), status=False), RealClock()
    driver.connect(clock.now() + 15.0)
    time.sleep(0.3)
    assert not robot.heard, "nothing before it is told to"
    driver.send(Arm("ugv0"))
    driver.send(Drive("ugv0", ((0.0, 0.0), (50.0, 0.0)), 0.4))
    begin_s = time.monotonic()

    def at() -> Vec2:
        return (0.4 * (time.monotonic() - begin_s), 0.0)

    def period_s() -> float:
        """The middle one of the newest: pauses of a busy machine are outliers; 40 ms and 60 ms take turns."""
        times = [h[0] for h in robot.heard[-32:]]
        return statistics.median(b - a for a, b in zip(times, times[2:], strict=False)) / 2

    feed_until(driver, lambda: len(robot.heard) > 30 and 0.044 < period_s() < 0.066, at)
    # late is possible, more is not
    assert len(robot.heard) < 23.0 * (time.monotonic() - begin_s) + 3.0
    feed_until(driver, lambda: robot.forward_mps == pytest.approx(0.4, abs=0.01), at)
    assert driver.state().battery is None
    assert driver.state().fault is None
    checks = {c.name: c.verdict for c in driver.self_checks()}
    assert checks["commands"] == checks["telemetry"] == "pass"
    assert checks["mode"] == checks["battery"] == "not run"
    driver.send(Hold("ugv0"))
    until(lambda: robot.forward_mps == 0.0)
    until(lambda: robot.silent_s() > 0.7, what="it never falls silent")
    zeros = [h for h in robot.heard if h[1] == 0.0]
    assert len(zeros) >= 5, "it says so several times"
    quiet = len(robot.heard)
    driver.send(StopMotors("ugv0"))
    until(lambda: len(robot.heard) > quiet)
    driver.close()


def test_stops_on_stale_poses_and_goes_on_with_fresh_ones(robot: Robot) -> None:
    driver = limo("ugv0", namespace("any"), status=False, pose_stale_s=0.3)
    driver.connect(driver._clock.now() + 15.0)
    driver.send(Arm("ugv0"))
    driver.send(Drive("ugv0", ((0.0, 0.0), (5.0, 0.0)), 0.4))
    fed_s = feed_until(driver, lambda: robot.forward_mps > 0.3)
    until(lambda: robot.forward_mps == 0.0)
    braking_s = next(b[0] for a, b in pairwise(robot.heard) if a[0] >= fed_s and b[1] < a[1])
    assert braking_s - fed_s > 0.3
    assert driver.state().fault == "waiting for poses"
    feed_until(driver, lambda: robot.forward_mps > 0.0)
    driver.send(Disarm("ugv0"))
    until(lambda: robot.forward_mps == 0.0)
    driver.close()


def test_closing_stops_it(robot: Robot) -> None:
    domains = dict(limo_ros._domains)
    driver = limo("ugv0", namespace("any"), status=False)
    driver.connect(driver._clock.now() + 15.0)
    driver.send(Arm("ugv0"))
    driver.send(Drive("ugv0", ((0.0, 0.0), (5.0, 0.0)), 0.4))
    feed_until(driver, lambda: robot.forward_mps > 0.1)
    driver.close()
    until(lambda: robot.heard[-1][1:] == (0.0, 0.0, 0.0))
    assert limo_ros._domains == domains, "and the domain is left"


def test_two_limos_in_one_domain_drive_their_own_ways(pair: Team) -> None:
    assert len(limo_ros._domains) == 1
    assert [t.name for t in threading.enumerate()].count(f"ros-domain-{DOMAIN}") == 1
    ends = ((0.8, 0.3), (0.5, 1.6))
    pair.drive(((0.0, 0.0), (0.8, 0.0), ends[0]), 0)
    pair.drive(((0.0, 2.0), (0.5, 2.0), ends[1]), 1)
    pair.run_until(lambda: all(math.dist(pair.at(k), ends[k]) < 0.04 for k in (0, 1)))
    for one in pair.limos:
        pair.run_until(lambda one=one: one.state().link and one.state().fault is None)  # type: ignore[misc]
    for k in (0, 1):
        state = pair.limos[k].state()
        assert state.battery is not None
        assert 0.8 < state.battery <= 1.0
        assert {c.verdict for c in pair.limos[k].self_checks()} == {"pass"}


def test_limos_in_a_domain_each_are_reached_from_one_process(pair: Team, tmp_path: Path) -> None:
    world = World.create(tmp_path, lab())
    other = DOMAIN + 1
    node = start("--world", str(tmp_path), "--vehicle", "ugv0", "--namespace", namespace("pair0"), domain=other)
    driver = Limo(
        "ugv0", namespace("pair0"), body="b", limits=LIMITS, book=PoseBook(), clock=RealClock(),
        options=LimoOptions(domain=other),
    )  # fmt: skip
    driver.connect(driver._clock.now() + 15.0)
    assert set(limo_ros._domains) >= {DOMAIN, other}
    before = pair.at()
    driver.send(Arm("ugv0"))
    driver.send(Drive("ugv0", ((0.0, 0.0), (1.0, 0.0)), 0.4))

    def x() -> float:
        return float(world.body(0).position_m[0])

    feed_until(driver, lambda: x() > 0.1, lambda: (x(), 0.0))
    assert pair.at() == before, "the one with the same name in the other domain hears nothing"
    driver.close()
    assert other not in limo_ros._domains
    node.end()


def test_stalled_it_keeps_trying_and_goes_on(pair: Team) -> None:
    pair.modify(0, slow=0.0)
    x, y = pair.at()
    pair.drive(((x, y), (x + 0.4, y)))
    pair.run(1.5)
    assert math.dist(pair.at(), (x, y)) < 0.02
    pair.modify(0)
    pair.run_until(lambda: math.dist(pair.at(), (x + 0.4, y)) < 0.04)


def test_silence_shows_in_the_link_while_it_hears_on(pair: Team) -> None:
    x, y = pair.at(1)
    pair.modify(1, silent=True)
    driver = pair.limos[1]
    pair.run_until(lambda: not driver.state().link)
    assert driver._clock.now() - driver.state().stamp_s > LimoOptions().link_stale_s
    pair.drive(((x, y), (x + 0.3, y)), 1)
    pair.run_until(lambda: math.dist(pair.at(1), (x + 0.3, y)) < 0.04)
    pair.run_until(lambda: pair.limos[0].state().link)
    pair.modify(1)
    pair.run_until(lambda: pair.limos[1].state().link)


def test_drives_through_a_link_that_loses_30_percent(pair: Team) -> None:
    x, y = pair.at()
    pair.modify(0, loss=0.3)
    pair.drive(((x, y), (x + 0.5, y)))
    pair.run_until(lambda: math.dist(pair.at(), (x + 0.5, y)) < 0.05)
    pair.run_until(lambda: pair.limos[0].state().link)
    pair.modify(0)


def test_a_failed_motor_is_told(pair: Team) -> None:
    pair.modify(0, motor_fail=True)
    pair.run_until(lambda: "motor driver 1" in (pair.limos[0].state().fault or ""))
    assert {c.name: c.verdict for c in pair.limos[0].self_checks()}["errors"] == "fail"
    pair.modify(0)
    pair.run_until(lambda: pair.limos[0].state().fault is None)


def test_a_new_path_on_the_way_takes_over(pair: Team) -> None:
    x, y = pair.at()
    pair.drive(((x, y), (x + 2.0, y)))
    pair.run_until(lambda: pair.at()[0] > x + 0.3)
    before = pair.at()
    pair.drive((before, (before[0] + 0.3, y), (before[0] + 0.3, y - 0.3)))
    pair.run_until(lambda: math.dist(pair.at(), (before[0] + 0.3, y - 0.3)) < 0.04)


def test_killed_it_is_noticed_and_found_again(pair: Team, tmp_path: Path) -> None:
    driver = pair.limos[1]
    pair.nodes[1].popen.kill()
    pair.run_until(lambda: not driver.state().link)
    driver.send(StopMotors("ugv1"))
    assert driver.state().locked
    names = namespace("pair1")
    pair.nodes[1] = start("--world", str(pair.world.folder), "--vehicle", "ugv1", "--namespace", names)
    driver.connect(driver._clock.now() + 15.0)
    until(lambda: driver.state().link)
    assert not driver.state().locked, "connected anew"
    x, y = pair.at(1)
    pair.drive(((x, y), (x + 0.2, y)), 1)
    pair.run_until(lambda: math.dist(pair.at(1), (x + 0.2, y)) < 0.04)


def test_steered_wheels_stop_within_their_limits(ackermann: Team) -> None:
    end = (1.0, 0.6)
    ackermann.drive(((0.0, 0.0), (1.0, 0.0), end))
    ackermann.run_until(lambda: math.dist(ackermann.at(), end) < 0.05)
    x, y = ackermann.at()
    ackermann.drive(((x, y), (x, y + 2.0)))
    ackermann.run_until(lambda: ackermann.at()[1] > y + 0.4)
    ackermann.limos[0].send(StopMotors("ugv0"))
    # a Twist of zeros would be lost here, and this firmware drive on for ever
    ackermann.run_until(lambda: ackermann.world.body(0).speed_mps == 0.0)


def test_a_mode_other_than_planned_is_a_failed_check(ackermann: Team) -> None:
    wrong = Limo(
        "ugv0", namespace("acker0"), body="b", limits=LIMITS, book=PoseBook(), clock=RealClock(),
        options=LimoOptions(domain=DOMAIN, mode="mecanum"),
    )  # fmt: skip
    wrong.connect(wrong._clock.now() + 15.0)
    check = {c.name: c for c in wrong.self_checks()}["mode"]
    assert check.verdict == "fail"
    assert "ackermann" in check.text
    assert "another motion mode" in (wrong.state().fault or "")
    wrong.close()


def test_what_is_missing_is_named_in_time(robot: Robot) -> None:
    nowhere = limo("ugv7", namespace("nowhere"))
    with pytest.raises(DriverError, match=rf"ugv7: no publisher on {namespace('nowhere')}/odom in ROS domain {DOMAIN}"):
        nowhere.connect(nowhere._clock.now() + 1.0)
    assert nowhere._clock.now() < 5.0
    assert not nowhere.state().link
    with pytest.raises(DriverError, match="ugv7"):
        nowhere.send(Arm("ugv7"))
    other = limo("ugv0", namespace("any"))
    with pytest.raises(DriverError, match=r"no publisher on /any_\d+/limo_status.*status: false"):
        other.connect(other._clock.now() + 5.0)  # somebody else has to be found first
    typing_error = limo("ugv0", namespace("ani"))
    with pytest.raises(DriverError, match=r"there is .*/any_\d+/odom"):
        typing_error.connect(typing_error._clock.now() + 5.0)


def test_unsound_settings_are_one_clear_error() -> None:
    with pytest.raises(DriverError, match="domain is 300"):
        LimoOptions(domain=300)
    with pytest.raises(DriverError, match="mode is 'tank'"):
        LimoOptions(mode="tank")  # type: ignore[arg-type]
    with pytest.raises(DriverError, match="pose_stale_s"):
        LimoOptions(pose_stale_s=0.0)
    with pytest.raises(DriverError, match="ugv0: 'a b' is no ROS namespace"):
        limo("ugv0", "a b")
