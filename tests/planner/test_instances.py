"""The data sets, the maps and mid-mission states."""

from __future__ import annotations

import time

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from planner.errors import PlannerError
from planner.instances import DATA_SETS, MAPS, SIZE, TEST, TRAIN, DataSet, data_set
from planner.midway import midway, state_at
from planner.occupancy import OccupancyRoads
from planner.plan import Move, Recharge, Visit
from planner.presets import PRESETS, TEAMS, preset
from planner.schedule import evaluate
from planner.solve import Stop, solve
from planner.terrain import IMPASSABLE, terrain


def test_the_papers_eight_data_sets() -> None:
    assert [d.name for d in DATA_SETS] == [f"{s}_{u}-{g}" for s in PRESETS for u, g in TEAMS]
    assert (len(TRAIN), len(TEST), SIZE) == (800, 200, 1000)
    assert not set(TRAIN) & set(TEST)


def test_instances_are_what_the_paper_says() -> None:
    for one in DATA_SETS:
        n_tasks, n_points = PRESETS[one.setup]
        first = one.instance(0)
        for problem in one.instances(range(30)):
            assert (problem.n_tasks, len(problem.path_points)) == (n_tasks, n_points)
            assert (len(problem.uavs), len(problem.ugvs)) == one.team
            away = np.linalg.norm(problem.tasks[:, None] - problem.sites[None], axis=2).min(axis=1)
            assert away.max() <= 6_500.0
            assert np.isfinite(problem.road_distance_m).all()
            np.testing.assert_array_equal(problem.path_points, first.path_points)  # the map is fixed
            assert problem.uavs[0].waiting == "landed" and problem.uavs[0].reserve_j == 0.0
            assert problem.ugvs[0].charge_s == 300.0 and problem.ugvs[0].docks == 2


def test_seeds_are_fixed() -> None:
    """If this fails, every committed label and benchmark result belongs to other instances."""
    assert data_set("T15-P5_2-2").instance(7).digest[:12] == "7b6bc8939c87"
    assert data_set("T45-P10_4-2_urban").instance(999).digest[:12] == "31c075c7d719"
    digests = {p.digest for one in DATA_SETS for p in one.instances(range(20))}
    assert len(digests) == 20 * len(DATA_SETS)


def test_generation_takes_seconds() -> None:
    DATA_SETS[0].instance(0)
    begun = time.perf_counter()
    for one in DATA_SETS:
        for _ in one.instances(range(100)):
            pass
    assert time.perf_counter() - begun < 5.0


@pytest.mark.parametrize("name", MAPS)
def test_maps(name: str) -> None:
    land = terrain(name)
    network = land.network
    assert network.parts == 1
    road = network.distance_m
    straight = np.linalg.norm(network.sites[:, None] - network.sites[None], axis=2)
    assert (road >= straight - 1e-6).all()
    assert np.abs(network.sites[:-1] - land.centres).max() < 2e-3  # central locations are on their roads
    assert np.hypot(*(network.sites[-1] - np.array(land.depot))) < 120.0
    for count in (5, 10):
        sites, distance = land.roads_at(land.spread(count))
        assert sites.shape == (count + 1, 2) and distance.shape == (count + 1, count + 1)
        apart = np.linalg.norm(sites[:, None] - sites[None], axis=2) + 1e9 * np.eye(count + 1)
        assert apart.min() > 500.0
        ticks = np.linspace(0, land.side_m, 41)
        places = np.stack(np.meshgrid(ticks, ticks), axis=-1).reshape(-1, 2)
        away = np.linalg.norm(places[:, None] - sites[None], axis=2).min(axis=1)
        assert (away <= 6_500.0).mean() > 0.98


@pytest.mark.parametrize("name", MAPS)
def test_occupancy_shows_what_the_areas_say(name: str) -> None:
    land = terrain(name)
    free = land.occupancy(20.0)
    assert free.shape == (500, 500)
    roads = shapely.unary_union([shapely.LineString(r) for r in land.roads]).buffer(60.0)
    solid = shapely.unary_union([s for k, s in land.areas if k in IMPASSABLE])
    rng = np.random.default_rng(1)
    cells = rng.integers(0, 500, (3000, 2))
    points = shapely.points((cells[:, ::-1] + 0.5) * 20.0)
    off_road = ~shapely.intersects(roads, points)
    inside = shapely.intersects(solid.buffer(-40.0), points)
    outside = ~shapely.intersects(solid.buffer(40.0), points)
    assert not free[tuple(cells[off_road & inside].T)].any()
    assert free[tuple(cells[outside].T)].all()
    on_road = np.vstack([land.centres, land.network.sites])
    rows = np.minimum((on_road / 20.0).astype(int), 499)
    assert free[rows[:, 1], rows[:, 0]].all()


def test_the_occupancy_can_be_driven_on() -> None:
    land = terrain("urban")
    sites, road = land.roads_at(land.spread(5))
    driven = OccupancyRoads(land.occupancy(20.0), 20.0, (0.0, 0.0, 0.0), sites, clearance_m=5.0).distance_m
    assert np.isfinite(driven).all()
    off = ~np.eye(6, dtype=bool)
    assert (driven[off] < 1.06 * road[off] + 80.0).all()  # open ground may be shorter, steps on the grid longer


def test_drawn_path_points() -> None:
    one = DataSet("T45-P10", (2, 2), drawn=True)
    problems = list(one.instances(range(5)))
    assert len({p.path_points.tobytes() for p in problems}) == 5
    for p in problems:
        apart = np.linalg.norm(p.sites[:, None] - p.sites[None], axis=2) + 1e9 * np.eye(11)
        assert apart.min() >= 1_200.0
    assert one.instance(3).digest == problems[3].digest
    assert data_set(one.name) == one


def test_every_map_can_be_flown() -> None:
    for name in MAPS:
        for setup in PRESETS:
            for team in ((1, 1), (4, 2)):
                for index in (800, 801):
                    problem = DataSet(setup, team, name).instance(index)
                    assert solve(problem, Stop(iterations=0)).plan.feasible, (name, setup, team, index)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: DataSet("T9", (1, 1)), "setup 'T9' does not exist; there are T15-P5, T45-P10"),
        (lambda: DataSet("T15-P5", (0, 1)), "team is"),
        (lambda: DataSet("T15-P5", (1, 1), "moon"), "map 'moon' does not exist; there are rural, suburban, urban"),
        (lambda: DATA_SETS[0].instance(-1), "instance -1 does not exist"),
        (lambda: data_set("T15"), "data set 'T15' does not exist; there are T15-P5_1-1, "),
        (lambda: terrain("moon"), "map 'moon' does not exist"),
        (lambda: terrain("rural").spread(93), "has 92 roads; 93 path points do not fit"),
    ],
)
def test_wrong_names(make, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        make()


# ---- mid-mission states


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(TEAMS), st.integers(0, 30), st.floats(0.01, 0.99), st.booleans())
def test_the_rest_of_a_plan_ends_as_foreseen(team: tuple[int, int], seed: int, share: float, hover: bool) -> None:
    more = {"waiting": "hover", "service_s": 20.0} if hover else {}
    problem = preset("T15-P5", team, seed, uav=more, ugv={"idle_w": 50.0} if hover else {})
    plan = solve(problem, Stop(iterations=3_000), seed).plan
    if not plan.feasible:
        return
    now = share * plan.makespan_s
    later, rest = state_at(problem, plan.actions, now)
    follow = evaluate(later, rest)
    assert follow.feasible, follow.violation
    rows = zip(plan.actions, plan.schedule.actions, strict=True)
    left = [r.end_s - now for a, r in rows if isinstance(a, Visit) and r.arrive_s > now]
    assert follow.makespan_s == pytest.approx(max(left, default=0.0), abs=1e-6)
    gone = sum(g.energy_j for g in problem.ugvs) - sum(g.energy_j for g in later.ugvs)
    whole = plan.schedule.ugv_energy_j + plan.schedule.energy_given_j
    assert gone + follow.ugv_energy_j + follow.energy_given_j == pytest.approx(whole, rel=1e-9)


def test_on_a_real_map_vehicles_are_on_their_roads() -> None:
    one = DATA_SETS[2]
    land = terrain("rural")
    chosen = land.spread(5)
    sites, _ = land.roads_at(chosen)
    roads = land.network.with_sites(sites)
    moving = charging = 0
    for index in range(25):
        problem = one.instance(index)
        later, rest = midway(problem, index, roads)
        assert evaluate(later, rest).feasible
        assert all(0.0 <= u.ready_s <= 300.0 for u in later.uavs)
        charging += any(u.ready_s > 0 for u in later.uavs)
        for g in later.ugvs:
            if g.distance_to_m is not None:
                moving += 1
                assert g.position is not None and roads.offset_m(g.position) < 1e-3
                assert any(isinstance(a, Move) and a.ugv == later.ugvs.index(g) for a in rest)
        again, same = midway(problem, index, roads)
        assert again.digest == later.digest and same == rest
    assert moving > 5 and charging > 2


def test_a_charging_uav_holds_its_dock() -> None:
    problem = preset("T15-P5", (2, 1), 3)
    plan = solve(problem, Stop(iterations=5_000)).plan
    i = next(i for i, a in enumerate(plan.actions) if isinstance(a, Recharge))
    row, act = plan.schedule.actions[i], plan.actions[i]
    later, rest = state_at(problem, plan.actions, row.work_s + 100.0)
    assert act not in rest or rest.count(act) < plan.actions.count(act)
    uav = later.uavs[act.uav]
    assert uav.ready_s == pytest.approx(200.0) and uav.energy_j == pytest.approx(uav.capacity_j)
    assert max(later.ugvs[act.ugv].dock_ready_s) == pytest.approx(200.0)
