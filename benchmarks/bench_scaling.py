"""Search on teams and task numbers far beyond the paper's.

python -m benchmarks.bench_scaling [--sizes 100/4/2,300/8/4,1000/20/10] [--workers 2]
    [--out benchmarks/results/scaling.csv] [--picture docs/scaling.png]

Tasks, UAVs and UGVs on the rural map, with one path point for every four tasks (10 to 40 in all). Each size has its
time; one row each. No plan is shorter than ``least_s``: the routes connect all tasks, so together they are at least as
long as a Steiner tree, which is at least 0.824 times as long as the shortest spanning tree (Chung and Graham 1985);
flown by all UAVs alike, with the recharges that it takes.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import cdist

from planner.instances import draw_tasks
from planner.problem import Problem, Uav, Ugv
from planner.solve import Params, Stop, solve
from planner.terrain import terrain

SIZES = {
    (15, 2, 2): 1.0,
    (45, 4, 2): 5.0,
    (100, 4, 2): 10.0,
    (200, 6, 3): 20.0,
    (300, 8, 4): 30.0,
    (600, 14, 7): 60.0,
    (1000, 20, 10): 120.0,
}
STEINER = 0.824
FIELDS = (
    "tasks", "uavs", "ugvs", "path_points", "time_s", "feasible", "start_s", "makespan_s", "tenth_s", "least_s",
    "steps", "steps_per_s", "planning_s",
)  # fmt: skip


def problem_of(n_tasks: int, n_uavs: int, n_ugvs: int, seed: int = 0) -> Problem:
    """An instance of that size on the rural map."""
    land = terrain("rural")
    sites, distance = land.roads_at(land.spread(min(40, max(10, n_tasks // 4))))
    depot = (float(sites[-1, 0]), float(sites[-1, 1]))
    rng = np.random.default_rng([2026, n_tasks, n_uavs, n_ugvs, seed])
    return Problem(
        depot=depot,
        tasks=draw_tasks(sites, n_tasks, rng, land.side_m),
        path_points=sites[:-1],
        road_distance_m=distance,
        uavs=tuple(Uav(f"uav{i}", depot) for i in range(n_uavs)),
        ugvs=tuple(Ugv(f"ugv{i}") for i in range(n_ugvs)),
    )


def least_s(problem: Problem) -> float:
    """A lower bound of the makespan, see above."""
    metres = STEINER * float(minimum_spanning_tree(cdist(problem.tasks, problem.tasks)).sum())
    uav, ugv = problem.uavs[0], problem.ugvs[0]
    each = metres / len(problem.uavs)
    charges = each / (uav.capacity_j / uav.cruise_w * uav.speed_mps) - 1.0
    return each / uav.speed_mps + max(0.0, charges) * (ugv.charge_s or 0.0)


def measure(size: tuple[int, int, int], time_s: float, workers: int) -> dict[str, object]:
    """One row."""
    problem = problem_of(*size)
    params = Params(options={"workers": workers})
    start = solve(problem, Stop(iterations=0)).plan
    early = solve(problem, Stop(time_s=time_s / 10), 0, params).plan
    result = solve(problem, Stop(time_s=time_s), 0, params)
    values = (
        *size, len(problem.path_points), time_s, result.plan.feasible, round(start.makespan_s, 1),
        round(result.plan.makespan_s, 1), round(early.makespan_s, 1), round(least_s(problem), 1),
        result.iterations, round(result.iterations / result.time_s), round(result.time_s, 2),
    )  # fmt: skip
    return dict(zip(FIELDS, values, strict=True))


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Makespan against size, and steps a second."""
    tasks = [float(str(r["tasks"])) for r in rows]

    def column(name: str) -> list[float]:
        return [float(str(r[name])) / (1e3 if name == "steps_per_s" else 60.0) for r in rows]

    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
    left.plot(tasks, column("start_s"), "o:", color="#b0b0b0", label="first plan")
    left.plot(tasks, column("tenth_s"), "o--", color="#7aa6d6", label="after a tenth of the time")
    left.plot(tasks, column("makespan_s"), "o-", color="#1f5fa8", label="search")
    left.plot(tasks, column("least_s"), ":", color="#555555", label="lower bound")
    for row, x, y in zip(rows, tasks, column("makespan_s"), strict=True):
        words = f"{row['uavs']}-{row['ugvs']}\n{float(str(row['time_s'])):g} s"
        left.annotate(words, (x, y), textcoords="offset points", xytext=(0, -24), ha="center", fontsize=7)
    left.set(xscale="log", yscale="log", xlabel="tasks", ylabel="makespan, min", title="Cost against size")
    left.legend(fontsize=8, loc="upper left", bbox_to_anchor=(0.0, 0.82))
    right.plot(tasks, column("steps_per_s"), "o-", color="#1f5fa8")
    right.set(xscale="log", yscale="log", xlabel="tasks", ylabel="thousand steps a second", title="Speed against size")
    left.set_yticks(minutes := [15, 30, 60, 120, 240], [f"{m}" for m in minutes])
    right.set_yticks(thousands := [10, 30, 100, 300, 1000], [f"{k}" for k in thousands])
    for axes in (left, right):
        axes.grid(alpha=0.3, which="both", linewidth=0.5)
        axes.set_xticks(tasks, [f"{t:g}" for t in tasks])
        axes.minorticks_off()
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description="Search on large teams and task numbers.")
    parser.add_argument("--sizes", default=",".join("/".join(map(str, size)) for size in SIZES))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--out", type=Path)
    parser.add_argument("--picture", type=Path)
    given = parser.parse_args()
    solve(problem_of(15, 2, 2), Stop(iterations=1))  # compiled code is loaded before any clock runs
    rows = []
    for text in given.sizes.split(","):
        n_tasks, n_uavs, n_ugvs = (int(x) for x in text.split("/"))
        size = (n_tasks, n_uavs, n_ugvs)
        rows.append(measure(size, SIZES.get(size, 0.1 * n_tasks), given.workers))
        print(", ".join(f"{k} {v}" for k, v in rows[-1].items()), flush=True)
    if given.out:
        given.out.parent.mkdir(parents=True, exist_ok=True)
        with given.out.open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, FIELDS)
            writer.writeheader()
            writer.writerows(rows)
    if given.picture:
        draw(rows, given.picture)


if __name__ == "__main__":
    main()
