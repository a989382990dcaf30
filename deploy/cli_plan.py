"""``copcs-deploy plan``: a mission or a problem file in, a plan file and a picture out."""

from __future__ import annotations

import json
import math
import sys
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from deploy.cli_common import DONE, FAILED, duration_text, finite, print_json, show_rows, working
from deploy.drawing import MapDrawing
from deploy.errors import InputError
from deploy.planning import LOADING, plan_with_margin
from planner.plan import Move, Plan, Recharge, Visit
from planner.problem import Problem
from planner.roads import Roads
from planner.solve import DEFAULT_METHOD, Params, Stop, warm_up

DEFAULT_TIME_S = 5.0


@dataclass(frozen=True, slots=True)
class _Task:
    """What is to be planned, and what the file says about how."""

    problem: Problem
    stop: Stop
    seed: int
    params: Params
    name: str
    roads: Roads | None = None
    drawing: MapDrawing | None = None
    margin: float = 0.0


def plan(
    file: Path, *, planner: str | None, time_s: float | None, seed: int | None, out: Path | None, as_json: bool
) -> int:
    """Plans ``file`` and writes the plan; 0 where it is feasible, else 1.

    Raises:
        InputError: a file or option is wrong.
        PlannerError: likewise.
    """
    if time_s is not None and not (math.isfinite(time_s) and time_s > 0):
        raise InputError(f"is {time_s:g}; give a number of seconds above 0", key="--time")
    plan_file = out or (None if as_json else Path(f"{file.stem}.plan.json"))
    if plan_file is not None:
        if plan_file.resolve() == file.resolve():
            raise InputError("is the input itself; give another file", key="--out")
        _check_writable(plan_file)
    is_mission = file.suffix.lower() in (".yaml", ".yml")
    task = _mission(file, planner, seed) if is_mission else _problem(file, planner, seed)
    stop = task.stop if time_s is None else Stop(time_s=time_s)
    with working(LOADING, quiet=as_json):
        warm_up(task.params.method, task.params.options)  # not out of the time to plan
    what = f"planning {task.name}" + (f" for {stop.time_s:g} s" if stop.time_s is not None else "")
    with working(what, quiet=as_json):
        made = plan_with_margin(task.problem, task.margin, stop, task.seed, task.params)
    picture = None
    if plan_file is not None:
        picture = plan_file.with_suffix(".png")
        try:
            plan_file.write_text(json.dumps(finite(made.to_json()), indent=1) + "\n", encoding="utf-8")
        except OSError as error:
            raise InputError(f"cannot be written: {error.strerror}; give another --out", file=plan_file) from error
        with working("drawing", quiet=as_json):
            _draw(picture, task, made)
    if as_json:
        print_json(made.to_json())
    else:
        _show(task, made, plan_file, picture)
    if not made.feasible:
        print(f"no feasible plan: {made.schedule.violation}", file=sys.stderr)
    return DONE if made.feasible else FAILED


def _check_writable(path: Path) -> None:
    """Says before minutes of planning what would fail after them."""
    if path.is_dir():
        raise InputError("is a folder; give a file", file=path, key="--out")
    existed = path.exists()
    try:
        path.open("ab").close()
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; give another --out", file=path) from error
    if not existed:
        path.unlink()


def _problem(file: Path, planner: str | None, seed: int | None) -> _Task:
    params = Params(planner or DEFAULT_METHOD)
    return _Task(Problem.read(file), Stop(time_s=DEFAULT_TIME_S), seed or 0, params, file.stem)


def _mission(file: Path, planner: str | None, seed: int | None) -> _Task:
    from deploy.map_drawing import drawing_of  # noqa: PLC0415  (a problem file needs no map)
    from deploy.planning_settings import first_plan, load_with  # noqa: PLC0415

    mission = load_with(file, planner, seed)
    stop, seed, params = first_plan(mission)
    drawing, margin = drawing_of(mission.geometry), mission.settings.replanning.margin
    return _Task(mission.problem, stop, seed, params, mission.name, mission.roads, drawing, margin)


def _draw(picture: Path, task: _Task, made: Plan) -> None:
    from deploy.pictures import plan_picture  # noqa: PLC0415  (matplotlib takes half a second to load)

    plan_picture(task.problem, made, picture, task.roads, task.drawing)


def _show(task: _Task, made: Plan, plan_file: Path | None, picture: Path | None) -> None:
    counts = Counter(type(action) for action in made.actions)
    rows = [
        ("plan", "feasible" if made.feasible else "not feasible"),
        ("makespan", duration_text(made.makespan_s)),
        ("tasks", f"{counts[Visit]} of {int((~task.problem.visited).sum())}"),
        ("recharges, drives", f"{counts[Recharge]}, {counts[Move]}"),
        (
            "energy of UAVs, UGVs",
            f"{made.schedule.uav_energy_j / 1e6:.2f} MJ, {made.schedule.ugv_energy_j / 1e6:.2f} MJ",
        ),
        ("waiting", duration_text(made.schedule.waiting_s)),
        ("method", f"{made.method}, {made.planning_s or 0.0:.1f} s"),
        ("plan file", str(plan_file)),
        ("picture", str(picture)),
    ]
    if made.note is not None:
        rows.insert(-2, ("note", made.note))
    show_rows(rows)
