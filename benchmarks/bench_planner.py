"""Planner benchmark: the evaluator's time and the search's quality on the paper's presets.

python benchmarks/bench_planner.py [--time 2] [--instances 10]
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from planner import kernel
from planner.arrays import Arrays, arrays_of, encode
from planner.plan import Action, Move, Recharge, Visit
from planner.presets import PRESETS, TEAMS, preset
from planner.problem import Problem
from planner.schedule import evaluate, predict
from planner.solve import Params, Stop, solve


def hundred_actions(problem: Problem) -> list[Action]:
    """45 visits, 35 recharges and 20 moves in a fixed order, whatever they are worth."""
    rng = np.random.default_rng(0)
    n_uavs, n_ugvs, n_points = len(problem.uavs), len(problem.ugvs), len(problem.path_points)
    actions: list[Action] = [Visit(int(rng.integers(n_uavs)), m) for m in range(problem.n_tasks)]
    actions += [Recharge(int(rng.integers(n_uavs)), int(rng.integers(n_ugvs))) for _ in range(35)]
    actions += [Move(int(rng.integers(n_ugvs)), int(rng.integers(n_points))) for _ in range(20)]
    return [actions[i] for i in rng.permutation(len(actions))]


def evaluator_us(problem: Problem, actions: list[Action], calls: int = 20_000) -> float:
    """Time of the compiled evaluator alone, in microseconds."""
    a: Arrays = arrays_of(problem)
    acts = encode(problem, actions)
    args = (a.world(), a.work(), acts, len(acts), np.inf, np.empty((0, 9)))

    from numba import njit  # noqa: PLC0415  (only to leave the interpreter out of the measurement)

    run = kernel.run

    @njit  # type: ignore[misc,untyped-decorator]
    def loop(n: int, args: tuple[object, ...]) -> None:
        for _ in range(n):
            run(*args)

    loop(1, args)
    begun = time.perf_counter()
    loop(calls, args)
    return (time.perf_counter() - begun) / calls * 1e6


def call_us(function: object, *args: object, calls: int = 300) -> float:
    """Median time of one call, in microseconds."""
    times = []
    for _ in range(calls):
        begun = time.perf_counter()
        function(*args)  # type: ignore[operator]
        times.append(time.perf_counter() - begun)
    return float(np.median(times)) * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description="Times the evaluator and measures the search.")
    parser.add_argument("--time", type=float, default=2.0, help="search time per instance in s")
    parser.add_argument("--instances", type=int, default=10, help="instances per preset and team")
    parser.add_argument("--hover", action="store_true", help="hover waiting and 15 %% reserve")
    given = parser.parse_args()
    begun = time.perf_counter()
    solve(preset("T15-P5"), Stop(iterations=1))
    print(f"first call with import of compiled code: {time.perf_counter() - begun:.1f} s")
    problem = preset("T45-P10", (4, 2))
    actions = hundred_actions(problem)
    print(f"evaluator, {len(actions)} actions: {evaluator_us(problem, actions):.2f} us")
    small = preset("T15-P5", (4, 2))
    plan = solve(small, Stop(iterations=20_000)).plan
    print(f"predict, {len(plan.actions)} actions: {call_us(predict, small, plan.actions):.0f} us")
    print(f"evaluate, {len(plan.actions)} actions: {call_us(evaluate, small, plan.actions):.0f} us")

    def fresh() -> None:
        arrays_of(Problem(**{n: getattr(small, n) for n in small.__dataclass_fields__}))

    print(f"new problem to arrays, 6 vehicles: {call_us(fresh):.0f} us")
    print(f"{'preset':10} {'team':5} {'mean makespan':>14} {'feasible':>9} {'steps/s':>9} {'start':>9}")
    for name in PRESETS:
        for team in TEAMS:
            more = {"waiting": "hover", "reserve_j": 0.15 * 287_700.0} if given.hover else None
            spans, starts, steps, fine = [], [], 0, 0
            for seed in range(given.instances):
                instance = preset(name, team, seed, uav=more)
                first = solve(instance, Stop(iterations=0)).plan
                starts.append(first.makespan_s if first.feasible else float("nan"))
                result = solve(instance, Stop(time_s=given.time), seed, Params("search"))
                steps += result.iterations
                fine += result.plan.feasible
                spans.append(result.plan.makespan_s if result.plan.feasible else float("nan"))
            rate = steps / (given.time * given.instances)
            n = f"{fine}/{given.instances}"
            row = f"{name:10} {team[0]}-{team[1]:<3} {np.nanmean(spans):14.0f} {n:>9} {rate:9.0f}"
            print(f"{row} {np.nanmean(starts):9.0f}", flush=True)


if __name__ == "__main__":
    main()
