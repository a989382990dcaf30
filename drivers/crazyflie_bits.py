"""What a Crazyflie's telemetry means: supervisor bits, charger and battery. Pure.

Sources: ``supervisor.c`` and ``pm.h`` of the firmware.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

Values = Mapping[str, float]

CHARGING_STATES = (1, 2)
"""``pm.state`` charging and charged."""
LIPO_CURVE = ((3.0, 0.0), (3.5, 0.1), (3.65, 0.25), (3.75, 0.5), (3.9, 0.75), (4.1, 1.0))
"""Usable share over volts under hovering load; 3.0 V is where a Crazyflie shuts down."""


@dataclass(frozen=True, slots=True)
class Bits:
    """The supervisor's view of the vehicle.

    Attributes:
        can_be_armed: an arming request would be accepted.
        armed: motors may turn.
        auto_arm: it arms itself (brushed motors).
        can_fly: its own readiness; says nothing about the estimate.
        flying: lags a real landing by about 2 s.
        tumbled, locked, crashed: motors stay off; locked needs a reboot.
        hl_active: the high-level commander flies.
        hl_finished: its last motion is over; None where the firmware does not tell.
        deck_fault: an expansion deck failed its test.
    """

    can_be_armed: bool = False
    armed: bool = False
    auto_arm: bool = False
    can_fly: bool = False
    flying: bool = False
    tumbled: bool = False
    locked: bool = False
    crashed: bool = False
    hl_active: bool = False
    hl_finished: bool | None = None
    deck_fault: bool = False


def decode(info: int) -> Bits:
    """``supervisor.info`` as bits; bits 8 and up came with protocol 12 and read as 0 before."""
    bit = [bool(info >> i & 1) for i in range(12)]
    tells = bit[8] or bit[9] or bit[10]
    return Bits(
        can_be_armed=bit[0],
        armed=bit[1],
        auto_arm=bit[2],
        can_fly=bit[3],
        flying=bit[4],
        tumbled=bit[5],
        locked=bit[6],
        crashed=bit[7],
        hl_active=bit[8],
        hl_finished=bit[9] if tells else None,
        deck_fault=bit[11],
    )


def bits_of(values: Values) -> Bits | None:
    """The bits from whatever the firmware logs; None where it logs nothing of the kind.

    Firmware before 2023.07 has no ``supervisor.info`` but ``sys.canfly``, ``sys.isFlying`` and ``sys.isTumbled``; it
    knows no arming: whoever can fly there is armed.
    """
    if "supervisor.info" in values:
        return decode(int(values["supervisor.info"]))
    if "sys.canfly" not in values:
        return None
    can_fly = bool(values["sys.canfly"])
    flying, tumbled = bool(values.get("sys.isFlying", 0)), bool(values.get("sys.isTumbled", 0))
    return Bits(can_fly, can_fly, True, can_fly, flying, tumbled)


def charging_of(values: Values) -> bool | None:
    """Whether the charger works; None where ``pm.state`` is not logged."""
    state = values.get("pm.state")
    return None if state is None else int(state) in CHARGING_STATES


def battery_of(values: Values, curve: Sequence[tuple[float, float]] | None) -> float | None:
    """Usable energy left, 0..1.

    Args:
        values: newest log values; ``pm.batteryLevel`` is in percent, ``pm.vbat`` in V.
        curve: (V, share) with rising volts; None takes the vehicle's own level where it has one.
    """
    volts, level = values.get("pm.vbat"), values.get("pm.batteryLevel")
    if level is not None and (curve is None or volts is None):
        return min(max(level / 100.0, 0.0), 1.0)
    return None if volts is None else interpolate(curve or LIPO_CURVE, volts)


def interpolate(curve: Sequence[tuple[float, float]], volts: float) -> float:
    """The share at ``volts``, linear between the points of the curve and flat beyond them."""
    i = bisect_right([v for v, _ in curve], volts)
    if i == 0 or i == len(curve):
        return curve[min(i, len(curve) - 1)][1]
    (v0, s0), (v1, s1) = curve[i - 1], curve[i]
    return s0 + (s1 - s0) * (volts - v0) / (v1 - v0)


def is_curve(curve: Sequence[tuple[float, float]]) -> bool:
    """Whether it has two points or more, rising volts and shares within 0..1."""
    rising = all(a[0] < b[0] for a, b in pairwise(curve))
    return len(curve) >= 2 and rising and all(0.0 <= share <= 1.0 for _, share in curve)


def words(bits: Bits) -> str | None:
    """What is wrong by the vehicle's own judgement; None when nothing is."""
    if bits.locked:
        return "locked: its motors stay off until it is rebooted"
    if bits.crashed:
        return "crashed: set it upright and reboot it"
    if bits.tumbled:
        return "tumbled: set it upright"
    return "an expansion deck failed its test" if bits.deck_fault else None
