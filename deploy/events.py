"""What can happen, how bad it is, what the supervisor may do about it, and the record of it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum


class Severity(IntEnum):
    """How loud an event is."""

    INFO = 0
    WARNING = 1
    ERROR = 2
    CRITICAL = 3


class Action(IntEnum):
    """What the supervisor does about an event, mildest first."""

    NOTE = 0
    WARN = 1
    RETIME = 2
    REPLAN = 3
    REPLAN_WITHOUT = 4
    HOLD = 5
    DIVERT = 6
    LAND_HERE = 7
    TEAM_RECOVERY = 8
    STOP_MOTORS = 9


class EventKind(StrEnum):
    """Every event. The failsafe table has a row for each."""

    # progress
    MISSION_STATE = "mission_state"
    TASK_VISITED = "task_visited"
    RECHARGE_STARTED = "recharge_started"
    RECHARGE_DONE = "recharge_done"
    UGV_ARRIVED = "ugv_arrived"
    UAV_DOWN = "uav_down"
    PLAN_ADOPTED = "plan_adopted"
    PLAN_KEPT = "plan_kept"
    PLAN_REQUESTED = "plan_requested"
    CONFLICT_HELD = "conflict_held"
    RECOVERED_FROM = "recovered_from"
    # poses and telemetry
    POSE_STALE = "pose_stale"
    POSE_LOST = "pose_lost"
    POSE_FROZEN = "pose_frozen"
    POSE_JUMP = "pose_jump"
    POSE_SWAP = "pose_swap"
    TELEMETRY_STALE = "telemetry_stale"
    LINK_LOST = "link_lost"
    # motion
    TRACKING_ERROR = "tracking_error"
    GEOFENCE_SOFT = "geofence_soft"
    GEOFENCE_HARD = "geofence_hard"
    SEPARATION = "separation"
    TUMBLED = "tumbled"
    UGV_OFF_ROAD = "ugv_off_road"
    UGV_STUCK = "ugv_stuck"
    COMMAND_FAILED = "command_failed"
    GATE_REFUSED = "gate_refused"
    # energy and rendezvous
    ENERGY_NO_RETURN = "energy_no_return"
    ENERGY_RENDEZVOUS = "energy_rendezvous"
    DOCK_MISSED = "dock_missed"
    CHARGE_UNCONFIRMED = "charge_unconfirmed"
    # schedule, planner, ground station
    SCHEDULE_DRIFT = "schedule_drift"
    PLANNER_LATE = "planner_late"
    PLANNER_INFEASIBLE = "planner_infeasible"
    GROUND_OVERLOADED = "ground_overloaded"
    # operator
    OPERATOR_HOLD = "operator_hold"
    OPERATOR_RECOVER = "operator_recover"
    OPERATOR_STOP = "operator_stop"


@dataclass(frozen=True, slots=True)
class Event:
    """One thing that happened.

    Attributes:
        time_s: on the loop's clock.
        kind: what.
        severity: how bad.
        vehicle: whose, None for the whole mission.
        action: what was done about it.
        text: for the operator, one sentence with numbers.
    """

    time_s: float
    kind: EventKind
    severity: Severity
    vehicle: str | None
    action: Action
    text: str
