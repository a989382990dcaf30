"""The operator's hand: signals during a flight become wishes that the loop reads, once per turn.

Ctrl-C once brings everybody down (``recover``), twice stops all motors (``stop``). The end of the terminal or of the
service (SIGHUP, SIGTERM) is a ``recover`` as well: nothing may be left in the air because a shell was closed. Ctrl-Z
(SIGTSTP) does nothing: a program that is paused flies nobody.
"""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterable, Sequence
from queue import Empty, SimpleQueue
from types import FrameType
from typing import Any, Literal, Protocol, Self

from deploy.observation import OperatorInput
from drivers.clock import Clock

Wish = Literal["checked", "arm", "start", "hold", "resume", "recover", "stop"]

GIVE_UP_S = 5.0
"""A loop that has not answered a stop for so long (wall clock) hangs; Ctrl-C then ends the program."""


class Operator(Protocol):
    """Where the loop reads the operator's wishes from; a context manager that is open during the flight."""

    wished: set[Wish]
    """Everything wished so far."""

    def __enter__(self) -> Self:
        """The flight begins."""
        ...

    def __exit__(self, *error: object) -> None:
        """It is over."""
        ...

    def attach(self, clock: Clock) -> None:
        """Tells the clock of the flight that begins; called once, before the first ``poll``."""
        ...

    def poll(self) -> tuple[OperatorInput, ...]:
        """Wishes since the last call; never blocks."""
        ...


class _Open:
    """Nothing to open and to close."""

    def __enter__(self) -> Self:
        """The flight begins."""
        return self

    def __exit__(self, *error: object) -> None:
        """It is over."""


class QueueOperator(_Open):
    """Wishes from any thread or signal handler, in the order they came."""

    def __init__(self) -> None:
        # SimpleQueue.put is re-entrant: a signal handler may interrupt a put or a get of the same thread.
        self._queue: SimpleQueue[OperatorInput] = SimpleQueue()
        self.wished: set[Wish] = set()

    def attach(self, clock: Clock) -> None:
        """Needs no clock."""

    def wish(self, wish: Wish) -> None:
        """Adds a wish; safe from everywhere."""
        self.wished.add(wish)
        self._queue.put(OperatorInput(wish))

    def poll(self) -> tuple[OperatorInput, ...]:
        """Wishes since the last call."""
        wishes: list[OperatorInput] = []
        while True:
            try:
                wishes.append(self._queue.get_nowait())
            except Empty:
                return tuple(wishes)


class SignalOperator(QueueOperator):
    """Ctrl-C, SIGTERM and SIGHUP as wishes, while it is used as a context manager in the main thread.

    Args:
        say: told, in words for the operator, what a signal has set going.
    """

    def __init__(self, say: Callable[[str], None] = lambda text: None) -> None:
        super().__init__()
        self._say = say
        self._before: dict[int, Any] = {}
        self._presses = 0
        self._stopped_at_s = 0.0
        self._turns_since_stop = 0

    def __enter__(self) -> Self:
        """Takes over the signals."""
        self._before[signal.SIGINT] = signal.signal(signal.SIGINT, self._on_interrupt)
        for number in (signal.SIGTERM, signal.SIGHUP):
            self._before[number] = signal.signal(number, self._on_terminate)
        self._before[signal.SIGTSTP] = signal.signal(signal.SIGTSTP, self._on_pause)
        return self

    def __exit__(self, *error: object) -> None:
        """Gives the signals back."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def poll(self) -> tuple[OperatorInput, ...]:
        """Wishes since the last call."""
        if self._presses >= 2:
            self._turns_since_stop += 1
        return super().poll()

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        self._presses += 1
        if self._presses == 1:
            self.wish("recover")
            self._say("Ctrl-C: bringing everybody down; once more stops all motors at once")
        elif self._presses == 2:
            self._stopped_at_s = time.monotonic()
            self.wish("stop")
            self._say("Ctrl-C again: stopping all motors")
        # From the third turn on the stop has been sent and seen; before that, ending the program could lose it.
        elif self._turns_since_stop >= 3 or time.monotonic() - self._stopped_at_s > GIVE_UP_S:
            raise KeyboardInterrupt
        else:
            self.wish("stop")

    def _on_pause(self, number: int, frame: FrameType | None) -> None:
        self._say("Ctrl-Z is of no use in flight; Ctrl-C brings everybody down")

    def _on_terminate(self, number: int, frame: FrameType | None) -> None:
        if "recover" not in self.wished:
            self._presses = max(self._presses, 1)
            self.wish("recover")
            self._say(f"{signal.Signals(number).name}: bringing everybody down")


class ScriptedOperator(_Open):
    """Wishes at given times of the loop's clock, for tests and rehearsals.

    Args:
        script: (time in arena s, wish) in any order.
    """

    def __init__(self, script: Iterable[tuple[float, Wish]] = ()) -> None:
        self._script: Sequence[tuple[float, Wish]] = sorted(script, key=lambda row: row[0])
        self._next = 0
        self._clock: Clock | None = None
        self.wished: set[Wish] = set()

    def attach(self, clock: Clock) -> None:
        """Whose time the script's times are."""
        self._clock = clock

    def poll(self) -> tuple[OperatorInput, ...]:
        """Wishes whose time has come since the last call."""
        wishes: list[OperatorInput] = []
        while self._clock and self._next < len(self._script) and self._script[self._next][0] <= self._clock.now():
            wish = self._script[self._next][1]
            self.wished.add(wish)
            wishes.append(OperatorInput(wish))
            self._next += 1
        return tuple(wishes)
