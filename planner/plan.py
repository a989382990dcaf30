"""Plans: joint actions in decision order, and the schedule that they decode to. File format ``copcs-plan/1``."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from planner.errors import PlannerError

FORMAT = "copcs-plan/1"


@dataclass(frozen=True, slots=True)
class Visit:
    """UAV ``uav`` flies to task ``task`` and serves it."""

    uav: int
    task: int


@dataclass(frozen=True, slots=True)
class Move:
    """UGV ``ugv`` drives to ``path_point``; None is the depot."""

    ugv: int
    path_point: int | None


@dataclass(frozen=True, slots=True)
class Recharge:
    """UAV ``uav`` flies to where UGV ``ugv`` is after its moves so far, docks, charges and leaves."""

    uav: int
    ugv: int


Action = Visit | Move | Recharge
_KINDS: dict[str, type[Visit] | type[Move] | type[Recharge]] = {"visit": Visit, "move": Move, "recharge": Recharge}


@dataclass(frozen=True, slots=True)
class ScheduledAction:
    """When one action of the plan happens; times in s from the problem's time 0, energies of the acting vehicle in J.

    Attributes:
        action: index into the plan's actions.
        start_s, end_s: the vehicle begins and ends the action then (travel, waiting and service included).
        slack_s: how much later the action may end before any other action starts or ends later, or energy runs short
            (free float); inf where nothing depends on it.
        total_slack_s: how much later it may end before the makespan grows or energy runs short (total float).
        arrive_s: end of travelling (at the task, the path point, the UGV).
        work_s: begin of the service, or of docking; ``work_s - arrive_s`` is waiting.
        energy_start_j, energy_end_j: the acting vehicle's energy (the UAV's for a recharge) at start and end.
        energy_arrive_j: the UAV's energy on docking (its lowest within a recharge), for a visit at its end.
        dock: index of the dock used by a recharge, else None.
    """

    action: int
    start_s: float
    end_s: float
    slack_s: float
    total_slack_s: float
    arrive_s: float
    work_s: float
    energy_start_j: float
    energy_end_j: float
    energy_arrive_j: float
    dock: int | None = None


@dataclass(frozen=True, slots=True)
class Recovery:
    """Where a UAV lands after its last action; ``site`` is a path point, None the depot."""

    uav: int
    site: int | None
    start_s: float
    end_s: float
    energy_end_j: float


@dataclass(frozen=True, slots=True)
class Schedule:
    """A plan with times, energies and slack. Where infeasible, ``violation`` says the first violated constraint."""

    feasible: bool
    violation: str | None
    makespan_s: float
    uav_energy_j: float
    ugv_energy_j: float
    energy_given_j: float
    waiting_s: float
    recovery_s: float
    actions: tuple[ScheduledAction, ...]
    recovery: tuple[Recovery, ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """A list of joint actions with its schedule and how it was made; ``note`` is what a user should know of that."""

    actions: tuple[Action, ...]
    schedule: Schedule
    method: str
    planning_s: float | None = None
    lower_bound_s: float | None = None
    note: str | None = None

    @property
    def feasible(self) -> bool:
        """Whether every task is visited and no constraint is violated."""
        return self.schedule.feasible

    @property
    def makespan_s(self) -> float:
        """Time of the last visit's end, in s."""
        return self.schedule.makespan_s

    @property
    def gap(self) -> float | None:
        """Share of the makespan that is not proven to be needed; 0 is optimal, None where no bound is known."""
        if self.lower_bound_s is None or not self.feasible:
            return None
        return max(0.0, self.makespan_s - self.lower_bound_s) / max(self.makespan_s, 1e-9)

    @property
    def digest(self) -> str:
        """SHA-256 of the actions; check results are bound to it."""
        return hashlib.sha256(json.dumps(actions_to_json(self.actions)).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """The ``copcs-plan/1`` object; what is not known is null (infinite slack is null as well)."""
        s = self.schedule
        rows = [_finite(asdict(row)) for row in s.actions]
        return {
            "format": FORMAT,
            "actions": actions_to_json(self.actions),
            **_finite(
                {
                    "makespan_s": s.makespan_s,
                    "uav_energy_j": s.uav_energy_j,
                    "ugv_energy_j": s.ugv_energy_j,
                    "energy_given_j": s.energy_given_j,
                    "waiting_s": s.waiting_s,
                    "recovery_s": s.recovery_s,
                    "planning_s": self.planning_s,
                    "lower_bound_s": self.lower_bound_s,
                }
            ),
            "feasible": s.feasible,
            "violation": s.violation,
            "method": self.method,
            "note": self.note,
            "schedule": rows,
            "recovery": [_finite(asdict(r)) for r in s.recovery],
        }


def _finite(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: None if isinstance(v, float) and v - v != 0 else v for k, v in values.items()}


def actions_to_json(actions: Sequence[Action]) -> list[dict[str, Any]]:
    """The ``actions`` member of a plan file."""
    return [{"kind": type(a).__name__.lower(), **asdict(a)} for a in actions]


def actions_from_json(rows: Sequence[Mapping[str, Any]]) -> tuple[Action, ...]:
    """Reads the ``actions`` member of a plan file.

    Raises:
        PlannerError: naming the action that is wrong.
    """
    if not isinstance(rows, Sequence) or isinstance(rows, str):
        raise PlannerError("actions is not a list")
    actions: list[Action] = []
    for i, row in enumerate(rows):
        kind = _KINDS.get(str(row.get("kind"))) if isinstance(row, Mapping) else None
        if kind is None:
            raise PlannerError(f"actions[{i}] is {row!r}; kind must be one of {sorted(_KINDS)}")
        names = [f.name for f in fields(kind)]
        values: dict[str, Any] = {k: row.get(k) for k in names}
        for name, value in values.items():
            if (value is None and name == "path_point" and "path_point" in row) or (type(value) is int and value >= 0):
                continue
            raise PlannerError(f"actions[{i}]: {name} is {value!r}; give a whole number of at least 0")
        if set(row) - {"kind", *names}:
            raise PlannerError(f"actions[{i}]: unknown members {sorted(set(row) - {'kind', *names})}")
        actions.append(kind(**values))
    return tuple(actions)


def read_actions(path: Path) -> tuple[Action, ...]:
    """Reads the actions of a plan file.

    Raises:
        PlannerError: when the file is missing, not JSON or wrong; the message names the file.
    """
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise PlannerError(f"format is not {FORMAT!r}")
        return actions_from_json(data.get("actions", []))
    except OSError as error:
        raise PlannerError(f"{path}: {error.strerror}") from error
    except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise PlannerError(f"{path}: not a JSON file: {error}") from error
    except PlannerError as error:
        raise PlannerError(f"{path}: {error}") from error
