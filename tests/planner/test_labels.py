"""Labels: a rule for names and order, resumable chunks, both engines."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest
from reference import Reference

from planner import labels
from planner.errors import PlannerError
from planner.instances import data_set
from planner.labels import Expert, in_order, make, read
from planner.plan import Move, Recharge, Visit
from planner.schedule import evaluate
from planner.solve import Stop, solve

NAME = "T15-P5_4-2"
FAST = Expert(steps_t15=600, steps_t45=600)


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(labels, "CHUNK", 3)


def test_names_of_alike_vehicles_do_not_matter() -> None:
    """However the expert named UAVs and UGVs, and in whatever order it listed actions, the label is the same."""
    problem = data_set(NAME).instance(4)
    plan = solve(problem, Stop(iterations=20_000), 1).plan
    want = in_order(problem, plan.actions)
    assert evaluate(problem, want).makespan_s == pytest.approx(plan.makespan_s)
    for uavs in permutations(range(4)):
        for ugvs in permutations(range(2)):
            named = [
                Visit(uavs[a.uav], a.task) if isinstance(a, Visit)
                else Recharge(uavs[a.uav], ugvs[a.ugv]) if isinstance(a, Recharge)
                else Move(ugvs[a.ugv], a.path_point)
                for a in plan.actions
            ]  # fmt: skip
            assert in_order(problem, named) == want
    starts = [r.start_s for r in evaluate(problem, want).actions]
    assert starts == sorted(starts) or any(not isinstance(a, Visit) for a in want)


def test_chunks_can_be_read_and_resumed(tmp_path) -> None:
    made = list(make(tmp_path, [NAME], 6, FAST))
    assert [p.name for p in made] == ["000000.npz", "000003.npz"]
    found = list(read(tmp_path, NAME))
    assert [x.index for x in found] == list(range(6))
    for label in found:
        problem = data_set(NAME).instance(label.index)
        ref = Reference(problem, list(label.actions))
        assert ref.violation() is None and ref.makespan == pytest.approx(label.makespan_s)
        assert in_order(problem, label.actions) == label.actions
    assert [x.longer_s is not None for x in found] == [True, False, False] * 2
    made[0].unlink()
    assert list(make(tmp_path, [NAME], 6, FAST)) == [made[0]]
    assert [x.actions for x in read(tmp_path, NAME)] == [x.actions for x in found]  # the same on every run
    assert list(make(tmp_path, [NAME], 6, FAST)) == []


def test_labels_of_other_instances_are_refused(tmp_path) -> None:
    (path,) = make(tmp_path, [NAME], 1, FAST)
    with np.load(path) as file:
        data = dict(file)
    data["about"] = np.array('{"digest": "something else"}')
    np.savez_compressed(path, **data)
    with pytest.raises(PlannerError, match="these labels are of other instances"):
        list(read(tmp_path, NAME))


def test_unknown_engine(tmp_path) -> None:
    with pytest.raises(PlannerError, match="engine 'cloud' does not exist; there are local, ray"):
        list(make(tmp_path, [NAME], 3, FAST, engine="cloud"))


@pytest.mark.slow
def test_a_local_ray_cluster_makes_the_same(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    import ray  # noqa: PLC0415  (slow)

    monkeypatch.undo()  # the workers know nothing of it
    monkeypatch.setattr(labels, "CHUNK", labels.CHUNK)
    one = Expert(steps_t15=100, steps_t45=100, sample=50)
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    try:
        list(make(tmp_path / "ray", [NAME], 50, one, engine="ray"))
    finally:
        ray.shutdown()
    list(make(tmp_path / "local", [NAME], 50, one))
    there, here = (list(read(tmp_path / x, NAME)) for x in ("ray", "local"))
    assert len(there) == 50 and [x.actions for x in there] == [x.actions for x in here]
