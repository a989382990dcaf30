"""What the operator sees of a run: a live screen in a terminal, one plain line an event where output is piped."""

from __future__ import annotations

import contextlib
import sys
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Protocol, TextIO

from rich.console import Console
from rich.live import Live
from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

from deploy.events import Event, Severity
from deploy.screen import Header, clock_text, render, what_text
from deploy.startup import Phase, Tell
from deploy.startup_screen import StartupScreen, startup_line
from deploy.status import Status

REFRESH_S = 0.1
"""Wall-clock time between two pictures: quick for the eye, nothing beside the cost of a virtual-clock turn."""
EVENTS_KEPT = 30


class SteadyConsole(Console):
    """A console that falls silent when whoever reads it has gone; rich's own would end the program, in flight too."""

    def on_broken_pipe(self) -> None:
        """Says nothing from now on."""
        self.quiet = True


class Display(Protocol):
    """Told about a run as it goes; must never stop one."""

    def note(self, text: str) -> None:
        """Something outside the flight itself: planning, checks, where files went."""
        ...

    def working(self, text: str) -> AbstractContextManager[object]:
        """Something outside the flight that takes a while."""
        ...

    def progress(self) -> AbstractContextManager[Tell]:
        """The fleet connects; what it returns is told of everybody's progress."""
        ...

    def begin(self, header: Header) -> None:
        """The flight begins."""
        ...

    def due(self) -> bool:
        """Whether it is time for a new picture; ``update`` may be skipped where not, its events excepted."""
        ...

    def update(self, status: Status | None, events: Sequence[Event]) -> None:
        """A moment of the flight; None where only the events are new."""
        ...

    def end(self) -> None:
        """The flight is over."""
        ...


class NullDisplay:
    """Shows nothing."""

    def note(self, text: str) -> None:
        """Nothing."""

    def working(self, text: str) -> AbstractContextManager[object]:
        """Nothing."""
        return contextlib.nullcontext()

    def progress(self) -> AbstractContextManager[Tell]:
        """Nothing."""
        return contextlib.nullcontext(lambda name, phase, text: None)

    def begin(self, header: Header) -> None:
        """Nothing."""

    def due(self) -> bool:
        """Never."""
        return False

    def update(self, status: Status | None, events: Sequence[Event]) -> None:
        """Nothing."""

    def end(self) -> None:
        """Nothing."""


class PlainDisplay:
    """One line an event, in mission time; for pipes, logs and CI.

    Args:
        stream: where to; a stream that is closed (``| head``) silences the display, not the flight.
    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = stream or sys.stdout
        self._time_scale = 1.0
        self._start_s = 0.0

    def note(self, text: str) -> None:
        """One line."""
        self._print(text)

    def working(self, text: str) -> AbstractContextManager[object]:
        """Nothing: who reads lines wants results."""
        return contextlib.nullcontext()

    def progress(self) -> AbstractContextManager[Tell]:
        """One line for who is ready or has failed."""

        def tell(name: str, phase: Phase, text: str) -> None:
            line = startup_line(name, phase, text)
            if line is not None:
                self._print(line)

        return contextlib.nullcontext(tell)

    def begin(self, header: Header) -> None:
        """One line that says what is flown."""
        self._time_scale = header.time_scale
        self._print(f"flying {header.mission}: {header.tasks} tasks, {header.subtitle}")

    def due(self) -> bool:
        """Never: events are all it shows."""
        return False

    def update(self, status: Status | None, events: Sequence[Event]) -> None:
        """A line for each event."""
        if status is not None:
            self._start_s = status.now_s - status.mission_s * self._time_scale
        for event in events:
            mission_s = max(0.0, (event.time_s - self._start_s) / self._time_scale)
            level = "" if event.severity is Severity.INFO else f"{event.severity.name.lower()}: "
            self._print(f"{clock_text(mission_s):>8}  {event.vehicle or '-':<8} {level}{what_text(event)}")

    def end(self) -> None:
        """Nothing more to show."""

    def _print(self, text: str) -> None:
        with _harmless():
            print(text, file=self._stream, flush=True)


class LiveDisplay:
    """A screen that is redrawn in place, at 80 columns and at 200.

    Args:
        console: a terminal.
    """

    def __init__(self, console: Console | None = None) -> None:
        self._console = console or SteadyConsole()
        self._live: Live | None = None
        self._header: Header | None = None
        self._status: Status | None = None
        self._events: deque[Event] = deque(maxlen=EVENTS_KEPT)
        self._drawn_s = float("-inf")

    def note(self, text: str) -> None:
        """One line above the screen."""
        with _harmless():
            self._console.print(text, style="dim", highlight=False, markup=False)

    def working(self, text: str) -> AbstractContextManager[object]:
        """A line that moves, gone when it is done."""
        columns = (SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn())
        progress = Progress(*columns, console=self._console, transient=True)
        progress.add_task(text, total=None)
        return progress

    @contextlib.contextmanager
    def progress(self) -> Iterator[Tell]:
        """A table that fills; it stays."""
        screen = StartupScreen()
        live = Live(screen, console=self._console, refresh_per_second=10)
        with _harmless():
            live.start()
        try:
            yield screen.tell
        finally:
            with _harmless():
                live.stop()

    def begin(self, header: Header) -> None:
        """Opens the screen."""
        self._header = header
        # rich would start a refresh thread of its own; pictures are drawn by the loop, when they are due.
        self._live = Live(console=self._console, auto_refresh=False, vertical_overflow="crop")
        with _harmless():
            self._live.start()

    def due(self) -> bool:
        """Ten times a second."""
        return time.monotonic() - self._drawn_s >= REFRESH_S

    def update(self, status: Status | None, events: Sequence[Event]) -> None:
        """Draws, when it is due."""
        self._events.extend(events)
        self._status = status or self._status
        if self.due():
            self._draw()

    def end(self) -> None:
        """Draws the last picture and leaves it standing."""
        if self._live is not None:
            self._draw()
            with _harmless():
                self._live.stop()
            self._live = None

    def _draw(self) -> None:
        if self._live is None or self._header is None or self._status is None:
            return
        with _harmless():
            size = self._console.size
            picture = render(self._header, self._status, tuple(self._events), size.width, size.height)
            self._live.update(picture, refresh=True)
        self._drawn_s = time.monotonic()


def make_display(*, quiet: bool) -> Display:
    """The display that suits where standard output goes; ``quiet`` (as with ``--json``) shows nothing."""
    if quiet:
        return NullDisplay()
    console = SteadyConsole()
    return LiveDisplay(console) if console.is_terminal and not console.is_dumb_terminal else PlainDisplay()


@contextlib.contextmanager
def _harmless() -> Iterator[None]:
    """A closed pipe or a full disk behind standard output must not end a flight."""
    with contextlib.suppress(OSError, ValueError):
        yield
