"""A simulated OptiTrack system: a NatNet server, as Motive is one, that streams every body of a world.

``python -m sim_backends.wire.natnet_server --world FOLDER`` serves the shared world; without a world it shows the
bodies named with ``--body``, standing still. Any NatNet client can connect: libmotioncapture, the NatNet SDK, ROS.
"""

from __future__ import annotations

import argparse
import contextlib
import ipaddress
import os
import select
import signal
import socket
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from sim_backends.errors import SimulationError
from sim_backends.wire import natnet_packets as natnet
from sim_backends.wire.cameras import Cameras
from sim_backends.wire.natnet_clients import Address, Clients
from sim_backends.wire.world import World
from sim_backends.world import SimUav, WorldConfig

COMMAND_PORT, DATA_PORT = 1510, 1511
"""Motive's defaults."""
_PARENT_S = 0.5
_LATE_S = 0.1  # after a pause (a stopped process) the frames missed are not made up for


@dataclass(frozen=True, slots=True)
class NatNetSettings:
    """How the server streams; validates itself.

    Attributes:
        address: of the interface it serves on; 0.0.0.0 for all.
        command_port: where clients ask; 0 for any free one.
        data_port: where clients listen; 0: a free port for each client.
        rate_hz: frames per second; None: as the world says.
        version: of NatNet: (4, 1) as Motive 3.1, (3, 1) as Motive 2.
        up: Motive's "Up Axis"; Motive itself defaults to y, labs that fly set z.
        group: multicast address; None streams by unicast.
    """

    address: str = "127.0.0.1"
    command_port: int = COMMAND_PORT
    data_port: int = DATA_PORT
    rate_hz: float | None = None
    version: natnet.Version = (4, 1)
    up: natnet.Up = "z"
    group: str | None = None

    def __post_init__(self) -> None:
        for name, text in (("address", self.address), ("group", self.group or "239.255.42.99")):
            try:
                number = ipaddress.IPv4Address(text)
            except ValueError:
                raise SimulationError(f"NatNet server: {name} is {text!r}; give a numeric IPv4 address") from None
            if name == "group" and not number.is_multicast:
                raise SimulationError(f"NatNet server: group is {text}; give a multicast address such as 239.255.42.99")
        for name, port in (("command_port", self.command_port), ("data_port", self.data_port)):
            if not 0 <= port <= 65535:
                raise SimulationError(f"NatNet server: {name} is {port}; give 0 to 65535")
        if self.group is not None and self.data_port == 0:
            raise SimulationError("NatNet server: multicast needs one data port for all; give a data_port")
        if self.rate_hz is not None and not 0 < self.rate_hz <= 1000:
            raise SimulationError(f"NatNet server: rate_hz is {self.rate_hz}; give a number above 0, at most 1000")
        if self.version not in natnet.VERSIONS:
            raise SimulationError(f"NatNet server: version is {self.version}; give one of {natnet.VERSIONS}")


class NatNetServer:
    """Answers requests and streams frames, in one thread.

    Raises:
        SimulationError: when the command port cannot be opened.
    """

    def __init__(self, world: World, settings: NatNetSettings) -> None:
        self._settings = settings
        self._names = [vehicle.body for vehicle in world.config.vehicles]
        rate_hz = settings.rate_hz or world.config.pose_rate_hz
        self._period_s = 1.0 / rate_hz
        self._latency_s = world.config.pose_latency_s
        self._cameras = Cameras(world, rate_hz)
        self._clients = Clients(settings.address, settings.data_port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((settings.address, settings.command_port))
        except OSError as error:
            self._socket.close()
            where = f"{settings.address}:{settings.command_port}"
            raise SimulationError(
                f"NatNet server: cannot serve on {where} ({error.strerror}); stop what uses it or give another port"
            ) from None
        self._socket.setblocking(False)
        self._group = self._open_group()
        self._waiting: deque[tuple[float, int, float, list[natnet.Seen]]] = deque()
        self._number = 0

    @property
    def address(self) -> Address:
        """Where clients ask."""
        host, port = self._socket.getsockname()
        return (str(host), int(port))

    def run(self, stop: threading.Event, parent: int | None = None) -> None:
        """Serves until ``stop`` is set or the process ``parent`` has ended."""
        due_s = looked_s = time.monotonic()
        while not stop.is_set():
            now_s = time.monotonic()
            if now_s - due_s > _LATE_S:
                due_s = now_s
            if now_s >= due_s:
                due_s += self._period_s
                self._number += 1
                self._waiting.append((now_s + self._latency_s, self._number, now_s, self._cameras.look(now_s)))
            while self._waiting and self._waiting[0][0] <= now_s:
                self._send(now_s)
            if parent is not None and now_s - looked_s > _PARENT_S:
                looked_s = now_s
                if not _alive(parent):
                    return
            next_s = min(due_s, self._waiting[0][0]) if self._waiting else due_s
            wait_s = min(max(0.0, next_s - time.monotonic()), 0.2)
            if select.select([self._socket], [], [], wait_s)[0]:
                self._answer()

    def close(self) -> None:
        """Releases every socket."""
        self._clients.close()
        self._socket.close()
        if self._group is not None:
            self._group.close()

    def _send(self, now_s: float) -> None:
        settings = self._settings
        _, number, seen_s, bodies = self._waiting.popleft()
        if self._group is None and len(self._clients) == 0:
            return
        packet = natnet.frame(settings.version, number, bodies, seen_s, now_s, settings.up)
        if self._group is None:
            self._clients.send(packet, now_s)
        else:
            with contextlib.suppress(OSError):  # a frame is lost, as on any network
                self._group.sendto(packet, (settings.group, settings.data_port))

    def _answer(self) -> None:
        with contextlib.suppress(OSError):  # the asker has gone; a lost answer is asked for again
            datagram, sender = self._socket.recvfrom(65535)
            kind = natnet.message_of(datagram)
            if kind == natnet.CONNECT:
                port = self._settings.data_port
                if self._group is None:
                    port = self._clients.meet(sender, time.monotonic())
                info = natnet.server_info(self._settings.version, port, self._settings.group)
                self._socket.sendto(info, sender)
            elif kind == natnet.REQUEST_MODEL:
                self._socket.sendto(natnet.model(self._settings.version, self._names), sender)
                self._clients.begin(sender)
            elif kind == natnet.DISCONNECT:
                self._clients.leave(sender)
            elif kind in (natnet.REQUEST, natnet.REQUEST_FRAME):  # Motive's remote control, which is not simulated
                self._socket.sendto(natnet.packet(natnet.UNRECOGNIZED), sender)

    def _open_group(self) -> socket.socket | None:
        if self._settings.group is None:
            return None
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        interface = socket.inet_aton(self._settings.address)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, interface)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 1)
        return sender


def _alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def serve(world: World, settings: NatNetSettings, stop: threading.Event, parent: int | None = None) -> None:
    """Serves a world until ``stop`` is set; says ``ready`` on standard output when it accepts clients."""
    server = NatNetServer(world, settings)
    try:
        host, port = server.address
        print(f"ready natnet {host}:{port}", flush=True)
        server.run(stop, parent)
    finally:
        server.close()


def _standing(folder: Path, names: Sequence[str]) -> World:
    """A world in which nothing moves, a metre between the bodies."""
    uavs = tuple(SimUav(name, name, start_m=(float(i), 0.0)) for i, name in enumerate(names))
    return World.create(folder, WorldConfig(uavs=uavs, ugvs=(), pose_noise_m=0.0005, pose_noise_rad=0.002))


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(prog="natnet_server", description="A simulated OptiTrack (NatNet) server.")
    parser.add_argument("--world", type=Path, metavar="FOLDER", help="folder of the simulated world")
    parser.add_argument("--body", action="append", default=[], metavar="NAME", help="without a world: a body to show")
    parser.add_argument("--address", default="127.0.0.1", help="numeric address to serve on (127.0.0.1)")
    parser.add_argument("--command-port", type=int, default=COMMAND_PORT, metavar="N", help="default 1510; 0: any")
    parser.add_argument("--data-port", type=int, default=DATA_PORT, metavar="N", help="default 1511; 0: any")
    parser.add_argument("--rate", type=float, metavar="HZ", help="frames per second (default: as the world says)")
    parser.add_argument("--natnet", choices=("3.1", "4.1"), default="4.1", help="version of the protocol")
    parser.add_argument("--up", choices=("y", "z"), default="z", help="axis that points up in the stream")
    parser.add_argument("--multicast", metavar="GROUP", help="stream to this group instead of to each client")
    parser.add_argument("--parent", type=int, metavar="PID", help="end when this process ends")
    options = parser.parse_args(arguments)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        settings = NatNetSettings(
            address=options.address,
            command_port=options.command_port,
            data_port=options.data_port,
            rate_hz=options.rate,
            version=(int(options.natnet[0]), int(options.natnet[2])),
            up=options.up,
            group=options.multicast,
        )
        if options.world is not None:
            serve(World(options.world), settings, stop, options.parent)
            return 0
        with tempfile.TemporaryDirectory(prefix="natnet-") as folder:
            serve(_standing(Path(folder), options.body or ["body1"]), settings, stop, options.parent)
    except SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
