"""NatNet packets against an independent reading of the format: sizes, order, axes."""

from __future__ import annotations

import struct

import pytest

from sim_backends.wire import natnet_packets as natnet
from sim_backends.wire.natnet_packets import Seen

OLD, NEW = (3, 1), (4, 1)
BODIES = [
    Seen(1, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3, 0.9)),
    Seen(2, (-1.0, 0.5, 0.25), (0.0, 0.0, 0.0, 1.0), tracked=False),
]


class Reader:
    """Reads a packet front to back."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, form: str) -> tuple:
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += struct.calcsize("<" + form)
        return values

    def text(self) -> str:
        end = self.data.index(b"\0", self.at)
        text, self.at = self.data[self.at : end].decode(), end + 1
        return text

    def size(self, version: natnet.Version) -> int | None:
        return self.take("i")[0] if version >= NEW else None


def test_server_info_says_where_the_frames_go() -> None:
    info = natnet.server_info(NEW, 1511, "239.255.42.99")
    kind, size, name, *versions, clock, port, multicast = struct.unpack_from("<HH256s8BQH?", info)
    assert (kind, size) == (natnet.SERVER_INFO, len(info) - 4)
    assert len(info) == 284  # the C structure, padding included
    assert name.rstrip(b"\0") == b"Motive"
    assert versions[4:6] == [4, 1]
    assert (clock, port, multicast) == (natnet.CLOCK_HZ, 1511, True)
    assert info[279:283] == bytes((239, 255, 42, 99))
    assert natnet.server_info(NEW, 5, None)[278] == 0


@pytest.mark.parametrize("version", natnet.VERSIONS)
def test_the_model_names_the_bodies(version: natnet.Version) -> None:
    packet = natnet.model(version, ["cf1", "größer"])
    reader = Reader(packet)
    assert reader.take("HHi") == (natnet.MODEL, len(packet) - 4, 2)
    for number, name in enumerate(("cf1", "größer"), 1):
        assert reader.take("i") == (1,)
        size, before = reader.size(version), 0
        before = reader.at
        assert reader.text() == name
        assert reader.take("ii3fi") == (number, -1, 0.0, 0.0, 0.0, 0)
        assert size in (None, reader.at - before)
    assert reader.at == len(packet)


@pytest.mark.parametrize("version", natnet.VERSIONS)
def test_a_frame_reads_back(version: natnet.Version) -> None:
    packet = natnet.frame(version, 77, BODIES, 12.5, 12.51)
    reader = Reader(packet)
    assert reader.take("HHi") == (natnet.FRAME, len(packet) - 4, 77)
    for _ in range(2):
        assert (reader.take("i"), reader.size(version)) in (((0,), None), ((0,), 0))
    assert reader.take("i") == (2,)
    size = reader.size(version)
    before = reader.at
    for body in BODIES:
        number, *numbers, error_m, flags = reader.take("i8fh")
        assert number == body.number
        assert numbers == pytest.approx([*body.position_m, *body.quaternion])
        assert 0 < error_m < 0.001
        assert bool(flags & 1) == body.tracked
    assert size in (None, reader.at - before)
    for _ in range(4 + (version >= NEW)):
        assert (reader.take("i"), reader.size(version)) in (((0,), None), ((0,), 0))
    assert reader.take("II") == (0, 0)
    assert reader.take("d") == (12.5,)
    assert reader.take("3Q") == (125_000_000, 125_000_000, 125_100_000)
    if version >= NEW:
        reader.take("ii")
    assert reader.take("hi") == (0, 0)
    assert reader.at == len(packet)


def test_y_up_turns_places_and_attitudes() -> None:
    packet = natnet.frame(OLD, 1, BODIES[:1], 0.0, 0.0, "y")
    numbers = struct.unpack_from("<7f", packet, 4 + 4 + 8 + 4 + 4)
    assert numbers == pytest.approx((1.0, 3.0, -2.0, 0.1, 0.3, -0.2, 0.9))


@pytest.mark.parametrize(
    ("datagram", "kind"),
    [
        (b"", None),
        (b"\0\0\0", None),
        (b"\0\0\0\0", natnet.CONNECT),
        (b"\4\0\0\0", natnet.REQUEST_MODEL),
        (b"\4\0\4\0\1\0\0\0", natnet.REQUEST_MODEL),
        (b"\0\0\0\0" + b"Ping" * 60, natnet.CONNECT),
        (b"\4\0\4\0\1", None),
        (b"\xff\xff\xff\xff", None),
    ],
)
def test_garbage_is_no_request(datagram: bytes, kind: int | None) -> None:
    assert natnet.message_of(datagram) == kind
