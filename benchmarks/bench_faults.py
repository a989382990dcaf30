"""Flies many demo missions with random faults and asks the simulated world itself whether anything unsafe happened.

    python benchmarks/bench_faults.py --runs 200 --faults 3 --out benchmarks/results/faults.json

Each run draws other faults (its number is the seed) on top of the mission's scripted ones, and other noise. A violation
is what ``sim_backends.truth`` records (separation with downwash, geofence, ceiling, an empty battery in the air, a
collision, a crash) unless the vehicle had been lost by a scripted fault before, which nobody could have prevented.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from deploy.backends import connect, faults_of
from deploy.events import Event, EventKind
from deploy.mission import Mission, load
from deploy.operator import ScriptedOperator
from deploy.planning import InlinePlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.runner import Tick, fly
from deploy.state import UavPhase
from planner.plan import Plan
from planner.problem import Problem

ROOT = Path(__file__).resolve().parent.parent
_MISSION: list[Mission] = []
_PLAN: list[Plan] = []


class Log:
    """Keeps the events of a run."""

    def __init__(self) -> None:
        self.events: list[Event] = []

    def tick(self, tick: Tick) -> None:
        """Takes the events of one turn."""
        self.events.extend(tick.events)

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Plans are told as events, too."""


def one(mission: Mission, plan: Plan, seed: int) -> dict[str, Any]:
    """One run in numbers."""
    fleet = connect(mission, seed=seed, horizon_s=plan.makespan_s)
    log = Log()
    begun_s = time.perf_counter()
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
            observer=log,
            virtual=True,
            limit_s=mission.settings.frame.time_scale * (4 * plan.makespan_s + 3600),
        )
        assert fleet.truth is not None  # the kinematic world knows
        truth = fleet.truth()
    finally:
        fleet.close()
    # A UAV that is lost, neither seen nor heard, comes down by its own failsafe when it will.
    lost = {c.id for u, c in zip(outcome.state.uavs, mission.settings.uavs, strict=True) if u.phase is UavPhase.LOST}
    flying = [v for v, t in truth.vehicles.items() if t.airborne and v not in lost]
    return {
        "seed": seed,
        "outcome": outcome.kind,
        "visited": sum(outcome.state.visited),
        "tasks": len(outcome.state.visited),
        "makespan_s": outcome.state.last_visit_s,
        "simulated_s": truth.time_s,
        "wall_s": round(time.perf_counter() - begun_s, 3),
        "violations": [
            {"time_s": v.time_s, "kind": v.kind, "vehicles": v.vehicles, "value": v.value, "cause": v.cause}
            for v in truth.violations
            if not v.scripted
        ],
        "still_flying": flying,
        "faults": [f"{f.kind.value} {f.vehicle or ''} at {f.at_s:.0f} s" for f in faults_of(mission, plan.makespan_s)],
        "replans": sum(e.kind is EventKind.PLAN_ADOPTED for e in log.events),
    }


def _start(path: str, faults: int) -> None:
    _MISSION[:] = [load(path)]
    mission = _MISSION[0]
    stop, seed, params = first_plan(mission)
    _PLAN[:] = [plan_with_margin(mission.problem, mission.settings.replanning.margin, stop, seed, params)]
    _FAULTS[:] = [faults]


_FAULTS: list[int] = []


def _job(arguments: tuple[str, int]) -> dict[str, Any]:
    path, seed = arguments
    mission = load(path, {"random_faults": {"count": _FAULTS[0], "seed": seed}, "seed": _MISSION[0].seed})
    return one(mission, _PLAN[0], seed)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--mission", default=str(ROOT / "mission_configs" / "demo.yaml"))
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--faults", type=int, default=3, help="random faults in each run")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    jobs = [(args.mission, args.first + i) for i in range(args.runs)]
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(args.jobs, initializer=_start, initargs=(args.mission, args.faults)) as pool:
        for row in pool.map(_job, jobs):
            rows.append(row)
            for v in row["violations"]:
                who = ", ".join(v["vehicles"])
                print(f"seed {row['seed']}: {v['kind']} of {who} at {v['time_s']:.1f} s ({v['cause']})")
            if row["still_flying"]:
                print(f"seed {row['seed']}: still in the air: {row['still_flying']}")
    unsafe = [r for r in rows if r["violations"] or r["still_flying"]]
    visited = sum(r["visited"] for r in rows) / sum(r["tasks"] for r in rows)
    summary = {
        "mission": Path(args.mission).name,
        "runs": len(rows),
        "faults_per_run": args.faults,
        "runs_with_violations": len(unsafe),
        "tasks_visited_share": round(visited, 4),
        "outcomes": dict(Counter(r["outcome"] for r in rows)),
        "simulated_s": round(sum(r["simulated_s"] for r in rows)),
        "wall_s": round(sum(r["wall_s"] for r in rows), 1),
    }
    print(json.dumps(summary, indent=1))
    if args.out:
        args.out.parent.mkdir(parents=True, exist_ok=True)
        lines = ",\n".join(json.dumps(row) for row in rows)
        text = f'{{"summary": {json.dumps(summary)},\n"runs": [\n{lines}\n]}}\n'
        args.out.write_text(text, encoding="utf-8")
    return 1 if unsafe else 0


if __name__ == "__main__":
    raise SystemExit(main())
