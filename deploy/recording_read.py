"""Reading a recording back: exact turns for replay, statuses and plans for the report."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import orjson

from deploy.errors import InputError
from deploy.events import Event
from deploy.observation import Observation, PlanRequest, Refusal
from deploy.recording_bytes import MAGIC, messages, whole
from deploy.recording_meta import RunMeta
from deploy.serial import decode, from_json, plan_from_json
from deploy.status import Status
from drivers.vehicle import Command
from planner.errors import PlannerError
from planner.plan import Plan
from planner.problem import Problem

PREFIX = "/copcs/"


@dataclass(frozen=True, slots=True)
class Tick:
    """One turn of the loop, as ``Recorder.tick`` takes it; ``status`` is None in turns where it was not written."""

    observation: Observation
    emitted: tuple[Command, ...] = ()
    accepted: tuple[Command, ...] = ()
    sent: tuple[Command, ...] = ()
    refusals: tuple[Refusal, ...] = ()
    events: tuple[Event, ...] = ()
    status: Status | None = None
    plan_request: PlanRequest | None = None


@dataclass(frozen=True, slots=True)
class Adopted:
    """A plan in force from ``time_s`` (loop clock); its schedule's 0 is at mission time ``zero_s``."""

    time_s: float
    zero_s: float
    reason: str
    plan: Plan
    problem: Problem | None = None


@dataclass(frozen=True, slots=True)
class Recording:
    """A recording on disk.

    Attributes:
        path: the file.
        meta: its head.
        problem: the mission's problem.
        truncated: the run was cut short; everything up to its last whole chunk is here.
    """

    path: Path
    meta: RunMeta
    problem: Problem
    truncated: bool

    def ticks(self) -> Iterator[Tick]:
        """Every turn in order, each exactly as it was."""
        turn: dict[str, Any] | None = None
        with self._naming_the_file():
            for topic, data in self._messages("observation", "commands", "events", "status", "plan_request"):
                if topic == "observation":
                    if turn is not None:
                        yield Tick(**turn)
                    turn = {"observation": decode(Observation, data)}
                elif turn is not None:
                    _add(turn, topic, data)
        if turn is not None:
            yield Tick(**turn)

    def moments(self) -> Iterator[tuple[float, float]]:
        """Loop time and lateness of every turn, in s; faster than ``ticks``."""
        with self._naming_the_file():
            for _, data in self._messages("observation"):
                row = orjson.loads(data)
                yield row["now_s"], row["late_s"]

    def events(self) -> Iterator[Event]:
        """Every event in order."""
        with self._naming_the_file():
            yield from (decode(Event, data) for _, data in self._messages("events"))

    def statuses(self) -> Iterator[Status]:
        """Every recorded status in order."""
        with self._naming_the_file():
            yield from (decode(Status, data) for _, data in self._messages("status"))

    def plans(self) -> Iterator[Adopted]:
        """Every plan that was adopted, in order."""
        with self._naming_the_file():
            for _, data in self._messages("plan"):
                row = orjson.loads(data)
                problem = None if row["problem"] is None else Problem.from_json(row["problem"])
                yield Adopted(row["time_s"], row["zero_s"], row["reason"], plan_from_json(row["plan"]), problem)

    def _messages(self, *names: str) -> Iterator[tuple[str, bytes]]:
        """Exact channels' names and data."""
        with self.path.open("rb") as stream:
            for topic, data in messages(stream, {PREFIX + name for name in names}):
                yield topic.removeprefix(PREFIX), data

    @contextmanager
    def _naming_the_file(self) -> Iterator[None]:
        try:
            yield
        except (InputError, PlannerError, KeyError, TypeError, ValueError) as error:
            what = error.what if isinstance(error, InputError) else f"damaged: {error!r}"
            raise InputError(what, file=self.path) from error


def _add(turn: dict[str, Any], topic: str, data: bytes) -> None:
    match topic:
        case "commands":
            row = orjson.loads(data)
            turn |= {k: from_json(tuple[Command, ...], row[k]) for k in ("emitted", "accepted", "sent")}
            turn["refusals"] = from_json(tuple[Refusal, ...], row["refusals"])
        case "events":
            turn["events"] = (*turn.get("events", ()), decode(Event, data))
        case "status":
            turn["status"] = decode(Status, data)
        case "plan_request":
            turn["plan_request"] = from_json(PlanRequest, orjson.loads(data)["request"])


def read(folder: Path) -> Recording:
    """Opens the recording of a run folder (or the ``.mcap`` file itself).

    Raises:
        InputError: when it is missing, is no recording of this program, or is damaged before its first turn.
    """
    path = folder / "recording.mcap" if folder.is_dir() else folder
    try:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise InputError("not an MCAP file; give a run folder of copcs-deploy", file=path)
            truncated = not whole(stream)
            head = next((data for _, data in messages(stream, {PREFIX + "mission"})), None)
    except FileNotFoundError as error:
        raise InputError("no such file; give a run folder of copcs-deploy", file=path) from error
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}; give another run folder", file=path) from error
    if head is None:
        what = "damaged before its first turn" if truncated else "not a recording of copcs-deploy"
        raise InputError(f"{what}; give the folder of another run", file=path)
    try:
        row = orjson.loads(head)
        problem = Problem.from_json(row.pop("problem"))
        return Recording(path, from_json(RunMeta, row), problem, truncated)
    except (KeyError, ValueError, AttributeError, TypeError, PlannerError, InputError) as error:
        raise InputError(f"its head is damaged ({error}); give the folder of another run", file=path) from error
