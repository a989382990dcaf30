"""Connects a whole fleet at once, everybody in a thread of its own, with a deadline."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Literal

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.vehicle import PoseSource, Vehicle

POSES = "poses"
"""Name of the motion capture among the vehicles."""
GRACE_S = 2.0
"""A driver that is still busy so long after its deadline hangs; nobody waits for it any more."""
LOOK_S = 0.05

Phase = Literal["connecting", "ready", "failed"]
Tell = Callable[[str, Phase, str], None]
"""Told a name, what has become of it, and in words why."""


def connect_all(
    vehicles: Mapping[str, Vehicle],
    poses: PoseSource,
    clock: Clock,
    deadline_s: float,
    tell: Tell,
    on_poses: Callable[[], None] = lambda: None,
) -> dict[str, str]:
    """Connects everybody in parallel.

    Args:
        vehicles: by id.
        poses: motion capture.
        clock: real; the deadline's.
        deadline_s: for everybody.
        tell: told of each one's progress, in the caller's thread.
        on_poses: called once poses can be read, from a thread of motion capture.

    Returns:
        why somebody could not be reached, by vehicle id and ``poses``, in the driver's words.
    """
    begun_s = clock.now()
    outcomes: dict[str, str | None] = {}
    threads: dict[str, threading.Thread] = {}

    def connect(name: str, connect_it: Callable[[float], None], then: Callable[[], None]) -> None:
        try:
            connect_it(deadline_s)
            then()
            outcomes[name] = None
        except DriverError as error:
            outcomes[name] = str(error)
        except Exception as error:  # a bug in a driver must not hang everybody else
            outcomes[name] = f"{name}: its driver failed: {type(error).__name__}: {error}"

    jobs: dict[str, tuple[Callable[[float], None], Callable[[], None]]] = {POSES: (poses.connect, on_poses)}
    jobs |= {name: (vehicle.connect, lambda: None) for name, vehicle in vehicles.items()}
    for name, (connect_it, then) in jobs.items():
        tell(name, "connecting", "")
        thread = threading.Thread(target=connect, args=(name, connect_it, then), name=f"connect {name}", daemon=True)
        threads[name] = thread
        thread.start()
    waiting = list(jobs)
    while waiting and clock.now() < deadline_s + GRACE_S:
        clock.wait_until(clock.now() + LOOK_S)
        for name in [n for n in waiting if n in outcomes]:
            waiting.remove(name)
            why = outcomes[name]
            tell(name, "ready" if why is None else "failed", why or f"after {clock.now() - begun_s:.1f} s")
    for name in waiting:
        waited_s = clock.now() - begun_s
        why = f"{name}: its driver has not answered for {waited_s:.0f} s; check power and address, then start again"
        outcomes[name] = why
        tell(name, "failed", why)
    return {name: why for name, why in outcomes.items() if why is not None}
