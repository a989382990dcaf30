"""What enters and leaves one turn of the loop. All of it is recorded; replay feeds it in again."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from drivers.vehicle import Command, Pose, VehicleState
from planner.plan import Action
from planner.problem import Problem


@dataclass(frozen=True, slots=True)
class OperatorInput:
    """One wish of the operator, or of the runner in the operator's name.

    Attributes:
        wish: ``checked`` (the checks of the plan passed), ``arm``, ``start``, ``hold``, ``resume``, ``recover`` (bring
            everybody down), ``stop`` (all motors off at once).
        plan_digest: with ``checked``, the plan that was checked.
        valid_until_s: with ``checked``, when the result expires.
    """

    wish: Literal["checked", "arm", "start", "hold", "resume", "recover", "stop"]
    plan_digest: str | None = None
    valid_until_s: float | None = None


@dataclass(frozen=True, slots=True)
class PlanRequest:
    """A replan asked for: a command out.

    Attributes:
        number: of the request.
        problem: the team's state now; its time 0 is now; indices are the mission's.
        start: the current plan's rest, the warm start.
        reason: for the operator.
        urgent: the current plan is infeasible.
        exclude_uavs, exclude_ugvs: indices of vehicles that can take no part.
        margin: share of capacity to keep above reserve where that is possible.
        landing_s: per UAV, mission time to land and take off again: where hovering at rendezvous leaves tasks out,
            waiting on the ground is tried. Empty where everybody waits so anyway.
    """

    number: int
    problem: Problem
    start: tuple[Action, ...]
    reason: str
    urgent: bool
    exclude_uavs: tuple[int, ...] = ()
    exclude_ugvs: tuple[int, ...] = ()
    margin: float = 0.0
    landing_s: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class PlanReply:
    """Its result: an observation in. Actions refer to the request's problem (same indices as the mission's).

    ``usable`` is true where the plan strands nobody, even if it leaves tasks out (``feasible`` is false then);
    ``landed`` where it counts on waiting on the ground. ``note`` is what a user should know of how it was made.
    """

    number: int
    feasible: bool
    actions: tuple[Action, ...]
    method: str
    planning_s: float
    violation: str | None = None
    usable: bool = True
    landed: bool = False
    note: str | None = None


@dataclass(frozen=True, slots=True)
class Refusal:
    """A command that the gate did not let pass, and why."""

    command: Command
    reason: str


@dataclass(frozen=True, slots=True)
class Observation:
    """Everything that ``step`` sees.

    Attributes:
        now_s: the loop's clock.
        poses: the newest pose of each body received since the last turn.
        vehicles: the newest snapshot of every vehicle.
        operator: wishes since the last turn.
        plan_reply: a planner's result that has just come in.
        refusals: what the gate refused of the last turn's commands.
        late_s: how much later than planned this turn began.
    """

    now_s: float
    poses: tuple[Pose, ...] = ()
    vehicles: tuple[VehicleState, ...] = ()
    operator: tuple[OperatorInput, ...] = ()
    plan_reply: PlanReply | None = None
    refusals: tuple[Refusal, ...] = ()
    late_s: float = 0.0
