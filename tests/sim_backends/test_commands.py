"""Commands beyond the drivers' contract: odd moments, odd orders, paths of every length."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest

from drivers.vehicle import Disarm, Dock, Drive, GoTo, Hold, Land, StopMotors, TakeOff
from sim_backends.world import SimUav
from tests.sim_backends.flying import WORLD, Team


def height(team: Team, vehicle: str = "uav0") -> float:
    return team.truth(vehicle).position_m[2]


def up(altitude_m: float = 10.0) -> Team:
    team = Team()
    team.send(TakeOff("uav0", altitude_m, 4.0))
    team.wait(8.0)
    return team


def test_a_take_off_in_flight_changes_the_altitude() -> None:
    team = up()
    team.send(TakeOff("uav0", 20.0, 4.0))
    team.wait(1.0)
    team.send(TakeOff("uav0", 25.0, 4.0))
    team.wait(10.0)
    assert height(team) == pytest.approx(25.0, abs=0.5)


@pytest.mark.parametrize("energy_j", [0.0, 287_700.0])
def test_a_take_off_to_nowhere_or_on_an_empty_battery_is_ignored(energy_j: float) -> None:
    team = Team(uavs=(SimUav("uav0", "cf0", energy_j=energy_j),))
    team.send(TakeOff("uav0", -1.0 if energy_j else 10.0, 3.0))
    team.wait(5.0)
    assert not team.truth("uav0").airborne


def test_a_falling_uav_obeys_nobody() -> None:
    team = up(50.0)
    team.send(StopMotors("uav0"))
    team.wait(1.0)
    team.send(TakeOff("uav0", 50.0, 4.0), Hold("uav0"), Disarm("uav0"), StopMotors("uav0"))
    team.wait(1.0)
    assert team.truth("uav0").phase == "fall"
    team.wait(5.0)
    assert team.truth("uav0").phase == "crashed"


def test_a_landing_can_be_broken_off() -> None:
    team = up(20.0)
    team.send(Land("uav0", 2.0))
    team.wait(4.0)
    team.send(Hold("uav0"))
    team.wait(10.0)
    assert 8.0 < height(team) < 18.0
    team.send(GoTo("uav0", (20.0, 0.0, 20.0), 5.0))
    team.wait(10.0)
    assert math.dist(team.truth("uav0").position_m, (20.0, 0.0, 20.0)) < 0.5


def test_a_landing_out_of_a_fast_flight_does_not_drag() -> None:
    team = up(20.0)
    team.send(GoTo("uav0", (300.0, 0.0, 20.0), 12.0))
    team.wait(8.0)
    team.send(Land("uav0", 3.0))
    team.wait(5.0)
    x = team.truth("uav0").position_m[0]
    team.wait(15.0)
    assert team.truth("uav0").phase == "ground"
    assert team.truth("uav0").position_m[0] == pytest.approx(x, abs=0.6)


def test_a_flight_can_be_turned_around_within_its_acceleration() -> None:
    team = up(20.0)
    team.send(GoTo("uav0", (300.0, 0.0, 20.0), 12.0))
    team.wait(8.0)
    team.send(GoTo("uav0", (0.0, 0.0, 20.0), 12.0))
    speeds = []
    for _ in range(300):
        team.wait(0.1)
        speeds.append(team.truth("uav0").speed_mps)
    assert all(abs(b - a) <= 0.3 + 1e-9 for a, b in pairwise(speeds))
    assert math.dist(team.truth("uav0").position_m, (0.0, 0.0, 20.0)) < 0.5


def test_a_docking_can_be_broken_off_by_a_hold() -> None:
    team = up()
    team.send(GoTo("uav0", (50.0, 0.0, 10.0), 10.0))
    team.wait(15.0)
    team.send(Dock("uav0", "ugv0", 0, 1.0, 15.0))
    team.wait(4.0)
    team.send(Hold("uav0"))
    team.wait(5.0)
    assert 4.0 < height(team) < 9.0
    team.send(Dock("uav0", "ugv0", 0, 1.0, 15.0))
    team.wait(15.0)
    assert team.truth("uav0").on == "ugv0"


def test_a_ugv_takes_a_new_path_from_where_it_is() -> None:
    team = Team()
    team.send(Drive("ugv0", ((50.0, 0.0), (250.0, 0.0)), 4.0))
    team.wait(10.0)
    x, y, _ = team.truth("ugv0").position_m
    team.send(Drive("ugv0", ((x, y), (x, y), (x + 20.0, y + 20.0)), 4.0))
    team.wait(30.0)
    assert math.dist(team.truth("ugv0").position_m[:2], (x + 20.0, y + 20.0)) < 0.5


def test_a_path_may_be_long_or_lead_nowhere() -> None:
    team = Team()
    circle = tuple(
        (50.0 + 30.0 * math.sin(a / 50), 30.0 - 30.0 * math.cos(a / 50)) for a in range(round(50 * math.pi) + 1)
    )
    team.send(Drive("ugv0", circle, 4.0), Drive("ugv1", ((50.0, 60.0),), 4.0))
    team.wait(20.0)
    assert team.truth("ugv1").position_m == (50.0, 60.0, 0.0)
    assert math.dist(team.truth("ugv0").position_m[:2], (50.0, 30.0)) == pytest.approx(30.0, abs=0.3)
    team.wait(20.0)
    assert math.dist(team.truth("ugv0").position_m[:2], circle[-1]) < 0.3


def test_a_disarmed_ugv_brakes() -> None:
    team = Team()
    team.send(Drive("ugv0", ((50.0, 0.0), (250.0, 0.0)), 4.0))
    team.wait(10.0)
    team.send(Disarm("ugv0"))
    team.wait(6.0)
    assert team.truth("ugv0").speed_mps == 0.0
    team.send(Drive("ugv0", ((50.0, 0.0), (250.0, 0.0)), 4.0))
    team.wait(2.0)
    assert team.truth("ugv0").speed_mps == 0.0


def test_a_uav_alone_is_a_world() -> None:
    team = Team(ugvs=(), uavs=WORLD.uavs[:1])
    team.send(TakeOff("uav0", 5.0, 2.0))
    team.wait(6.0)
    assert height(team) == pytest.approx(5.0, abs=0.5)
    assert team.backend.truth().min_uav_distance_m == math.inf
