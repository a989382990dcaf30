"""Speed of the loop: simulation against real time, and the time of one ``step`` for 6 and for 40 vehicles.

python benchmarks/bench_loop.py [--quick]
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from deploy import supervisor
from deploy.backends import connect
from deploy.mission import Mission, load
from deploy.operator import ScriptedOperator
from deploy.planning import InlinePlanner
from deploy.planning_settings import first_plan, replanning
from deploy.runner import Tick, fly
from deploy.session import run_mission
from planner.plan import Plan
from planner.problem import Problem
from planner.solve import solve

DEMO = Path(__file__).parent.parent / "mission_configs" / "demo.yaml"


class Nobody:
    """Watches nothing, so that only the loop is measured."""

    def tick(self, tick: Tick) -> None:
        """Nothing."""

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Nothing."""


@contextmanager
def timed_steps() -> Iterator[list[float]]:
    """Collects the time of every ``supervisor.step`` in s."""
    times: list[float] = []
    real = supervisor.step

    def step(*args: Any) -> Any:
        begun = time.perf_counter()
        result = real(*args)
        times.append(time.perf_counter() - begun)
        return result

    supervisor.step = step
    try:
        yield times
    finally:
        supervisor.step = real


def team(n_uavs: int, n_ugvs: int, n_tasks: int) -> Mission:
    """The demo with another team."""
    vehicles = {f"uav{i}": {"type": "quad"} for i in range(n_uavs)} | {
        f"ugv{j}": {"type": "rover"} for j in range(n_ugvs)
    }
    fleet = {"types": {"quad": {"kind": "uav"}, "rover": {"kind": "ugv"}}, "vehicles": vehicles}
    changes = {
        "fleet": fleet,
        "faults": [],
        "tasks": {"random": {"count": n_tasks, "seed": 5}, "max_distance_m": 6500.0},
    }
    return load(DEMO, {**changes, "planner.iterations": 20_000, "planner.replan.iterations": 5_000})


def step_times_ms(mission: Mission, limit_s: float) -> np.ndarray[Any, np.dtype[np.float64]]:
    """Time of each step of a flight of at the most ``limit_s``, in ms."""
    stop, seed, params = first_plan(mission)
    plan = solve(mission.problem, stop, seed, params).plan
    fleet = connect(mission, horizon_s=plan.makespan_s)
    fleet.connect(10.0)
    with timed_steps() as times:
        fly(
            mission.settings,
            plan,
            vehicles=fleet.vehicles,
            poses=fleet.poses,
            clock=fleet.clock,
            planner=InlinePlanner(replanning(mission)),
            operator=ScriptedOperator(),
            observer=Nobody(),
            virtual=True,
            limit_s=limit_s,
        )
    return np.array(times) * 1e3


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="shorter flights")
    limit_s = 300.0 if parser.parse_args().quick else 1200.0

    mission = load(DEMO)
    with tempfile.TemporaryDirectory() as folder:
        run_mission(mission, out=Path(folder) / "warm", with_report=False)  # compiles what is not compiled yet
        with timed_steps() as times:
            begun = time.perf_counter()
            result = run_mission(mission, out=Path(folder) / "run", with_report=False)
            took_s = time.perf_counter() - begun
    if result.outcome is None or result.truth is None:
        failed = ", ".join(row.name for row in result.checks.failures)
        raise SystemExit(f"the demo was not flown: checks failed: {failed}")
    flown_s = result.truth.time_s
    print(
        f"demo, planned, checked, flown and recorded: {flown_s:.0f} s in {took_s:.1f} s, "
        f"{flown_s / took_s:.0f} times real time (target 500); {result.outcome.turns} turns, "
        f"{100 * sum(times) / took_s:.0f} % of the time in step"
    )
    for n_uavs, n_ugvs, n_tasks in ((4, 2, 15), (26, 14, 60)):
        ms = step_times_ms(team(n_uavs, n_ugvs, n_tasks), limit_s)
        target = " (target p99 < 2 ms)" if n_uavs + n_ugvs == 6 else ""
        print(
            f"step, {n_uavs + n_ugvs} vehicles: median {np.median(ms):.2f} ms, "
            f"99th percentile {np.quantile(ms, 0.99):.2f} ms{target}, {len(ms)} turns"
        )


if __name__ == "__main__":
    main()
