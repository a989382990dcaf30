"""Whole flights of the lab in the simulated world under drawn faults: how they end, and that they replay."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deploy.backends import connect
from deploy.gate import GateState, judge
from deploy.mission import Mission, load
from deploy.observation import Observation
from deploy.operator import ScriptedOperator
from deploy.planning import InlinePlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.runner import Tick, fly
from deploy.serial import decode, encode
from deploy.state import UAV_FINAL
from deploy.supervisor import initial, step
from planner.plan import Plan
from planner.problem import Problem

LAB = Path(__file__).resolve().parents[2] / "mission_configs" / "lab.yaml"


@cache
def lab_plan() -> Plan:
    mission = load(LAB)
    return plan_with_margin(mission.problem, mission.settings.replanning.margin, *first_plan(mission))


class Tape:
    """Keeps every turn."""

    def __init__(self) -> None:
        self.ticks: list[Tick] = []

    def tick(self, tick: Tick) -> None:
        self.ticks.append(tick)

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Plans are in the events."""


def replayed(mission: Mission, tape: Tape) -> None:
    """Steps through the observations as a recording keeps them: the same commands, verdicts and events come out."""
    state, gate = initial(mission.settings, lab_plan()), GateState()
    for tick in tape.ticks:
        observation = decode(Observation, encode(tick.observation))
        result = step(mission.settings, state, observation)
        verdict = judge(mission.settings, gate, observation, result.commands)
        assert (result.commands, result.events) == (tick.emitted, tick.events)
        assert (verdict.accepted, verdict.refused) == (tick.accepted, tick.refusals)
        state, gate = result.state, verdict.state


SEEDS, FAULTS = st.integers(0, 10_000), st.integers(1, 5)


@settings(max_examples=3, deadline=None)
@given(seed=SEEDS, faults=FAULTS)
def test_every_flight_ends_with_everybody_down_and_replays(seed: int, faults: int) -> None:
    _flown_and_replayed(seed, faults)


@pytest.mark.slow
@settings(max_examples=25, deadline=None)
@given(seed=SEEDS, faults=FAULTS)
def test_many_flights_end_with_everybody_down_and_replay(seed: int, faults: int) -> None:
    _flown_and_replayed(seed, faults)


def _flown_and_replayed(seed: int, faults: int) -> None:
    mission = load(LAB, {"random_faults": {"count": faults, "seed": seed}})
    fleet = connect(mission, seed=seed, horizon_s=lab_plan().makespan_s)
    fleet.connect(30.0)
    tape = Tape()
    outcome = fly(
        mission.settings,
        lab_plan(),
        vehicles=fleet.vehicles,
        poses=fleet.poses,
        clock=fleet.clock,
        planner=InlinePlanner(replanning(mission), fleet.planner_delay_s),
        operator=ScriptedOperator(),
        observer=tape,
        virtual=True,
        limit_s=3_000.0,
        linger_s=10.0,
    )
    assert outcome.state.over
    assert all(u.phase in UAV_FINAL for u in outcome.state.uavs)
    assert fleet.truth is not None
    truth = fleet.truth()
    assert not [name for name, vehicle in truth.vehicles.items() if vehicle.airborne]
    replayed(mission, tape)
