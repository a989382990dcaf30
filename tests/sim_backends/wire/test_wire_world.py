"""The shared world of the wire simulators: rows, modifiers, ground and batteries."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from sim_backends.errors import SimulationError
from sim_backends.wire.physics import UavBattery, UgvBattery, ground_under
from sim_backends.wire.world import Body, Modifiers, World
from sim_backends.world import SimUav, SimUgv, WorldConfig

UGV = SimUgv("ugv0", "g", (2.0, 0.0), pad_height_m=0.3, dock_offsets_m=((0.1, 0.0),), charge_s=40.0, idle_w=0.0)


@pytest.fixture
def world(tmp_path: Path) -> World:
    config = WorldConfig(uavs=(SimUav("uav0", "u"),), ugvs=(UGV,), dock_tolerance_m=0.05, scale=0.01, time_scale=0.25)
    return World.create(tmp_path, config)


def test_a_second_handle_sees_the_same_world(world: World) -> None:
    other = World(world.folder)
    body = Body(position_m=(1.0, 2.0, 3.0), armed=True, energy_j=5.0, on=-1, code=2)
    world.put(0, body)
    seen = other.body(0)
    assert replace(seen, time_s=0.0) == body
    assert seen.time_s > 0
    assert other.config == world.config


def test_everybody_begins_at_the_start(world: World) -> None:
    assert world.body(1).position_m == (2.0, 0.0, 0.0)
    assert world.body(0).energy_j == world.config.uavs[0].capacity_j
    assert world.started_s is None
    world.start()
    first = World(world.folder).started_s
    world.start()
    assert first is not None
    assert world.started_s == first


def test_modifiers_pass_through(world: World) -> None:
    assert world.modifiers(0) == Modifiers(swap=0)
    worse = Modifiers(0.5, 1.0, 2.0, 0.0, 0.1, 0.2, 0.3, 1, True, True, True, True, True, 2)
    world.modify(0, worse)
    assert World(world.folder).modifiers(0) == worse
    world.dock_missed(0)
    assert world.modifiers(0).dock_miss == 1


def test_no_world_is_one_clear_error(tmp_path: Path) -> None:
    with pytest.raises(SimulationError, match="holds no simulated world"):
        World(tmp_path / "nowhere")


def test_an_unknown_vehicle_is_named(world: World) -> None:
    with pytest.raises(SimulationError, match=r"'nobody'.*uav0, ugv0"):
        world.row("nobody")


@pytest.mark.parametrize(
    ("at", "ugv", "contact"),
    [
        ((2.1, 0.0, 0.5), 1, True),
        ((2.2, 0.0, 0.5), 1, False),
        ((2.1, 0.0, 0.1), -1, False),
        ((3.0, 0.0, 0.5), -1, False),
    ],
)
def test_ground_is_a_dock_or_the_floor(world: World, at: tuple[float, float, float], ugv: int, contact: bool) -> None:
    ground = ground_under(world, 0, at)
    assert (ground.ugv, ground.contact) == (ugv, contact)
    assert ground.height_m == (0.3 if ugv == 1 else 0.0)


def test_a_battery_empties_in_flight_and_fills_on_the_dock(world: World) -> None:
    battery, ugv = UavBattery(world, 0), UgvBattery(world, 1)
    full = battery.energy_j
    battery.step(25.0, True, 0.0, None, world.modifiers(0))
    assert full - battery.energy_j == pytest.approx(229.6 * 100.0)
    ground = ground_under(world, 0, (2.1, 0.0, 0.3))
    for _ in range(10):  # 40 mission s are 10 arena s
        battery.step(1.0, False, 0.0, ground, world.modifiers(0))
        assert battery.charging
        world.put(0, Body(on=1, drawn_j=battery.drawn_j, energy_j=battery.energy_j))
        ugv.step(1.0, 0.0, world.modifiers(1))
    assert battery.energy_j == pytest.approx(full)
    assert ugv.given_j == pytest.approx(229.6 * 100.0)
    assert ugv.energy_j == pytest.approx(UGV.capacity_j - 229.6 * 100.0)


def test_without_contact_nothing_is_charged(world: World) -> None:
    battery = UavBattery(world, 0)
    battery.step(25.0, True, 0.0, None, world.modifiers(0))
    before = battery.energy_j
    beside = ground_under(world, 0, (2.2, 0.0, 0.3))
    battery.step(1.0, False, 0.0, beside, world.modifiers(0))
    broken = replace(world.modifiers(0), charge_factor=0.0)
    battery.step(1.0, False, 0.0, ground_under(world, 0, (2.1, 0.0, 0.3)), broken)
    assert battery.energy_j == before
    assert not battery.charging
