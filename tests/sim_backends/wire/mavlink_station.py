"""A bare ground station on pymavlink's codec, and the vehicles' processes, for tests over real sockets."""

from __future__ import annotations

import contextlib
import math
import os
import selectors
import socket
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import Any

os.environ.setdefault("MAVLINK20", "1")
from pymavlink.dialects.v20 import ardupilotmega as mavlink

NAN = math.nan
COMMAND = [sys.executable, "-m", "sim_backends.wire.mavlink_vehicle"]


class Station:
    """Hears and says; ``pump`` lets it. A heartbeat goes out every second while ``beats``."""

    def __init__(self, *, sysid: int = 255, key: bytes | None = None) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(0.01)
        self.codec = mavlink.MAVLink(None, srcSystem=sysid, srcComponent=190)
        self.codec.robust_parsing = True
        if key is not None:
            self.codec.signing.secret_key = key
            self.codec.signing.sign_outgoing = True
            self.codec.signing.timestamp = int((time.time() - 1_420_070_400) * 1e5)
        self.newest: dict[str, Any] = {}
        self.all: dict[str, list[Any]] = defaultdict(list)
        self.peer: tuple[str, int] | None = None
        self.vehicle: tuple[str, int] | None = None
        self.beats = True
        self.stream: Callable[[], Any] | None = None
        self.streamed_s = 0.0
        self._next_beat_s = self._next_stream_s = 0.0

    @property
    def port(self) -> int:
        return int(self.socket.getsockname()[1])

    def send(self, message: Any) -> None:
        assert self.peer is not None
        data = message.pack(self.codec)
        self.codec.seq = (self.codec.seq + 1) % 256
        self.socket.sendto(data, self.peer)

    def turn(self) -> None:
        now_s = time.monotonic()
        if self.peer is not None and self.beats and now_s >= self._next_beat_s:
            self._next_beat_s = now_s + 1.0
            self.send(mavlink.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
        if self.peer is not None and self.stream is not None and now_s >= self._next_stream_s:
            self._next_stream_s = now_s + 0.05
            self.streamed_s = now_s
            found = self.stream()
            for message in found if isinstance(found, list) else [found]:
                self.send(message)
        try:
            data, address = self.socket.recvfrom(4096)
        except TimeoutError:
            return
        if self.vehicle is not None and address != self.vehicle:
            return  # somebody who believes that another still listens at this port
        self.peer = address
        for message in self.codec.parse_buffer(data) or []:
            self.newest[message.get_type()] = message
            self.all[message.get_type()].append(message)

    def pump(self, seconds: float) -> None:
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.turn()

    def until(self, condition: Callable[[], Any], seconds: float = 30.0) -> None:
        """Pumps until it holds."""
        start_s = time.monotonic()
        while not condition():
            assert time.monotonic() - start_s < seconds, f"it did not happen; {self.texts[-5:]}"
            self.turn()

    @property
    def texts(self) -> list[str]:
        whole: dict[Any, str] = {}
        for i, m in enumerate(self.all["STATUSTEXT"]):
            key = m.id or f"single {i}"
            whole[key] = whole.get(key, "") + m.text
        return list(whole.values())

    @property
    def armed(self) -> bool:
        return bool(self.newest["HEARTBEAT"].base_mode & 128)

    @property
    def mode(self) -> int:
        return int(self.newest["HEARTBEAT"].custom_mode)

    @property
    def ned(self) -> tuple[float, float, float]:
        m = self.newest["LOCAL_POSITION_NED"]
        return (m.x, m.y, m.z)

    def command(self, command: int, *p: float, confirmation: int = 0, wait: bool = True) -> int:
        """COMMAND_LONG and, with ``wait``, its answer."""
        n = len(self.all["COMMAND_ACK"])
        full = (*p, *([0.0] * (7 - len(p))))
        self.send(mavlink.MAVLink_command_long_message(1, 1, command, confirmation, *full))
        if not wait:
            return -1
        self.until(lambda: any(a.command == command for a in self.all["COMMAND_ACK"][n:]))
        return int(next(a for a in self.all["COMMAND_ACK"][n:] if a.command == command).result)

    def insist(self, command: int, *p: float) -> None:
        """The command again and again until it is accepted."""
        end_s = time.monotonic() + 30.0
        while self.command(command, *p) != 0:
            assert time.monotonic() < end_s, f"it is refused; {self.texts[-5:]}"
            self.pump(0.1)

    def velocity(self, n: float, e: float, d: float) -> Any:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b110111000111, 0, 0, 0, n, e, d, 0, 0, 0, 0, 0
        )

    def position(self, n: float, e: float, d: float) -> Any:
        return mavlink.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, 1, 0b110111111000, n, e, d, 0, 0, 0, 0, 0, 0, 0, 0
        )

    def close(self) -> None:
        self.socket.close()


@contextlib.contextmanager
def process(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A vehicle's process that says it is ready."""
    child = subprocess.Popen(
        [*COMMAND, *arguments, "--parent", str(os.getpid())], stdout=subprocess.PIPE, text=True, bufsize=1
    )
    try:
        assert child.stdout is not None
        selector = selectors.DefaultSelector()
        selector.register(child.stdout, selectors.EVENT_READ)
        assert selector.select(60.0), "the vehicle did not get ready"
        line = child.stdout.readline()
        assert line.startswith("ready "), line
        child.ready = line  # type: ignore[attr-defined]
        yield child
    finally:
        child.terminate()
        try:
            child.wait(10.0)
        finally:
            child.kill()


@contextlib.contextmanager
def flying(*arguments: str, key: bytes | None = None, sysid: int = 255) -> Iterator[Station]:
    """A vehicle that a station hears."""
    station = Station(key=key, sysid=sysid)
    try:
        with process("--out", f"127.0.0.1:{station.port}", *arguments) as child:
            words = child.ready.split()  # type: ignore[attr-defined]
            station.vehicle = ("127.0.0.1", int(words[words.index("udp") + 1]))
            station.until(lambda: "HEARTBEAT" in station.newest)
            yield station
    finally:
        station.close()
