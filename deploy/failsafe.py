"""The failsafe table: event x phase -> action. Read it from top to bottom; the operator's manual prints it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

from deploy.events import Action, EventKind, Severity
from deploy.state import UavPhase, UgvPhase


class Situation(StrEnum):
    """The phases of the table: what a vehicle is doing, as far as it matters for what to do about an event."""

    GROUND = "ground"  # a UAV on a pad, charging, or down
    AIR = "air"  # taking off, flying, waiting
    DOCKING = "docking"
    LANDING = "landing"
    DRIVING = "driving"  # a UGV under way or stopped between path points
    PARKED = "parked"
    GONE = "gone"  # a lost vehicle
    MISSION = "mission"  # not about one vehicle


UAV_SITUATION: Mapping[UavPhase, Situation] = MappingProxyType(
    {
        UavPhase.ON_PAD: Situation.GROUND,
        UavPhase.TAKING_OFF: Situation.AIR,
        UavPhase.FLYING: Situation.AIR,
        UavPhase.WAITING: Situation.AIR,
        UavPhase.DOCKING: Situation.DOCKING,
        UavPhase.CHARGING: Situation.GROUND,
        UavPhase.LANDING: Situation.LANDING,
        UavPhase.DOWN: Situation.GROUND,
        UavPhase.LOST: Situation.GONE,
    }
)
UGV_SITUATION: Mapping[UgvPhase, Situation] = MappingProxyType(
    {
        UgvPhase.PARKED: Situation.PARKED,
        UgvPhase.DRIVING: Situation.DRIVING,
        UgvPhase.HOLDING: Situation.DRIVING,
        UgvPhase.LOST: Situation.GONE,
    }
)


@dataclass(frozen=True, slots=True)
class Row:
    """One event: how loud it is, what is done about it in each situation, and why."""

    severity: Severity
    actions: Mapping[Situation, Action]
    why: str
    default: Action = Action.NOTE


def _row(severity: Severity, why: str, default: Action = Action.NOTE, **actions: Action) -> Row:
    return Row(severity, MappingProxyType({Situation(k): v for k, v in actions.items()}), why, default)


N, W, E, C = Severity.INFO, Severity.WARNING, Severity.ERROR, Severity.CRITICAL
A = Action

TABLE: Mapping[EventKind, Row] = MappingProxyType(
    {
        # progress
        EventKind.MISSION_STATE: _row(N, "the mission enters another state"),
        EventKind.TASK_VISITED: _row(N, "a task is done"),
        EventKind.RECHARGE_STARTED: _row(N, "the charger has confirmed"),
        EventKind.RECHARGE_DONE: _row(N, "full, and clear of the dock"),
        EventKind.UGV_ARRIVED: _row(N, "parked at its path point"),
        EventKind.UAV_DOWN: _row(N, "on the ground"),
        EventKind.PLAN_ADOPTED: _row(N, "a better or a feasible plan"),
        EventKind.PLAN_KEPT: _row(N, "the replan is not worth the change"),
        EventKind.PLAN_REQUESTED: _row(N, "a replan has been asked for"),
        EventKind.CONFLICT_HELD: _row(N, "a flight or drive waits until it is free of conflicts"),
        EventKind.RECOVERED_FROM: _row(N, "a condition is over"),
        # poses and telemetry
        EventKind.POSE_STALE: _row(
            W, "without a fresh pose nobody can steer: stop and hover", air=A.HOLD, docking=A.HOLD, driving=A.HOLD
        ),
        EventKind.POSE_LOST: _row(
            E,
            "its own estimate drifts: land before it is far off",
            air=A.LAND_HERE,
            docking=A.LAND_HERE,
            driving=A.HOLD,
        ),
        EventKind.POSE_FROZEN: _row(
            W, "a pose that never changes is not a measurement", air=A.HOLD, docking=A.HOLD, driving=A.HOLD
        ),
        EventKind.POSE_JUMP: _row(
            W, "it cannot be where motion capture says", air=A.HOLD, docking=A.HOLD, driving=A.HOLD
        ),
        EventKind.POSE_SWAP: _row(
            E,
            "two bodies have exchanged names",
            air=A.HOLD,
            docking=A.HOLD,
            driving=A.HOLD,
            ground=A.WARN,
            parked=A.WARN,
        ),
        EventKind.TELEMETRY_STALE: _row(
            W, "its battery and its state are unknown", air=A.HOLD, docking=A.WARN, landing=A.WARN, driving=A.HOLD
        ),
        EventKind.LINK_LOST: _row(
            E,
            "nothing can be commanded: plan without it, keep asking it to land",
            ground=A.REPLAN_WITHOUT,
            air=A.LAND_HERE,
            docking=A.LAND_HERE,
            landing=A.WARN,
            driving=A.REPLAN_WITHOUT,
            parked=A.REPLAN_WITHOUT,
        ),
        # motion
        EventKind.TRACKING_ERROR: _row(W, "off its path: stop, then go on from there", air=A.HOLD, docking=A.HOLD),
        EventKind.GEOFENCE_SOFT: _row(W, "close to the fence", air=A.WARN, docking=A.WARN, driving=A.WARN),
        EventKind.GEOFENCE_HARD: _row(
            C, "outside the fence: end the flight there", air=A.LAND_HERE, docking=A.LAND_HERE, driving=A.REPLAN_WITHOUT
        ),
        EventKind.SEPARATION: _row(C, "two vehicles too near: the lower priority stops", air=A.HOLD, driving=A.HOLD),
        EventKind.TUMBLED: _row(
            C,
            "propellers must not turn on the floor",
            ground=A.STOP_MOTORS,
            air=A.STOP_MOTORS,
            docking=A.STOP_MOTORS,
            landing=A.STOP_MOTORS,
            driving=A.STOP_MOTORS,
            parked=A.STOP_MOTORS,
        ),
        EventKind.UGV_OFF_ROAD: _row(E, "it is where it must not drive: stop it there", driving=A.REPLAN_WITHOUT),
        EventKind.UGV_STUCK: _row(E, "no progress: plan without it until it moves again", driving=A.REPLAN_WITHOUT),
        EventKind.COMMAND_FAILED: _row(
            E,
            "repeated and without effect: do not rely on it",
            ground=A.REPLAN_WITHOUT,
            air=A.LAND_HERE,
            docking=A.DIVERT,
            landing=A.WARN,
            driving=A.REPLAN_WITHOUT,
            parked=A.REPLAN_WITHOUT,
        ),
        EventKind.GATE_REFUSED: _row(W, "the last check said no: the vehicle stays as it is and is asked later"),
        # energy and rendezvous
        EventKind.ENERGY_NO_RETURN: _row(
            E, "it would not reach a landing site later", air=A.DIVERT, docking=A.NOTE, landing=A.NOTE
        ),
        EventKind.ENERGY_RENDEZVOUS: _row(E, "the plan runs out of energy: another one, at once", mission=A.REPLAN),
        EventKind.DOCK_MISSED: _row(
            W, "climb back and try again; then wait on the ground", docking=A.HOLD, air=A.DIVERT
        ),
        EventKind.CHARGE_UNCONFIRMED: _row(W, "no contact: lift off and dock again", ground=A.HOLD),
        # schedule, planner, ground station
        EventKind.SCHEDULE_DRIFT: _row(W, "the predicted loss is worth a new plan", mission=A.REPLAN),
        EventKind.PLANNER_LATE: _row(W, "the old plan is flown until the new one comes", mission=A.WARN),
        EventKind.PLANNER_INFEASIBLE: _row(E, "nobody can finish: bring everybody down", mission=A.TEAM_RECOVERY),
        EventKind.GROUND_OVERLOADED: _row(W, "commands and monitors are late", mission=A.WARN),
        # operator
        EventKind.OPERATOR_HOLD: _row(W, "the operator says so", mission=A.HOLD),
        EventKind.OPERATOR_RECOVER: _row(W, "the operator says so", mission=A.TEAM_RECOVERY),
        EventKind.OPERATOR_STOP: _row(C, "the operator says so", mission=A.STOP_MOTORS),
    }
)

FIXED = frozenset({EventKind.OPERATOR_STOP, EventKind.OPERATOR_RECOVER, EventKind.TUMBLED})
"""Rows that no mission may change."""


def severity_of(kind: EventKind) -> Severity:
    """How loud the event is."""
    return TABLE[kind].severity


def action_for(kind: EventKind, situation: Situation, overrides: Mapping[str, str] | None = None) -> Action:
    """What to do about ``kind`` in ``situation``.

    Args:
        kind: the event.
        situation: of the vehicle it concerns, ``MISSION`` for the team.
        overrides: of the mission, "event/situation" before "event", values are names of ``Action`` in lower case.
    """
    if overrides and kind not in FIXED:
        chosen = overrides.get(f"{kind.value}/{situation.value}", overrides.get(kind.value))
        if chosen is not None:
            return Action[chosen.upper()]
    row = TABLE[kind]
    return row.actions.get(situation, row.default)


def override_problem(key: str, value: str) -> str | None:
    """Why an override is wrong, or None: for whoever reads it from a file."""
    event, slash, situation = key.partition("/")
    if event not in set(EventKind):
        return f"there is no event {event!r}; known are {', '.join(sorted(TABLE))}"
    if slash and situation not in set(Situation):
        return f"there is no situation {situation!r}; known are {', '.join(Situation)}"
    if EventKind(event) in FIXED:
        return f"what {event} does cannot be changed"
    if value not in {a.name.lower() for a in Action}:
        return f"there is no action {value!r}; known are {', '.join(a.name.lower() for a in Action)}"
    return None
