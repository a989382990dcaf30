"""The telemetry of the simulated MAVLink vehicles: which message how often, and what stands in it."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from sim_backends.wire.mavlink_autopilot import Autopilot
from sim_backends.wire.mavlink_estimate import Estimate
from sim_backends.wire.mavlink_guidance import Sense
from sim_backends.wire.mavlink_link import mavlink

PX4_RATES_HZ = {
    mavlink.MAVLINK_MSG_ID_ATTITUDE: 10.0,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 10.0,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 10.0,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 2.0,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: 2.0,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 2.0,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 2.0,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 1.0,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: 1.0,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 0.5,
    mavlink.MAVLINK_MSG_ID_VIBRATION: 0.5,
}
"""What PX4 sends unasked; modest rates, as on a radio."""
DATA_STREAMS = {
    1: (),
    2: (
        mavlink.MAVLINK_MSG_ID_SYS_STATUS,
        mavlink.MAVLINK_MSG_ID_GPS_RAW_INT,
    ),
    6: (mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT, mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
    10: (mavlink.MAVLINK_MSG_ID_ATTITUDE,),
    11: (mavlink.MAVLINK_MSG_ID_VFR_HUD,),
    12: (
        mavlink.MAVLINK_MSG_ID_BATTERY_STATUS,
        mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_VIBRATION,
    ),
}
"""ArduPilot sends nothing but heartbeats until a stream (MAV_DATA_STREAM) or a message is asked for."""
STREAM_PARAMS = {
    "SR0_RAW_SENS": 1, "SR0_EXT_STAT": 2, "SR0_POSITION": 6, "SR0_EXTRA1": 10, "SR0_EXTRA2": 11, "SR0_EXTRA3": 12,
}  # fmt: skip
FULL_MV, EMPTY_MV, CELLS = 16_800, 13_200, 4
"""Of four lithium cells."""
SENSORS = 0x1 | 0x2 | 0x4 | 0x8 | 0x8000 | 0x200000 | 0x2000000
"""Gyroscopes, accelerometers, compass, barometer, motors, AHRS, battery of MAV_SYS_STATUS_SENSOR."""
GPS_BIT, VISION_BIT, PREARM_BIT = 0x20, 0x80, 0x10000000


@dataclass(frozen=True, slots=True)
class View:
    """Everything that telemetry tells.

    Attributes:
        sense: what the autopilot believes.
        autopilot: its state.
        estimate: which knows the globe.
        boot_ms: since the vehicle was switched on.
        unix_us: wall clock.
        charging: on its charger.
        tilt: roll and pitch, forward-right-down.
        source: of the position.
        noise_m: of GPS.
    """

    sense: Sense
    autopilot: Autopilot
    estimate: Estimate
    boot_ms: int
    unix_us: int
    charging: bool
    tilt: tuple[float, float]
    source: str
    noise_m: float


def _altitude_m(v: View) -> float:
    return v.autopilot.globe.altitude_m - v.sense.ned[2]


def _heading_cdeg(v: View) -> int:
    return round(math.degrees(v.sense.yaw) * 100) % 36000


def heartbeat(v: View) -> Any:
    """HEARTBEAT."""
    a = v.autopilot
    kind = mavlink.MAV_TYPE_QUADROTOR if a.kind == "copter" else mavlink.MAV_TYPE_GROUND_ROVER
    maker = mavlink.MAV_AUTOPILOT_PX4 if a.params.bytewise else mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
    return mavlink.MAVLink_heartbeat_message(kind, maker, a.base_mode, a.custom_mode, a.system_status, 3)


def _attitude(v: View) -> Any:
    return mavlink.MAVLink_attitude_message(v.boot_ms, *v.tilt, v.sense.yaw, 0.0, 0.0, 0.0)


def _local(v: View) -> Any:
    if not v.sense.position_ok:
        return None
    return mavlink.MAVLink_local_position_ned_message(v.boot_ms, *v.sense.ned, *v.sense.velocity)


def _global(v: View) -> Any:
    if not v.sense.global_ok:
        return None
    lat, lon = v.estimate.to_globe(v.sense.ned)
    home = v.autopilot.home
    above = -v.sense.ned[2] if home is None else home[2] - v.sense.ned[2]
    speeds = (round(100 * s) for s in v.sense.velocity)
    return mavlink.MAVLink_global_position_int_message(
        v.boot_ms, round(lat * 1e7), round(lon * 1e7), round(_altitude_m(v) * 1000), round(above * 1000), *speeds,
        _heading_cdeg(v),
    )  # fmt: skip


def _gps(v: View) -> Any:
    if v.source != "gps":
        return mavlink.MAVLink_gps_raw_int_message(v.unix_us, 0, 0, 0, 0, 65535, 65535, 65535, 65535, 0)
    lat, lon = v.estimate.to_globe(v.sense.ned)
    fix = 6 if v.noise_m <= 0.05 else 4 if v.noise_m <= 0.5 else 3
    speed = round(100 * math.hypot(v.sense.velocity[0], v.sense.velocity[1]))
    accuracy = max(round(1000 * v.noise_m), 10)
    return mavlink.MAVLink_gps_raw_int_message(
        v.unix_us, fix, round(lat * 1e7), round(lon * 1e7), round(_altitude_m(v) * 1000), 60, 90, speed,
        _heading_cdeg(v), 17, round(_altitude_m(v) * 1000), accuracy, round(1.5 * accuracy), 100, 100_000,
    )  # fmt: skip


def _millivolts(v: View) -> int:
    return round(EMPTY_MV + (FULL_MV - EMPTY_MV) * v.sense.battery)


def _percent(v: View) -> int:
    return max(0, min(100, round(100 * v.sense.battery)))


def _sys_status(v: View) -> Any:
    source = GPS_BIT if v.source == "gps" else VISION_BIT
    present = SENSORS | source | PREARM_BIT
    healthy = SENSORS | (source if v.sense.position_ok else 0)
    if v.autopilot.may_arm(v.sense):
        healthy |= PREARM_BIT
    return mavlink.MAVLink_sys_status_message(
        present, present, healthy, 300, _millivolts(v), -1, _percent(v), 0, 0, 0, 0, 0, 0
    )


def _battery(v: View) -> Any:
    level = v.sense.battery
    state = 7 if v.charging else 4 if level < 0.05 else 3 if level < 0.07 else 2 if level < 0.15 else 1
    cells = [_millivolts(v) // CELLS] * CELLS + [65535] * (10 - CELLS)
    return mavlink.MAVLink_battery_status_message(0, 1, 3, 32767, cells, -1, -1, -1, _percent(v), 0, state)


def _extended(v: View) -> Any:
    return mavlink.MAVLink_extended_sys_state_message(0, v.autopilot.landed_state)


def _home(v: View) -> Any:
    if not v.sense.global_ok:
        return None
    home = v.autopilot.home or (0.0, 0.0, 0.0)
    lat, lon = v.estimate.to_globe(home)
    altitude = v.autopilot.globe.altitude_m - home[2]
    return mavlink.MAVLink_home_position_message(
        round(lat * 1e7), round(lon * 1e7), round(altitude * 1000), *home, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0
    )


def estimator_flags(position_ok: bool, global_ok: bool) -> int:
    """ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS: attitude and heights always, the rest by what is known."""
    flags = 0x1 | 0x4 | 0x20
    if position_ok:
        flags |= 0x2 | 0x8 | 0x100
    return flags | (0x10 | 0x200 if global_ok else 0) | (0 if position_ok else 0x80)


def _estimator(v: View) -> Any:
    accuracy = max(v.noise_m, 0.01) if v.sense.position_ok else 10.0
    flags = estimator_flags(v.sense.position_ok, v.sense.global_ok)
    return mavlink.MAVLink_estimator_status_message(v.unix_us, flags, 0.1, 0.1, 0.1, 0.1, 0.0, 0.0, accuracy, accuracy)


def _ekf(v: View) -> Any:
    flags = estimator_flags(v.sense.position_ok, v.sense.global_ok)
    return mavlink.MAVLink_ekf_status_report_message(flags, 0.1, 0.1 if v.sense.position_ok else 2.0, 0.1, 0.1, 0.0)


def _hud(v: View) -> Any:
    speed = math.hypot(v.sense.velocity[0], v.sense.velocity[1])
    return mavlink.MAVLink_vfr_hud_message(
        speed, speed, _heading_cdeg(v) // 100, 50 if v.autopilot.armed else 0, _altitude_m(v), -v.sense.velocity[2]
    )


def _time(v: View) -> Any:
    return mavlink.MAVLink_system_time_message(v.unix_us, v.boot_ms)


def _vibration(v: View) -> Any:
    size = 0.02 if v.autopilot.landed else 5.0
    return mavlink.MAVLink_vibration_message(v.unix_us, size, size, size, 0, 0, 0)


CAPABILITIES = (
    mavlink.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
    | mavlink.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
    | mavlink.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
    | mavlink.MAV_PROTOCOL_CAPABILITY_MAVLINK2
)


def _version(v: View) -> Any:
    px4 = v.autopilot.params.bytewise
    encoding = (
        mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_ENCODE_BYTEWISE if px4 else mavlink.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
    )
    release = 0x011000FF if px4 else 0x040600FF  # 1.16.0 and 4.6.0, released
    return mavlink.MAVLink_autopilot_version_message(
        CAPABILITIES | encoding, release, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0xC0BC5
    )


MAKERS: Mapping[int, Callable[[View], Any]] = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: heartbeat,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: _attitude,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _global,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: _gps,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    mavlink.MAVLINK_MSG_ID_BATTERY_STATUS: _battery,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: _home,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator,
    mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _ekf,
    mavlink.MAVLINK_MSG_ID_VFR_HUD: _hud,
    mavlink.MAVLINK_MSG_ID_SYSTEM_TIME: _time,
    mavlink.MAVLINK_MSG_ID_VIBRATION: _vibration,
    mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION: _version,
}


class Streams:
    """When which message is due."""

    def __init__(self, rates_hz: Mapping[int, float]) -> None:
        self._default = dict(rates_hz)
        self._interval = {m: 1.0 / hz for m, hz in rates_hz.items() if hz > 0}
        self._interval[mavlink.MAVLINK_MSG_ID_HEARTBEAT] = 1.0
        self._due: dict[int, float] = {}

    def set_interval(self, message: int, interval_us: float) -> bool:
        """As MAV_CMD_SET_MESSAGE_INTERVAL: -1 stops it, 0 is the default; False where there is no such message."""
        if message not in MAKERS or message == mavlink.MAVLINK_MSG_ID_HEARTBEAT:
            return False
        self._due.pop(message, None)
        hz = self._default.get(message, 0.0) if interval_us == 0 else 1e6 / interval_us if interval_us > 0 else 0.0
        if hz > 0.0:
            self._interval[message] = 1.0 / hz
        else:
            self._interval.pop(message, None)
        return True

    def interval_us(self, message: int) -> int:
        """As MESSAGE_INTERVAL has it: -1 is off, 0 unknown."""
        if message not in MAKERS:
            return 0
        return round(1e6 * self._interval[message]) if message in self._interval else -1

    def due(self, now_s: float) -> list[int]:
        """What is to be sent now."""
        found = []
        for message, interval_s in self._interval.items():
            at_s = self._due.get(message, now_s)
            if now_s >= at_s:
                found.append(message)
                # no catching up after a pause
                self._due[message] = max(at_s + interval_s, now_s + 0.5 * interval_s)
        return found
