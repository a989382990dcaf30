"""Which variables a Crazyflie is asked to log, and how they are packed into its log blocks. Pure.

Limits of the firmware (``log.c``): 26 bytes a block, 16 blocks, 128 variables, periods of 10 to 2540 ms.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

BLOCK_BYTES = 26
SIZES = {"uint8_t": 1, "int8_t": 1, "uint16_t": 2, "int16_t": 2, "FP16": 2, "uint32_t": 4, "int32_t": 4, "float": 4}

STATE = ("supervisor.info",)
OLD_STATE = ("sys.canfly", "sys.isFlying", "sys.isTumbled")
FAST = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z", "stateEstimate.yaw", "pm.state")
SLOW = (
    "pm.vbat",
    "pm.batteryLevel",
    "kalman.varPX",
    "kalman.varPY",
    "kalman.varPZ",
    "locSrvZ.tick",
    "radio.rssi",
    "stabilizer.thrust",
)
WANTED = (*STATE, *FAST, *SLOW)
"""Whatever of these is missing degrades a check."""


@dataclass(frozen=True, slots=True)
class Block:
    """One log block: what it holds and how often it is sent."""

    variables: tuple[str, ...]
    period_ms: int


def pack(names: Sequence[str], types: Mapping[str, str], period_ms: int) -> list[Block]:
    """The named variables that exist, in as few blocks as their order allows.

    Args:
        names: wanted, in order.
        types: stored type of each variable that the vehicle has.
        period_ms: of every block.
    """
    blocks: list[Block] = []
    current: list[str] = []
    used = 0
    for name in names:
        size = SIZES.get(types.get(name, ""), 0)
        if size == 0:
            continue
        if used + size > BLOCK_BYTES:
            blocks.append(Block(tuple(current), period_ms))
            current, used = [], 0
        current.append(name)
        used += size
    if current:
        blocks.append(Block(tuple(current), period_ms))
    return blocks


def plan_blocks(types: Mapping[str, str], fast_ms: int, slow_ms: int) -> tuple[list[Block], list[str]]:
    """The blocks to log and the wanted variables that the vehicle does not have.

    Args:
        types: stored type of each variable in the vehicle's table of contents.
        fast_ms: period of what commands wait for: state and position.
        slow_ms: period of the rest.
    """
    state = STATE if STATE[0] in types else OLD_STATE
    blocks = [*pack((*state, *FAST), types, fast_ms), *pack(SLOW, types, slow_ms)]
    return blocks, [name for name in WANTED if name not in types]
