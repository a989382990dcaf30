"""Closest approaches against dense sampling, and the predicted paths themselves."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from checks_world import EAST_WEST, check, make_settings, plan_of, with_problem, with_uav

from deploy.check_paths import Leg, polyline, team_paths
from deploy.check_report import Verdict
from deploy.check_separation import closest_approach, episodes
from deploy.flightpath import rest_to_rest_s
from planner.plan import Move, Recharge, Visit


def leg(t0: float, t1: float, a: tuple[float, float, float], b: tuple[float, float, float]) -> Leg:
    return Leg("fly", t0, t1, a, b)


@pytest.mark.parametrize("seed", range(40))
def test_exact_against_sampling(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b = (
        Leg("fly", 0.0, 10.0, *(tuple(map(float, rng.uniform(-10, 10, 3))) for _ in range(2)))  # type: ignore[misc]
        for _ in range(2)
    )
    h, v = rng.uniform(1, 5, 2)
    found = closest_approach(a, b, h, v)
    f = np.linspace(0, 1, 20_001)[:, None]
    d = (np.array(a.a_m) - b.a_m) * (1 - f) + (np.array(a.b_m) - b.b_m) * f
    sampled = np.maximum(np.hypot(d[:, 0], d[:, 1]) - h, np.abs(d[:, 2]) - v)
    assert found.margin_m <= sampled.min() + 1e-9
    assert found.margin_m == pytest.approx(sampled.min(), abs=2e-3)
    flat = closest_approach(a, b, h, math.inf)
    assert flat.margin_m == pytest.approx((np.hypot(d[:, 0], d[:, 1]) - h).min(), abs=2e-3)


def test_head_on_in_one_layer_and_in_two() -> None:
    a = leg(0, 10, (0, 0, 60), (100, 0, 60))
    b = leg(0, 10, (100, 0, 60), (0, 0, 60))
    found = closest_approach(a, b, 5.0, 6.0)
    assert (found.time_s, found.horizontal_m, found.margin_m) == (5.0, 0.0, pytest.approx(-5.0, abs=1.1))
    above = leg(0, 10, (100, 0, 70), (0, 0, 70))
    assert closest_approach(a, above, 5.0, 6.0).margin_m == pytest.approx(4.0)


def test_only_what_overlaps_in_time_counts() -> None:
    a = [leg(0, 10, (0, 0, 60), (100, 0, 60))]
    b = [leg(20, 30, (0, 0, 60), (100, 0, 60))]
    assert episodes(a, b, 5.0, 6.0) == (None, ())


def test_touching_conflicts_are_one_episode() -> None:
    a = [leg(0, 100, (0, 0, 60), (0, 0, 60))]
    b = [
        leg(0, 10, (50, 0, 60), (3, 0, 60)),
        leg(10, 20, (3, 0, 60), (2, 0, 60)),
        leg(20, 30, (2, 0, 60), (50, 0, 60)),
        leg(30, 40, (50, 0, 60), (1, 0, 60)),
    ]
    closest, found = episodes(a, b, 5.0, 6.0)
    assert [x.horizontal_m for x in found] == pytest.approx([2.0, 1.0])
    assert closest is not None
    assert closest.horizontal_m == pytest.approx(1.0)


def test_paths_climb_fly_dock_and_stay_where_nothing_is_left_to_do() -> None:
    settings = make_settings()
    paths = team_paths(settings, plan_of(settings))
    kinds = [x.kind for x in paths.uavs[0]]
    assert kinds == ["climb", "fly", "fly", "fly", "descend"]
    climb = paths.uavs[0][0]
    assert (climb.a_m, climb.b_m) == ((0.0, 10.0, 0.0), (0.0, 10.0, 60.0))
    assert climb.t1_s == pytest.approx(60 / 3 + 3 / 2)
    assert paths.uavs[0][1].b_m == (2000.0, 0.0, 60.0)
    assert paths.uavs[0][2].b_m == (3000.0, 10.0, 60.0)  # its own waiting place
    assert paths.uavs[0][-1].b_m == (3000.0, -2.0, 0.5)  # the dock
    for legs in paths.uavs:
        for before, after in pairwise(legs):
            assert after.t0_s >= before.t1_s - 1e-9
            assert after.a_m == before.b_m
    drive = [x for x in paths.ugvs[0] if x.kind == "drive"]
    assert drive[-1].b_m == (3000.0, -2.0, 0.0)
    assert drive[-1].t1_s == pytest.approx(rest_to_rest_s(3000.0, 15.0, 1.0))
    assert polyline(paths.ugvs[0]) == [(0.0, -2.0), (3000.0, -2.0)]


def test_a_uav_waits_hovering_for_its_ugv_and_leaves_when_it_is_full() -> None:
    settings = make_settings()
    actions = (Move(0, 1), Move(0, 0), Visit(0, 0), Recharge(0, 0), Visit(0, 1), Visit(1, 1))[:5]
    paths = team_paths(settings, plan_of(settings, actions))
    kinds = [x.kind for x in paths.uavs[0]]
    assert kinds == ["climb", "fly", "fly", "wait", "fly", "descend", "climb", "fly", "fly", "descend"]
    descend, climb = paths.uavs[0][5], paths.uavs[0][6]
    assert climb.t0_s - descend.t1_s == pytest.approx(300.0)
    # to its pad at the site nearest to the last task
    assert paths.uavs[0][-1].b_m == (-3000.0, 10.0, 0.0)


def test_two_uavs_at_one_ugv_are_never_in_the_column_together() -> None:
    settings = make_settings()
    actions = (Move(0, 0), Visit(0, 0), Recharge(0, 0), Recharge(1, 0), Visit(1, 1))
    paths = team_paths(settings, plan_of(settings, actions))
    first, second = (next(x for x in legs if x.kind == "descend") for legs in paths.uavs)
    assert second.t0_s >= first.t1_s or first.t0_s >= second.t1_s
    closest, conflicts = episodes(paths.uavs[0], paths.uavs[1], 5.0, 6.0)
    assert closest is not None
    assert conflicts == ()


def test_waiting_places_too_near_cannot_be_resolved() -> None:
    # both wait in one layer, 2 m apart, for a UGV that is still on its way
    settings = with_uav(with_uav(make_settings(), 1, altitude_m=60.0), 1, pad_offset_m=(0.0, 12.0))
    large = (replace(u, waiting="landed", energy_j=200e3, capacity_j=200e3) for u in settings.problem.uavs)
    settings = with_problem(settings, uavs=tuple(large))
    actions = (Move(0, 1), Move(0, 0), Visit(0, 0), Recharge(0, 0), Recharge(1, 0), Visit(1, 1))
    paths = team_paths(settings, plan_of(settings, actions))
    _, conflicts = episodes(paths.uavs[0], paths.uavs[1], 5.0, 6.0)
    assert any(c.stuck for c in conflicts)
    row = check(settings, actions).row("separation")
    assert row.verdict is Verdict.FAIL
    assert "holding cannot resolve it" in row.text


def test_the_plan_used_here_is_feasible() -> None:
    assert plan_of(make_settings(), EAST_WEST).feasible
