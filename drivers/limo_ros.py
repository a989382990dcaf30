"""The drivers' side of ROS 2: one node and one thread per domain, in which every robot's topics are read and written.

Messages are taken by polling at 50 Hz, not by an executor: a wait set over a dozen topics costs Python more than all
the rest of the driver, and nothing here needs a message sooner than the next 20 ms. Odometry is taken as bytes: only
its arrival counts (motion capture says where the robot is).
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, cast

import rclpy
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.duration import Duration
from rclpy.exceptions import InvalidTopicNameException
from rclpy.qos import QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Header

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.limo_status import LimoStatus, decode
from drivers.limo_typesupport import status_type

POLL_S = 0.02
LEAVE_S = 2.0
ACKED_S = 0.3  # the last words are waited for that long
# what arrives: the newest only, from reliable and best-effort publishers alike
_READ: Any = cast(Any, QoSProfile)(depth=1, reliability=QoSReliabilityPolicy.BEST_EFFORT)
_WRITE: Any = cast(Any, QoSProfile)(depth=1, reliability=QoSReliabilityPolicy.RELIABLE)

_domains: dict[int, _Domain] = {}
_domains_lock = threading.Lock()


class RosRobot:
    """One robot's topics: ``cmd_vel``, ``odom`` and, where there is one, ``limo_status``.

    Args:
        vehicle: its id, for messages.
        namespace: before the topics; empty for none.
        domain: ROS domain; None: the environment's.
        status: it has a ``limo_status``.
        clock: for the stamps of what arrives.
        turn: called every 20 ms in the domain's thread, after what arrived has been taken; it must be quick.

    Raises:
        DriverError: when the domain cannot be joined or the namespace is none.
    """

    def __init__(
        self, vehicle: str, namespace: str, domain: int | None, status: bool, clock: Clock, turn: Callable[[], None]
    ) -> None:
        self.heard_s: float | None = None
        self.odom_s: float | None = None
        self.status_s: float | None = None
        self.status: LimoStatus | None = None
        self.broken: str | None = None
        self.cmd_vel, self.odom, self.limo_status = (
            f"{namespace}/{topic}" for topic in ("cmd_vel", "odom", "limo_status")
        )
        self.turn = turn
        self._clock = clock
        self._status: Any = None
        self._twist = Twist()
        self._domain = _join(vehicle, domain)
        self.domain = self._domain.number
        node = self._domain.node
        try:
            self._publisher = node.create_publisher(Twist, self.cmd_vel, _WRITE)
            self._odom = node.create_subscription(Odometry, self.odom, _nothing, _READ, raw=True)
            if status:
                self._status = node.create_subscription(
                    status_type(Header), self.limo_status, _nothing, _READ, raw=True
                )
        except (InvalidTopicNameException, RuntimeError) as error:
            _leave(self._domain)
            remedy = (
                "give a ROS namespace such as /limo1 as its endpoint"
                if isinstance(error, InvalidTopicNameException)
                else "install this package's dependencies anew and unset RMW_IMPLEMENTATION, or set its status to false"
            )
            raise DriverError(
                f"{vehicle}: the topics of {namespace or '/'} cannot be opened: {error}; {remedy}"
            ) from error
        self._domain.add(self)

    def poll(self) -> None:
        """Takes what has arrived; only the domain's thread calls it."""
        now_s = self._clock.now()
        if _take(self._odom) is not None:
            self.odom_s = self.heard_s = now_s
        if self._status is None:
            return
        data = _take(self._status)
        if data is not None:
            with contextlib.suppress(ValueError):  # another message under this name: as if there were none
                self.status = decode(data)
                self.status_s = self.heard_s = now_s

    def publish(self, forward_mps: float, left_mps: float, turn_radps: float) -> None:
        """Sends one Twist."""
        twist = self._twist
        twist.linear.x, twist.linear.y, twist.angular.z = forward_mps, left_mps, turn_radps
        self._publisher.publish(twist)

    def listeners(self) -> int:
        """How many subscriptions the commands reach."""
        return int(self._publisher.get_subscription_count())

    def publishers(self, topic: str) -> int:
        """How many nodes publish on ``topic``, this one included."""
        return int(self._domain.node.count_publishers(topic))

    def subscribers(self, topic: str) -> int:
        """How many nodes subscribe to ``topic``, this one included."""
        return int(self._domain.node.count_subscribers(topic))

    def seen(self, name: str) -> list[str]:
        """Every topic in the domain that ends in ``name`` and that somebody else publishes or hears."""
        names = [topic for topic, _ in self._domain.node.get_topic_names_and_types()]
        return sorted(n for n in names if n.rsplit("/", 1)[-1] == name and n not in (self.odom, self.cmd_vel))

    def close(self, *last: tuple[float, float, float]) -> None:
        """Sends last Twists and leaves the domain; the last robot there takes its node and thread with it.

        Fast DDS may hang when a peer leaves at the same moment; who closes waits ``LEAVE_S`` at the most.
        """
        leaving = threading.Thread(target=self._destroy, args=(last,), name="ros-leaving", daemon=True)
        leaving.start()
        leaving.join(LEAVE_S)

    def _destroy(self, last: Sequence[tuple[float, float, float]]) -> None:
        self._domain.remove(self)
        node = self._domain.node
        with contextlib.suppress(Exception):
            for twist in last:
                self.publish(*twist)
                time.sleep(0.01)
            if last:  # a publisher that is gone repeats nothing that was lost
                self._publisher.wait_for_all_acked(Duration(seconds=ACKED_S))
            node.destroy_publisher(self._publisher)
            node.destroy_subscription(self._odom)
            if self._status is not None:
                node.destroy_subscription(self._status)
        _leave(self._domain)


def _nothing(_: Any) -> None:
    """Subscriptions are polled; their callback is never called."""


def _take(subscription: Any) -> bytes | None:
    with subscription.handle:
        taken = subscription.handle.take_message(subscription.msg_type, True)
    return None if taken is None else taken[0]


class _Domain:
    """One context, node and thread."""

    def __init__(self, number: int) -> None:
        self.number = number
        self.users = 0
        self._context = Context()
        self._context.init(args=[], domain_id=number, initialize_logging=False)
        self.node: Any = rclpy.create_node(
            f"copcs_deploy_{os.getpid()}", context=self._context, cli_args=[], use_global_arguments=False,
            enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        self._robots: list[RosRobot] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"ros-domain-{number}", daemon=True)
        self._thread.start()

    def add(self, robot: RosRobot) -> None:
        with self._lock:
            self._robots.append(robot)

    def remove(self, robot: RosRobot) -> None:
        with self._lock:
            self._robots = [r for r in self._robots if r is not robot]

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stop.wait(due_s - time.monotonic()):
            with self._lock:
                for robot in self._robots:
                    try:
                        robot.poll()
                        robot.turn()
                    except Exception as error:  # one broken robot must not stop the others'
                        robot.broken = f"{type(error).__name__}: {error}"
            due_s = max(due_s + POLL_S, time.monotonic())

    def close(self) -> None:
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join(2.0)
        with contextlib.suppress(Exception):
            self.node.destroy_node()
        self._context.try_shutdown()


def _join(vehicle: str, domain: int | None) -> _Domain:
    try:
        number = int(os.environ.get("ROS_DOMAIN_ID") or 0) if domain is None else domain
        with _domains_lock:
            known = _domains.get(number) or _Domain(number)
            _domains[number] = known
            known.users += 1
            return known
    except (ValueError, RuntimeError) as error:
        raise DriverError(
            f"{vehicle}: ROS domain {os.environ.get('ROS_DOMAIN_ID') if domain is None else domain} cannot be joined: "
            f"{error}; give a domain from 0 to 232, and check RMW_IMPLEMENTATION and the network interface"
        ) from error


def _leave(domain: _Domain) -> None:
    with _domains_lock:
        domain.users -= 1
        if domain.users > 0:
            return
        _domains.pop(domain.number, None)
    domain.close()
