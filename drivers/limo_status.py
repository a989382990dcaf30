"""AgileX' ``limo_msgs/msg/LimoStatus`` without a ROS workspace: its bytes on the wire, and what they mean.

No package with this message can be installed with pip, and building one needs a compiler. But a ROS 2 subscription can
hand over the bytes as they came (``raw``), and this message is simple: a header, three bytes, a double and an integer
in the Common Data Representation (OMG CDR, RTPS 2.3 section 10; the version that every ROS 2 release so far sends).
``limo_typesupport`` makes the type known to rclpy, this file reads and writes the bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

MOTION_MODES = ("differential", "ackermann", "mecanum")
"""By number; tracked counts as differential (``limo_protocol.h``: MODE_FOUR_DIFF, MODE_ACKERMANN, MODE_MCNAMU)."""
COMMANDED = 1
"""The ``control_mode`` in which it follows ``cmd_vel``; anything else is the remote control or stand-by."""
NORMAL = 0
"""The ``vehicle_state`` without emergency stop (1) and exception (2)."""
ERRORS = (
    (0x0001, "battery empty"),
    (0x0002, "battery low"),
    (0x0004, "remote control lost"),
    (0x0008, "motor driver 1"),
    (0x0010, "motor driver 2"),
    (0x0020, "motor driver 3"),
    (0x0040, "motor driver 4"),
    (0x0100, "drive status"),
)
"""Bits of ``error_code`` (``limo_driver.cpp``, processErrorCode)."""
HARMLESS = 0x0004
"""Nobody holds the remote control of a Limo that a computer drives."""
FULL_V, CUT_OFF_V = 12.6, 8.25
_CELLS = 3
_CURVE = (
    (2.75, 0.0), (3.2, 0.05), (3.38, 0.1), (3.52, 0.2), (3.6, 0.3), (3.65, 0.4), (3.72, 0.5), (3.8, 0.6),
    (3.88, 0.7), (3.97, 0.8), (4.07, 0.9), (4.2, 1.0),
)  # fmt: skip
"""Voltage of a Li-ion cell under a light load and the charge that is left: typical NMC; the ends are the manual's."""


@dataclass(frozen=True, slots=True)
class LimoStatus:
    """One status message; its time stamp is wrong on every Limo (seconds taken for nanoseconds) and of no use.

    Attributes:
        stamp_ns: header stamp as sent.
        vehicle_state: 0 is normal.
        control_mode: 1 is commanded by ROS.
        battery_v: in steps of 0.1 V.
        error_code: bits of ``ERRORS``.
        motion_mode: index into ``MOTION_MODES``.
        frame_id: of the header; empty.
    """

    stamp_ns: int
    vehicle_state: int
    control_mode: int
    battery_v: float
    error_code: int
    motion_mode: int
    frame_id: str = ""


def decode(data: bytes) -> LimoStatus:
    """Reads a message in CDR, either byte order.

    Raises:
        ValueError: when these bytes are no LimoStatus.
    """
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError(f"no plain CDR: begins with {data[:4].hex()}")
    order, body = "<" if data[1] else ">", data[4:]
    try:
        sec, nanosec, length = struct.unpack_from(order + "iII", body, 0)
        if not 0 < length <= len(body) - 12:
            raise ValueError(f"a frame id of {length} bytes in a message of {len(data)}")
        frame_id = body[12 : 12 + length - 1].decode("utf-8", "replace")
        at = 12 + length
        vehicle_state, control_mode = struct.unpack_from(order + "BB", body, at)
        at += 2 + -(at + 2) % 8
        battery_v, error_code, motion_mode = struct.unpack_from(order + "dHB", body, at)
    except struct.error as error:
        raise ValueError(f"too short: {len(data)} bytes") from error
    stamp_ns = sec * 1_000_000_000 + nanosec
    return LimoStatus(stamp_ns, vehicle_state, control_mode, battery_v, error_code, motion_mode, frame_id)


def encode(status: LimoStatus) -> bytes:
    """The message in little-endian CDR."""
    sec, nanosec = divmod(status.stamp_ns, 1_000_000_000)
    frame_id = status.frame_id.encode() + b"\0"
    body = struct.pack("<iII", sec, nanosec, len(frame_id)) + frame_id
    body += struct.pack("<BB", status.vehicle_state, status.control_mode)
    body += bytes(-len(body) % 8)
    body += struct.pack("<dHB", status.battery_v, status.error_code, status.motion_mode)
    return b"\x00\x01\x00\x00" + body


def errors(error_code: int) -> Sequence[str]:
    """The faults that ``error_code`` reports, in words; unknown bits as a number."""
    words = [word for bit, word in ERRORS if error_code & bit & ~HARMLESS]
    rest = error_code & ~sum(bit for bit, _ in ERRORS)
    return [*words, f"unknown error 0x{rest:04x}"] if rest else words


def charge(battery_v: float) -> float:
    """Share of the usable charge at a terminal voltage, 0..1; a step of 0.1 V is up to 0.05 of it."""
    cell = battery_v / _CELLS
    if cell <= _CURVE[0][0]:
        return 0.0
    for (low, a), (high, b) in pairwise(_CURVE):
        if cell <= high:
            return a + (b - a) * (cell - low) / (high - low)
    return 1.0
