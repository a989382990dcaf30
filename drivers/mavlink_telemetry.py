"""What one vehicle last said, decoded from its messages; and its state in the drivers' words. No SDK, no clock."""

from __future__ import annotations

import math
import struct
from collections import deque
from dataclasses import dataclass, field
from typing import Any

from drivers import mavlink_words as w
from drivers.mavlink_frames import MavlinkFrame
from drivers.vehicle import Vec3

TUMBLED_RAD = math.radians(75.0)
"""Autopilots limit the tilt to 45 degrees or less; who leans more has lost control or lies on its side."""
TUMBLED_S = 0.5
YOUNG_MS = 60_000
"""A clock that went back to less than this has started anew; one further on may be a late packet's."""
NEVER = -math.inf


@dataclass
class Telemetry:
    """The newest of everything, with receipt times where age matters; angles in rad, clockwise from north.

    Attributes:
        stamp_s: receipt of the newest message of any kind.
        heartbeat_s: of the newest heartbeat.
        armed_s: of the newest heartbeat, which says ``armed``, and ``custom_mode``.
        landed: MAV_LANDED_STATE, 0 where it never came.
        position_m: own estimate in the arena.
        tumbled_since_s: leaning too far since then; None when level.
        battery: remaining, 0..1.
        charge_state: MAV_BATTERY_CHARGE_STATE.
        current_a: out of the battery; negative when charging; None where it is not measured.
        texts: newest status texts with receipt time and severity.
        text_id: of the newest, which may go on.
        version: ``flight_sw_version`` of AUTOPILOT_VERSION.
        back: messages in a row whose clock went backwards.
        rebooted: its clock went backwards since the last look, and no heartbeat has said since that it is armed.
    """

    stamp_s: float = NEVER
    heartbeat_s: float = NEVER
    autopilot: int = -1
    type: int = -1
    armed: bool = False
    custom_mode: int = 0
    system_status: int = 0
    landed: int = 0
    landed_s: float = NEVER
    position_m: Vec3 | None = None
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)
    position_s: float = NEVER
    amsl_m: float | None = None
    heading_rad: float = 0.0
    heading_s: float = NEVER
    tilt_rad: float = 0.0
    tumbled_since_s: float | None = None
    battery: float | None = None
    charge_state: int = 0
    current_a: float | None = None
    voltage_v: float | None = None
    health: tuple[int, int, int] | None = None
    gps_fix: int | None = None
    satellites: int | None = None
    ekf_flags: int | None = None
    version: int | None = None
    origin_known: bool = False
    boot_ms: int | None = None
    back: int = 0
    rebooted: bool = False
    text_id: int = 0
    texts: deque[tuple[float, int, str]] = field(default_factory=lambda: deque(maxlen=20))

    def take(self, message: Any, now_s: float, frame: MavlinkFrame) -> None:
        """Notes a message of the vehicle's autopilot."""
        self.stamp_s = now_s
        handler = _HANDLERS.get(message.get_type())
        if handler is not None:
            handler(self, message, now_s, frame)

    @property
    def on_ground(self) -> bool:
        """Landed by its own judgement; a disarmed vehicle does not fly."""
        return self.landed == w.ON_GROUND or (self.landed == 0 and not self.armed)

    @property
    def airborne(self) -> bool:
        """Flies by its own judgement."""
        return self.landed in (w.IN_AIR, w.TAKING_OFF, w.LANDING)

    def tumbled(self, now_s: float) -> bool:
        """Leans too far, for long enough."""
        return self.tumbled_since_s is not None and now_s - self.tumbled_since_s >= TUMBLED_S

    @property
    def charging(self) -> bool | None:
        """Whether its charger works; None where the battery monitor cannot tell."""
        if self.charge_state == w.CHARGE_CHARGING:
            return True
        if self.current_a is not None and self.current_a < -0.02:
            return True
        # A state other than "charging" means that this monitor knows; a measured current too.
        if self.charge_state != w.CHARGE_UNDEFINED or self.current_a is not None:
            return False
        return None

    def why(self, since_s: float) -> str:
        """Its own words since then, newest last; empty when it said nothing."""
        said = [text.strip() for at_s, severity, text in tuple(self.texts) if at_s >= since_s and severity <= w.WARNING]
        return "; ".join(dict.fromkeys(said[-3:]))


def _clock(t: Telemetry, boot_ms: int) -> None:
    # 3 s: messages of one link may overtake each other, a reboot starts again near 0
    if t.boot_ms is not None and boot_ms + 3000 < t.boot_ms:
        t.back += 1
        if boot_ms >= YOUNG_MS and t.back < 2:
            return  # one late packet
        t.rebooted = True
    t.back, t.boot_ms = 0, boot_ms


def _heartbeat(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.heartbeat_s = now_s
    t.autopilot, t.type = m.autopilot, m.type
    t.armed = bool(m.base_mode & w.ARMED_FLAG)
    if t.armed:
        t.rebooted = False  # nobody wakes up armed: the clock was that of late packets
    t.custom_mode, t.system_status = m.custom_mode, m.system_status


def _extended(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    if m.landed_state != 0:
        t.landed, t.landed_s = m.landed_state, now_s


def _attitude(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    _clock(t, m.time_boot_ms)
    t.heading_rad, t.heading_s = m.yaw, now_s
    t.tilt_rad = math.acos(max(-1.0, min(1.0, math.cos(m.roll) * math.cos(m.pitch))))
    if t.tilt_rad <= TUMBLED_RAD:
        t.tumbled_since_s = None
    elif t.tumbled_since_s is None:
        t.tumbled_since_s = now_s


def _local(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    _clock(t, m.time_boot_ms)
    if frame.geo is None and all(map(math.isfinite, (m.x, m.y, m.z, m.vx, m.vy, m.vz))):
        t.position_m, t.velocity_mps = frame.from_ned((m.x, m.y, m.z)), frame.from_ned((m.vx, m.vy, m.vz))
        t.position_s = now_s


def _global(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    _clock(t, m.time_boot_ms)
    # before the first fix some firmware sends zeros: the sea off Africa
    if frame.geo is None or (m.lat == 0 and m.lon == 0):
        return
    t.amsl_m = m.alt * 1e-3
    t.position_m = frame.from_global(m.lat, m.lon, m.alt)
    t.velocity_mps = frame.from_ned((m.vx * 0.01, m.vy * 0.01, m.vz * 0.01))
    t.position_s = now_s


def _battery(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    if m.id != 0:
        return
    if m.battery_remaining >= 0:
        t.battery = min(1.0, m.battery_remaining / 100.0)
    t.charge_state = m.charge_state
    # -1 means "not measured" (common.xml), so a charging current of exactly 10 mA cannot be told
    t.current_a = None if m.current_battery == -1 else m.current_battery * 0.01


def _sys_status(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.health = (
        m.onboard_control_sensors_present,
        m.onboard_control_sensors_enabled,
        m.onboard_control_sensors_health,
    )
    if m.battery_remaining >= 0 and t.battery is None:
        t.battery = min(1.0, m.battery_remaining / 100.0)
    if m.voltage_battery not in (0, 65535):
        t.voltage_v = m.voltage_battery * 1e-3


def _gps(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.gps_fix = m.fix_type
    t.satellites = None if m.satellites_visible == 255 else m.satellites_visible


def _estimator(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.ekf_flags = m.flags


def _version(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.version = m.flight_sw_version


def _origin(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    t.origin_known = True


def _text(t: Telemetry, m: Any, now_s: float, frame: MavlinkFrame) -> None:
    text = m.text.decode("utf-8", "replace") if isinstance(m.text, bytes) else str(m.text)
    text = text.rstrip("\0")
    if m.id and m.chunk_seq and t.texts and t.text_id == m.id:
        # long texts come in pieces
        at_s, severity, before = t.texts.pop()
        t.texts.append((at_s, severity, before + text))
    else:
        t.texts.append((now_s, m.severity, text))
    t.text_id = m.id


_HANDLERS = {
    "HEARTBEAT": _heartbeat,
    "EXTENDED_SYS_STATE": _extended,
    "ATTITUDE": _attitude,
    "LOCAL_POSITION_NED": _local,
    "GLOBAL_POSITION_INT": _global,
    "BATTERY_STATUS": _battery,
    "SYS_STATUS": _sys_status,
    "GPS_RAW_INT": _gps,
    "ESTIMATOR_STATUS": _estimator,
    "EKF_STATUS_REPORT": _estimator,
    "AUTOPILOT_VERSION": _version,
    "GPS_GLOBAL_ORIGIN": _origin,
    "STATUSTEXT": _text,
}


def parameter_value(value: float, kind: int, bytewise: bool) -> float:
    """The number of a PARAM_VALUE.

    Args:
        value: its float.
        kind: MAV_PARAM_TYPE.
        bytewise: PX4 copies an integer's bytes into the float, ArduPilot converts the number
            (https://mavlink.io/en/services/parameter.html#parameter-encoding).
    """
    form = w.INTEGERS.get(kind)
    if not bytewise or form is None:
        return float(value)
    raw = struct.pack("<f", value)
    return float(struct.unpack(form, raw[: struct.calcsize(form)])[0])


def version_text(version: int) -> str:
    """``flight_sw_version`` in words: major, minor, patch, kind of release, highest byte first."""
    major, minor, patch, kind = ((version >> shift) & 0xFF for shift in (24, 16, 8, 0))
    release = "" if kind == 255 else " release candidate" if kind >= 192 else " (not a release)"
    return f"{major}.{minor}.{patch}{release}"
