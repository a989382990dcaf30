"""Everybody who watches a flight: the recording, the plan files and the display. None of them can end it."""

from __future__ import annotations

import json
from pathlib import Path

from deploy.display import Display
from deploy.recording import Recorder
from deploy.runner import Tick
from deploy.serial import plan_to_json
from planner.plan import Plan
from planner.problem import Problem


class Watch:
    """The loop's observer.

    Args:
        recorder: of the run.
        folder: where plans go as ``plan-0.json``, ``plan-1.json``, ...
        display: for the operator.
    """

    def __init__(self, recorder: Recorder, folder: Path, display: Display) -> None:
        self._recorder, self._folder, self._display = recorder, folder, display
        self._plans = 0
        self._display_works = True
        self.failure: str | None = None

    def tick(self, tick: Tick) -> None:
        """Records and shows one turn."""
        if self.failure is None:
            try:
                self._recorder.tick(
                    tick.observation,
                    tick.emitted,
                    tick.accepted,
                    tick.sent,
                    tick.refusals,
                    tick.events,
                    tick.status,
                    tick.request,
                )
            except Exception as error:  # vehicles are in the air: a full disk must not end the loop
                self._fail(error)
        if self._display_works and (tick.events or self._display.due()):
            try:
                self._display.update(tick.status, tick.events)
            except Exception as error:
                self._display_works = False
                self._say(f"the display has failed and stays as it is; the flight goes on: {error!r}")

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Records a plan that was adopted."""
        number, self._plans = self._plans, self._plans + 1
        if self.failure is not None:
            return
        try:
            self._recorder.plan(plan, time_s, reason, problem, zero_s=mission_s)
            text = json.dumps(plan_to_json(plan), indent=1, allow_nan=False)
            (self._folder / f"plan-{number}.json").write_text(text + "\n", encoding="utf-8")
        except Exception as error:
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        self.failure = str(error) or repr(error)
        self._say(f"recording has stopped, the flight goes on: {self.failure}")

    def _say(self, text: str) -> None:
        try:
            self._display.note(text)
        except Exception:  # then nobody can be told
            self._display_works = False
