"""Pure pursuit against simple kinematics on a virtual clock: how near to the path, how exactly at its end."""

from __future__ import annotations

import itertools
import math
from collections import deque
from dataclasses import dataclass, field

import pytest
from hypothesis import given
from hypothesis import settings as examples
from hypothesis import strategies as st

from drivers.errors import DriverError
from drivers.pursuit import Mode, Motion, Pursuit, Tuning, carried_on
from drivers.pursuit_route import Piece, clean, pieces, rounded
from drivers.vehicle import Vec2

STEP_S, PERIOD = 0.01, 5
RADIUS_M = 0.4
MODES: tuple[Mode, ...] = ("differential", "ackermann", "mecanum")
ELL = ((0.0, 0.0), (2.0, 0.0), (2.0, 1.0))
ROUND_TRIP = ((0.0, 0.0), (1.5, 0.0), (1.5, 1.0), (0.0, 1.0), (0.0, 0.0))


def off_m(path: tuple[Vec2, ...], x: float, y: float) -> float:
    best = min(math.dist(p, (x, y)) for p in path)
    for (ax, ay), (bx, by) in itertools.pairwise(path):
        length = math.dist((ax, ay), (bx, by))
        if length > 0:
            f = min(1.0, max(0.0, ((x - ax) * (bx - ax) + (y - ay) * (by - ay)) / length**2))
            best = min(best, math.hypot(ax + f * (bx - ax) - x, ay + f * (by - ay) - y))
    return best


@dataclass
class Robot:
    """Kinematics that obey after ``delay_s``; an Ackermann one cannot turn tighter than its radius."""

    mode: Mode
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    delay_s: float = 0.06
    stuck: bool = False
    sent: deque[Motion] = field(default_factory=deque)
    track: list[tuple[float, float, float]] = field(default_factory=list)

    def obey(self, command: Motion) -> None:
        self.sent.append(command)
        if len(self.sent) * STEP_S <= self.delay_s or self.stuck:
            return
        m = self.sent.popleft()
        turn, left = m.turn_radps, m.left_mps
        if self.mode == "ackermann":
            assert left == 0.0
            turn = min(max(turn, -abs(m.forward_mps) / RADIUS_M), abs(m.forward_mps) / RADIUS_M)
        if self.mode == "differential":
            assert left == 0.0
        self.x, self.y, self.yaw = carried_on(self.x, self.y, self.yaw, Motion(m.forward_mps, left, turn), STEP_S)
        self.track.append((self.x, self.y, self.yaw))


@dataclass
class Ride:
    pursuit: Pursuit
    robot: Robot
    commands: list[Motion] = field(default_factory=list)

    def go(self, for_s: float = 150.0) -> Ride:
        for k in range(round(for_s / STEP_S)):
            if k % PERIOD == 0:
                self.commands.append(
                    self.pursuit.step(self.robot.x, self.robot.y, self.robot.yaw, PERIOD * STEP_S)
                )  # fmt: skip
                if self.pursuit.arrived and all(m.still for m in self.robot.sent):
                    return self
            self.robot.obey(self.commands[-1])
        return self

    def worst_off_m(self) -> float:
        return max(off_m(self.pursuit.path, x, y) for x, y, _ in self.robot.track)

    def end_off_m(self) -> float:
        return math.dist(self.pursuit.path[-1], (self.robot.x, self.robot.y))


def ride(path: tuple[Vec2, ...], robot: Robot, speed: float = 0.4, accel: float = 1.0, for_s: float = 150.0) -> Ride:
    return Ride(Pursuit(path, robot.mode, speed, accel), robot).go(for_s)


@pytest.mark.parametrize(
    ("mode", "path", "most_off_m"),
    [
        ("differential", ELL, 0.02),
        ("differential", ROUND_TRIP, 0.02),
        ("differential", ((0.0, 0.0), (2.0, 0.0), (0.5, 0.0)), 0.02),
        ("differential", ((0.0, 0.0), (-1.0, 0.0)), 0.02),
        ("differential", ((0.0, 0.0), (1.0, 0.3), (2.0, -0.3), (3.0, 0.3)), 0.05),
        ("ackermann", ELL, 0.15),  # the least possible around a corner of 90 degrees is 0.12 m
        ("ackermann", ROUND_TRIP, 0.15),
        ("ackermann", ((0.0, 0.0), (2.0, 0.0), (0.5, 0.0)), 0.03),
        ("ackermann", ((0.0, 0.0), (-1.0, 0.0)), 0.03),
        ("ackermann", ((0.0, 0.0), (1.0, 0.3), (2.0, -0.3), (3.0, 0.3)), 0.1),
        ("mecanum", ELL, 0.02),
        ("mecanum", ROUND_TRIP, 0.02),
        ("mecanum", ((0.0, 0.0), (0.0, 1.0)), 0.02),
        ("mecanum", ((0.0, 0.0), (1.0, 0.3), (2.0, -0.3), (3.0, 0.3)), 0.05),
    ],
)
def test_stays_on_its_path_and_stops_at_its_end(mode: Mode, path: tuple[Vec2, ...], most_off_m: float) -> None:
    done = ride(path, Robot(mode))
    assert done.pursuit.arrived
    assert done.pursuit.missed_m is None
    assert done.worst_off_m() < most_off_m
    assert done.end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(("speed", "accel"), [(0.2, 0.5), (0.5, 1.0), (1.0, 1.0)])
def test_never_faster_and_never_harder_than_allowed(mode: Mode, speed: float, accel: float) -> None:
    done = ride(ROUND_TRIP, Robot(mode), speed, accel)
    assert done.pursuit.arrived
    speeds = [math.hypot(m.forward_mps, m.left_mps) for m in done.commands]
    assert max(speeds) <= speed + 1e-9
    assert max(speeds) > 0.7 * speed, "and it uses what it has"
    for before, after in zip(done.commands, done.commands[1:], strict=False):
        assert abs(after.forward_mps - before.forward_mps) <= accel * PERIOD * STEP_S + 0.02 or mode == "mecanum"
    for slow, fast in itertools.pairwise(speeds):
        assert abs(fast - slow) <= accel * PERIOD * STEP_S + 1e-9


@pytest.mark.parametrize("mode", MODES)
def test_does_not_overshoot_the_end(mode: Mode) -> None:
    done = ride(((0.0, 0.0), (1.5, 0.0)), Robot(mode, delay_s=0.1), 0.8)
    assert max(x for x, _, _ in done.robot.track) < 1.52
    assert done.end_off_m() < 0.02


def test_ackermann_drives_forward_where_it_can_and_keeps_to_its_radius() -> None:
    done = ride(ROUND_TRIP, Robot("ackermann"))
    moving = [m for m in done.commands if abs(m.forward_mps) > 0.01]
    assert all(m.forward_mps > 0 for m in moving)
    assert all(abs(m.turn_radps / m.forward_mps) <= 1 / RADIUS_M + 1e-6 for m in moving)


def test_ackermann_backs_along_a_path_that_lies_behind_it() -> None:
    done = ride(((0.0, 0.0), (-1.0, 0.0)), Robot("ackermann"))
    assert all(m.forward_mps <= 0 for m in done.commands)
    assert done.end_off_m() < 0.03


def test_ackermann_makes_room_for_an_end_beside_it() -> None:
    done = ride(((0.0, 0.0), (0.0, 0.15)), Robot("ackermann"))
    assert done.pursuit.arrived
    assert done.end_off_m() < 0.05


def test_against_a_wall_it_keeps_trying_rather_than_claim_to_be_there() -> None:
    pursuit, x = Pursuit(((0.0, 0.0), (1.0, 0.0)), "mecanum", 0.4, 1.0), 0.0
    for _ in range(1000):  # it slides along a wall 0.2 m beside the path
        x += 0.05 * pursuit.step(x, 0.2, 0.0, 0.05).forward_mps
    assert not pursuit.arrived


def test_after_some_tries_it_says_by_how_much_it_missed() -> None:
    pursuit = Pursuit(((0.0, 0.0), (1.0, 0.0)), "differential", 0.4, 1.0)
    pursuit.step(0.0, 0.0, 0.0, 0.05)
    for k in range(40):  # it is thrown past the end, to either side
        pursuit.step(1.05, 0.2 * (-1) ** (k // 2), 0.0, 0.05)
        if pursuit.arrived:
            break
    assert pursuit.missed_m == pytest.approx(math.hypot(0.05, 0.2))


def test_differential_turns_in_place_at_a_sharp_corner() -> None:
    done = ride(ELL, Robot("differential"))
    turning = [m for m in done.commands if m.forward_mps == 0.0 and abs(m.turn_radps) > 0.1]
    assert turning, "it stood still while it turned"
    assert max(abs(m.turn_radps) for m in done.commands) <= Tuning().turn_rate_radps + 1e-9


def test_differential_half_turn_keeps_its_direction() -> None:
    pursuit, yaw, turns = Pursuit(((0.0, 0.0), (-1.0, 0.0)), "differential", 0.4, 1.0), 0.0, []
    for k in range(60):
        noise = 0.01 * (-1) ** k
        turns.append(pursuit.step(0.0, 0.0, yaw + noise, 0.05).turn_radps)
        yaw += 0.05 * turns[-1]
    assert len({math.copysign(1.0, t) for t in turns if abs(t) > 0.2}) == 1


def test_mecanum_keeps_its_heading() -> None:
    done = ride(ELL, Robot("mecanum", yaw=0.7))
    assert all(abs(yaw - 0.7) < 0.02 for _, _, yaw in done.robot.track)
    assert done.end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_comes_back_to_the_path(mode: Mode) -> None:
    done = ride(((0.0, 0.0), (3.0, 0.0)), Robot(mode, y=0.2))
    assert max(abs(y) for x, y, _ in done.robot.track if x > 1.5) < 0.03
    assert done.end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_a_path_that_begins_elsewhere_is_driven_to(mode: Mode) -> None:
    done = ride(((1.0, 0.5), (3.0, 0.5)), Robot(mode))
    assert min(math.dist((x, y), (1.0, 0.5)) for x, y, _ in done.robot.track) < 0.15
    assert done.end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_brakes_and_goes_on(mode: Mode) -> None:
    robot = Robot(mode)
    going = Ride(Pursuit(ELL, mode, 0.4, 1.0), robot).go(3.0)
    braking = [going.pursuit.brake(0.05, robot.yaw) for _ in range(20)]
    speeds = [math.hypot(m.forward_mps, m.left_mps) for m in braking]
    assert speeds[0] > 0.3
    assert all(a >= b for a, b in itertools.pairwise(speeds))
    assert braking[-1].still
    assert not going.pursuit.arrived
    done = going.go()
    assert done.pursuit.arrived
    assert done.end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_a_new_path_goes_on_at_the_speed_of_the_old_one(mode: Mode) -> None:
    robot = Robot(mode)
    old = Ride(Pursuit(((0.0, 0.0), (3.0, 0.0)), mode, 0.4, 1.0), robot).go(3.0)
    new = Pursuit(((robot.x, 0.0), (robot.x + 1.0, 0.0)), mode, 0.4, 1.0)
    new.take_over(old.pursuit)
    assert new.step(robot.x, robot.y, robot.yaw, 0.05).forward_mps > 0.35
    assert Ride(new, robot).go().end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_stuck_it_keeps_trying_and_goes_on_when_free(mode: Mode) -> None:
    robot = Robot(mode, stuck=True)
    going = Ride(Pursuit(ELL, mode, 0.4, 1.0), robot).go(5.0)
    assert not going.pursuit.arrived
    assert not going.commands[-1].still
    robot.stuck = False
    robot.sent.clear()
    assert going.go().end_off_m() < 0.03


@pytest.mark.parametrize("mode", MODES)
def test_a_path_to_where_it_stands_is_done_at_once(mode: Mode) -> None:
    for path in (((0.0, 0.0),), ((0.0, 0.0), (0.0, 0.0))):
        pursuit = Pursuit(path, mode, 0.4, 1.0)
        assert pursuit.step(0.001, 0.0, 0.3, 0.05).still
        assert pursuit.arrived


def corners(draw: st.DrawFn, sharpest: float) -> tuple[Vec2, ...]:
    legs = draw(st.lists(st.floats(0.2, 1.5), min_size=1, max_size=4))
    heading, path = draw(st.floats(-3.0, 3.0)), [(0.0, 0.0)]
    for leg in legs:
        path.append((path[-1][0] + leg * math.cos(heading), path[-1][1] + leg * math.sin(heading)))
        heading += draw(st.floats(-sharpest, sharpest))
    return tuple(path)


@st.composite
def any_path(draw: st.DrawFn) -> tuple[Vec2, ...]:
    return corners(draw, math.pi)


@st.composite
def gentle_path(draw: st.DrawFn) -> tuple[Vec2, ...]:
    return corners(draw, 1.6)


@examples(max_examples=25, deadline=None)
@given(path=any_path(), mode=st.sampled_from(("differential", "mecanum")), yaw=st.floats(-3.1, 3.1),
       speed=st.floats(0.15, 0.8), delay_s=st.floats(0.0, 0.12))  # fmt: skip
def test_any_path_is_followed_closely(
    path: tuple[Vec2, ...], mode: Mode, yaw: float, speed: float, delay_s: float
) -> None:
    done = ride(path, Robot(mode, yaw=yaw, delay_s=delay_s), speed)
    assert done.pursuit.arrived
    assert done.worst_off_m() < 0.08
    assert done.end_off_m() < 0.05


@examples(max_examples=25, deadline=None)
@given(path=gentle_path(), yaw=st.floats(-3.1, 3.1), speed=st.floats(0.15, 0.8), delay_s=st.floats(0.0, 0.12))
def test_any_path_is_driven_to_its_end_with_steered_wheels(
    path: tuple[Vec2, ...], yaw: float, speed: float, delay_s: float
) -> None:
    done = ride(path, Robot("ackermann", yaw=yaw, delay_s=delay_s), speed)
    assert done.pursuit.arrived
    assert done.end_off_m() < 0.06
    # crossing the path's direction, corners closer than its turning circle: never further off than that circle
    assert done.worst_off_m() < 2.5 * RADIUS_M


class TestRoute:
    def test_cuts_where_the_drive_must_stop(self) -> None:
        made = pieces(ELL, math.radians(40.0), 0.0)
        assert [p.points for p in made] == [ELL[:2], ELL[1:]]
        assert len(pieces(ELL, math.radians(100.0), 0.0)) == 1

    def test_says_nothing_twice(self) -> None:
        assert clean(((0.0, 0.0), (0.0, 0.0), (0.5, 0.0), (0.999, 0.0), (1.0, 0.0))) == [(0.0, 0.0), (1.0, 0.0)]
        assert pieces(((1.0, 1.0), (1.0, 1.0)), 1.0, 0.0) == []

    def test_rounds_a_corner_with_the_radius_it_is_given(self) -> None:
        made = rounded(ELL, 0.4)
        middle = (1.6, 0.4)
        arc = [p for p in made if p[0] > 1.61 and p[1] < 0.39]
        assert len(arc) >= 5
        assert all(math.dist(p, middle) == pytest.approx(0.4) for p in arc)
        assert (made[0], made[-1]) == (ELL[0], ELL[-1])

    def test_rounds_no_more_than_there_is_room_for(self) -> None:
        short = ((0.0, 0.0), (0.2, 0.0), (0.2, 0.2))
        assert all(0.0 <= x <= 0.2 and 0.0 <= y <= 0.2 for x, y in rounded(short, 1.0))

    def test_locates_ahead_only_and_beyond_the_end(self) -> None:
        piece = Piece.of(((0.0, 0.0), (1.0, 0.0)))
        assert piece.locate(0.4, 0.1, 0.0, 1.0) == pytest.approx((0.4, 0.1))
        assert piece.locate(0.4, 0.0, 0.7, 1.0)[0] == pytest.approx(0.7)
        assert piece.locate(1.3, 0.0, 0.0, 1.0)[0] == pytest.approx(1.3)
        assert piece.point(1.5) == pytest.approx((1.5, 0.0))

    def test_does_not_jump_where_a_path_crosses_itself(self) -> None:
        piece = Piece.of(((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 1.0), (1.0, -1.0)))
        assert piece.locate(1.0, 0.02, 0.9, 1.9)[0] == pytest.approx(1.0)


def test_tuning_checks_itself() -> None:
    with pytest.raises(DriverError, match="turning_radius_m"):
        Tuning(turning_radius_m=0.0)
    with pytest.raises(DriverError, match="latency_s"):
        Tuning(latency_s=math.nan)
