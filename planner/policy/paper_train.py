"""Trains the paper's network or its MLP baseline: ``python -m planner.policy.paper_train``.

As the paper has it: teacher forcing on the expert's sequences, cross-entropy over the list of actions (equation 12),
Adam. Beyond it: the rate rises and falls (``training.schedule``), and sequences are taken from all eight orientations
of a problem, vehicles that are alike renamed by the labels' rule in each (unless switched off: ``--no-augment``). Tasks
are numbered by where they lie, or at random anew each time (``--no-place``).
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import rich.progress
import torch
from numpy.typing import NDArray
from torch.nn import functional as fn

from planner.errors import PlannerError, exit_on_error
from planner.instances import data_set
from planner.labels import in_order
from planner.labels import read as read_labels
from planner.plan import Action, Visit
from planner.policy.config import PaperConfig
from planner.policy.graph import Graph, graph, index_of, numbering, renumbered, spoken
from planner.policy.paper_net import Graphs, PaperNet
from planner.policy.state import SYMMETRIES
from planner.policy.training import COLUMNS, Progress, Training
from planner.problem import Point, Problem


@dataclass(frozen=True, slots=True)
class Sequences:
    """Problems and the experts' sequences.

    Attributes:
        graphs: of each, with a first axis.
        said: numbers of actions, padded with -1, (n, longest).
    """

    graphs: Graph
    said: NDArray[np.int64]


def turned(problem: Problem, turn: NDArray[np.float64]) -> Problem:
    """The problem with all positions turned or mirrored about the origin; ``turn`` is (2, 2)."""

    def point(p: Point) -> Point:
        x, y = np.array(p) @ turn
        return float(x), float(y)

    return replace(
        problem,
        depot=point(problem.depot),
        tasks=problem.tasks @ turn,
        path_points=problem.path_points @ turn,
        uavs=tuple(replace(u, position=point(u.position)) for u in problem.uavs),
        ugvs=tuple(g if g.position is None else replace(g, position=point(g.position)) for g in problem.ugvs),
    )


def sequences(
    pairs: Sequence[tuple[Problem, tuple[Action, ...]]], config: PaperConfig, *, augment: bool = True
) -> Sequences:
    """Graphs and sequences of all pairs; with ``augment``, in all eight orientations.

    Raises:
        PlannerError: where there are none, sizes differ from the network's, or a sequence is too long for it.
    """
    graphs: list[Graph] = []
    said: list[list[int]] = []
    for problem, actions in pairs:
        for k in range(8 if augment else 1):
            one, acts = problem if k == 0 else turned(problem, SYMMETRIES[k]), actions
            if config.by_place:
                order = numbering(one)
                one, new = renumbered(one, order), order.argsort()
                acts = tuple(Visit(a.uav, int(new[a.task])) if isinstance(a, Visit) else a for a in acts)
            said.append([index_of(a, config) for a in spoken(in_order(one, acts))])
            graphs.append(graph(one, config))
    longest = max((len(x) for x in said), default=0)
    if not 0 < longest < config.most:
        raise PlannerError(f"the longest sequence has {longest} actions; the network takes 1 to {config.most - 1}")
    rows = np.full((len(said), longest), -1, np.int64)
    for row, one_said in zip(rows, said, strict=True):
        row[: len(one_said)] = one_said
    return Sequences(Graph(*(np.stack(x) for x in zip(*graphs, strict=True))), rows)


def shuffled(data: Sequences, rows: NDArray[np.int64], config: PaperConfig, rng: np.random.Generator) -> Sequences:
    """Some of the sequences, the tasks of each numbered anew at random: their numbers mean nothing."""
    m, b = config.n_tasks, len(rows)
    order = rng.permuted(np.tile(np.arange(m), (b, 1)), axis=1)
    g = data.graphs
    rest = np.arange(m, g.intra.shape[1])
    nodes = np.hstack([order, np.tile(rest, (b, 1))])

    def edges(some: NDArray[np.bool_]) -> NDArray[np.bool_]:
        turned_rows = np.take_along_axis(some[rows], nodes[:, :, None], axis=1)
        return np.take_along_axis(turned_rows, nodes[:, None, :], axis=2)

    said = data.said[rows]
    visits = (said >= 0) & (said < config.n_uavs * m)
    new = np.take_along_axis(order.argsort(axis=1), np.where(visits, said % m, 0), axis=1)
    graphs = Graph(
        np.take_along_axis(g.task[rows], order[:, :, None], axis=1), g.point[rows], g.uav[rows], g.ugv[rows],
        edges(g.intra), edges(g.uav_edges), edges(g.ugv_edges),
    )  # fmt: skip
    return Sequences(graphs, np.where(visits, said - said % m + new, said))


def loss_of(
    net: PaperNet, data: Sequences, rows: NDArray[np.int64], device: torch.device, *, bfloat16: bool = False
) -> tuple[torch.Tensor, int]:
    """Mean cross-entropy per action, equation (12), and how many actions the largest logit gets right."""
    graphs = Graphs(*(torch.from_numpy(x[rows]).to(device) for x in data.graphs))
    said = torch.from_numpy(data.said[rows]).to(device)
    with torch.autocast(device.type, torch.bfloat16, bfloat16):
        logits = net(graphs, said[:, :-1].clamp(min=0)).float()
    right = int((logits.detach().argmax(-1) == said).sum())
    return fn.cross_entropy(logits.flatten(0, 1), said.flatten(), ignore_index=-1), right


def train(
    folder: Path, config: PaperConfig, how: Training, data: Sequences, valid: Sequences, *, quiet: bool = False
) -> PaperNet:
    """Trains, resuming from ``folder``'s checkpoint; writes checkpoint, curve and weights after every epoch.

    Raises:
        PlannerError: where the checkpoint is of another network.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(how.seed)
    net = PaperNet(config).to(device)
    at = Progress(folder, config, how, net, torch.optim.Adam(net.parameters(), lr=how.rate))
    n = len(data.said)
    steps = how.epochs * -(-n // how.batch)
    with rich.progress.Progress(disable=quiet) as bar:
        task = bar.add_task("training", total=steps, completed=at.step)
        while at.epoch < how.epochs and at.seconds < how.time_s:
            begun = time.perf_counter()
            net.train()
            rng = np.random.default_rng([how.seed, at.epoch])
            order = rng.permutation(n)
            total, hits, count = 0.0, 0, 0
            for first in range(0, n, how.batch):
                rows = order[first : first + how.batch]
                rate = at.rate(steps)
                some, which = data, rows
                if how.augment and not config.by_place:
                    some, which = shuffled(data, rows, config, rng), np.arange(len(rows))
                loss, right = loss_of(net, some, which, device, bfloat16=how.bfloat16)
                at.adam.zero_grad(set_to_none=True)
                loss.backward()  # type: ignore[no-untyped-call]
                torch.nn.utils.clip_grad_norm_(net.parameters(), how.clip)
                at.adam.step()
                size = int((data.said[rows] >= 0).sum())
                total, hits, count = total + float(loss.detach()) * size, hits + right, count + size
                at.step += 1
                bar.update(task, completed=at.step, description=f"loss {total / count:.3f}")
            at.epoch += 1
            at.seconds += time.perf_counter() - begun
            loss_v, right_v = measure(net, valid, how.batch, device)
            values = (at.epoch, at.step, round(at.seconds, 1), rate, total / count, hits / count, loss_v, right_v)
            at.save(dict(zip(COLUMNS, values, strict=True)), loss_v, {})
    return net


def measure(net: PaperNet, data: Sequences, batch: int, device: torch.device) -> tuple[float, float]:
    """Mean loss per action, and the share of actions where the expert's choice has the largest logit."""
    net.eval()
    total, hits, count = 0.0, 0, 0
    with torch.inference_mode():
        for first in range(0, len(data.said), batch):
            rows = np.arange(first, min(first + batch, len(data.said)))
            loss, right = loss_of(net, data, rows, device)
            size = int((data.said[rows] >= 0).sum())
            total, hits, count = total + float(loss) * size, hits + right, count + size
    return total / max(1, count), hits / max(1, count)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    how = Training(epochs=10, batch=64, rate=2e-3)
    parser = argparse.ArgumentParser(prog="python -m planner.policy.paper_train", description="Trains network paper.")
    parser.add_argument("--labels", type=Path, default=Path("benchmarks/labels"))
    parser.add_argument("--set", required=True, help="the data set")
    parser.add_argument("--out", type=Path, default=Path("runs/paper"), help="checkpoint, curve, weights")
    parser.add_argument("--count", type=int, default=760, help="instances to train on")
    parser.add_argument("--valid", type=int, default=40, help="instances after these, to watch the loss on")
    parser.add_argument("--graph", choices=("hgt", "mlp"), default="hgt")
    parser.add_argument("--epochs", type=int, default=how.epochs)
    parser.add_argument("--batch", type=int, default=how.batch)
    parser.add_argument("--rate", type=float, default=how.rate)
    parser.add_argument("--seed", type=int, default=how.seed)
    parser.add_argument("--time", type=float, default=math.inf, help="in s")
    parser.add_argument("--dim", type=int, default=128)
    parser.add_argument("--radius", type=float, default=0.5)
    parser.add_argument("--bfloat16", action="store_true", help="faster, where the processor has it")
    for name in ("no-augment", "no-uav-edges", "no-ugv-edges", "no-names", "no-place"):
        parser.add_argument(f"--{name}", action="store_true")
    given = parser.parse_args(arguments)
    one = data_set(given.set)
    first = one.instance(0)
    config = PaperConfig(
        first.n_tasks, len(first.path_points), *one.team, graph=given.graph, dim=given.dim, radius=given.radius,
        uav_edges=not given.no_uav_edges, ugv_edges=not given.no_ugv_edges, named=not given.no_names,
        by_place=not given.no_place,
    )  # fmt: skip
    how = replace(
        how,
        epochs=given.epochs,
        batch=given.batch,
        rate=given.rate,
        seed=given.seed,
        time_s=given.time,
        augment=not given.no_augment,
        bfloat16=given.bfloat16,
    )
    pairs = [(one.instance(x.index), x.actions) for x in read_labels(given.labels, given.set)]
    data = sequences(pairs[: given.count], config, augment=not given.no_augment)
    valid = sequences(pairs[given.count : given.count + given.valid], config, augment=False)
    net = train(given.out, config, how, data, valid)
    loss, right = measure(net, valid, how.batch, next(net.parameters()).device)
    print(f"{len(data.said)} sequences: loss {loss:.4f}, right {right:.1%}")


if __name__ == "__main__":
    exit_on_error(main)
