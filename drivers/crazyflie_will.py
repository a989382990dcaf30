"""The last will of a Crazyflie: it lands where it is, by the guardian's own link, when the ground station has died.

Its high-level commander flies on without us, but nobody hands it poses any more: its estimate drifts from the first
second, so it comes down at once and quickly. No tables are downloaded; a landing is one packet.
"""

from __future__ import annotations

import struct
import time

from drivers.crazyflie_bits import decode
from drivers.crazyflie_flight import BLIND_BELOW_M, BLIND_MPS
from drivers.crazyflie_link import SUPERVISOR_PROTOCOL, BareLink, load
from drivers.crazyflie_motion import PEAK_SPEED
from drivers.errors import DriverError
from drivers.last_will import Arguments

HIGH_LEVEL, GENERIC, SUPERVISOR = 0x08, 0x07, 0x09
LAND, ALL_GROUPS = 8, 0
NOTIFY_SETPOINT_STOP = b"\x00" + struct.pack("<I", 0)
STATE_BITS = 0x0C
ANSWER = 0x80
LEAST_S = 1.0
EVERY_S = 0.15
OPEN_EVERY_S = 0.3
SETTLE_S = 3.0
"""``flying`` lags a landing by 2 s."""


def prepare() -> None:
    """Loads cflib."""
    load()


def carry_out(arguments: Arguments, height_m: float, deadline_s: float) -> str:
    """Lands it where it is.

    Args:
        arguments: ``uri``, and ``protocol``, the firmware's CRTP version.
        height_m: above the ground.
        deadline_s: when to give up, ``time.monotonic()``.

    Returns:
        what became of it.

    Raises:
        DriverError: when it cannot be reached.
    """
    link = _open(str(arguments["uri"]), deadline_s)
    try:
        return _land(link, int(arguments.get("protocol") or -1), height_m, deadline_s)
    finally:
        link.close()  # without cflib's goodbye, which is a set-point of zero


def duration_s(height_m: float) -> float:
    """How long a landing takes that, as the driver's own without poses, aims below the floor."""
    return max(LEAST_S, PEAK_SPEED * (height_m + BLIND_BELOW_M) / BLIND_MPS)


def _open(uri: str, deadline_s: float) -> BareLink:
    """The dead program's radio is released by the kernel in a moment: tried until then."""
    while True:
        try:
            return BareLink(uri)
        except DriverError:
            if time.monotonic() > deadline_s:
                raise
        time.sleep(OPEN_EVERY_S)


def _land(link: BareLink, protocol: int, height_m: float, deadline_s: float) -> str:
    takes_s = duration_s(height_m)
    # absolute height, heading kept
    landing = struct.pack("<BBff?f", LAND, ALL_GROUPS, -BLIND_BELOW_M, 0.0, True, takes_s)
    begun_s, asked_s = time.monotonic(), -EVERY_S
    ordered_s: float | None = None
    flying: bool | None = None
    heard = False
    while (now_s := time.monotonic()) < deadline_s:
        if now_s - asked_s >= EVERY_S:
            asked_s = now_s
            if ordered_s is None:
                # a set-point from somebody's joystick would outrank the landing
                link.send(GENERIC, 1, NOTIFY_SETPOINT_STOP)
                link.send(HIGH_LEVEL, 0, landing)
            if protocol >= SUPERVISOR_PROTOCOL:
                link.send(SUPERVISOR, 0, bytes((STATE_BITS,)))
        for port, channel, data in link.receive(0.02):
            heard = True
            if port == HIGH_LEVEL and len(data) >= 4 and data[0] == LAND and data[3] == 0 and ordered_s is None:
                ordered_s = time.monotonic()
            if port == SUPERVISOR and channel == 0 and len(data) >= 3 and data[0] == STATE_BITS | ANSWER:
                bits = decode(int.from_bytes(data[1:3], "little"))
                if bits.locked or bits.tumbled or bits.crashed:
                    return "lies on the ground, its motors are off"
                flying = bits.flying
        # who has just begun to take off does not say yet that it flies
        if flying is False and now_s > (begun_s + SETTLE_S if ordered_s is None else ordered_s + LEAST_S):
            return "landed" if ordered_s is not None else "was on the ground"
        if flying is None and ordered_s is not None and now_s > ordered_s + takes_s + SETTLE_S:
            return "was told to land, and had the time for it"
    if ordered_s is not None:
        return "was told to land, but still says that it flies"
    raise DriverError("it refuses to land" if heard else f"nothing answers at {link.uri}")
