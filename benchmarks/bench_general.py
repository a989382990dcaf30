"""Plans of the learned planner for problems unlike those it was trained on: other maps, teams and numbers of tasks.

python -m benchmarks.bench_general [--count 20] [--cases A,B] [--out benchmarks/results/general.csv]

Greedy plans, with and without looking ahead, and ``search`` for the time of the benchmark (30 and 100 tasks: 5 and 10
s). One row for each plan, resumable; about 40 minutes of one core. Plans of other weights than those that are shipped
now are measured anew.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.rows import Rows
from planner.errors import exit_on_error
from planner.instances import TEST, DataSet, draw_tasks
from planner.policy.shipped import FOLDER, shipped
from planner.presets import TEAMS
from planner.problem import Problem
from planner.solve import Params, Stop, solve, warm_up
from planner.terrain import terrain

FIELDS = ("case", "instance", "row", "network", "makespan_s", "feasible", "planning_s", "outside")
ROWS = {"copcs": {"polish": False}, "copcs-net": {"polish": False, "look_ahead": False}, "search": {}}
OTHER_TEAMS = ((3, 1), (3, 2), (6, 3))
TASKS = {30: 5.0, 100: 10.0}  # number and time of search
TIME_S = {"T15-P5": 1.0, "T45-P10": 5.0}


def with_tasks(one: DataSet, count: int) -> Callable[[int], Problem]:
    """Instances of a data set with another number of tasks."""

    def make(index: int) -> Problem:
        problem = one.instance(index)
        rng = np.random.default_rng([count, index])
        tasks = draw_tasks(problem.sites, count, rng, terrain(one.map_name).side_m)
        return replace(problem, tasks=tasks, visited=np.zeros(count, dtype=np.bool_))

    return make


def cases() -> dict[str, tuple[Callable[[int], Problem], float]]:
    """By name: what makes an instance from its number, and the time of search."""
    found: dict[str, tuple[Callable[[int], Problem], float]] = {}
    for setup, time_s in TIME_S.items():
        for map_name in ("suburban", "urban"):
            for team in TEAMS:
                one = DataSet(setup, team, map_name)
                found[one.name] = one.instance, time_s
        for team in OTHER_TEAMS:
            one = DataSet(setup, team)
            found[one.name] = one.instance, time_s
    for count, time_s in TASKS.items():
        for team in ((2, 2), (4, 2)):
            found[f"T{count}-P10_{team[0]}-{team[1]}"] = with_tasks(DataSet("T45-P10", team), count), time_s
    return found


def main() -> None:
    every = cases()
    parser = argparse.ArgumentParser(description="The learned planner on problems unlike those it was trained on.")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--cases", default=",".join(every))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/general.csv"))
    given = parser.parse_args()
    names = [name.strip() for name in given.cases.split(",")]
    if wrong := [name for name in names if name not in every]:
        parser.error(f"there is no case {wrong[0]!r}; there are {', '.join(every)}")
    if not 0 < given.count <= len(TEST):
        parser.error(f"--count is {given.count}; give 1 to {len(TEST)}")
    for method in ("copcs", "search"):
        warm_up(method)
    network = json.loads((FOLDER / "weights.json").read_text(encoding="utf-8"))["sha256"][:16]
    table = Rows(given.out, FIELDS)
    again = {(name, str(i)) for name in names for i in TEST[: given.count]}
    table.keep(lambda r: r["network"] in ("", network) or (r["case"], r["instance"]) not in again)
    have = {(r["case"], int(r["instance"]), r["row"]) for r in table.rows if r["network"] in ("", network)}
    for k in range(given.count):
        for name in names:
            make, time_s = every[name]
            problem = make(TEST[k])
            for row, options in ROWS.items():
                if (name, TEST[k], row) in have:
                    continue
                method = "search" if row == "search" else "copcs"
                plan = solve(problem, Stop(time_s=time_s), TEST[k], Params(method, options=options)).plan
                mine = row != "search"
                values = (
                    name, TEST[k], row, network if mine else "", round(plan.makespan_s, 3), plan.feasible,
                    round(plan.planning_s or 0.0, 4), (shipped().outside(problem) or "") if mine else "",
                )  # fmt: skip
                table.add(dict(zip(FIELDS, values, strict=True)))
        print(f"\r{k + 1}/{given.count} instances", end="", flush=True)
    print("\n" + markdown([r for r in table.rows if r["network"] in ("", network)], names))


def markdown(rows: list[dict[str, str]], names: list[str]) -> str:
    """The table: mean makespans against search's, over the instances where all plans are feasible."""
    lines = ["| Problems | Feasible | Feasible, left alone | Longer than search | Left alone | Unlike training |",
             "|---|---:|---:|---:|---:|---:|"]  # fmt: skip
    for name in names:
        found: dict[str, dict[str, dict[str, str]]] = {row: {} for row in ROWS}
        for r in rows:
            if r["case"] == name:
                found[r["row"]][r["instance"]] = r
        fine = {row: {i for i, r in x.items() if r["feasible"] == "True"} for row, x in found.items()}
        every = set.intersection(*fine.values())
        if not every:
            continue
        sums = {row: sum(float(x[i]["makespan_s"]) for i in every) for row, x in found.items()}
        shares = (f"{len(fine[row])} of {len(found[row])}" for row in ("copcs", "copcs-net"))
        gaps = (f"{100 * (sums[row] / sums['search'] - 1):.1f} %" for row in ("copcs", "copcs-net"))
        unlike = sum(bool(r["outside"]) for r in found["copcs"].values())
        lines.append(f"| {name} | {' | '.join(shares)} | {' | '.join(gaps)} | {unlike} |")
    return "\n".join(lines)


if __name__ == "__main__":
    exit_on_error(main)
