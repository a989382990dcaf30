"""The wire of the simulated MAVLink vehicles: sockets, frames, signatures. The only file here that imports pymavlink.

UDP goes out to fixed addresses, as PX4's simulator pushes to a ground station, and back to whoever has spoken; a TCP
server is optional, as ArduPilot's simulator has one on port 5760.
"""

from __future__ import annotations

import random
import select
import socket
import time
from collections.abc import Callable, Sequence
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from sim_backends.errors import SimulationError
from sim_backends.wire.world import Modifiers

mavlink: Any = ardupilotmega
"""The dialect: common.xml and ArduPilot's own."""
Address = tuple[str, int]

FORGET_S = 60.0
"""A client that has been silent this long gets nothing more."""
UNSIGNED = frozenset(
    (
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        mavlink.MAVLINK_MSG_ID_ADSB_VEHICLE,
        mavlink.MAVLINK_MSG_ID_COLLISION,
    )
)
"""What a vehicle with a signing key still takes unsigned: others' traffic and the radio's own words, no orders."""
SIGNING_EPOCH_S = 1_420_070_400
"""2015-01-01, from which signing stamps count in 10 us (mavlink.io, message signing)."""


def parse_key(text: str) -> bytes:
    """A signing key of 32 bytes from hex digits.

    Raises:
        SimulationError: when it is anything else.
    """
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != 32:
        raise SimulationError("the signing key is not 64 hex digits; give 32 bytes, such as: openssl rand -hex 32")
    return key


def _careful(codec: Any) -> Callable[[bytearray, int, int], bool]:
    """Pymavlink's check without its flaw: a stamp counts before its signature is found to be wrong.

    Whoever sends rubbish with a late stamp could so shut out the real ground station.
    """
    check, stamps = codec.check_signature, codec.signing.stream_timestamps

    def checked(data: bytearray, system: int, component: int) -> bool:
        before = dict(stamps)
        good = bool(check(data, system, component))
        if not good:
            stamps.clear()
            stamps.update(before)
        return good

    return checked


def _stamp_now() -> int:
    return int((time.time() - SIGNING_EPOCH_S) * 1e5)


class Link:
    """Everything a vehicle hears and says; never blocks.

    Attributes:
        faults: what the link suffers; the vehicle renews it.
        refused: messages that were dropped for their signature.
    """

    def __init__(
        self,
        sysid: int,
        *,
        host: str = "127.0.0.1",
        port: int | None = None,
        outs: Sequence[Address] = (),
        tcp_port: int | None = None,
        key: bytes | None = None,
        seed: int = 0,
    ) -> None:
        """Opens the sockets.

        Args:
            sysid: MAVLink id of the vehicle.
            host: address to listen on.
            port: UDP port to listen on; None takes any.
            outs: where everything is sent from the start.
            tcp_port: of the TCP server; None: there is none.
            key: for signing; None: nothing is signed or checked.
            seed: of the lost packets.

        Raises:
            SimulationError: when a port is taken.
        """
        self.faults = Modifiers()
        self._sysid, self._key = sysid, key
        self._random = random.Random(f"link {seed} {sysid}")
        self._outs = tuple(outs)
        self._clients: dict[Address, float] = {}
        self._streams: dict[socket.socket, Any] = {}
        self._server: socket.socket | None = None
        self._signing: Any = None
        self._packer = self._codec()
        self._parser = self._codec()
        try:
            self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._udp.bind((host, port or 0))
            self._udp.setblocking(False)
            if tcp_port is not None:
                self._server = socket.create_server((host, tcp_port))
                self._server.setblocking(False)
        except OSError as error:
            raise SimulationError(f"vehicle {sysid}: cannot listen on {host}: {error}; choose another port") from error

    def _codec(self) -> Any:
        codec = mavlink.MAVLink(None, srcSystem=self._sysid, srcComponent=mavlink.MAV_COMP_ID_AUTOPILOT1)
        codec.robust_parsing = True
        if self._signing is not None:
            # one clock and one memory of stamps for all directions
            codec.signing = self._signing
            codec.check_signature = _careful(codec)
        elif self._key is not None:
            self._signing = codec.signing
            codec.signing.secret_key = self._key
            codec.signing.sign_outgoing = True
            codec.signing.timestamp = _stamp_now()
            codec.signing.allow_unsigned_callback = lambda _codec, message_id: message_id in UNSIGNED
            codec.check_signature = _careful(codec)
        return codec

    @property
    def port(self) -> int:
        """UDP port it listens on."""
        return int(self._udp.getsockname()[1])

    @property
    def tcp_port(self) -> int | None:
        """TCP port it listens on."""
        return None if self._server is None else int(self._server.getsockname()[1])

    @property
    def refused(self) -> int:
        """Messages dropped for a missing or wrong signature."""
        return int(self._parser.signing.reject_count + self._parser.signing.badsig_count)

    def wait(self, timeout_s: float) -> None:
        """Returns after ``timeout_s``; a vehicle answers in its own rhythm, not faster."""
        if timeout_s > 0:
            time.sleep(timeout_s)

    def receive(self) -> list[Any]:
        """Every message for this vehicle since the last call."""
        found: list[Any] = []
        now_s = time.monotonic()
        while True:
            try:
                data, address = self._udp.recvfrom(4096)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # somebody's port is closed; that is no fault of ours
                continue
            messages = [] if self._dropped() else self._parse(self._parser, data)
            if messages:
                self._clients[address] = now_s
                found += messages
        found += self._receive_tcp()
        return [m for m in found if self._is_mine(m)]

    def _receive_tcp(self) -> list[Any]:
        if self._server is None:
            return []
        found: list[Any] = []
        ready, _, _ = select.select([self._server, *self._streams], [], [], 0.0)
        for sock in ready:
            if sock is self._server:
                client, _ = self._server.accept()
                client.setblocking(False)
                self._streams[client] = self._codec()
                continue
            try:
                data = sock.recv(65536)
            except OSError:
                data = b""
            if not data:
                self._streams.pop(sock)
                sock.close()
            elif not self._dropped():
                found += self._parse(self._streams[sock], data)
        return found

    def _parse(self, codec: Any, data: bytes) -> list[Any]:
        try:
            parsed = codec.parse_buffer(data) or []
        except mavlink.MAVError:
            return []
        return [m for m in parsed if m.get_type() != "BAD_DATA"]

    def _is_mine(self, message: Any) -> bool:
        if message.get_srcSystem() == self._sysid:
            return False
        system = getattr(message, "target_system", 0)
        component = getattr(message, "target_component", 0)
        return system in (0, self._sysid) and component in (0, mavlink.MAV_COMP_ID_AUTOPILOT1)

    def _dropped(self) -> bool:
        return self.faults.lost or (self.faults.loss > 0.0 and self._random.random() < self.faults.loss)

    def send(self, message: Any) -> None:
        """Sends to everybody who listens."""
        if self.faults.lost or self.faults.silent:
            return
        if self._key is not None:
            # the codec only counts up; a stamp has to keep up with the clock
            self._packer.signing.timestamp = max(self._packer.signing.timestamp, _stamp_now())
        data = message.pack(self._packer)
        self._packer.seq = (self._packer.seq + 1) % 256
        oldest_s = time.monotonic() - FORGET_S
        clients = [a for a, heard_s in self._clients.items() if heard_s >= oldest_s and a not in self._outs]
        for address in (*self._outs, *clients):
            if not self._dropped():
                self._send_to(address, data)
        for sock in list(self._streams):
            try:
                sock.sendall(data)
            except OSError:
                self._streams.pop(sock)
                sock.close()

    def _send_to(self, address: Address, data: bytes) -> None:
        try:
            self._udp.sendto(data, address)
        except OSError:  # nobody there, or no buffer: a datagram is lost, as on any radio
            return

    def close(self) -> None:
        """Closes every socket."""
        for sock in (self._udp, self._server, *self._streams):
            if sock is not None:
                sock.close()
