"""AgileX Limo, and any ROS 2 robot with ``cmd_vel`` and ``odom``: drives paths on motion-capture poses.

The Limo has no emergency stop, no arming and no watchdog in its ROS driver, so all three are kept here: nothing is sent
until ``Arm``; while it drives, a command goes out at 20 Hz; and it is stopped by saying so, several times. What a dead
ground station leaves behind is up to the firmware, which stops half a second after the last command on AgileX' chassis.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from drivers import limo_status
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.last_will import LastWill
from drivers.limits import PoseBook, UgvLimits
from drivers.limo_checks import Seen, checks
from drivers.pursuit import STILL, Mode, Motion, Pursuit, Tuning, carried_on
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Drive,
    Hold,
    Kind,
    Pose,
    SelfCheck,
    StopMotors,
    VehicleState,
)

if TYPE_CHECKING:
    from drivers.limo_ros import RosRobot

PERIOD_S = 0.05
STOPS = 10
"""So many stop commands follow a movement: half a second, in which a lossy radio delivers some."""
CARRY_S = 0.1
"""An older pose is carried on by no more than this; loops feed poses every 20 to 100 ms."""
REMIND_S = 0.5
"""A locked Limo is told to stop so often, in case another program commands it."""
SMOOTH_S = 10.0
"""Time constant of the battery's reading: driving off makes the voltage sag for a moment."""
TINY_MPS = 0.0004
"""Forward speed of an Ackermann stop. The Limo's ROS driver divides linear by angular speed, so that a Twist of zeros
steers by 0/0; this one steers straight, and is 0 mm/s in the serial frame, whose unit is mm/s (``limo_driver.cpp``)."""
_NAMESPACE = re.compile(r"(/[A-Za-z_][A-Za-z0-9_]*)*")


@dataclass(frozen=True, slots=True)
class LimoOptions:
    """How to reach and drive it.

    Attributes:
        domain: its ROS domain; None: that of ROS_DOMAIN_ID. Two Limos either have one each or a namespace each.
        mode: as its hardware is set up (wheels, steering pins); pre-flight compares it with what it reports.
        status: it has a ``limo_status``; false for other robots.
        pose_stale_s: it stops when its newest pose is older: at 0.5 m/s it drives 0.15 m blind.
        link_stale_s: silent for longer, its link counts as down: 50 odometry messages or 10 status messages.
        tuning: of the path following.
    """

    domain: int | None = None
    mode: Mode = "differential"
    status: bool = True
    pose_stale_s: float = 0.3
    link_stale_s: float = 1.0
    tuning: Tuning = field(default_factory=Tuning)

    def __post_init__(self) -> None:
        if self.domain is not None and not 0 <= self.domain <= 232:
            raise DriverError(f"limo: domain is {self.domain!r}; give a ROS domain from 0 to 232")
        if self.mode not in limo_status.MOTION_MODES:
            raise DriverError(f"limo: mode is {self.mode!r}; give one of {', '.join(limo_status.MOTION_MODES)}")
        for name in ("pose_stale_s", "link_stale_s"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise DriverError(f"limo: {name} is {value!r}; give s above 0")


class Limo:
    """One Limo; a UGV of ``drivers.vehicle``.

    ``StopMotors`` locks it until it is connected anew: it has no lock of its own.

    Args:
        id: vehicle id.
        endpoint: ROS namespace such as ``/limo1``; empty or ``/`` for the absolute names that it has by default.
        body: its name in motion capture.
        limits: never exceeded.
        book: where its poses are noted for others.
        clock: the loop's.
        options: see there.

    Raises:
        DriverError: when the endpoint is no namespace.
    """

    def __init__(
        self,
        id: str,
        endpoint: str,
        *,
        body: str,
        limits: UgvLimits,
        book: PoseBook,
        clock: Clock,
        options: LimoOptions | None = None,
    ) -> None:
        self._id, self._body, self._limits = id, body, limits
        self._book, self._clock, self._options = book, clock, options or LimoOptions()
        namespace = "/" + endpoint.strip().strip("/") if endpoint.strip("/ ") else ""
        if not _NAMESPACE.fullmatch(namespace):
            raise DriverError(f"{id}: {endpoint!r} is no ROS namespace; give one such as /limo1, or / for none")
        self._namespace = namespace
        self._lock = threading.Lock()
        self._ros: RosRobot | None = None
        self._pose: Pose | None = None
        self._reset()

    def _reset(self) -> None:
        self._armed = self._locked = self._driving = self._waiting = False
        self._pursuit: Pursuit | None = None
        self._motion = STILL
        self._stops = 0
        self._due_s = self._turned_s = -math.inf
        self._battery_v: float | None = None
        self._battery_s = 0.0

    @property
    def id(self) -> str:
        """Its id in the fleet."""
        return self._id

    @property
    def kind(self) -> Kind:
        """A UGV."""
        return "ugv"

    def connect(self, deadline_s: float) -> None:
        """Joins the domain and waits until the robot speaks and listens.

        Raises:
            DriverError: when ROS cannot be loaded, or something is missing at the deadline.
        """
        self.close()
        try:
            from drivers.limo_ros import RosRobot  # noqa: PLC0415 - half a second, for those alone who have a Limo
        except ImportError as error:
            raise DriverError(
                f"{self._id}: ROS 2 cannot be loaded ({error}); install this package's dependencies anew, "
                "or start it in a shell without another ROS in PYTHONPATH"
            ) from error
        options = self._options
        with self._lock:
            self._reset()
        ros = RosRobot(self._id, self._namespace, options.domain, options.status, self._clock, self._turn)
        while (missing := self._missing(ros)) is not None:
            if self._clock.now() >= deadline_s:
                ros.close()
                raise DriverError(f"{self._id}: {missing}")
            self._clock.wait_until(min(self._clock.now() + 0.02, deadline_s))
        with self._lock:
            self._ros = ros

    def _missing(self, ros: RosRobot) -> str | None:
        """What is still missing, with its remedy; None when all is there."""
        where = f"in ROS domain {ros.domain}"
        topics = [(ros.odom, ros.odom_s)] + ([(ros.limo_status, ros.status_s)] if self._options.status else [])
        for topic, heard_s in topics:
            if heard_s is not None:
                continue
            name = topic.rsplit("/", 1)[-1]
            if ros.publishers(topic):
                return (
                    f"{topic} is published {where}, but nothing arrives; check the network between here and the robot "
                    "(firewall, multicast, the interface)"
                    + (" and that its type is limo_msgs/msg/LimoStatus" if name == "limo_status" else "")
                )
            others = [t for t in ros.seen(name) if ros.publishers(t)]
            hint = f" (there is {', '.join(others)}: is that the namespace?)" if others else ""
            remedy = (
                "switch the robot on, start its ROS driver, and compare its domain and namespace with the fleet file"
                if name == "odom"
                else "a robot other than a Limo needs the option status: false"
            )
            return f"no publisher on {topic} {where}{hint}; {remedy}"
        if not ros.listeners():
            others = [t for t in ros.seen("cmd_vel") if ros.subscribers(t)]
            hint = f" (there is {', '.join(others)})" if others else ""
            return f"nobody listens to {ros.cmd_vel} {where}{hint}; is its ROS driver started, and cmd_vel remapped?"
        return None

    def state(self) -> VehicleState:
        """The newest snapshot; never blocks."""
        ros, now_s = self._ros, self._clock.now()
        if ros is None or ros.heard_s is None:
            return VehicleState(self._id, 0.0, False, False, locked=self._locked)
        return VehicleState(
            self._id,
            ros.heard_s,
            link=now_s - ros.heard_s <= self._options.link_stale_s,
            armed=self._armed,
            locked=self._locked,
            battery=None if self._battery_v is None else limo_status.charge(self._battery_v),
            fault=self._fault(ros),
        )

    def _fault(self, ros: RosRobot) -> str | None:
        words: list[str] = []
        status = ros.status
        if status is not None:
            words += limo_status.errors(status.error_code)
            if status.vehicle_state != limo_status.NORMAL and not words:
                words.append(f"vehicle state {status.vehicle_state}")
            if status.control_mode != limo_status.COMMANDED:
                words.append("not under control of ROS (remote control?)")
            if status.motion_mode != limo_status.MOTION_MODES.index(self._options.mode):
                words.append("in another motion mode than planned")
        if ros.broken:
            words.append(ros.broken)
        if self._waiting:
            words.append("waiting for poses")
        pursuit = self._pursuit
        if pursuit is not None and pursuit.missed_m is not None:
            words.append(f"stopped {pursuit.missed_m:.2f} m from the path's end")
        return ", ".join(words) or None

    def send(self, command: Command) -> Command:
        """Takes a command for the next period, at the most 20 ms away; never blocks.

        Raises:
            DriverError: when it is not for this vehicle, of the wrong kind, unsound, or the vehicle is not connected.
        """
        if command.vehicle != self._id:
            raise DriverError(f"{self._id}: got a command for {command.vehicle}; send it to that vehicle")
        if not isinstance(command, Arm | Disarm | Drive | Hold | StopMotors):
            raise DriverError(f"{self._id}: a UGV cannot {type(command).__name__}; send it drives only")
        if self._ros is None:
            raise DriverError(f"{self._id}: is not connected; connect it first")
        if isinstance(command, Drive):
            numbers = (command.speed_mps, *(c for point in command.path_m for c in point))
            if not command.path_m or not all(map(math.isfinite, numbers)) or command.speed_mps <= 0:
                raise DriverError(f"{self._id}: {command} is no drive; give at least one point and a speed above 0")
            command = self._limits.limited(command)
        with self._lock:
            self._accept(command)
        return command

    def _accept(self, command: Command) -> None:
        match command:
            case StopMotors():
                self._locked, self._armed, self._driving, self._pursuit = True, False, False, None
                self._stops, self._due_s = 2 * STOPS, -math.inf
            case Arm():
                self._armed = not self._locked
            case Disarm():
                self._armed = self._driving = False
                self._stops = max(self._stops, STOPS)
            case Hold():
                self._driving = False
                self._stops = max(self._stops, 2)
            case Drive() if self._armed:
                self._drive(command)
            case _:
                pass

    def _drive(self, command: Drive) -> None:
        before = self._pursuit
        if before is None or before.path != command.path_m:
            self._pursuit = Pursuit(
                command.path_m, self._options.mode, command.speed_mps, self._limits.accel_mps2, self._options.tuning
            )
            if before is not None:
                self._pursuit.take_over(before)
        elif before.arrived:
            return
        else:
            before.speed_mps = command.speed_mps
        self._driving = True

    def _turn(self) -> None:
        """Called every 20 ms by the domain's thread; commands every 50 ms."""
        ros, now_s = self._ros, self._clock.now()
        if ros is None:
            return
        self._read_battery(ros, now_s)
        with self._lock:
            if now_s < self._due_s - 0.005:
                return
            dt_s = min(max(now_s - self._turned_s, 0.0), 2 * PERIOD_S)
            self._due_s, self._turned_s = max(self._due_s + PERIOD_S, now_s), now_s
            motion = self._motion = self._next(now_s, dt_s)
            if motion.still and not self._driving:
                if self._stops > 0:
                    self._stops -= 1
                elif self._locked:
                    self._due_s = now_s + REMIND_S
                else:
                    return
            else:
                self._stops = max(self._stops, STOPS)
        ros.publish(*self._twist(motion))

    def _next(self, now_s: float, dt_s: float) -> Motion:
        pursuit, pose = self._pursuit, self._pose
        self._waiting = False
        if pursuit is None:
            return STILL
        fresh = pose is not None and now_s - pose.stamp_s <= self._options.pose_stale_s
        yaw_rad = pose.yaw_rad if pose is not None else None
        if not self._driving:
            return pursuit.brake(dt_s, yaw_rad)
        if pose is None or not fresh:
            self._waiting = True
            return pursuit.brake(dt_s, yaw_rad)
        age_s = min(max(now_s - pose.stamp_s, 0.0), CARRY_S)
        motion = pursuit.step(*carried_on(*pose.position_m[:2], pose.yaw_rad, self._motion, age_s), dt_s)
        if pursuit.arrived and motion.still:
            self._driving = False
        return motion

    def _twist(self, motion: Motion) -> tuple[float, float, float]:
        if motion.still and self._options.mode == "ackermann" and self._options.status:
            motion = Motion(TINY_MPS)
        return (motion.forward_mps, motion.left_mps, motion.turn_radps)

    def _read_battery(self, ros: RosRobot, now_s: float) -> None:
        if ros.status is None or ros.status_s is None or ros.status_s == self._battery_s:
            return
        volts = ros.status.battery_v
        share = min(1.0, (ros.status_s - self._battery_s) / SMOOTH_S)
        self._battery_v = volts if self._battery_v is None else self._battery_v + share * (volts - self._battery_v)
        self._battery_s = ros.status_s

    def self_checks(self) -> Sequence[SelfCheck]:
        """Mode, control, errors, battery, telemetry and who else commands it."""
        ros = self._ros
        if ros is None:
            return [SelfCheck("link", "fail", "not connected; connect it first")]
        now_s = self._clock.now()
        odom_age_s = now_s - ros.odom_s if ros.odom_s is not None else math.inf
        status = ros.status if self._options.status else None
        return checks(
            Seen(status, odom_age_s, ros.listeners(), ros.publishers(ros.cmd_vel) - 1, ros.cmd_vel),
            self._options.mode,
            self._options.status,
            self._options.link_stale_s,
        )

    def feed_pose(self, pose: Pose) -> None:
        """Takes a pose: it is what the path following steers by."""
        self._book.put(pose)
        if pose.body == self._body:
            self._pose = pose

    def last_will(self) -> LastWill:
        """It is told to stop."""
        domain = self._options.domain if self._ros is None else self._ros.domain
        stop_mps, _, _ = self._twist(STILL)
        arguments = {"namespace": self._namespace, "domain": domain, "stop_mps": stop_mps}
        return LastWill(self._id, "drivers.limo_will", arguments)

    def close(self) -> None:
        """Stops it and leaves the domain."""
        with self._lock:
            ros, self._ros = self._ros, None
            self._armed = self._driving = False
            self._pursuit = None
        if ros is not None:
            ros.close(*3 * [self._twist(STILL)])
