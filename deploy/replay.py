"""Replay: feeds every recorded observation through supervisor and gate again; the same commands must come out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

from deploy.errors import InputError
from deploy.gate import GateState, judge
from deploy.mission import Mission, load
from deploy.observation import PlanRequest
from deploy.recording import Recording, Tick, read, versions
from deploy.run_folder import MISSION
from deploy.supervisor import initial, step
from planner.problem import Problem


@dataclass(frozen=True, slots=True)
class Difference:
    """Where a replay first gave something else.

    Attributes:
        turn: of the loop, from 0.
        time_s: on the loop's clock.
        what: ``commands``, ``passed the gate``, ``refused``, ``events`` or ``replan asked for``.
        recorded, replayed: the first pair that differs, in words.
    """

    turn: int
    time_s: float
    what: str
    recorded: str
    replayed: str

    def __str__(self) -> str:
        where = f"turn {self.turn} at {self.time_s:.2f} s, {self.what}"
        return f"{where}: recorded {self.recorded}, replayed {self.replayed}"


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """How a replay went.

    Attributes:
        turns, commands: how many were compared.
        truncated: the recording breaks off; all of what is there was compared.
        difference: the first one, None where there is none.
        other_versions: what the recording was made with and is different now, name -> (then, now).
    """

    turns: int
    commands: int
    truncated: bool
    difference: Difference | None
    other_versions: dict[str, tuple[str, str]]

    @property
    def identical(self) -> bool:
        """Whether everything came out the same."""
        return self.difference is None


def mission_of(folder: Path) -> Mission:
    """The mission of a run, as it was run.

    Raises:
        InputError: when it is not there or is not the one that was flown.
    """
    path = folder / MISSION / "mission.yaml"
    if not path.is_file():
        raise InputError("is missing; give the folder of a run", file=path)
    return load(path)


def replay(folder: Path) -> ReplayResult:
    """Re-executes a run.

    Raises:
        InputError: when ``folder`` is no run, or its parts do not belong together.
    """
    recording = read(folder)
    mission = mission_of(folder)
    if mission.digest != recording.meta.mission_digest:
        what = "is not the mission that was flown: it was changed, or this version of the program reads it differently"
        raise InputError(what, file=folder / MISSION / "mission.yaml")
    return replay_of(recording, mission)


def replay_of(recording: Recording, mission: Mission) -> ReplayResult:
    """Re-executes a recording of ``mission``.

    Raises:
        InputError: when the recording holds no plan.
    """
    adopted = next(recording.plans(), None)
    if adopted is None:
        raise InputError("holds no plan; the run was broken off before it began", file=recording.path)
    state, gate = initial(mission.settings, adopted.plan), GateState()
    turns = commands = 0
    difference: Difference | None = None
    for tick in recording.ticks():
        turn = step(mission.settings, state, tick.observation)
        verdict = judge(mission.settings, gate, tick.observation, turn.commands)
        state, gate = turn.state, verdict.state
        difference = _difference(
            turns, tick, turn.commands, verdict.accepted, verdict.refused, turn.events, turn.request
        )
        turns, commands = turns + 1, commands + len(tick.emitted)
        if difference is not None:
            break
    now, then = versions(), recording.meta.versions
    changed = {name: (was, now.get(name, "-")) for name, was in then.items() if now.get(name, "-") != was}
    return ReplayResult(turns, commands, recording.truncated, difference, changed)


def _difference(
    number: int,
    tick: Tick,
    emitted: Sequence[Any],
    accepted: Sequence[Any],
    refused: Sequence[Any],
    events: Sequence[Any],
    request: object,
) -> Difference | None:
    pairs = (
        ("commands", tick.emitted, emitted),
        ("passed the gate", tick.accepted, accepted),
        ("refused", tick.refusals, refused),
        ("events", tick.events, events),
        ("replan asked for", (tick.plan_request,), (request,)),
    )
    for what, was, now in pairs:
        for i in range(max(len(was), len(now))):
            a, b = (items[i] if i < len(items) else None for items in (was, now))
            if not _same(a, b):
                return Difference(number, tick.observation.now_s, what, *_words(a, b))
    return None


def _same(a: object, b: object) -> bool:
    """Equality, also of what holds a problem: its arrays have no plain equality, its digest does."""
    if isinstance(a, Problem) and isinstance(b, Problem):
        return a.digest == b.digest
    if isinstance(a, PlanRequest) and isinstance(b, PlanRequest):
        return all(_same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return a == b


def _words(a: object, b: object) -> tuple[str, str]:
    """Both in words; of two of a kind only the first member that differs."""
    if type(a) is type(b) and is_dataclass(a) and not isinstance(a, type):
        for f in fields(a):
            x, y = getattr(a, f.name), getattr(b, f.name)
            if not _same(x, y):
                who = getattr(a, "vehicle", None)
                name = f"{type(a).__name__}{f' of {who}' if who else ''}: {f.name}"
                return f"{name} = {_short(x)}", f"{f.name} = {_short(y)}"
    return _short(a), _short(b)


def _short(value: object) -> str:
    text = "nothing" if value is None else "another problem" if isinstance(value, Problem) else repr(value)
    return text if len(text) <= 300 else text[:297] + "..."
