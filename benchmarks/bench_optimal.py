"""How often search reaches the optimum where the exact method proves it.

python -m benchmarks.bench_optimal [--count 200] [--time 1.0] [--proof 60] [--out benchmarks/results/optimal.csv]

Small instances: the first 3 to 7 tasks of training instances of the T15-P5 data sets, teams 1-1, 2-1 and 2-2; those
whose optimum needs a recharge are counted apart as well. One row each, resumable. The exact method starts from its own
short search with another seed; search never sees its plan.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace
from pathlib import Path

from benchmarks.rows import Rows
from planner.instances import DataSet
from planner.plan import Recharge
from planner.problem import Problem
from planner.solve import Params, Stop, solve

FIELDS = ("team", "tasks", "instance", "proven", "optimum_s", "proof_s", "search_s", "recharges", "reached")
TEAMS = ((1, 1), (2, 1), (2, 2))
SIZES = (3, 4, 5, 6, 7)
WITHIN = 0.001


def small(team: tuple[int, int], n_tasks: int, index: int) -> Problem:
    """The first tasks of a training instance."""
    problem = DataSet("T15-P5", team).instance(index)
    return replace(problem, tasks=problem.tasks[:n_tasks], visited=problem.visited[:n_tasks])


def measure(team: tuple[int, int], n_tasks: int, index: int, time_s: float, proof_s: float) -> dict[str, object]:
    """One row."""
    problem = small(team, n_tasks, index)
    exact = solve(problem, Stop(time_s=proof_s), index + 10_000, Params("milp", options={"start_s": 0.5})).plan
    found = solve(problem, Stop(time_s=time_s), index).plan
    return {
        "team": f"{team[0]}-{team[1]}",
        "tasks": n_tasks,
        "instance": index,
        "proven": exact.gap == 0.0,
        "optimum_s": round(exact.makespan_s, 3),
        "proof_s": round(exact.planning_s or 0.0, 2),
        "search_s": round(found.makespan_s, 3) if found.feasible else "",
        "recharges": sum(isinstance(a, Recharge) for a in exact.actions),
        "reached": found.feasible and found.makespan_s <= exact.makespan_s * (1 + WITHIN),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="How often search reaches a proven optimum.")
    parser.add_argument("--count", type=int, default=200, help="proven instances wanted")
    parser.add_argument("--time", type=float, default=1.0, help="search time in s")
    parser.add_argument("--proof", type=float, default=60.0, help="time of the exact method in s")
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/optimal.csv"))
    given = parser.parse_args()
    solve(small((1, 1), 3, 0), Stop(iterations=1))  # compiled code is loaded before any clock runs
    table = Rows(given.out, FIELDS)
    have = {(r["team"], int(r["tasks"]), int(r["instance"])) for r in table.rows}
    every = [(team, n, k // 5) for k in range(10_000) for n in SIZES[k % 5 : k % 5 + 1] for team in TEAMS]
    proven = sum(r["proven"] == "True" for r in table.rows)
    for team, n_tasks, index in every:
        if proven >= given.count:
            break
        if (f"{team[0]}-{team[1]}", n_tasks, index) in have:
            continue
        row = measure(team, n_tasks, index, given.time, given.proof)
        table.add(row)
        proven += row["proven"] is True
        print(f"\r{proven}/{given.count} proven", end="", flush=True)
    print()
    summary(table.rows)


def summary(rows: list[dict[str, str]]) -> None:
    """Shares reached, over all proven instances and over those whose optimum needs a recharge."""
    for words, chosen in (("all", rows), ("with recharges", [r for r in rows if int(r["recharges"]) > 0])):
        for team in ("all", *sorted({r["team"] for r in rows})):
            mine = [r for r in chosen if r["proven"] == "True" and team in ("all", r["team"])]
            reached = sum(r["reached"] == "True" for r in mine)
            if mine:
                share = 100 * reached / len(mine)
                print(f"{words:15} team {team:4} reached {reached}/{len(mine)} = {share:.1f} %")
    slowest = max((float(r["proof_s"]) for r in rows if r["proven"] == "True"), default=0.0)
    print("not proven:", dict(Counter(r["team"] for r in rows if r["proven"] != "True")), f"slowest proof {slowest} s")


if __name__ == "__main__":
    main()
