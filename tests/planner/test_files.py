"""Problem and plan files: round trips, defaults, and one clear message for every mistake."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import action_lists, problems

from planner.errors import PlannerError
from planner.plan import Move, Plan, Recharge, Visit, actions_from_json, actions_to_json, read_actions
from planner.presets import preset
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate
from planner.solve import Stop, solve


@settings(max_examples=60, deadline=None)
@given(problems())
def test_problem_round_trip(problem: Problem) -> None:
    text = json.dumps(problem.to_json(), allow_nan=False)
    again = Problem.from_json(json.loads(text))
    assert again.to_json() == problem.to_json()
    assert again.digest == problem.digest
    assert again.uavs == problem.uavs and again.ugvs == problem.ugvs
    np.testing.assert_array_equal(again.road_distance_m, problem.road_distance_m)


@settings(max_examples=60, deadline=None)
@given(problems().flatmap(lambda p: st.tuples(st.just(p), action_lists(p))))
def test_plan_round_trip(case) -> None:
    problem, actions = case
    plan = Plan(tuple(actions), evaluate(problem, actions), "test")
    data = json.loads(json.dumps(plan.to_json(), allow_nan=False))
    assert actions_from_json(data["actions"]) == tuple(actions)
    assert data["planning_s"] is None and data["lower_bound_s"] is None
    assert data["feasible"] == plan.feasible
    assert len(data["schedule"]) == len(actions)
    for row in data["schedule"]:
        assert row["slack_s"] is None or math.isfinite(row["slack_s"])


def test_files_on_disk(tmp_path: Path) -> None:
    problem = preset("T15-P5")
    (tmp_path / "problem.json").write_text(json.dumps(problem.to_json()))
    again = Problem.read(tmp_path / "problem.json")
    plan = solve(again, Stop(iterations=2_000)).plan
    (tmp_path / "plan.json").write_text(json.dumps(plan.to_json()))
    assert read_actions(tmp_path / "plan.json") == plan.actions
    assert Plan(plan.actions, plan.schedule, "x").digest == plan.digest


def small() -> dict:
    return {
        "format": "copcs-problem/1",
        "depot": [0, 0],
        "tasks": [[1, 2]],
        "path_points": [[3, 4]],
        "road_distance_m": [[0, 5], [5, 0]],
        "uavs": [{"position": [0, 0]}],
        "ugvs": [{"path_point": None}],
    }


def test_optional_members_take_the_defaults() -> None:
    problem = Problem.from_json(small())
    assert problem.uavs == (Uav("uav0", (0.0, 0.0)),)
    assert problem.ugvs == (Ugv("ugv0"),)
    assert problem.visited.tolist() == [False]
    assert (problem.n_tasks, problem.depot_index, problem.sites.tolist()) == (1, 1, [[3, 4], [0, 0]])
    data = small()
    data["ugvs"] = [{"charge_w": 900.0}]
    assert Problem.from_json(data).ugvs[0].charge_s is None


def put(path: str, value: object) -> dict:
    data = small()
    *way, last = path.split(".")
    at: object = data
    for key in way:
        at = at[int(key)] if key.isdigit() else at[key]  # type: ignore[index]
    at[int(last) if last.isdigit() else last] = value  # type: ignore[index]
    return data


MISTAKES = [
    (put("format", "copcs-problem/2"), "format is 'copcs-problem/2'"),
    (put("extra", 1), r"unknown members \['extra'\]"),
    ({k: v for k, v in small().items() if k != "tasks"}, "member 'tasks' is missing"),
    (put("depot", [1]), "wrong type"),
    (put("depot", [math.nan, 0]), "depot"),
    (put("tasks", [[1, 2, 3]]), "wrong shape|tasks"),
    (put("tasks", [["a", 2]]), "wrong shape"),
    (put("tasks", [[math.inf, 2]]), "tasks: every coordinate must be finite"),
    (put("path_points", [[math.nan, 2]]), "path_points: every coordinate must be finite"),
    (put("road_distance_m", [[0]]), r"road_distance_m has shape \(1, 1\); give \(2, 2\)"),
    (put("road_distance_m", [[0, 5], [6, 0]]), "not symmetric"),
    (put("road_distance_m", [[0, -5], [-5, 0]]), "negative"),
    (put("road_distance_m", [[1, 5], [5, 0]]), "diagonal"),
    (put("road_distance_m", [[0, math.nan], [math.nan, 0]]), "not-a-number"),
    (put("visited", [True, True]), "visited has 2 entries for 1 tasks"),
    (put("uavs", []), "uavs is empty"),
    (put("uavs", [3]), r"uavs\[0\] is not an object"),
    (put("uavs", [{"id": "a", "position": [0, 0]}] * 2), r"vehicle ids are not unique: \['a'"),
    (put("uavs.0.position", [1]), "position is"),
    (put("uavs.0.position", "here"), "wrong type"),
    (put("uavs.0.speed", 1), r"uavs\[0\]: unknown members \['speed'\]"),
    (put("uavs", [{"id": "a"}]), r"uavs\[0\]: position is missing"),
    (put("uavs.0.speed_mps", 0), "speed_mps is 0; give a number above 0"),
    (put("uavs.0.energy_j", -1), "energy_j is -1; give a number of at least 0"),
    (put("uavs.0.energy_j", math.nan), "energy_j is nan; give a finite number"),
    (put("uavs.0.cruise_w", "much"), "cruise_w is 'much'; give a finite number"),
    (put("uavs.0.waiting", "asleep"), "waiting is 'asleep'; give landed or hover"),
    (put("ugvs.0.docks", 0), "docks is 0; give at least 1"),
    (put("ugvs.0.docks", 1.5), "docks is 1.5; give at least 1"),
    (put("ugvs", [{"dock_ready_s": [1, 2, 3]}]), "dock_ready_s has more values than docks"),
    (put("ugvs", [{"charge_s": 300, "charge_w": 100}]), "give either charge_s or charge_w"),
    (put("ugvs.0.path_point", 7), "path_point 7 does not exist; there are 1"),
    (put("ugvs.0.distance_to_m", [1]), "distance_to_m needs 2 values"),
    (put("ugvs.0.distance_to_m", [1, -1]), "negative value"),
]


@pytest.mark.parametrize(("data", "words"), MISTAKES)
def test_every_mistake_is_named(data: dict, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        Problem.from_json(data)


@pytest.mark.parametrize(
    ("text", "words"),
    [("{", "not a JSON file"), ("[]", "one JSON object"), ("[" * 100_000, "not a JSON file"), ("\xff", "problem.json")],
)
def test_problem_files_that_cannot_be_read(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "problem.json"
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(PlannerError, match=words):
        Problem.read(path)
    with pytest.raises(PlannerError, match=r"missing\.json: No such file"):
        Problem.read(tmp_path / "missing.json")


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("visit", "actions is not a list"),
        ([3], r"actions\[0\] is 3; kind must be one of"),
        ([{"kind": "fly"}], "kind must be one of"),
        ([{"kind": "visit", "uav": 0}], r"actions\[0\]: task is None"),
        ([{"kind": "visit", "uav": -1, "task": 0}], "uav is -1; give a whole number of at least 0"),
        ([{"kind": "visit", "uav": True, "task": 0}], "uav is True"),
        ([{"kind": "move", "ugv": 0}], "path_point is None"),
        ([{"kind": "recharge", "uav": 0, "ugv": 0, "task": 1}], r"unknown members \['task'\]"),
    ],
)
def test_wrong_actions_are_named(rows: object, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        actions_from_json(rows)  # type: ignore[arg-type]


def test_actions_round_trip() -> None:
    actions = (Move(0, None), Move(1, 2), Visit(0, 3), Recharge(0, 1))
    assert actions_from_json(actions_to_json(actions)) == actions


@pytest.mark.parametrize(
    ("text", "words"), [("{", "not a JSON file"), ("[]", "format is not"), ('{"format": "x"}', "format is not")]
)
def test_plan_files_that_cannot_be_read(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "plan.json"
    path.write_text(text)
    with pytest.raises(PlannerError, match=words):
        read_actions(path)
    with pytest.raises(PlannerError, match="No such file"):
        read_actions(tmp_path / "missing.json")
