"""A run as arrays: what the report's numbers and pictures are computed from."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from deploy.events import Event, EventKind
from deploy.recording_meta import RunMeta
from deploy.recording_read import Adopted, Recording
from deploy.runner import PERIOD_S
from deploy.settings import Settings
from deploy.state import AIRBORNE, UavPhase, UgvPhase
from deploy.status import Status

Array = NDArray[np.float64]
STANDSTILL_S = 15.0  # longer than turning on the spot and waiting for a command
STILL_SHARE = 0.05  # of its speed: a pose's noise, not a drive


@dataclass(frozen=True, slots=True)
class Lateness:
    """How punctual the loop was: turns, loop time of the last one, and by how much they began late, in s.

    A turn is late that begins more than a whole period after its time.
    """

    turns: int
    end_s: float
    mean_late_s: float
    max_late_s: float
    late_turns: int = 0

    @property
    def late_share(self) -> float:
        """Share of late turns."""
        return self.late_turns / self.turns if self.turns else 0.0


@dataclass(frozen=True, slots=True)
class VisitMade:
    """``uav`` (None where it cannot be told) visited ``task`` at mission time ``time_s``."""

    task: int
    uav: str | None
    time_s: float


@dataclass(frozen=True, slots=True)
class Span:
    """A vehicle was in ``phase`` from ``start_s`` to ``end_s`` (mission time), doing ``doing`` in words at first."""

    phase: str
    start_s: float
    end_s: float
    doing: str
    first: int
    last: int


@dataclass(frozen=True)
class History:
    """A whole run; T recorded statuses of V vehicles, in the order of ``ids``.

    Attributes:
        now_s, mission_s: (T,) loop time and mission time.
        position_m: (T, V, 3) trusted poses, arena frame; nan before the first.
        energy_j: (T, V).
        phase: (T, V) phases in words.
        doing: (T, V) in words.
        visited: (T, n_tasks).
        state: the mission's last state.
        predicted_s: (T,) predicted makespan, nan where unknown.
        truncated: the recording breaks off.
    """

    meta: RunMeta
    settings: Settings
    ids: tuple[str, ...]
    now_s: Array
    mission_s: Array
    position_m: Array
    energy_j: Array
    phase: NDArray[np.object_]
    doing: NDArray[np.object_]
    visited: NDArray[np.bool_]
    state: str
    predicted_s: Array
    events: tuple[Event, ...]
    plans: tuple[Adopted, ...]
    lateness: Lateness
    truncated: bool = False

    @property
    def n_uavs(self) -> int:
        """UAVs come first in ``ids``."""
        return len(self.settings.uavs)

    @cached_property
    def start_s(self) -> float:
        """Loop time of mission time 0."""
        started = np.flatnonzero(self.mission_s > 0)
        if not started.size:
            return float(self.now_s[-1]) if self.now_s.size else 0.0
        i = started[0]
        return float(self.now_s[i] - self.mission_s[i] * self.settings.frame.time_scale)

    def to_mission_s(self, now_s: float) -> float:
        """Mission time of a moment of the loop clock; negative before the start."""
        return (now_s - self.start_s) / self.settings.frame.time_scale

    @cached_property
    def world_m(self) -> Array:
        """(T, V, 2) positions in the world frame."""
        x, y = self.settings.frame.to_world((self.position_m[..., 0], self.position_m[..., 1]))  # type: ignore[arg-type]
        return np.stack([x, y], axis=-1)

    @cached_property
    def airborne(self) -> NDArray[np.bool_]:
        """(T, n_uavs) in the air with a known position."""
        phase, place = self.phase[:, : self.n_uavs], self.position_m[:, : self.n_uavs, 0]
        return np.isin(phase, [str(p) for p in AIRBORNE]) & ~np.isnan(place)

    @cached_property
    def visits(self) -> tuple[VisitMade, ...]:
        """In order of time. The UAV is the one that the event of that moment names, or that says it is on the task."""
        made = []
        told = [e for e in self.events if e.kind is EventKind.TASK_VISITED and e.vehicle is not None]
        for task in range(self.visited.shape[1]):
            hits = np.flatnonzero(self.visited[:, task])
            if not hits.size or bool(self.settings.problem.visited[task]):
                continue
            i = int(hits[0])
            words = [u for u in range(self.n_uavs) for k in (i, i - 1) if k >= 0 and self.doing[k, u] == f"task {task}"]
            if words:
                uav: str | None = self.ids[words[0]]
            else:
                near = [e.vehicle for e in told if abs(e.time_s - self.now_s[i]) < 1e-6]
                uav = near[0] if len(near) == 1 else None
            made.append(VisitMade(task, uav, float(self.mission_s[i])))
        return tuple(sorted(made, key=lambda v: (v.time_s, v.task)))

    def spans(self, vehicle: int) -> list[Span]:
        """The phases of a vehicle, one after another."""
        phase, doing = self.phase[:, vehicle], self.doing[:, vehicle]
        if not len(phase):
            return []
        key = np.array([f"{p}|{d}" for p, d in zip(phase, doing, strict=True)])
        cuts = [0, *(np.flatnonzero(key[1:] != key[:-1]) + 1).tolist(), len(key)]
        t = self.mission_s
        last = len(t) - 1
        return [
            Span(str(phase[a]), float(t[a]), float(t[min(b, last)]), str(doing[a]), a, min(b, last))
            for a, b in pairwise(cuts)
        ]


def charger(history: History, uav: int, span: Span) -> str | None:
    """The UGV that charged ``uav`` in ``span``: the one its words name, else the nearest; None without any."""
    ugvs = history.ids[history.n_uavs :]
    named = [g for g in ugvs if g in span.doing.split()]
    if named:
        return named[0]
    places = history.position_m[span.first]
    gaps = np.hypot(*(places[history.n_uavs :, :2] - places[uav, :2]).T)
    return None if np.isnan(gaps).all() or not len(ugvs) else ugvs[int(np.nanargmin(gaps))]


def phase_spans(history: History, vehicle: int, phase: UavPhase | UgvPhase) -> list[Span]:
    """As ``History.spans``, of one phase alone; a change of words in between does not split it."""
    merged: list[Span] = []
    for span in history.spans(vehicle):
        if span.phase != phase:
            continue
        if merged and merged[-1].last == span.first:
            old = merged.pop()
            span = Span(old.phase, old.start_s, span.end_s, old.doing, old.first, span.last)  # noqa: PLW2901
        merged.append(span)
    return merged


def standstills(history: History, vehicle: int) -> list[Span]:
    """When a UGV that was to drive stood for ``STANDSTILL_S`` or longer, whatever held it up."""
    found: list[Span] = []
    if vehicle < history.n_uavs:
        return []
    model = history.settings.problem.ugvs[vehicle - history.n_uavs]
    for span in phase_spans(history, vehicle, UgvPhase.DRIVING):
        t, place = history.mission_s[span.first : span.last + 1], history.world_m[span.first : span.last + 1, vehicle]
        gone = np.hypot(*np.diff(place, axis=0).T)
        slow = gone < STILL_SHARE * model.speed_mps * np.diff(t)
        edges = np.flatnonzero(np.diff([0, *slow.astype(int).tolist(), 0]))
        for a, b in zip(edges[::2], edges[1::2], strict=True):
            if t[b] - t[a] >= STANDSTILL_S:
                found.append(
                    Span("standing", float(t[a]), float(t[b]), span.doing, span.first + int(a), span.first + int(b))
                )
    return found


def collect(
    meta: RunMeta,
    settings: Settings,
    statuses: Iterable[Status],
    events: Iterable[Event],
    plans: Iterable[Adopted],
    lateness: Lateness,
    truncated: bool = False,
) -> History:
    """Makes a history of what a recording holds, or of the same things kept in memory."""
    ids = (*(u.id for u in settings.uavs), *(g.id for g in settings.ugvs))
    place = {v: i for i, v in enumerate(ids)}
    rows = list(statuses)
    position = np.full((len(rows), len(ids), 3), np.nan)
    energy = np.full((len(rows), len(ids)), np.nan)
    phase = np.full((len(rows), len(ids)), "", dtype=object)
    doing = np.full((len(rows), len(ids)), "", dtype=object)
    for t, status in enumerate(rows):
        for row in status.vehicles:
            v = place.get(row.vehicle)
            if v is None:
                continue
            if row.position_m is not None:
                position[t, v] = row.position_m
            energy[t, v], phase[t, v], doing[t, v] = row.energy_j, str(row.phase), row.doing
    n_tasks = settings.problem.n_tasks
    return History(
        meta=meta,
        settings=settings,
        ids=ids,
        now_s=np.array([s.now_s for s in rows], dtype=np.float64),
        mission_s=np.array([s.mission_s for s in rows], dtype=np.float64),
        position_m=position,
        energy_j=energy,
        phase=phase,
        doing=doing,
        visited=np.array([s.tasks_visited for s in rows], dtype=np.bool_).reshape(len(rows), n_tasks),
        state=str(rows[-1].mission_state) if rows else "",
        predicted_s=np.array(
            [np.nan if s.predicted_makespan_s is None else s.predicted_makespan_s for s in rows], dtype=np.float64
        ),
        events=tuple(events),
        plans=tuple(plans),
        lateness=lateness,
        truncated=truncated,
    )


def from_recording(recording: Recording, settings: Settings) -> History:
    """Reads the history of a recorded run; ``settings`` are those of its mission.

    Raises:
        InputError: when the recording is damaged.
    """
    moments = np.array(list(recording.moments()), dtype=np.float64).reshape(-1, 2)
    late = moments[:, 1]
    lateness = Lateness(
        turns=len(late),
        end_s=float(moments[-1, 0]) if len(late) else 0.0,
        mean_late_s=float(late.mean()) if len(late) else 0.0,
        max_late_s=float(late.max()) if len(late) else 0.0,
        late_turns=int((late > PERIOD_S).sum()),
    )
    return collect(
        recording.meta,
        settings,
        recording.statuses(),
        recording.events(),
        recording.plans(),
        lateness,
        recording.truncated,
    )
