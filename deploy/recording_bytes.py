"""Messages of an MCAP file in the order of writing, up to its end or its first damage.

Chunks and channels are parsed by the ``mcap`` package; the walk over records is here, because the package's own visits
every index entry, which takes ten times as long. Format: mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections.abc import Container, Iterator
from contextlib import suppress
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk
from mcap.stream_reader import get_chunk_data_stream
from zstandard import ZstdError

MAGIC = b"\x89MCAP0\r\n"
RECORD = struct.Struct("<BQ")
MESSAGE_HEAD = 22  # channel, sequence, log time, publish time
CHUNK_LIMIT = 1 << 30  # larger ones are damage, not data
DAMAGE = (McapError, ZstdError, EOFError, KeyError, ValueError, OverflowError, MemoryError, struct.error)


def messages(stream: BinaryIO, topics: Container[str]) -> Iterator[tuple[str, bytes]]:
    """Topic and data of every message on ``topics``; ends at the first damage."""
    names: dict[int, str] = {}
    with suppress(*DAMAGE):
        for opcode, body in _top_level(stream):
            if opcode == Opcode.CHUNK:
                yield from _in_chunk(_unpack(body), names, topics)


def whole(stream: BinaryIO) -> bool:
    """Whether every chunk is intact and the file was ended properly."""
    opcode = 0
    try:
        for opcode, body in _top_level(stream):
            if opcode == Opcode.CHUNK:
                _unpack(body)
        return opcode == Opcode.FOOTER and stream.read(len(MAGIC)) == MAGIC
    except DAMAGE:
        return False


def _top_level(stream: BinaryIO) -> Iterator[tuple[int, bytes]]:
    """Chunks and, at last, the footer; other records are skipped."""
    stream.seek(0)
    if stream.read(len(MAGIC)) != MAGIC:
        raise ValueError("no MCAP file")
    while True:
        head = stream.read(RECORD.size)
        if len(head) < RECORD.size:
            raise EOFError
        opcode, length = RECORD.unpack(head)
        if opcode not in (Opcode.CHUNK, Opcode.FOOTER):
            stream.seek(length, 1)
            continue
        if length > CHUNK_LIMIT:
            raise ValueError("a chunk of impossible size")
        body = stream.read(length)
        if len(body) < length:
            raise EOFError
        yield opcode, body
        if opcode == Opcode.FOOTER:
            return


def _unpack(body: bytes) -> bytes:
    chunk = Chunk.read(ReadDataStream(BytesIO(body)))
    if chunk.uncompressed_size > CHUNK_LIMIT:
        raise ValueError("a chunk of impossible size")
    data, length = get_chunk_data_stream(chunk, validate_crc=True)
    return bytes(data.read(length))


def _in_chunk(data: bytes, names: dict[int, str], topics: Container[str]) -> Iterator[tuple[str, bytes]]:
    at = 0
    while at < len(data):
        opcode, length = RECORD.unpack_from(data, at)
        at += RECORD.size
        if opcode == Opcode.MESSAGE:
            name = names[int.from_bytes(data[at : at + 2], "little")]
            if name in topics:
                yield name, data[at + MESSAGE_HEAD : at + length]
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(data[at : at + length])))
            names[channel.id] = channel.topic
        at += length
