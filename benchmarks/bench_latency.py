"""Latency from a pose frame to the command that depends on it, with two Crazyflies and two Limos over the real wires.

    python -m benchmarks.bench_latency [--tasks 4] [--out benchmarks/results/latency.json]

A small lab mission is flown in real time against simulated endpoints (CRTP over UDP, ROS 2, NatNet), whose processes
run on the same machine. A pose's stamp is its receipt from the motion-capture client; the turn that used it is over
when every command and every pose has been handed to the drivers. Crazyflies get each pose, and Limos steer by the
newest at 20 Hz.
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from deploy.backends import connect
from deploy.display import NullDisplay
from deploy.mission import Mission, load
from deploy.operator import ScriptedOperator
from deploy.planning import ProcessPlanner
from deploy.planning_settings import replanning
from deploy.runner import Outcome, Tick, fly
from deploy.session import make_checks, make_plan
from drivers.clock import Clock
from planner.plan import Plan
from planner.problem import Problem

LAB = Path(__file__).resolve().parent.parent / "mission_configs" / "lab.yaml"
WARM_S = 60.0


@dataclass
class Stopwatch:
    """Notes, at the end of each turn, how old the poses are that it used.

    Attributes:
        clock: of the loop.
        turns_ms: of turns with fresh poses: from the newest pose's receipt to the turn's end.
        commands_ms: of each command: from its vehicle's newest pose to the turn's end.
    """

    clock: Clock
    bodies: dict[str, str]
    turns_ms: list[float] = field(default_factory=list)
    commands_ms: list[float] = field(default_factory=list)
    newest_s: dict[str, float] = field(default_factory=dict)

    def tick(self, tick: Tick) -> None:
        """One turn is over."""
        now_s = self.clock.now()
        for pose in tick.observation.poses:
            self.newest_s[pose.body] = pose.stamp_s
        if tick.observation.poses:
            self.turns_ms.append(1e3 * (now_s - max(p.stamp_s for p in tick.observation.poses)))
        for command in tick.sent:
            stamp_s = self.newest_s.get(self.bodies[command.vehicle])
            if stamp_s is not None:
                self.commands_ms.append(1e3 * (now_s - stamp_s))

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """A plan is in force."""


def flown(mission: Mission) -> tuple[Stopwatch, Outcome]:
    """Flies ``mission`` over the wires.

    Raises:
        SystemExit: when a check fails.
    """
    plan = make_plan(mission, NullDisplay())
    fleet = connect(mission, "sim", "wire", horizon_s=plan.makespan_s)
    planner = ProcessPlanner(replanning(mission), fleet.planner_delay_s)
    try:
        checks = make_checks(mission, plan, fleet, NullDisplay())
        if not checks.passed:
            raise SystemExit("checks failed: " + "; ".join(f"{row.name}: {row.text}" for row in checks.failures))
        planner.wait_warm(WARM_S)
        fleet.hand_over()
        watch = Stopwatch(fleet.clock, {v.id: v.body for v in mission.settings.vehicles})
        outcome = fly(
            mission.settings,
            plan,
            vehicles=fleet.vehicles,
            poses=fleet.poses,
            clock=fleet.clock,
            planner=planner,
            operator=ScriptedOperator(),
            observer=watch,
            virtual=False,
            linger_s=3.0,
        )
    finally:
        planner.close()
        fleet.close()
    return watch, outcome


def main() -> None:
    """Prints the figures and writes them where wished."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--tasks", type=int, default=4, help="tasks of the lab mission")
    parser.add_argument("--out", type=Path, help="JSON file")
    arguments = parser.parse_args()
    few = {"tasks": {"random": {"count": arguments.tasks, "seed": 2}}, "planner.iterations": 100_000}
    watch, outcome = flown(load(LAB, few))
    turns, commands = np.array(watch.turns_ms), np.array(watch.commands_ms)
    result = {
        "mission": f"lab.yaml with {arguments.tasks} tasks, 2 Crazyflies and 2 Limos",
        "outcome": outcome.kind,
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "turns": outcome.turns,
        "late_turns_share": round(outcome.late_turns / outcome.turns, 5),
        "pose_to_end_of_turn_ms": {"median": _q(turns, 0.5), "p99": _q(turns, 0.99), "n": len(turns)},
        "pose_to_command_ms": {"median": _q(commands, 0.5), "p99": _q(commands, 0.99), "n": len(commands)},
    }
    print(json.dumps(result, indent=1))
    if arguments.out is not None:
        arguments.out.write_text(json.dumps(result, indent=1) + "\n")


def _q(values: np.ndarray[tuple[int], np.dtype[np.float64]], share: float) -> float | None:
    return round(float(np.quantile(values, share)), 2) if len(values) else None


if __name__ == "__main__":
    main()
