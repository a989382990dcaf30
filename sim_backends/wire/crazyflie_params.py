"""The Crazyflie's parameters: read, written by id or by name, stored, with defaults and extended types.

Source: ``src/modules/src/param_logic.c`` of the firmware, ``cflib/crazyflie/param.py``.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable
from dataclasses import dataclass

from sim_backends.wire.crtp_toc import Toc

TOC, READ, WRITE, MISC = range(4)
(
    SET_BY_NAME,
    VALUE_UPDATED,
    GET_EXTENDED_TYPE,
    PERSISTENT_STORE,
    PERSISTENT_STATE,
    PERSISTENT_CLEAR,
    GET_DEFAULT,
    GET_EXTENDED_TYPE_V2,
    GET_DEFAULT_V2,
) = range(9)
CODES = {"b": 0x00, "h": 0x01, "i": 0x02, "f": 0x06, "B": 0x08, "H": 0x09, "I": 0x0A}
EXTENDED, READ_ONLY = 0x10, 0x40
PERSISTENT = 0x01


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter.

    Attributes:
        name: ``group.name``.
        kind: its type as a letter of ``struct``.
        default: value after a reboot.
        read_only: cannot be written.
        persistent: can be stored, and survives a reboot then.
    """

    name: str
    kind: str
    default: float
    read_only: bool = False
    persistent: bool = False

    @property
    def code(self) -> int:
        """Type byte in the table of contents."""
        return CODES[self.kind] | (READ_ONLY if self.read_only else 0) | (EXTENDED if self.persistent else 0)

    def pack(self, value: float) -> bytes:
        """``value`` as it is sent."""
        return struct.pack("<" + self.kind, value if self.kind == "f" else int(value))


PARAMS = (
    Param("activeMarker.mode", "B", 0),
    Param("commander.enHighLevel", "B", 1),
    Param("cpu.flash", "H", 1024, read_only=True),
    Param("cpu.id0", "I", 0x00C0FFEE, read_only=True),
    Param("cpu.id1", "I", 0x51A50000, read_only=True),
    Param("cpu.id2", "I", 0x20260800, read_only=True),
    Param("deck.bcFlow2", "B", 0, read_only=True),
    Param("deck.bcLighthouse4", "B", 0, read_only=True),
    Param("deck.bcLoco", "B", 0, read_only=True),
    Param("deck.bcActiveM", "B", 0, read_only=True),
    Param("firmware.modified", "B", 0, read_only=True),
    Param("firmware.revision0", "I", 0x20260800, read_only=True),
    Param("firmware.revision1", "H", 0, read_only=True),
    Param("flightmode.stabModePitch", "B", 1),
    Param("flightmode.stabModeRoll", "B", 1),
    Param("flightmode.stabModeYaw", "B", 0),
    Param("hlCommander.vland", "f", 0.5),
    Param("hlCommander.vtoff", "f", 0.5),
    Param("imu_sensors.AK8963", "B", 0, read_only=True),
    Param("imu_sensors.imuPresent", "B", 1, read_only=True),
    Param("kalman.initialX", "f", 0.0),
    Param("kalman.initialY", "f", 0.0),
    Param("kalman.initialYaw", "f", 0.0),
    Param("kalman.initialZ", "f", 0.0),
    Param("kalman.resetEstimation", "B", 0),
    Param("led.bitmask", "B", 0),
    Param("locSrv.enLhAngleStream", "B", 0),
    Param("locSrv.enRangeStreamFP32", "B", 0),
    Param("locSrv.extPosStdDev", "f", 0.01),
    Param("locSrv.extQuatStdDev", "f", 4.5e-3),
    Param("motorPowerSet.enable", "B", 0),
    Param("motorPowerSet.m1", "H", 0),
    Param("pm.criticalLowVoltage", "f", 3.0),
    Param("pm.lowVoltage", "f", 3.2),
    Param("posCtlPid.xVelMax", "f", 1.0),
    Param("posCtlPid.yVelMax", "f", 1.0),
    Param("posCtlPid.zVelMax", "f", 1.0),
    Param("ring.effect", "B", 6, persistent=True),
    Param("sound.effect", "B", 0),
    Param("stabilizer.controller", "B", 1),
    Param("stabilizer.estimator", "B", 2),
    Param("stabilizer.stop", "B", 0),
    Param("supervisor.infdmp", "B", 0),
    Param("supervisor.landedTimeout", "H", 3000, persistent=True),
    Param("supervisor.prefltTimeout", "H", 30000, persistent=True),
    Param("supervisor.tmblChckEn", "B", 1),
    Param("system.selftestPassed", "B", 1, read_only=True),
    Param("system.taskDump", "B", 0),
)


class Params:
    """The values of all parameters, and the answers to requests about them."""

    def __init__(self, changed: Callable[[str, float], None], params: tuple[Param, ...] = PARAMS) -> None:
        """Starts with the defaults.

        Args:
            changed: is told each value that was written.
            params: the table.
        """
        self._params, self._changed = params, changed
        self.values: dict[str, float] = {p.name: p.default for p in params}
        self.stored: dict[str, float] = {}
        self._toc = Toc([(p.code, p.name) for p in params])

    def restore(self, stored: dict[str, float]) -> None:
        """What a reboot finds in the storage."""
        self.stored = dict(stored)
        self.values.update(stored)

    def answer(self, channel: int, data: bytes) -> bytes | None:
        """Answers a packet on the parameters' port; None where the firmware says nothing."""
        if channel == TOC:
            return self._toc.answer(data)
        if channel == MISC:
            return self._misc(data)
        if len(data) < 2:
            return None
        param = self._param(data)
        if param is None:
            return data[:2] + bytes((errno.ENOENT,))
        if channel == READ:
            return data[:2] + b"\0" + param.pack(self.values[param.name])
        size = struct.calcsize("<" + param.kind)
        if param.read_only or len(data) < 2 + size:
            return None
        self._set(param, data[2 : 2 + size])
        return data[:2] + param.pack(self.values[param.name])

    def _param(self, data: bytes) -> Param | None:
        (index,) = struct.unpack_from("<H", data)
        return self._params[index] if index < len(self._params) else None

    def _set(self, param: Param, raw: bytes) -> None:
        (value,) = struct.unpack("<" + param.kind, raw)
        self.values[param.name] = value
        self._changed(param.name, value)

    def _misc(self, data: bytes) -> bytes | None:
        command = data[0] if data else -1
        if command == SET_BY_NAME:
            return self._set_by_name(data)
        if len(data) < 3:
            return None
        param = self._param(data[1:])
        missing = data[:3] + bytes((errno.ENOENT,))
        if command == GET_EXTENDED_TYPE:
            return data[:3] + bytes((PERSISTENT,)) if param and param.persistent else missing
        if command == GET_EXTENDED_TYPE_V2:
            return data[:3] + bytes((0, PERSISTENT)) if param and param.persistent else missing
        if command == GET_DEFAULT:
            return data[:3] + param.pack(param.default) if param and not param.read_only else missing
        if command == GET_DEFAULT_V2:
            return data[:3] + b"\0" + param.pack(param.default) if param and not param.read_only else missing
        if param is None or not param.persistent:
            return missing
        if command == PERSISTENT_STORE:
            self.stored[param.name] = self.values[param.name]
            return data[:3] + b"\0"
        if command == PERSISTENT_CLEAR:
            self.stored.pop(param.name, None)
            return data[:3] + b"\0"
        if command == PERSISTENT_STATE:
            if param.name in self.stored:
                return data[:3] + b"\1" + param.pack(param.default) + param.pack(self.stored[param.name])
            return data[:3] + b"\0" + param.pack(param.default)
        return None

    def _set_by_name(self, data: bytes) -> bytes | None:
        parts = data[1:].split(b"\0", 2)
        if len(parts) < 3 or not parts[2]:
            return None
        head = data[: 1 + len(parts[0]) + 1 + len(parts[1]) + 1]
        name = f"{parts[0].decode('latin-1')}.{parts[1].decode('latin-1')}"
        param = next((p for p in self._params if p.name == name), None)
        if param is None:
            return head + bytes((errno.ENOENT,))
        raw = parts[2][1:]
        if parts[2][0] & 0x0F != CODES[param.kind] or len(raw) != struct.calcsize("<" + param.kind):
            return head + bytes((errno.EINVAL,))
        if param.read_only:
            return head + bytes((errno.EACCES,))
        self._set(param, raw)
        return head + b"\0"
