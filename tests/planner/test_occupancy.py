"""Occupancy grids: clearance, distances, routes pulled straight."""

from __future__ import annotations

import math
import time
from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

from planner.occupancy import OccupancyRoads
from planner.roads import RoadError


def room() -> NDArray[np.bool_]:
    """100 x 60 cells with a wall at columns 45..54 that leaves a gate at the top, and a closed chamber."""
    free = np.ones((60, 100), dtype=np.bool_)
    free[:40, 45:55] = False
    free[10:30, 10:30] = False
    free[14:26, 14:26] = True
    return free


SITES = np.array([[35.0, 10.0], [90.0, 10.0], [20.0, 20.0], [50.0, 50.0]])


@pytest.fixture(scope="module")
def roads() -> OccupancyRoads:
    return OccupancyRoads(room(), 1.0, (0.0, 0.0, 0.0), SITES, 3.0)


def length(line: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def test_the_chamber_is_out_of_reach(roads: OccupancyRoads) -> None:
    assert np.isinf(roads.distance_m[2, [0, 1, 3]]).all()
    assert np.isfinite(roads.distance_m[0, [1, 3]]).all()
    with pytest.raises(RoadError, match="no way leads"):
        roads.route((35.0, 10.0), 2)


def test_distances_are_symmetric_and_a_little_too_long(roads: OccupancyRoads) -> None:
    d = roads.distance_m
    assert (d == d.T).all()
    assert (np.diag(d) == 0).all()
    corners = [(35, 10), (42, 43), (58, 43), (90, 10)]  # around the wall with 3 m of clearance
    shortest = sum(math.dist(a, b) for a, b in pairwise(corners))
    assert 0.97 * shortest < d[0, 1] < 1.03 * shortest


def test_routes_keep_clear_and_are_straight(roads: OccupancyRoads) -> None:
    line = roads.route((35.0, 10.0), 1)
    assert line[0].tolist() == [35, 10]
    assert line[-1].tolist() == [90, 10]
    assert len(line) < 8
    assert length(line) <= roads.distances_from((35.0, 10.0))[1] + 1.5
    for a, b in pairwise(line):
        for t in np.linspace(0, 1, 50):
            x, y = a + t * (b - a)
            assert roads.offset_m((x, y)) <= 1.0
            assert not (44.0 - 1.5 < x < 56.0 + 0.5 and y < 41.0)


def test_offset_and_snapping(roads: OccupancyRoads) -> None:
    assert roads.offset_m((35.0, 10.0)) == 0
    assert roads.offset_m((50.0, 20.0)) == pytest.approx(8, abs=1.5)
    assert roads.offset_m((150.0, 30.0)) > 50
    inside = roads.with_sites(np.array([[50.0, 20.0]]))
    assert roads.offset_m((float(inside.sites[0, 0]), float(inside.sites[0, 1]))) == 0


def test_a_route_from_inside_an_obstacle_begins_there(roads: OccupancyRoads) -> None:
    line = roads.route((46.0, 20.0), 0)
    assert line[0].tolist() == [46, 20]
    assert line[-1].tolist() == [35, 10]


def test_origin_and_yaw() -> None:
    turned = OccupancyRoads(room(), 0.5, (10.0, 20.0, math.pi / 2), np.array([[5.0, 37.5], [5.0, 65.0]]), 1.5)
    plain = OccupancyRoads(room(), 1.0, (0.0, 0.0, 0.0), np.array([[35.0, 10.0], [90.0, 10.0]]), 3.0)
    assert turned.distance_m[0, 1] == pytest.approx(0.5 * plain.distance_m[0, 1], rel=1e-6)
    assert turned.route((5.0, 37.5), 1)[-1].tolist() == [5, 65]


def test_nowhere_to_be() -> None:
    with pytest.raises(RoadError, match="clearance"):
        OccupancyRoads(room(), 1.0, (0.0, 0.0, 0.0), SITES, 40.0)


def test_no_sites_yet_but_places(roads: OccupancyRoads) -> None:
    empty = roads.with_sites(np.zeros((0, 2)))
    assert empty.distance_m.shape == (0, 0)
    places = empty.places(10.0)
    assert len(places) > 5
    assert max(empty.offset_m((float(x), float(y))) for x, y in places) == 0


def test_long_steps_do_not_jump_thin_diagonal_walls() -> None:
    free = np.ones((30, 30), dtype=np.bool_)
    for i in range(30):
        free[i, max(0, i - 1) : i + 1] = False
    apart = OccupancyRoads(free, 1.0, (0.0, 0.0, 0.0), np.array([[5.0, 25.0], [25.0, 5.0]]), 0.0)
    assert np.isinf(apart.distance_m[0, 1])


def test_in_flight_queries_are_fast(roads: OccupancyRoads) -> None:
    rng = np.random.default_rng(1)
    points = [(float(x), float(y)) for x, y in rng.uniform(0, 60, (500, 2))]
    begun = time.perf_counter()
    for point in points:
        roads.distances_from(point)
        roads.offset_m(point)
    assert (time.perf_counter() - begun) / 1000 < 200e-6
