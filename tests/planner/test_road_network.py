"""Road networks: noding, snapping, distances and routes that agree."""

from __future__ import annotations

import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from planner.road_network import RoadNetwork
from planner.roads import RoadError

# A cross, and a piece of road that leads nowhere.
CROSS = [np.array([[0.0, 0], [100, 0]]), np.array([[50.0, -50], [50, 50]]), np.array([[200.0, 0], [300, 0]])]
SITES = np.array([[10.0, 3], [50, 40], [90, 0], [250, 0]])


def length(line: NDArray[np.float64]) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


@pytest.fixture(scope="module")
def cross() -> RoadNetwork:
    return RoadNetwork.from_lines(CROSS, SITES)


def test_sites_move_onto_the_road(cross: RoadNetwork) -> None:
    assert cross.sites.tolist() == [[10, 0], [50, 40], [90, 0], [250, 0]]


def test_crossing_lines_are_joined(cross: RoadNetwork) -> None:
    assert cross.distance_m[0].tolist() == [0, 80, 80, np.inf]
    assert cross.distance_m[1].tolist() == [80, 0, 80, np.inf]
    assert cross.parts == 2


def test_distances_from_anywhere(cross: RoadNetwork) -> None:
    assert cross.distances_from((50.0, 20.0)).tolist() == [60, 20, 60, np.inf]
    assert cross.distances_from((20.0, -7.0))[:3].tolist() == [10, 70, 70]
    assert cross.distances_from((1000.0, 0.0)).tolist() == [np.inf, np.inf, np.inf, 50]


def test_offset(cross: RoadNetwork) -> None:
    assert cross.offset_m((20.0, -7.0)) == pytest.approx(7)
    assert cross.offset_m((150.0, 0.0)) == pytest.approx(50)
    assert cross.offset_m((50.0, 12.0)) == 0


def test_routes_turn_at_the_crossing(cross: RoadNetwork) -> None:
    assert cross.route((10.0, 0.0), 1).tolist() == [[10, 0], [50, 0], [50, 40]]
    assert cross.route((20.0, 5.0), 2).tolist() == [[20, 5], [20, 0], [50, 0], [90, 0]]
    assert cross.route((90.0, 0.0), 2).shape == (2, 2)


def test_no_way(cross: RoadNetwork) -> None:
    with pytest.raises(RoadError, match="no road leads"):
        cross.route((10.0, 0.0), 3)


def test_two_sites_on_one_piece_and_on_its_ends() -> None:
    roads = RoadNetwork.from_lines(
        [np.array([[0.0, 0], [10, 0]])], np.array([[7.0, 0], [3, 0], [3, 1], [0, 0], [10, 0]])
    )
    assert roads.distance_m[0].tolist() == [0, 4, 4, 7, 3]
    assert roads.route((1.0, 0.0), 0).tolist() == [[1, 0], [3, 0], [7, 0]]


@pytest.mark.parametrize("lines", [[], [np.zeros((1, 2))], [np.zeros((2, 2))]])
def test_no_road_at_all(lines: list[NDArray[np.float64]]) -> None:
    with pytest.raises(RoadError, match="road"):
        RoadNetwork.from_lines(lines, np.zeros((1, 2)))


def test_a_site_too_far_from_roads() -> None:
    with pytest.raises(RoadError, match="site 0 at"):
        RoadNetwork.from_lines(CROSS, SITES, max_offset_m=2.0)


def test_places_are_on_the_road_and_spread(cross: RoadNetwork) -> None:
    places = cross.places(10.0)
    assert len(places) >= 20
    assert max(cross.offset_m((float(x), float(y))) for x, y in places) < 1e-9


def grid(n: int, rng: np.random.Generator) -> list[NDArray[np.float64]]:
    knots = np.stack(np.meshgrid(np.arange(n), np.arange(n), indexing="ij"), -1) * 100.0
    knots = knots + rng.uniform(-30, 30, knots.shape)
    across = [knots[i : i + 2, j] for i in range(n - 1) for j in range(n)]
    return across + [knots[i, j : j + 2] for i in range(n) for j in range(n - 1)]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_routes_are_as_long_as_the_distances_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    lines = grid(5, rng)
    roads = RoadNetwork.from_lines(lines, rng.uniform(0, 400, (4, 2)))
    d = roads.distance_m
    np.testing.assert_allclose(d, d.T)
    for i in range(4):
        for j in range(4):
            assert (d[i, j] <= d[i] + d[:, j] + 1e-6).all()
    start = (float(rng.uniform(0, 400)), float(rng.uniform(0, 400)))
    for site, distance in enumerate(roads.distances_from(start)):
        line = roads.route(start, site)
        np.testing.assert_allclose(line[0], start)
        np.testing.assert_allclose(line[-1], roads.sites[site], atol=1e-6)
        assert length(line) - roads.offset_m(start) == pytest.approx(distance, abs=1e-3)


def test_in_flight_queries_are_fast() -> None:
    rng = np.random.default_rng(1)
    roads = RoadNetwork.from_lines(grid(25, rng), rng.uniform(0, 2400, (10, 2)))
    points = [(float(x), float(y)) for x, y in rng.uniform(0, 2400, (500, 2))]
    begun = time.perf_counter()
    for point in points:
        roads.distances_from(point)
        roads.offset_m(point)
    assert (time.perf_counter() - begun) / 1000 < 300e-6  # about 30 us on an idle machine
