"""Every fault shows where it should: in the motion, the poses, the telemetry or the battery."""

from __future__ import annotations

import math

import pytest

from drivers.vehicle import Dock, Drive, GoTo, Hold, TakeOff
from sim_backends.errors import SimulationError
from sim_backends.faults import Fault, FaultKind
from sim_backends.world import UAV_POWER_W, SimUav
from tests.sim_backends.flying import WORLD, Team

ROAD = ((50.0, 0.0), (450.0, 0.0))
START_S = 1.0


def driving(*faults: Fault) -> Team:
    team = Team(*faults)
    team.send(Drive("ugv0", ROAD, 4.0))
    return team


def flying(*faults: Fault, **changes: object) -> Team:
    """Two UAVs, one at 20 m on a long way, the other hovering at 30 m."""
    team = Team(*faults, **changes)
    team.send(TakeOff("uav0", 20.0, 4.0), TakeOff("uav1", 30.0, 4.0))
    team.wait(12.0)
    team.send(GoTo("uav0", (400.0, 0.0, 20.0), 10.0))
    return team


def docking(*faults: Fault, **changes: object) -> Team:
    """uav0 over dock 0 of ugv0, told to dock."""
    team = Team(*faults, **changes)
    team.send(TakeOff("uav0", 10.0, 4.0))
    team.wait(8.0)
    team.send(GoTo("uav0", (50.0, 0.0, 10.0), 10.0))
    team.wait(15.0)
    team.send(Dock("uav0", "ugv0", 0, 2.0, 15.0))
    return team


def test_a_stalled_ugv_stands_still_and_goes_on_afterwards() -> None:
    team = driving(Fault(FaultKind.UGV_STALL, "ugv0", at_s=10.0, duration_s=20.0))
    team.until(START_S + 16.0)
    x = team.truth("ugv0").position_m[0]
    team.until(START_S + 29.0)
    assert team.truth("ugv0").position_m[0] == x
    team.until(START_S + 40.0)
    assert team.truth("ugv0").position_m[0] > x + 20.0


def test_a_slow_ugv_keeps_its_factor() -> None:
    team = driving(Fault(FaultKind.UGV_SLOW, "ugv0", at_s=10.0, value=0.5))
    team.until(START_S + 20.0)
    assert team.truth("ugv0").speed_mps == pytest.approx(2.0)


@pytest.mark.parametrize("vehicle", ["uav0", None])
def test_head_wind_costs_ground_speed(vehicle: str | None) -> None:
    team = flying(Fault(FaultKind.HEAD_WIND, vehicle, at_s=1.0, value=3.0))
    team.wait(15.0)
    truth = team.truth("uav0")
    assert truth.speed_mps == pytest.approx(7.0)


def test_head_wind_does_not_slow_a_climb_that_is_almost_vertical() -> None:
    team = flying(Fault(FaultKind.HEAD_WIND, "uav0", at_s=1.0, value=3.0))
    team.wait(5.0)
    x, y, z = team.truth("uav0").position_m
    team.send(Hold("uav0"))
    team.wait(6.0)
    x, y, z = team.truth("uav0").position_m
    team.send(GoTo("uav0", (x + 1.0, y, z + 20.0), 10.0))
    team.wait(8.0)  # 20 m at 5 m/s, with acceleration and latency
    assert team.truth("uav0").position_m[2] > z + 19.0


def test_a_drained_battery_empties_faster_by_its_factor() -> None:
    used = []
    for faults in ((), (Fault(FaultKind.BATTERY_DRAIN, "uav1", at_s=0.0, value=2.0),)):
        team = flying(*faults)
        team.wait(30.0)
        used.append(team.truth("uav1").used_j)
    assert used[1] == pytest.approx(2.0 * used[0])


def test_power_is_the_model_s() -> None:
    team = flying()
    before, start_s = team.truth("uav1").used_j, team.now_s
    team.wait(50.0)
    assert (team.truth("uav1").used_j - before) / (team.now_s - start_s) == pytest.approx(UAV_POWER_W[0])


@pytest.mark.parametrize("factor", [0.25, 0.0])
def test_slow_charging_gives_less(factor: float) -> None:
    uavs = (SimUav("uav0", "cf0", on="ugv0", energy_j=100_000.0), WORLD.uavs[1])
    team = Team(Fault(FaultKind.CHARGE_SLOW, "uav0", at_s=20.0, value=factor), uavs=uavs)
    team.send(TakeOff("uav1", 30.0, 4.0))
    team.until(START_S + 19.0)
    rate = (team.truth("uav0").energy_j - 100_000.0) / team.now_s
    assert team.state("uav0").charging
    team.wait(2.0)
    before, before_s = team.truth("uav0").energy_j, team.now_s
    team.wait(20.0)
    assert (team.truth("uav0").energy_j - before) / (team.now_s - before_s) == pytest.approx(factor * rate, rel=0.02)
    assert team.state("uav0").charging is (factor > 0)


@pytest.mark.parametrize("vehicle", ["uav1", None])
def test_a_dropout_ends_the_stream_of_that_body(vehicle: str | None) -> None:
    team = flying(Fault(FaultKind.POSE_DROPOUT, vehicle, at_s=20.0, duration_s=5.0))
    team.until(START_S + 24.0)
    assert team.now_s - team.poses["uav1"].stamp_s > 3.0
    assert (team.now_s - team.poses["ugv1"].stamp_s > 3.0) is (vehicle is None)
    team.until(START_S + 26.0)
    assert team.now_s - team.poses["uav1"].stamp_s < 0.2


def test_a_frozen_pose_repeats_with_fresh_stamps() -> None:
    team = flying(Fault(FaultKind.POSE_FREEZE, "uav0", at_s=20.0, duration_s=5.0))
    team.feeding = False
    team.until(START_S + 21.0)
    first = team.poses["uav0"]
    team.until(START_S + 24.0)
    second = team.poses["uav0"]
    assert (first.position_m, first.yaw_rad) == (second.position_m, second.yaw_rad)
    assert second.stamp_s > first.stamp_s + 2.0
    assert math.dist(second.position_m, team.truth("uav0").position_m) > 10.0


def test_a_jump_displaces_the_pose_by_its_length() -> None:
    team = flying(Fault(FaultKind.POSE_JUMP, "uav1", at_s=20.0, duration_s=2.0, value=6.0))
    team.feeding = False
    team.until(START_S + 21.0)
    assert math.dist(team.poses["uav1"].position_m, team.truth("uav1").position_m) == pytest.approx(6.0, abs=0.3)
    team.until(START_S + 23.0)
    assert math.dist(team.poses["uav1"].position_m, team.truth("uav1").position_m) < 0.3


def test_swapped_bodies_show_each_other() -> None:
    team = flying(Fault(FaultKind.POSE_SWAP, "uav1", at_s=20.0, duration_s=2.0, other="ugv1"))
    team.feeding = False
    team.until(START_S + 21.0)
    assert math.dist(team.poses["uav1"].position_m, team.truth("ugv1").position_m) < 0.3
    assert math.dist(team.poses["ugv1"].position_m, team.truth("uav1").position_m) < 0.3


@pytest.mark.parametrize("kind", [FaultKind.POSE_JUMP, FaultKind.POSE_SWAP])
def test_whoever_feeds_a_false_pose_moves_the_vehicle(kind: FaultKind) -> None:
    fault = Fault(kind, "uav1", 20.0, 5.0, *((8.0, None) if kind is FaultKind.POSE_JUMP else (None, "uav0")))
    fed, ignored = flying(fault), flying(fault)
    fed.until(START_S + 19.5)
    ignored.until(START_S + 19.5)
    ignored.feeding = False
    moved = []
    for team in (fed, ignored):
        before = team.truth("uav1").position_m
        team.until(START_S + 24.0)
        moved.append(math.dist(before, team.truth("uav1").position_m))
    assert moved[0] > 4.0
    assert moved[1] < 1.0


def test_lost_telemetry_ages_while_commands_get_through() -> None:
    team = flying(Fault(FaultKind.TELEMETRY_LOSS, "uav0", at_s=20.0, duration_s=6.0))
    team.until(START_S + 21.0)
    team.send(GoTo("uav0", (100.0, 50.0, 20.0), 10.0))
    team.until(START_S + 25.0)
    assert team.now_s - team.state("uav0").stamp_s > 4.0
    assert team.now_s - team.state("uav1").stamp_s < 0.3
    assert team.state("uav0").link
    team.until(START_S + 35.0)
    assert team.now_s - team.state("uav0").stamp_s < 0.3
    assert math.dist(team.truth("uav0").position_m, (100.0, 50.0, 20.0)) < 30.0


def test_a_lost_uav_goes_silent_and_lands_by_itself() -> None:
    team = flying(Fault(FaultKind.VEHICLE_LOST, "uav1", at_s=20.0))
    team.until(START_S + 21.0)
    assert team.truth("uav1").airborne
    team.until(START_S + 45.0)
    truth, state = team.truth("uav1"), team.state("uav1")
    assert (truth.airborne, truth.armed, truth.tumbled, truth.phase) == (False, False, False, "ground")
    assert not state.link
    assert state.airborne, "the last it told"
    assert team.now_s - state.stamp_s > 20.0
    assert team.now_s - team.poses["uav1"].stamp_s > 20.0


def test_failing_motors_let_a_uav_fall() -> None:
    team = flying(Fault(FaultKind.VEHICLE_LOST, "uav1", at_s=20.0, value=1))
    team.until(START_S + 25.0)
    state = team.state("uav1")
    assert (state.airborne, state.tumbled, state.locked, state.link) == (False, True, True, True)
    assert state.fault == "motor failure"
    (crash,) = team.backend.truth().violations
    assert (crash.kind, crash.cause, crash.scripted) == ("crash", "motor failure", True)


@pytest.mark.parametrize("value", [0, 1])
def test_a_lost_ugv_stops(value: int) -> None:
    team = driving(Fault(FaultKind.VEHICLE_LOST, "ugv0", at_s=10.0, value=value))
    team.until(START_S + 20.0)
    assert team.truth("ugv0").speed_mps == 0.0
    assert team.truth("ugv0").position_m[0] < 100.0
    assert team.state("ugv0").link is (value == 1)
    assert team.state("ugv0").locked is (value == 1)


def test_a_missed_dock_climbs_away_as_often_as_told() -> None:
    team = docking(Fault(FaultKind.DOCK_MISSED, "uav0", at_s=0.0, value=2))
    for _ in range(2):
        team.wait(20.0)
        assert team.state("uav0").fault == "dock missed"
        assert team.truth("uav0").position_m[2] == pytest.approx(15.0, abs=0.5)
        assert not team.state("uav0").charging
        team.send(Dock("uav0", "ugv0", 0, 2.0, 15.0))
    team.wait(20.0)
    assert team.truth("uav0").on == "ugv0"
    assert team.state("uav0").charging
    assert team.state("uav0").fault is None


def test_a_moving_ugv_is_not_docked_on() -> None:
    team = docking()
    team.send(Drive("ugv0", ROAD, 3.0))
    team.wait(10.0)
    assert team.truth("uav0").airborne
    assert team.state("uav0").fault == "dock missed"


def test_a_taken_dock_is_not_docked_on() -> None:
    team = docking(uavs=(WORLD.uavs[0], SimUav("uav1", "cf1", on="ugv0", dock=0)))
    team.wait(15.0)
    assert team.truth("uav0").airborne


def test_a_slow_planner_is_told_to_whoever_runs_it() -> None:
    team = driving(Fault(FaultKind.PLANNER_SLOW, at_s=5.0, duration_s=5.0, value=4.0))
    team.until(START_S + 4.0)
    assert team.backend.planner_delay_s() == 0.0
    team.until(START_S + 6.0)
    assert team.backend.planner_delay_s() == 4.0
    team.until(START_S + 11.0)
    assert team.backend.planner_delay_s() == 0.0


def test_faults_wait_for_the_first_motion() -> None:
    team = Team(Fault(FaultKind.POSE_DROPOUT, "uav0", at_s=0.0))
    team.until(20.0)
    assert team.now_s - team.poses["uav0"].stamp_s < 0.2
    team.send(TakeOff("uav1", 10.0, 3.0))
    team.wait(2.0)
    assert team.now_s - team.poses["uav0"].stamp_s > 1.0


def test_a_fault_for_nobody_is_refused() -> None:
    with pytest.raises(SimulationError, match=r"uav7.*uav0, uav1"):
        Team(Fault(FaultKind.DOCK_MISSED, "uav7"))
    with pytest.raises(SimulationError, match=r"uav0.*ugv0, ugv1"):
        Team(Fault(FaultKind.UGV_STALL, "uav0"))


def test_a_dock_is_missed_only_as_long_as_the_fault_lasts() -> None:
    team = docking(Fault(FaultKind.DOCK_MISSED, "uav0", at_s=0.0, duration_s=10.0, value=5))
    team.wait(20.0)
    assert team.truth("uav0").on == "ugv0"


def test_a_lost_vehicle_hears_nothing_until_its_link_is_back() -> None:
    lost = [Fault(FaultKind.VEHICLE_LOST, v, at_s=5.0, duration_s=10.0) for v in ("uav1", "ugv0")]
    team = driving(*lost)
    team.until(START_S + 7.0)
    team.send(TakeOff("uav1", 10.0, 3.0), Drive("ugv0", ROAD, 3.0))
    team.until(START_S + 14.0)
    assert not team.truth("uav1").airborne
    assert team.truth("ugv0").speed_mps == 0.0
    team.until(START_S + 17.0)
    assert team.state("uav1").link
    team.send(TakeOff("uav1", 10.0, 3.0))
    team.wait(8.0)
    assert team.truth("uav1").position_m[2] == pytest.approx(10.0, abs=0.5)
