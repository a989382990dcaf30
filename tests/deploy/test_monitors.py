"""Each monitor says so when its threshold is crossed, and not before."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import world
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from deploy import monitors
from deploy.events import EventKind as K
from deploy.flightpath import TimedPath, along, resting, straight
from deploy.frames import Frame
from deploy.observation import Observation
from deploy.settings import Separation
from deploy.state import AIRBORNE, Order, UavPhase, UavState, UgvPhase
from drivers.vehicle import Arm, Command, Drive, GoTo, Hold, Land, Vec3
from planner.plan import Move, Recharge, Visit

S = world.settings(n_uavs=2, n_ugvs=2)
FLYING = {"phase": UavPhase.FLYING, "now_s": 100.0}
AIR: Vec3 = (50.0, 30.0, 10.0)


def found(*, uavs=(), ugvs=(), now_s: float = 100.0, of=S, **kwargs) -> list[tuple[str, str | None]]:
    turn = world.turn(of, now_s=now_s, uavs=list(uavs), ugvs=list(ugvs), **kwargs)
    return [(f.kind.value, f.vehicle) for f in monitors.findings(turn)]


def of_uav(at: Vec3 = AIR, of=S, **members) -> list[str]:
    """What is found about one flying UAV that is well but for ``members``."""
    return [kind for kind, _ in found(uavs=[world.uav(0, at, **{**FLYING, **members})], of=of)]


def of_ugv(at: Vec3 = (50.0, 0.0, 0.0), of=S, **members) -> list[str]:
    return [
        kind
        for kind, _ in found(ugvs=[world.ugv(0, at, **{"phase": UgvPhase.DRIVING, "now_s": 100.0, **members})], of=of)
    ]


def test_all_is_well() -> None:
    assert found(uavs=[world.uav(0, AIR, **FLYING)], ugvs=[world.ugv(0, now_s=100.0)]) == []
    assert of_ugv() == []


def test_findings_come_in_the_order_of_vehicles_with_words() -> None:
    uavs = [world.uav(i, (50.0 * i, 0.0, 10.0), **{**FLYING, "telemetry": None}) for i in range(2)]
    turn = world.turn(S, now_s=100.0, uavs=uavs, ugvs=[world.ugv(0, now_s=100.0, track=None)])
    assert [(f.kind, f.vehicle) for f in monitors.findings(turn)] == [
        (K.LINK_LOST, "uav0"),
        (K.LINK_LOST, "uav1"),
        (K.POSE_STALE, "ugv0"),
    ]
    assert all(f.vehicle in f.text for f in monitors.findings(turn))


def test_the_lost_are_not_watched() -> None:
    uav = world.uav(0, (500.0, 500.0, 500.0), phase=UavPhase.LOST, telemetry=None)
    ugv = world.ugv(0, (500.0, 500.0, 0.0), phase=UgvPhase.LOST, telemetry=None)
    assert found(uavs=[uav], ugvs=[ugv], now_s=900.0) == []


@pytest.mark.parametrize(("late_s", "kinds"), [(0.2, []), (0.201, [("ground_overloaded", None)])])
def test_a_late_loop(late_s: float, kinds: list) -> None:
    assert found(seen=Observation(100.0, late_s=late_s)) == kinds


# --- poses and telemetry ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("age_s", "kinds"),
    [(0.5, []), (0.501, ["pose_stale"]), (3.0, ["pose_stale"]), (3.001, ["pose_lost"]), (500.0, ["pose_lost"])],
)
def test_age_of_the_pose(age_s: float, kinds: list[str]) -> None:
    assert of_uav(track=world.track(AIR, 100.0 - age_s)) == kinds
    assert of_ugv(track=world.track((50.0, 0.0, 0.0), 100.0 - age_s)) == kinds


@pytest.mark.parametrize(("same_s", "kinds"), [(0.49, []), (0.5, ["pose_frozen"])])
def test_a_frozen_pose(same_s: float, kinds: list[str]) -> None:
    assert of_uav(track=world.track(AIR, 100.0, raw_stamp_s=100.0, same_since_s=100.0 - same_s)) == kinds


def test_silence_is_not_frozen() -> None:
    assert of_uav(track=world.track(AIR, 98.0)) == ["pose_stale"]


def test_never_seen() -> None:
    assert of_uav(track=None) == ["pose_stale"]
    assert of_ugv(track=None) == ["pose_stale"]


def test_jumps_count_while_moving() -> None:
    track = world.track(AIR, 100.0, jumped=True, raw_m=(58.0, 30.0, 10.0))
    assert of_uav(track=track) == ["pose_jump"]
    assert of_uav(track=track, phase=UavPhase.ON_PAD) == []
    assert of_ugv(track=replace(track, position_m=(50.0, 0.0, 0.0))) == ["pose_jump"]
    assert of_ugv(track=track, phase=UgvPhase.PARKED) == []


def test_a_swap_is_told_instead_of_the_jump() -> None:
    track = world.track(AIR, 100.0, jumped=True, swapped=True)
    assert of_uav(track=track) == ["pose_swap"]
    assert of_uav(track=track, phase=UavPhase.ON_PAD) == ["pose_swap"]


@pytest.mark.parametrize(
    ("age_s", "kinds"),
    [(1.5, []), (1.501, ["telemetry_stale"]), (5.0, ["telemetry_stale"]), (5.001, ["link_lost"])],
)
def test_age_of_telemetry(age_s: float, kinds: list[str]) -> None:
    assert of_uav(telemetry=world.report("uav0", 100.0 - age_s)) == kinds
    assert of_ugv(telemetry=world.report("ugv0", 100.0 - age_s)) == kinds


def test_a_link_that_says_it_is_down_and_one_that_never_was_up() -> None:
    assert of_uav(telemetry=world.report("uav0", 100.0, link=False)) == ["link_lost"]
    assert of_uav(telemetry=None) == ["link_lost"]


@pytest.mark.parametrize("phase", [p for p in UavPhase if p is not UavPhase.LOST])
def test_tumbled(phase: UavPhase) -> None:
    assert "tumbled" in of_uav(phase=phase, telemetry=world.report("uav0", 100.0, tumbled=True))
    assert of_ugv(telemetry=world.report("ugv0", 100.0, tumbled=True)) == ["tumbled"]


@pytest.mark.parametrize(
    ("attempts", "sent_s", "confirmed", "kinds"),
    [
        (5, 98.0, False, ["command_failed"]),
        (5, 98.01, False, []),
        (4, 90.0, False, []),
        (5, 90.0, True, []),
    ],
)
def test_a_command_without_effect(attempts: int, sent_s: float, confirmed: bool, kinds: list[str]) -> None:
    order = Order(Hold("uav0"), 80.0, sent_s, attempts, confirmed)
    assert of_uav(order=order) == kinds
    assert of_ugv(order=replace(order, command=Arm("ugv0")), phase=UgvPhase.PARKED) == kinds


def test_a_drive_without_effect_is_for_the_stuck_monitor() -> None:
    drive = Drive("ugv0", ((0.0, 0.0), (90.0, 0.0)), 5.0)
    assert of_ugv(order=Order(drive, 80.0, 90.0, 9), progress_s=40.001) == []
    assert of_ugv(order=Order(drive, 80.0, 90.0, 9), progress_s=40.0) == ["ugv_stuck"]
    assert of_ugv(progress_s=0.0, phase=UgvPhase.HOLDING) == []


# --- where they are ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("at", "kinds"),
    [
        ((50.0, 194.9, 10.0), []),
        ((50.0, 195.1, 10.0), ["geofence_soft"]),
        ((50.0, 199.9, 10.0), ["geofence_soft"]),
        ((50.0, 200.1, 10.0), ["geofence_hard"]),
        ((50.0, 30.0, 54.9), []),
        ((50.0, 30.0, 55.1), ["geofence_soft"]),
        ((50.0, 30.0, 60.1), ["geofence_hard"]),
    ],
)
def test_geofence(at: Vec3, kinds: list[str]) -> None:
    assert of_uav(at, energy_j=1e9) == kinds
    assert of_uav(at, energy_j=1e9, phase=UavPhase.DOWN) == []
    on_floor = kinds if at[2] == 10.0 else []  # a UGV has no height
    assert of_ugv(at) == on_floor
    assert of_ugv(at, phase=UgvPhase.HOLDING) == on_floor
    assert of_ugv(at, phase=UgvPhase.PARKED) == []


@pytest.mark.parametrize(("off_m", "kinds"), [(10.0, []), (10.1, ["ugv_off_road"])])
def test_off_road(off_m: float, kinds: list[str]) -> None:
    route = ((0.0, 0.0), (100.0, 0.0), (100.0, 100.0))
    assert of_ugv((50.0, off_m, 0.0), route_m=route) == kinds
    assert of_ugv((100.0 + off_m, 50.0, 0.0), route_m=route) == kinds
    assert of_ugv((50.0, off_m, 0.0), route_m=()) == []
    assert of_ugv((50.0, off_m, 0.0), route_m=route, phase=UgvPhase.HOLDING) == kinds
    assert of_ugv((50.0, off_m, 0.0), route_m=route, phase=UgvPhase.PARKED) == []


@pytest.mark.parametrize(("since_s", "kinds"), [(None, []), (99.01, []), (99.0, ["tracking_error"])])
def test_tracking_error(since_s: float | None, kinds: list[str]) -> None:
    assert of_uav(off_path_since_s=since_s) == kinds


def deviating(at: Vec3, goal: Vec3 = (100.0, 0.0, 10.0), **members) -> float | None:
    """Since when a UAV told at (0, 0, 10) to fly to ``goal`` has been off its path."""
    path = straight((0.0, 0.0, 10.0), goal, 90.0, 10.0, 2.0)
    order = Order(GoTo("uav0", goal, 10.0), 90.0, 90.0)
    uav = world.uav(0, at, **{**FLYING, "path": path, "order": order, **members})
    return monitors.note_deviation(world.turn(S, now_s=100.0), uav).off_path_since_s


@pytest.mark.parametrize(
    ("at", "off"),
    [
        ((50.0, 5.0, 10.0), False),
        ((50.0, 5.01, 10.0), True),
        ((50.0, 0.0, 15.1), True),  # heights count
        ((50.0, 3.6, 13.6), True),  # and add up
        ((-4.0, 3.1, 10.0), True),  # before its start
        ((104.0, 2.9, 10.0), False),  # behind its end
        ((104.0, 3.1, 10.0), True),
    ],
)
def test_distance_from_the_path(at: Vec3, off: bool) -> None:
    assert deviating(at) == (100.0 if off else None)
    assert deviating(at, off_path_since_s=97.0) == (97.0 if off else None)


def test_only_straight_flights_have_a_path_to_be_off() -> None:
    away: Vec3 = (50.0, 50.0, 10.0)
    assert deviating(away) == 100.0
    assert deviating(away, goal=(0.0, 0.0, 10.0)) == 100.0  # a flight to where it is
    for without in ({"path": None}, {"order": None}, {"track": None}, {"order": Order(Hold("uav0"), 0.0, 0.0)}):
        assert deviating(away, **without) is None
        assert deviating(away, off_path_since_s=97.0, **without) is None


# --- energy -----------------------------------------------------------------------------------------------------------

# To the depot's pad, 50 m away: 5 s of cruising at 200 W; 2 * 10 / 2 s of braking and 10 / 1.5 s of landing at 230 W.
NEEDED_J = 5 * 200 + (10 + 10 / 1.5) * 230
FLOOR_J = 0.08 * 60_000


@pytest.mark.parametrize(("over_j", "kinds"), [(1.0, []), (-1.0, ["energy_no_return"])])
@pytest.mark.parametrize("phase", sorted(AIRBORNE))
def test_energy_to_the_nearest_site(phase: UavPhase, over_j: float, kinds: list[str]) -> None:
    at = (40.0, 30.0, 10.0)
    assert of_uav(at, phase=phase, energy_j=NEEDED_J + FLOOR_J + over_j) == kinds
    assert of_uav(at, phase=phase, energy_j=NEEDED_J + FLOOR_J + over_j, diverting=True) == []
    assert of_uav(at, phase=UavPhase.ON_PAD, energy_j=0.0) == []


def test_energy_after_landing() -> None:
    turn = world.turn(S, now_s=100.0, uavs=[world.uav(0, (40.0, 30.0, 10.0), energy_j=NEEDED_J - 500, **FLYING)])
    assert monitors.energy_after_landing_j(turn, turn.uavs[0]) == pytest.approx(-500)
    finding = monitors.findings(turn)[0]
    assert finding.text == "uav0 would land at the nearest site with 0.0 kJ (least 4.8 kJ)"


def test_its_own_pad_counts_and_mission_time() -> None:
    of = world.settings(frame=Frame(time_scale=0.5), uav={"pad_offset_m": (0.0, -20.0)})
    turn = world.turn(of, now_s=100.0, uavs=[world.uav(0, (0.0, 30.0, 10.0), energy_j=60_000.0, **FLYING)])
    assert monitors.energy_after_landing_j(turn, turn.uavs[0]) == pytest.approx(60_000 - 2 * NEEDED_J)


AT_SITE_0 = (Move(0, 0), Recharge(0, 0), Visit(0, 0))


def rendezvous(uav_at: Vec3, energy_j: float = 4_900.0, actions=AT_SITE_0, done: int = 1, **ugv_members) -> bool:
    """Whether a UAV with little energy, its UGV parked at path point 0, is told that it cannot return."""
    uav = world.uav(0, uav_at, energy_j=energy_j, **FLYING)
    ugv = world.ugv(0, (100.0, 0.0, 0.0), **{"now_s": 100.0, "site": 0, **ugv_members})
    turn = world.turn(S, now_s=100.0, uavs=[uav], ugvs=[ugv], actions=actions)
    for k in range(done):
        turn.mark_done(k)
    return any(f.kind is K.ENERGY_NO_RETURN for f in monitors.findings(turn))


def test_one_that_can_dock_at_once_does() -> None:
    assert not rendezvous((99.0, 0.0, 10.0))
    assert rendezvous((99.0, 0.0, 10.0), 3_000.0)  # it would fall down before
    assert rendezvous((99.0, 0.0, 10.0), target=1)  # its UGV is not there yet
    assert rendezvous((99.0, 0.0, 10.0), actions=(Move(0, 0), Visit(0, 0), Recharge(0, 0)))  # a task comes first
    assert rendezvous((99.0, 0.0, 10.0), done=3)  # nothing comes any more


def test_one_that_is_nearer_to_another_site_than_to_its_dock_does_not_try() -> None:
    assert rendezvous((10.0, 0.0, 10.0), 6_600.0)  # 9 s to the dock, 1 s to the depot; it could reach both
    assert not rendezvous((95.0, 0.0, 10.0))


def test_energy_on_the_dock() -> None:
    uav = world.uav(0, (69.0, 0.0, 10.0), energy_j=20_000.0, **FLYING)
    ugv = world.ugv(0, (100.0, 0.0, 0.0), now_s=100.0, site=0)
    turn = world.turn(S, now_s=100.0, uavs=[uav], ugvs=[ugv], actions=AT_SITE_0)
    k = 1
    assert turn.plan.docks[k] == 0  # a metre behind the UGV's middle: 30 m to fly
    expected_j = 20_000 - 3 * 200 - (10 + 10 / 1.5) * 230
    assert monitors.energy_on_dock_j(turn, uav, k) == pytest.approx(expected_j)


def test_a_uav_as_it_would_be_after_taking_off() -> None:
    turn = world.turn(S, now_s=100.0)
    up = monitors.climbed(turn, world.uav(1, (3.0, 4.0, 2.0), energy_j=20_000.0, now_s=100.0))
    assert up.track is not None and up.track.position_m == (3.0, 4.0, 16.0)
    assert up.energy_j == pytest.approx(20_000 - 7 * 230)  # 14 m at 2 m/s
    above = monitors.climbed(turn, world.uav(1, (3.0, 4.0, 20.0), energy_j=20_000.0, now_s=100.0))
    assert above.energy_j == 20_000


@pytest.mark.parametrize(("over_j", "back"), [(1.0, False), (-1.0, True)])
def test_taking_off_only_to_turn_back(over_j: float, back: bool) -> None:
    needed_j = 5 * 230 + NEEDED_J - 5 * 200 + FLOOR_J  # up, brake and down, all at the depot
    uav = world.uav(0, (0.0, 0.0, 0.0), energy_j=needed_j + over_j, now_s=100.0)
    assert monitors.would_turn_back(world.turn(S, now_s=100.0), uav) is back


@pytest.mark.parametrize(("over_j", "now"), [(1.0, False), (-1.0, True)])
def test_the_last_moment_to_land(over_j: float, now: bool) -> None:
    needed_j = monitors.LANDING_SPARE * 230 * (10 / 1.5 + 1.5 / 2)
    uav = world.uav(0, AIR, energy_j=needed_j + over_j, **FLYING)
    assert monitors.LANDING_SPARE > 1
    assert monitors.only_landing_is_left(world.turn(S, now_s=100.0), uav) is now


@pytest.mark.parametrize(("battery", "now"), [(None, False), (0.05, False), (0.02, True)])
def test_whatever_the_model_says_an_empty_battery_lands(battery: float | None, now: bool) -> None:
    assert S.uavs[0].energy == "virtual"
    uav = world.uav(0, AIR, energy_j=60_000.0, **FLYING, telemetry=world.report("uav0", 100.0, battery=battery))
    assert monitors.only_landing_is_left(world.turn(S, now_s=100.0), uav) is now


# --- separation -------------------------------------------------------------------------------------------------------

APART = Separation(horizontal_m=3.0, vertical_m=4.0, buffer_m=1.0, ugv_m=2.0)  # told at 3.5 m and 4.5 m


def flyer(index: int, at: Vec3, to: Vec3 | None = None, *, command: Command | None = None, **members) -> UavState:
    """A UAV that flies to ``to`` at its speed, or hovers."""
    path = (
        resting(at, 100.0)
        if to is None
        else TimedPath(((100.0, *at), (100.0 + math.dist(at, to) / 10.0, *to), (1e9, *to)))
    )
    command = command or GoTo(f"uav{index}", to or at, 10.0)
    order = Order(command, 100.0, 100.0)
    return world.uav(index, at, **{**FLYING, "energy_j": 1e9, "path": path, "order": order, **members})


def near(*uavs: UavState, of=None) -> list[str | None]:
    """Who is told about separation."""
    of = of or world.settings(n_uavs=2, separation=APART)
    return [v for kind, v in found(uavs=uavs, of=of) if kind == "separation"]


# 10 m/s and 2 m/s^2: it looks 1 + 5 s ahead.
@pytest.mark.parametrize(("x", "told"), [(63.6, []), (63.4, ["uav1"])])
def test_how_far_ahead(x: float, told: list[str]) -> None:
    still = flyer(0, (0.0, 0.0, 10.0))
    assert near(still, flyer(1, (x, 0.0, 10.0), (x - 200.0, 0.0, 10.0))) == told
    assert near(flyer(0, (x, 0.0, 10.0), (x - 200.0, 0.0, 10.0)), flyer(1, (0.0, 0.0, 10.0))) == told


@pytest.mark.parametrize(
    ("y", "z", "told"), [(3.4, 10.0, True), (3.6, 10.0, False), (0.0, 14.4, True), (0.0, 14.6, False)]
)
def test_the_cylinder(y: float, z: float, told: bool) -> None:
    assert bool(near(flyer(0, (0.0, 0.0, 10.0), (200.0, 0.0, 10.0)), flyer(1, (30.0, y, z)))) is told


def test_passing_through_in_the_middle_of_the_look_ahead() -> None:
    # Sinking across the other's height while passing beside it: near only between the nearest point and the end.
    low = flyer(1, (30.0, 0.0, 10.0))
    path = TimedPath(((100.0, 0.0, 3.0, 34.0), (106.0, 60.0, 3.0, -6.0)))
    sinking = replace(flyer(0, (0.0, 3.0, 34.0)), path=path)
    assert near(sinking, low) == ["uav1"]
    too_early = replace(
        sinking, path=TimedPath(((100.0, 0.0, 3.0, 28.0), (101.0, 0.0, 3.0, 4.0), (106.0, 60.0, 3.0, 4.0)))
    )
    assert near(too_early, low) == []


def test_who_has_to_stop() -> None:
    a, b = (0.0, 0.0, 10.0), (30.0, 0.0, 10.0)
    assert near(flyer(0, a, b), flyer(1, b, a)) == ["uav1"]  # the lower priority
    landing = flyer(1, b, command=Land("uav1", 1.5), phase=UavPhase.LANDING)
    assert near(flyer(0, a, b), landing) == ["uav0"]  # holding one that lands does not help
    hovering = flyer(1, b, command=Hold("uav1"))
    assert near(flyer(0, a, b), hovering) == ["uav0"]
    assert near(flyer(0, a, b), flyer(1, b, order=None)) == ["uav0"]
    both = flyer(0, a, b, command=Land("uav0", 1.0), phase=UavPhase.LANDING)
    assert near(both, landing) == ["uav1"]


def test_how_far_ahead_depends_on_who_has_to_stop() -> None:
    of = world.settings(n_uavs=2, separation=APART)
    slow_to_stop = replace(of.uavs[0], accel_mps2=1.0)
    of = replace(of, uavs=(slow_to_stop, of.uavs[1]))  # uav0 looks 11 s ahead, uav1 6 s
    mover, sitter = flyer(0, (0.0, 0.0, 10.0), (300.0, 0.0, 10.0)), flyer(1, (80.0, 0.0, 10.0), command=Hold("uav1"))
    assert near(mover, sitter, of=of) == ["uav0"]
    assert near(mover, replace(sitter, order=Order(GoTo("uav1", (80.0, 0.0, 10.0), 1.0), 0.0, 0.0)), of=of) == []


def test_those_who_part_or_stay_are_left_alone() -> None:
    a, b = (0.0, 0.0, 10.0), (2.0, 0.0, 10.0)
    assert near(flyer(0, a), flyer(1, b)) == []  # too near, but holding changes nothing
    assert near(flyer(0, a), flyer(1, b, (100.0, 0.0, 10.0))) == []
    assert near(flyer(0, a), flyer(1, b, (-100.0, 0.0, 10.0))) == ["uav1"]
    assert near(flyer(0, a), flyer(1, (2.0, 0.0, 13.0), (100.0, 0.0, 13.0))) == []
    assert near(flyer(0, a), flyer(1, (2.0, 0.0, 13.0), (2.0, 0.0, 10.0))) == ["uav1"]


def test_those_on_the_ground_or_unseen_are_not_in_the_way() -> None:
    mover = flyer(0, (0.0, 0.0, 10.0), (100.0, 0.0, 10.0))
    assert near(mover, flyer(1, (30.0, 0.0, 10.0), phase=UavPhase.DOWN)) == []
    assert near(mover, flyer(1, (30.0, 0.0, 10.0), track=None)) == []
    assert near(mover, flyer(1, (30.0, 0.0, 10.0), path=None)) == ["uav1"]  # hangs there without a path


corner = st.tuples(st.floats(-40, 40), st.floats(-40, 40), st.floats(0, 30))


@settings(max_examples=60, deadline=None)
@given(corner, corner, corner, corner)
def test_separation_against_sampling(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> None:
    paths = [TimedPath(((100.0, *p), (106.0, *q))) for p, q in ((a, b), (c, d))]
    pair = [replace(flyer(i, path.at(100.0)), path=path) for i, path in enumerate(paths)]
    told = bool(near(*pair))
    start_h, start_v = math.dist(a[:2], c[:2]), abs(a[2] - c[2])
    samples = [(paths[0].at(100 + t / 20), paths[1].at(100 + t / 20)) for t in range(121)]
    nearness = [max(math.dist(p[:2], q[:2]) / 3.5, abs(p[2] - q[2]) / 4.5) for p, q in samples]
    assume(max(start_h / 3.5, start_v / 4.5) > 1)
    if min(nearness) < 1 - 1e-3:
        assert told
    if min(nearness) > 1.02:
        assert not told
    assert bool(near(*(replace(u, index=1 - u.index) for u in reversed(pair)))) == told


# --- UGVs near one another --------------------------------------------------------------------------------------------


def driver(index: int, at: Vec3, to: tuple[float, float] | None = None, **members):
    path = None if to is None else along((at[:2], to), 0.0, 100.0, 5.0)
    phase = UgvPhase.PARKED if to is None else UgvPhase.DRIVING
    return world.ugv(index, at, **{"now_s": 100.0, "phase": phase, "path": path, **members})


def near_ugvs(*ugvs) -> list[str | None]:
    return [v for kind, v in found(ugvs=ugvs) if kind == "separation"]


# 5 m/s and 1 m/s^2: it looks 0.5 + 5 s ahead.
@pytest.mark.parametrize(("x", "told"), [(29.4, True), (29.6, False)])
def test_ugvs_look_ahead(x: float, told: bool) -> None:
    standing = (x, 0.0, 0.0)
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0), (200.0, 0.0)), driver(1, standing)) == ["ugv0"] * told
    assert near_ugvs(driver(0, standing), driver(1, (0.0, 0.0, 0.0), (200.0, 0.0))) == ["ugv1"] * told
    held = driver(1, standing, phase=UgvPhase.HOLDING)
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0), (200.0, 0.0)), held) == ["ugv0"] * told


@pytest.mark.parametrize(("y", "told"), [(1.9, ["ugv0"]), (2.1, [])])
def test_ugvs_pass_beside_each_other(y: float, told: list[str]) -> None:
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0), (200.0, 0.0)), driver(1, (20.0, y, 0.0))) == told


def test_which_ugv_stops() -> None:
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0), (50.0, 0.0)), driver(1, (20.0, 0.0, 0.0), (-50.0, 0.0))) == ["ugv1"]
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0)), driver(1, (1.0, 0.0, 0.0))) == []  # parked side by side
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0)), driver(1, (1.0, 0.0, 0.0), (50.0, 0.0))) == []  # leaves
    assert near_ugvs(driver(0, (0.0, 0.0, 0.0), (50.0, 0.0)), driver(1, (20.0, 0.0, 0.0), track=None)) == []


def test_a_locked_vehicle_follows_nothing() -> None:
    assert of_uav(phase=UavPhase.ON_PAD, telemetry=world.report("uav0", 100.0, locked=True)) == ["command_failed"]
    assert of_ugv(telemetry=world.report("ugv0", 100.0, locked=True)) == ["command_failed"]
    assert of_uav(phase=UavPhase.ON_PAD, telemetry=world.report("uav0", 100.0)) == []
