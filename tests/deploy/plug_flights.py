"""Flights over the real protocols whose plugs are pulled in the air: what was told, sent and done, and how soon."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import yaml

from deploy.backends import world_of
from deploy.check_vehicles import settle
from deploy.events import Event, EventKind
from deploy.mission import Mission, load
from deploy.operator import ScriptedOperator
from deploy.planning import ProcessPlanner
from deploy.planning_settings import replanning
from deploy.real_fleet import fleet_of
from deploy.runner import Outcome, Tick, fly
from deploy.wire import launch_mission, mocap_of, places_of
from drivers.clock import Clock, RealClock
from drivers.vehicle import Command
from planner.plan import Action, Plan
from planner.problem import Problem
from planner.schedule import evaluate
from sim_backends.truth import Truth
from sim_backends.wire.launch import WireSimulation
from sim_backends.wire.world import Body

CONFIGS = Path(__file__).resolve().parents[2] / "mission_configs"
ALLOWANCE_S = 0.3
"""What a reaction may take beyond its threshold: two turns of the loop, a period of poses or telemetry, and two busy
cores. How late the loop itself ran meanwhile comes on top; a monitor of its own watches that."""
STEADY_S = 2.0
"""So long after the last word about a plan nobody is turned round by it any more."""
WARM_S, LIMIT_S = 60.0, 120.0
Script = Iterator[None]


def mission_of(
    name: str, vehicles: Sequence[str], tasks: Sequence[tuple[float, float]], **overrides: object
) -> Mission:
    """A shipped mission with fewer vehicles and its own tasks; further overrides by key, dots as two underscores."""
    fleet = yaml.safe_load((CONFIGS / "fleets" / f"{name}.yaml").read_text())
    fleet["vehicles"] = {v: fleet["vehicles"][v] for v in vehicles}
    for kind in fleet["types"].values():
        kind["capacity_j"] = 4 * kind["capacity_j"]  # these flights are about plugs, not about batteries
    more = {key.replace("__", "."): value for key, value in overrides.items()}
    wanted = {"fleet": fleet, "tasks": {"points": [list(t) for t in tasks]}, "planner.iterations": 100_000, **more}
    return load(CONFIGS / f"{name}.yaml", wanted)


class Expected(Protocol):
    """Something that must follow a pulled plug within ``within_s``."""

    @property
    def what(self) -> str:
        """What, and of whom."""
        ...

    @property
    def label(self) -> str:
        """What, whoever it is."""
        ...

    @property
    def within_s(self) -> float:
        """The threshold after which it must come."""
        ...

    def seen(self, tick: Tick, bodies: Mapping[str, Body]) -> bool:
        """Whether this turn shows it."""
        ...


@dataclass(frozen=True)
class Told:
    """An event about a vehicle."""

    kind: EventKind
    vehicle: str
    within_s: float

    @property
    def what(self) -> str:
        return f"{self.label} of {self.vehicle}"

    @property
    def label(self) -> str:
        return self.kind.value.replace("_", " ")

    def seen(self, tick: Tick, bodies: Mapping[str, Body]) -> bool:
        return any(e.kind is self.kind and e.vehicle == self.vehicle for e in tick.events)


@dataclass(frozen=True)
class Sent:
    """A command to a vehicle."""

    command: type[Command]
    vehicle: str
    within_s: float

    @property
    def what(self) -> str:
        return f"{self.label} to {self.vehicle}"

    @property
    def label(self) -> str:
        return self.command.__name__

    def seen(self, tick: Tick, bodies: Mapping[str, Body]) -> bool:
        return any(isinstance(c, self.command) and c.vehicle == self.vehicle for c in tick.sent)


@dataclass(frozen=True)
class Asked:
    """A replan without a vehicle."""

    uav: int | None
    ugv: int | None
    within_s: float
    what: str = "replan without it"
    label: str = "replan without it"

    def seen(self, tick: Tick, bodies: Mapping[str, Body]) -> bool:
        request = tick.request
        return request is not None and (self.uav in request.exclude_uavs or self.ugv in request.exclude_ugvs)


@dataclass(frozen=True)
class Really:
    """An effect in the simulated world, which the ground station does not see."""

    label: str
    vehicle: str
    true: Callable[[Body], bool]
    within_s: float

    @property
    def what(self) -> str:
        return f"{self.vehicle} {self.label}"

    def seen(self, tick: Tick, bodies: Mapping[str, Body]) -> bool:
        return self.true(bodies[self.vehicle])


@dataclass
class Pull:
    """One plug, and what followed.

    Attributes:
        name: in words.
        at_s: when it was pulled, on the loop's clock.
        after_s: per expected reaction, how long after; None while it has not come.
        late_s: the most that the loop was late meanwhile.
    """

    name: str
    at_s: float
    expected: tuple[Expected, ...]
    after_s: dict[str, float | None]
    late_s: float = 0.0
    notes: dict[str, float] = field(default_factory=dict)

    @property
    def complete(self) -> bool:
        """Everything expected has come."""
        return None not in self.after_s.values()

    def check(self) -> None:
        """Everything has come in time."""
        for e in self.expected:
            after_s = self.after_s[e.what]
            assert after_s is not None, f"{self.name}: {e.what} never came (wanted within {e.within_s:g} s)"
            limit_s = e.within_s + ALLOWANCE_S + self.late_s
            assert after_s <= limit_s, f"{self.name}: {e.what} came after {after_s:.2f} s (wanted within {limit_s:.2f})"


class Flight:
    """One flight and its script; an observer of the loop.

    The script is a generator that is resumed after each turn; it waits with ``yield from until(...)``.
    """

    def __init__(self, simulation: WireSimulation, clock: Clock, script: Callable[[Flight], Script]) -> None:
        self.simulation, self.clock = simulation, clock
        self.now_s = clock.now()
        self.events: list[Event] = []
        self.phases: dict[str, str] = {}
        self.bodies: dict[str, Body] = {}
        self.pulls: dict[str, Pull] = {}
        self.visited = 0
        self.age_s = 0.0
        """The oldest telemetry that any turn had to do with, since it was set to 0 last."""
        self.finished = False
        self.outcome: Outcome
        self.truth: Truth
        self._script = script(self)

    # --- what scripts use

    def pull(self, name: str, *expected: Expected, do: Callable[[], None]) -> Pull:
        """Pulls a plug."""
        pull = Pull(name, self.clock.now(), expected, {e.what: None for e in expected})
        self.pulls[name] = pull
        do()
        return pull

    def until(self, condition: Callable[[], bool], limit_s: float = LIMIT_S) -> Script:
        """Waits for a condition, at most so long: what is missing then shows in the tests."""
        end_s = self.now_s + limit_s
        while not condition() and self.now_s < end_s:
            yield

    def after(self, pull: Pull, least_s: float = 0.0, spare_s: float = 5.0) -> Script:
        """Waits until everything expected has come, at least and at most so long."""
        limit_s = max((e.within_s for e in pull.expected), default=0.0) + spare_s
        yield from self.until(lambda: pull.complete and self.now_s >= pull.at_s + least_s, max(limit_s, least_s))

    def modify(self, vehicles: Sequence[str], **modifiers: Any) -> None:
        """Sets a fault's modifiers in the world, others stay."""
        world = self.simulation.world
        for vehicle in vehicles:
            row = world.row(vehicle)
            world.modify(row, replace(world.modifiers(row), **modifiers))

    def signal(self, name: str, number: int) -> None:
        """Sends a signal to an endpoint's process."""
        self.simulation.process(name).send_signal(number)

    def moving(self, *vehicles: str) -> bool:
        """Whether these fly or drive, by the ground station and in truth."""
        return all(self.phases.get(v) in ("flying", "driving") and self.bodies[v].speed_mps > 0.1 for v in vehicles)

    def steady(self, *vehicles: str) -> bool:
        """Whether these move on, and no new plan is about to turn them round: what follows comes of the plug."""
        plans = [e.time_s for e in self.events if e.kind in (EventKind.PLAN_REQUESTED, EventKind.PLAN_ADOPTED)]
        return self.moving(*vehicles) and self.now_s > max(plans, default=0.0) + STEADY_S

    # --- the observer

    def tick(self, tick: Tick) -> None:
        """One turn is over."""
        self.now_s = self.clock.now()
        world = self.simulation.world
        self.bodies = dict(zip(world.ids, world.bodies(), strict=True))
        self.phases = {v.vehicle: v.phase for v in tick.status.vehicles}
        self.events.extend(tick.events)
        self.visited = sum(tick.status.tasks_visited)
        ages = [tick.observation.now_s - v.stamp_s for v in tick.observation.vehicles]
        self.age_s = max([self.age_s, *ages])
        for pull in self.pulls.values():
            if not pull.complete:
                pull.late_s = max(pull.late_s, tick.observation.late_s)
            for e in pull.expected:
                if pull.after_s[e.what] is None and e.seen(tick, self.bodies):
                    pull.after_s[e.what] = self.now_s - pull.at_s
        self.finished = self.finished or next(self._script, self) is self

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Plans are in the events."""

    # --- what tests ask

    def kinds(self, vehicle: str | None = None) -> set[EventKind]:
        """What was told, about one vehicle or everybody."""
        return {e.kind for e in self.events if vehicle in (None, e.vehicle)}

    def story(self) -> str:
        """The events, for a test that fails."""
        lines = [f"{e.time_s:7.2f} {e.kind.value}: {e.text}" for e in self.events]
        return "\n".join(["", *map(str, self.truth.violations), *lines])

    def nobody_is_harmed(self, *but: str) -> None:
        """Everybody, except whose process was killed, is down and whole, and no rule was broken that could be kept."""
        avoidable = [v for v in self.truth.violations if not v.scripted]
        assert avoidable == [], self.story()
        for name, vehicle in self.truth.vehicles.items():
            assert not vehicle.airborne, f"{name} still flies\n{self.story()}"
            if name not in but:
                assert not vehicle.tumbled and not vehicle.locked, f"{name} is harmed\n{self.story()}"


def flown(mission: Mission, actions: Sequence[Action], script: Callable[[Flight], Script]) -> Flight:
    """Flies ``actions`` over the real protocols and ``script`` with them, until everybody is down."""
    plan = Plan(tuple(actions), evaluate(mission.problem, actions), "by hand")
    assert plan.feasible, plan.schedule.violation
    clock = RealClock()
    planner = ProcessPlanner(replanning(mission))  # starts while the simulation does
    try:
        zero_s = time.monotonic() - clock.now()
        simulation = launch_mission(mission, world_of(mission, mission.seed), (), zero_s=zero_s)
    except BaseException:
        planner.close()
        raise
    fleet = fleet_of(mission, clock, "wire", places_of(simulation), mocap_of(simulation))
    fleet.end = simulation.close
    try:
        errors = fleet.connect()
        assert errors == {}
        settle(fleet)
        planner.wait_warm(WARM_S)
        fleet.hand_over()
        flight = Flight(simulation, clock, script)
        flight.outcome = fly(
            mission.settings,
            plan,
            vehicles=fleet.vehicles,
            poses=fleet.poses,
            clock=clock,
            planner=planner,
            operator=ScriptedOperator(),
            observer=flight,
            virtual=False,
            limit_s=clock.now() + LIMIT_S,
            linger_s=3.0,
        )
        _wait_down(flight)
    finally:
        planner.close()
        fleet.close()
    flight.truth = simulation.truth()
    print(flight.story())
    _write(mission.name, flight)
    return flight


def _wait_down(flight: Flight, limit_s: float = 60.0) -> None:
    """Who cannot be commanded any more comes down by itself, maybe later than the mission ends."""
    world, end_s = flight.simulation.world, time.monotonic() + limit_s
    while any(b.airborne for b in world.bodies()) and time.monotonic() < end_s:
        time.sleep(0.1)


def _write(mission: str, flight: Flight) -> None:
    """Prints the reaction times, and appends them to the file that ``COPCS_PLUGS`` names."""
    rows = [
        {
            "mission": mission,
            "plug": pull.name,
            "late_s": round(pull.late_s, 3),
            "reactions": [
                {
                    "kind": type(e).__name__.lower(),
                    "label": e.label,
                    "what": e.what,
                    "limit_s": e.within_s,
                    "after_s": _rounded(pull.after_s[e.what]),
                }
                for e in pull.expected
            ],
            **{key: round(value, 3) for key, value in pull.notes.items()},
        }
        for pull in flight.pulls.values()
    ]
    for row in rows:
        print(json.dumps(row))
    target = os.environ.get("COPCS_PLUGS")
    if target:
        with Path(target).open("a") as file:
            file.writelines(json.dumps(row) + "\n" for row in rows)


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 3)
