"""The link to one Crazyflie: the only file that knows cflib.

What cflib leaves to its users is done here. Its UDP link never resends (one lost request hangs connecting for ever):
resending is switched on and every attempt has a deadline. Its thread of pings can deadlock or outlive a dead link: it
is not started. Its ``close_link`` sends a zero set-point that outranks the high-level commander: that is never sent.
"""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from drivers.crazyflie_logs import Block, plan_blocks
from drivers.crazyflie_orders import ArmOrder, GoToOrder, LandOrder, Order, StopOrder, TakeOffOrder
from drivers.errors import DriverError
from drivers.vehicle import Pose

if TYPE_CHECKING:
    from cflib.crazyflie import Crazyflie as Cf

PORT_LOG, PORT_LOCALISATION, PORT_HIGH_LEVEL, PORT_SUPERVISOR = 0x05, 0x06, 0x08, 0x09
PORT_PLATFORM, PORT_LINK = 0x0D, 0x0F
CREATE_BLOCK, APPEND_BLOCK, START_BLOCK, ITEMS_PER_PACKET = 6, 7, 3, 9
RESEND_S = 0.06
"""cflib repeats a request after 0.2 s; on a network an answer takes some ms, and each of hundreds may get lost."""
SUPERVISOR_PROTOCOL = 12
"""From this CRTP protocol on, arming and emergency stop have port 9."""
LINEAR_PROTOCOL = 8
EMERGENCY_STOP = 3
ARMING = 1
_ORDERS: dict[int, type[Order]] = {7: TakeOffOrder, 8: LandOrder, 3: StopOrder, 4: GoToOrder, 12: GoToOrder}

Logged = Callable[[int, Mapping[str, float]], None]
Answered = Callable[[type[Order], int], None]

_init_lock = threading.Lock()


def load() -> type[Cf]:
    """Loads cflib and its drivers of links; returns its Crazyflie."""
    with _init_lock:  # importing and registering drivers is not safe in several threads at once
        with warnings.catch_warnings():  # cflib turns on everybody's deprecation warnings when it is imported
            import cflib.crtp  # noqa: PLC0415  slow to import; needed only where a Crazyflie flies
            from cflib.crazyflie import Crazyflie  # noqa: PLC0415

        # what cflib logs without being asked (tracebacks among it) comes back here as errors of the link
        logging.getLogger("cflib").addHandler(logging.NullHandler())
        if not cflib.crtp.CLASSES:
            cflib.crtp.init_drivers()
    return Crazyflie  # type: ignore[no-any-return]  # cflib has no types


def _packet(port: int, channel: int, data: bytes) -> Any:
    from cflib.crtp.crtpstack import CRTPPacket  # noqa: PLC0415  as above

    packet = CRTPPacket()
    packet.set_header(port, channel)
    packet.data = data
    return packet


class BareLink:
    """Packets to and from a Crazyflie, nothing more: no tables, no logs, no goodbye.

    Raises:
        DriverError: when there is no such radio, or another program holds it.
    """

    def __init__(self, uri: str) -> None:
        load()
        import cflib.crtp  # noqa: PLC0415  as above

        self.uri = uri
        try:
            self._link: Any = cflib.crtp.get_link_driver(uri, lambda _: None, lambda _: None)
        except Exception as error:  # cflib raises whatever it likes, Exception itself as well
            raise DriverError(f"{uri} cannot be opened: {error}") from error
        if self._link is None:
            raise DriverError(f"{uri} is no Crazyflie's URI; it begins with radio://, usb:// or udp://")

    def send(self, port: int, channel: int, data: bytes) -> None:
        """Sends one packet."""
        self._link.send_packet(_packet(port, channel, data))

    def receive(self, wait_s: float) -> list[tuple[int, int, bytes]]:
        """Port, channel and data of what has arrived, waiting for the first."""
        found = []
        packet = self._link.receive_packet(wait_s)
        while packet is not None:
            found.append((int(packet.port), int(packet.channel), bytes(packet.data)))
            packet = self._link.receive_packet(0)
        return found

    def close(self) -> None:
        """Drops it without a packet."""
        self._link.close()


def _new_crazyflie(cache: Path, udp: bool) -> Cf:
    cf = load()(rw_cache=str(cache))
    # no thread of pings: see the top of the file
    cf.link_statistics.latency.start = lambda: None
    cf.link_statistics.latency.stop = lambda: None
    if udp:
        cf.send_packet = partial(cf.send_packet, timeout=RESEND_S)
    return cf


class CrazyflieLink:
    """One open link. Made by ``connect``; dead for good once ``lost`` is set.

    Attributes:
        protocol: CRTP protocol version of the firmware.
        missing: wanted log variables that it does not have.
        state_variable: the log variable that carries its state, or the best there is; empty where it logs nothing.
        parameters: names of the parameters that it has.
        lost: what cflib said when the link broke; None while it is up.
        quality: share of packets that got through at the first try, percent, radios only.
        latency_s: 95th percentile of the round trip, once measured.
        packets: number of packets received.
    """

    def __init__(self, uri: str, cache: Path, on_log: Logged, on_answer: Answered) -> None:
        self.uri = uri
        self.protocol = -1
        self.missing: list[str] = []
        self.state_variable = ""
        self.parameters: frozenset[str] = frozenset()
        self.lost: str | None = None
        self.quality: float | None = None
        self.latency_s: float | None = None
        self.packets = 0
        self._heard_s = time.monotonic()
        self._complete = threading.Event()
        self._on_log, self._on_answer = on_log, on_answer
        self._first_log = threading.Event()
        self._configs: list[Any] = []
        self._breaking = threading.Lock()
        self._udp = uri.startswith("udp:")
        self._cf: Any = _new_crazyflie(cache, self._udp)
        cf = self._cf
        # orders of the flight go past cflib's lock, too: who hangs there could not stop the motors any more either
        cf.high_level_commander._send_packet = partial(self._raw, PORT_HIGH_LEVEL, 0)
        self._break = cf._link_error_cb
        cf._link_error_cb = self._broken  # must not run in the thread that holds cflib's send lock
        self._start_setup = cf._start_connection_setup
        cf._start_connection_setup = self._setup
        cf.packet_received.add_callback(self._received)
        cf.fully_connected.add_callback(lambda _: self._complete.set())
        cf.connection_failed.add_callback(lambda _, text: self._fail(text))
        cf.connection_lost.add_callback(lambda _, text: self._fail(text))
        cf.link_statistics.link_quality_updated.add_callback(self._note_quality)
        cf.link_statistics.latency_updated.add_callback(self._note_latency)
        cf.add_port_callback(PORT_HIGH_LEVEL, self._answered)

    # --- connecting

    def open(self, deadline_s: float, answer_s: float, fast_ms: int, slow_ms: int) -> None:
        """Connects and starts logging.

        Args:
            deadline_s: when to give up, ``time.monotonic()``.
            answer_s: give up when nothing was heard for so long.
            fast_ms: period of the log blocks that commands wait for.
            slow_ms: of the others.

        Raises:
            DriverError: saying how far it came.
        """
        self._heard_s = time.monotonic()
        # cflib blocks in here on a jammed USB port: the thread is left behind then
        threading.Thread(target=self._cf.open_link, args=(self.uri,), name="crazyflie-open", daemon=True).start()
        self._wait(self._complete, deadline_s, answer_s)
        types = {
            f"{group}.{name}": element.ctype
            for group, names in self._cf.log.toc.toc.items()
            for name, element in names.items()
        }
        self.parameters = frozenset(
            f"{group}.{name}" for group, names in self._cf.param.toc.toc.items() for name in names
        )
        blocks, self.missing = plan_blocks(types, fast_ms, slow_ms)
        self.state_variable = blocks[0].variables[0] if blocks else ""
        for i, block in enumerate(blocks):
            self._log(f"block{i}", block)
        if blocks:
            self._wait(self._first_log, deadline_s, answer_s)

    def _wait(self, event: threading.Event, deadline_s: float, answer_s: float) -> None:
        asked_s = time.monotonic()
        while not event.wait(0.02):
            now_s = time.monotonic()
            if self.lost is not None:
                raise DriverError(self.lost)
            if now_s > deadline_s or now_s - self._heard_s > answer_s:
                raise DriverError(self._progress())
            if self._cf.platform.get_protocol_version() < 0 and now_s - asked_s > 0.3 and self._cf.link is not None:
                # the one request that cflib never repeats
                asked_s = now_s
                self._raw(PORT_LINK, 1, b"\x00")

    def _progress(self) -> str:
        cf = self._cf
        if self.packets == 0:
            return "nothing answers there; switch it on, check the URI and, for a radio, channel and address"
        if cf.platform.get_protocol_version() < 0:
            return "it answers but does not say its protocol; restart it"
        if cf.log.toc is None or not cf.log.toc.toc:
            return "its table of log variables did not arrive; move the radio nearer or restart it"
        if not self._complete.is_set():
            return "its parameters did not arrive; move the radio nearer or restart it"
        return "it connects but does not send its state; restart it"

    def _setup(self) -> None:
        link = self._cf.link
        if link is not None and self._udp:
            link.needs_resending = True
        self._start_setup()

    def _log(self, name: str, block: Block) -> None:
        from cflib.crazyflie.log import LogConfig  # noqa: PLC0415  as above

        config = LogConfig(name, block.period_ms)
        for variable in block.variables:
            config.add_variable(variable)
        config.data_received_cb.add_callback(self._logged)
        self._cf.log.add_config(config)
        config.start()
        self._configs.append(config)

    def log_again(self) -> None:
        """Asks for the log blocks once more: a vehicle that has rebooted has forgotten them."""
        for config in self._configs if self.up else ():
            items = [
                bytes((v.get_storage_and_fetch_byte(), *self._cf.log.toc.get_element_id(v.name).to_bytes(2, "little")))
                for v in config.variables
            ]
            # without cflib's resending: while nothing answers, each call would start another endless chain of repeats
            for i in range(0, len(items), ITEMS_PER_PACKET):
                command = APPEND_BLOCK if i else CREATE_BLOCK
                self._raw(PORT_LOG, 1, bytes((command, config.id)) + b"".join(items[i : i + ITEMS_PER_PACKET]))
            self._raw(PORT_LOG, 1, bytes((START_BLOCK, config.id, config.period)))

    # --- what comes in; all in cflib's thread

    def _received(self, _: Any) -> None:
        self.packets += 1
        self._heard_s = time.monotonic()
        if self.protocol < 0:
            self.protocol = self._cf.platform.get_protocol_version()

    def _logged(self, stamp_ms: int, values: Mapping[str, float], _: Any) -> None:
        if self.state_variable in values:
            self._first_log.set()
        self._on_log(stamp_ms, {k: v for k, v in values.items() if math.isfinite(v)})

    def _answered(self, packet: Any) -> None:
        data = bytes(packet.data)
        if len(data) >= 4 and data[0] in _ORDERS:
            self._on_answer(_ORDERS[data[0]], data[3])

    def _note_quality(self, percent: float) -> None:
        self.quality = float(percent)

    def _note_latency(self, milliseconds: float) -> None:
        self.latency_s = float(milliseconds) / 1000.0

    def _broken(self, text: str) -> None:
        if self._breaking.acquire(blocking=False):
            threading.Thread(target=self._break, args=(text,), name="crazyflie-broken", daemon=True).start()

    def _fail(self, text: str) -> None:
        if self.lost is None:
            first = str(text).strip().splitlines()[0] if str(text).strip() else "unknown"
            self.lost = f"the link broke: {first}"

    # --- what goes out; never blocks for longer than a full radio queue (2 s)

    @property
    def up(self) -> bool:
        """Whether cflib still has a link."""
        return self.lost is None and self._cf.link is not None

    def _raw(self, port: int, channel: int, data: bytes) -> None:
        """Sends past cflib's lock, in which its own threads may hang."""
        link = self._cf.link
        if link is not None:
            link.send_packet(_packet(port, channel, data))

    def send(self, order: Order) -> None:
        """Sends an order of the flight."""
        if not self.up:
            return
        hl = self._cf.high_level_commander
        match order:
            case ArmOrder(arm) if self.protocol >= SUPERVISOR_PROTOCOL:
                self._raw(PORT_SUPERVISOR, 1, bytes((ARMING, arm)))
            case ArmOrder(arm):
                self._raw(PORT_PLATFORM, 0, bytes((ARMING, arm)))
            case TakeOffOrder(height, duration):
                hl.takeoff(height, duration, yaw=None)
            case LandOrder(height, duration):
                hl.land(height, duration, yaw=None)
            case GoToOrder((x, y, z), yaw, duration, linear):
                hl.go_to(x, y, z, yaw, duration, linear=linear)
            case StopOrder():
                hl.stop()

    def emergency_stop(self) -> None:
        """Motors off at once; the vehicle locks. Past cflib's lock, as poses are."""
        if not self.up:
            return
        if self.protocol >= SUPERVISOR_PROTOCOL:
            self._raw(PORT_SUPERVISOR, 1, bytes((EMERGENCY_STOP,)))
        else:
            self._raw(PORT_LOCALISATION, 1, bytes((EMERGENCY_STOP,)))

    def send_pose(self, pose: Pose, attitude: bool) -> None:
        """Hands a pose to the vehicle's estimator: one packet."""
        x, y, z = pose.position_m
        if attitude:
            half = 0.5 * pose.yaw_rad
            packed = struct.pack("<Bfffffff", 8, x, y, z, 0.0, 0.0, math.sin(half), math.cos(half))
            self._raw(PORT_LOCALISATION, 1, packed)
        else:
            self._raw(PORT_LOCALISATION, 0, struct.pack("<fff", x, y, z))

    def set_parameter(self, name: str, value: float) -> bool:
        """Sets a parameter, repeated until it is confirmed; false where the firmware has none of that name."""
        if name not in self.parameters or not self.up:
            return False
        try:
            self._cf.param.set_value(name, value)
        except (KeyError, AttributeError):
            return False  # read-only, or gone with a link that breaks just now
        return True

    def parameter(self, name: str) -> str | None:
        """The newest known value of a parameter."""
        group, _, key = name.partition(".")
        value = self._cf.param.values.get(group, {}).get(key)
        return None if value is None else str(value)

    def ping(self) -> None:
        """Measures the round trip; ``latency_s`` follows. What cflib's own ``ping`` sends, but past its lock."""
        from cflib.crazyflie.link_statistics import ECHO_CHANNEL, PING_HEADER  # noqa: PLC0415  as above

        if self.up:
            self._raw(PORT_LINK, ECHO_CHANNEL, struct.pack("<Bd", PING_HEADER, time.time()))

    def close(self) -> None:
        """Drops the link without a packet: what the vehicle does, it goes on doing."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            link, self._cf.link = self._cf.link, None
            if link is not None:
                link.close()
            self._cf.close_link()  # with no link left it sends nothing, but ends cflib's threads
        self._fail("closed")


def connect(
    uri: str,
    cache: Path,
    on_log: Logged,
    on_answer: Answered,
    *,
    timeout_s: float,
    answer_s: float,
    fast_ms: int,
    slow_ms: int,
    stop: threading.Event | None = None,
) -> CrazyflieLink:
    """Connects, on a fresh link after each failure, until ``timeout_s`` is over.

    Args:
        uri: ``radio://``, ``usb://`` or ``udp://``.
        cache: folder of cached tables of contents.
        on_log: gets the vehicle's clock in ms and the values of each log block.
        on_answer: gets the error code with which the vehicle answers a high-level command.
        timeout_s: for everything.
        answer_s: silence after which an attempt is dropped.
        fast_ms: period of the log blocks that commands wait for.
        slow_ms: of the others.
        stop: set it to give up early.

    Raises:
        DriverError: with the cause of the last failure.
    """
    deadline_s = time.monotonic() + timeout_s
    cause: Sequence[str] = ()
    while True:
        link = CrazyflieLink(uri, cache, on_log, on_answer)
        try:
            link.open(deadline_s, answer_s, fast_ms, slow_ms)
            return link
        except Exception as error:  # cflib raises whatever it likes, and would keep its radio and its threads
            known = isinstance(error, DriverError)
            words = f"cflib failed with {type(error).__name__} ({error}); restart the vehicle and try again"
            cause = (str(error) if known else words,)
            # closing may block where opening does
            threading.Thread(target=link.close, name="crazyflie-close", daemon=True).start()
        if time.monotonic() + 0.2 > deadline_s or (stop is not None and stop.wait(0.2)):
            raise DriverError("; ".join(cause) or "no time to connect")
        time.sleep(0.0 if stop is not None else 0.2)
