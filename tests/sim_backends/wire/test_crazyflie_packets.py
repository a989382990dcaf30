"""CRTP without sockets: packets, tables of contents, parameters, log blocks, low-level set-points."""

from __future__ import annotations

import errno
import math
import struct

import pytest

from sim_backends.wire import crazyflie_params as p
from sim_backends.wire.crazyflie_logs import (
    APPEND_V2,
    CREATE_V2,
    DELETE,
    MAX_BLOCKS,
    RESET,
    SETTINGS,
    START,
    STOP,
    TOC,
    Logs,
)
from sim_backends.wire.crazyflie_params import Param, Params
from sim_backends.wire.crazyflie_setpoints import Mode, RpytDecoder, decode_generic
from sim_backends.wire.crtp_packets import Packet, decode, decompress_quaternion, yaw_of
from sim_backends.wire.crtp_toc import Toc

TABLE = (
    Param("a.level", "B", 3),
    Param("a.gain", "f", 0.5, persistent=True),
    Param("b.version", "I", 7, read_only=True),
)


@pytest.mark.parametrize("datagram", [b"", b"\x50" + bytes(31)])
def test_garbage_is_no_packet(datagram: bytes) -> None:
    assert decode(datagram) is None


def test_a_packet_comes_back_as_it_was_sent() -> None:
    packet = Packet(5, 2, b"abc")
    assert decode(packet.encode()) == packet
    # cflib sets the two bits between port and channel
    assert decode(bytes((packet.encode()[0] | 0x0C,)) + b"abc") == packet


@pytest.mark.parametrize("yaw", [-3.0, -1.2, 0.0, 0.7, 2.5])
def test_a_compressed_quaternion_keeps_its_heading(yaw: float) -> None:
    q = (0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2))
    largest = max(range(4), key=lambda i: abs(q[i]))
    packed = largest
    for i in range(4):
        if i != largest:
            size = round(abs(q[i]) / math.sqrt(0.5) * 511)
            packed = packed << 10 | ((q[i] < 0) ^ (q[largest] < 0)) << 9 | size
    assert math.remainder(yaw_of(*decompress_quaternion(packed)) - yaw, math.tau) == pytest.approx(0.0, abs=0.01)


def test_a_toc_is_read_item_by_item() -> None:
    toc = Toc([(7, "a.b"), (8, "c.d")], b"\x10\x80")
    answer = toc.answer(bytes((3,)))
    assert answer is not None
    assert struct.unpack("<BHI", answer[:7]) == (3, 2, toc.crc)
    assert answer[7:] == b"\x10\x80"
    assert toc.answer(b"\x02\x01\x00") == b"\x02\x01\x00\x08c\0d\0"
    assert toc.answer(b"\x02\x05\x00") == b"\x02"  # no such item
    assert toc.answer(b"\x01") is None  # version 1 is gone
    assert Toc([(7, "a.b")]).crc != toc.crc


def params(changed: list[tuple[str, float]]) -> Params:
    return Params(lambda name, value: changed.append((name, value)), TABLE)


@pytest.mark.parametrize(
    ("channel", "request_", "answer"),
    [
        (p.READ, b"\0\0", b"\0\0\0\x03"),
        (p.READ, b"\x09\0", b"\x09\0" + bytes((errno.ENOENT,))),
        (p.WRITE, b"\0\0\x05", b"\0\0\x05"),
        (p.WRITE, b"\x02\0\1\0\0\0", None),  # read only
        (p.WRITE, b"\x01\0\1", None),  # too short
        (p.MISC, b"\x02\x01\0", b"\x02\x01\0\x01"),
        (p.MISC, b"\x07\x01\0", b"\x07\x01\0\0\x01"),
        (p.MISC, b"\x07\0\0", b"\x07\0\0" + bytes((errno.ENOENT,))),
        (p.MISC, b"\x06\0\0", b"\x06\0\0\x03"),
        (p.MISC, b"\x08\0\0", b"\x08\0\0\0\x03"),
        (p.MISC, b"\x08\x02\0", b"\x08\x02\0" + bytes((errno.ENOENT,))),
        (p.MISC, b"\0a\0level\0\x08\x09", b"\0a\0level\0\0"),
        (p.MISC, b"\0a\0nothing\0\x08\x09", b"\0a\0nothing\0" + bytes((errno.ENOENT,))),
        (p.MISC, b"\0b\0version\0\x0a\1\0\0\0", b"\0b\0version\0" + bytes((errno.EACCES,))),
        (p.MISC, b"\0a\0level\0\x06\x09", b"\0a\0level\0" + bytes((errno.EINVAL,))),
        (p.MISC, b"", None),
    ],
)
def test_parameters_answer(channel: int, request_: bytes, answer: bytes | None) -> None:
    assert params([]).answer(channel, request_) == answer


def test_a_stored_parameter_survives_a_reboot() -> None:
    first = params([])
    first.answer(p.WRITE, b"\x01\0" + struct.pack("<f", 2.5))
    assert first.answer(p.MISC, b"\x04\x01\0") == b"\x04\x01\0\0" + struct.pack("<f", 0.5)
    assert first.answer(p.MISC, b"\x03\x01\0") == b"\x03\x01\0\0"
    assert first.answer(p.MISC, b"\x04\x01\0") == b"\x04\x01\0\1" + struct.pack("<ff", 0.5, 2.5)
    again = params([])
    again.restore(first.stored)
    assert again.values["a.gain"] == 2.5
    again.answer(p.MISC, b"\x05\x01\0")
    assert again.stored == {}


def test_writing_tells_the_firmware() -> None:
    changed: list[tuple[str, float]] = []
    params(changed).answer(p.WRITE, b"\0\0\x05")
    assert changed == [("a.level", 5)]


def logs() -> Logs:
    return Logs({"a.x": ("f", lambda: 1.5), "a.big": ("H", lambda: 70000.0), "a.n": ("b", lambda: -3.0)})


def settings(table: Logs, *data: int, now_ms: float = 0.0) -> int:
    answer = table.answer(SETTINGS, bytes(data), now_ms)
    assert answer is not None
    assert answer[:2] == bytes((data[0], data[1] if len(data) > 1 else 0))
    return answer[2]


def test_a_block_is_sent_at_its_period() -> None:
    table = logs()
    assert settings(table, CREATE_V2, 4, 7, 0, 0, 2, 1, 0) == 0
    assert settings(table, APPEND_V2, 4, 4, 2, 0) == 0
    assert table.due(1000.0) == []  # not started
    assert settings(table, START, 4, 10, now_ms=1000.0) == 0
    assert table.due(1050.0) == []
    sample = struct.pack("<fHb", 1.5, 65535, -3)
    assert table.due(1100.0) == [b"\x04" + (1100).to_bytes(3, "little") + sample]
    assert table.due(1150.0) == []
    assert len(table.due(1200.0)) == 1
    assert len(table.due(1999.0)) == 1  # what was slept through is not made up for
    assert table.due(2010.0) == []
    assert settings(table, STOP, 4) == 0
    assert table.due(3000.0) == []


def test_values_are_converted_to_the_type_that_was_asked_for() -> None:
    table = logs()
    settings(table, CREATE_V2, 1, 0x78, 0, 0)  # stored as float, fetched as FP16
    settings(table, START, 1, 0, now_ms=0.0)
    assert table.due(10.0) == [b"\x01\x0a\0\0" + struct.pack("<e", 1.5)]
    assert table.due(1000.0) == []  # period 0 is one sample


def test_the_limits_of_log_blocks() -> None:
    table = logs()
    assert settings(table, CREATE_V2, 1, *(7, 0, 0) * 7) == errno.E2BIG  # 28 bytes
    assert settings(table, CREATE_V2, 1) == errno.EEXIST
    assert settings(table, START, 9, 1) == errno.ENOENT
    assert settings(table, APPEND_V2, 9, 7, 0, 0) == errno.ENOENT
    assert settings(table, CREATE_V2, 2, 7, 9, 0) == errno.ENOENT  # no such variable
    assert settings(table, CREATE_V2, 3, 7, 0, 0, 7) == 0  # cflib's stray byte
    assert settings(table, DELETE, 2) == 0
    assert settings(table, RESET) == 0
    for ident in range(MAX_BLOCKS):
        assert settings(table, CREATE_V2, ident, *(1, 0, 0) * 8) == 0
    assert settings(table, CREATE_V2, 99) == errno.ENOMEM
    assert settings(table, APPEND_V2, 0, 1, 0, 0) == errno.ENOMEM  # 128 variables
    assert table.answer(TOC, b"\x02\x00\x00", 0.0) == b"\x02\0\0\x07a\0x\0"


@pytest.mark.parametrize(
    ("data", "mode"),
    [
        (b"\0", Mode.OFF),
        (struct.pack("<Bffff", 7, 1, 2, 3, 90), Mode.GOAL),
        (struct.pack("<Bffff", 8, 1, 0, 0, 0), Mode.VELOCITY),
        (struct.pack("<Bffff", 9, 1, 0, 0, 0.5), Mode.ZDISTANCE),
        (struct.pack("<Bffff", 10, 1, 0, 0, 0.5), Mode.HOVER),
        (struct.pack("<BfffHB", 11, 1, 0, 0, 30000, 0), Mode.ATTITUDE),
        (struct.pack("<BhhhhhhhhhIhhh", 6, *range(9), 0xC0000000, 0, 0, 0), Mode.GOAL),
    ],
)
def test_generic_setpoints(data: bytes, mode: Mode) -> None:
    setpoint = decode_generic(data)
    assert setpoint is not None
    assert setpoint.mode is mode


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x07",
        b"\x63abc",
        struct.pack("<Bffff", 7, math.nan, 0, 0, 0),
        struct.pack("<Bffff", 10, 0, 0, 0, math.inf),
    ],
)
def test_setpoints_that_are_none(data: bytes) -> None:
    assert decode_generic(data) is None


def test_legacy_yaw_rates_turn_the_other_way() -> None:
    new, old = (decode_generic(struct.pack("<Bffff", kind, 0, 0, 30, 1)) for kind in (10, 5))
    assert new is not None
    assert old is not None
    assert new.yaw_rate == -old.yaw_rate == pytest.approx(math.radians(30))


def test_classic_thrust_is_locked_until_it_was_zero() -> None:
    decoder = RpytDecoder()
    fly = struct.pack("<fffH", 0, 0, 0, 40000)
    first = decoder.decode(fly)
    assert first is not None
    assert first.mode is Mode.OFF
    decoder.decode(struct.pack("<fffH", 0, 0, 0, 0))
    second = decoder.decode(fly)
    assert second is not None
    assert second.mode is Mode.ATTITUDE
    assert decoder.decode(b"short") is None
