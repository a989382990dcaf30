"""How far search is from what it finds in twenty times the time.

python -m benchmarks.bench_convergence [--count 50] [--sets A,B] [--out benchmarks/results/convergence.csv]

The first test instances of each data set: ``search`` with 1 s (T15) or 5 s (T45), and with 20 s or 100 s and another
seed. One row each, resumable; about 70 minutes of one core for T15, six hours for T45. The best known plan is the
better one of the two.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.rows import Rows
from planner.benchmark import SEARCH_S
from planner.errors import exit_on_error
from planner.instances import DATA_SETS, TEST, data_set
from planner.solve import Stop, solve

FIELDS = ("data_set", "instance", "time_s", "makespan_s", "feasible", "longer_time_s", "longer_s")
LONGER = 20
OTHER_SEED = 10**6


def measure(name: str, index: int) -> dict[str, object]:
    """One row."""
    one = data_set(name)
    problem, time_s = one.instance(index), SEARCH_S[one.setup]
    plan = solve(problem, Stop(time_s=time_s), index).plan
    longer = solve(problem, Stop(time_s=LONGER * time_s), index + OTHER_SEED).plan
    values = (
        name, index, time_s, round(plan.makespan_s, 3), plan.feasible, LONGER * time_s, round(longer.makespan_s, 3)
    )  # fmt: skip
    return dict(zip(FIELDS, values, strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description="How far search is from what it finds in twenty times the time.")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--sets", default=",".join(d.name for d in DATA_SETS))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/convergence.csv"))
    given = parser.parse_args()
    names = [data_set(name.strip()).name for name in given.sets.split(",")]
    solve(DATA_SETS[0].instance(0), Stop(iterations=1))  # compiled code is loaded before any clock runs
    table = Rows(given.out, FIELDS)
    have = {(r["data_set"], int(r["instance"])) for r in table.rows}
    for k in range(given.count):
        for name in names:
            if (name, TEST[k]) not in have:
                table.add(measure(name, TEST[k]))
        print(f"\r{k + 1}/{given.count} instances", end="", flush=True)
    print()
    summary(table.rows)


def summary(rows: list[dict[str, str]]) -> None:
    """Mean gap of each data set, with its standard error."""
    for name in sorted({r["data_set"] for r in rows}):
        mine = [r for r in rows if r["data_set"] == name]
        short = np.array([float(r["makespan_s"]) for r in mine])
        best = np.minimum(short, [float(r["longer_s"]) for r in mine])
        gaps = 100 * (short / best - 1)
        error = gaps.std(ddof=1) / len(gaps) ** 0.5 if len(gaps) > 1 else float("nan")
        fine = sum(r["feasible"] == "True" for r in mine)
        print(f"{name}: {gaps.mean():.2f} ± {error:.2f} % above the best known, {fine}/{len(mine)} feasible")


if __name__ == "__main__":
    exit_on_error(main)
