"""A link to a Crazyflie that is up, with a note-taker in the place of the radio."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from drivers.crazyflie_link import CrazyflieLink


class Wire:
    """Stands where cflib keeps its radio: takes packets down."""

    def __init__(self) -> None:
        self.sent: list[tuple[int, int, bytes]] = []

    def send_packet(self, packet: Any) -> bool:
        self.sent.append((packet.port, packet.channel, bytes(packet.data)))
        return True

    def close(self) -> None: ...


def wired(cache: Path, protocol: int = 12) -> tuple[CrazyflieLink, Wire]:
    link, wire = CrazyflieLink("udp://127.0.0.1:1", cache, lambda *_: None, lambda *_: None), Wire()
    link._cf.link, link.protocol = wire, protocol
    return link, wire
