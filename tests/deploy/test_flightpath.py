"""Timed paths, and conflicts between them against brute-force sampling."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

from deploy.flightpath import (
    EARLY_LATE_S,
    FOREVER_S,
    PIECE_S,
    TimedPath,
    along,
    conflict,
    pieces,
    rest_to_rest_s,
    resting,
    segment_distance_m,
    straight,
    vertical_gap_m,
)
from drivers.vehicle import Vec3

H, V = 4.0, 5.0
number = st.floats(-30, 30).map(lambda x: round(x, 2))
place = st.tuples(number, number, st.floats(0, 20).map(lambda x: round(x, 2)))


@st.composite
def paths(draw: st.DrawFn, forever: bool | None = None) -> TimedPath:
    """One to five knots that begin around time 0; with or without the last rest written out."""
    t = draw(st.floats(-10, 3))
    knots = []
    for at in draw(st.lists(place, min_size=1, max_size=5)):
        knots.append((t, *at))
        t += draw(st.floats(0.5, 12))
    if draw(st.booleans()) if forever is None else forever:
        knots.append((FOREVER_S, *knots[-1][1:]))
    return TimedPath(tuple(knots))


@st.composite
def near_pairs(draw: st.DrawFn) -> tuple[TimedPath, TimedPath]:
    """Two paths that begin at time 0 inside each other's cylinder."""
    mine, other = draw(paths()), draw(paths())
    (_, x, y, z), (_, u, v, w) = mine.knots[0], other.knots[0]
    dx, dy, dz = (
        x - u + draw(st.floats(-2.5, 2.5)),
        y - v + draw(st.floats(-2.5, 2.5)),
        z - w + draw(st.floats(-4.5, 4.5)),
    )
    late = [(t if t >= FOREVER_S else t - mine.knots[0][0], *p) for t, *p in mine.knots]
    moved = [(t if t >= FOREVER_S else t - other.knots[0][0], a + dx, b + dy, c + dz) for t, a, b, c in other.knots]
    return TimedPath(tuple(late)), TimedPath(tuple(moved))


def nearness(a: Vec3, b: Vec3) -> float:
    """In cylinders: below 1 is too near."""
    return max(math.dist(a[:2], b[:2]) / H, abs(a[2] - b[2]) / V)


# --- paths ------------------------------------------------------------------------------------------------------------


def test_at_rests_before_and_after() -> None:
    path = TimedPath(((10.0, 0.0, 0.0, 5.0), (12.0, 4.0, 0.0, 5.0), (16.0, 4.0, 8.0, 1.0)))
    assert path.at(0.0) == (0.0, 0.0, 5.0)
    assert path.at(10.0) == (0.0, 0.0, 5.0)
    assert path.at(11.0) == (2.0, 0.0, 5.0)
    assert path.at(13.0) == (4.0, 2.0, 4.0)
    assert path.at(16.0) == path.at(99.0) == (4.0, 8.0, 1.0)
    assert (path.end_s, path.end_m, path.rests_from_s) == (16.0, (4.0, 8.0, 1.0), 16.0)


def test_when_it_comes_to_rest() -> None:
    assert resting((1.0, 2.0, 3.0), 7.0).rests_from_s == 7.0
    assert TimedPath(((5.0, 1.0, 2.0, 3.0),)).rests_from_s == 5.0
    assert straight((0.0, 0.0, 0.0), (10.0, 0.0, 0.0), 3.0, 2.0, 1.0).rests_from_s == pytest.approx(3.0 + 7.0)


@pytest.mark.parametrize(
    ("distance_m", "duration_s"),
    [
        (0.0, 0.0),
        (-1.0, 0.0),
        (100.0, 15.0),  # 5 s and 25 m to 10 m/s, 50 m at it, 5 s and 25 m to rest
        (50.0, 10.0),  # just reaches 10 m/s
        (8.0, 4.0),  # 2 s and 4 m up to 4 m/s, and down again
    ],
)
def test_rest_to_rest(distance_m: float, duration_s: float) -> None:
    assert rest_to_rest_s(distance_m, 10.0, 2.0) == pytest.approx(duration_s)


@given(st.floats(0.01, 500), st.floats(0.5, 20), st.floats(0.2, 10))
def test_rest_to_rest_against_integration(distance_m: float, speed_mps: float, accel_mps2: float) -> None:
    x = v = t = 0.0
    dt = rest_to_rest_s(distance_m, speed_mps, accel_mps2) / 5000
    while x < distance_m and t < 2 * 5000 * dt:
        brake = v * v / (2 * accel_mps2) >= distance_m - x
        v = max(1e-9, v - accel_mps2 * dt) if brake else min(speed_mps, v + accel_mps2 * dt)
        x, t = x + v * dt, t + dt
        if brake and v <= 1e-9:
            break
    assert t == pytest.approx(5000 * dt, rel=0.02)


def test_straight() -> None:
    path = straight((0.0, 0.0, 10.0), (100.0, 0.0, 10.0), 50.0, 10.0, 2.0)
    assert path.at(50.0) == (0.0, 0.0, 10.0)
    assert path.at(57.5) == pytest.approx((50.0, 0.0, 10.0))
    assert path.at(65.0) == path.at(1e6) == (100.0, 0.0, 10.0)
    assert straight((1.0, 2.0, 3.0), (1.0, 2.0, 3.0), 5.0, 10.0, 2.0) == resting((1.0, 2.0, 3.0), 5.0)


def test_along() -> None:
    path = along(((0.0, 0.0), (10.0, 0.0), (10.0, 0.0), (10.0, 5.0)), 0.3, 100.0, 5.0)
    assert [k[0] for k in path.knots] == [100.0, 102.0, 103.0, FOREVER_S]  # the doubled point gives no knot
    assert path.at(101.0) == (5.0, 0.0, 0.3)
    assert path.at(102.5) == (10.0, 2.5, 0.3)
    assert path.at(1e6) == (10.0, 5.0, 0.3)


@given(paths(), st.floats(-15, 60))
def test_pieces_cover_the_path(path: TimedPath, from_s: float) -> None:
    found = pieces(path, from_s)
    assert found[0][0] == from_s
    assert found[-1][1] >= FOREVER_S
    for (_, t1, _, b), (t2, _, c, _) in pairwise(found):
        assert t1 == pytest.approx(t2, abs=1e-9)
        assert b == pytest.approx(c, abs=1e-6)
    for t0, t1, a, b in found:
        assert t1 > t0
        assert a == b or t1 - t0 <= PIECE_S + 1e-9
        assert a == pytest.approx(path.at(t0), abs=1e-6)
        assert b == pytest.approx(path.at(t1), abs=1e-6)


def test_pieces_after_everything() -> None:
    path = TimedPath(((0.0, 1.0, 2.0, 3.0), (1.0, 4.0, 5.0, 6.0)))
    assert pieces(path, 2 * FOREVER_S) == [(2 * FOREVER_S, 3 * FOREVER_S, (4.0, 5.0, 6.0), (4.0, 5.0, 6.0))]


# --- distances --------------------------------------------------------------------------------------------------------

flat = st.tuples(number, number, st.just(0.0))


@pytest.mark.parametrize(
    ("a", "b", "c", "d", "distance_m"),
    [
        ((0, 0, 0), (10, 0, 0), (5, -5, 0), (5, 5, 0), 0.0),  # crossing
        ((0, 0, 0), (10, 0, 0), (0, 3, 0), (10, 3, 0), 3.0),  # parallel
        ((0, 0, 0), (10, 0, 0), (13, 4, 0), (20, 4, 0), 5.0),  # end to end
        ((0, 0, 0), (10, 0, 0), (4, 2, 9), (4, 2, 9), 2.0),  # a point; heights do not count
        ((4, 2, 0), (4, 2, 0), (0, 0, 0), (10, 0, 0), 2.0),
        ((0, 0, 0), (0, 0, 0), (3, 4, 0), (3, 4, 0), 5.0),  # two points
        ((0, 0, 0), (10, 0, 0), (12, 0, 0), (20, 0, 0), 2.0),  # on one line
        ((0, 0, 0), (10, 0, 0), (2, 0, 0), (8, 0, 0), 0.0),
    ],
)
def test_segment_distance(a: Vec3, b: Vec3, c: Vec3, d: Vec3, distance_m: float) -> None:
    assert segment_distance_m(a, b, c, d) == pytest.approx(distance_m, abs=1e-9)


@given(flat, flat, flat, flat)
def test_segment_distance_against_sampling(a: Vec3, b: Vec3, c: Vec3, d: Vec3) -> None:
    found = segment_distance_m(a, b, c, d)
    assert found == pytest.approx(segment_distance_m(c, d, a, b), abs=1e-6)
    assert found == pytest.approx(segment_distance_m(b, a, c, d), abs=1e-6)
    n = 40
    sampled = min(
        math.dist([a[k] + i / n * (b[k] - a[k]) for k in (0, 1)], [c[k] + j / n * (d[k] - c[k]) for k in (0, 1)])
        for i in range(n + 1)
        for j in range(n + 1)
    )
    assert found <= sampled + 1e-6
    assert found >= sampled - (math.dist(a, b) + math.dist(c, d)) / (2 * n) - 1e-6


@pytest.mark.parametrize(
    ("za", "zb", "zc", "zd", "gap_m"),
    [(0, 2, 5, 9, 3), (9, 5, 2, 0, 3), (0, 6, 5, 9, 0), (3, 3, 3, 3, 0), (7, 7, 1, 2, 5)],
)
def test_vertical_gap(za: float, zb: float, zc: float, zd: float, gap_m: float) -> None:
    assert vertical_gap_m((0, 0, za), (9, 9, zb), (50, 0, zc), (60, 0, zd)) == gap_m


# --- conflicts --------------------------------------------------------------------------------------------------------


@settings(max_examples=120, deadline=None)
@given(paths(), paths(), st.floats(0, 6), st.sampled_from([0.0, 1.0, EARLY_LATE_S]))
def test_no_conflict_is_missed(mine: TimedPath, other: TimedPath, now_s: float, slop_s: float) -> None:
    assume(nearness(mine.at(now_s), other.at(now_s)) >= 1)
    found = conflict(mine, other, now_s, H, V, slop_s)
    end_s = max(k[0] for p in (mine, other) for k in p.knots if k[0] < FOREVER_S) + 2 * slop_s + 1
    times = [now_s + i * (max(end_s, now_s + 1) - now_s) / 100 for i in range(101)]
    shifts = [2 * slop_s * k / 3 for k in range(-3, 4)] if slop_s else [0.0]
    near = [
        (t, s)
        for t in times
        for shift in shifts
        if (s := t + shift) >= now_s and nearness(mine.at(t), other.at(s)) < 1 - 1e-6
    ]
    if near:
        assert found is not None, f"they are too near at {near[0]}"
    if found is not None:
        assert found.time_s >= now_s
        assert found.horizontal_m < H and found.vertical_m < V


@settings(max_examples=100, deadline=None)
@given(near_pairs(), st.floats(0, 1))
@example(  # side by side, and the way leads straight through the other one
    (straight((0.0, 0.0, 10.0), (50.0, 0.0, 10.0), 0.0, 10.0, 2.0), resting((2.9, 0.0, 10.0), 0.0)), 0.0
)
@example(  # one above the other, and the lower one climbs through the upper one
    (straight((0.0, 0.0, 10.0), (0.0, 0.0, 40.0), 0.0, 10.0, 2.0), resting((0.0, 0.0, 14.0), 0.0)), 0.0
)
def test_a_pair_that_starts_too_near_may_only_part(pair: tuple[TimedPath, TimedPath], now_s: float) -> None:
    mine, other = pair
    assume(nearness(mine.at(now_s), other.at(now_s)) < 1)
    if conflict(mine, other, now_s, H, V) is None:
        values = [nearness(mine.at(now_s + 0.1 * i), other.at(now_s + 0.1 * i)) for i in range(600)]
        left = next(i for i, value in enumerate(values) if value >= 1)  # it does leave,
        assert all(b >= a - 1e-9 for a, b in pairwise(values[: left + 1]))  # only ever away,
        assert min(values[left:]) >= 1 - 1e-6  # and never comes back


@given(paths(), paths(), st.floats(0, 6), st.sampled_from([0.0, EARLY_LATE_S]))
def test_conflict_is_symmetric(mine: TimedPath, other: TimedPath, now_s: float, slop_s: float) -> None:
    there, back = conflict(mine, other, now_s, H, V, slop_s), conflict(other, mine, now_s, H, V, slop_s)
    assert (there is None) == (back is None)


@given(paths(), paths())
def test_layers_keep_apart_whatever_the_paths(mine: TimedPath, other: TimedPath) -> None:
    low = TimedPath(tuple((t, x, y, 10.0) for t, x, y, _ in mine.knots))
    high = TimedPath(tuple((t, x, y, 10.0 + V) for t, x, y, _ in other.knots))
    assert conflict(low, high, 0.0, H, V) is None


@given(paths(), paths(), st.floats(0, 6))
def test_far_apart_is_no_conflict(mine: TimedPath, other: TimedPath, now_s: float) -> None:
    far = TimedPath(tuple((t, x + 100, y, z) for t, x, y, z in other.knots))
    assert conflict(mine, far, now_s, H, V) is None


def test_the_radius_is_not_part_of_the_cylinder() -> None:
    a, b = resting((0.0, 0.0, 10.0), 0.0), resting((4.0, 0.0, 10.0), 0.0)
    assert conflict(a, b, 0.0, 4.0, 5.0) is None
    assert conflict(a, b, 0.0, 4.001, 5.0) is not None
    c = resting((0.0, 0.0, 15.0), 0.0)
    assert conflict(a, c, 0.0, 4.0, 5.0) is None
    assert conflict(a, c, 0.0, 4.0, 5.001) is not None


def test_what_the_conflict_says() -> None:
    crossing = straight((0.0, -50.0, 10.0), (0.0, 50.0, 10.0), 0.0, 10.0, 2.0)
    found = conflict(crossing, resting((3.0, 0.0, 12.0), 0.0), 0.0, H, V)
    assert found is not None
    assert (found.horizontal_m, found.vertical_m) == (pytest.approx(3.0), pytest.approx(2.0))
    assert 3.0 <= found.time_s <= 7.5  # the piece that passes there at 7.5 s


@pytest.mark.parametrize(("apart_s", "slop_s", "free"), [(6.5, 3.0, False), (14.0, 3.0, True), (6.5, 0.5, True)])
def test_slop_is_how_unpunctual_both_may_be(apart_s: float, slop_s: float, free: bool) -> None:
    first = along(((-20.0, 0.0), (20.0, 0.0)), 10.0, 0.0, 10.0)
    second = along(((0.0, -20.0), (0.0, 20.0)), 10.0, apart_s, 10.0)
    assert (conflict(first, second, 0.0, 3.0, V, slop_s) is None) == free
    assert (conflict(second, first, 0.0, 3.0, V, slop_s) is None) == free


def test_one_behind_the_other_is_let_go_when_the_first_is_gone() -> None:
    leaving = straight((0.0, 0.0, 10.0), (200.0, 0.0, 10.0), 0.0, 10.0, 2.0)
    after = straight((0.0, -100.0, 10.0), (0.0, 0.0, 10.0), 0.0, 10.0, 2.0)
    assert conflict(after, leaving, 0.0, H, V) is None


def test_parting_sideways_is_allowed() -> None:
    other = resting((2.0, 0.0, 10.0), 0.0)
    away = straight((0.0, 0.0, 10.0), (-60.0, 0.0, 10.0), 0.0, 10.0, 2.0)
    assert conflict(away, other, 0.0, H, V) is None
    assert conflict(resting((0.0, 0.0, 10.0), 0.0), other, 0.0, H, V) is not None  # staying is not parting
    short = straight((0.0, 0.0, 10.0), (-1.0, 0.0, 10.0), 0.0, 10.0, 2.0)
    assert conflict(short, other, 0.0, H, V) is not None  # nor is stopping inside


def test_parting_upwards_is_allowed() -> None:
    other = resting((0.0, 0.0, 10.0), 0.0)
    assert conflict(straight((0.0, 0.0, 12.0), (0.0, 0.0, 30.0), 0.0, 5.0, 2.0), other, 0.0, H, V) is None
    assert conflict(straight((0.0, 0.0, 12.0), (0.0, 0.0, 0.0), 0.0, 5.0, 2.0), other, 0.0, H, V) is not None


def test_parting_from_the_very_same_place() -> None:
    here = (0.0, 0.0, 10.0)
    away = straight(here, (60.0, 0.0, 10.0), 0.0, 10.0, 2.0)
    assert conflict(away, resting(here, 0.0), 0.0, H, V) is None
    assert conflict(away, straight(here, (-60.0, 0.0, 10.0), 0.0, 10.0, 2.0), 0.0, H, V) is None
    assert conflict(away, away, 0.0, H, V) is not None


def test_ugvs_conflict_whatever_their_height() -> None:
    a = along(((0.0, 0.0), (50.0, 0.0)), 0.0, 0.0, 5.0)
    b = along(((25.0, -25.0), (25.0, 25.0)), 0.0, 0.0, 5.0)
    assert conflict(a, b, 0.0, 2.0, math.inf) is not None
    assert conflict(a, along(((0.0, 10.0), (50.0, 10.0)), 0.0, 0.0, 5.0), 0.0, 2.0, math.inf) is None
