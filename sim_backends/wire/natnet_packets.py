"""NatNet packets as Motive sends them, packed: pure, no socket, no clock.

Source: OptiTrack's NatNet SDK 4.1 (``NatNetTypes.h``, the ``PacketClient`` sample) and what libmotioncapture 1.1 parses
(``optitrack.cpp``). Little endian. From 4.1 on, every list is preceded by its size in bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.vehicle import Vec3

Up = Literal["y", "z"]
Version = tuple[int, int]

CONNECT, SERVER_INFO, REQUEST, RESPONSE, REQUEST_MODEL, MODEL, REQUEST_FRAME, FRAME = range(8)
DISCONNECT, UNRECOGNIZED = 9, 100
CLOCK_HZ = 10_000_000
"""Ticks per second of the time stamps, as Windows' performance counter has them."""

VERSIONS: tuple[Version, ...] = ((3, 1), (4, 1))
_VALID, _NO_PARENT = 1, -1
_ERROR_M = 0.0002  # a well-calibrated system's mean marker error
_RIGID_BODY = struct.Struct("<i8fh")
_NONE = struct.pack("<i", 0)


@dataclass(frozen=True, slots=True)
class Seen:
    """One rigid body of one frame.

    Attributes:
        number: streaming id, from 1.
        position_m: in the arena (z up).
        quaternion: x y z w.
        tracked: seen in this very frame; Motive goes on to send the body's last pose when it is not.
    """

    number: int
    position_m: Vec3
    quaternion: tuple[float, float, float, float]
    tracked: bool = True


def message_of(datagram: bytes) -> int | None:
    """Which request a datagram is, or None for garbage."""
    if len(datagram) < 4:
        return None
    kind, size = struct.unpack_from("<HH", datagram)
    # Motive accepts requests whose payload is longer than declared: clients send a whole buffer
    return int(kind) if size <= len(datagram) - 4 else None


def packet(kind: int, payload: bytes = b"") -> bytes:
    """A packet with its header."""
    return struct.pack("<HH", kind, len(payload) & 0xFFFF) + payload


def server_info(version: Version, data_port: int, group: str | None) -> bytes:
    """The answer to CONNECT: who serves, and where the frames go.

    Args:
        version: of NatNet.
        data_port: where a client listens.
        group: multicast address; None for unicast.
    """
    address = bytes(int(part) for part in (group or "0.0.0.0").split("."))
    application = b"Motive".ljust(256, b"\0") + bytes((3, 1, 0, 0)) + bytes((*version, 0, 0))
    tail = struct.pack("<QH?", CLOCK_HZ, data_port, group is not None) + address
    return packet(SERVER_INFO, application + tail + b"\0")


def model(version: Version, names: Sequence[str]) -> bytes:
    """The answer to REQUEST_MODEL: the rigid bodies, numbered from 1 in the order of ``names``."""
    parts = [struct.pack("<i", len(names))]
    for number, name in enumerate(names, 1):
        body = name.encode() + b"\0" + struct.pack("<ii3fi", number, _NO_PARENT, 0.0, 0.0, 0.0, 0)
        parts.append(struct.pack("<i", 1) + _sized(version, body))
    return packet(MODEL, b"".join(parts))


def frame(version: Version, number: int, bodies: Sequence[Seen], seen_s: float, sent_s: float, up: Up = "z") -> bytes:
    """One frame of rigid bodies.

    Args:
        version: of NatNet.
        number: of the frame.
        bodies: all that Motive knows, tracked or not.
        seen_s: when the cameras exposed, s on the server's clock.
        sent_s: when it is sent.
        up: Motive's streaming setting "Up Axis"; the arena's z is sent as y for ``y``.
    """
    rigid = b"".join(_rigid_body(body, up) for body in bodies)
    empty = _NONE + _sized(version, b"")
    modern = _sizes(version)
    ticks, received, sent = (round(t * CLOCK_HZ) for t in (seen_s, seen_s, sent_s))
    parts = [
        struct.pack("<i", number),
        empty * 2,  # marker sets, unlabelled markers
        struct.pack("<i", len(bodies)) + _sized(version, rigid),
        empty,  # skeletons
        empty if modern else b"",  # assets
        empty * 3,  # labelled markers, force plates, devices
        struct.pack("<IId3Q", 0, 0, seen_s, ticks, received, sent),
        bytes(8) if modern else b"",  # precision time stamp
        struct.pack("<hi", 0, 0),  # parameters of the frame, end of data
    ]
    return packet(FRAME, b"".join(parts))


def _rigid_body(body: Seen, up: Up) -> bytes:
    x, y, z = body.position_m
    qx, qy, qz, qw = body.quaternion
    if up == "y":  # turned by -90 deg about x: the arena's z becomes y, its y becomes -z
        y, z, qy, qz = z, -y, qz, -qy
    return _RIGID_BODY.pack(body.number, x, y, z, qx, qy, qz, qw, _ERROR_M, _VALID if body.tracked else 0)


def _sizes(version: Version) -> bool:
    return version >= (4, 1)


def _sized(version: Version, data: bytes) -> bytes:
    return struct.pack("<i", len(data)) + data if _sizes(version) else data
