"""The virtual clock may skip turns: what is decided, and in which order, is the same as at 50 Hz."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.backends import faults_of, world_of
from deploy.events import EventKind
from deploy.mission import load
from deploy.operator import ScriptedOperator, Wish
from deploy.planning import InlinePlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.runner import Outcome, Tick, fly
from deploy.state import UAV_FINAL
from drivers.vehicle import Command, Dock, Drive, GoTo, TakeOff
from planner.plan import Plan
from planner.problem import Problem
from sim_backends.kinematic import build

CONFIGS = Path(__file__).resolve().parents[2] / "mission_configs"
DECISIONS = {
    EventKind.MISSION_STATE,
    EventKind.TASK_VISITED,
    EventKind.RECHARGE_STARTED,
    EventKind.RECHARGE_DONE,
    EventKind.UGV_ARRIVED,
    EventKind.UAV_DOWN,
    EventKind.PLAN_ADOPTED,
    EventKind.UGV_STUCK,
    EventKind.POSE_STALE,
    EventKind.POSE_LOST,
}


NEAR_M = 0.4  # targets beside a UGV that is arriving are corrected as it comes: as often as there are turns


class Decisions:
    """Keeps each vehicle's motion commands and each decisive event, in order, with their times."""

    def __init__(self) -> None:
        self.turns = 0
        self.orders: dict[str, list[tuple[float, Command]]] = {}
        self.events: list[tuple[float, str]] = []

    def tick(self, tick: Tick) -> None:
        self.turns += 1
        now_s = tick.observation.now_s
        for command in tick.sent:
            if isinstance(command, TakeOff | GoTo | Dock | Drive):
                log = self.orders.setdefault(command.vehicle, [])
                # a lost command is repeated, which is no new decision; nor is a small correction
                if not log or not alike(log[-1][1], command):
                    log.append((now_s, command))
        for event in tick.events:
            if event.kind in DECISIONS:
                text = (
                    ""
                    if event.kind in (EventKind.PLAN_ADOPTED, EventKind.RECHARGE_STARTED)
                    else event.text.split("(")[0]
                )
                self.events.append((now_s, f"{event.kind} {event.vehicle} {text}"))

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Told as an event, too."""


def alike(a: Command, b: Command) -> bool:
    """Whether two motion commands are of one kind and lead to one place."""
    return type(a) is type(b) and math.dist(target(a), target(b)) < NEAR_M


def target(command: Command) -> tuple[float, ...]:
    match command:
        case GoTo(position_m=position):
            return position
        case Drive(path_m=path):
            return path[-1]
        case _:
            return (0.0,)


def fly_it(
    mission_file: str, *, every_turn: bool, script: Sequence[tuple[float, Wish]] = (), limit_s: float = 10_000.0
) -> tuple[Outcome, Decisions]:
    mission = load(CONFIGS / mission_file)
    plan = plan_with_margin(mission.problem, mission.settings.replanning.margin, *first_plan(mission))
    # Without lost commands: which one is lost depends on the very moment at which it is sent.
    fleet = build(replace(world_of(mission, mission.seed), command_drop=0.0), faults_of(mission, plan.makespan_s))
    fleet.poses.connect(30.0)
    for vehicle in fleet.vehicles.values():
        vehicle.connect(30.0)
    log, operator = Decisions(), ScriptedOperator(script)
    operator.attach(fleet.clock)
    outcome = fly(
        mission.settings,
        plan,
        vehicles=fleet.vehicles,
        poses=fleet.poses,
        clock=fleet.clock,
        planner=InlinePlanner(replanning(mission), fleet.planner_delay_s),
        operator=operator,
        observer=log,
        virtual=not every_turn,
        limit_s=limit_s,
    )
    return outcome, log


def compare(mission_file: str, within_s: float) -> None:
    """Orders and events up to the first new plan are the same; that plan is made from states some cm apart."""
    fine_outcome, fine = fly_it(mission_file, every_turn=True)
    coarse_outcome, coarse = fly_it(mission_file, every_turn=False)
    assert coarse.turns < fine.turns / 3
    assert coarse_outcome.kind == fine_outcome.kind == "done"
    fine_s, coarse_s = fine_outcome.state.last_visit_s, coarse_outcome.state.last_visit_s
    assert fine_s is not None and coarse_s == pytest.approx(fine_s, rel=0.06)
    replans_s = [t for log in (fine, coarse) for t, e in log.events if e.startswith(EventKind.PLAN_ADOPTED)]
    until_s = min(replans_s, default=1e9) - within_s
    compared = 0
    for vehicle, orders in fine.orders.items():
        for (a_s, a), (b_s, b) in zip(orders, coarse.orders[vehicle], strict=False):
            if max(a_s, b_s) < until_s:
                assert alike(a, b)
                assert abs(a_s - b_s) <= within_s
                compared += 1
    assert compared >= 6  # the demo replans early
    if not replans_s:
        assert sorted(e for _, e in coarse.events) == sorted(e for _, e in fine.events)


def test_the_lab_is_decided_alike_at_50_hz_and_from_event_to_event() -> None:
    compare("lab.yaml", within_s=2.5)


def test_a_mission_held_for_ever_is_brought_down_at_its_limit() -> None:
    outcome, log = fly_it("lab.yaml", every_turn=False, script=[(10.0, "hold")], limit_s=30.0)
    assert outcome.kind == "aborted" and all(u.phase in UAV_FINAL for u in outcome.state.uavs)
    assert any("recovering" in e for _, e in log.events)


@pytest.mark.slow
def test_the_demo_is_decided_alike_at_50_hz_and_from_event_to_event() -> None:
    compare("demo.yaml", within_s=10.0)
