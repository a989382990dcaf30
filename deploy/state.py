"""The supervisor's state: frozen, and everything that the next step needs to know besides the next observation."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from deploy.events import Action, EventKind
from deploy.flightpath import TimedPath
from drivers.vehicle import Command, Vec2, Vec3, VehicleState
from planner.plan import Action as PlanAction


class MissionPhase(StrEnum):
    """Where the mission stands."""

    DISARMED = "disarmed"
    CHECKED = "checked"
    ARMED = "armed"
    RUNNING = "running"
    HOLDING = "holding"
    RECOVERING = "recovering"
    DONE = "done"
    ABORTED = "aborted"


class UavPhase(StrEnum):
    """What a UAV is doing."""

    ON_PAD = "on_pad"  # on the ground or on a dock, ready to take off again
    TAKING_OFF = "taking_off"
    FLYING = "flying"  # on its way, serving a task, or hovering until it may go on
    WAITING = "waiting"  # hovering at a rendezvous until UGV and dock are there
    DOCKING = "docking"
    CHARGING = "charging"
    LANDING = "landing"
    DOWN = "down"  # on the ground for good
    LOST = "lost"


class UgvPhase(StrEnum):
    """What a UGV is doing."""

    PARKED = "parked"
    DRIVING = "driving"
    HOLDING = "holding"  # stopped between path points
    LOST = "lost"


AIRBORNE = frozenset({UavPhase.TAKING_OFF, UavPhase.FLYING, UavPhase.WAITING, UavPhase.DOCKING, UavPhase.LANDING})
UAV_FINAL = frozenset({UavPhase.DOWN, UavPhase.LOST})


@dataclass(frozen=True, slots=True)
class Track:
    """What motion capture says about one body, and how much of it is trusted.

    Attributes:
        position_m, yaw_rad, stamp_s: the last trusted pose.
        speed_mps, velocity_mps: over the last trusted poses, smoothed as a vector so that noise cancels out.
        raw_m, raw_stamp_s: the last pose received, trusted or not.
        same_since_s: since when the raw pose has not changed by a single bit.
        jumped: the raw pose is where the vehicle cannot be.
        swapped: it is where another vehicle should be.
    """

    position_m: Vec3
    yaw_rad: float
    stamp_s: float
    speed_mps: float
    raw_m: Vec3
    raw_stamp_s: float
    same_since_s: float
    jumped: bool = False
    swapped: bool = False
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class Order:
    """The command a vehicle is under, repeated until its effect is seen.

    Attributes:
        command: as wanted.
        first_s, sent_s: first and last sending.
        attempts: sendings so far.
        confirmed: the effect was seen.
        mark_m: progress when last confirmed (meaning depends on the command), None before.
    """

    command: Command
    first_s: float
    sent_s: float
    attempts: int = 1
    confirmed: bool = False
    mark_m: float | None = None


@dataclass(frozen=True, slots=True)
class UavState:
    """One UAV.

    Attributes:
        index: in the problem and in ``Settings.uavs``.
        phase, since_s: what it does and since when.
        track, telemetry: newest trusted pose and newest snapshot, None before the first.
        energy_j, energy_s: estimate and its time.
        order: the command it is under.
        path: its committed flight while airborne, else None.
        work_until_s: end of the service at a task, None when not serving.
        docked: (UGV index, dock) while docking, charging or standing there, else None.
        dock_attempts: at this rendezvous so far.
        lowest_m: least height in this docking attempt.
        charge_from_j: energy when charging began.
        charge_seen: its charger has confirmed.
        action: index of the plan action it is carrying out while docking, charging and undocking, else None.
        diverting: on its way to the nearest site, to land and wait there.
        site: the site it stands at or recovers to, else None.
        out: gets no further actions.
        held: hovers until the reason is gone.
        retry_s: no new motion before this time (after a refusal or a conflict).
        off_path_since_s: since when it has been off its path.
        active: conditions that hold now, so that each is told once.
        refused: what the gate last said no to, until something has worked again; told once, too.
    """

    index: int
    phase: UavPhase = UavPhase.ON_PAD
    since_s: float = 0.0
    track: Track | None = None
    telemetry: VehicleState | None = None
    energy_j: float = 0.0
    energy_s: float = 0.0
    order: Order | None = None
    path: TimedPath | None = None
    work_until_s: float | None = None
    docked: tuple[int, int] | None = None
    dock_attempts: int = 0
    lowest_m: float = 0.0
    charge_from_j: float = 0.0
    charge_seen: bool = False
    action: int | None = None
    diverting: bool = False
    site: int | None = None
    out: bool = False
    held: bool = False
    retry_s: float = 0.0
    off_path_since_s: float | None = None
    active: frozenset[EventKind] = frozenset()
    refused: str = ""


@dataclass(frozen=True, slots=True)
class UgvState:
    """One UGV; names as for ``UavState``.

    Attributes:
        site: the site it is parked at, None between sites.
        target: the site it drives to.
        route_m: its drive in the arena, ends at its own place at the target.
        left_m: way left on the route; ``progress_m`` and ``progress_s`` are its value and time at the last progress.
        stuck: makes no progress; it is left out of plans until it moves again.
    """

    index: int
    phase: UgvPhase = UgvPhase.PARKED
    since_s: float = 0.0
    track: Track | None = None
    telemetry: VehicleState | None = None
    energy_j: float = 0.0
    energy_s: float = 0.0
    order: Order | None = None
    path: TimedPath | None = None
    site: int | None = None
    target: int | None = None
    route_m: tuple[Vec2, ...] = ()
    left_m: float = 0.0
    progress_m: float = 0.0
    progress_s: float = 0.0
    stuck: bool = False
    out: bool = False
    held: bool = False
    retry_s: float = 0.0
    active: frozenset[EventKind] = frozenset()
    refused: str = ""


@dataclass(frozen=True, slots=True)
class PlanState:
    """The plan in force.

    Attributes:
        number: 0 for the first.
        actions: its joint actions.
        done: per action.
        docks: dock of each recharge, None for other actions.
        sites: site of each recharge, target of each move, None for visits.
        slack_s: per action, mission s, inf where without limit.
        baseline_s: makespan promised at adoption or at the last review that accepted a loss, mission s.
        planned_s: makespan promised at adoption, mission s.
        predicted_s: makespan at the last review, None where the rest of the plan is infeasible.
        violation: why it is, else None.
        given_up: tasks left out because nobody can visit them any more.
        landed: it counts on UAVs waiting on the ground, whatever the mission says.
    """

    number: int
    actions: tuple[PlanAction, ...]
    done: tuple[bool, ...]
    docks: tuple[int | None, ...]
    sites: tuple[int | None, ...]
    slack_s: tuple[float, ...]
    baseline_s: float
    planned_s: float
    predicted_s: float | None
    violation: str | None = None
    given_up: frozenset[int] = frozenset()
    landed: bool = False


@dataclass(frozen=True, slots=True)
class Pending:
    """A replan that has been asked for.

    Attributes:
        number: of the request.
        asked_s: when.
        urgent: the current plan is infeasible.
        docked: which UAVs were docking or charging then; their first recharge is not in the reply.
        late: told already.
    """

    number: int
    asked_s: float
    urgent: bool
    docked: frozenset[int]
    given_up: frozenset[int]
    reason: str
    late: bool = False


@dataclass(frozen=True, slots=True)
class State:
    """All of it."""

    phase: MissionPhase
    uavs: tuple[UavState, ...]
    ugvs: tuple[UgvState, ...]
    plan: PlanState
    plan_digest: str
    visited: tuple[bool, ...]
    valid_until_s: float | None = None
    start_s: float | None = None
    end_s: float | None = None
    last_visit_s: float | None = None
    pending: Pending | None = None
    requests: int = 0
    replan_reason: str | None = None
    replan_urgent: bool = False
    last_request_s: float = -1e9
    review_s: float = -1e9
    recovering_since_s: float = 0.0
    aborting: bool = False
    tried_again: bool = False
    recharges: int = 0
    active: frozenset[EventKind] = frozenset()

    @property
    def units(self) -> tuple[UavState | UgvState, ...]:
        """UAVs, then UGVs."""
        return (*self.uavs, *self.ugvs)

    @property
    def over(self) -> bool:
        """The mission has ended."""
        return self.phase in (MissionPhase.DONE, MissionPhase.ABORTED)


@dataclass(frozen=True, slots=True)
class Finding:
    """A condition that a monitor sees right now; level-triggered. ``vehicle`` is None for the whole mission."""

    kind: EventKind
    vehicle: str | None
    text: str
    action: Action | None = None
