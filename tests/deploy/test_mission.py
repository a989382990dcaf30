"""Loading: merging, defaults, frames, copies, the shipped missions."""

from __future__ import annotations

import json
import math
import re
import time
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
import shapely
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mission_files import FLEET, MISSION, changed, write

from deploy.errors import InputError
from deploy.mission import Mission, load, schema
from deploy.mission_copy import save_copy
from deploy.mission_reference import PAGE, page
from deploy.mission_schema import FOLDER, fleet_schema, texts
from deploy.mission_slots import best_turn, make_slots
from deploy.yaml_file import read_yaml

SHIPPED = sorted(FOLDER.glob("*.yaml"))


@pytest.fixture(scope="module", params=SHIPPED, ids=lambda path: path.stem)
def shipped(request: pytest.FixtureRequest) -> Mission:
    return load(request.param)


def test_three_missions_are_shipped() -> None:
    assert {path.stem for path in SHIPPED} >= {"demo", "lab", "field"}


def test_shipped_missions_have_room_for_everybody(shipped: Mission) -> None:
    s = shipped.settings
    fence = shapely.Polygon(s.geofence.polygon_m).buffer(-s.geofence.soft_margin_m + 1e-6)
    for site in shipped.problem.sites:
        x, y = s.frame.to_arena((float(site[0]), float(site[1])))
        for dx, dy in [u.pad_offset_m for u in s.uavs] + [g.park_offset_m for g in s.ugvs]:
            assert shapely.covers(fence, shapely.Point(x + dx, y + dy))
    for task in shipped.problem.tasks:
        assert shapely.covers(fence, shapely.Point(s.frame.to_arena((float(task[0]), float(task[1])))))
    for u in s.uavs:
        assert u.altitude_m <= s.geofence.ceiling_m - s.geofence.soft_margin_m
        assert u.speed_mps <= u.max_speed_mps


def test_shipped_missions_keep_their_places_apart(shipped: Mission) -> None:
    s = shipped.settings
    least = s.separation.horizontal_m + s.separation.buffer_m
    for a, b in combinations(s.uavs, 2):
        assert math.dist(a.pad_offset_m, b.pad_offset_m) >= least - 1e-3
    for g, h in combinations(s.ugvs, 2):
        assert math.dist(g.park_offset_m, h.park_offset_m) >= s.separation.ugv_m - 1e-3
    for u in s.uavs:
        for g in s.ugvs:
            radius = max(math.hypot(*dock) for dock in g.dock_offsets_m)
            assert math.dist(u.pad_offset_m, g.park_offset_m) >= least + radius - 1e-3


def test_shipped_missions_agree_with_the_roads(shipped: Mission) -> None:
    problem, roads = shipped.problem, shipped.roads
    assert np.isfinite(problem.road_distance_m).all()
    np.testing.assert_allclose(roads.sites, problem.sites)
    for i, site in enumerate(problem.sites):
        here = (float(site[0]), float(site[1]))
        np.testing.assert_allclose(roads.distances_from(here), problem.road_distance_m[i], rtol=1e-6, atol=1e-3)


def test_a_copy_is_the_same_mission(shipped: Mission, tmp_path: Path) -> None:
    again = load(save_copy(shipped, tmp_path / "run" / "mission"))
    assert again.problem.digest == shipped.problem.digest
    assert again.digest == shipped.digest
    assert replace(again.settings, problem=None, roads=None) == replace(shipped.settings, problem=None, roads=None)  # type: ignore[arg-type]
    assert {path.parent for path in again.files} == {tmp_path / "run" / "mission"}


def test_a_copy_keeps_overrides_and_what_was_read(tmp_path: Path) -> None:
    path = write(tmp_path, mission=changed(MISSION, "name", "1e3"))
    mission = load(path, {"seed": 9, "planner.iterations": 5, "arena.scale": 1e-05 * 1e5})
    path.write_text("broken: [")
    again = load(save_copy(mission, tmp_path / "copy"))
    assert (again.name, again.seed, again.planner.iterations, again.planner.seed) == ("1e3", 9, 5, 9)
    assert again.digest == mission.digest


def test_a_copy_that_cannot_be_written_says_so(tmp_path: Path) -> None:
    mission = load(write(tmp_path))
    with pytest.raises(InputError, match="another folder"):
        save_copy(mission, tmp_path / "mission.yaml" / "x")


def test_the_demo_loads_quickly() -> None:
    begun = time.perf_counter()
    load(FOLDER / "demo.yaml")
    assert time.perf_counter() - begun < 3.0  # 0.6 s on an idle machine


def test_the_demo_is_of_the_papers_scale() -> None:
    mission = load(FOLDER / "demo.yaml")
    problem = mission.problem
    assert (len(problem.uavs), len(problem.ugvs), problem.n_tasks) == (2, 2, 15)
    assert mission.geometry.bounds == (0, 0, 10_000, 10_000)
    away = np.hypot(*(problem.tasks[:, None] - problem.sites[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.max() <= 6500
    assert [fault.kind for fault in mission.faults] == ["ugv_stall"]


def test_the_lab_flies_at_walking_pace() -> None:
    settings_ = load(FOLDER / "lab.yaml").settings
    assert all(0.3 <= u.speed_mps <= 0.5 for u in settings_.uavs)
    assert [u.altitude_m for u in settings_.uavs] == [0.6, 1.2]
    assert all(u.energy == "virtual" for u in settings_.uavs)


def test_values_go_vehicle_then_type_then_all(tmp_path: Path) -> None:
    fleet: dict[str, Any] = {
        "all": {"speed_mps": 7, "accel_mps2": 2, "docks": 1},
        "types": {"q": {"kind": "uav", "speed_mps": 8}, "r": {"kind": "ugv", "speed_mps": 3}},
        "vehicles": {"a": {"type": "q"}, "b": {"type": "q", "speed_mps": 9}, "c": {"type": "r"}},
    }
    mission = load(write(tmp_path, fleet=fleet))
    assert [u.speed_mps for u in mission.problem.uavs] == [8, 9]
    assert [g.speed_mps for g in mission.problem.ugvs] == [3]
    assert mission.problem.ugvs[0].docks == 1
    assert {u.accel_mps2 for u in mission.settings.uavs} == {2}


def test_the_fleet_may_stand_in_the_mission(tmp_path: Path) -> None:
    inline = load(write(tmp_path, mission=changed(MISSION, "fleet", FLEET)))
    assert inline.digest == load(write(tmp_path)).digest
    assert [v.id for v in inline.fleet] == ["uav0", "uav1", "ugv0"]
    assert (inline.fleet[0].driver, inline.fleet[0].sysid) == ("mavlink", 1)


def test_take_off_takes_time_and_energy(tmp_path: Path) -> None:
    mission = load(write(tmp_path), {"arena.time_scale": 0.5, "fleet.file": "fleet.yaml"})
    uav, flown = mission.problem.uavs[0], mission.settings.uavs[0]
    climb_s = flown.altitude_m / flown.climb_mps + flown.climb_mps / flown.accel_mps2
    assert uav.ready_s == pytest.approx(climb_s / 0.5)
    assert uav.energy_j == pytest.approx(uav.capacity_j - uav.ready_s * uav.hover_w)
    assert uav.reserve_j == pytest.approx(0.15 * uav.capacity_j)
    assert uav.waiting == "hover"


def test_docking_times_follow_from_the_vehicles(tmp_path: Path) -> None:
    mission = load(write(tmp_path))
    ugv, high = mission.problem.ugvs[0], mission.settings.uavs[1]
    height = high.altitude_m - mission.settings.ugvs[0].pad_height_m
    assert ugv.undock_s == pytest.approx(height / 3 + 3 / 2.5, abs=1e-3)
    assert ugv.dock_s == pytest.approx(10 / 2.5 + height / 2 + 2 / 2.5, abs=1e-3)
    given = load(write(tmp_path, fleet=changed(FLEET, "types.rover.dock_s", 0)))
    assert given.problem.ugvs[0].dock_s == 0


def test_layers_are_shared_where_the_ceiling_is_low(tmp_path: Path) -> None:
    base = changed(MISSION, "arena.ceiling_m", 46)
    mission = load(write(tmp_path, mission=base, fleet=changed(FLEET, "vehicles.uav2", {"type": "quad"})))
    assert [u.altitude_m for u in mission.settings.uavs] == [30, 35, 30]


def test_scale_rotation_and_time(tmp_path: Path) -> None:
    overrides = {
        "arena.scale": 0.1,
        "arena.rotation_deg": 90.0,
        "arena.origin_m": [5.0, 6.0],
        "arena.time_scale": 0.2,
        "arena.soft_margin_m": 1.0,
    }
    mission = load(write(tmp_path), overrides)
    assert mission.settings.frame.to_arena((10.0, 0.0)) == pytest.approx((5.0, 7.0))
    assert mission.settings.uavs[0].speed_mps == pytest.approx(10 * 0.1 / 0.2)
    assert shapely.Polygon(mission.settings.geofence.polygon_m).bounds == pytest.approx((-75, 6, 5, 106))


def test_points_from_files(tmp_path: Path) -> None:
    from_csv = load(write(tmp_path, mission=changed(MISSION, "tasks", {"file": "points.csv"})))
    assert from_csv.task_names == ("a", "b")
    assert from_csv.problem.tasks.tolist() == [[300, 300], [700, 300]]
    feature = {"type": "Feature", "id": "x", "properties": {}, "geometry": {"type": "Point", "coordinates": [300, 100]}}
    points = {"type": "FeatureCollection", "features": [feature]}
    path = write(tmp_path, mission=changed(MISSION, "path_points", {"file": "points.geojson"}), points=points)
    assert load(path).problem.path_points.tolist() == [[300, 100]]


def test_random_tasks_and_placed_points_repeat(tmp_path: Path) -> None:
    base = {**MISSION, "tasks": {"random": {"count": 9}, "max_distance_m": 300}, "path_points": {"place": 3}}
    first, again, other = (load(write(tmp_path, mission=base), {"seed": seed}) for seed in (1, 1, 2))
    assert first.problem.digest == again.problem.digest
    assert first.problem.tasks.tolist() != other.problem.tasks.tolist()
    assert first.problem.path_points.tolist() == other.problem.path_points.tolist()
    away = np.hypot(*(first.problem.tasks[:, None] - first.problem.sites[None]).transpose(2, 0, 1)).min(axis=1)
    assert away.max() <= 300


def test_failsafe_and_faults_pass_through(tmp_path: Path) -> None:
    base = changed(MISSION, "failsafe", {"pose_stale": "hold", "link_lost/air": "hold"})
    base = changed(base, "faults", [{"kind": "ugv_stall", "vehicle": "ugv0", "at_s": 5, "duration_s": 60}])
    mission = load(write(tmp_path, mission=changed(base, "random_faults", {"count": 2, "seed": 3})))
    assert mission.settings.failsafe == {"pose_stale": "hold", "link_lost/air": "hold"}
    assert mission.faults[0].duration_s == 60
    assert mission.random_faults is not None
    assert mission.random_faults.count == 2


@pytest.mark.parametrize(("n_uavs", "n_ugvs"), [(1, 0), (1, 1), (2, 2), (3, 4), (8, 5), (20, 20)])
def test_slots_are_apart(n_uavs: int, n_ugvs: int) -> None:
    slots = make_slots(n_uavs, [((-0.5, 0.0), (0.5, 0.0))] * n_ugvs, 4.0, 2.0)
    for a, b in combinations(slots.pads, 2):
        assert math.dist(a, b) >= 4 - 1e-3
    for a, b in combinations(slots.parks, 2):
        assert math.dist(a, b) >= 5 - 1e-3
    for a in slots.pads:
        assert all(math.dist(a, b) >= 4.5 - 1e-3 for b in slots.parks)
        assert math.hypot(*a) <= slots.reach_m


def test_slots_turn_to_where_there_is_road() -> None:
    slots = make_slots(2, [((0.0, 0.0),)] * 2, 4.0, 2.0)
    turned = best_turn(slots, lambda offset: abs(offset[0]))  # the road runs along y
    assert max(abs(x) for x, _ in turned.parks) < 1e-6


def test_schema_files_are_current() -> None:
    for name, text in texts().items():
        hint = "run: python -m deploy.mission_schema"
        assert (FOLDER / name).read_text(encoding="utf-8") == text, hint


def test_the_documented_keys_are_current() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert page(text) == text, "run: python -m deploy.mission_schema"


@pytest.mark.parametrize("block", re.findall(r"```yaml\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL))
def test_examples_in_the_docs_load(block: str, tmp_path: Path) -> None:
    if block.startswith("version"):
        base = block
        for name in ("maps/rural.geojson", "fleets/demo.yaml"):
            base = base.replace(name, str(FOLDER / name))
        (tmp_path / "mission.yaml").write_text(base, encoding="utf-8")
        assert load(tmp_path / "mission.yaml").problem.n_tasks == 15
    else:
        assert len(load(write(tmp_path, fleet=block)).fleet) == 2


def test_schemas_accept_what_is_shipped_and_refuse_typos() -> None:
    jsonschema.Draft202012Validator.check_schema(schema())
    for path in SHIPPED:
        data = read_yaml(path, "mission").data
        jsonschema.validate(data, schema())
        jsonschema.validate(read_yaml(FOLDER / data["fleet"]["file"], "fleet").data, fleet_schema())
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate({**data, "tsks": 1}, schema())


JUNK = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=8),
    st.lists(st.integers(-3, 3), max_size=3),
    st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    st.sampled_from([0, -1, 1e-300, 1e300, 2**70, "1e3", "../demo.yaml", ".", "\0", [[0, 0], [1, 1], [2, 2]]]),
)


def leaves(data: Any, at: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    found = [at] if at else []
    pairs = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in pairs:
        found += leaves(value, (*at, str(key)))
    return found


DEMO = read_yaml(FOLDER / "demo.yaml", "mission").data
DEMO_FLEET = read_yaml(FOLDER / "fleets" / "demo.yaml", "fleet").data


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
@given(
    changes=st.lists(st.tuples(st.sampled_from(leaves(DEMO)), JUNK), max_size=2),
    fleet_changes=st.lists(st.tuples(st.sampled_from(leaves(DEMO_FLEET)), JUNK), max_size=2),
)
def test_nothing_but_input_errors_escapes(
    changes: list[tuple[tuple[str, ...], Any]], fleet_changes: list[tuple[tuple[str, ...], Any]], tmp_path: Path
) -> None:
    # The small map's roads: the demo's own would only make this slow.
    base = changed(DEMO, "map.file", "roads.geojson")
    base = changed(changed(base, "depot", [500.0, 100.0]), "path_points.place", 2)
    base, fleet = changed(base, "fleet.file", "fleet.yaml"), DEMO_FLEET
    try:
        for key, value in changes:
            base = changed(base, ".".join(key), value)
        for key, value in fleet_changes:
            fleet = changed(fleet, ".".join(key), value)
        path = write(tmp_path, mission=base, fleet=fleet)
    except (AttributeError, TypeError, KeyError, IndexError, ValueError):
        return  # the second change reached into what the first had removed
    try:
        mission = load(path)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        json.dumps(mission.problem.to_json())


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True
)
@given(raw=st.one_of(st.binary(max_size=60), st.text("ab:-[]{}&*!?|>'\"#,\n 1.~", max_size=60).map(str.encode)))
def test_any_bytes_are_read_or_refused(raw: bytes, tmp_path: Path) -> None:
    (tmp_path / "mission.yaml").write_bytes(raw)
    with pytest.raises(InputError):
        load(tmp_path / "mission.yaml")
