"""The paper's network and its MLP baseline: graph, list of actions, the same numbers without torch, feasible plans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from planner.copcs import sample
from planner.errors import PlannerError
from planner.instances import data_set
from planner.labels import in_order
from planner.plan import Action, Visit
from planner.policy import tokens_kernel as tk
from planner.policy.config import PaperConfig
from planner.policy.graph import (
    POINT,
    TASK,
    UAV,
    UGV,
    Graph,
    action_of,
    graph,
    index_of,
    n_actions,
    numbering,
    renumbered,
    spoken,
)
from planner.policy.paper_decode import PaperPolicy
from planner.policy.paper_kernel import offer_all, say
from planner.policy.paper_net import Graphs, PaperNet
from planner.policy.paper_numpy import PaperModel
from planner.policy.paper_train import loss_of as paper_loss_of
from planner.policy.paper_train import measure, sequences, shuffled, train
from planner.policy.state import new_state
from planner.policy.training import Training
from planner.policy.weights import read, write
from planner.presets import preset
from planner.problem import Problem
from planner.schedule import evaluate
from planner.solve import Params, Stop, solve, warm_up

# Half a minute of compiling: not in the default suite.
pytestmark = pytest.mark.slow

CONFIG = PaperConfig(15, 5, 2, 2, dim=32, encoder_layers=2, decoder_layers=2, most=96)


def network(config: PaperConfig = CONFIG) -> tuple[PaperNet, dict[str, np.ndarray]]:
    torch.manual_seed(0)
    net = PaperNet(config).eval()
    return net, {k: v.detach().numpy() for k, v in net.state_dict().items()}


@pytest.fixture(scope="module")
def pairs() -> list[tuple[Problem, tuple[Action, ...]]]:
    one = data_set("T15-P5_2-2")
    return [(p, solve(p, Stop(iterations=5_000), i).plan.actions) for i, p in enumerate(one.instances(range(6)))]


def batch(g: Graph) -> Graphs:
    return Graphs(*(torch.from_numpy(x[None]) for x in g))


def test_edges_are_the_papers() -> None:
    problem = preset("T15-P5", (2, 2), 0)
    g = graph(problem, replace(CONFIG, radius=0.4))
    kind = np.repeat([TASK, POINT, UAV, UGV], [15, 6, 2, 2])
    to, of = kind[:, None], kind[None, :]
    assert not g.intra[to != of].any()
    assert np.diag(g.intra).all()
    assert (g.uav_edges <= ((to == UAV) & ((of == TASK) | (of == UGV)))).all()
    assert (g.ugv_edges <= ((to == UGV) & ((of == UAV) | (of == POINT)))).all()
    wide = graph(problem, replace(CONFIG, radius=9.0))
    assert wide.uav_edges.sum() == 2 * (15 + 2)
    assert wide.ugv_edges.sum() == 2 * (2 + 6)
    assert (g.intra <= wide.intra).all()
    assert g.intra.sum() < wide.intra.sum()
    assert not graph(problem, replace(CONFIG, uav_edges=False)).uav_edges.any()


def test_every_action_has_a_number() -> None:
    assert n_actions(CONFIG) == 2 * 15 + 2 * 6 + 2 * 2
    assert [index_of(action_of(i, CONFIG), CONFIG) for i in range(n_actions(CONFIG))] == list(range(n_actions(CONFIG)))


@pytest.mark.parametrize(("kind", "named"), [("hgt", True), ("mlp", True), ("hgt", False)])
def test_the_same_logits_with_and_without_torch(kind: str, named: bool) -> None:
    config = replace(CONFIG, graph=kind, named=named)
    net, tensors = network(config)
    g = graph(preset("T15-P5", (2, 2), 1), config)
    said = np.random.default_rng(0).integers(0, n_actions(config), 30)
    with torch.inference_mode():
        expected = net(batch(g), torch.from_numpy(said[None]))[0].numpy()
    model = PaperModel(config, tensors)
    saying = model.begin(model.encode(g))
    mine = np.stack([saying.next(None if t == 0 else int(said[t - 1])) for t in range(31)])
    assert np.abs(mine - expected).max() < 1e-4


def test_logits_do_not_see_the_future() -> None:
    net, _ = network()
    g = batch(graph(preset("T15-P5", (2, 2), 1), CONFIG))
    one = torch.tensor([[1, 2, 3, 4]])
    other = torch.tensor([[1, 2, 30, 31]])
    with torch.inference_mode():
        a, b = net(g, one)[0], net(g, other)[0]
    assert torch.allclose(a[:3], b[:3])
    assert not torch.allclose(a[3:], b[3:])


def test_experts_are_never_masked_out(pairs: list[tuple[Problem, tuple[Action, ...]]]) -> None:
    for problem, actions in pairs:
        sequence = spoken(in_order(problem, actions))
        s = new_state(problem)
        tk.start(s.world, s.work, s.turn)
        moved, offered = np.zeros(2, np.uint8), np.zeros(n_actions(CONFIG), np.uint8)
        for action in sequence:
            offer_all(s.world, s.work, s.turn, moved, offered)
            assert offered[index_of(action, CONFIG)]
            say(s.world, s.work, s.turn, moved, index_of(action, CONFIG))
        schedule = evaluate(problem, sequence)
        assert schedule.feasible
        assert schedule.makespan_s == pytest.approx(evaluate(problem, actions).makespan_s)


@pytest.mark.parametrize(("setup", "team"), [("T15-P5", (1, 1)), ("T15-P5", (4, 2)), ("T45-P10", (2, 2))])
def test_whatever_the_weights_plans_are_feasible(setup: str, team: tuple[int, int]) -> None:
    problem = preset(setup, team, 2)
    config = replace(
        CONFIG, n_tasks=problem.n_tasks, n_points=len(problem.path_points), n_uavs=team[0], n_ugvs=team[1], most=256
    )
    found = PaperPolicy(config, network(config)[1]).greedy(problem)
    schedule = evaluate(problem, found.actions(problem))
    assert found.certain
    assert schedule.violation is None
    assert schedule.makespan_s == pytest.approx(found.makespan_s)


def test_other_sizes_are_refused() -> None:
    policy = PaperPolicy(CONFIG, network()[1])
    with pytest.raises(PlannerError, match="15 tasks, 5 path points, 2 UAVs and 2 UGVs only"):
        policy.greedy(preset("T15-P5", (2, 1), 0))


@pytest.mark.parametrize("damage", ["missing", "shape", "actions"])
def test_weights_that_do_not_fit(tmp_path: Path, damage: str) -> None:
    tensors = dict(network()[1])
    if damage == "missing":
        del tensors["layers.1.norm.bias"]
    elif damage == "shape":
        tensors["decoder.0.q_c.weight"] = tensors["decoder.0.q_c.weight"][:-1]
    else:
        tensors["out.weight"] = tensors["out.weight"][:-1]
    file = tmp_path / "paper.safetensors"
    write(file, CONFIG, tensors, {})
    with pytest.raises(PlannerError, match=r"paper\.safetensors: weights of network paper: "):
        PaperPolicy.load(file)


def test_it_is_tried_on_a_problem_of_its_sizes(tmp_path: Path) -> None:
    file = tmp_path / "paper.safetensors"
    other = replace(CONFIG, n_tasks=45, n_points=10, n_uavs=1, n_ugvs=1)
    write(file, other, network(other)[1], {})
    problem = sample({"weights": str(file)})
    assert (problem.n_tasks, len(problem.path_points), len(problem.uavs), len(problem.ugvs)) == (45, 10, 1, 1)
    warm_up("copcs", {"weights": str(file), "polish": False})


def test_it_plans_as_a_method(tmp_path: Path) -> None:
    file = tmp_path / "paper.safetensors"
    write(file, CONFIG, network()[1], {})
    options = {"weights": str(file), "polish": False}
    problem, stop = preset("T15-P5", (2, 2), 4), Stop(iterations=500)
    plan = solve(problem, stop, 0, Params("copcs", options=options)).plan
    assert plan.feasible
    assert plan.actions == PaperPolicy.load(file).greedy(problem).actions(problem)
    without = solve(problem, stop, 0, Params("copcs", options={**options, "exclude_uavs": {1}})).plan
    assert {a.uav for a in without.actions if isinstance(a, Visit)} == {0}
    other = solve(preset("T15-P5", (2, 1), 4), stop, 0, Params("copcs", options={"weights": str(file)})).plan
    assert other.note == (
        "search took over: the network was trained on other problems "
        "(its data set has 15 tasks, 5 path points, 2 UAVs and 2 UGVs)"
    )
    with pytest.raises(PlannerError, match="option decode is 'beam'; the paper's network plans greedy only"):
        solve(problem, stop, 0, Params("copcs", options={**options, "decode": "beam"}))


def test_first_weights_point_from_numbers_to_actions() -> None:
    w = network()[1]
    name, out = w["name.weight"], w["out.weight"]
    first_uav = CONFIG.n_tasks + CONFIG.n_points + 1
    for index in range(n_actions(CONFIG)):
        act = action_of(index, CONFIG)
        if isinstance(act, Visit):
            both = name[act.task] + name[first_uav + act.uav]
            assert out[index] == pytest.approx(0.5 * both / np.linalg.norm(both), abs=1e-6)
    assert (w["decoder.0.v_c.weight"] == np.eye(CONFIG.dim)).all()
    other = network(replace(CONFIG, named=False))[1]
    assert "name.weight" not in other and np.abs(other["out.weight"]).max() < 0.5


def test_half_precision_learns_the_same(pairs: list[tuple[Problem, tuple[Action, ...]]]) -> None:
    net, data = network()[0], sequences(pairs, CONFIG, augment=False)
    rows, cpu = np.arange(len(data.said)), torch.device("cpu")
    plain, half = (paper_loss_of(net, data, rows, cpu, bfloat16=x)[0] for x in (False, True))
    assert float(half.detach()) == pytest.approx(float(plain.detach()), rel=0.02)
    half.backward()
    assert all(p.grad is not None and p.grad.dtype == torch.float32 for p in net.decoder.parameters())


def test_numbers_by_place_do_not_depend_on_the_order_given(pairs: list[tuple[Problem, tuple[Action, ...]]]) -> None:
    problem = preset("T15-P5", (2, 2), 4)
    order = numbering(problem)
    assert sorted(order.tolist()) == list(range(15))
    first, second = problem.tasks[order[:4]], problem.tasks[order[4:8]]  # four strips: 4, 4, 4, 3
    assert first[:, 0].max() <= second[:, 0].min()
    assert (np.diff(first[:, 1]) > 0).all() and (np.diff(second[:, 1]) < 0).all()
    config = replace(CONFIG, by_place=True)
    policy = PaperPolicy(config, network(config)[1])
    mixed = renumbered(problem, np.random.default_rng(1).permutation(15))
    one, other = policy.greedy(problem), policy.greedy(mixed)
    for plan, of in ((one, problem), (other, mixed)):
        found = evaluate(of, plan.actions(of))
        assert found.violation is None and found.makespan_s == pytest.approx(one.makespan_s)
    some = sequences(pairs[:1], config, augment=False)
    task = some.graphs.task[0, some.said[0, 0] % 15]  # what is said first, and where that is
    xy = pairs[0][0].tasks[next(a.task for a in in_order(*pairs[0]) if isinstance(a, Visit))]
    every = np.vstack([pairs[0][0].tasks, pairs[0][0].sites])
    low, high = every.min(axis=0), every.max(axis=0)
    assert task[:2] == pytest.approx((xy - 0.5 * (low + high)) / (high - low).max(), abs=1e-5)


def test_numbering_tasks_anew_keeps_every_plan(pairs: list[tuple[Problem, tuple[Action, ...]]]) -> None:
    data = sequences(pairs, CONFIG, augment=False)
    rows = np.array([3, 1])
    some = shuffled(data, rows, CONFIG, np.random.default_rng(0))
    for k, row in enumerate(rows.tolist()):
        assert not np.array_equal(some.said[k], data.said[row])
        for new, old in zip(some.said[k].tolist(), data.said[row].tolist(), strict=True):
            if 0 <= old < 30:
                assert new // 15 == old // 15
                assert np.array_equal(some.graphs.task[k, new % 15], data.graphs.task[row, old % 15])
            else:
                assert new == old
        assert some.graphs.uav_edges[k].sum() == data.graphs.uav_edges[row].sum()
        first, again = int(some.said[k][0]), int(data.said[row][0])
        if again < 30:
            uav = 15 + 6 + again // 15
            assert some.graphs.uav_edges[k, uav, first % 15] == data.graphs.uav_edges[row, uav, again % 15]


def test_training_learns_and_goes_on(tmp_path: Path, pairs: list[tuple[Problem, tuple[Action, ...]]]) -> None:
    data = sequences(pairs, CONFIG)
    assert len(data.said) == 8 * len(pairs)
    valid = sequences(pairs[:2], CONFIG, augment=False)
    how = Training(epochs=24, batch=16, rate=3e-3, augment=False)  # to learn a few plans by heart is enough here
    before = measure(network()[0], valid, 8, torch.device("cpu"))[0]
    train(tmp_path, CONFIG, replace(how, time_s=1e-9), data, valid, quiet=True)
    net = train(tmp_path, CONFIG, how, data, valid, quiet=True)
    assert measure(net, valid, 8, torch.device("cpu"))[0] < 0.8 * before
    assert (tmp_path / "curve.csv").read_text().count("\n") == 25
    best, size = tmp_path / "best.safetensors", sum(p.numel() for p in net.parameters())
    assert best.stat().st_size < 2.2 * size + 10_000  # in half precision: there are many of these files
    assert all(x.dtype == np.float32 for x in read(best)[1].values())
    policy = PaperPolicy.load(best)
    problem = pairs[0][0]
    assert evaluate(problem, policy.greedy(problem).actions(problem)).violation is None
