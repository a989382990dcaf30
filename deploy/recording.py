"""Recording of a run: ``recording.mcap``, complete for replay and readable in Foxglove, and ``log.txt``.

``docs/recordings.md`` lists the channels. The file is cut into chunks at the end of a turn, about once a second, so
that a killed process leaves all but its last second. Everything of one turn stands behind its observation.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import TextIO

import foxglove
from foxglove.mcap import MCAPWriteOptions

from deploy.drawing import MapDrawing
from deploy.errors import DeployError, InputError
from deploy.events import Event
from deploy.observation import Observation, PlanRequest, Refusal
from deploy.recording_meta import RunMeta, versions
from deploy.recording_read import Adopted, Recording, Tick, read
from deploy.recording_scene import SceneWriter
from deploy.recording_schema import schema_of
from deploy.serial import encode, to_json
from deploy.settings import Settings
from deploy.status import Status
from drivers.vehicle import Command
from planner.plan import Plan
from planner.problem import Problem

FILE = "recording.mcap"
LOG = "log.txt"
FLUSH_S = 1.0  # wall-clock time between chunks: what a crash may cost
FLUSH_BYTES = 4 << 20  # a chunk is held in memory, and a virtual clock writes minutes a second
STATUS_S = 0.1  # loop time between statuses without an event

__all__ = ["FILE", "LOG", "Adopted", "Recorder", "Recording", "RunMeta", "Tick", "read", "versions"]


class Recorder:
    """Writes one run; used by one thread."""

    def __init__(
        self, folder: Path, mission_meta: RunMeta, settings: Settings, scene: MapDrawing | None = None
    ) -> None:
        """Opens the recording in ``folder``, which is made where it is missing.

        Raises:
            InputError: when there already is a recording, or the folder cannot be written.
        """
        path = folder / FILE
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if path.exists():
                raise InputError("there already is a recording here; give another --out", file=path)
            self._context = foxglove.Context()
            self._writer = foxglove.open_mcap(
                path,
                context=self._context,
                # chunks end where flush() says and are written in one piece (no seeking back to complete them); threads
                # for compression cost more than they save at this size
                writer_options=MCAPWriteOptions(chunk_size=None, disable_seeking=True, compression_threads=0),
            )
            self._log: TextIO = (folder / LOG).open("a", encoding="utf-8", buffering=1)
        except (OSError, RuntimeError) as error:
            raise InputError(f"cannot record here: {error}; give another --out", file=folder) from error
        self._path = path
        self._start_ns = round(mission_meta.started_unix_s * 1e9)
        self._closed = False
        self._tick = 0
        self._bytes = 0
        self._flushed_s = time.monotonic()
        self._now_s = 0.0
        self._mission_s = 0.0
        self._status_due_s = float("-inf")
        self._last_status: Status | None = None

        def channel(name: str, kind: type | None = None) -> foxglove.Channel:
            schema = schema_of(f"copcs.{(kind.__name__ if kind else name.title().replace('_', ''))}", kind)
            return foxglove.Channel(f"/copcs/{name}", schema=schema, context=self._context)

        self._observations = channel("observation", Observation)
        self._commands = channel("commands")
        self._events = channel("events", Event)
        self._statuses = channel("status", Status)
        self._plans = channel("plan")
        self._requests = channel("plan_request")
        meta = {**asdict(mission_meta), "problem": settings.problem.to_json()}
        self._write(channel("mission"), encode(meta), self._ns(0.0))
        self._scene = SceneWriter(self._context, settings, scene)
        self._scene.start(self._ns(0.0))
        self._flush()

    def tick(
        self,
        observation: Observation,
        emitted: Sequence[Command] = (),
        accepted: Sequence[Command] = (),
        sent: Sequence[Command] = (),
        refusals: Sequence[Refusal] = (),
        events: Sequence[Event] = (),
        status: Status | None = None,
        plan_request: PlanRequest | None = None,
    ) -> None:
        """Records one turn of the loop.

        Args:
            observation: what ``step`` saw.
            emitted: the commands that ``step`` wanted.
            accepted: those of them that the gate let pass.
            sent: those that were sent, as the drivers really sent them.
            refusals: those that the gate refused.
            events: what ``step`` said happened.
            status: the mission after ``step``; written with every event and at most ten times a second of loop time.
            plan_request: the replan that ``step`` asked for.

        Raises:
            DeployError: when the recording cannot be written any more (a full disk); said once, from then on nothing is
                recorded.
        """
        if self._closed:
            return
        now_s = self._now_s = observation.now_s
        ns = self._ns(now_s)
        self._write(self._observations, encode(observation), ns)
        if emitted or accepted or sent or refusals:
            turn = {
                "tick": self._tick,
                "emitted": to_json(emitted),
                "accepted": to_json(accepted),
                "sent": to_json(sent),
                "refusals": to_json(refusals),
            }
            self._write(self._commands, encode(turn), ns)
        for event in events:
            self._write(self._events, encode(event), ns)
            self._scene.log(event, ns)
            self._note(log_line(event))
        if plan_request is not None:
            self._write(self._requests, encode({"time_s": now_s, "request": plan_request}), ns)
        if status is not None:
            self._last_status, self._mission_s = status, status.mission_s
            if events or now_s >= self._status_due_s:
                self._write_status(status, ns)
        self._scene.tick(observation, status, ns)
        self._tick += 1
        if self._bytes > FLUSH_BYTES or time.monotonic() - self._flushed_s > FLUSH_S:
            self._flush()

    def plan(
        self, plan: Plan, time_s: float, reason: str, problem: Problem | None = None, zero_s: float | None = None
    ) -> None:
        """Records a plan that has been adopted.

        Args:
            plan: with its schedule.
            time_s: when, loop clock.
            reason: why, in words.
            problem: what it solves, where it is not the mission's.
            zero_s: mission time of its schedule's 0; the present mission time where not given.
        """
        if self._closed:
            return
        adopted = {
            "time_s": time_s,
            "zero_s": self._mission_s if zero_s is None else zero_s,
            "reason": reason,
            "problem": None if problem is None else problem.to_json(),
            "plan": plan,
        }
        ns = self._ns(time_s)
        self._write(self._plans, encode(adopted), ns)
        self._scene.plan(plan, problem, ns)
        self._flush()

    def close(self) -> None:
        """Ends the recording; closing again does nothing.

        Raises:
            DeployError: when its end cannot be written; what was flushed before is readable.
        """
        if self._closed:
            return
        if self._last_status is not None:
            self._write_status(self._last_status, self._ns(self._now_s))
        self._closed = True
        try:
            self._log.close()
            self._writer.close()
        except (OSError, RuntimeError) as error:
            raise self._failure(error) from error

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ns(self, now_s: float) -> int:
        return self._start_ns + round(now_s * 1e9)

    def _note(self, line: str) -> None:
        try:
            self._log.write(line)
        except OSError as error:
            self._give_up()
            raise self._failure(error) from error

    def _write(self, channel: foxglove.Channel, data: bytes, ns: int) -> None:
        channel.base.log(data, ns)
        self._bytes += len(data)

    def _write_status(self, status: Status, ns: int) -> None:
        self._write(self._statuses, encode(status), ns)
        self._status_due_s = status.now_s + STATUS_S * 0.999  # not one turn later for the sake of rounding

    def _flush(self) -> None:
        try:
            self._writer.flush()
        except (OSError, RuntimeError) as error:
            self._give_up()
            raise self._failure(error) from error
        self._bytes, self._flushed_s = 0, time.monotonic()

    def _give_up(self) -> None:
        """Nothing can be written any more: say so once, and let the flight go on."""
        self._closed = True
        for end in (self._log.close, self._writer.close):
            with suppress(OSError, RuntimeError):
                end()

    def _failure(self, error: Exception) -> DeployError:
        return DeployError(f"{self._path}: cannot write the recording: {error}; free some disk space")


def log_line(event: Event) -> str:
    """One line of ``log.txt``."""
    action = event.action.name.lower().replace("_", " ")
    who = event.vehicle or "mission"
    return f"{event.time_s:10.3f}  {event.severity.name:8}  {who:10}  {event.kind.value:18}  {event.text} [{action}]\n"
