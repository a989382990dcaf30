"""The report of a run: its numbers (``report.json``), and the page and pictures made of them.

``docs/recordings.md`` explains every key.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import orjson

from deploy.drawing import MapDrawing
from deploy.errors import DeployError
from deploy.events import Severity
from deploy.recording_read import read
from deploy.report_history import (
    History,
    Lateness,
    VisitMade,
    charger,
    collect,
    from_recording,
    phase_spans,
    standstills,
)
from deploy.report_safety import Safety, Violation, judge
from deploy.settings import Settings
from deploy.state import MissionPhase, UavPhase, UgvPhase

FORMAT = "copcs-report/1"
Outcome = Literal["done", "failed", "aborted"]

__all__ = [
    "FORMAT",
    "History",
    "Lateness",
    "Outcome",
    "Replan",
    "Report",
    "VehicleReport",
    "Violation",
    "build",
    "collect",
    "from_recording",
    "make",
    "write",
]


@dataclass(frozen=True, slots=True)
class Replan:
    """A plan that replaced another: when (mission time), why, and what it promised."""

    number: int
    time_s: float
    reason: str
    makespan_s: float | None
    method: str
    planning_s: float | None


@dataclass(frozen=True, slots=True)
class VehicleReport:
    """One vehicle's part in it.

    Attributes:
        phase: its last.
        tasks, recharges: visited, had (a UGV: given).
        distance_m: way made good in the world, m.
        moving_s: airborne, or driving without standing still; mission s.
        waiting_s: hovering at a rendezvous; of a UGV, standing on its way.
        charging_s: on a dock.
        energy_used_j: what flying or driving took; energy charged or given away is apart.
        energy_end_j: what is left.
        min_energy_margin_j: least energy above reserve (UAVs).
    """

    id: str
    kind: str
    phase: str
    tasks: int
    recharges: int
    distance_m: float
    moving_s: float
    waiting_s: float
    charging_s: float
    energy_used_j: float | None
    energy_end_j: float | None
    min_energy_margin_j: float | None


@dataclass(frozen=True, slots=True)
class Report:
    """Everything in ``report.json``; key by key in ``docs/recordings.md``. Unknown numbers are None."""

    format: str
    name: str
    outcome: Outcome
    truncated: bool
    tasks_total: int
    tasks_visited: int
    makespan_planned_s: float | None
    makespan_actual_s: float | None
    duration_s: float
    uav_energy_j: float | None
    ugv_energy_j: float | None
    energy_given_j: float | None
    recharges: int
    replans: tuple[Replan, ...]
    min_separation_m: float | None
    min_ugv_separation_m: float | None
    min_energy_margin_j: float | None
    safety_violations: tuple[Violation, ...]
    planner_method: str | None
    planning_s: float | None
    lower_bound_s: float | None
    vehicles: tuple[VehicleReport, ...]
    visits: tuple[VisitMade, ...]
    events: dict[str, int]
    severities: dict[str, int]
    loop: Lateness
    seed: int
    backend: str
    command: str
    mission_digest: str
    plan_digest: str | None
    versions: dict[str, str]

    def to_json(self) -> bytes:
        """``report.json``, indented for people."""
        return orjson.dumps(asdict(self), option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE)


def build(history: History, outcome: Outcome | None = None) -> Report:
    """Computes the report's numbers.

    Args:
        history: the run.
        outcome: as the runner knows it; judged from the last state and the tasks visited where not given.
    """
    safety = judge(history)
    vehicles = _vehicles(history, safety)
    first = history.plans[0].plan if history.plans else None
    tasks = int(history.visited[-1].sum()) if len(history.visited) else int(history.settings.problem.visited.sum())
    total = history.settings.problem.n_tasks
    uavs, ugvs = vehicles[: history.n_uavs], vehicles[history.n_uavs :]
    given = [_charged(history, u) for u in range(history.n_uavs)]
    taken = _sum([row.energy_used_j for row in ugvs])
    return Report(
        format=FORMAT,
        name=history.meta.name,
        outcome=outcome or _outcome(history, tasks == total),
        truncated=history.truncated,
        tasks_total=total,
        tasks_visited=tasks,
        makespan_planned_s=_number(first.makespan_s) if first else None,
        makespan_actual_s=max((v.time_s for v in history.visits), default=None) if tasks == total else None,
        duration_s=float(history.mission_s[-1]) if len(history.mission_s) else 0.0,
        uav_energy_j=_sum([row.energy_used_j for row in uavs]),
        ugv_energy_j=taken,
        energy_given_j=_sum(given),
        recharges=sum(row.recharges for row in uavs),
        replans=tuple(
            Replan(
                number,
                history.to_mission_s(adopted.time_s),
                adopted.reason,
                _number(adopted.plan.makespan_s + adopted.zero_s),
                adopted.plan.method,
                adopted.plan.planning_s,
            )
            for number, adopted in enumerate(history.plans[1:], start=1)
        ),
        min_separation_m=safety.min_separation_m,
        min_ugv_separation_m=safety.min_ugv_separation_m,
        min_energy_margin_j=safety.min_energy_margin_j,
        safety_violations=safety.violations,
        planner_method=first.method if first else None,
        planning_s=first.planning_s if first else None,
        lower_bound_s=first.lower_bound_s if first else None,
        vehicles=vehicles,
        visits=history.visits,
        events=dict(sorted(Counter(e.kind.value for e in history.events).items())),
        severities={s.name.lower(): sum(e.severity is s for e in history.events) for s in Severity},
        loop=history.lateness,
        seed=history.meta.seed,
        backend=history.meta.backend,
        command=history.meta.command,
        mission_digest=history.meta.mission_digest,
        plan_digest=history.meta.plan_digest,
        versions=history.meta.versions,
    )


def write(
    report: Report, history: History, drawing: MapDrawing, folder: Path, progress: Callable[[str], None] | None = None
) -> None:
    """Writes ``report.json``, ``report.html`` and ``picture.png`` into ``folder``.

    Raises:
        DeployError: when a file cannot be written.
    """
    from deploy.pictures import run_picture  # noqa: PLC0415  (matplotlib takes half a second to load)
    from deploy.report_html import page  # noqa: PLC0415

    tell = progress or (lambda _: None)
    try:
        tell("report.json")
        (folder / "report.json").write_bytes(report.to_json())
        tell("report.html")
        (folder / "report.html").write_text(page(report, history, drawing), encoding="utf-8")
        tell("picture.png")
        run_picture(history, drawing, folder / "picture.png")
    except OSError as error:
        raise DeployError(f"{folder}: cannot write the report: {error.strerror}") from error


def make(folder: Path, settings: Settings, drawing: MapDrawing, outcome: Outcome | None = None) -> Report:
    """Reads the recording in ``folder`` and writes its report there.

    Raises:
        InputError: when there is no readable recording.
        DeployError: when the report cannot be written.
    """
    history = from_recording(read(folder), settings)
    report = build(history, outcome)
    write(report, history, drawing, folder)
    return report


def _outcome(history: History, complete: bool) -> Outcome:
    if history.state == MissionPhase.ABORTED:
        return "aborted"
    return "done" if history.state == MissionPhase.DONE and complete and not history.truncated else "failed"


def _vehicles(history: History, safety: Safety) -> tuple[VehicleReport, ...]:
    rows = []
    t = history.mission_s
    hours = np.diff(t, append=t[-1:]) if len(t) else np.zeros(0)
    for v, name in enumerate(history.ids):
        uav = v < history.n_uavs
        phase = history.phase[:, v]
        moving = history.airborne[:, v] if uav else phase == str(UgvPhase.DRIVING)
        stood_s = math.fsum(span.end_s - span.start_s for span in standstills(history, v))
        served = _served(history, name) if not uav else len(phase_spans(history, v, UavPhase.CHARGING))
        charged = _charged(history, v) if uav else -(_given(history, name) or 0.0)
        energy = history.energy_j[:, v][~np.isnan(history.energy_j[:, v])]
        steps = np.diff(history.world_m[:, v][~np.isnan(history.world_m[:, v, 0])], axis=0)
        rows.append(
            VehicleReport(
                id=name,
                kind="uav" if uav else "ugv",
                phase=str(phase[-1]) if len(phase) else "",
                tasks=sum(visit.uav == name for visit in history.visits),
                recharges=served,
                distance_m=float(np.hypot(steps[:, 0], steps[:, 1]).sum()),
                moving_s=float(hours[moving].sum()) - stood_s,
                waiting_s=float(hours[phase == str(UavPhase.WAITING)].sum()) if uav else stood_s,
                charging_s=float(hours[phase == str(UavPhase.CHARGING)].sum()) if uav else 0.0,
                energy_used_j=max(0.0, float(energy[0] - energy[-1]) + (charged or 0.0)) if len(energy) else None,
                energy_end_j=float(energy[-1]) if len(energy) else None,
                min_energy_margin_j=safety.margin_of.get(name),
            )
        )
    return tuple(rows)


def _charged(history: History, uav: int, at: str | None = None) -> float | None:
    """Energy that a UAV was given, at UGV ``at`` or anywhere, in J."""
    spans = phase_spans(history, uav, UavPhase.CHARGING)
    energy = history.energy_j[:, uav]
    return _sum(
        [float(energy[s.last] - energy[s.first]) for s in spans if at is None or charger(history, uav, s) == at]
    )


def _given(history: History, ugv: str) -> float | None:
    return _sum([_charged(history, u, ugv) for u in range(history.n_uavs)])


def _served(history: History, ugv: str) -> int:
    uavs = range(history.n_uavs)
    return sum(charger(history, u, s) == ugv for u in uavs for s in phase_spans(history, u, UavPhase.CHARGING))


def _sum(values: list[float | None]) -> float | None:
    known = [v for v in values if v is not None and math.isfinite(v)]
    return math.fsum(known) if known or not values else None


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
