"""Replanning from mid-mission states of T45-P10 4-2: how long it takes, and what it gains on the plan in force.

python -m benchmarks.bench_replan [--count 200] [--time 0.08] [--out benchmarks/results/replan.json]

States are drawn by ``planner.midway`` from the test instances: a quickly made plan at a random moment, and its rest as
the plan to start from. The time is that of the whole call, from the problem as objects to the plan with its schedule.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from planner.instances import TEST, data_set
from planner.midway import midway
from planner.schedule import evaluate
from planner.solve import Params, Stop, solve


def main() -> None:
    parser = argparse.ArgumentParser(description="Times replanning in mid-mission.")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--time", type=float, default=0.08, help="time for the search in s")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    one = data_set("T45-P10_4-2")
    solve(one.instance(0), Stop(iterations=1))  # compiled code is loaded before any clock runs
    took, gains, feasible, left = [], [], 0, []
    for k in range(given.count):
        problem, rest = midway(one.instance(TEST[k % len(TEST)]), k)
        before = evaluate(problem, rest).makespan_s
        fresh = replace(problem)  # nothing about it is kept from the evaluation before
        begun = time.perf_counter()
        plan = solve(fresh, Stop(time_s=given.time), k, Params(start=rest)).plan
        took.append(1e3 * (time.perf_counter() - begun))
        feasible += plan.feasible
        gains.append(100.0 * (1.0 - plan.makespan_s / before))
        left.append(int((~problem.visited).sum()))
    found = {
        "states": given.count,
        "tasks_left_mean": round(float(np.mean(left)), 1),
        "feasible": feasible,
        "improved": sum(g > 1e-6 for g in gains),
        "worse": sum(g < -0.1 for g in gains),
        "ms_median": round(float(np.median(took)), 1),
        "ms_p99": round(float(np.percentile(took, 99)), 1),
        "ms_max": round(max(took), 1),
        "shorter_percent_mean": round(float(np.mean(gains)), 1),
    }
    print(json.dumps(found, indent=1))
    if given.out:
        given.out.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
