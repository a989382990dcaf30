"""CRTP, the Crazyflie's packet format: one packet a datagram, a header byte and at most 30 bytes of data.

Source: the docstring of ``cflib/crtp/udpdriver.py`` and ``docs/functional-areas/crtp`` of the Crazyflie firmware.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum

MAX_DATA = 30
"""Bytes of data in one packet at most."""
NULL = 0xFF
"""Header of the null packet, with which cflib probes for vehicles."""


class Port(IntEnum):
    """Who a packet is for."""

    CONSOLE = 0x0
    PARAM = 0x2
    SETPOINT = 0x3
    MEM = 0x4
    LOG = 0x5
    LOCALIZATION = 0x6
    SETPOINT_GENERIC = 0x7
    SETPOINT_HL = 0x8
    SUPERVISOR = 0x9
    PLATFORM = 0xD
    LINK = 0xF


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet.

    Attributes:
        port: 0..15, see ``Port``.
        channel: 0..3.
        data: at most 30 bytes.
    """

    port: int
    channel: int
    data: bytes = b""

    def encode(self) -> bytes:
        """As a datagram."""
        return bytes(((self.port & 0xF) << 4 | (self.channel & 0x3),)) + self.data[:MAX_DATA]


def decode(datagram: bytes) -> Packet | None:
    """The packet in a datagram; None where it is none (empty or too long)."""
    if not 1 <= len(datagram) <= 1 + MAX_DATA:
        return None
    header = datagram[0]
    return Packet(header >> 4, header & 0x3, datagram[1:])


def decompress_quaternion(compressed: int) -> tuple[float, float, float, float]:
    """A unit quaternion (x, y, z, w) from 32 bits: index of the largest element, then the others, 10 bits each.

    Source: ``quatcompress.h`` of the firmware.
    """
    q = [0.0, 0.0, 0.0, 0.0]
    largest = compressed >> 30
    squares = 0.0
    for i in (3, 2, 1, 0):
        if i == largest:
            continue
        size = (compressed & 0x1FF) / 0x1FF * math.sqrt(0.5)
        q[i] = -size if compressed & 0x200 else size
        squares += size * size
        compressed >>= 10
    q[largest] = math.sqrt(max(0.0, 1.0 - squares))
    return (q[0], q[1], q[2], q[3])


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Heading of a quaternion, rad."""
    return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
