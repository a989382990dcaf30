"""The localisation port: poses from outside, and the old way to an emergency stop.

Source: ``crtp_localization_service.c`` of the firmware, ``cflib/crazyflie/localization.py``.
"""

from __future__ import annotations

import math
import struct
from typing import TYPE_CHECKING

from drivers.vehicle import Vec3
from sim_backends.wire.crtp_packets import decompress_quaternion, yaw_of
from sim_backends.wire.world import Quaternion

if TYPE_CHECKING:
    from sim_backends.wire.crazyflie_firmware import Firmware

POSITION, GENERIC, POSITION_PACKED = range(3)
EMERGENCY_STOP, EMERGENCY_WATCHDOG, EXT_POSE, EXT_POSE_PACKED = 3, 4, 8, 9
LEVEL = (0.0, 0.0, 0.0, 1.0)


class Localization:
    """Takes the packets and keeps what is logged as ``locSrv`` and ``locSrvZ``."""

    def __init__(self, firmware: Firmware, address: int) -> None:
        """Starts without poses.

        Args:
            firmware: whose estimator and supervisor are told.
            address: its id in packed packets.
        """
        self._firmware, self._address = firmware, address
        self.position_m: Vec3 = (0.0, 0.0, 0.0)
        self.quaternion: Quaternion = LEVEL
        self.tick_ms = 0

    def take(self, channel: int, data: bytes) -> None:
        """Obeys a packet; a malformed one is ignored."""
        try:
            self._take(channel, data)
        except struct.error:
            return

    def _take(self, channel: int, data: bytes) -> None:
        if channel == POSITION:
            x, y, z = struct.unpack_from("<fff", data)
            self._pose((x, y, z), None)
        elif channel == POSITION_PACKED:
            for at in range(0, len(data) - 6, 7):
                ident, x, y, z = struct.unpack_from("<Bhhh", data, at)
                if ident == self._address:
                    self._pose((x / 1000, y / 1000, z / 1000), None)
        elif channel == GENERIC and data:
            self._generic(data[0], data[1:])

    def _generic(self, kind: int, data: bytes) -> None:
        supervisor = self._firmware.supervisor
        if kind == EMERGENCY_STOP:
            supervisor.emergency_stop()
        elif kind == EMERGENCY_WATCHDOG:
            supervisor.watchdog(self._firmware.now_s)
        elif kind == EXT_POSE:
            x, y, z, *q = struct.unpack_from("<fffffff", data)
            self._pose((x, y, z), (q[0], q[1], q[2], q[3]))
        elif kind == EXT_POSE_PACKED:
            for at in range(0, len(data) - 10, 11):
                ident, x, y, z, packed = struct.unpack_from("<BhhhI", data, at)
                if ident == self._address:
                    self._pose((x / 1000, y / 1000, z / 1000), decompress_quaternion(packed))

    def _pose(self, at_m: Vec3, q: Quaternion | None) -> None:
        self.tick_ms = int(1000.0 * self._firmware.now_s)
        if not all(map(math.isfinite, (*at_m, *(q or LEVEL)))):
            return
        self.position_m, self.quaternion = at_m, q or LEVEL
        body, params = self._firmware.body, self._firmware.params
        std_m = max(1e-4, params.values["locSrv.extPosStdDev"])
        yaw = None if q is None else yaw_of(*q)
        self._firmware.estimator.pose(at_m, yaw, body.position_m, body.rpy[2], std_m)
