"""The driver's own thread and what its state says: a state that is no longer logged, errors, closing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers.crazyflie import Crazyflie
from drivers.crazyflie_link import CrazyflieLink
from drivers.crazyflie_options import CrazyflieOptions
from drivers.limits import PoseBook, UavLimits
from drivers.vehicle import Pose, StopMotors
from tests.drivers.crazyflie_unplugged import Wire, wired

LIMITS = UavLimits(max_speed_mps=1.5, accel_mps2=2.0, climb_mps=1.0, descent_mps=0.7, altitude_m=2.5)
ON_GROUND, FLYING = 0x0E, 0x1E


class Now:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.s = 100.0

    def now(self) -> float:
        return self.s

    def wait_until(self, time_s: float) -> float:
        self.s = max(self.s, time_s)
        return self.s


class Rig:
    """A driver on a link that is up, without a vehicle behind it; logs and turns come from the test."""

    def __init__(self, folder: Path) -> None:
        self.clock = Now()
        self.uav = Crazyflie(
            "uav0", "udp://127.0.0.1:1", body="cf0", limits=LIMITS, pads={}, book=PoseBook(), clock=self.clock,
            options=CrazyflieOptions(cache=folder),
        )  # fmt: skip
        self.link: CrazyflieLink
        self.wire: Wire
        self.link, self.wire = wired(folder)
        self.link.state_variable = "supervisor.info"
        self.uav._adopt(self.link)

    def log(self, **values: float) -> None:
        named = {name.replace("_", "."): value for name, value in values.items()}
        self.uav._on_log(round(1000 * self.clock.s), named)

    def start(self) -> None:
        """As ``connect`` does after the link is there."""
        self.uav._turned_s = self.clock.s
        self.uav._worker = threading.Thread(target=self.uav._work, daemon=True)
        self.uav._worker.start()


@pytest.fixture
def rig(tmp_path: Path) -> Iterator[Rig]:
    made = Rig(tmp_path)
    yield made
    made.uav.close()


def until(condition: Callable[[], bool]) -> None:
    end_s = time.monotonic() + 5.0
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


# --- the state's own age


def test_other_logs_do_not_make_a_state_fresh(rig: Rig) -> None:
    asked: list[float] = []
    rig.link.log_again = lambda: asked.append(rig.clock.s)  # type: ignore[method-assign]
    rig.log(pm_vbat=4.0)
    assert rig.uav.state().stamp_s < 0, "nothing is known of its state"
    rig.log(supervisor_info=ON_GROUND, stateEstimate_x=0.0, stateEstimate_y=0.0, stateEstimate_z=0.0)
    assert rig.uav.state().stamp_s == 100.0
    rig.clock.s = 101.0
    rig.log(pm_vbat=4.0)
    rig.uav._turn([], None)
    assert rig.uav.state().stamp_s == 100.0
    assert rig.uav._look().position_m == (0.0, 0.0, 0.0)
    assert asked == []
    for _ in range(100):
        rig.clock.s += 0.1
        rig.log(pm_vbat=4.0)
        rig.uav._turn([], None)
    assert rig.uav.state().stamp_s == 100.0
    assert not rig.uav.state().link
    assert rig.uav._look().position_m is None
    assert "telemetry" in (rig.uav._look().not_ready or "")
    assert len(asked) == 4, "again and again until its state is back"
    rig.log(supervisor_info=ON_GROUND)
    assert rig.uav.state().stamp_s == rig.clock.s


# --- the thread


def test_an_error_does_not_end_the_thread_nor_the_emergency_stop(rig: Rig) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("radio unplugged")

    rig.log(supervisor_info=FLYING)
    rig.link.send_pose = fail  # type: ignore[method-assign]
    rig.start()
    assert rig.uav.state().link
    rig.uav.feed_pose(Pose("cf0", (0.0, 0.0, 1.0), 0.0, rig.clock.s))
    until(lambda: rig.uav.state().fault is not None)
    assert "RuntimeError (radio unplugged)" in (rig.uav.state().fault or "")
    rig.uav.send(StopMotors("uav0"))
    until(lambda: (9, 1, b"\x03") in rig.wire.sent)
    rig.uav.feed_pose(Pose("cf0", (0.0, 0.0, 1.0), 0.0, rig.clock.s + 0.1))
    rig.clock.s += 0.2
    until(lambda: rig.wire.sent.count((9, 1, b"\x03")) > 1)
    assert rig.uav.state().link
    rig.log(supervisor_info=0x44)
    rig.clock.s += 6.0
    assert "locked" in (rig.uav.state().fault or "")


def test_a_thread_that_hangs_or_is_dead_is_a_lost_link(rig: Rig) -> None:
    rig.log(supervisor_info=ON_GROUND)
    assert not rig.uav.state().link, "not begun"
    rig.start()
    assert rig.uav.state().link
    inside, go_on = threading.Event(), threading.Event()

    def hang() -> None:
        inside.set()
        go_on.wait(5.0)

    rig.clock.s += 0.6
    rig.link.ping = hang  # type: ignore[method-assign]
    assert inside.wait(5.0)
    rig.clock.s += 0.5
    rig.log(supervisor_info=ON_GROUND)
    rig.clock.s += 0.6
    assert not rig.uav.state().link, "its telemetry is fresh, but nobody turns"
    go_on.set()
    until(lambda: rig.uav.state().link)
    rig.uav._closing.set()
    until(lambda: not rig.uav.state().link)


# --- closing


def test_closing_lands_one_that_flies_without_our_doing(rig: Rig) -> None:
    rig.log(supervisor_info=FLYING, stateEstimate_x=1.0, stateEstimate_y=0.0, stateEstimate_z=1.0)
    rig.uav.close()
    assert {data[0] for port, _, data in rig.wire.sent if port == 8} == {8}, "landings, no stop"


def test_closing_stops_one_that_stands(rig: Rig) -> None:
    rig.log(supervisor_info=ON_GROUND, stateEstimate_x=1.0, stateEstimate_y=0.0, stateEstimate_z=0.0)
    rig.uav.close()
    assert {data[0] for port, _, data in rig.wire.sent if port == 8} == {3}
