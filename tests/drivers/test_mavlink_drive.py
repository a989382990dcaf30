"""A rover along its path, with a rover of a few lines and time that passes at once."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.limits import UgvLimits
from drivers.mavlink_drive import ARRIVED_M, STAND, Driving
from drivers.mavlink_frames import wrap
from drivers.vehicle import Vec2

LIMITS = UgvLimits(max_speed_mps=2.0, accel_mps2=1.0)
DT = 0.05


class Cart:
    """Turns towards the velocity it is given at 90 degrees a second and drives where it looks."""

    def __init__(self, at: Vec2 = (0.0, 0.0), yaw: float = 0.0, delay: int = 2) -> None:
        self.at, self.yaw, self.speed = at, yaw, 0.0
        self.driving = Driving(LIMITS)
        self.late = [STAND] * delay
        self.track = [at]
        self.speeds = [0.0]

    def turn(self, stale: bool = False) -> None:
        self.late.append(self.driving.step(None if stale else self.at, self.yaw, DT))
        motion = self.late.pop(0)
        goal = 0.0
        if motion.velocity_mps is not None:
            vx, vy = motion.velocity_mps
            aside = wrap(math.atan2(vy, vx) - self.yaw)
            self.yaw += max(-math.pi / 2 * DT, min(math.pi / 2 * DT, aside))
            goal = math.hypot(vx, vy) if abs(aside) < 0.6 else 0.0
        self.speed += max(-3 * DT, min(3 * DT, goal - self.speed))
        x, y = self.at
        self.at = (x + self.speed * math.cos(self.yaw) * DT, y + self.speed * math.sin(self.yaw) * DT)
        self.track.append(self.at)
        self.speeds.append(self.speed)

    def until_it_stands(self, most_s: float = 200.0) -> None:
        for _ in range(round(most_s / DT)):
            self.turn()
            if not self.driving.going and self.speed == 0.0:
                return
        raise AssertionError("it never stands")


def off_path(path: list[Vec2], p: Vec2) -> float:
    best = math.inf
    for a, b in itertools.pairwise(path):
        length = math.dist(a, b)
        t = max(0.0, min(1.0, ((p[0] - a[0]) * (b[0] - a[0]) + (p[1] - a[1]) * (b[1] - a[1])) / length**2))
        best = min(best, math.dist(p, (a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]))))
    return best


@pytest.mark.parametrize("yaw", [0.0, 2.0, -3.0])
@pytest.mark.parametrize(
    "path",
    [
        [(0.0, 0.0), (5.0, 0.0), (5.0, 3.0)],
        [(0.0, 0.0), (2.0, 0.0), (0.0, 0.1)],
        [(0.0, 0.0), (1.0, 0.05), (2.0, 0.2), (3.0, 0.5), (4.0, 1.0)],
    ],
)
def test_follows_its_path_to_the_end(path: list[Vec2], yaw: float) -> None:
    cart = Cart(yaw=yaw)
    cart.driving.drive(tuple(path), 1.5, cart.at)
    cart.until_it_stands()
    assert math.dist(cart.at, path[-1]) < 0.15
    assert max(off_path(path, p) for p in cart.track) < 0.25
    assert max(cart.speeds) <= 1.5 + 1e-6


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-8, 8), st.floats(-8, 8)), min_size=1, max_size=4, unique=True))
def test_any_path_ends(points: list[Vec2]) -> None:
    cart = Cart()
    cart.driving.drive(tuple(points), 2.0, cart.at)
    cart.until_it_stands()
    assert math.dist(cart.at, points[-1]) < 0.3


def test_never_faster_than_its_limit() -> None:
    cart = Cart()
    cart.driving.drive(((0.0, 0.0), (20.0, 0.0)), 9.0, cart.at)
    cart.until_it_stands()
    assert max(cart.speeds) <= LIMITS.max_speed_mps + 1e-6


def test_hold_stops_and_the_same_path_goes_on() -> None:
    cart, path = Cart(), ((0.0, 0.0), (6.0, 0.0), (6.0, 3.0))
    cart.driving.drive(path, 1.0, cart.at)
    for _ in range(80):
        cart.turn()
    cart.driving.hold()
    cart.until_it_stands()
    assert 1.0 < cart.at[0] < 5.5
    cart.driving.drive(path, 1.0, cart.at)
    cart.until_it_stands()
    assert math.dist(cart.at, path[-1]) < 0.15
    cart.driving.drive(path, 1.0, cart.at)
    assert not cart.driving.going, "there is nothing left to do"


def test_a_repeated_drive_changes_nothing() -> None:
    path = ((0.0, 0.0), (4.0, 0.0))
    once, often = Cart(), Cart()
    for cart, every in ((once, 10_000), (often, 5)):
        for k in range(150):
            if k % every == 0:
                cart.driving.drive(path, 1.0, cart.at)
            cart.turn()
    assert once.track == often.track


def test_stands_while_its_pose_is_stale() -> None:
    cart = Cart()
    cart.driving.drive(((0.0, 0.0), (9.0, 0.0)), 1.0, cart.at)
    for _ in range(60):
        cart.turn()
    for _ in range(40):
        cart.turn(stale=True)
    assert cart.speed == 0.0
    assert cart.driving.going
    cart.until_it_stands()
    assert cart.at[0] == pytest.approx(9.0, abs=0.15)


def test_standing_on_the_only_point_is_being_there() -> None:
    cart = Cart()
    cart.driving.drive(((0.0, 0.0),), 1.0, cart.at)
    assert not cart.driving.going
    assert cart.driving.step(cart.at, 0.0, DT) == STAND
    assert ARRIVED_M > 0
