"""The loop's clock: real, or virtual where the world is simulated in process."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """Time in s since some fixed moment; the only clock that loop, drivers and recordings know."""

    def now(self) -> float:
        """Current time in s."""
        ...

    def wait_until(self, time_s: float) -> float:
        """Lets time pass until ``time_s`` and returns the time reached.

        A virtual clock may return early, at a moment when something the loop can see has changed.
        """
        ...


class RealClock:
    """Monotonic wall-clock time since construction."""

    def __init__(self) -> None:
        self._start_s = time.monotonic()

    def now(self) -> float:
        """Current time in s."""
        return time.monotonic() - self._start_s

    def wait_until(self, time_s: float) -> float:
        """Sleeps until ``time_s``; returns at once when it has passed."""
        delay_s = time_s - self.now()
        if delay_s > 0:
            time.sleep(delay_s)
        return self.now()
