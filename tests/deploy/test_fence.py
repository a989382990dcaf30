"""The geofence against a polygon that is not convex."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.fence import margin_m, path_inside

# A U that opens to the north: x 0..30, y 0..20, with a notch x 10..20, y 5..20.
U = ((0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (20.0, 20.0), (20.0, 5.0), (10.0, 5.0), (10.0, 20.0), (0.0, 20.0))
coordinate = st.floats(-5, 35)
point = st.tuples(coordinate, coordinate)


def in_u(x: float, y: float) -> bool:
    return 0 <= x <= 30 and 0 <= y <= 20 and not (10 < x < 20 and y > 5)


@pytest.mark.parametrize(
    ("x", "y", "margin"),
    [
        (5.0, 10.0, 5.0),
        (15.0, 2.0, 2.0),
        (15.0, 10.0, -5.0),  # in the notch: outside
        (15.0, 7.0, -2.0),
        (40.0, 10.0, -10.0),
        (-3.0, -4.0, -5.0),
        (0.0, 10.0, 0.0),
    ],
)
def test_margin(x: float, y: float, margin: float) -> None:
    assert margin_m(U, x, y) == pytest.approx(margin)


@given(point)
def test_the_sign_of_the_margin_says_inside(p: tuple[float, float]) -> None:
    margin = margin_m(U, *p)
    if abs(margin) > 1e-9:
        assert (margin > 0) == in_u(*p)


@pytest.mark.parametrize(
    ("points", "inside"),
    [
        (((5.0, 18.0), (5.0, 2.0)), True),
        (((5.0, 18.0), (25.0, 18.0)), False),  # both ends inside, but across the notch
        (((5.0, 18.0), (5.0, 2.0), (25.0, 2.0), (25.0, 18.0)), True),
        (((5.0, 2.0), (5.0, -2.0)), False),
        (((0.0, 0.0), (30.0, 0.0)), True),  # along the edge
        (((5.0, 5.0), (5.0, 5.0)), True),  # a path that does not move
        (((15.0, 10.0), (15.0, 10.0)), False),
    ],
)
def test_paths(points: tuple[tuple[float, float], ...], inside: bool) -> None:
    assert path_inside(U, points) is inside


@given(point, point)
def test_a_path_inside_has_every_point_inside(a: tuple[float, float], b: tuple[float, float]) -> None:
    samples = [(a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1])) for f in np.linspace(0, 1, 101)]
    if path_inside(U, (a, b)):
        assert all(margin_m(U, *s) >= -1e-9 for s in samples)
    else:
        length_m = math.dist(a, b)
        # Something of it is outside; where samples see nothing, it only cuts a corner shorter than their spacing.
        assert any(not in_u(*s) for s in samples) or min(margin_m(U, *s) for s in samples) <= length_m / 100
