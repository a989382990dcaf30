"""Last wills over the wire: what the guardian does for each kind of vehicle, without the driver that flew it."""

from __future__ import annotations

import importlib
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pymavlink import mavutil

from drivers.clock import RealClock
from drivers.crazyflie_will import duration_s
from drivers.errors import DriverError
from drivers.last_will import LastWill
from drivers.limits import PoseBook, UgvLimits
from drivers.limo import TINY_MPS, Limo, LimoOptions
from drivers.mavlink_options import MavlinkOptions
from drivers.vehicle import Arm, Drive
from sim_backends.wire.world import Body, World
from tests.drivers.crazyflie_lab import MakeLab, labs_in, ready
from tests.drivers.mavlink_team import Team, team

KEY = bytes(range(32))
LOITER = 5


def carried_out(will: LastWill | None, height_m: float, timeout_s: float = 60.0) -> Future[str]:
    """As the guardian does it, in a thread."""
    assert will is not None
    carry_out: Callable[..., str] = importlib.import_module(will.module).carry_out
    pool = ThreadPoolExecutor(1)
    found = pool.submit(carry_out, will.arguments, height_m, time.monotonic() + timeout_s)
    pool.shutdown(wait=False)
    return found


def until(condition: Callable[[], bool], timeout_s: float, what: str) -> float:
    begun_s = time.monotonic()
    while not condition():
        assert time.monotonic() - begun_s < timeout_s, what
        time.sleep(0.01)
    return time.monotonic() - begun_s


def body(world: World, vehicle: str) -> Body:
    return world.body(world.row(vehicle))


def test_a_crazyflie_comes_down_gently_and_soon() -> None:
    assert 1.0 <= duration_s(0.0) < duration_s(1.2) < 4.0


def test_an_ackermann_limo_is_never_sent_zeros() -> None:
    def stop_mps(**options: Any) -> Any:
        limits, book = UgvLimits(0.5, 0.5), PoseBook()
        limo = Limo(
            "ugv0", "/limo1", body="limo1", limits=limits, book=book, clock=RealClock(), options=LimoOptions(**options)
        )
        return limo.last_will().arguments["stop_mps"]

    assert stop_mps() == 0.0
    assert stop_mps(mode="ackermann") == TINY_MPS


@pytest.fixture
def make_lab(tmp_path: Path) -> Iterator[MakeLab]:
    with labs_in(tmp_path) as make:
        yield make


@pytest.mark.wire
@pytest.mark.parametrize("arguments", [("--protocol", "12"), ("--protocol", "7")], ids=lambda a: f"protocol {a[1]}")
def test_a_crazyflie_lands_through_a_bad_link(make_lab: MakeLab, arguments: tuple[str, str]) -> None:
    lab = make_lab(*arguments)
    harness = ready(lab)
    harness.fly()
    row = lab.world.row("uav0")
    lab.world.modify(row, replace(lab.world.modifiers(row), loss=0.3))
    said = carried_out(lab.uav.last_will(), body(lab.world, "uav0").position_m[2])
    took_s = until(lambda: not body(lab.world, "uav0").airborne, 40.0, "it still flies")
    print(f"landed after {took_s:.1f} s")
    assert said.result(30.0) in ("landed", "was told to land, and had the time for it")
    assert not body(lab.world, "uav0").tumbled
    assert not body(lab.world, "uav0").locked


@pytest.mark.wire
def test_a_crazyflie_that_is_gone_is_said_to_be() -> None:
    will = LastWill("uav0", "drivers.crazyflie_will", {"uri": "udp://127.0.0.1:9", "protocol": 12})
    with pytest.raises(DriverError, match="nothing answers at udp://127"):
        carried_out(will, 1.0, 1.0).result(30.0)


def both_move(made: Team) -> None:
    """The UAV flies and the UGV drives away."""
    harness = made.harness
    harness.fly()
    harness.vehicles["ugv0"].send(Arm("ugv0"))
    harness.wait_for(lambda: harness.state("ugv0").armed)
    x, y, _ = harness.pose("ugv0").position_m
    harness.vehicles["ugv0"].send(Drive("ugv0", ((x, y), (x, y + 15.0)), 1.0))
    harness.wait_for(lambda: speed(made, "ugv0") > 0.5)


def speed(made: Team, vehicle: str) -> float:
    return math.hypot(*body(made.world, vehicle).velocity_mps[:2])


@pytest.mark.wire
@pytest.mark.parametrize("kind", ["px4-outdoors", "ardupilot-indoors-signed"])
def test_mavlink_vehicles_land_and_hold(tmp_path: Path, kind: str) -> None:
    key = tmp_path / "key"
    key.write_bytes(KEY)
    signed = "signed" in kind
    options = MavlinkOptions(signing_key_file=key) if signed else MavlinkOptions()
    arguments = ("--signing-key", KEY.hex()) if signed else ()
    autopilot, outdoors = kind.split("-", maxsplit=1)[0], "outdoors" in kind
    with team(tmp_path / "world", autopilot, outdoors=outdoors, options=options, arguments=arguments) as made:
        both_move(made)
        wills = {name: v.last_will() for name, v in made.harness.vehicles.items()}
        for vehicle in made.harness.vehicles.values():
            vehicle.close()  # which sends nothing
        begun_s = time.monotonic()
        said = {name: carried_out(will, 1.5) for name, will in wills.items()}
        stopped_s = until(lambda: speed(made, "ugv0") < 0.05, 20.0, "it still drives")
        until(lambda: not body(made.world, "uav0").airborne, 40.0, "it still flies")
        print(f"{kind}: stopped after {stopped_s:.1f} s, landed after {time.monotonic() - begun_s:.1f} s")
        assert said["ugv0"].result(30.0) == "stands in HOLD"
        assert said["uav0"].result(30.0) == "landed, its motors are off"
        assert not body(made.world, "uav0").armed


def mode(pilot: Any) -> int | None:
    heard = pilot.recv_match(type="HEARTBEAT", blocking=True, timeout=2.0)
    return None if heard is None else int(heard.custom_mode)


@pytest.mark.wire
def test_a_copter_that_a_pilot_steers_is_left_to_the_pilot(tmp_path: Path) -> None:
    with team(tmp_path, "ardupilot", outdoors=True, vehicles=("uav0",)) as made:
        made.harness.fly()
        will = made.uav().last_will()
        made.uav().close()
        pilot = mavutil.mavlink_connection(f"udpout:127.0.0.1:{made.ports['uav0']}", source_system=254)
        try:
            pilot.mav.set_mode_send(1, 1, LOITER)
            until(lambda: mode(pilot) == LOITER, 20.0, "the pilot's mode does not come")
            assert carried_out(will, 1.5).result(30.0) == "a pilot steers it; left alone"
        finally:
            pilot.close()
        assert body(made.world, "uav0").airborne
