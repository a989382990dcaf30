"""The table of contents (version 2) through which parameters and log variables are found by name."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

GET_ITEM, GET_INFO = 2, 3


class Toc:
    """A fixed list of variables, each with a type byte and a ``group.name``."""

    def __init__(self, items: Sequence[tuple[int, str]], limits: bytes = b"") -> None:
        """Builds the table.

        Args:
            items: type byte and ``group.name`` of each variable; the place in the list is its id.
            limits: what follows the checksum in the answer to ``GET_INFO``.
        """
        self._items = [bytes((code,)) + name.replace(".", "\0", 1).encode() + b"\0" for code, name in items]
        self._limits = limits
        self.ids = {name: i for i, (_, name) in enumerate(items)}
        self.crc = zlib.crc32(b"".join(self._items))
        """Of all entries: cflib caches a table under it."""

    def answer(self, data: bytes) -> bytes | None:
        """Answers a request on the table's channel; None for what newer firmware does not know."""
        if data[:1] == bytes((GET_INFO,)):
            return struct.pack("<BHI", GET_INFO, len(self._items), self.crc) + self._limits
        if data[:1] == bytes((GET_ITEM,)) and len(data) >= 3:
            index = int.from_bytes(data[1:3], "little")
            if index < len(self._items):
                return data[:3] + self._items[index]
            return data[:1]
        return None
