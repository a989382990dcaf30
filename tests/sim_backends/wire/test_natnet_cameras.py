"""What the simulated cameras see: noise as configured, occlusions, and each fault of motion capture."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.mocap_axes import yaw_of
from sim_backends.wire.cameras import Cameras
from sim_backends.wire.natnet_packets import Seen
from sim_backends.wire.world import Body, Modifiers, World, yaw_quaternion
from sim_backends.world import SimUav, SimUgv, WorldConfig

CONFIG = WorldConfig(
    uavs=(SimUav("u0", "a", (1.0, 2.0)), SimUav("u1", "b", (-1.0, 0.0))),
    ugvs=(SimUgv("g0", "c", (3.0, 0.0), yaw_rad=0.7),),
    pose_noise_m=0.002,
    pose_noise_rad=0.01,
)
EXACT = replace(CONFIG, pose_noise_m=0.0, pose_noise_rad=0.0)


def cameras(folder: Path, config: WorldConfig = EXACT) -> tuple[World, Cameras]:
    world = World.create(folder, config)
    return world, Cameras(world, 100.0)


def looks(eyes: Cameras, n: int, at_s: float = 0.0) -> list[list[Seen]]:
    return [eyes.look(at_s + k / 100) for k in range(n)]


def test_who_has_not_begun_stands_at_the_start(tmp_path: Path) -> None:
    _, eyes = cameras(tmp_path)
    seen = eyes.look(0.0)
    assert [s.number for s in seen] == [1, 2, 3]
    assert [s.position_m for s in seen] == [(1.0, 2.0, 0.0), (-1.0, 0.0, 0.0), (3.0, 0.0, 0.0)]
    assert yaw_of(seen[2].quaternion) == pytest.approx(0.7)
    assert all(s.tracked for s in seen)


def test_the_world_is_followed(tmp_path: Path) -> None:
    world, eyes = cameras(tmp_path)
    eyes.look(0.0)
    world.put(1, Body(position_m=(4.0, 5.0, 6.0), quaternion=yaw_quaternion(-1.0)))
    seen = eyes.look(0.01)[1]
    assert seen.position_m == (4.0, 5.0, 6.0)
    assert yaw_of(seen.quaternion) == pytest.approx(-1.0)


def test_noise_is_as_the_world_says(tmp_path: Path) -> None:
    _, eyes = cameras(tmp_path, CONFIG)
    seen = [s[2] for s in looks(eyes, 3000)]
    for axis, mean_m in enumerate((3.0, 0.0, 0.0)):
        values = [s.position_m[axis] for s in seen]
        assert statistics.fmean(values) == pytest.approx(mean_m, abs=0.0003)
        assert statistics.stdev(values) == pytest.approx(0.002, rel=0.1)
    yaws = [yaw_of(s.quaternion) or 0.0 for s in seen]
    assert statistics.fmean(yaws) == pytest.approx(0.7, abs=0.001)
    assert statistics.stdev(yaws) == pytest.approx(0.01, rel=0.1)
    assert all(math.hypot(*s.quaternion) == pytest.approx(1.0) for s in seen)


def test_the_same_seed_sees_the_same(tmp_path: Path) -> None:
    _, one = cameras(tmp_path / "one", CONFIG)
    _, two = cameras(tmp_path / "two", CONFIG)
    _, other = cameras(tmp_path / "other", replace(CONFIG, seed=1))
    assert looks(one, 5) == looks(two, 5)
    assert looks(one, 5) != looks(other, 5)


@pytest.mark.parametrize("modifiers", [Modifiers(dropout=True), Modifiers(lost=True)])
def test_a_hidden_body_is_not_tracked_and_the_others_are(tmp_path: Path, modifiers: Modifiers) -> None:
    world, eyes = cameras(tmp_path)
    eyes.look(0.0)
    world.modify(0, modifiers)
    assert [s.tracked for s in eyes.look(0.01)] == [False, True, True]
    world.modify(0, Modifiers())
    assert eyes.look(0.02)[0].tracked


def test_silence_of_a_link_is_not_seen_by_cameras(tmp_path: Path) -> None:
    world, eyes = cameras(tmp_path)
    world.modify(0, Modifiers(silent=True, loss=1.0, motor_fail=True))
    assert eyes.look(0.0)[0].tracked


def test_a_frozen_body_repeats_its_last_pose_to_the_bit(tmp_path: Path) -> None:
    world, eyes = cameras(tmp_path, CONFIG)
    before = eyes.look(0.0)[1]
    world.modify(1, Modifiers(freeze=True))
    world.put(1, Body(position_m=(9.0, 9.0, 9.0)))
    assert [s[1] for s in looks(eyes, 3)] == [before] * 3
    world.modify(1, Modifiers())
    assert eyes.look(1.0)[1].position_m[0] == pytest.approx(9.0, abs=0.02)


def test_a_jump_moves_the_pose_aside(tmp_path: Path) -> None:
    world, eyes = cameras(tmp_path)
    world.modify(0, Modifiers(jump_x=0.5, jump_y=-0.25))
    assert eyes.look(0.0)[0].position_m == (1.5, 1.75, 0.0)


def test_swapped_bodies_carry_each_others_pose(tmp_path: Path) -> None:
    world, eyes = cameras(tmp_path)
    world.modify(0, Modifiers(swap=1))
    world.modify(1, Modifiers(swap=0))
    a, b, c = eyes.look(0.0)
    assert (a.number, b.number) == (1, 2)
    assert (a.position_m, b.position_m) == ((-1.0, 0.0, 0.0), (1.0, 2.0, 0.0))
    assert c.position_m == (3.0, 0.0, 0.0)


def test_occlusions_come_as_often_and_as_long_as_configured(tmp_path: Path) -> None:
    config = replace(EXACT, occlusions_per_s=2.0, occlusion_s=0.05)
    _, eyes = cameras(tmp_path, config)
    seen = looks(eyes, 8000)  # 80 s
    for row in range(3):
        hidden = [not s[row].tracked for s in seen]
        spells = sum(now and not before for before, now in zip([False, *hidden], hidden, strict=False))
        assert spells == pytest.approx(160 * 0.9, rel=0.25)  # some fall into another
        assert sum(hidden) / 100 / spells == pytest.approx(0.055, rel=0.2)
