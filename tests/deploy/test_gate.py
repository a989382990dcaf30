"""The gate: each refusal by itself, then whatever hypothesis can think of: no accepted command breaks a limit."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import pytest
import world
from hypothesis import HealthCheck, assume, given
from hypothesis import settings as hypothesis_settings
from hypothesis import strategies as st

from deploy.fence import margin_m, path_inside
from deploy.flightpath import FOREVER_S, TimedPath
from deploy.gate import GateState, Verdict, judge
from deploy.observation import Observation
from deploy.settings import Separation, Settings
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    StopMotors,
    TakeOff,
    Vec3,
    VehicleState,
)

# A U that opens to the north; its notch is x 100..200 above y 50.
U = ((-60.0, -60.0), (400.0, -60.0), (400.0, 200.0), (200.0, 200.0), (200.0, 50.0), (100.0, 50.0), (100.0, 200.0))
U = (*U, (-60.0, 200.0))
SEPARATION = Separation(horizontal_m=3.0, vertical_m=4.0, buffer_m=1.0)
S = world.settings(n_uavs=3, n_ugvs=2, fence=U, ceiling_m=60.0, separation=SEPARATION)
HIGH: dict[str, Vec3] = {
    "uav0": (0.0, 0.0, 10.0),
    "uav1": (50.0, 0.0, 16.0),
    "uav2": (300.0, 0.0, 22.0),
    "ugv0": (0.0, -30.0, 0.0),
    "ugv1": (300.0, -30.0, 0.0),
}
SAFER = (StopMotors("uav0"), Hold("uav0"), Land("uav0", 1.5), Disarm("uav0"))


def told(*commands: Command, at: dict[str, Vec3] | None = None, of: Settings = S, **changes: VehicleState) -> Verdict:
    """A first turn, everybody seen and armed at ``at``; ``changes`` replace a vehicle's report."""
    seen = world.seen(of, 100.0, HIGH | (at or {}))
    vehicles = tuple(changes.get(v.vehicle, v) for v in seen.vehicles)
    return judge(of, GateState(), replace(seen, vehicles=vehicles), commands)


def why(*args: Command, **kwargs) -> str:
    """Why the last command is refused; empty where it is not."""
    verdict = told(*args, **kwargs)
    return verdict.refused[-1].reason if verdict.refused else ""


# --- each rule by itself ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        Arm("uav0"),
        TakeOff("uav0", 12.0, 2.0),
        GoTo("uav0", (90.0, 150.0, 10.0), 12.0),
        GoTo("uav0", (0.0, 0.0, 60.0), 1.0),
        GoTo("uav0", (0.0, 0.0, 0.0), 1.0),
        Arm("ugv0"),
        Drive("ugv0", ((0.0, -30.0), (300.0, -40.0)), 6.0),
    ],
)
def test_what_keeps_every_rule_passes_unchanged(command: Command) -> None:
    verdict = told(command)
    assert (verdict.accepted, verdict.refused) == ((command,), ())


@pytest.mark.parametrize("command", SAFER)
@pytest.mark.parametrize("seen", [False, True])
def test_what_makes_safer_passes_whatever_is_known(command: Command, seen: bool) -> None:
    tumbled = world.report("uav0", 0.0, armed=False, locked=True, tumbled=True, link=False)
    observation = (
        Observation(100.0, (world.pose("uav0", (0.0, 0.0, 500.0), 1.0),), (tumbled,)) if seen else Observation(100.0)
    )
    assert judge(S, GateState(), observation, (command,)).accepted == (command,)


def test_stop_and_hold_pass_for_ugvs() -> None:
    commands = (StopMotors("ugv0"), Hold("ugv0"), Disarm("ugv0"))
    assert judge(S, GateState(), Observation(0.0), commands).accepted == commands


@pytest.mark.parametrize("speed_mps", [math.nan, math.inf, -1.0, 0.0, 50.0])
def test_a_landing_at_a_wrong_speed_is_made_at_the_right_one(speed_mps: float) -> None:
    assert told(Land("uav0", speed_mps)).accepted == (Land("uav0", 1.5),)
    assert told(Land("uav0", 0.7)).accepted == (Land("uav0", 0.7),)


@pytest.mark.parametrize("command", [Arm("x"), StopMotors("x"), Land("x", 1.0), GoTo("x", (0.0, 0.0, 1.0), 1.0)])
def test_strangers_are_refused(command: Command) -> None:
    assert why(command) == "x is not in the fleet"


@pytest.mark.parametrize(
    "command",
    [
        Drive("uav0", ((0.0, 0.0), (10.0, 0.0)), 1.0),
        TakeOff("ugv0", 10.0, 1.0),
        GoTo("ugv0", (0.0, -30.0, 5.0), 1.0),
        Dock("ugv0", "ugv1", 0, 1.0, 10.0),
        Land("ugv0", 1.0),
    ],
)
def test_the_wrong_kind_is_refused(command: Command) -> None:
    assert why(command) == f"{type(command).__name__} is not for this kind of vehicle"


@pytest.mark.parametrize(
    ("report", "reason"),
    [
        ({"stamp_s": 98.4}, "its telemetry is stale"),
        ({"stamp_s": 101.6}, "its telemetry is stale"),  # from the future: its clock is not ours
        ({"stamp_s": math.nan}, "its telemetry is stale"),
        ({"locked": True}, "it is locked or tumbled"),
        ({"tumbled": True}, "it is locked or tumbled"),
        ({"armed": False}, "it is not armed"),
    ],
)
def test_the_vehicle_must_be_able(report: dict, reason: str) -> None:
    uav0 = world.report("uav0", **{"stamp_s": 100.0, "airborne": True, **report})
    assert why(GoTo("uav0", (1.0, 0.0, 10.0), 1.0), uav0=uav0) == reason
    assert why(Arm("uav0"), uav0=uav0) == ("" if reason == "it is not armed" else reason)


def test_one_that_never_reported_or_was_never_seen_does_not_move() -> None:
    go = GoTo("uav0", (1.0, 0.0, 10.0), 1.0)
    unseen = replace(world.seen(S, 100.0, {"uav0": (0.0, 0.0, 10.0)}), poses=())
    assert judge(S, GateState(), unseen, (go,)).refused[0].reason == "its pose is stale"
    silent = replace(world.seen(S, 100.0, {"uav0": (0.0, 0.0, 10.0)}), vehicles=())
    assert judge(S, GateState(), silent, (go,)).refused[0].reason == "its telemetry is stale"


@pytest.mark.parametrize(("stamp_s", "passes"), [(99.5, True), (99.49, False), (100.5, True), (100.51, False)])
def test_the_pose_must_be_fresh(stamp_s: float, passes: bool) -> None:
    seen = world.seen(S, 100.0, {"uav0": (0.0, 0.0, 10.0)}, poses=(world.pose("uav0", (0.0, 0.0, 10.0), stamp_s),))
    verdict = judge(S, GateState(), seen, (GoTo("uav0", (1.0, 0.0, 10.0), 1.0),))
    assert bool(verdict.accepted) == passes


@pytest.mark.parametrize("bad", [math.nan, math.inf])
@pytest.mark.parametrize("k", range(5))
def test_a_pose_that_is_no_number_is_no_pose(bad: float, k: int) -> None:
    numbers = [0.0, 0.0, 10.0, 0.0, 100.0]
    numbers[k] = bad
    pose = Pose("body-uav0", (numbers[0], numbers[1], numbers[2]), numbers[3], numbers[4])
    seen = replace(world.seen(S, 100.0, {"uav0": (0.0, 0.0, 10.0)}), poses=(pose,))
    assert judge(S, GateState(), seen, (GoTo("uav0", (1.0, 0.0, 10.0), 1.0),)).refused[0].reason == "its pose is stale"


@pytest.mark.parametrize("speed_mps", [0.0, -1.0, 12.001, math.inf, math.nan])
def test_flying_speeds(speed_mps: float) -> None:
    reason = why(GoTo("uav0", (1.0, 0.0, 10.0), speed_mps))
    assert reason == ("a number is not finite" if not math.isfinite(speed_mps) else reason) and reason


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (TakeOff("uav0", 20.0, 2.1), "speed 2.1 m/s is not within 0 and 2 m/s"),
        (Dock("uav0", "ugv0", 0, 1.6, 10.0), "speed 1.6 m/s is not within 0 and 1.5 m/s"),
        (Drive("ugv0", ((0.0, -30.0), (1.0, -30.0)), 6.1), "speed 6.1 m/s is not within 0 and 6 m/s"),
        (Drive("ugv0", ((0.0, -30.0), (1.0, -30.0)), 0.0), "speed 0 m/s is not within 0 and 6 m/s"),
        (Drive("ugv0", ((0.0, -30.0), (1.0, -30.0)), math.nan), "speed nan m/s is not within 0 and 6 m/s"),
        (TakeOff("uav0", 60.1, 2.0), "altitude 60.10 m is not within 0 and 60 m"),
        (GoTo("uav0", (0.0, 0.0, -0.1), 1.0), "altitude -0.10 m is not within 0 and 60 m"),
        (TakeOff("uav0", math.nan, 2.0), "a number is not finite"),
        (GoTo("uav0", (math.nan, 0.0, 10.0), 1.0), "a number is not finite"),
        (GoTo("uav0", (-70.0, 0.0, 10.0), 1.0), "(-70.00, 0.00) m is outside the geofence"),
        (GoTo("uav0", (150.0, 100.0, 10.0), 1.0), "(150.00, 100.00) m is outside the geofence"),
        (Dock("uav0", "ugv9", 0, 1.0, 10.0), "there is no dock 0 on ugv9"),
        (Dock("uav0", "ugv0", 2, 1.0, 10.0), "there is no dock 2 on ugv0"),
        (Dock("uav0", "ugv0", -1, 1.0, 10.0), "there is no dock -1 on ugv0"),
        (Dock("uav0", "ugv0", 0, 1.0, 61.0), "altitude 61.00 m is not within 0 and 60 m"),
        (Dock("uav0", "ugv0", 0, 1.0, math.nan), "a number is not finite"),
        (Dock("uav0", "ugv0", 0, 1.0, 0.4), "it would abort to 0.40 m, below the dock at 0.5 m"),
        (Dock("uav0", "ugv1", 0, 1.0, 10.0), "dock 0 of ugv1 is 300.00 m aside, not beneath it"),
        (Drive("ugv0", ((0.0, -30.0),), 1.0), "a drive needs at least two points with finite numbers"),
        (Drive("ugv0", ((0.0, -30.0), (0.0, math.inf)), 1.0), "a drive needs at least two points with finite numbers"),
        (Drive("ugv0", ((0.0, -30.0), (0.0, -61.0)), 1.0), "the drive leaves the geofence"),
        (Drive("ugv0", ((0.0, 60.0), (210.0, 60.0)), 1.0), "the drive leaves the geofence"),
        (Drive("ugv0", ((0.0, -19.0), (9.0, -19.0)), 1.0), "the drive passes 11.00 m away from the vehicle"),
        (Drive("ugv0", ((0.0, -19.0), (0.0, -19.0)), 1.0), "the drive passes 11.00 m away from the vehicle"),
    ],
)
def test_limits(command: Command, reason: str) -> None:
    assert why(command, at={"uav0": (1.0, -30.0, 10.0), "ugv1": (300.0 + 2.0, -30.0, 0.0)}) == reason


def test_a_way_across_the_notch_is_refused_and_one_around_is_not() -> None:
    at = {"uav0": (90.0, 150.0, 10.0)}
    assert why(GoTo("uav0", (210.0, 150.0, 10.0), 5.0), at=at) == "the way to (210.00, 150.00) m leaves the geofence"
    assert why(GoTo("uav0", (90.0, 40.0, 10.0), 5.0), at=at) == ""


def test_one_outside_may_come_back_and_nothing_else() -> None:
    at = {"uav0": (-70.0, 0.0, 70.0)}
    assert why(GoTo("uav0", (-50.0, 0.0, 50.0), 5.0), at=at) == ""
    assert why(GoTo("uav0", (-65.0, 0.0, 50.0), 5.0), at=at) == "(-65.00, 0.00) m is outside the geofence"
    assert "altitude" in why(GoTo("uav0", (-50.0, 0.0, 65.0), 5.0), at=at)


@pytest.mark.parametrize(("yaw_rad", "dock", "x", "y"), [(0.0, 0, -1, 0), (0.0, 1, 1, 0), (math.pi / 2, 0, 0, -1)])
def test_a_dock_must_be_beneath(yaw_rad: float, dock: int, x: float, y: float) -> None:
    command = Dock("uav0", "ugv0", dock, 1.5, 10.0)
    for aside_m, passes in ((2.9, True), (3.1, False)):
        uav_at = (
            x + math.copysign(aside_m, x) if x else 0.0,
            -30.0 + (y + math.copysign(aside_m, y) if y else 0.0),
            10.0,
        )
        seen = world.seen(S, 100.0, {"uav0": uav_at, "ugv0": (0.0, -30.0, 0.0)})
        poses = (seen.poses[0], replace(seen.poses[1], yaw_rad=yaw_rad))
        assert bool(judge(S, GateState(), replace(seen, poses=poses), (command,)).accepted) == passes


@pytest.mark.parametrize("poses", [slice(0, 1), slice(0, 2)])
def test_a_dock_that_is_not_seen_now_is_none(poses: slice) -> None:
    seen = world.seen(S, 100.0, {"uav0": (0.0, -30.0, 10.0)})
    all_poses = (*seen.poses, world.pose("ugv0", (0.0, -30.0, 0.0), 99.0))
    verdict = judge(S, GateState(), replace(seen, poses=all_poses[poses]), (Dock("uav0", "ugv0", 0, 1.0, 10.0),))
    assert verdict.refused[0].reason == "the pose of ugv0 is stale"


# --- room in the air --------------------------------------------------------------------------------------------------


def test_the_second_of_two_crossing_flights_is_refused() -> None:
    east, north = GoTo("uav0", (80.0, 0.0, 10.0), 10.0), GoTo("uav1", (40.0, 40.0, 10.0), 10.0)
    at = {"uav1": (40.0, -40.0, 10.0)}
    verdict = told(east, north, at=at)
    assert verdict.accepted == (east,)
    assert "it would come as near as 0.00 m and 0.00 m in height to uav0" in verdict.refused[0].reason
    assert told(north, east, at=at).accepted == (north,)
    assert (
        told(east, replace(north, position_m=(40.0, 40.0, 14.0)), at=at | {"uav1": (40.0, -40.0, 14.0)}).refused == ()
    )


@pytest.mark.parametrize(
    ("y", "z", "passes"),
    [
        (2.99, 10.0, False),
        (3.01, 10.0, True),
        (0.0, 13.99, False),
        (0.0, 14.01, True),
        (2.99, 6.01, False),
        (2.99, 5.99, True),
    ],
)
def test_how_near_a_flight_may_pass(y: float, z: float, passes: bool) -> None:
    reason = why(GoTo("uav0", (90.0, 0.0, 10.0), 10.0), at={"uav1": (50.0, y, z)})
    assert (reason == "") == passes


def test_an_accepted_command_counts_in_later_turns() -> None:
    east = GoTo("uav0", (80.0, 0.0, 10.0), 10.0)
    at = {"uav1": (40.0, -40.0, 10.0)}
    state = told(east, at=at).state
    later = world.seen(S, 102.0, HIGH | at | {"uav0": (10.0, 0.0, 10.0)})
    assert judge(S, state, later, (GoTo("uav1", (40.0, 40.0, 10.0), 10.0),)).refused
    held = judge(S, state, later, (Hold("uav0"), GoTo("uav1", (40.0, 40.0, 10.0), 10.0)))
    assert held.refused == ()


def test_a_refused_command_leaves_the_earlier_path_in_force() -> None:
    east = GoTo("uav0", (80.0, 0.0, 10.0), 10.0)
    state = told(east).state
    again = judge(S, state, world.seen(S, 101.0, HIGH), (GoTo("uav0", (-500.0, 0.0, 10.0), 10.0),))
    assert again.refused and again.state.paths == state.paths


def test_one_that_flies_without_a_path_takes_the_room_where_it_is_seen() -> None:
    through = GoTo("uav0", (90.0, 0.0, 10.0), 10.0)
    at = {"uav1": (50.0, 1.0, 12.0)}
    assert "to uav1" in why(through, at=at)
    on_ground = world.report("uav1", 100.0, airborne=False)
    assert why(through, at=at, uav1=on_ground) == ""
    unreported = replace(world.seen(S, 100.0, HIGH | at), vehicles=(world.report("uav0", 100.0, airborne=True),))
    assert judge(S, GateState(), unreported, (through,)).refused == ()


def flight_then(
    now_s: float, seen_at: Vec3 | None, *, airborne: bool, first: Command, stamp_s: float | None = None, x: float = 0.0
) -> str:
    """uav1 is told ``first`` at 100 s; why uav0 may not fly on from ``x`` along y = 0 at 10 m then."""
    at = {"uav1": (50.0, 0.0, 0.0 if isinstance(first, TakeOff) else 10.0), "uav0": (0.0, 0.0, 10.0)}
    state = told(first, at=at).state
    assert "uav1" in state.paths
    if seen_at is None:
        state = replace(state, poses={})
    places = {"uav0": (x, 0.0, 10.0)} | ({"uav1": seen_at} if seen_at else {})
    seen = world.seen(S, now_s, places)
    report = world.report("uav1", now_s if stamp_s is None else stamp_s, airborne=airborne)
    seen = replace(seen, vehicles=(seen.vehicles[0], report))
    verdict = judge(S, state, seen, (GoTo("uav0", (90.0, 0.0, 10.0), 10.0),))
    return verdict.refused[0].reason if verdict.refused else ""


def test_a_take_off_takes_room_before_the_vehicle_says_that_it_flies() -> None:
    climb = TakeOff("uav1", 10.0, 2.0)
    assert "to uav1" in flight_then(103.0, (50.0, 0.0, 0.5), airborne=False, first=climb)
    assert flight_then(107.0, (50.0, 0.0, 0.0), airborne=False, first=climb) == ""  # it never left the ground


def test_a_landing_takes_room_until_it_is_down() -> None:
    land = Land("uav1", 1.5)
    assert "to uav1" in flight_then(101.5, (50.0, 0.0, 8.0), airborne=True, first=land, x=44.0)
    assert flight_then(101.5, (50.0, 0.0, 0.0), airborne=False, first=land, x=44.0) == ""
    old = flight_then(101.5, (50.0, 0.0, 8.0), airborne=False, first=land, stamp_s=100.5, x=44.0)
    assert "to uav1" in old  # from before the landing had begun
    assert "to uav1" in flight_then(120.0, (50.0, 0.0, 9.0), airborne=True, first=land)  # it did not come down


def test_a_glitch_does_not_make_a_flying_vehicle_invisible() -> None:
    away = GoTo("uav1", (50.0, 90.0, 10.0), 1.0)
    assert "to uav1" in flight_then(103.0, (50.0, 1.0, 10.0), airborne=False, first=away, x=44.0)
    assert "to uav1" in flight_then(103.0, (50.0, 1.0, 10.0), airborne=True, first=away, x=44.0)


def test_after_its_flight_it_takes_the_room_where_it_is_and_on_the_way_to_where_it_should_be() -> None:
    there = GoTo("uav1", (50.0, 20.0, 10.0), 10.0)  # 6.3 s
    assert flight_then(120.0, (50.0, 20.0, 10.0), airborne=True, first=there) == ""
    assert "to uav1" in flight_then(120.0, (50.0, 0.0, 10.0), airborne=True, first=there)  # hangs back, may come on
    assert "to uav1" in flight_then(120.0, (30.0, 0.0, 10.0), airborne=True, first=there)  # is elsewhere
    assert flight_then(120.0, None, airborne=True, first=there) == ""  # not seen: where it should be
    stay = GoTo("uav1", (50.0, 2.0, 10.0), 10.0)
    assert "to uav1" in flight_then(120.0, None, airborne=True, first=stay)


def test_a_held_vehicle_is_where_it_came_to_rest_not_where_it_was_told_to() -> None:
    hold = Hold("uav1")
    assert "to uav1" in flight_then(110.0, (50.0, 0.0, 10.0), airborne=True, first=hold)
    assert "to uav1" in flight_then(110.0, (75.0, 0.0, 10.0), airborne=True, first=hold)
    # two bodies were swapped: it does not fly to where it was seen when it was told to stay
    assert flight_then(110.0, (50.0, 60.0, 10.0), airborne=True, first=hold) == ""


# --- whatever hypothesis can think of ---------------------------------------------------------------------------------

bad = st.sampled_from([math.nan, math.inf, -math.inf, -1.0, 0.0])
x = st.floats(-80, 420) | st.sampled_from([-60.0, 100.0, 200.0])
y = st.floats(-80, 220) | st.sampled_from([50.0, 200.0])
z = st.floats(-1, 65) | st.sampled_from([0.0, 10.0, 16.0, 60.0])
goal = st.tuples(x, y, z)
near_goal = st.tuples(st.floats(-20, 90), st.floats(-20, 40), st.sampled_from([8.0, 10.0, 12.0, 16.0]))
speed = st.floats(0.1, 14) | bad
name = st.sampled_from(["uav0", "uav1", "uav2", "ugv0", "ugv1"]) | st.just("stranger")
motions = st.one_of(
    st.builds(TakeOff, name, z | bad, speed),
    st.builds(GoTo, name, near_goal | goal | st.tuples(x, y, bad), speed),
    st.builds(GoTo, st.sampled_from(["uav0", "uav1", "uav2"]), near_goal, st.floats(1, 12)),
    st.builds(Dock, name, name, st.integers(-1, 2), speed, z | bad),
    st.builds(Drive, name, st.lists(st.tuples(x, y | bad), max_size=3).map(tuple), speed),
    st.builds(Drive, name, st.just(((0.0, -30.0), (50.0, -30.0))), st.floats(1, 6)),
    st.builds(Arm, name),
)
safer = st.one_of(
    st.builds(StopMotors, name), st.builds(Hold, name), st.builds(Disarm, name), st.builds(Land, name, speed)
)


@st.composite
def worlds(draw: st.DrawFn) -> Settings:
    horizontal_m, vertical_m = draw(st.floats(0.5, 10)), draw(st.floats(0.5, 8))
    return replace(
        S,
        separation=Separation(horizontal_m=horizontal_m, vertical_m=vertical_m, buffer_m=draw(st.floats(0, 2))),
        geofence=replace(S.geofence, ceiling_m=draw(st.floats(5, 60))),
        uavs=tuple(
            replace(
                u,
                max_speed_mps=draw(st.floats(1, 15)),
                climb_mps=draw(st.floats(0.5, 4)),
                accel_mps2=draw(st.floats(0.5, 5)),
            )
            for u in S.uavs
        ),
    )


@st.composite
def turns(draw: st.DrawFn, of: Settings, now_s: float) -> tuple[Observation, tuple[Command, ...]]:
    """What a turn may see and be told; most of it healthy, so that much is accepted."""
    mostly = st.sampled_from([True] * 9 + [False])
    poses, vehicles = [], []
    for c in (*of.uavs, *of.ugvs):
        at = draw(near_goal) if c in of.uavs else (draw(st.floats(-5, 5)), -30.0, 0.0)
        if draw(mostly):
            stamp_s = now_s - draw(st.just(0.0) | st.floats(0, 1))
            poses.append(Pose(c.body, at if draw(mostly) else (math.nan, 0.0, 0.0), draw(st.floats(-3, 3)), stamp_s))
        if draw(mostly):
            report = world.report(c.id, now_s - draw(st.just(0.0) | st.floats(0, 3)), airborne=draw(mostly))
            flags = {k: draw(mostly) for k in ("armed", "unlocked", "upright")}
            vehicles.append(
                replace(report, armed=flags["armed"], locked=not flags["unlocked"], tumbled=not flags["upright"])
            )
    commands = tuple(draw(st.lists(motions | safer, max_size=6)))
    return Observation(now_s, tuple(poses), tuple(vehicles)), commands


def check_command(of: Settings, known: GateState, now_s: float, command: Command) -> None:
    """Every rule once more, in other words; ``known`` is what has been seen by now."""
    uavs, ugvs = {u.id: u for u in of.uavs}, {g.id: g for g in of.ugvs}
    assert command.vehicle in uavs or command.vehicle in ugvs
    if isinstance(command, Land):
        assert command.vehicle in uavs
        assert 0 < command.speed_mps <= uavs[command.vehicle].descent_mps + 1e-6
    if isinstance(command, StopMotors | Hold | Disarm | Land):
        return
    telemetry = known.vehicles[command.vehicle]
    assert abs(now_s - telemetry.stamp_s) <= of.monitors.telemetry_stale_s
    assert not telemetry.locked and not telemetry.tumbled
    if isinstance(command, Arm):
        return
    assert telemetry.armed
    config = uavs.get(command.vehicle) or ugvs[command.vehicle]
    pose = known.poses[config.body]
    assert abs(now_s - pose.stamp_s) <= of.monitors.pose_stale_s
    assert math.isfinite(command.speed_mps) and 0 < command.speed_mps <= config.max_speed_mps + 1e-6
    fence = of.geofence
    if isinstance(command, Drive):
        assert command.vehicle in ugvs
        assert path_inside(fence.polygon_m, command.path_m)
        return
    assert command.vehicle in uavs
    end = pose.position_m
    if isinstance(command, TakeOff):
        end = (*end[:2], command.altitude_m)
        assert command.speed_mps <= config.climb_mps + 1e-6
    elif isinstance(command, GoTo):
        end = command.position_m
    else:
        assert isinstance(command, Dock)
        assert (
            math.dist(end[:2], known.poses[f"body-{command.onto}"].position_m[:2])
            <= 3 * of.monitors.arrival_m + 1 + 1e-6
        )
        assert 0 <= command.abort_altitude_m <= fence.ceiling_m + 1e-6
    assert -1e-6 <= end[2] <= fence.ceiling_m + 1e-6
    for i in range(101):
        p = [a + i / 100 * (b - a) for a, b in zip(pose.position_m[:2], end[:2], strict=True)]
        if margin_m(fence.polygon_m, *pose.position_m[:2]) >= 0 or i == 100:
            assert margin_m(fence.polygon_m, *p) >= -1e-6


def check_separation(of: Settings, paths: dict[str, TimedPath], mine: str, now_s: float) -> None:
    """Samples the accepted path against all others; a pair that starts too near may only part."""
    h, v = of.separation.horizontal_m, of.separation.vertical_m

    def nearness(a: Vec3, b: Vec3) -> float:
        return max(math.dist(a[:2], b[:2]) / h, abs(a[2] - b[2]) / v)

    end_s = max(k[0] for p in paths.values() for k in p.knots if k[0] < FOREVER_S)
    times = [now_s + i * (max(end_s, now_s) + 1 - now_s) / 120 for i in range(121)]
    for other, path in paths.items():
        if other == mine:
            continue
        values = [nearness(paths[mine].at(t), path.at(t)) for t in times]
        out = next((i for i, value in enumerate(values) if value >= 1), len(values))
        assert out < len(values), f"{mine} and {other} never part"
        assert all(b >= a - 1e-9 for a, b in pairwise(values[: out + 1])), f"{mine} comes nearer to {other}"
        assert min(values[out:]) >= 1 - 1e-6, f"{mine} and {other} too near"


@hypothesis_settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data(), worlds())
def test_no_accepted_command_breaks_a_limit(data: st.DataObject, of: Settings) -> None:
    state, now_s = GateState(), 100.0
    for _ in range(2):
        observation, commands = data.draw(turns(of, now_s))
        for command in commands:  # one at a time, so that what is known before each one is known here
            verdict = judge(of, state, observation, (command,))
            assert len(verdict.accepted) + len(verdict.refused) == 1
            assert all(r.reason for r in verdict.refused)
            for accepted in verdict.accepted:
                assert type(accepted) is type(command) and accepted.vehicle == command.vehicle
                check_command(of, verdict.state, now_s, accepted)
                if isinstance(accepted, TakeOff | GoTo | Dock):
                    moving = {
                        v: p
                        for v, p in verdict.state.paths.items()
                        if v.startswith("uav")
                        and p.rests_from_s >= now_s
                        and (v == accepted.vehicle or p.end_m[2] >= p.knots[0][3])
                    }
                    check_separation(of, moving, accepted.vehicle, now_s)
            state = verdict.state
        together = judge(of, GateState(), observation, commands)
        assert len(together.accepted) + len(together.refused) == len(commands)
        now_s += data.draw(st.floats(0.02, 8))


@given(st.data(), safer)
@hypothesis_settings(max_examples=30, deadline=None)
def test_stop_hold_land_disarm_are_never_refused(data: st.DataObject, command: Command) -> None:
    assume(command.vehicle != "stranger" and not (isinstance(command, Land) and command.vehicle.startswith("ugv")))
    observation, before = data.draw(turns(S, 50.0))
    state = judge(S, GateState(), observation, before).state
    verdict = judge(S, state, Observation(data.draw(st.floats(0, 1e6))), (command,))
    assert not verdict.refused and type(verdict.accepted[0]) is type(command)


@given(st.data())
@hypothesis_settings(max_examples=30, deadline=None)
def test_the_same_turn_is_judged_the_same(data: st.DataObject) -> None:
    observation, commands = data.draw(turns(S, 50.0))
    first, second = (judge(S, GateState(), observation, commands) for _ in range(2))
    assert first.accepted == second.accepted or any(c != c for c in commands)  # noqa: PLR0124  (nan is not nan)
    assert [r.reason for r in first.refused] == [r.reason for r in second.refused]
