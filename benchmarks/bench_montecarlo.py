"""The Monte Carlo's time, and its model against flights in the kinematic world.

    python benchmarks/bench_montecarlo.py [--runs 40] [--out benchmarks/results/montecarlo.json]

Each flight gets one sample's battery drains and UGV stalls as faults: flight and sample are a pair. The simulator
adds its own noise, latency and losses, for which the delays stand in the samples. Replans are switched off and reserves
are not guarded, so that the plan is flown as it is; whether a UAV would have come below its reserve is judged
afterwards. Wind and charging times are left out on both sides, since the simulator's faults only know their bad half.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from deploy.backends import connect
from deploy.check_chance import overheads_of
from deploy.check_limits import CERTAIN, Uncertainty
from deploy.mission import Mission, load
from deploy.montecarlo import Draws, Floats, draw, estimate, simulate
from deploy.operator import ScriptedOperator
from deploy.planning import InlinePlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.runner import Tick, fly
from deploy.settings import Replanning
from planner.plan import Move, Plan
from planner.problem import Problem
from sim_backends.faults import Fault, FaultKind

ROOT = Path(__file__).resolve().parent.parent
DRAWN = replace(
    CERTAIN,
    drain=0.05,
    stalls_per_h=2.0,
    stall_s=120.0,
    stall_sigma=0.5,
    departure_s=1.0,
    docking_s=3.0,
    delay_sigma=0.8,
)
"""What both sides draw (drain, stalls), and what stands for the simulator's own noise (the delays)."""
NEVER = 1e9


@dataclass(frozen=True)
class Flight:
    """One flight: end of the last visit in mission s, and each UAV's least energy in J."""

    makespan_s: float
    least_j: tuple[float, ...]
    done: bool


class Watch:
    """Follows the true course of one flight through the loop's status."""

    def __init__(self, n_uavs: int) -> None:
        self.least_j = [math.inf] * n_uavs

    def tick(self, tick: Tick) -> None:
        """Keeps the least energies."""
        for u, row in enumerate(tick.status.vehicles[: len(self.least_j)]):
            self.least_j[u] = min(self.least_j[u], row.energy_j)

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """There is one plan only."""


def drawn_faults(mission: Mission, plan: Plan, draws: Draws, run: int) -> tuple[Fault, ...]:
    """One sample's drains and stalls as the simulator's faults."""
    scale = mission.settings.frame.time_scale
    faults = [
        Fault(FaultKind.BATTERY_DRAIN, vehicle=u.id, value=max(0.2, 1 + DRAWN.drain * float(draws.uav[1, run, i])))
        for i, u in enumerate(mission.problem.uavs)
    ]
    for row in plan.schedule.actions:
        i, act = row.action, plan.actions[row.action]
        drive_s = row.end_s - row.start_s
        stalls = draws.stall_u[run, i] < 1 - math.exp(-DRAWN.stalls_per_h / 3600 * drive_s)
        if isinstance(act, Move) and drive_s > 0 and stalls:
            stall_s = DRAWN.stall_s * math.exp(DRAWN.stall_sigma * float(draws.stall_z[run, i]))
            # In the middle of the drive as planned: at its ends a UGV that runs early or late would be parked.
            at_s = (row.start_s + 0.4 * drive_s) * scale
            vehicle = mission.problem.ugvs[act.ugv].id
            faults.append(Fault(FaultKind.UGV_STALL, vehicle=vehicle, at_s=at_s, duration_s=stall_s * scale))
    return tuple(faults)


def unguarded(mission: Mission, faults: tuple[Fault, ...]) -> Mission:
    """The mission with these faults only, flown as planned: nobody replans and no reserve is kept."""
    settings = mission.settings
    monitors = replace(settings.monitors, energy_margin=0.0, ugv_stuck_s=NEVER)
    problem = replace(mission.problem, uavs=tuple(replace(u, reserve_j=0.0) for u in mission.problem.uavs))
    settings = replace(
        settings, monitors=monitors, problem=problem, replanning=Replanning(loss_ratio=NEVER, loss_s=NEVER)
    )
    return replace(mission, settings=settings, problem=problem, faults=faults, random_faults=None)


def flight(mission: Mission, plan: Plan, draws: Draws, seed: int) -> Flight:
    """Flies the plan once."""
    mission = unguarded(mission, drawn_faults(mission, plan, draws, seed))
    fleet = connect(mission, seed=seed, horizon_s=plan.makespan_s)
    watch = Watch(len(mission.problem.uavs))
    try:
        fleet.connect(30.0)
        outcome = fly(
            mission.settings,
            plan,
            vehicles=fleet.vehicles,
            poses=fleet.poses,
            clock=fleet.clock,
            planner=InlinePlanner(replanning(mission), fleet.planner_delay_s),
            operator=ScriptedOperator(),
            observer=watch,
            virtual=True,
            limit_s=mission.settings.frame.time_scale * (3 * plan.makespan_s + 3600),
        )
    finally:
        fleet.close()
    last = outcome.state.last_visit_s
    return Flight(math.nan if last is None else last, tuple(watch.least_j), outcome.kind == "done")


def plan_of(mission: Mission) -> Plan:
    """The mission's plan, made as for a flight."""
    stop, seed, params = first_plan(mission)
    return plan_with_margin(mission.problem, mission.settings.replanning.margin, stop, seed, params)


def _fly(arguments: tuple[Path, Plan, Draws, int]) -> Flight:
    path, plan, draws, seed = arguments
    return flight(load(path), plan, draws, seed)


def compare(path: Path, plan: Plan, runs: int, workers: int) -> dict[str, object]:
    """Flights against samples."""
    mission = load(path)
    draws = draw(mission.problem, len(plan.actions), runs, seed=1)
    with ProcessPoolExecutor(workers) as pool:
        flights = list(pool.map(_fly, [(path, plan, draws, seed) for seed in range(runs)]))
    drawn = simulate(
        unguarded(mission, ()).problem,
        plan.actions,
        DRAWN,
        overheads=overheads_of(mission.settings),
        draws=draws,
    )
    reserve = np.array([u.reserve_j for u in mission.problem.uavs])
    flown = np.array([f.least_j for f in flights])
    sampled = drawn.land_j.copy()
    for i, act in enumerate(plan.actions):
        if not isinstance(act, Move):
            sampled[:, act.uav] = np.minimum(sampled[:, act.uav], drawn.low_j[:, i])
    done = np.array([f.done for f in flights])
    flown_s = np.array([f.makespan_s for f in flights])
    ratio = flown_s[done] / drawn.makespan_s[done]
    above_flown, above_sampled = (flown >= reserve).all(axis=1), (sampled >= reserve).all(axis=1)

    def quantiles(values: Floats, digits: int) -> list[float]:
        return [round(float(q), digits) for q in np.quantile(values, (0.05, 0.5, 0.95))]

    return {
        "mission": path.name,
        "runs": runs,
        "flown_to_the_end": int(done.sum()),
        "planned_s": round(plan.makespan_s, 1),
        "makespan_flown_s": quantiles(flown_s[done], 1),
        "makespan_sampled_s": quantiles(drawn.makespan_s[done], 1),
        "makespan_flown_to_sampled": quantiles(ratio, 4),
        "least_energy_flown_less_sampled_kj": [
            quantiles((flown - sampled)[done, u] / 1e3, 1) for u in range(len(reserve))
        ],
        "above_reserve_flown": round(float(above_flown.mean()), 3),
        "above_reserve_sampled": round(float(above_sampled.mean()), 3),
        "agree_on_reserve": round(float((above_flown == above_sampled).mean()), 3),
        "empty_in_flight_sampled": round(float((drawn.fail_zero >= 0).mean()), 3),
    }


def time_s(mission: Mission, plan: Plan, samples: int) -> tuple[float, float]:
    """Seconds of the first call (compiling or loading the machine code) and of the median of later ones."""
    times = []
    for seed in range(12):
        begun = time.perf_counter()
        estimate(mission.problem, plan.actions, Uncertainty(), samples=samples, seed=seed)
        times.append(time.perf_counter() - begun)
    return times[0], float(np.median(times[1:]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mission", type=Path, default=ROOT / "mission_configs" / "demo.yaml")
    parser.add_argument("--runs", type=int, default=40, help="flights to compare with; 0 for the time alone")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    mission = load(args.mission)
    plan = plan_of(mission)
    first, later = time_s(mission, plan, 1000)
    result: dict[str, object] = {"samples": 1000, "first_call_s": round(first, 3), "median_s": round(later, 4)}
    print(f"Monte Carlo, {mission.name}, 1000 samples: {1e3 * later:.1f} ms (first call {first:.2f} s)")
    if args.runs:
        result["comparison"] = found = compare(args.mission, plan, args.runs, args.workers)
        print(f"{args.runs} flights, each against its own sample:")
        for key, value in found.items():
            print(f"  {key}: {value}")
    if args.out is not None:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        args.out.write_text(json.dumps(result, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
