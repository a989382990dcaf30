"""World and arena: a similarity that can be undone."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.frames import Frame

coordinate = st.floats(-1e4, 1e4)
point = st.tuples(coordinate, coordinate)
frames = st.builds(
    Frame,
    scale=st.floats(1e-3, 1e2),
    rotation_rad=st.floats(-math.pi, math.pi),
    origin_m=point,
    time_scale=st.floats(1e-3, 10),
)


def test_the_default_changes_nothing() -> None:
    assert Frame().to_arena((3.0, -4.0)) == (3.0, -4.0)
    assert Frame().to_world((3.0, -4.0)) == (3.0, -4.0)
    assert Frame().speed_to_arena(10.0) == 10.0


def test_scale_rotate_move() -> None:
    frame = Frame(scale=0.5, rotation_rad=math.pi / 2, origin_m=(1.0, 2.0), time_scale=0.1)
    assert frame.to_arena((10.0, 0.0)) == pytest.approx((1.0, 7.0))  # east becomes north
    assert frame.to_arena((0.0, 10.0)) == pytest.approx((-4.0, 2.0))
    assert frame.to_world((1.0, 7.0)) == pytest.approx((10.0, 0.0))
    assert frame.speed_to_arena(2.0) == pytest.approx(10.0)  # half as far, in a tenth of the time


@given(frames, point)
def test_there_and_back(frame: Frame, world: tuple[float, float]) -> None:
    assert frame.to_world(frame.to_arena(world)) == pytest.approx(world, abs=1e-4)


@given(frames, point, point)
def test_distances_scale(frame: Frame, a: tuple[float, float], b: tuple[float, float]) -> None:
    arena_m = math.dist(frame.to_arena(a), frame.to_arena(b))
    assert arena_m == pytest.approx(frame.scale * math.dist(a, b), rel=1e-6, abs=1e-6)


@given(frames, st.floats(0.1, 50))
def test_a_speed_is_a_distance_over_a_time(frame: Frame, world_mps: float) -> None:
    arena_m = math.dist(frame.to_arena((0.0, 0.0)), frame.to_arena((world_mps, 0.0)))
    assert frame.speed_to_arena(world_mps) == pytest.approx(arena_m / frame.time_scale, rel=1e-6)
