"""The command protocol of the simulated MAVLink vehicles: orders, answers, repetitions, parameters, refusals.

An order that is repeated with a higher confirmation is answered again but does not act again (mavlink.io, command
protocol). Set-points have no answer.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from sim_backends.wire.mavlink_autopilot import (
    ACCEPTED,
    CRITICAL,
    DENIED,
    IN_PROGRESS,
    INFO,
    REJECTED,
    UNSUPPORTED,
    WARNING,
    Autopilot,
    Order,
    whole,
)  # fmt: skip
from sim_backends.wire.mavlink_guidance import Sense
from sim_backends.wire.mavlink_link import mavlink
from sim_backends.wire.mavlink_params import HASH_NAME, UINT32, encode
from sim_backends.wire.mavlink_setpoints import Target
from sim_backends.wire.mavlink_streams import DATA_STREAMS, MAKERS, STREAM_PARAMS, Streams

REPEAT_S = 5.0
"""A repetition within this time of the first is the same order."""
CALIBRATION_S = 2.0
"""How long a simulated calibration takes; it reports IN_PROGRESS meanwhile."""
PARAMS_PER_TURN = 2
"""At 50 turns a second a hundred a second, as on a real link."""
SCALED = 1e7
LOCAL_FRAMES = (1, 7, 8, 9, 20, 21)


class Commands:
    """Everything that a ground station may ask; one ``handle`` per message, one ``step`` per turn."""

    def __init__(
        self, autopilot: Autopilot, streams: Streams, send: Callable[[Any], None], reboot: Callable[[], None]
    ) -> None:
        """Serves one autopilot.

        Args:
            autopilot: that obeys.
            streams: whose rates are asked for.
            send: takes messages.
            reboot: restarts the autopilot.
        """
        self._autopilot, self._streams, self._send, self._reboot = autopilot, streams, send, reboot
        self._last: dict[tuple[int, int, int], tuple[float, Order, int]] = {}
        self._listing: int | None = None
        self._wanted: list[int] = []
        self._calibration: tuple[float, int, int] | None = None

    def wanted(self) -> list[int]:
        """Messages that were asked for once."""
        found, self._wanted = self._wanted, []
        return found

    def step(self, now_s: float) -> None:
        """Sends what takes several turns."""
        if self._calibration is not None and now_s >= self._calibration[0]:
            _, system, component = self._calibration
            self._calibration = None
            self._ack(mavlink.MAV_CMD_PREFLIGHT_CALIBRATION, ACCEPTED, system, component)
        for _ in range(PARAMS_PER_TURN):
            if self._listing is None:
                return
            names = self._autopilot.params.names
            if self._listing < 0:
                self._send_hash(len(names))
            elif self._listing < len(names):
                self._send_param(names[self._listing])
            self._listing = self._listing + 1 if self._listing + 1 < len(names) else None

    def handle(self, message: Any, sense: Sense) -> bool:
        """Answers a message; False where it is none of these."""
        handler = _HANDLERS.get(message.get_type())
        if handler is None:
            return False
        handler(self, message, sense)
        return True

    # commands

    def command_long(self, m: Any, sense: Sense) -> None:
        """COMMAND_LONG."""
        p = (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7)
        self._command(m, Order(m.command, p), m.confirmation, sense)

    def command_int(self, m: Any, sense: Sense) -> None:
        """COMMAND_INT; a place that is not given is INT32_MAX there."""
        scale = 1e4 if m.frame in LOCAL_FRAMES else SCALED
        x, y = (math.nan if v == 2**31 - 1 else v / scale for v in (m.x, m.y))
        p = (m.param1, m.param2, m.param3, m.param4, x, y, m.z)
        self._command(m, Order(m.command, p, frame=m.frame, is_int=True), 0, sense)

    def _command(self, m: Any, order: Order, confirmation: int, sense: Sense) -> None:
        system, component = m.get_srcSystem(), m.get_srcComponent()
        key = (system, component, order.command)
        known = self._last.get(key)
        if (
            confirmation > 0
            and known is not None
            and repr(known[1]) == repr(order)  # NaN is not equal to itself
            and sense.now_s - known[0] <= REPEAT_S
            and known[2] in (ACCEPTED, IN_PROGRESS)  # what was refused may be possible by now
        ):
            self._ack(order.command, known[2], system, component)
            return
        result = self._obey(order, sense, system, component)
        self._last[key] = (sense.now_s, order, result)
        self._ack(order.command, result, system, component)

    def _ack(self, command: int, result: int, system: int, component: int) -> None:
        self._send(mavlink.MAVLink_command_ack_message(command, result, 255, 0, system, component))

    def _obey(self, order: Order, sense: Sense, system: int, component: int) -> int:
        p = order.p
        match order.command:
            case mavlink.MAV_CMD_REQUEST_MESSAGE:
                return self._request(whole(p[0]))
            case mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES:
                return self._request(mavlink.MAVLINK_MSG_ID_AUTOPILOT_VERSION)
            case mavlink.MAV_CMD_GET_HOME_POSITION:
                return self._request(mavlink.MAVLINK_MSG_ID_HOME_POSITION)
            case mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
                return ACCEPTED if self._streams.set_interval(whole(p[0]), p[1]) else DENIED
            case mavlink.MAV_CMD_GET_MESSAGE_INTERVAL:
                if not 0 <= whole(p[0]) <= 0xFFFF:
                    return DENIED
                interval = self._streams.interval_us(whole(p[0]))
                self._send(mavlink.MAVLink_message_interval_message(whole(p[0]), interval))
                return ACCEPTED
            case mavlink.MAV_CMD_PREFLIGHT_CALIBRATION:
                if self._autopilot.armed:
                    return REJECTED
                self._calibration = (sense.now_s + CALIBRATION_S, system, component)
                return IN_PROGRESS
            case mavlink.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN:
                if self._autopilot.armed or whole(p[0]) != 1:
                    return DENIED
                self._reboot()
                return ACCEPTED
            case mavlink.MAV_CMD_MISSION_START:
                self._autopilot.say(CRITICAL, "Mission start denied! No valid mission")
                return DENIED
        return self._autopilot.order(order, sense)

    def _request(self, message: int) -> int:
        if message not in MAKERS:
            return UNSUPPORTED
        self._wanted.append(message)
        return ACCEPTED

    def set_mode(self, m: Any, sense: Sense) -> None:
        """SET_MODE; each firmware answers it in its own way."""
        done = bool(m.base_mode & 1) and self._autopilot.set_custom_mode(m.custom_mode, sense)
        px4 = self._autopilot.params.bytewise
        command = mavlink.MAV_CMD_DO_SET_MODE if px4 else mavlink.MAVLINK_MSG_ID_SET_MODE
        self._ack(command, ACCEPTED if done else REJECTED if px4 else 4, m.get_srcSystem(), m.get_srcComponent())

    # set-points

    def local_target(self, m: Any, sense: Sense) -> None:
        """SET_POSITION_TARGET_LOCAL_NED."""
        self._target(m, False, (m.x, m.y, m.z), sense)

    def global_target(self, m: Any, sense: Sense) -> None:
        """SET_POSITION_TARGET_GLOBAL_INT."""
        self._target(m, True, (m.lat_int / SCALED, m.lon_int / SCALED, m.alt), sense)

    def _target(self, m: Any, globe: bool, position: tuple[float, float, float], sense: Sense) -> None:
        target = Target(
            globe, m.coordinate_frame, m.type_mask, position, (m.vx, m.vy, m.vz), (m.afx, m.afy, m.afz),
            m.yaw, m.yaw_rate,
        )  # fmt: skip
        self._autopilot.set_point(target, sense)

    # parameters

    def param_list(self, m: Any, sense: Sense) -> None:
        """PARAM_REQUEST_LIST; PX4 begins with its check word."""
        self._listing = -1 if self._autopilot.params.bytewise else 0

    def param_read(self, m: Any, sense: Sense) -> None:
        """PARAM_REQUEST_READ; an unknown name has no answer, as in both firmwares."""
        params = self._autopilot.params
        name = m.param_id
        if m.param_index >= 0:
            name = params.names[m.param_index] if m.param_index < len(params.names) else ""
        if name == HASH_NAME and params.bytewise:
            self._send_hash(len(params.names))
        elif name in params:
            self._send_param(name)
        elif params.bytewise and m.param_index >= 0:
            self._autopilot.say(INFO, f"[pm] unknown param ID: {m.param_index}")

    def param_set(self, m: Any, sense: Sense) -> None:
        """PARAM_SET; the answer holds the value that is in effect."""
        params, name = self._autopilot.params, m.param_id
        if name == HASH_NAME and params.bytewise:
            self._listing = None
            return
        if name not in params:
            if params.bytewise:
                self._autopilot.say(INFO, f"[pm] unknown param: {name}")
            return
        params.put_wire(name, m.param_value)
        self._send_param(name)
        if name in STREAM_PARAMS:
            self._set_stream(STREAM_PARAMS[name], params[name])

    def _send_param(self, name: str) -> None:
        params = self._autopilot.params
        self._send(
            mavlink.MAVLink_param_value_message(
                name.encode(), params.wire(name), params.types[name], len(params.names), params.names.index(name)
            )
        )

    def _send_hash(self, count: int) -> None:
        word = encode(UINT32, self._autopilot.params.hash, bytewise=True)
        self._send(mavlink.MAVLink_param_value_message(HASH_NAME.encode(), word, UINT32, count, 65535))

    def data_stream(self, m: Any, sense: Sense) -> None:
        """REQUEST_DATA_STREAM; PX4 has done away with it."""
        if self._autopilot.params.bytewise:
            return
        rate = m.req_message_rate if m.start_stop else 0
        for stream in DATA_STREAMS if m.req_stream_id == 0 else (m.req_stream_id,):
            self._set_stream(stream, rate)

    def _set_stream(self, stream: int, rate_hz: float) -> None:
        for message in DATA_STREAMS.get(stream, ()):
            self._streams.set_interval(message, 1e6 / rate_hz if rate_hz > 0 else -1)

    # missions: this vehicle has none

    def refuse_mission(self, m: Any, sense: Sense) -> None:
        """Whatever would put a mission on board."""
        self._autopilot.say(WARNING, "Mission upload not supported: steer it by set-points")
        self._mission_ack(m, mavlink.MAV_MISSION_UNSUPPORTED)

    def clear_mission(self, m: Any, sense: Sense) -> None:
        """MISSION_CLEAR_ALL: there is nothing to clear."""
        self._mission_ack(m, mavlink.MAV_MISSION_ACCEPTED)

    def _mission_ack(self, m: Any, result: int) -> None:
        kind = getattr(m, "mission_type", 0)
        self._send(mavlink.MAVLink_mission_ack_message(m.get_srcSystem(), m.get_srcComponent(), result, kind))

    def list_mission(self, m: Any, sense: Sense) -> None:
        """MISSION_REQUEST_LIST: none."""
        kind = getattr(m, "mission_type", 0)
        self._send(mavlink.MAVLink_mission_count_message(m.get_srcSystem(), m.get_srcComponent(), 0, kind))


_HANDLERS: dict[str, Callable[[Commands, Any, Sense], None]] = {
    "COMMAND_LONG": Commands.command_long,
    "COMMAND_INT": Commands.command_int,
    "SET_MODE": Commands.set_mode,
    "SET_POSITION_TARGET_LOCAL_NED": Commands.local_target,
    "SET_POSITION_TARGET_GLOBAL_INT": Commands.global_target,
    "PARAM_REQUEST_LIST": Commands.param_list,
    "PARAM_REQUEST_READ": Commands.param_read,
    "PARAM_SET": Commands.param_set,
    "REQUEST_DATA_STREAM": Commands.data_stream,
    "MISSION_COUNT": Commands.refuse_mission,
    "MISSION_ITEM": Commands.refuse_mission,
    "MISSION_ITEM_INT": Commands.refuse_mission,
    "MISSION_WRITE_PARTIAL_LIST": Commands.refuse_mission,
    "MISSION_CLEAR_ALL": Commands.clear_mission,
    "MISSION_REQUEST_LIST": Commands.list_mission,
}
