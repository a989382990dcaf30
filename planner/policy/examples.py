"""Training data: problems with good plans for them, compact; decisions are made from them batch by batch.

An example is a problem as arrays and a plan as visits and meetings: a few kilobytes. Any source will do: labels
(``planner.labels``), mid-mission states, or what was decoded and then improved by search. ``replay_kernel`` goes
through a plan in a fraction of a millisecond and writes what the network sees at each decision, so nothing larger is
stored, and training and planning see the same features by construction.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from planner.arrays import encode_meets
from planner.errors import PlannerError
from planner.instances import data_set
from planner.kernel import Codes, Floats, World
from planner.labels import read as read_labels
from planner.midway import midway
from planner.plan import Action
from planner.policy.order import in_turns, useful
from planner.policy.state import new_state
from planner.problem import Problem
from planner.solve import Params, Stop, solve

FORMAT = "copcs-examples/1"
WORLD = ("dist", "near", "road", "uavs", "ugvs", "site0", "docks0", "visited", "uav_on", "ugv_on")
NAMES = (*WORLD, "xy", "reach", "codes")


@dataclass(frozen=True, slots=True)
class Example:
    """One problem and a plan for it.

    Attributes:
        world: the problem.
        xy: positions of nodes, (N + U + G, 2) in m.
        reach: ranges of the UAVs, (U,) in m.
        codes: the plan's visits and meetings, (n,).
        steps: decisions in it.
        makespan_s: of the plan in the decoder's order.
    """

    world: World
    xy: Floats
    reach: Floats
    codes: Codes
    steps: int
    makespan_s: float


def example(problem: Problem, actions: Sequence[Action]) -> Example:
    """Makes an example of a feasible plan.

    Raises:
        PlannerError: where the decoder cannot say the plan, or it is infeasible in the decoder's order.
    """
    state = new_state(problem)
    told = in_turns(problem, actions, state)
    if not told.feasible:
        raise PlannerError("the plan is infeasible in the decoder's order")
    codes = useful(encode_meets(problem, actions))
    return Example(state.world, state.xy, state.reach, codes, len(told.options), told.makespan_s)


@dataclass(frozen=True, slots=True)
class Source:
    """Where examples come from, as ``gather`` takes it.

    Attributes:
        folder: of labels.
        name: a data set.
        first, count: which instances, by index.
        midway: mid-mission states per label.
        steps: of the search that labels these.
        seed: of those states and searches.
    """

    folder: Path
    name: str
    first: int = 0
    count: int = 1 << 30
    midway: int = 0
    steps: int = 50_000
    seed: int = 0


def gather(source: Source) -> Iterator[Example]:
    """The examples of a source; what the decoder cannot say is left out.

    A mid-mission state is one of a hastily made plan, as ``planner.midway`` has it; its label is what search makes of
    the rest of that plan.
    """
    one = data_set(source.name)
    for label in read_labels(source.folder, source.name):
        if not source.first <= label.index < source.first + source.count:
            continue
        problem = one.instance(label.index)
        pairs = [(problem, label.actions)]
        for k in range(source.midway):
            seed = source.seed + label.index + 1_000_003 * (k + 1)
            later, rest = midway(problem, seed)
            better = solve(later, Stop(iterations=source.steps), seed, Params(start=rest)).plan
            pairs.append((later, better.actions))
        for some, actions in pairs:
            try:
                made = example(some, actions)
            except PlannerError:
                continue
            if made.steps > 0:
                yield made


def save(path: Path, examples: Iterable[Example], about: Mapping[str, Any]) -> int:
    """Writes examples to one ``.npz`` file, whole or not at all; how many."""
    shapes: list[list[int]] = []
    flat: dict[str, list[NDArray[Any]]] = {name: [] for name in NAMES}
    steps, spans = [], []
    for e in examples:
        row: list[int] = []
        arrays: tuple[NDArray[Any], ...] = (*e.world, e.xy, e.reach, e.codes)
        for name, array in zip(NAMES, arrays, strict=True):
            flat[name].append(array.ravel())
            row += [*array.shape, *[0] * (2 - array.ndim)]
        shapes.append(row)
        steps.append(e.steps)
        spans.append(e.makespan_s)
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.npz")
    members: dict[str, Any] = {name: np.concatenate(parts) if parts else np.zeros(0) for name, parts in flat.items()}
    np.savez(
        part,
        shapes=np.array(shapes, np.int32).reshape(len(shapes), 2 * len(NAMES)),
        steps=np.array(steps, np.int32),
        makespan_s=np.array(spans),
        about=np.array(json.dumps({"format": FORMAT, **about})),
        **members,
    )
    part.replace(path)
    return len(shapes)


def load(path: Path) -> list[Example]:
    """Reads what ``save`` wrote.

    Raises:
        PlannerError: where the file is missing or of another format.
    """
    try:
        with np.load(path) as file:
            data = {key: file[key] for key in file.files}
    except (OSError, ValueError, TypeError, EOFError, BadZipFile) as error:
        raise PlannerError(f"{path}: no examples can be read: {error}") from error
    about = json.loads(str(data["about"])) if "about" in data else {}
    if about.get("format") != FORMAT:
        raise PlannerError(f"{path}: format is {about.get('format')!r}; this program reads {FORMAT!r}")
    at = dict.fromkeys(NAMES, 0)
    examples = []
    listed = (data[name].tolist() for name in ("shapes", "steps", "makespan_s"))
    for row, steps, span in zip(*listed, strict=True):
        arrays = []
        for i, name in enumerate(NAMES):
            rows, columns = row[2 * i : 2 * i + 2]
            flat = name in ("near", "site0", "visited", "uav_on", "ugv_on", "reach", "codes")
            size = rows if flat else rows * columns
            part = data[name][at[name] : at[name] + size]
            arrays.append(part if flat else part.reshape(rows, columns))
            at[name] += size
        examples.append(Example(World(*arrays[:10]), arrays[10], arrays[11], arrays[12], steps, span))
    return examples
