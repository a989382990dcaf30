"""Log blocks: sets of variables that the Crazyflie sends by itself at a period.

Source: ``src/modules/src/log.c`` of the firmware, ``cflib/crazyflie/log.py``.
"""

from __future__ import annotations

import errno
import struct
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from sim_backends.wire.crtp_toc import Toc

TOC, SETTINGS, DATA = range(3)
DELETE, START, STOP, RESET, CREATE_V2, APPEND_V2, START_V2 = 2, 3, 4, 5, 6, 7, 8
MAX_BLOCKS, MAX_VARIABLES, MAX_BYTES = 16, 128, 26
FORMATS = {1: "B", 2: "H", 3: "I", 4: "b", 5: "h", 6: "i", 7: "f", 8: "e"}
CODES = {letter: code for code, letter in FORMATS.items()}
_RANGES = {"B": (0, 255), "H": (0, 65535), "I": (0, 2**32 - 1), "b": (-128, 127), "h": (-32768, 32767)}

Readers = Mapping[str, tuple[str, Callable[[], float]]]
"""Of each variable: its type as a letter of ``struct`` and how to read it."""


@dataclass
class Block:
    """One block: what it sends (format and reader), how often, and when next (firmware ms)."""

    variables: list[tuple[str, Callable[[], float]]] = field(default_factory=list)
    period_ms: int = 0
    due_ms: float | None = None

    @property
    def size(self) -> int:
        """Bytes of its values."""
        return sum(struct.calcsize("<" + kind) for kind, _ in self.variables)

    def sample(self) -> bytes:
        """Its values now."""
        return b"".join(_pack(kind, read()) for kind, read in self.variables)


def _pack(kind: str, value: float) -> bytes:
    if kind == "f":
        return struct.pack("<f", value)
    if kind == "e":
        return struct.pack("<e", max(-65504.0, min(65504.0, value)))
    low, high = _RANGES.get(kind, (-(2**31), 2**31 - 1))
    return struct.pack("<" + kind, max(low, min(high, int(value))))


class Logs:
    """All blocks of one vehicle."""

    def __init__(self, readers: Readers) -> None:
        self._readers = [readers[name] for name in readers]
        items = [(CODES[kind], name) for name, (kind, _) in readers.items()]
        self._toc = Toc(items, bytes((MAX_BLOCKS, MAX_VARIABLES)))
        self._blocks: dict[int, Block] = {}

    def answer(self, channel: int, data: bytes, now_ms: float) -> bytes | None:
        """Answers a packet on the log port; None where the firmware says nothing."""
        if channel == TOC:
            return self._toc.answer(data)
        if channel != SETTINGS or not data:
            return None
        command, ident = data[0], data[1] if len(data) > 1 else 0
        return bytes((command, ident, self._settings(command, ident, data[2:], now_ms)))

    def _settings(self, command: int, ident: int, rest: bytes, now_ms: float) -> int:
        if command == RESET:
            self._blocks.clear()
            return 0
        if command == CREATE_V2:
            if ident in self._blocks:
                return errno.EEXIST
            if len(self._blocks) >= MAX_BLOCKS:
                return errno.ENOMEM
            self._blocks[ident] = Block()
            return self._append(ident, rest)
        block = self._blocks.get(ident)
        if block is None:
            return errno.ENOENT
        if command == APPEND_V2:
            return self._append(ident, rest)
        if command in (START, START_V2):
            size, unit_ms = (1, 10) if command == START else (2, 1)
            block.period_ms = int.from_bytes(rest[:size], "little") * unit_ms
            block.due_ms = now_ms + block.period_ms
        elif command == STOP:
            block.due_ms = None
        elif command == DELETE:
            del self._blocks[ident]
        else:
            return errno.ENOEXEC
        return 0

    def _append(self, ident: int, rest: bytes) -> int:
        block = self._blocks[ident]
        # cflib leaves the first byte of a variable that did not fit at the end of a full packet: three bytes or none
        for at in range(0, len(rest) - 2, 3):
            code, index = struct.unpack_from("<BH", rest, at)
            kind = FORMATS.get(code & 0x0F)
            if kind is None or index >= len(self._readers):
                return errno.ENOENT
            if sum(len(b.variables) for b in self._blocks.values()) >= MAX_VARIABLES:
                return errno.ENOMEM
            if block.size + struct.calcsize("<" + kind) > MAX_BYTES:
                return errno.E2BIG
            block.variables.append((kind, self._readers[index][1]))
        return 0

    def due(self, now_ms: float) -> list[bytes]:
        """What has to be sent at ``now_ms`` on the data channel; a period that was slept through is sent once."""
        out: list[bytes] = []
        for ident, block in self._blocks.items():
            if block.due_ms is None or now_ms < block.due_ms - 1e-6:
                continue
            stamp = int(now_ms) & 0xFFFFFF
            out.append(struct.pack("<BI", ident, stamp)[:4] + block.sample())
            if block.period_ms == 0:  # period 0 asks for one sample
                block.due_ms = None
                continue
            block.due_ms += block.period_ms
            if block.due_ms <= now_ms:
                block.due_ms = now_ms + block.period_ms
        return out
