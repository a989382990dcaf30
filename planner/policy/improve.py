"""Self-improvement: what the policy plans, improved by search, as training data: ``python -m planner.policy.improve``.

Two examples come from each instance: the whole problem, where search starts from the best of the policy's plans over
all orientations; and a moment in the middle of its greedy plan, where search starts from the rest of that plan. The
second kind shows the policy what to do in states that its own mistakes lead to (as in DAgger, Ross 2011). With
``--varied`` the instances get other teams and vehicles first (``planner.policy.varied``).

Chunks of ``CHUNK`` instances, one file each: a run may be interrupted and goes on. Train with ``--more FILES``.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress

from planner.errors import PlannerError, exit_on_error
from planner.instances import SIZE, data_set
from planner.midway import state_at
from planner.plan import Action
from planner.policy.decode import Policy
from planner.policy.examples import Example, example, save
from planner.policy.state import SYMMETRIES
from planner.policy.varied import varied
from planner.problem import Problem
from planner.solve import Params, Stop, solve

CHUNK = 50


def improved(policy: Policy, problem: Problem, seed: int, steps: int) -> list[Example]:
    """Up to two examples from one problem (see above); none where neither the policy nor search finds a plan.

    Args:
        policy: whose plans are improved.
        problem: the problem.
        seed: of search and of the moment.
        steps: of each search.
    """
    plain = policy.greedy(problem)
    if not plain.complete:
        return _example(problem, None, seed, steps)
    best = policy.greedy(problem, symmetries=len(SYMMETRIES))
    found = _example(problem, best.actions(problem), seed, steps)
    share = float(np.random.default_rng([seed, 2]).uniform(0.02, 0.95))
    later, rest = state_at(problem, plain.actions(problem), share * plain.makespan_s)
    return found + _example(later, rest, seed, steps)


def _example(problem: Problem, start: Sequence[Action] | None, seed: int, steps: int) -> list[Example]:
    plan = solve(problem, Stop(iterations=steps), seed, Params(start=start)).plan
    if not plan.feasible:
        return []
    try:
        return [example(problem, plan.actions)]
    except PlannerError:  # the decoder has no words for this plan
        return []


def make_chunk(out: Path, weights: Path, name: str, first: int, steps: int, vary: bool) -> int:
    """Writes the examples of instances ``first`` to ``first + CHUNK - 1``; how many there are."""
    one, policy = data_set(name), Policy.load(weights)
    given = ((i, one.instance(i)) for i in range(first, first + CHUNK))
    made = (x for i, p in given for x in improved(policy, varied(p, i) if vary else p, i, steps))
    return save(_file(out, name, first), made, {"data_set": name, "first": first, **_made_with(weights, steps, vary)})


def _made_with(weights: Path, steps: int, vary: bool) -> dict[str, Any]:
    return {"weights": _hash(weights), "steps": steps, "varied": vary}


@cache
def _hash(weights: Path) -> str:
    try:
        return hashlib.sha256(weights.read_bytes()).hexdigest()
    except OSError as error:
        raise PlannerError(f"{weights}: the weights cannot be read: {error.strerror}") from error


def _exists(path: Path, weights: Path, steps: int, vary: bool) -> bool:
    """Whether a chunk is there already.

    Raises:
        PlannerError: where it was made otherwise.
    """
    if not path.exists():
        return False
    with np.load(path) as file:
        about = json.loads(str(file["about"]))
    made_with = _made_with(weights, steps, vary)
    if {k: about.get(k, False) for k in made_with} != made_with:
        raise PlannerError(f"{path}: was made with other weights, steps or problems; give another --out, or remove it")
    return True


def _file(out: Path, name: str, first: int) -> Path:
    return out / name / f"{first:06d}.npz"


def make(
    out: Path,
    weights: Path,
    sets: Sequence[str],
    first: int,
    count: int,
    steps: dict[str, int],
    jobs: int = 1,
    *,
    vary: bool = False,
) -> Iterator[Path]:
    """Makes the chunks that are missing; yields each as it is done.

    Args:
        out: where they go, a folder for each data set.
        weights: the policy's.
        sets: names of data sets.
        first: first instance; those from ``instances.SIZE`` on are in no data set of the paper.
        count: of instances, rounded up to whole chunks.
        steps: of each search, by setup.
        jobs: processes at once.
        vary: whether the instances get other teams and vehicles.

    Raises:
        PlannerError: where chunks were made with other weights, steps or problems, or weights cannot be read.
    """
    todo = [
        (name, start)
        for start in range(first, first + count, CHUNK)
        for name in sets
        if not _exists(_file(out, name, start), weights, steps[data_set(name).setup], vary)
    ]  # fmt: skip
    tasks = [(out, weights, name, start, steps[data_set(name).setup], vary) for name, start in todo]
    if jobs <= 1:
        for task, (name, start) in zip(tasks, todo, strict=True):
            make_chunk(*task)
            yield _file(out, name, start)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for _, (name, start) in zip(pool.map(make_chunk, *zip(*tasks, strict=True)), todo, strict=True):
            yield _file(out, name, start)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line.

    Raises:
        PlannerError: a data set does not exist, or weights cannot be read.
    """
    parser = argparse.ArgumentParser(
        prog="python -m planner.policy.improve", description="Improves the policy's plans by search; resumable."
    )
    parser.add_argument("--weights", type=Path, required=True, help="of network plus")
    parser.add_argument("--sets", required=True, help="data sets, with commas between")
    parser.add_argument("--out", type=Path, default=Path("runs/improved"), help="files of examples")
    parser.add_argument("--first", type=int, default=SIZE, help="first instance")
    parser.add_argument("--count", type=int, default=200, help="instances of each data set")
    parser.add_argument("--steps-t15", type=int, default=60_000, help="of each search")
    parser.add_argument("--steps-t45", type=int, default=250_000, help="of each search")
    parser.add_argument(
        "--varied", action="store_true", help="with other teams and vehicles: hovering, slow to dock, ..."
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at once")
    given = parser.parse_args(arguments)
    sets = [data_set(name.strip()).name for name in given.sets.split(",")]
    steps = {"T15-P5": given.steps_t15, "T45-P10": given.steps_t45}
    chunks = len(sets) * -(-given.count // CHUNK)
    have = sum(
        _file(given.out, n, k).exists() for n in sets for k in range(given.first, given.first + given.count, CHUNK)
    )
    with Progress() as bar:
        task = bar.add_task("chunks", total=chunks, completed=have)
        for _ in make(given.out, given.weights, sets, given.first, given.count, steps, given.jobs, vary=given.varied):
            bar.advance(task)


if __name__ == "__main__":
    exit_on_error(main)
