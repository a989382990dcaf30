"""What a Crazyflie's telemetry means: supervisor bits and charger. Pure.

Sources: ``supervisor.c`` and ``pm.h`` of the firmware.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

Values = Mapping[str, float]

CHARGING_STATES = (1, 2)
"""``pm.state`` charging and charged."""


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


def loaded_of(values: Values) -> bool:
    """Whether the motors carry it, and so its battery sags."""
    if "stabilizer.thrust" in values:
        return values["stabilizer.thrust"] > 0.0
    bits = bits_of(values)
    return bits is not None and bits.flying


def words(bits: Bits) -> str | None:
    """What is wrong by the vehicle's own judgement; None when nothing is."""
    if bits.locked:
        return "locked: its motors stay off until it is rebooted"
    if bits.crashed:
        return "crashed: set it upright and reboot it"
    if bits.tumbled:
        return "tumbled: set it upright"
    return "an expansion deck failed its test" if bits.deck_fault else None
