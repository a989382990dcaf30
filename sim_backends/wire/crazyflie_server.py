"""A simulated Crazyflie as its own process: speaks CRTP over UDP as cflib's ``udp://host:port`` link expects.

Alone, in a temporary world of its own, so that cfclient or a script can talk to it at ``udp://127.0.0.1:19850``::

    python -m sim_backends.wire.crazyflie_server --port 19850

or as one vehicle of a shared world::

    python -m sim_backends.wire.crazyflie_server --world FOLDER --vehicle uav0 --port 19851 --variant brushless

Nobody feeds it poses when it is alone, so its estimate drifts as the real one's does: send ``cf.extpos`` packets, or
give ``--feed`` to let it see itself.

Answers go to who asked. What it says by itself (log data, console) goes to the client that opened its session last, so
that a second process may send packets (a watchdog, say) without stealing the stream.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import random
import select
import signal
import socket
import sys
import tempfile
import threading
import time
from pathlib import Path

from sim_backends.errors import SimulationError
from sim_backends.wire.crazyflie_firmware import PROTOCOLS, STEP_S, CrazyflieKind, Firmware
from sim_backends.wire.crazyflie_logs import RESET, SETTINGS
from sim_backends.wire.crtp_packets import NULL, Packet, Port, decode
from sim_backends.wire.world import World
from sim_backends.world import SimUav, WorldConfig

Address = tuple[str, int]

BACKLOG_S = 0.5
"""A process that was held up for longer leaves out the rest: the world goes on without it."""
BURST = 64
"""Packets taken at once before a step is due."""
PARENT_S = 0.5


def serve(
    world: World,
    vehicle: str,
    sock: socket.socket,
    kind: CrazyflieKind | None = None,
    *,
    stop: threading.Event | None = None,
    parent: int | None = None,
    feed: bool = False,
) -> None:
    """Flies one Crazyflie until it is told to stop.

    Args:
        world: the shared world.
        vehicle: which of its UAVs.
        sock: bound UDP socket; is closed at the end.
        kind: which Crazyflie it is.
        stop: ends it.
        parent: process that must stay alive.
        feed: it sees itself as if motion capture fed it.

    Raises:
        SimulationError: when the world has no such UAV.
    """
    with contextlib.closing(sock):
        CrazyflieServer(world, vehicle, sock, kind or CrazyflieKind(), feed=feed).run(stop or threading.Event(), parent)


class CrazyflieServer:
    """The link of one firmware (addresses, losses, silence) and the loop that lets its time pass."""

    def __init__(
        self, world: World, vehicle: str, sock: socket.socket, kind: CrazyflieKind, *, feed: bool = False
    ) -> None:
        """Takes over a UAV; see ``serve``."""
        row = world.row(vehicle)
        if not world.is_uav(row):
            raise SimulationError(f"{vehicle!r} is a UGV; a Crazyflie server needs a UAV")
        self._firmware, self._sock, self._feed = Firmware(world, row, kind), sock, feed
        sock.setblocking(False)
        self._owner: Address | None = None
        self._random = random.Random(7919 * world.config.seed + row)

    def run(self, stop: threading.Event, parent: int | None = None) -> None:
        """Runs in real time until ``stop`` is set or the process ``parent`` has gone."""
        begun = time.monotonic()
        done, watched_s, born_of = 0, begun, os.getppid()
        while not stop.is_set():
            now_s = time.monotonic()
            wait_s = begun + (done + 1) * STEP_S - now_s
            if wait_s > 0.0:
                if select.select((self._sock,), (), (), wait_s)[0]:
                    self.receive()
                continue
            if -wait_s > BACKLOG_S:
                done += int(-wait_s / STEP_S)
            self.step()
            done += 1
            if now_s - watched_s > PARENT_S:
                watched_s = now_s
                if parent is not None and _gone(parent, born_of):
                    return

    def receive(self) -> None:
        """Takes what has arrived."""
        for _ in range(BURST):
            try:
                datagram, sender = self._sock.recvfrom(2048)
            except OSError:
                return  # nothing more, or word that a client has gone
            self._take(datagram, sender)

    def _take(self, datagram: bytes, sender: Address) -> None:
        packet = decode(datagram)
        faults = self._firmware.body.faults
        if packet is None or faults.lost or self._random.random() < faults.loss:
            return
        if datagram == bytes((NULL,)):
            self._send(Packet(Port.LINK, 3), sender)  # a scan, or a client that keeps the link busy
            return
        opens = packet.port == Port.LINK and packet.channel == 1
        logs = packet.port == Port.LOG and packet.channel == SETTINGS and packet.data[:1] != bytes((RESET,))
        if self._owner is None or opens or logs:
            self._owner = sender
        for answer in self._firmware.handle(packet):
            self._send(answer, sender)

    def step(self) -> None:
        """Lets one step pass and sends what the Crazyflie says by itself."""
        firmware = self._firmware
        if self._feed:
            body = firmware.body
            firmware.estimator.pose(body.position_m, body.rpy[2], body.position_m, body.rpy[2], 0.01)
        said = firmware.step()
        if self._owner is not None:
            for packet in (*said, *firmware.printed()):
                self._send(packet, self._owner)

    def _send(self, packet: Packet, to: Address) -> None:
        faults = self._firmware.body.faults
        if faults.lost or faults.silent or self._random.random() < faults.loss:
            return
        with contextlib.suppress(OSError):  # an address that cannot be reached is the radio's void
            self._sock.sendto(packet.encode(), to)


def _gone(pid: int, born_of: int) -> bool:
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


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="crazyflie_server", description=__doc__.split("\n", 1)[0])
    parser.add_argument("--world", type=Path, help="folder of the shared world (default: a temporary one of its own)")
    parser.add_argument("--vehicle", default="uav0", help="id of the UAV in that world")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument("--port", type=int, default=19850, help="UDP port, 0 for any free one")
    parser.add_argument("--variant", default="brushed", help="brushed (arms itself) or brushless (must be armed)")
    parser.add_argument("--protocol", type=int, default=12, help=f"CRTP version, {PROTOCOLS[0]} to {PROTOCOLS[-1]}")
    parser.add_argument("--without", default="", help="log groups to leave out, such as pm,radio")
    parser.add_argument("--clock-rate", type=float, default=1.0, help="firmware seconds per second, such as 0.97")
    parser.add_argument("--address", type=lambda text: int(text, 0), default=0xE7, help="last byte of its address")
    parser.add_argument("--feed", action="store_true", help="let it see itself, as if motion capture fed it")
    parser.add_argument("--parent", type=int, help="end when this process ends")
    return parser.parse_args(argv)


def _bound(host: str, port: int) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        sock.bind((host, port))
    except (OSError, OverflowError) as error:
        sock.close()
        raise SimulationError(
            f"cannot listen on {host}:{port}: {error}; give another --port, or an address of this computer as --host"
        ) from error
    return sock


def main(argv: list[str] | None = None) -> int:
    """Entry point of the process; returns its exit code."""
    args = _arguments(argv)
    stop = threading.Event()
    for name in (signal.SIGTERM, signal.SIGINT):
        signal.signal(name, lambda *_: stop.set())
    with contextlib.ExitStack() as stack:
        try:
            without = tuple(filter(None, args.without.split(",")))
            kind = CrazyflieKind(args.variant, args.protocol, without, args.clock_rate, args.address)
            if args.world is None:
                config = WorldConfig((SimUav(args.vehicle, args.vehicle, tracking_noise_m=0.01),), (), step_s=0.02)
                folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="crazyflie-")))
                world = World.create(folder, config)
            else:
                world = World(args.world)
            sock = stack.enter_context(contextlib.closing(_bound(args.host, args.port)))
            server = CrazyflieServer(world, args.vehicle, sock, kind, feed=args.feed)
        except SimulationError as error:
            print(f"crazyflie_server: {error}", file=sys.stderr)
            return 2
        print(f"ready udp://{args.host}:{sock.getsockname()[1]}", flush=True)
        server.run(stop, args.parent)
    return 0


if __name__ == "__main__":
    sys.exit(main())
