"""What the link to a Crazyflie does when cflib does not do its part: its lock held, its errors."""

from __future__ import annotations

import struct
import threading
import time
from pathlib import Path

import pytest

from drivers.crazyflie_link import CrazyflieLink, connect
from drivers.crazyflie_orders import ArmOrder, GoToOrder, LandOrder, Order, StopOrder, TakeOffOrder
from drivers.errors import DriverError
from tests.drivers.crazyflie_unplugged import Wire, wired


def test_only_the_state_ends_connecting(tmp_path: Path) -> None:
    link, _ = wired(tmp_path)
    link.state_variable = "supervisor.info"
    link._logged(100, {"pm.vbat": 4.0}, None)
    assert not link._first_log.is_set()
    link._logged(100, {"supervisor.info": 14, "pm.state": 0}, None)
    assert link._first_log.is_set()


@pytest.mark.parametrize(("protocol", "packet"), [(12, (9, 1, b"\x03")), (11, (6, 1, b"\x03"))])
def test_the_emergency_stop_waits_for_no_lock(tmp_path: Path, protocol: int, packet: tuple[int, int, bytes]) -> None:
    link, wire = wired(tmp_path, protocol)
    with link._cf._send_lock:  # somebody in cflib hangs there
        stop = threading.Thread(target=link.emergency_stop, daemon=True)
        stop.start()
        stop.join(2.0)
        assert not stop.is_alive()
    assert wire.sent == [packet]


def test_the_stop_is_the_one_that_cflib_sends(tmp_path: Path) -> None:
    link, wire = wired(tmp_path)
    link._cf.platform._protocolVersion = 12
    link._cf.supervisor.send_emergency_stop()
    link._cf.supervisor.send_arming_request(True)
    link.emergency_stop()
    link.send(ArmOrder(True))
    assert wire.sent[:2] == wire.sent[2:]


@pytest.mark.parametrize(
    ("order", "port", "start"),
    [
        (ArmOrder(True), 9, b"\x01\x01"),
        (StopOrder(), 8, b"\x03"),
        (TakeOffOrder(1.0, 2.0), 8, b"\x07\x00" + struct.pack("<f", 1.0)),
        (LandOrder(0.0, 2.0), 8, b"\x08\x00" + struct.pack("<f", 0.0)),
        (GoToOrder((1.0, 2.0, 3.0), 0.0, 2.0), 8, b"\x0c"),
    ],
)
def test_orders_and_pings_wait_for_no_lock(tmp_path: Path, order: Order, port: int, start: bytes) -> None:
    link, wire = wired(tmp_path)
    link._cf.platform._protocolVersion = 12
    with link._cf._send_lock:
        for target, arguments in ((link.send, (order,)), (link.ping, ())):
            sender = threading.Thread(target=target, args=arguments, daemon=True)
            sender.start()
            sender.join(2.0)
            assert not sender.is_alive()
    (sent_port, _, data), ping = wire.sent
    assert ping[:2] == (15, 0)
    assert sent_port == port
    assert data.startswith(start)


def test_whatever_cflib_raises_the_link_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[CrazyflieLink] = []

    def fail(link: CrazyflieLink, *_: object) -> None:
        opened.append(link)
        link._cf.link = Wire()
        raise AttributeError("no toc")

    monkeypatch.setattr(CrazyflieLink, "open", fail)
    with pytest.raises(DriverError, match=r"AttributeError \(no toc\); restart"):
        connect(
            "udp://127.0.0.1:1", tmp_path, lambda *_: None, lambda *_: None,
            timeout_s=0.1, answer_s=0.1, fast_ms=50, slow_ms=200,
        )  # fmt: skip
    (link,) = opened
    end_s = time.monotonic() + 2.0
    while link.lost is None and time.monotonic() < end_s:
        time.sleep(0.01)
    assert link.lost == "the link broke: closed"
    assert link._cf.link is None
