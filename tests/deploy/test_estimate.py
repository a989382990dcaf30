"""Which poses are trusted, and how much energy is left."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import world
from hypothesis import given
from hypothesis import strategies as st

from deploy import estimate
from deploy.frames import Frame
from deploy.settings import Monitors
from deploy.state import AIRBORNE, Track, UavPhase, UgvPhase
from drivers.vehicle import Pose, Vec3

LIMITS = Monitors(pose_stale_s=0.5, pose_lost_s=3.0, pose_frozen_s=0.5, pose_jump_m=2.0)


def follow(track: Track, at: Vec3, stamp_s: float, *, moving: bool = True, vmax: float = 10.0) -> Track:
    pose = Pose("b", at, 0.1, stamp_s)
    return estimate.follow(track, pose, moving=moving, max_speed_mps=vmax, brake_mps2=2.0, limits=LIMITS)


def flown(speed_mps: float = 10.0, steps: int = 50, dt_s: float = 0.1) -> Track:
    """A track at constant speed along x, from 0."""
    track = estimate.first_track(Pose("b", (0.0, 0.0, 10.0), 0.0, 0.0))
    for i in range(1, steps + 1):
        track = follow(track, (speed_mps * i * dt_s, 0.0, 10.0), i * dt_s)
    return track


# --- poses ------------------------------------------------------------------------------------------------------------


def test_the_first_pose_is_trusted_and_at_rest() -> None:
    track = estimate.first_track(Pose("b", (1.0, 2.0, 3.0), 0.5, 7.0))
    assert track == Track((1.0, 2.0, 3.0), 0.5, 7.0, 0.0, (1.0, 2.0, 3.0), 7.0, 7.0)


def test_speed_settles_at_the_true_one() -> None:
    assert flown(8.0).speed_mps == pytest.approx(8.0, rel=1e-3)
    assert flown(8.0, steps=1).speed_mps == pytest.approx(0.2 * 8.0)  # 0.1 s of the smoothing's 0.5 s


def test_a_pose_from_the_past_changes_nothing() -> None:
    track = flown()
    assert follow(track, (0.0, 0.0, 0.0), track.stamp_s) is track
    assert follow(track, (0.0, 0.0, 0.0), track.stamp_s - 1) is track


def test_a_frozen_pose_does_not_renew_the_trusted_one() -> None:
    track = flown()
    last_s, place = track.stamp_s, track.position_m
    for i in range(1, 8):
        track = follow(track, place, last_s + 0.1 * i)
    assert (track.stamp_s, track.same_since_s) == (last_s, last_s)
    assert track.raw_stamp_s == pytest.approx(last_s + 0.7)
    moved = follow(track, (place[0] + 1e-9, *place[1:]), last_s + 0.8)  # one bit is enough
    assert moved.stamp_s == moved.same_since_s == last_s + 0.8


@pytest.mark.parametrize(("step_m", "trusted"), [(3.19, True), (3.21, False)])
def test_a_jump_is_further_than_it_can_have_moved(step_m: float, trusted: bool) -> None:
    track = estimate.first_track(Pose("b", (0.0, 0.0, 10.0), 0.0, 0.0))
    after = follow(track, (step_m, 0.0, 10.0), 0.1)  # 2 m + 1.2 * 10 m/s * 0.1 s
    assert after.jumped is not trusted
    assert after.position_m == ((step_m, 0.0, 10.0) if trusted else (0.0, 0.0, 10.0))
    assert after.stamp_s == (0.1 if trusted else 0.0)
    assert after.raw_m == (step_m, 0.0, 10.0)


@pytest.mark.parametrize(("away_m", "trusted"), [(37.9, True), (38.1, False)])
def test_after_a_dropout_it_may_have_come_further_but_not_without_limit(away_m: float, trusted: bool) -> None:
    track = estimate.first_track(Pose("b", (0.0, 0.0, 10.0), 0.0, 0.0))
    assert follow(track, (away_m, 0.0, 10.0), 60.0).jumped is not trusted  # 2 m + 1.2 * 10 m/s * 3 s, not * 60 s


def test_dropout_then_return() -> None:
    track = flown(10.0)
    back = follow(track, (65.0, 0.0, 10.0), track.stamp_s + 1.5)
    assert not back.jumped
    assert back.position_m == (65.0, 0.0, 10.0)
    assert back.speed_mps == pytest.approx(10.0)


def test_one_wrong_frame_is_forgotten() -> None:
    track = flown()
    wrong = follow(track, (500.0, 0.0, 10.0), track.stamp_s + 0.1)
    assert wrong.jumped and wrong.position_m == track.position_m
    right = follow(wrong, (52.0, 0.0, 10.0), track.stamp_s + 0.2)
    assert not right.jumped and right.position_m == (52.0, 0.0, 10.0)


@pytest.mark.parametrize(("away_m", "trusted"), [(31.9, True), (32.1, False)])
def test_after_a_jump_only_the_place_where_it_must_have_stopped_is_trusted(away_m: float, trusted: bool) -> None:
    track = replace(flown(10.0), speed_mps=10.0)
    track = follow(track, (500.0, 0.0, 10.0), track.stamp_s + 0.1)
    # 2 m, 0.5 s until it was told to stop, and 10^2 / (2 * 2) m of braking: not 20 s at full speed.
    after = follow(track, (track.position_m[0] + away_m, 0.0, 10.0), track.stamp_s + 20.0)
    assert after.jumped is not trusted


def test_a_jump_stays_one_while_its_place_is_frozen() -> None:
    track = flown()
    track = follow(track, (500.0, 0.0, 10.0), track.stamp_s + 0.1)
    track = follow(track, (500.0, 0.0, 10.0), track.stamp_s + 0.2)
    assert track.jumped


def test_on_the_ground_it_may_be_carried_about() -> None:
    track = estimate.first_track(Pose("b", (0.0, 0.0, 0.0), 0.0, 0.0))
    carried = follow(track, (400.0, 0.0, 0.0), 0.1, moving=False)
    assert not carried.jumped
    assert carried.position_m == (400.0, 0.0, 0.0)
    assert carried.speed_mps <= 10.0
    jumped = follow(flown(), (500.0, 0.0, 0.0), 5.1)
    assert not follow(jumped, (500.1, 0.0, 0.0), 5.2, moving=False).jumped  # landed meanwhile: believed again


@given(st.lists(st.tuples(st.floats(0.01, 1.0), st.floats(-100, 100), st.floats(-100, 100)), min_size=1, max_size=12))
def test_what_is_trusted_was_possible(steps: list[tuple[float, float, float]]) -> None:
    track = estimate.first_track(Pose("b", (0.0, 0.0, 5.0), 0.0, 0.0))
    now_s = 0.0
    for dt_s, x, y in steps:
        now_s += dt_s
        before, track = track, follow(track, (x, y, 5.0), now_s)
        moved_m = math.dist(before.position_m, track.position_m)
        assert moved_m <= 2.0 + max(1.2 * 10 * min(now_s - before.stamp_s, 3.0), 0.5 * 10 + 10**2 / 4)
        assert 0 <= track.speed_mps <= 10.0
        assert track.raw_stamp_s == now_s
        assert track.jumped == (track.stamp_s != now_s) or track.raw_m == before.raw_m


# --- swaps ------------------------------------------------------------------------------------------------------------


def jumped(at: Vec3, raw: Vec3) -> Track:
    return replace(world.track(at), raw_m=raw, jumped=True)


def test_two_that_jumped_to_each_other_have_been_swapped() -> None:
    a, b, c = (0.0, 0.0, 10.0), (50.0, 0.0, 16.0), (99.0, 0.0, 22.0)
    tracks = {"a": jumped(a, b), "b": jumped(b, a), "c": world.track(c)}
    marked = estimate.mark_swaps(tracks, LIMITS)
    assert [marked[v].swapped for v in "abc"] == [True, True, False]
    assert marked["c"] is tracks["c"]


@pytest.mark.parametrize(("off_m", "swapped"), [(3.9, True), (4.1, False)])
def test_how_near_counts_as_the_others_place(off_m: float, swapped: bool) -> None:
    a, b = (0.0, 0.0, 10.0), (50.0, 0.0, 10.0)
    for tracks in (
        {"a": jumped(a, (b[0] + off_m, 0.0, 10.0)), "b": jumped(b, a)},
        {"a": jumped(a, b), "b": jumped(b, (a[0] + off_m, 0.0, 10.0))},
    ):
        assert estimate.mark_swaps(tracks, LIMITS)["a"].swapped is swapped


def test_one_that_jumped_alone_is_no_swap_and_old_marks_go() -> None:
    a, b = (0.0, 0.0, 10.0), (50.0, 0.0, 10.0)
    tracks = {"a": replace(jumped(a, b), swapped=True), "b": world.track(b)}
    assert not estimate.mark_swaps(tracks, LIMITS)["a"].swapped


# --- energy of UAVs ---------------------------------------------------------------------------------------------------

VIRTUAL = world.settings()
MEASURED = world.settings(uav={"energy": "measured"}, ugv={"energy": "measured"})


def uav_energy(of=VIRTUAL, *, now_s: float = 10.0, battery: float | None = None, told: bool = True, **members) -> float:
    uav = world.uav(0, **{"energy_j": 30_000.0, **members})
    telemetry = world.report("uav0", now_s, battery=battery) if told else None
    return estimate.uav_energy(of, uav, of.uavs[0], telemetry, now_s)


@pytest.mark.parametrize("phase", UavPhase)
def test_energy_is_used_in_the_air_only(phase: UavPhase) -> None:
    expected = 30_000 - 10 * 230 if phase in AIRBORNE else 30_000
    assert uav_energy(phase=phase) == pytest.approx(expected)


@pytest.mark.parametrize(("speed_mps", "power_w"), [(0.0, 230.0), (5.0, 215.0), (10.0, 200.0), (15.0, 200.0)])
def test_power_by_speed(speed_mps: float, power_w: float) -> None:
    track = world.track(speed_mps=speed_mps, velocity_mps=(0.6 * speed_mps, -0.8 * speed_mps, 0.0))
    assert uav_energy(phase=UavPhase.FLYING, track=track) == pytest.approx(30_000 - 10 * power_w)


def test_climbing_costs_what_hovering_costs() -> None:
    track = world.track(speed_mps=5.0, velocity_mps=(0.0, 0.0, 5.0))
    assert uav_energy(phase=UavPhase.FLYING, track=track) == pytest.approx(30_000 - 10 * 230)


def test_one_that_was_never_seen_is_counted_as_hovering() -> None:
    assert uav_energy(phase=UavPhase.FLYING, track=None) == pytest.approx(30_000 - 10 * 230)


def test_energy_ends_at_zero_and_time_never_runs_backwards() -> None:
    assert uav_energy(phase=UavPhase.FLYING, energy_j=100.0) == 0.0
    assert uav_energy(phase=UavPhase.FLYING, now_s=-5.0) == 30_000


def test_a_fast_arena_uses_mission_time() -> None:
    of = world.settings(frame=Frame(time_scale=0.1))
    assert uav_energy(of, phase=UavPhase.FLYING, now_s=1.0) == pytest.approx(30_000 - 10 * 230)


def test_a_measured_battery_is_believed() -> None:
    assert uav_energy(MEASURED, battery=0.25, phase=UavPhase.FLYING) == 15_000
    assert uav_energy(VIRTUAL, battery=0.25, phase=UavPhase.FLYING) == pytest.approx(27_700)


@pytest.mark.parametrize("battery", [None, math.nan, math.inf])
def test_where_the_battery_says_nothing_the_model_does(battery: float | None) -> None:
    assert uav_energy(MEASURED, battery=battery, phase=UavPhase.FLYING) == pytest.approx(27_700)
    assert uav_energy(MEASURED, told=False, phase=UavPhase.FLYING) == pytest.approx(27_700)


@pytest.mark.parametrize(("battery", "energy_j"), [(1.3, 60_000.0), (-0.2, 0.0)])
def test_no_battery_holds_more_than_all_or_less_than_nothing(battery: float, energy_j: float) -> None:
    assert uav_energy(MEASURED, battery=battery) == energy_j


def test_charging_by_constant_time() -> None:
    charging = {"phase": UavPhase.CHARGING, "docked": (0, 1), "charge_from_j": 24_000.0, "energy_j": 30_000.0}
    # 36 kJ in 60 s: 600 W.
    assert uav_energy(now_s=10.0, **charging) == pytest.approx(36_000)
    assert uav_energy(now_s=0.0, **charging) == 30_000
    assert uav_energy(now_s=500.0, **charging) == 60_000
    assert uav_energy(now_s=10.0, **{**charging, "docked": None}) == 30_000


def test_charging_by_power() -> None:
    of = world.settings(of=world.problem(charge_w=500.0))
    assert estimate.charge_duration_s(of, 0, 0, 40_000.0) == pytest.approx(40.0)
    assert estimate.charge_duration_s(of, 0, 0, 70_000.0) == 0.0
    assert estimate.charge_duration_s(VIRTUAL, 0, 0, 40_000.0) == 60.0
    charging = {"phase": UavPhase.CHARGING, "docked": (0, 0), "charge_from_j": 20_000.0}
    assert uav_energy(of, now_s=10.0, **charging) == pytest.approx(35_000)


def test_a_charge_that_takes_no_time() -> None:
    of = world.settings(of=world.problem(charge_s=0.0))
    charging = {"phase": UavPhase.CHARGING, "docked": (0, 0), "charge_from_j": 20_000.0}
    assert uav_energy(of, now_s=0.0, **charging) == 30_000
    assert uav_energy(of, now_s=0.1, **charging) == 60_000


# --- energy of UGVs ---------------------------------------------------------------------------------------------------


def ugv_energy(of=VIRTUAL, *, now_s: float = 10.0, battery: float | None = None, **members) -> float:
    ugv = world.ugv(0, **{"energy_j": 100_000.0, **members})
    return estimate.ugv_energy(of, ugv, of.ugvs[0], world.report("ugv0", now_s, battery=battery), now_s)


@pytest.mark.parametrize("phase", UgvPhase)
def test_driving_and_standing(phase: UgvPhase) -> None:
    of = world.settings(of=world.problem(ugv={"idle_w": 50.0}))
    power_w = 2000 if phase is UgvPhase.DRIVING else 50
    assert ugv_energy(of, phase=phase) == pytest.approx(100_000 - 10 * power_w)


def test_ugv_limits() -> None:
    assert ugv_energy(phase=UgvPhase.DRIVING, energy_j=1.0) == 0.0
    assert ugv_energy(phase=UgvPhase.DRIVING, now_s=-1.0) == 100_000
    assert ugv_energy(MEASURED, battery=0.5, phase=UgvPhase.DRIVING) == 500_000
    assert ugv_energy(MEASURED, battery=None, phase=UgvPhase.DRIVING) == pytest.approx(80_000)
