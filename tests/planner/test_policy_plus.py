"""Network ``plus``: the same numbers with and without torch, what it may be fed, and what it decodes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from strategies import problems

from planner import kernel
from planner.arrays import decode
from planner.errors import PlannerError
from planner.instances import data_set
from planner.labels import Expert, make
from planner.midway import midway
from planner.plan import Visit
from planner.policy import decode_kernel as dk
from planner.policy import improve
from planner.policy import tokens_kernel as tk
from planner.policy.batches import batches, pool
from planner.policy.config import PlusConfig
from planner.policy.decode import Policy, _Seat
from planner.policy.examples import Example, Source, example, load, save
from planner.policy.features_kernel import fill_view
from planner.policy.improve import improved
from planner.policy.order import in_turns
from planner.policy.plus_kernel import logits
from planner.policy.plus_net import FORBIDDEN, Batch, PlusNet
from planner.policy.state import SYMMETRIES, new_state
from planner.policy.train import Trainer, hits, loss_of, prepare, to_tensors
from planner.policy.training import Training
from planner.policy.weights import plus_weights, read, room, write
from planner.presets import preset
from planner.problem import Problem
from planner.schedule import evaluate
from planner.solve import Stop, solve

# Half a minute of compiling: not in the default suite.
pytestmark = pytest.mark.slow

SMALL = PlusConfig(dim=32, heads=4, layers=2, hidden=48)


def network(config: PlusConfig = SMALL, seed: int = 0) -> tuple[PlusNet, dict[str, np.ndarray]]:
    torch.manual_seed(seed)
    net = PlusNet(config).eval()
    return net, {k: v.detach().numpy() for k, v in net.state_dict().items()}


@pytest.fixture(scope="module")
def policy() -> Policy:
    config, tensors = SMALL, network()[1]
    return Policy(config, tensors)


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    made = []
    for name in ("T15-P5_2-1", "T15-P5_4-2", "T45-P10_2-2_drawn"):
        for index in range(2):
            problem = data_set(name).instance(index)
            plan = solve(problem, Stop(iterations=5_000), index).plan
            made.append(example(problem, plan.actions))
            made.append(example(*midway(problem, index)))
    return made


@pytest.mark.parametrize("config", [SMALL, replace(SMALL, uav_edges=False), replace(SMALL, ugv_edges=False)])
def test_the_same_logits_with_and_without_torch(config: PlusConfig) -> None:
    net, tensors = network(config)
    weights = plus_weights(config, tensors)
    rng = np.random.default_rng(0)
    for setup, team in (("T15-P5", (1, 1)), ("T15-P5", (3, 2)), ("T45-P10", (6, 3))):
        problem = midway(preset(setup, team, 1), 3)[0]
        s = new_state(problem)
        n_tasks, n_sites = len(s.world.visited), s.world.road.shape[1]
        n_ugvs = len(s.world.ugvs)
        desk = room(config, n_tasks + n_sites + len(s.world.uavs) + n_ugvs)
        visit, meet, done = np.zeros(n_tasks, "f"), np.zeros((n_ugvs, n_sites), "f"), np.zeros(1, "f")
        tk.start(s.world, s.work, s.turn)
        while s.work.sums[kernel.S_LEFT] > 0:
            u = tk.acting(s.work, s.turn)
            tk.offer(s.world, s.work, s.turn, u)
            fill_view(s.world, s.work, s.turn, u, s.xy, s.reach, s.view)
            logits(weights, desk, s.view, visit, meet, done)
            left, active = int(s.view.counts[0]), int(s.view.counts[2])
            v = s.view
            parts = (v.task[:left], v.site, v.uav[:active], v.ugv, v.pair, v.drive, v.counts)
            with torch.inference_mode():
                expected = net(Batch(*(torch.from_numpy(x[None].copy()) for x in parts))).numpy()[0]
            mine = np.r_[visit[:left], meet.ravel(), done]
            offered = expected > -1e8
            assert (offered == (mine > -1e8)).all()
            if not offered.any():
                break
            assert np.abs(mine - expected)[offered].max() < 1e-4
            option = int(rng.choice(np.flatnonzero(offered)))
            if option == len(mine) - 1:
                s.turn.done[u] = 1
                continue
            real = int(v.tasks[option]) if option < left else n_tasks + option - left
            tk.apply(s.world, s.work, s.turn, tk.code_of(u, real, n_tasks, n_sites))


def test_padding_changes_nothing(examples: list[Example]) -> None:
    net, _ = network()
    every = pool(examples, [0] * len(examples))
    together, option = to_tensors(every, torch.device("cpu"))
    with torch.inference_mode():
        whole = net(together).log_softmax(-1).gather(1, option[:, :1])[:, 0]
        for row in range(0, len(option), 7):
            one, choice = to_tensors(every.take(np.array([row], np.int32)), torch.device("cpu"))
            alone = net(one).log_softmax(-1)[0, choice[0, 0]]
            assert abs(float(alone - whole[row])) < 1e-4
    assert float(whole.min()) > -1e6  # nothing the expert does is masked out


def test_order_of_vehicles_and_place_of_the_map_do_not_matter(policy: Policy) -> None:
    problem = preset("T15-P5", (3, 2), 5)
    moved = replace(
        problem,
        depot=(problem.depot[0] + 4e4, problem.depot[1]),
        tasks=problem.tasks + np.array([4e4, 0.0]),
        path_points=problem.path_points + np.array([4e4, 0.0]),
        uavs=tuple(replace(u, position=(u.position[0] + 4e4, u.position[1])) for u in problem.uavs),
    )
    assert policy.greedy(problem).makespan_s == pytest.approx(policy.greedy(moved).makespan_s, rel=1e-6)


@pytest.mark.parametrize("team", [(1, 1), (2, 1), (4, 2), (6, 3)])
def test_whatever_the_weights_plans_are_feasible(policy: Policy, team: tuple[int, int]) -> None:
    for seed in range(2):
        problem = preset("T15-P5", team, seed)
        for one in (problem, midway(problem, seed)[0]):
            found = policy.greedy(one)
            schedule = evaluate(one, found.actions(one))
            assert found.certain
            assert schedule.violation is None
            assert schedule.makespan_s == pytest.approx(found.makespan_s)


def test_looking_ahead_never_makes_a_plan_worse(policy: Policy) -> None:
    better = 0
    for seed in range(6):
        problem = preset("T15-P5", (2, 2), seed)
        found, bare = policy.greedy(problem), policy.alone().greedy(problem)
        assert (found.decisions, found.chosen, found.log_p) == (bare.decisions, bare.chosen, bare.log_p)  # the same way
        assert found.cost <= bare.cost
        better += found.cost < bare.cost
        assert evaluate(problem, bare.actions(problem)).violation is None
    assert better >= 3


def test_sampling_and_beam_find_better_plans(policy: Policy) -> None:
    problem = preset("T15-P5", (2, 1), 3)
    one = policy.greedy(problem)
    several = policy.sample(problem, 24, seed=1)
    assert several.cost <= policy.greedy(problem, symmetries=8).cost <= one.cost
    again = policy.sample(problem, 24, seed=1, threads=2)
    assert (several.codes == again.codes).all()
    searched = policy.beam(problem, 2, 3)
    assert searched.cost <= one.cost
    for found in (several, searched):
        assert evaluate(problem, found.actions(problem)).violation is None


@pytest.mark.parametrize("look_ahead", [True, False])
def test_greedy_from_the_middle_is_greedy_to_the_end(policy: Policy, look_ahead: bool) -> None:
    """What a beam relies on, where it takes a greedy end as known."""
    problem = preset("T15-P5", (2, 1), 3)
    seat = _Seat(policy if look_ahead else policy.alone(), problem, ((), ()))
    xy = seat.turned(0)
    seat.begin()
    seat.run(xy)
    whole = seat.result(True, whole=False).codes
    assert any(code >> kernel.KIND == kernel.MEET for code in whole)
    seat.begin()
    for n in range(len(whole)):
        u = seat.look(xy)[0]
        while (whole[n] >> kernel.VEHICLE & kernel.MASK) != u:  # greedy had nothing more for this one
            assert seat.take(u, seat.n_tasks + seat.n_ugvs * seat.n_sites)
            u = seat.look(xy)[0]
        for option in range(seat.n_tasks + seat.n_ugvs * seat.n_sites):
            if dk.code_of(u, option, seat.n_tasks, seat.n_sites) == whole[n]:
                assert seat.take(u, option)
        assert seat.keep().acts.tolist() == whole[: n + 1].tolist()
        node = seat.keep()
        seat.run(xy)
        assert (seat.result(True, whole=False).codes == whole).all()
        seat.back(node)


def test_a_beam_does_not_decode_what_it_knows(policy: Policy) -> None:
    problem, alone = preset("T15-P5", (2, 1), 3), policy.alone()
    greedy, narrow = alone.greedy(problem), alone.beam(problem, 1, 1)
    n = greedy.decisions
    assert narrow.decisions < n * (n + 1) / 4  # it follows greedy's plan most of the way


def test_what_cannot_be_finished_is_said_to_be_so(policy: Policy) -> None:
    problem = preset("T15-P5", (1, 1), 0)
    weak = replace(problem, ugvs=tuple(replace(g, energy_j=1e5) for g in problem.ugvs))
    found = policy.greedy(weak)
    assert not found.certain
    assert not found.complete
    schedule = evaluate(weak, found.actions(weak))
    assert schedule.violation is not None
    assert "not visited" in schedule.violation  # nobody is lost


def test_lost_vehicles_take_no_part(policy: Policy) -> None:
    problem = preset("T15-P5", (3, 2), 1)
    found = policy.greedy(problem, exclude_uavs=(0,), exclude_ugvs=(1,))
    schedule = evaluate(problem, found.actions(problem), exclude_uavs=(0,), exclude_ugvs=(1,))
    assert schedule.violation is None


def test_where_nobody_is_left_nothing_is_planned(policy: Policy) -> None:
    problem = preset("T15-P5", (2, 1), 1)
    found = policy.greedy(problem, exclude_uavs=(0, 1))
    assert not found.complete
    assert len(found.codes) == 0


def test_weights_files(tmp_path: Path) -> None:
    _, tensors = network()
    path = tmp_path / "w.safetensors"
    digest = write(path, SMALL, tensors, {"seed": 1})
    config, back, about = read(path, digest)
    assert config == SMALL
    assert about == {"seed": 1}
    assert all((back[k] == v).all() for k, v in tensors.items() if k != "edges")
    with pytest.raises(PlannerError, match="hash differs"):
        read(path, "0" * 64)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(PlannerError, match="cannot be read"):
        read(path)
    with pytest.raises(PlannerError, match=r"query\.weight is missing"):
        plus_weights(SMALL, {k: v for k, v in tensors.items() if k != "query.weight"})


def test_examples_survive_their_file(tmp_path: Path, examples: list[Example]) -> None:
    path = tmp_path / "some.npz"
    assert save(path, examples, {"what": "test"}) == len(examples)
    for a, b in zip(examples, load(path), strict=True):
        assert a.steps == b.steps
        assert all(np.array_equal(x, y) for x, y in zip(a.world, b.world, strict=True))
        assert np.array_equal(a.codes, b.codes)
    first, second = (pool(x, [3] * len(examples)) for x in (examples, load(path)))
    assert all(np.array_equal(x, y) for x, y in zip(first, second, strict=True))


def test_labels_and_states_under_way_become_examples(tmp_path: Path) -> None:
    list(make(tmp_path, ["T15-P5_2-1"], 1, Expert(steps_t15=1_000, sample=50)))
    source = Source(tmp_path, "T15-P5_2-1", first=3, count=4, midway=1, steps=500)
    first = prepare(tmp_path / "cache", [source])
    assert 6 <= len(first) <= 8
    assert sum(bool(e.world.visited.any()) for e in first) >= 1
    files = list((tmp_path / "cache").iterdir())
    assert len(files) == 1
    before = files[0].stat().st_mtime_ns
    again = prepare(tmp_path / "cache", [source])
    assert files[0].stat().st_mtime_ns == before
    assert [e.makespan_s for e in again] == [e.makespan_s for e in first]


def test_symmetries_turn_positions_and_nothing_else(examples: list[Example]) -> None:
    alone = [e for e in examples if len(e.world.uavs) == 2][:1]
    plain = pool(alone, [0])
    for k in range(8):
        turned = pool(alone, [k])
        if not np.array_equal(turned.option, plain.option):
            continue  # another UAV of two alike went first
        assert np.allclose(turned.task[..., :2], plain.task[..., :2] @ SYMMETRIES[k], atol=1e-5)
        assert np.allclose(turned.task[..., 2:], plain.task[..., 2:], atol=1e-5)


def test_batches_hold_every_decision_once(examples: list[Example]) -> None:
    total = sum(e.steps for e in examples)
    for parts in (1, 4):
        made = list(batches(examples, 32, np.random.default_rng(0), augment=False, parts=parts))
        assert sum(len(b.option) for some in made for b in some) == total
        assert {len(some) for some in made} == {parts}


def test_training_learns_and_goes_on_where_it_stopped(tmp_path: Path, examples: list[Example]) -> None:
    how = Training(epochs=6, batch=64, rate=3e-3, seed=1)
    whole = Trainer(tmp_path / "a", SMALL, how).run(examples, examples, quiet=True)
    assert whole[-1]["valid_loss"] < whole[0]["valid_loss"]
    Trainer(tmp_path / "b", SMALL, replace(how, time_s=1e-9)).run(examples, examples, quiet=True)
    half = Trainer(tmp_path / "b", SMALL, how)
    assert half.at.epoch == 1
    rest = half.run(examples, examples, quiet=True)
    assert rest[-1]["valid_loss"] == pytest.approx(whole[-1]["valid_loss"], abs=1e-3)
    assert Policy.load(tmp_path / "b" / "best.safetensors").config == SMALL
    assert (tmp_path / "b" / "curve.csv").read_text().count("\n") == 7
    with pytest.raises(PlannerError, match="another network"):
        Trainer(tmp_path / "b", replace(SMALL, layers=1), how)
    best = tmp_path / "a" / "best.safetensors"
    begun = Trainer(tmp_path / "c", SMALL, replace(how, epochs=1, rate=1e-9), start=best)
    assert begun.run(examples, examples, quiet=True)[0]["valid_loss"] == pytest.approx(
        whole[-1]["valid_loss"], abs=1e-3
    )
    with pytest.raises(PlannerError, match="these weights are of another network"):
        Trainer(tmp_path / "d", replace(SMALL, layers=1), how, start=best)


def test_search_improves_what_the_policy_plans(tmp_path: Path, policy: Policy, monkeypatch: pytest.MonkeyPatch) -> None:
    problem = data_set("T15-P5_2-2").instance(1_003)
    bare = policy.greedy(problem, symmetries=8)
    whole, later = improved(policy, problem, 4, 3_000)
    assert whole.makespan_s < bare.makespan_s
    assert not whole.world.visited.any()
    assert later.world.visited.any()
    write(tmp_path / "w.safetensors", SMALL, network()[1], {})
    monkeypatch.setattr("planner.policy.improve.CHUNK", 2)
    given = (tmp_path, tmp_path / "w.safetensors", ["T15-P5_2-2"], 1_002, 4, {"T15-P5": 500})
    files = list(improve.make(*given))
    assert [file.stem for file in files] == ["001002", "001004"]
    assert 4 <= sum(len(load(file)) for file in files) <= 8
    files[0].unlink()
    assert list(improve.make(*given)) == files[:1]
    with pytest.raises(PlannerError, match="made with other weights, steps or problems"):
        list(improve.make(*given[:-1], {"T15-P5": 501}))
    with pytest.raises(PlannerError, match="made with other weights, steps or problems"):
        list(improve.make(*given, vary=True))
    others = [e for file in improve.make(tmp_path / "others", *given[1:], vary=True) for e in load(file)]
    assert len({(len(e.world.uavs), len(e.world.ugvs)) for e in others}) > 1


@settings(max_examples=60, deadline=None, derandomize=True)
@given(problem=problems())
def test_any_problem_is_decoded_and_nobody_is_lost(problem: Problem) -> None:
    found = Policy(SMALL, network()[1]).greedy(problem)
    schedule = evaluate(problem, found.actions(problem))
    assert schedule.makespan_s == pytest.approx(found.makespan_s)
    assert found.complete == schedule.feasible
    if found.certain:
        assert schedule.violation is None
    elif schedule.violation is not None and "not visited" not in schedule.violation:
        # Somebody was lost from the start, whatever anybody does.
        assert evaluate(problem, ()).violation == schedule.violation


@settings(max_examples=60, deadline=None, derandomize=True)
@given(problem=problems())
def test_experts_of_any_problem_are_reproduced(problem: Problem) -> None:
    plan = solve(problem, Stop(iterations=2_000), 0).plan
    if not plan.feasible:
        return
    try:
        told = in_turns(problem, plan.actions)
    except PlannerError:  # seldom: the UAV that is ready first takes the dock, and the other one cannot hover so long
        assert any(u.waiting == "hover" for u in problem.uavs)
        return
    assert len(told.codes) <= len(plan.actions)
    if told.feasible:
        assert evaluate(problem, decode(problem, told.codes)).makespan_s == told.makespan_s


def test_what_uavs_that_are_alike_would_do_counts_as_right() -> None:
    problem = data_set("T15-P5_4-2").instance(3)
    plan = solve(problem, Stop(iterations=5_000), 0).plan
    one = example(problem, plan.actions)
    firsts = set()
    for angle in np.linspace(0.0, 2.0 * np.pi, 16, endpoint=False).tolist():
        made = pool([one], [0], [angle])
        first = made.option[0]
        acting = {a.uav for a in plan.actions if isinstance(a, Visit)}
        assert (first >= 0).sum() == len(acting), "all are at the depot and alike"
        assert len(set(first[first >= 0].tolist())) == len(acting)
        assert all((row >= 0).any() for row in made.option)
        firsts.add(int(first[0]))
    assert len(firsts) == len(acting), "any of them can be the first"


def test_any_right_choice_will_do() -> None:
    logits = torch.tensor([[0.0, 5.0, 0.0, FORBIDDEN], [3.0, 0.0, 0.0, 0.0]])
    option = torch.tensor([[0, 1], [0, -1]])
    expected = -(logits.softmax(-1)[0, :2].sum().log() + logits.softmax(-1)[1, 0].log()) / 2
    assert loss_of(logits, option) == pytest.approx(float(expected), rel=1e-5)
    assert hits(logits, option) == 2
    assert hits(logits, torch.tensor([[0, 2], [-1, 1]])) == 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"epochs": 0}, "epochs is 0; give a number above 0"),
        ({"decay": -1.0}, "decay is -1.0; give a number of at least 0"),
        ({"seed": -1}, "seed is -1; give"),
        ({"smooth": 1.0}, "smooth is 1.0; give a number from 0 to below 1"),
        ({"batch": 3, "parts": 4}, "a batch of 3 cannot come in 4 parts"),
    ],
)
def test_wrong_settings_of_training(wrong: dict[str, float], message: str) -> None:
    with pytest.raises(PlannerError, match=message):
        Training(**wrong)  # type: ignore[arg-type]


def test_files_of_examples_that_are_none(tmp_path: Path) -> None:
    for k, data in enumerate((b"", b"PK\x03\x04cut", b"text")):
        (tmp_path / f"{k}.npz").write_bytes(data)
        with pytest.raises(PlannerError, match=f"{k}.npz: no examples can be read"):
            load(tmp_path / f"{k}.npz")
