"""The wires that MAVLink travels on: UDP in and out, TCP, serial. None of them ever blocks once it is open."""

from __future__ import annotations

import contextlib
import os
import socket
import termios
import time
from collections.abc import Callable
from typing import Any, Protocol

from drivers.errors import DriverError

Peer = tuple[str, int] | None
FORMS = "udpin:ADDRESS:PORT, udpout:HOST:PORT, tcp:HOST:PORT, /dev/tty..., or /dev/tty...:BAUD"
RETRY_S = 1.0


class Wire(Protocol):
    """Bytes to and from vehicles."""

    def fileno(self) -> int:
        """For select; -1 while it is broken."""
        ...

    def receive(self) -> list[tuple[bytes, Peer]]:
        """Everything that has arrived, with its sender where there are several."""
        ...

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        """Sends, or drops what the wire does not take now; what is urgent goes ahead of what waits."""
        ...

    def close(self) -> None:
        """Releases it."""
        ...


def open_wire(endpoint: str, baud: int, timeout_s: float) -> Wire:
    """Opens an endpoint.

    Args:
        endpoint: one of ``FORMS``.
        baud: of a serial endpoint that names none.
        timeout_s: for the opening.

    Raises:
        DriverError: naming the endpoint, the cause and the remedy.
    """
    scheme, _, rest = endpoint.partition(":")
    try:
        if endpoint.startswith("/") or scheme.upper().startswith("COM"):
            device, _, rate = endpoint.partition(":")
            return _Serial(device, int(rate) if rate else baud)
        host, _, port = rest.rpartition(":")
        if scheme in ("udpin", "udpout", "tcp") and host and port:
            if scheme == "udpin":
                return _UdpIn(host, int(port))
            return _UdpOut(host, int(port)) if scheme == "udpout" else _Tcp(host, int(port), timeout_s)
    except (OSError, ValueError) as error:
        raise DriverError(f"MAVLink endpoint {endpoint}: {error}; {_remedy(scheme)}") from error
    raise DriverError(f"MAVLink endpoint {endpoint!r} is not understood; give {FORMS}")


def _remedy(scheme: str) -> str:
    if scheme == "udpin":
        return "give an address of this computer and a port that no other ground station uses"
    if scheme in ("udpout", "tcp"):
        return "check host and port and that the vehicle or its router is switched on"
    return "check the cable, the device's name and your membership of the group dialout"


class _UdpIn:
    """Vehicles send here; each is answered where it was heard."""

    def __init__(self, host: str, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, port))
        except OSError:
            self._socket.close()
            raise
        self._socket.setblocking(False)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> list[tuple[bytes, Peer]]:
        found: list[tuple[bytes, Peer]] = []
        while True:
            try:
                data, peer = self._socket.recvfrom(65535)
            except ConnectionError:
                continue  # an answer of a vehicle that has gone
            except OSError:
                return found
            found.append((data, (peer[0], peer[1])))

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        if peer is None:
            return
        try:
            self._socket.sendto(data, peer)
        except OSError:
            return  # lost, as datagrams are

    def close(self) -> None:
        self._socket.close()


class _UdpOut:
    """One vehicle or router that waits to be talked to."""

    def __init__(self, host: str, port: int) -> None:
        self._address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.bind(("", 0))

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> list[tuple[bytes, Peer]]:
        found: list[tuple[bytes, Peer]] = []
        while True:
            try:
                found.append((self._socket.recv(65535), None))
            except ConnectionError:
                continue
            except OSError:
                return found

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        try:
            self._socket.sendto(data, self._address)
        except OSError:
            return

    def close(self) -> None:
        self._socket.close()


class _Tcp:
    """A stream to a router or a simulator; a broken one is opened again."""

    def __init__(self, host: str, port: int, timeout_s: float) -> None:
        self._address = (host, port)
        self._retry_s = 0.0
        self._socket: socket.socket | None = self._ready(socket.create_connection(self._address, timeout_s))

    @staticmethod
    def _ready(made: socket.socket) -> socket.socket:
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        made.setblocking(False)
        return made

    def fileno(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    def receive(self) -> list[tuple[bytes, Peer]]:
        if self._socket is None:
            self._reopen()
            return []
        found: list[tuple[bytes, Peer]] = []
        while True:
            try:
                data = self._socket.recv(65535)
            except BlockingIOError:
                return found
            except OSError:
                data = b""
            if not data:
                self._broken()
                return found
            found.append((data, None))

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        if self._socket is None:
            return
        try:
            if self._socket.send(data) < len(data):
                self._broken()  # half a packet is out: start anew rather than send rubbish
        except BlockingIOError:
            return
        except OSError:
            self._broken()

    def _broken(self) -> None:
        self.close()
        self._retry_s = time.monotonic() + RETRY_S

    def _reopen(self) -> None:
        if time.monotonic() < self._retry_s:
            return
        try:
            # on a network that swallows packets this takes its time: kept short, all else waits for it
            self._socket = self._ready(socket.create_connection(self._address, 0.2))
        except OSError:
            self._retry_s = time.monotonic() + RETRY_S

    def close(self) -> None:
        if self._socket is not None:
            self._socket.close()
            self._socket = None


class _Serial:
    """A telemetry radio or a cable; one that was unplugged is opened again."""

    def __init__(self, device: str, baud: int) -> None:
        try:
            import serial  # type: ignore[import-untyped]  # noqa: PLC0415  only serial endpoints need it
        except ImportError as error:
            raise OSError("the package pyserial is missing (pip install pyserial)") from error
        self._open: Callable[[], Any] = lambda: serial.Serial(device, baud, timeout=0, exclusive=True)
        self._port: Any = self._open()
        self._retry_s = 0.0
        self._tail = b""
        self._longest = 0
        self._urgent = False

    def fileno(self) -> int:
        return -1 if self._port is None else int(self._port.fileno())

    def receive(self) -> list[tuple[bytes, Peer]]:
        if self._port is None:
            self._reopen()
            return []
        try:
            data = self._port.read(65535)
        except OSError:
            # unplugged: it would be readable for ever
            self._broken()
            return []
        return [(data, None)] if data else []

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        if self._port is None:
            return
        # Straight to the descriptor, which pyserial has made non-blocking: its own write goes round and round until a
        # full port takes everything.
        try:
            if urgent and not self._urgent:
                self._jump_queue()
            self._urgent = urgent
            self._tail = self._tail[self._write(self._tail) :]
            if not self._tail:
                self._longest = max(self._longest, len(data))
                sent = self._write(data)
                # a packet that has begun must end, or it spoils the next; one that has not is dropped
                self._tail = data[sent:] if sent else b""
        except (OSError, termios.error):
            self._broken()

    def _write(self, data: bytes) -> int:
        try:
            return os.write(self._port.fileno(), data) if data else 0
        except BlockingIOError:
            return 0

    def _jump_queue(self) -> None:
        """Throws away what waits; of a packet cut by that the receiver expects the rest, so it gets zeros for it."""
        if self._tail or self._port.out_waiting:
            self._port.reset_output_buffer()
            self._tail = bytes(self._longest)

    def _broken(self) -> None:
        self.close()
        self._tail, self._urgent = b"", False
        self._retry_s = time.monotonic() + RETRY_S

    def _reopen(self) -> None:
        if time.monotonic() < self._retry_s:
            return
        try:
            self._port = self._open()
        except (OSError, termios.error):
            self._retry_s = time.monotonic() + RETRY_S

    def close(self) -> None:
        if self._port is not None:
            port, self._port = self._port, None
            with contextlib.suppress(OSError, termios.error):
                port.close()
