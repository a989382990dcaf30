"""The expert's plans as training data: ``python -m planner.labels``.

Chunks of ``CHUNK`` instances, one file each, so that a run may be interrupted and its files be committed as they come.
The expert is ``search`` with a budget of steps: the same command makes the same labels on any machine. How good they
are is measured on some instances of each chunk by a search ``LONGER`` times as long.

**Order.** One schedule has many action lists, and vehicles that are alike can change names. A sequence model can only
learn one of these. So (1) among vehicles that are alike, the one that acts first has the lowest index; of those that
set out together, the first counter-clockwise from east, seen from where they start; (2) actions are in the canonical
order of ``planner.order``: by start time, then vehicle. What a decoder has to say next then depends on the state at
that time, not on how the expert came upon its plan.
"""

from __future__ import annotations

import argparse
import io
import json
import math
import multiprocessing
import os
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from rich.progress import Progress

from planner.errors import PlannerError, exit_on_error
from planner.instances import DATA_SETS, SIZE, data_set
from planner.order import canonical
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Point, Problem
from planner.schedule import evaluate
from planner.solve import Stop, solve

CHUNK = 50
LONGER = 10
OTHER_SEED = 10**6  # of the longer search: it shall not repeat the expert's walk
FOLDER = Path("benchmarks/labels")


@dataclass(frozen=True, slots=True)
class Expert:
    """How labels are made.

    Attributes:
        steps_t15: of the search for T15-P5; 400,000 take a third of a second.
        steps_t45: the same for T45-P10; 1,500,000 take two seconds.
        seed: added to the instance's number.
        sample: every so many instances of a chunk are searched ``LONGER`` times as long as well.
    """

    steps_t15: int = 400_000
    steps_t45: int = 1_500_000
    seed: int = 0
    sample: int = 25

    def steps(self, setup: str) -> int:
        """The budget for a setup."""
        return self.steps_t15 if setup == "T15-P5" else self.steps_t45


@dataclass(frozen=True, slots=True)
class Label:
    """One instance's plan, the CPU time it took, and the makespan after a longer search where that was tried."""

    index: int
    actions: tuple[Action, ...]
    makespan_s: float
    planning_s: float
    longer_s: float | None


def in_order(problem: Problem, actions: Sequence[Action]) -> tuple[Action, ...]:
    """``actions`` with vehicles that are alike named by rule, in canonical order (see above)."""
    rows = evaluate(problem, actions).actions
    begins: dict[tuple[str, int], tuple[float, float]] = {}
    for act, row in zip(actions, rows, strict=True):
        who = ("ugv", act.ugv) if isinstance(act, Move) else ("uav", act.uav)
        begins.setdefault(who, (round(row.start_s, 3), _bearing(problem, act)))
        if isinstance(act, Recharge):
            begins.setdefault(("ugv", act.ugv), (round(row.work_s, 3), 0.0))
    names: dict[tuple[str, int], int] = {}
    teams: tuple[tuple[str, Sequence[Any]], ...] = (("uav", problem.uavs), ("ugv", problem.ugvs))
    for kind, vehicles in teams:
        alike: dict[Any, list[int]] = {}
        for i, vehicle in enumerate(vehicles):
            alike.setdefault(replace(vehicle, id=""), []).append(i)
        for group in alike.values():
            acting = sorted(group, key=lambda i: (begins.get((kind, i), (math.inf, 0.0)), i))
            names |= {(kind, old): new for old, new in zip(acting, group, strict=True)}
    named: list[Action] = []
    for act in actions:
        if isinstance(act, Visit):
            named.append(Visit(names["uav", act.uav], act.task))
        elif isinstance(act, Recharge):
            named.append(Recharge(names["uav", act.uav], names["ugv", act.ugv]))
        else:
            named.append(Move(names["ugv", act.ugv], act.path_point))
    return canonical(problem, named)


def _bearing(problem: Problem, act: Action) -> float:
    """Direction of an action's target as seen from the depot or the UAV's start, in rad from east, 0 to 2 pi."""
    start: Point = problem.depot
    if isinstance(act, Visit):
        start, target = problem.uavs[act.uav].position, problem.tasks[act.task]
    elif isinstance(act, Move):
        target = problem.sites[problem.depot_index if act.path_point is None else act.path_point]
    else:
        return 0.0
    return math.atan2(float(target[1]) - start[1], float(target[0]) - start[0]) % (2 * math.pi)


def make_chunk(name: str, first: int, expert: Expert) -> bytes:
    """The labels of instances ``first`` to ``first + CHUNK - 1`` as a compressed ``.npz`` file."""
    one = data_set(name)
    steps = expert.steps(one.setup)
    rows: list[tuple[int, int, int]] = []
    start, spans, took, longer = [0], [], [], []
    for index in range(first, first + CHUNK):
        problem = one.instance(index)
        begun = time.process_time()
        result = solve(problem, Stop(iterations=steps), expert.seed + index)
        took.append(time.process_time() - begun)
        if not result.plan.feasible:
            raise PlannerError(f"{name} {index}: no feasible plan in {steps} steps: {result.plan.schedule.violation}")
        actions = in_order(problem, result.plan.actions)
        rows += [_row(act) for act in actions]
        start.append(start[-1] + len(actions))
        spans.append(evaluate(problem, actions).makespan_s)
        more = math.nan
        if (index - first) % expert.sample == 0:
            more = solve(problem, Stop(iterations=LONGER * steps), expert.seed + index + OTHER_SEED).plan.makespan_s
        longer.append(more)
    about = {"data_set": name, "expert": asdict(expert), "steps": steps, "digest": one.instance(first).digest}
    file = io.BytesIO()
    np.savez_compressed(
        file,
        index=np.arange(first, first + CHUNK, dtype=np.int32),
        start=np.array(start, np.int32),
        actions=np.array(rows, np.int16),
        makespan_s=np.array(spans),
        planning_s=np.array(took, np.float32),
        longer_s=np.array(longer),
        about=np.array(json.dumps(about)),
    )
    return file.getvalue()


def _row(act: Action) -> tuple[int, int, int]:
    """Kind (0 visit, 1 recharge, 2 move), vehicle and target; -1 is the depot."""
    if isinstance(act, Visit):
        return 0, act.uav, act.task
    if isinstance(act, Recharge):
        return 1, act.uav, act.ugv
    return 2, act.ugv, -1 if act.path_point is None else act.path_point


def _act(kind: int, vehicle: int, target: int) -> Action:
    if kind == 0:
        return Visit(vehicle, target)
    if kind == 1:
        return Recharge(vehicle, target)
    return Move(vehicle, None if target < 0 else target)


def read(folder: Path, name: str) -> Iterator[Label]:
    """The labels of a data set, in order of the instances.

    Raises:
        PlannerError: where a file belongs to other instances than those that are generated now.
    """
    one = data_set(name)
    for path in sorted((folder / name).glob("*.npz")):
        with np.load(path) as file:
            data = {key: file[key] for key in file.files}
        first = int(data["index"][0])
        if json.loads(str(data["about"]))["digest"] != one.instance(first).digest:
            raise PlannerError(f"{path}: these labels are of other instances; make them again")
        for k, index in enumerate(data["index"].tolist()):
            rows = data["actions"][data["start"][k] : data["start"][k + 1]].tolist()
            longer = float(data["longer_s"][k])
            yield Label(
                index,
                tuple(_act(*row) for row in rows),
                float(data["makespan_s"][k]),
                float(data["planning_s"][k]),
                None if math.isnan(longer) else longer,
            )


def make(
    folder: Path, sets: Sequence[str], count: int, expert: Expert, *, engine: str = "local", jobs: int = 1
) -> Iterator[Path]:
    """Makes the chunks that are missing, of the first ``count`` instances of each set; yields each file as it is done.

    Args:
        folder: where they go, a folder for each data set.
        sets: names of data sets.
        count: rounded up to whole chunks.
        expert: how.
        engine: ``local`` or ``ray`` (a running Ray cluster, or one on this machine).
        jobs: processes at once, for ``local``.

    Raises:
        PlannerError: for an unknown engine, or where Ray is not installed.
    """
    todo = [
        (name, first)
        for first in range(0, count, CHUNK)
        for name in sets
        if not _file(folder, name, first).exists()
    ]  # fmt: skip
    if engine == "local":
        done = _local(todo, expert, jobs)
    elif engine == "ray":
        done = _ray(todo, expert)
    else:
        raise PlannerError(f"engine {engine!r} does not exist; there are local, ray")
    for (name, first), data in done:
        path = _file(folder, name, first)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(".part")
        part.write_bytes(data)
        part.replace(path)  # whole or not at all
        yield path


def _file(folder: Path, name: str, first: int) -> Path:
    return folder / name / f"{first:06d}.npz"


_Done = Iterator[tuple[tuple[str, int], bytes]]


def _local(todo: Sequence[tuple[str, int]], expert: Expert, jobs: int) -> _Done:
    if jobs <= 1:
        for one in todo:
            yield one, make_chunk(*one, expert)
        return
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        running = {pool.submit(make_chunk, *one, expert): one for one in todo}
        for future in as_completed(running):
            yield running[future], future.result()


def _ray(todo: Sequence[tuple[str, int]], expert: Expert) -> _Done:
    try:
        import ray  # noqa: PLC0415  (optional)
    except ImportError:
        raise PlannerError("engine ray needs Ray; pip install 'copcs-deploy[cluster]', or use engine local") from None
    ray.init(ignore_reinit_error=True, log_to_driver=False)
    remote = ray.remote(num_cpus=1)(make_chunk)
    running = {remote.remote(*one, expert): one for one in todo}
    while running:
        finished, _ = ray.wait(list(running), num_returns=1)
        yield running.pop(finished[0]), ray.get(finished[0])


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m planner.labels", description="Makes training labels; resumable.")
    parser.add_argument("--out", type=Path, default=FOLDER)
    parser.add_argument("--sets", default=",".join(d.name for d in DATA_SETS), help="data sets, with commas between")
    parser.add_argument("--count", type=int, default=SIZE, help="instances of each data set")
    parser.add_argument("--engine", choices=("local", "ray"), default="local")
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--steps-t15", type=int, default=Expert().steps_t15)
    parser.add_argument("--steps-t45", type=int, default=Expert().steps_t45)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    sets = [data_set(name.strip()).name for name in given.sets.split(",")]
    expert = Expert(given.steps_t15, given.steps_t45, given.seed)
    chunks = len(sets) * -(-given.count // CHUNK)
    have = sum(_file(given.out, name, first).exists() for name in sets for first in range(0, given.count, CHUNK))
    begun = time.perf_counter()
    with Progress() as bar:
        task = bar.add_task("chunks", total=chunks, completed=have)
        for _ in make(given.out, sets, given.count, expert, engine=given.engine, jobs=given.jobs):
            bar.advance(task)
    print(f"{chunks - have} chunks in {time.perf_counter() - begun:.0f} s")
    for name in sets:
        labels = list(read(given.out, name))
        gaps = [x.makespan_s / x.longer_s - 1.0 for x in labels if x.longer_s]
        mean = 100 * sum(gaps) / max(1, len(gaps))
        took = sum(x.planning_s for x in labels) / max(1, len(labels))
        print(f"{name}: {len(labels)} labels, {took:.2f} s each, {mean:+.2f} % against {LONGER}x longer ({len(gaps)})")


if __name__ == "__main__":
    exit_on_error(main)
