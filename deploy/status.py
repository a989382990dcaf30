"""What the operator sees of one moment: for the live display, the recording and the report."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.vehicle import Vec3


@dataclass(frozen=True, slots=True)
class VehicleStatus:
    """One row.

    Attributes:
        vehicle: id.
        kind: ``uav`` or ``ugv``.
        phase: a value of ``deploy.state.UavPhase`` or ``UgvPhase``.
        position_m: last trusted pose, arena frame; None before the first.
        yaw_rad: its heading.
        energy_j: estimate, in the world's terms.
        energy_fraction: of capacity.
        doing: in words, "task 7", "to path point 3", "recharge at ugv1".
        goal_m: where it is going, arena frame; None when nowhere.
        slack_s: of its current action, mission s; None where not known or without limit.
    """

    vehicle: str
    kind: str
    phase: str
    position_m: Vec3 | None
    yaw_rad: float
    energy_j: float
    energy_fraction: float
    doing: str
    goal_m: Vec3 | None
    slack_s: float | None


@dataclass(frozen=True, slots=True)
class Status:
    """The whole mission at one moment.

    Attributes:
        now_s: the loop's clock, arena s.
        mission_s: mission time since start (0 before).
        mission_state: a value of ``deploy.state.MissionPhase``.
        tasks_visited: which, (n_tasks,).
        plan_number: 0 for the first plan, then one more for each adopted.
        predicted_makespan_s: mission s; None where it cannot be predicted.
    """

    now_s: float
    mission_s: float
    mission_state: str
    tasks_visited: tuple[bool, ...]
    plan_number: int
    predicted_makespan_s: float | None
    vehicles: tuple[VehicleStatus, ...]
