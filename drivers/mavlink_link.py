"""A MAVLink connection, shared by all vehicles of one endpoint: one thread that receives, ticks and sends.

The only file that imports pymavlink. The ground station's heartbeat goes out only while the control loop calls
(``Rider.alive``): a heartbeat from a thread of its own would tell the vehicles that a dead application is well.
"""

from __future__ import annotations

import contextlib
import logging
import os
import select
import stat
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

os.environ["MAVLINK20"] = "1"  # pymavlink looks at it while it is imported

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from drivers import mavlink_words as w
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_socket import Peer, Wire, open_wire

logging.getLogger(mavlink.__name__).setLevel(logging.WARNING)  # a line for each packet of a stranger is too much

SIGNING_EPOCH_S = 1420070400
"""1 January 2015: from there signatures count in 10 us."""
SIGNED_FLAG = 1
"""MAVLINK_IFLAG_SIGNED of a packet's header."""
FAILED_S = 0.005
"""Pause after an error."""
RADIO_STATUS = 109
"""Comes unsigned out of telemetry radios, which know no key."""


class Rider(Protocol):
    """A vehicle on the link, seen from the link's thread."""

    @property
    def sysid(self) -> int:
        """Its system id."""
        ...

    def alive(self, now_s: float) -> bool:
        """Whether its control loop has called lately."""
        ...

    def on_message(self, message: Any, now_s: float) -> None:
        """Takes a message of its autopilot."""
        ...

    def pump(self, now_s: float) -> None:
        """Acts on what the loop has handed over; called at every wake-up."""
        ...

    def tick(self, now_s: float) -> None:
        """Called at the rate of set-points."""
        ...

    def on_error(self, error: Exception) -> None:
        """One of the above failed; the link goes on for the others."""
        ...


@dataclass(frozen=True, slots=True)
class Heard:
    """A system that was heard on the link: what its heartbeat says."""

    autopilot: int
    type: int


def read_key(path: Path) -> bytes:
    """The 32 bytes of a signing key.

    Raises:
        DriverError: when the file cannot be read or holds something else; the key itself is never shown.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise DriverError(f"MAVLink signing key {path}: {error.strerror}; check signing_key_file") from error
    if len(raw) != 32:
        with contextlib.suppress(ValueError):
            raw = bytes.fromhex(raw.decode("ascii", "replace").strip())
    if len(raw) != 32:
        raise DriverError(f"MAVLink signing key {path}: give 32 bytes, or 64 hexadecimal digits")
    return raw


def key_is_open(path: Path | None) -> bool:
    """Whether others than its owner can read the file."""
    try:
        return path is not None and bool(path.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO))
    except OSError:
        return False


class Link:
    """One endpoint. Made by ``board``, ended when the last vehicle leaves.

    Attributes:
        signed: packets are signed, and only signed ones taken.
        rejected: packets dropped for their signature.
        foreign: packets came with a signature while we have no key.
        heard: who was heard, by system id.
    """

    _links: dict[str, Link] = {}  # noqa: RUF012  the process's own registry
    _opening: dict[str, threading.Lock] = {}  # noqa: RUF012
    _registry = threading.Lock()

    def __init__(self, endpoint: str, options: MavlinkOptions, clock: Clock, timeout_s: float) -> None:
        key = None if options.signing_key_file is None else read_key(options.signing_key_file)
        self.endpoint, self._options, self._clock = endpoint, options, clock
        self.identity = (options.system_id, options.component_id, key)
        self._wire: Wire = open_wire(endpoint, options.baud, timeout_s)
        self._packer: Any = mavlink.MAVLink(None, options.system_id, options.component_id)
        self._parsers: dict[Peer, Any] = {}
        if key is not None:
            signing = self._packer.signing
            signing.secret_key, signing.sign_outgoing, signing.link_id = key, True, 0
            signing.timestamp = int((time.time() - SIGNING_EPOCH_S) * 1e5)
            signing.allow_unsigned_callback = lambda _, message_id: message_id == RADIO_STATUS
        self.signed = key is not None
        self.rejected = 0
        self.foreign = False
        self.heard: dict[int, Heard] = {}
        self._peers: dict[int, Peer] = {}
        self._sequence: dict[int, int] = {}
        self._counts: dict[int, tuple[int, int]] = {}
        self._riders: dict[int, Rider] = {}
        self._sending = threading.Lock()
        self._waking = threading.Lock()
        self._wake_out, self._wake_in = os.pipe()
        os.set_blocking(self._wake_out, False)
        os.set_blocking(self._wake_in, False)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"mavlink {endpoint}", daemon=True)
        self._thread.start()

    @classmethod
    def board(cls, endpoint: str, options: MavlinkOptions, clock: Clock, rider: Rider, timeout_s: float) -> Link:
        """Puts a vehicle on the link of its endpoint, which is opened for the first.

        Raises:
            DriverError: when the endpoint cannot be opened, the system id is taken, or its link talks as somebody else.
        """
        key = None if options.signing_key_file is None else read_key(options.signing_key_file)
        with cls._registry:
            opening = cls._opening.setdefault(endpoint, threading.Lock())
        # opening may take long: the other endpoints do not wait for it
        with opening:
            while True:
                with cls._registry:
                    link = cls._links.get(endpoint)
                if link is None:
                    link = cls(endpoint, options, clock, timeout_s)
                with cls._registry:
                    if link._stop.is_set():
                        continue  # its last vehicle has left meanwhile
                    cls._links[endpoint] = link
                    if link.identity != (options.system_id, options.component_id, key):
                        raise DriverError(f"{endpoint}: its vehicles differ in system_id, component_id or signing key")
                    if rider.sysid in link._riders:
                        raise DriverError(f"{endpoint}: two vehicles have the system id {rider.sysid}; change one")
                    link._riders[rider.sysid] = rider
                    return link

    def leave(self, rider: Rider) -> None:
        """Takes a vehicle off; with the last one the link ends: thread joined, socket closed."""
        with self._registry:
            if self._riders.get(rider.sysid) is rider:
                del self._riders[rider.sysid]
            if self._riders:
                return
            self._links.pop(self.endpoint, None)
            self._stop.set()
        self.wake()
        if threading.current_thread() is not self._thread:
            self._thread.join(5.0)

    def wake(self) -> None:
        """Makes the thread look at what it was handed; from any thread."""
        with self._waking, contextlib.suppress(OSError):
            if self._wake_in >= 0:  # closed, its number may be another file's
                os.write(self._wake_in, b"x")

    def send(self, sysid: int | None, name: str, *values: Any, urgent: bool = False) -> None:
        """Sends a message to a vehicle, or to all; never blocks.

        Args:
            sysid: of the vehicle; None: everybody who was heard.
            name: of the message in small letters.
            values: its fields in the order of the XML.
            urgent: goes ahead of what the wire still holds.
        """
        message = getattr(mavlink, f"MAVLink_{name}_message")(*values)
        with self._sending:
            data = bytes(message.pack(self._packer))
            self._packer.seq = (self._packer.seq + 1) % 256
            # who was never heard may be behind any of the known addresses, or a wire with one end
            known = set(self._peers.values()) or {None}
            for peer in {self._peers[sysid]} if sysid in self._peers else known:
                self._wire.send(data, peer, urgent)

    def lost(self, sysid: int) -> float:
        """Share of the vehicle's packets that did not arrive."""
        got, missed = self._counts.get(sysid, (0, 0))
        return missed / (got + missed) if got else 0.0

    # ------------------------------------------------------------------------------------- the link's own thread

    def _run(self) -> None:
        period_s = 1.0 / self._options.setpoint_hz
        tick_s = beat_s = self._clock.now()
        try:
            while not self._stop.is_set():
                self._guarded(self._sleep, max(0.0, tick_s - self._clock.now()))
                now_s = self._clock.now()
                self._guarded(self._receive, now_s)
                riders = list(self._riders.values())
                for rider in riders:
                    _guarded(rider, rider.pump, now_s)
                if now_s >= beat_s:
                    beat_s = now_s + (1.0 / self._options.heartbeat_hz if self._guarded(self._beat, now_s) else 0.0)
                if now_s >= tick_s:
                    tick_s = max(tick_s + period_s, now_s)
                    for rider in riders:
                        _guarded(rider, rider.tick, now_s)
        finally:
            self._wire.close()
            with self._waking:
                os.close(self._wake_out)
                os.close(self._wake_in)
                self._wake_out = self._wake_in = -1

    def _guarded(self, call: Callable[..., bool | None], *values: Any) -> bool:
        """Calls; what fails is told to every vehicle, and the thread goes on: their stops travel by it."""
        try:
            return bool(call(*values))
        except Exception as error:
            for rider in list(self._riders.values()):
                rider.on_error(error)
            self._stop.wait(FAILED_S)  # what fails at once, again and again, leaves the processor to others
            return False

    def _receive(self, now_s: float) -> None:
        for data, peer in self._wire.receive():
            self._guarded(self._take, data, peer, now_s)

    def _beat(self, now_s: float) -> bool:
        if not any(rider.alive(now_s) for rider in list(self._riders.values())):
            return False
        self.send(None, "heartbeat", w.GCS_TYPE, w.NO_AUTOPILOT, 0, 0, w.ACTIVE, 3)
        return True

    def _sleep(self, most_s: float) -> None:
        wire = self._wire.fileno()
        try:
            readable, _, _ = select.select([self._wake_out, *([wire] if wire >= 0 else [])], [], [], most_s)
        except OSError:
            return  # the wire broke between the two lines
        if self._wake_out in readable:
            with contextlib.suppress(OSError):
                os.read(self._wake_out, 4096)

    def _take(self, data: bytes, peer: Peer, now_s: float) -> None:
        parser = self._parsers.get(peer)
        if parser is None:
            parser = self._parsers[peer] = mavlink.MAVLink(None, self._options.system_id, self._options.component_id)
            parser.robust_parsing = True
            parser.signing = self._packer.signing
        with self._sending:  # signatures' time stamps are shared with the packer
            messages = parser.parse_buffer(data) or []
        for message in messages:
            if message.get_type() == "BAD_DATA":
                self.rejected += "signature" in str(message.reason).lower()
                continue
            if message.get_srcComponent() != w.AUTOPILOT_COMPONENT:
                continue
            if not self.signed and message.get_header().incompat_flags & SIGNED_FLAG:
                self.foreign = True
            sysid = message.get_srcSystem()
            self._peers[sysid] = peer
            self._count(sysid, message.get_seq())
            if message.get_type() == "HEARTBEAT":
                self.heard[sysid] = Heard(message.autopilot, message.type)
            rider = self._riders.get(sysid)
            if rider is not None:
                _guarded(rider, rider.on_message, message, now_s)

    def _count(self, sysid: int, sequence: int) -> None:
        got, missed = self._counts.get(sysid, (0, 0))
        last = self._sequence.get(sysid)
        gap = 0 if last is None else (sequence - last - 1) % 256
        self._sequence[sysid] = sequence
        # packets of before a pause are not losses
        self._counts[sysid] = (got + 1, missed + (gap if gap < 50 else 0))


def _guarded(rider: Rider, call: Callable[..., None], *values: Any) -> None:
    """Calls, and keeps the thread alive for the other vehicles whatever happens."""
    try:
        call(*values)
    except Exception as error:
        rider.on_error(error)
