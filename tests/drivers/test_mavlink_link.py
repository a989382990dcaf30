"""The thread of a link: whatever fails in it, its vehicles are told, and their stops still travel."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import pytest

from drivers import mavlink_link
from drivers.clock import RealClock
from drivers.mavlink_link import Link
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_socket import Peer


class Broken:
    """A wire whose every call fails while ``fails``; what it sends is kept."""

    def __init__(self) -> None:
        self.fails, self.closed = False, False
        self.sent: list[bytes] = []

    def fileno(self) -> int:
        return -1

    def receive(self) -> list[tuple[bytes, Peer]]:
        self._fail()
        return []

    def send(self, data: bytes, peer: Peer, urgent: bool = False) -> None:
        self._fail()
        self.sent.append(data)

    def close(self) -> None:
        self.closed = True

    def _fail(self) -> None:
        if self.fails:
            raise RuntimeError("the wire fails")


class Passenger:
    """A vehicle that only notes what it is told."""

    def __init__(self, sysid: int) -> None:
        self.sysid = sysid
        self.ticks = 0
        self.errors: list[Exception] = []

    def alive(self, now_s: float) -> bool:
        return True

    def on_message(self, message: Any, now_s: float) -> None: ...

    def pump(self, now_s: float) -> None: ...

    def tick(self, now_s: float) -> None:
        self.ticks += 1

    def on_error(self, error: Exception) -> None:
        self.errors.append(error)


def wait(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.01)


def test_a_failing_wire_ends_no_thread_and_is_told_to_all(monkeypatch: pytest.MonkeyPatch) -> None:
    wire = Broken()
    monkeypatch.setattr(mavlink_link, "open_wire", lambda *_: wire)
    riders = [Passenger(1), Passenger(2)]
    endpoint = "udpin:broken:1"
    links = [Link.board(endpoint, MavlinkOptions(), RealClock(), rider, 1.0) for rider in riders]
    try:
        wait(lambda: len(wire.sent) > 0)
        wire.fails = True
        wait(lambda: all(rider.errors for rider in riders))
        ticks = [rider.ticks for rider in riders]
        wait(lambda: all(rider.ticks > before + 3 for rider, before in zip(riders, ticks, strict=True)))
        wire.fails = False
        sent = len(wire.sent)
        wait(lambda: len(wire.sent) > sent)
    finally:
        for link, rider in zip(links, riders, strict=True):
            link.leave(rider)
    assert wire.closed
    assert not [t for t in threading.enumerate() if t.name == f"mavlink {endpoint}"]
