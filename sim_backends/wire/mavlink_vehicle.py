"""A simulated MAVLink copter or rover as its own process: ``python -m sim_backends.wire.mavlink_vehicle --help``.

It speaks MAVLink 2 as PX4 or ArduPilot do, moves its body in the shared world and obeys the faults there. Without
``--world`` it makes a world of its own, so that QGroundControl, MAVSDK or anybody's script can fly it.
"""

from __future__ import annotations

import argparse
import ipaddress
import math
import os
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

from drivers.geodesy import GeoFrame
from sim_backends.errors import SimulationError
from sim_backends.wire.mavlink_ardupilot import ArduPilot
from sim_backends.wire.mavlink_autopilot import Autopilot, VehicleType
from sim_backends.wire.mavlink_commands import Commands
from sim_backends.wire.mavlink_estimate import Estimate, Quality, Source
from sim_backends.wire.mavlink_guidance import Sense
from sim_backends.wire.mavlink_link import Address, Link, mavlink, parse_key
from sim_backends.wire.mavlink_options import ZURICH, AutopilotName, VehicleOptions, build_params
from sim_backends.wire.mavlink_px4 import Px4
from sim_backends.wire.mavlink_setpoints import Globe
from sim_backends.wire.mavlink_streams import MAKERS, PX4_RATES_HZ, Streams, View
from sim_backends.wire.mavlink_world import CopterInWorld, RoverInWorld
from sim_backends.wire.world import World
from sim_backends.world import SimUav, SimUgv, WorldConfig

TURN_S = 0.02
LONGEST_TURN_S = 0.1
"""A machine that stalls for longer slows the vehicle down rather than making it jump."""
PARENT_S = 0.2
"""Period in which it looks for its parent."""
TEXT_LENGTH = 50
ARDUPILOT_VISION_S = 7.0
"""EKF3 gives a position up so long after its last aid (``posRetryTimeNoVel_ms``)."""


class MavlinkVehicle:
    """One vehicle: wire, autopilot, estimate and body."""

    def __init__(self, world: World, vehicle: str, options: VehicleOptions) -> None:
        """Switches it on.

        Raises:
            SimulationError: when there is no such vehicle, a port is taken or a parameter does not exist.
        """
        self._world, self._row, self._options = world, world.row(vehicle), options
        self.kind: VehicleType = "copter" if world.is_uav(self._row) else "rover"
        self._boot_s = self._before_s = time.monotonic()
        self._body: CopterInWorld | RoverInWorld = (
            CopterInWorld(world, self._row)
            if self.kind == "copter"
            else RoverInWorld(world, self._row, options.turn_radius_m)
        )
        self._params = build_params(options, self.kind, self._body.limits)
        self.link = Link(
            options.sysid, host=options.host, port=options.port, outs=options.outs, tcp_port=options.tcp_port,
            key=options.key, seed=world.config.seed,
        )  # fmt: skip
        self._text_id = 0
        self._boot()

    def _boot(self) -> None:
        options, config = self._options, self._world.config
        px4 = options.autopilot == "px4"
        drift = config.uavs[self._row].drift_mps if self.kind == "copter" else 0.1
        timeout_s = self._params["EKF2_NOAID_TOUT"] * 1e-6 if px4 else ARDUPILOT_VISION_S
        quality = Quality(options.noise_m, timeout_s, drift, config.estimate_mps)
        allows = "EKF2_EV_CTRL" if px4 else "VISO_TYPE"
        seed = f"estimate {config.seed} {self._row}"
        self._estimate = Estimate(
            options.source, options.frame, self._body.position, quality, seed, lambda: self._params[allows] != 0
        )
        build = Px4 if px4 else ArduPilot
        self.autopilot: Autopilot = build(self.kind, self._params, self._body.limits, self._globe())
        self._streams = Streams(PX4_RATES_HZ if px4 else {})
        self._commands = Commands(self.autopilot, self._streams, self.link.send, self._reboot)
        self._rebooting = False
        self._sense = Sense(time.monotonic())

    def _reboot(self) -> None:
        self._rebooting = True

    def _globe(self) -> Globe:
        altitude = self._options.altitude_m
        if self._options.source == "gps":
            altitude += self._body.position[2]
        return Globe(self._estimate.to_ned if self._estimate.local is not None else None, altitude, altitude)

    def turn(self) -> None:
        """One turn: hear, think, move, tell."""
        now_s = time.monotonic()
        dt = min(now_s - self._before_s, LONGEST_TURN_S)
        self._before_s = now_s
        faults = self._world.modifiers(self._row)
        self.link.faults = faults
        body, estimate = self._body, self._estimate
        for message in self.link.receive():
            self._hear(message, now_s)
        estimate.step(now_s, dt, body.position, body.velocity, body.yaw)
        self._sense = Sense(
            now_s=now_s, ned=estimate.ned, velocity=estimate.velocity, yaw=estimate.yaw, contact=body.contact,
            pushing=body.pushing, position_ok=estimate.position_ok, global_ok=estimate.global_ok,
            battery=body.battery, tumbled=body.tumbled,
        )  # fmt: skip
        wish = self.autopilot.step(self._sense)
        body.step(now_s, dt, wish, self._sense, estimate, faults)
        body.put(self.autopilot)
        if self.autopilot.started:
            self._world.start()
        self._commands.step(now_s)
        self._tell(now_s)
        if self._rebooting:
            self._body.reset()
            self._boot()

    def _hear(self, message: Any, now_s: float) -> None:
        if self._commands.handle(message, self._sense):
            return
        match message.get_type():
            case "HEARTBEAT":
                # PX4 looks for a ground station, ArduPilot for the one it was told
                if message.type == mavlink.MAV_TYPE_GCS or not self._params.bytewise:
                    self.autopilot.heard_gcs(message.get_srcSystem(), now_s)
            case "VISION_POSITION_ESTIMATE" | "VICON_POSITION_ESTIMATE":
                self._pose(now_s, (message.x, message.y, message.z), message.yaw)
            case "ODOMETRY" | "ATT_POS_MOCAP":
                w, x, y, z = message.q
                yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
                self._pose(now_s, (message.x, message.y, message.z), yaw)
            case "SET_GPS_GLOBAL_ORIGIN":
                if self._estimate.set_origin(message.latitude / 1e7, message.longitude / 1e7):
                    altitude = message.altitude / 1000.0
                    self.autopilot.globe = Globe(self._estimate.to_ned, altitude, altitude)
            case "TIMESYNC":
                if message.tc1 == 0:
                    self.link.send(mavlink.MAVLink_timesync_message(time.monotonic_ns(), message.ts1))
            case "PING":
                if message.target_system == 0:
                    self.link.send(
                        mavlink.MAVLink_ping_message(
                            message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
                        )
                    )

    def _pose(self, now_s: float, ned: tuple[float, float, float], yaw: float) -> None:
        self._estimate.pose(now_s, ned, yaw, self._body.yaw)

    def _tell(self, now_s: float) -> None:
        due = [*self._streams.due(now_s), *self._commands.wanted()]
        if due:
            view = View(
                self._sense, self.autopilot, self._estimate, round(1000 * (now_s - self._boot_s)),
                round(time.time() * 1e6), self._body.charging, self._body.tilt, self._options.source,
                self._options.noise_m,
            )  # fmt: skip
            for number in due:
                message = MAKERS[number](view)
                if message is not None:
                    self.link.send(message)
        for severity, text in self.autopilot.said:
            self._say(severity, text)
        self.autopilot.said.clear()

    def _say(self, severity: int, text: str) -> None:
        data = text.encode("ascii", "replace")
        chunks = [data[i : i + TEXT_LENGTH] for i in range(0, len(data), TEXT_LENGTH)]
        self._text_id = self._text_id % 65535 + 1
        for i, chunk in enumerate(chunks):
            number = self._text_id if len(chunks) > 1 else 0
            self.link.send(mavlink.MAVLink_statustext_message(severity, chunk, number, i))

    def close(self) -> None:
        """Switches it off."""
        self.link.close()


def serve(
    world: World,
    vehicle: str,
    options: VehicleOptions | None = None,
    *,
    stop: threading.Event | None = None,
    parent: int | None = None,
    ready: bool = False,
) -> None:
    """Runs a vehicle until ``stop`` is set or its parent is gone.

    Args:
        world: the shared world.
        vehicle: whose body it moves.
        options: how it is.
        stop: ends it.
        parent: process that it does not outlive.
        ready: print a line once it can be talked to.
    """
    stop, born_of = stop or threading.Event(), os.getppid()
    craft = MavlinkVehicle(world, vehicle, options or VehicleOptions(port=0))
    try:
        if ready:
            tcp = "" if craft.link.tcp_port is None else f" tcp {craft.link.tcp_port}"
            sysid = (options or VehicleOptions(port=0)).sysid
            print(f"ready {vehicle} mavlink udp {craft.link.port}{tcp} sysid {sysid}", flush=True)
        next_s = looked_s = time.monotonic()
        while not stop.is_set():
            craft.turn()
            next_s = max(next_s + TURN_S, time.monotonic() - LONGEST_TURN_S)
            craft.link.wait(next_s - time.monotonic())
            if parent is not None and next_s - looked_s >= PARENT_S:
                looked_s = next_s
                if gone(parent, born_of):
                    return
    finally:
        craft.close()


def gone(pid: int, born_of: int) -> bool:
    """Whether a process has ended; an own parent that nobody has buried yet counts as ended."""
    if pid == born_of:
        return os.getppid() != pid
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:
        return False
    return False


def _address(text: str) -> Address:
    host, _, port = text.rpartition(":")
    if not host or not port.isdigit():
        raise argparse.ArgumentTypeError(f"{text!r} is not HOST:PORT")
    try:
        # once, not with every packet
        return (socket.gethostbyname(host), int(port))
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{host!r} is unknown: {error}") from error


def _origin(text: str) -> GeoFrame:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3, 5):
        raise argparse.ArgumentTypeError(f"{text!r} is not LAT,LON[,ROTATION_DEG[,X,Y]]")
    origin_m = (numbers[3], numbers[4]) if len(numbers) == 5 else (0.0, 0.0)
    return GeoFrame(numbers[0], numbers[1], math.radians(numbers[2]) if len(numbers) > 2 else 0.0, origin_m)


def _param(text: str) -> tuple[str, float]:
    name, _, value = text.partition("=")
    try:
        return (name, float(value))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is not NAME=NUMBER") from None


def parser() -> argparse.ArgumentParser:
    """The command line."""
    p = argparse.ArgumentParser(prog="python -m sim_backends.wire.mavlink_vehicle", description=__doc__)
    p.add_argument("--world", type=Path, help="folder of the shared world; without it the vehicle is alone")
    p.add_argument("--vehicle", help="id of the vehicle in the world")
    p.add_argument("--type", choices=("copter", "rover"), default="copter", help="when it is alone")
    p.add_argument("--autopilot", choices=("px4", "ardupilot"), default="px4")
    p.add_argument("--sysid", type=int, default=1)
    p.add_argument("--host", help="address to listen on; default: this computer alone, unless --out is another")
    p.add_argument("--port", type=int, help="UDP port to listen on; 0: any")
    p.add_argument("--out", type=_address, action="append", default=[], help="HOST:PORT to send to; may be repeated")
    p.add_argument("--tcp", type=int, help="port of a TCP server")
    p.add_argument("--signing-key", help="64 hex digits; MAVLINK_SIGNING_KEY in the environment is kept out of ps")
    p.add_argument("--position", choices=("gps", "vision"), help="default: gps; in a world without --origin: vision")
    p.add_argument("--origin", type=_origin, help="LAT,LON[,ROTATION_DEG[,X,Y]] of the arena, deg, m")
    p.add_argument("--altitude", type=float, default=488.0, help="m of the floor above the sea")
    p.add_argument("--gps-noise", type=float, default=0.02, help="m")
    p.add_argument("--turn-radius", type=float, default=0.0, help="m, of a rover; 0 turns on the spot")
    p.add_argument("--param", type=_param, action="append", default=[], help="NAME=NUMBER; may be repeated")
    p.add_argument("--parent", type=int, help="process id without which it ends")
    return p


def main(arguments: Sequence[str] | None = None) -> int:
    """The process."""
    args = parser().parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        if args.world is not None and args.vehicle is None:
            raise SimulationError("--world needs --vehicle: which body is it?")
        key = args.signing_key or os.environ.get("MAVLINK_SIGNING_KEY")
        here = all(ipaddress.ip_address(host).is_loopback for host, _ in args.out)
        host = args.host or ("127.0.0.1" if here else "0.0.0.0")
        # indoors nobody gives an origin
        source = args.position or ("vision" if args.world is not None and args.origin is None else "gps")
        options = VehicleOptions(
            autopilot=cast(AutopilotName, args.autopilot), sysid=args.sysid, host=host, port=args.port,
            outs=tuple(args.out), tcp_port=args.tcp, key=None if not key else parse_key(key),
            source=cast(Source, source), frame=args.origin or ZURICH, altitude_m=args.altitude, noise_m=args.gps_noise,
            turn_radius_m=args.turn_radius, params=tuple(args.param),
        )  # fmt: skip
        if args.world is not None:
            serve(World(args.world), args.vehicle, options, stop=stop, parent=args.parent, ready=True)
            return 0
        vehicle = args.vehicle or f"{args.type}{args.sysid}"
        with tempfile.TemporaryDirectory(prefix="mavlink-world-") as folder:
            world = World.create(Path(folder), alone(vehicle, args.type))
            serve(world, vehicle, options, stop=stop, parent=args.parent, ready=True)
    except SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def alone(vehicle: str, kind: VehicleType) -> WorldConfig:
    """A world of one."""
    uavs = (SimUav(vehicle, vehicle),) if kind == "copter" else ()
    ugvs = (SimUgv(vehicle, vehicle, max_speed_mps=3.0),) if kind == "rover" else ()
    return WorldConfig(uavs=uavs, ugvs=ugvs, step_s=0.02)


if __name__ == "__main__":
    sys.exit(main())
