"""The serial wire on a pseudo-terminal: a full port blocks nobody, and a stop goes ahead of what waits."""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from drivers.mavlink_socket import Wire, open_wire

pytest.importorskip("serial")
PACKET = bytes(range(1, 66))
STOP = b"S" * 44


class Radio:
    """The other end of a serial cable; ``device`` names the end of the computer."""

    def __init__(self, folder: Path) -> None:
        self.device = folder / "radio"
        self._end = -1
        self.plug()

    def plug(self) -> None:
        self._end, computer = os.openpty()
        os.set_blocking(self._end, False)
        self.device.unlink(missing_ok=True)
        self.device.symlink_to(os.ttyname(computer))
        self._computer = computer

    def unplug(self) -> None:
        for end in (self._end, self._computer):
            os.close(end)

    def hears(self, quiet_s: float = 0.1) -> bytes:
        found = b""
        while select.select([self._end], [], [], quiet_s)[0]:
            found += os.read(self._end, 65535)
        return found

    def says(self, data: bytes) -> None:
        os.write(self._end, data)


@pytest.fixture
def radio(tmp_path: Path) -> Iterator[Radio]:
    made = Radio(tmp_path)
    yield made
    made.unplug()


@pytest.fixture
def wire(radio: Radio) -> Iterator[Wire]:
    made = open_wire(f"{radio.device}:57600", 57600, 1.0)
    yield made
    made.close()


def fill(wire: Wire) -> None:
    """Sends far more than a port takes; in a thread of its own, so that one that blocks is found out."""

    def run() -> None:
        for _ in range(3000):
            wire.send(PACKET, None)

    sender = threading.Thread(target=run, daemon=True)
    sender.start()
    sender.join(5.0)
    assert not sender.is_alive(), "a full port blocks"


def test_bytes_travel_both_ways(radio: Radio, wire: Wire) -> None:
    wire.send(PACKET, None)
    assert radio.hears() == PACKET
    radio.says(b"hello")
    assert select.select([wire.fileno()], [], [], 1.0)[0]
    assert wire.receive() == [(b"hello", None)]


def test_a_full_port_drops_whole_packets_and_ends_those_begun(radio: Radio, wire: Wire) -> None:
    fill(wire)
    heard = radio.hears()
    wire.send(PACKET, None)
    heard += radio.hears()
    assert len(heard) > len(PACKET)
    assert heard == PACKET * (len(heard) // len(PACKET)), "half a packet is among them"


def test_a_stop_goes_ahead_of_what_waits(radio: Radio, wire: Wire) -> None:
    fill(wire)
    begun_s = time.monotonic()
    for _ in range(3):
        wire.send(STOP, None, urgent=True)
    assert time.monotonic() - begun_s < 0.5
    assert radio.hears().endswith(bytes(len(PACKET)) + STOP * 3), "the cut packet is ended, and then it comes whole"


def test_an_unplugged_radio_is_silent_and_comes_back(radio: Radio, wire: Wire) -> None:
    radio.unplug()
    deadline_s = time.monotonic() + 5.0
    while wire.fileno() >= 0:
        assert wire.receive() == []
        assert time.monotonic() < deadline_s
    wire.send(PACKET, None)
    wire.send(STOP, None, urgent=True)
    radio.plug()
    while wire.fileno() < 0:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)
        assert wire.receive() == []
    wire.send(PACKET, None)
    assert radio.hears() == PACKET


def test_a_send_to_an_unplugged_radio_harms_nobody(radio: Radio, wire: Wire) -> None:
    radio.unplug()
    for urgent in (False, True, False):
        wire.send(PACKET, None, urgent=urgent)
    assert wire.fileno() < 0
    radio.plug()
