"""A simulated AgileX Limo on ROS 2: a process that drives by ``cmd_vel`` and tells odometry, IMU and status.

Run as ``python -m sim_backends.wire.limo_node --world FOLDER --vehicle ugv0 [--namespace /limo1] [--domain 0]``;
without ``--world`` it makes a world of its own. It behaves as the real one does behind ``limo_ros2``: absolute topic
names, no watchdog in the ROS driver, a status stamp that takes seconds for nanoseconds. What moves is in ``limo_base``.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import random
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from drivers.errors import DriverError
from drivers.limo_status import COMMANDED, NORMAL, LimoStatus, encode
from sim_backends.errors import SimulationError
from sim_backends.wire import limo_base
from sim_backends.wire.limo_base import LimoBase, Mode, Motion
from sim_backends.wire.physics import UgvBattery
from sim_backends.wire.world import BATTERY_EMPTY, FINE, MOTOR_FAILURE, Body, Modifiers, World, yaw_quaternion
from sim_backends.world import SimUgv, WorldConfig

STEP_S = 0.01
ODOM_EVERY, IMU_EVERY, STATUS_EVERY = 2, 2, 10
"""Steps between messages: 50 Hz, 50 Hz and 10 Hz."""
PARENT_S = 0.5
LEAVE_S = 0.5
LEAP_S = 0.25
"""A process that was stopped for longer than this does not drive the whole way at once."""


class LimoNode:
    """One Limo: its chassis in the shared world and its ROS 2 topics.

    Args:
        world: the shared world.
        vehicle: id of a UGV in it.
        mode: as its hardware is set up.
        namespace: before every topic; empty for the absolute names of the real one.
        domain: ROS domain; None: the environment's.
        command_timeout_s: of the firmware.

    Raises:
        SimulationError: when the vehicle is no UGV, or the namespace is none.
    """

    def __init__(
        self,
        world: World,
        vehicle: str,
        *,
        mode: Mode = "differential",
        namespace: str = "",
        domain: int | None = None,
        command_timeout_s: float = limo_base.COMMAND_TIMEOUT_S,
    ) -> None:
        self._world, self._row = world, world.row(vehicle)
        if world.is_uav(self._row):
            raise SimulationError(f"{vehicle} is a UAV in this world; a Limo needs a UGV")
        config = world.ugv(self._row)
        body = world.body(self._row)
        seed = world.config.seed * 1009 + self._row
        self._base = LimoBase(
            mode,
            Motion(body.position_m[0], body.position_m[1], body.yaw_rad),
            max_speed_mps=config.max_speed_mps,
            accel_mps2=config.accel_mps2,
            slip_m=config.tracking_noise_m,
            seed=seed,
            command_timeout_s=command_timeout_s,
        )
        self._battery = UgvBattery(world, self._row)
        self._random = random.Random(seed)
        self._count = 0
        self._last_s = time.monotonic()
        self._last_forward = 0.0
        self._open(vehicle, namespace.rstrip("/"), domain)
        self._put(Modifiers())

    def _open(self, vehicle: str, namespace: str, domain: int | None) -> None:
        import rclpy  # noqa: PLC0415 - it takes half a second, which a user's typing error need not wait for
        from geometry_msgs.msg import Twist  # noqa: PLC0415
        from nav_msgs.msg import Odometry  # noqa: PLC0415
        from rclpy.context import Context  # noqa: PLC0415
        from sensor_msgs.msg import Imu  # noqa: PLC0415
        from std_msgs.msg import Header  # noqa: PLC0415

        from drivers.limo_typesupport import status_type  # noqa: PLC0415

        self._context = Context()
        self._context.init(args=[], domain_id=domain)
        self.domain = int(self._context.get_domain_id())
        name = "limo_base_node_" + "".join(c if c.isalnum() else "_" for c in vehicle)
        try:
            self._node = rclpy.create_node(
                name, context=self._context, start_parameter_services=False, enable_rosout=False, cli_args=[]
            )
            self.topic = f"{namespace}/cmd_vel"
            self._cmd_vel = self._node.create_subscription(Twist, self.topic, lambda _: None, 10)
        except rclpy.exceptions.InvalidTopicNameException as error:
            raise SimulationError(f"{namespace!r} is no ROS namespace: {error}; give one such as /limo1") from error
        self._odom = self._node.create_publisher(Odometry, f"{namespace}/odom", 50)
        self._imu = self._node.create_publisher(Imu, f"{namespace}/imu", 10)
        self._status = self._node.create_publisher(status_type(Header), f"{namespace}/limo_status", 50)
        self._odometry, self._inertia = Odometry(), Imu()
        self._odometry.header.frame_id, self._odometry.child_frame_id = "odom", "base_link"
        self._inertia.header.frame_id = "imu_link"
        for i in (0, 7, 14):
            self._odometry.pose.covariance[i] = 0.1
            self._odometry.pose.covariance[i + 21] = 1.0

    def turn(self) -> None:
        """One step: hears, moves, speaks."""
        now_s = time.monotonic()
        dt_s, self._last_s = min(now_s - self._last_s, LEAP_S), now_s
        faults = self._world.modifiers(self._row)
        self._hear(now_s, faults)
        empty = self._battery.energy_j <= 0.0
        self._base.step(now_s, dt_s, slow=faults.slow, dead=faults.motor_fail or empty)
        self._battery.step(dt_s, self._speed(), faults)
        self._put(faults)
        if not (faults.silent or faults.lost):
            self._speak(faults, dt_s)
        self._last_forward = self._base.forward_mps
        self._count += 1

    def _speed(self) -> float:
        return math.hypot(self._base.forward_mps, self._base.left_mps)

    def _hear(self, now_s: float, faults: Modifiers) -> None:
        # taken without an executor: a wait set costs more than everything else here
        while True:
            with self._cmd_vel.handle:
                taken = self._cmd_vel.handle.take_message(self._cmd_vel.msg_type, False)
            if taken is None:
                return
            if faults.lost or self._random.random() < faults.loss:
                continue
            twist = taken[0]
            frame = limo_base.frame_of(self._base.mode, twist.linear.x, twist.linear.y, twist.angular.z)
            if frame is None:
                continue
            self._base.command(now_s, frame)
            if frame.forward_mps or frame.left_mps or frame.turn_radps:
                self._world.start()

    def _put(self, faults: Modifiers) -> None:
        motion, battery = self._base.motion, self._battery
        code = MOTOR_FAILURE if faults.motor_fail else BATTERY_EMPTY if battery.energy_j <= 0.0 else FINE
        speed = self._speed()
        self._world.put(
            self._row,
            Body(
                position_m=(motion.x_m, motion.y_m, 0.0),
                velocity_mps=(motion.vx_mps, motion.vy_mps, 0.0) if speed > 0.0 else (0.0, 0.0, 0.0),
                quaternion=yaw_quaternion(motion.yaw_rad),
                armed=code == FINE,
                code=code,
                energy_j=battery.energy_j,
                used_j=battery.used_j,
                given_j=battery.given_j,
            ),
        )

    def _speak(self, faults: Modifiers, dt_s: float) -> None:
        wall_ns = time.time_ns()
        stamp = divmod(wall_ns, 1_000_000_000)
        base, odom = self._base, self._odometry
        if self._count % ODOM_EVERY == 0 and self._arrives(faults):
            odom.header.stamp.sec, odom.header.stamp.nanosec = stamp
            at = base.odometry
            odom.pose.pose.position.x, odom.pose.pose.position.y = at.x_m, at.y_m
            *_, odom.pose.pose.orientation.z, odom.pose.pose.orientation.w = yaw_quaternion(at.yaw_rad)
            twist = odom.twist.twist
            twist.linear.x, twist.linear.y, twist.angular.z = base.forward_mps, base.left_mps, base.turn_radps
            self._odom.publish(odom)
        if self._count % IMU_EVERY == 0 and self._arrives(faults):
            imu, noise = self._inertia, self._random.gauss
            imu.header.stamp.sec, imu.header.stamp.nanosec = stamp
            *_, imu.orientation.z, imu.orientation.w = yaw_quaternion(base.odometry.yaw_rad)
            imu.angular_velocity.z = base.turn_radps + noise(0.0, 0.01)
            imu.linear_acceleration.x = (base.forward_mps - self._last_forward) / max(dt_s, 1e-3) + noise(0.0, 0.05)
            imu.linear_acceleration.y = base.forward_mps * base.turn_radps + noise(0.0, 0.05)
            imu.linear_acceleration.z = 9.81 + noise(0.0, 0.05)
            self._imu.publish(imu)
        if self._count % STATUS_EVERY == 0 and self._arrives(faults):
            self._status.publish(encode(self._report(faults, wall_ns)))

    def _report(self, faults: Modifiers, wall_ns: int) -> LimoStatus:
        error = limo_base.MOTOR_1 | limo_base.DRIVE_STATUS if faults.motor_fail else 0
        error |= limo_base.BATTERY_EMPTY if self._battery.energy_j <= 0.0 else 0
        return LimoStatus(
            stamp_ns=wall_ns // 1_000_000_000,  # the real driver's rclcpp::Time(seconds): seconds as nanoseconds
            vehicle_state=2 if error else NORMAL,
            control_mode=COMMANDED,
            battery_v=limo_base.battery_v(self._battery.level, self._speed()),
            error_code=error,
            motion_mode=limo_base.MOTION_MODES[self._base.mode],
        )

    def _arrives(self, faults: Modifiers) -> bool:
        return faults.loss <= 0.0 or self._random.random() >= faults.loss

    def close(self) -> None:
        """Leaves the domain; gives up after ``LEAVE_S``, since Fast DDS may hang when a peer leaves too."""
        leaving = threading.Thread(target=self._leave, daemon=True)
        leaving.start()
        leaving.join(LEAVE_S)

    def _leave(self) -> None:
        with contextlib.suppress(Exception):
            self._node.destroy_node()  # type: ignore[no-untyped-call]
            self._context.try_shutdown()


def serve(
    world: World,
    vehicle: str,
    *,
    mode: Mode = "differential",
    namespace: str = "",
    domain: int | None = None,
    command_timeout_s: float = limo_base.COMMAND_TIMEOUT_S,
    parent: int | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Runs a Limo until ``stop``, or until the process ``parent`` is gone; prints one line when it is ready."""
    stop = stop or threading.Event()
    node = LimoNode(world, vehicle, mode=mode, namespace=namespace, domain=domain, command_timeout_s=command_timeout_s)
    print(f"ready limo {vehicle} {mode} {node.topic} domain {node.domain}", flush=True)
    due_s = look_s = time.monotonic()
    try:
        while not stop.is_set():
            node.turn()
            now_s = time.monotonic()
            if parent is not None and now_s >= look_s:
                look_s = now_s + PARENT_S
                if not Path(f"/proc/{parent}").exists() and not _lives(parent):
                    return
            due_s = max(due_s + STEP_S, now_s)
            stop.wait(due_s - now_s)
    finally:
        node.close()


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def alone(vehicle: str, mode: Mode) -> WorldConfig:
    """A world with nothing in it but one Limo with a charging pad on its roof."""
    del mode  # every mode has the same body
    limo = SimUgv(
        vehicle, vehicle, max_speed_mps=limo_base.TOP_SPEED_MPS, tracking_noise_m=0.005, pad_height_m=0.3,
        dock_offsets_m=((0.0, 0.0),),
    )  # fmt: skip
    return WorldConfig(uavs=(), ugvs=(limo,), scale=0.01, time_scale=0.25)


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m sim_backends.wire.limo_node", description=__doc__)
    parser.add_argument("--world", type=Path, help="folder of the shared world; default: a world of its own")
    parser.add_argument("--vehicle", default="ugv0", help="id of the UGV (default: %(default)s)")
    parser.add_argument("--mode", choices=tuple(limo_base.MOTION_MODES), default="differential")
    parser.add_argument("--namespace", default="", help="before the topics, such as /limo1 (default: none)")
    parser.add_argument("--domain", type=int, help="ROS domain (default: ROS_DOMAIN_ID)")
    parser.add_argument(
        "--command-timeout", type=float, default=limo_base.COMMAND_TIMEOUT_S,
        help="s after which the firmware stops without commands; inf: never (default: %(default)s)",
    )  # fmt: skip
    parser.add_argument("--parent", type=int, help="end when this process does")
    options = parser.parse_args(arguments)
    stop, failed = threading.Event(), list[str]()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())

    def run(world: World) -> None:
        try:
            serve(
                world, options.vehicle, mode=options.mode, namespace=options.namespace, domain=options.domain,
                command_timeout_s=options.command_timeout, parent=options.parent, stop=stop,
            )  # fmt: skip
        except (SimulationError, DriverError) as error:
            failed.append(str(error))
        finally:
            stop.set()

    with contextlib.ExitStack() as stack:
        try:
            if options.world is None:
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="limo-")))
                world = World.create(folder, alone(options.vehicle, options.mode))
            else:
                world = World(options.world)
        except SimulationError as error:
            failed.append(str(error))
        else:
            # not in this thread: whatever ROS waits for, a signal is heard here and ends the process
            running = threading.Thread(target=run, args=(world,), daemon=True)
            running.start()
            stop.wait()
            running.join(LEAVE_S + 0.2)
    for words in failed:
        print(f"limo: {words}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    code = main()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)  # without the libraries' own farewells, which may take longer than a second
