"""Method ``copcs``: the policy's plan, search from it, and when search takes over."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from reference import Reference
from safetensors.numpy import save

from planner.copcs import UNSURE, Options, copcs, split
from planner.errors import PlannerError
from planner.instances import data_set
from planner.midway import midway
from planner.policy.batches import Pool
from planner.policy.config import PlusConfig
from planner.policy.domain import NAMES, Domain
from planner.policy.features_kernel import View
from planner.policy.shipped import shipped
from planner.policy.shipped.__main__ import ship
from planner.policy.weights import write
from planner.presets import preset
from planner.problem import Problem
from planner.schedule import evaluate
from planner.solve import Params, Stop, solve

SMALL = PlusConfig(dim=32, heads=4, layers=2, hidden=48)


def pools(seed: int, low: float = 0.0, high: float = 1.0) -> Pool:
    """Three decisions with 4 tasks, 3 sites, 2 UAVs and 1 UGV, of which some rows are padding."""
    rng = np.random.default_rng(seed)

    def some(*shape: int) -> np.ndarray:
        return rng.uniform(low, high, (3, *shape)).astype(np.float32)

    made = Pool(
        some(4, 17), some(3, 12), some(2, 25), some(1, 14), some(1, 3, 11), some(4, 3),
        np.array([[4, 3, 2, 1, 1], [3, 3, 1, 1, 0], [1, 3, 1, 1, 0]], np.int32), np.zeros(3, np.int32),
    )  # fmt: skip
    made.task[2, 1:] = 99.0  # padding
    return made


def view(pool: Pool, k: int) -> View:
    tasks = np.zeros(4, np.int32)
    return View(
        pool.task[k], pool.site[k], pool.uav[k], pool.ugv[k], pool.pair[k], pool.drive[k], tasks, pool.counts[k]
    )


def test_what_was_seen_is_inside_and_padding_was_not_seen() -> None:
    domain = Domain.of(pools(seed) for seed in range(20))
    assert all(domain.outside(view(pools(seed), k)) is None for seed in (0, 1, 99) for k in range(3))
    assert all(float(side[name].max()) <= 1.0 for side in (domain.least, domain.most) for name in NAMES)


@pytest.mark.parametrize("kind", list(NAMES))
@pytest.mark.parametrize("value", [-0.6, 1.6])
def test_what_was_not_seen_is_named(kind: str, value: float) -> None:
    domain = Domain.of(pools(seed) for seed in range(20))
    for k, name in enumerate(NAMES[kind]):
        other = pools(3)
        rows = getattr(other, kind)[0]
        rows.reshape(-1, rows.shape[-1])[1 if kind not in ("ugv",) else 0, k] = value
        found = domain.outside(view(other, 0))
        assert found is not None
        assert found.startswith(f"{kind}: {name} is {value:.2f}, trained on 0.")


def test_a_domain_is_read_as_it_was_written() -> None:
    domain = Domain.of([pools(0)])
    again = Domain.from_json(json.loads(json.dumps(domain.to_json())))
    for name in NAMES:
        assert np.allclose(again.least[name], domain.least[name], atol=1e-4)
        assert np.allclose(again.most[name], domain.most[name], atol=1e-4)
    with pytest.raises(PlannerError, match="no decisions"):
        Domain.of([])
    with pytest.raises(PlannerError, match="incomplete"):
        Domain.from_json({"task": [[0], [1]]})
    with pytest.raises(PlannerError, match=r"uav is \(2, 3\); it should be \(2, 25\)"):
        Domain.from_json({**domain.to_json(), "uav": [[0, 0, 0], [1, 1, 1]]})


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"decode": "magic"}, "option decode is 'magic'; choose one of greedy, sample, beam"),
        ({"polish": 1}, "option polish is 1; give true or false"),
        ({"look_ahead": "no"}, "option look_ahead is 'no'; give true or false"),
        ({"weights": 3}, "option weights is 3; give a file"),
        ({"magic": 1}, "method 'copcs' has no option 'magic'"),
        ({"hot": -1.0}, "option hot is -1.0; give a number above 0"),
    ],
)
def test_wrong_options(options: dict[str, object], message: str) -> None:
    with pytest.raises(PlannerError, match=message):
        solve(preset("T15-P5"), Stop(iterations=1), 0, Params("copcs", options=options))


def test_options_are_shared_out_with_search() -> None:
    mine, others, off = split({"decode": "beam", "exclude_uavs": {1}, "workers": 2})
    assert mine == Options(decode="beam")
    assert others == {"exclude_uavs": {1}, "workers": 2}
    assert (off.exclude_uavs, off.workers) == ({1}, 2)


@pytest.mark.parametrize(
    "damage", ["missing", "cut", "changed", "no weights", "no config", "bad config", "not a number"]
)
def test_search_takes_over_where_weights_cannot_be_read(tmp_path: Path, damage: str) -> None:
    file = tmp_path / "some.safetensors"
    if damage == "cut":
        file.write_bytes(b"\x10\x00\x00\x00\x00\x00\x00\x00{")
    elif damage == "changed":
        file.write_text("no weights at all, but a text of some length")
    elif damage == "no weights":
        file.mkdir()
    elif damage == "no config":
        file.write_bytes(save({"a": np.zeros(1, np.float32)}, {"format": "copcs-policy/1"}))
    elif damage == "bad config":
        more = {"format": "copcs-policy/1", "config": "[1]", "about": "{}"}
        file.write_bytes(save({"a": np.zeros(1, np.float32)}, more))
    elif damage == "not a number":
        write(file, SMALL, {"a": np.full(1, np.nan, np.float32)}, {})
    problem, stop = preset("T15-P5", (2, 1), 3), Stop(iterations=2_000)
    plan = solve(problem, stop, 5, Params("copcs", options={"weights": str(file)})).plan
    assert plan.actions == solve(problem, stop, 5).plan.actions
    assert plan.method == "copcs"
    assert plan.note is not None
    assert plan.note.startswith("search took over: ")
    assert str(file) in plan.note
    assert plan.to_json()["note"] == plan.note
    with pytest.raises(PlannerError, match="without polish has nothing to plan with"):
        solve(problem, stop, 5, Params("copcs", options={"weights": str(file), "polish": False}))


def test_weights_with_another_hash_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PlannerError, match=r"weights\.json: cannot be read"):
        shipped(tmp_path / "nowhere")
    (tmp_path / "weights.json").write_text(json.dumps({"file": "a.safetensors", "sha256": "0" * 64}))
    (tmp_path / "a.safetensors").write_bytes(b"something else")
    with pytest.raises(PlannerError, match=r"a\.safetensors: the weights are not the ones expected"):
        shipped(tmp_path)


def test_only_weights_that_tell_their_domain_are_shipped(tmp_path: Path) -> None:
    with pytest.raises(PlannerError, match="does not say what the network was trained on"):
        ship(weights_file(tmp_path), tmp_path)
    path = weights_file(tmp_path, 2.0, Domain.of([pools(0)]))
    ship(path, tmp_path)
    assert shipped(tmp_path).domain is not None
    assert json.loads((tmp_path / "weights.json").read_text())["network"]["dim"] == SMALL.dim
    (tmp_path / "plus.safetensors").write_bytes(path.read_bytes()[:-1])
    shipped.cache_clear()
    with pytest.raises(PlannerError, match="hash differs"):
        shipped(tmp_path)


def weights_file(folder: Path, scale: float = 1.0, domain: Domain | None = None) -> Path:
    """Weights that were never trained; ``scale`` makes them surer of what they know nothing of."""
    torch = pytest.importorskip("torch")
    from planner.policy.plus_net import PlusNet  # noqa: PLC0415  (imports torch)

    torch.manual_seed(0)
    tensors = {k: v.detach().numpy() for k, v in PlusNet(SMALL).state_dict().items()}
    tensors["score.weight"] = tensors["score.weight"] * scale
    path = folder / f"w{scale:g}.safetensors"
    write(path, SMALL, tensors, {} if domain is None else {"domain": domain.to_json()})
    return path


SURE = 300.0


@pytest.mark.slow
def test_search_goes_on_from_the_policys_plan(tmp_path: Path) -> None:
    file = str(weights_file(tmp_path, SURE))
    problem = preset("T15-P5", (2, 1), 2)
    bare = solve(problem, Stop(iterations=0), 0, Params("copcs", options={"weights": file, "polish": False})).plan
    assert bare.feasible
    assert bare.note is None
    more = solve(problem, Stop(iterations=2_000), 0, Params("copcs", options={"weights": file})).plan
    assert more.feasible
    assert more.note is None
    assert more.makespan_s < bare.makespan_s
    for decode in ("sample", "beam"):
        options = {"weights": file, "polish": False, "decode": decode}
        best = solve(problem, Stop(iterations=0), 0, Params("copcs", options=options)).plan
        assert best.feasible
        assert best.makespan_s <= bare.makespan_s


@pytest.mark.slow
@pytest.mark.parametrize("decode", ["greedy", "sample", "beam"])
@pytest.mark.parametrize("name", ["T15-P5_1-1", "T15-P5_4-2", "T45-P10_2-2", "T15-P5_2-1_urban"])
def test_its_plans_are_right_by_the_independent_validator(tmp_path: Path, name: str, decode: str) -> None:
    options = {"weights": str(weights_file(tmp_path, SURE)), "polish": False, "decode": decode}
    problem = data_set(name).instance(801)
    plan = solve(problem, Stop(time_s=0.5), 0, Params("copcs", options=options)).plan
    reference = Reference(problem, list(plan.actions))
    assert reference.violation() is None
    assert reference.makespan == pytest.approx(plan.makespan_s, rel=1e-9)


@pytest.mark.slow
def test_search_takes_over_where_the_policy_is_unsure(tmp_path: Path) -> None:
    problem, stop = preset("T15-P5", (2, 1), 3), Stop(iterations=2_000)
    plan = solve(problem, stop, 5, Params("copcs", options={"weights": str(weights_file(tmp_path, 1e-3))})).plan
    assert plan.note is not None
    assert plan.note.startswith("search took over: the network is unsure of its plan")
    told = float(plan.note.partition("(")[2].partition("%")[0])
    assert told < 100 * UNSURE
    assert plan.actions == solve(problem, stop, 5).plan.actions


@pytest.mark.slow
def test_search_takes_over_where_the_problem_is_unlike_the_training_data(tmp_path: Path) -> None:
    file = str(weights_file(tmp_path, SURE, Domain.of([pools(0)])))
    problem, stop = preset("T15-P5", (2, 1), 2), Stop(iterations=2_000)
    plan = solve(problem, stop, 5, Params("copcs", options={"weights": file})).plan
    assert plan.note is not None
    assert plan.note.startswith("search took over: the network was trained on other problems (")
    assert plan.actions == solve(problem, stop, 5).plan.actions
    bare = solve(problem, stop, 5, Params("copcs", options={"weights": file, "polish": False})).plan
    assert bare.feasible
    assert bare.note is not None
    assert bare.note.startswith("the network was trained on other problems (")


@pytest.mark.slow
def test_a_better_plan_to_start_from_is_kept(tmp_path: Path) -> None:
    file = str(weights_file(tmp_path, SURE))
    problem = midway(data_set("T15-P5_2-2").instance(7), 1)[0]
    good = solve(problem, Stop(iterations=20_000), 0).plan
    again = solve(problem, Stop(iterations=0), 0, Params("copcs", good.actions, {"weights": file})).plan
    assert again.makespan_s <= good.makespan_s + 1e-6
    assert again.feasible


@pytest.mark.slow
def test_excluded_vehicles_get_nothing_to_do(tmp_path: Path) -> None:
    options = {"weights": str(weights_file(tmp_path, SURE)), "exclude_uavs": {0}, "exclude_ugvs": {1}}
    problem: Problem = preset("T15-P5", (2, 2), 4)
    for polish in (False, True):
        plan = copcs(problem, Stop(iterations=500), 0, Params("copcs", None, {**options, "polish": polish})).plan
        assert plan.feasible
        assert evaluate(problem, plan.actions, exclude_uavs={0}, exclude_ugvs={1}).feasible
        assert all(getattr(a, "uav", 1) == 1 and getattr(a, "ugv", 0) == 0 for a in plan.actions)
