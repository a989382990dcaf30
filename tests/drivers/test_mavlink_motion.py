"""The streamed reference keeps every limit and rests exactly where it should."""

from __future__ import annotations

import itertools
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.limits import UavLimits
from drivers.mavlink_motion import REST, Reference, approach_mps, brake, patience, steer

LIMITS = UavLimits(max_speed_mps=4.0, accel_mps2=2.0, climb_mps=1.5, descent_mps=1.0, altitude_m=30.0)
DT = 0.05
COORDINATE = st.floats(-30.0, 30.0)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)


def flight(start: Reference, target: tuple[float, float, float], speed: float) -> list[Reference]:
    track = [start]
    while track[-1] != Reference(target):
        track.append(steer(track[-1], target, speed, LIMITS, DT))
        assert len(track) < 10_000, "it never arrives"
    return track


@settings(deadline=None)
@given(POINT, POINT, st.floats(0.2, 10.0))
def test_rest_to_rest_is_straight_and_within_limits(
    a: tuple[float, float, float], b: tuple[float, float, float], speed: float
) -> None:
    track = flight(Reference(a), b, speed)
    for before, after in itertools.pairwise(track):
        vx, vy, vz = after.velocity_mps
        assert math.hypot(vx, vy, vz) <= min(speed, LIMITS.max_speed_mps) + 1e-9
        assert -LIMITS.descent_mps - 1e-9 <= vz <= LIMITS.climb_mps + 1e-9
        assert math.dist(before.velocity_mps, after.velocity_mps) <= LIMITS.accel_mps2 * DT + 1e-9
    length = math.dist(a, b)
    for r in track:
        on_line = math.dist(a, r.position_m) + math.dist(r.position_m, b)
        assert on_line == pytest.approx(length, abs=1e-2)


@settings(deadline=None)
@given(POINT, POINT, POINT)
def test_a_new_target_on_the_way_is_reached_without_a_jump(
    a: tuple[float, float, float], b: tuple[float, float, float], c: tuple[float, float, float]
) -> None:
    way = flight(Reference(a), b, 3.0)
    track = flight(way[len(way) // 2], c, 3.0)
    for before, after in itertools.pairwise(track):
        assert math.dist(before.position_m, after.position_m) <= LIMITS.max_speed_mps * DT + 2e-3


def test_braking_ends_at_rest_within_the_stopping_distance() -> None:
    reference = Reference((0.0, 0.0, 10.0), (4.0, 0.0, 0.0))
    for _ in range(100):
        reference = brake(reference, LIMITS.accel_mps2, DT)
    assert reference.velocity_mps == REST
    assert reference.position_m[0] == pytest.approx(4.0, abs=0.2)


@pytest.mark.parametrize("distance", [0.001, 0.1, 1.0, 50.0])
def test_approach_speed_suffices_to_stop(distance: float) -> None:
    left = distance
    for _ in range(10_000):
        speed = approach_mps(left, 2.0, DT)
        left -= speed * DT
        assert left > -1e-9
    assert left < 1e-3


def test_the_reference_waits_for_a_vehicle_that_lags() -> None:
    assert patience(0.3, 2.0) == 1.0
    assert patience(1.5, 2.0) == 1.0
    assert 0.0 < patience(2.0, 2.0) < 1.0
    assert patience(4.0, 2.0) == 0.0
