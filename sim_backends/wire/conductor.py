"""The conductor of a wire simulation: sets the faults going, audits the truth, moves bodies whose endpoint has died.

Run as ``python -m sim_backends.wire.conductor --world FOLDER --parent PID``; ``launch`` does. What it decides is in
``modifiers``, ``audit`` and ``orphans``; here are the clock and the files.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import signal
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cattrs

from sim_backends.errors import SimulationError
from sim_backends.faults import Fault
from sim_backends.truth import Truth
from sim_backends.wire.audit import Audit
from sim_backends.wire.modifiers import FaultTimes
from sim_backends.wire.orphans import Orphans
from sim_backends.wire.world import World

FAULTS, TRUTH = "faults.json", "truth.json"
PERIOD_S = 0.02
TELL_S = 1.0
"""The truth is written so often, and at the end."""
PARENT_S = 0.5
LINGER_S = 2.0


def write_faults(folder: Path, faults: Sequence[Fault]) -> None:
    """Leaves the faults in the world's folder for the conductor."""
    (folder / FAULTS).write_text(json.dumps(cattrs.unstructure(list(faults))))


def read_faults(folder: Path) -> list[Fault]:
    """The faults of a world; none where nobody has left any.

    Raises:
        SimulationError: when the file cannot be understood.
    """
    path = folder / FAULTS
    if not path.exists():
        return []
    try:
        return cattrs.structure(json.loads(path.read_text()), list[Fault])
    except (OSError, ValueError, cattrs.BaseValidationError) as error:
        raise SimulationError(f"{path} cannot be read: {error}; write it with write_faults") from error


def write_truth(folder: Path, truth: Truth) -> None:
    """Writes the audit, whole or not at all."""
    temporary = folder / f"{TRUTH}.new"
    temporary.write_text(json.dumps(cattrs.unstructure(truth)))
    temporary.replace(folder / TRUTH)


def read_truth(folder: Path) -> Truth:
    """The newest audit, at most a second old.

    Raises:
        SimulationError: when there is none yet.
    """
    try:
        return cattrs.structure(json.loads((folder / TRUTH).read_text()), Truth)
    except (OSError, ValueError) as error:
        raise SimulationError(f"{folder}: the conductor has told no truth yet: {error}; start it first") from error


class Conductor:
    """One look after the other.

    Args:
        world: the shared one.
        faults: of this world.
        zero_s: ``time.monotonic()`` at which the truth's times begin.
    """

    def __init__(self, world: World, faults: Sequence[Fault], zero_s: float) -> None:
        self._world, self._zero_s = world, zero_s
        self._times = FaultTimes(world.config, faults)
        self._audit = Audit(world.config)
        self._orphans = Orphans(world.n_uav, len(world.ids))
        self._active: frozenset[int] = frozenset()
        self._fallen: set[int] = set()
        self._last_s = time.monotonic()

    def look(self) -> None:
        """Sets the faults of the moment, moves orphans, audits."""
        world, now_s = self._world, time.monotonic()
        dt_s, self._last_s = now_s - self._last_s, now_s
        rows = range(len(world.ids))
        started_s = world.started_s
        active = self._times.active(None if started_s is None else now_s - started_s)
        modifiers = [world.modifiers(row) for row in rows]
        if active != self._active:
            for row, wanted in enumerate(self._times.modifiers(active, self._active, modifiers)):
                if wanted != modifiers[row]:
                    world.modify(row, wanted)
                    modifiers[row] = wanted
            self._active = active
        bodies = world.bodies()
        for row in rows:
            if self._orphans.look(now_s, row, bodies[row]):
                pad_m = world.pad_m(bodies[row].on, bodies[row].dock) if bodies[row].on >= 0 else None
                world.put(row, self._orphans.moved(row, bodies[row], min(dt_s, 0.1), pad_m))
                bodies[row] = world.body(row)
                self._orphans.wrote(row, bodies[row])
        hit = [
            m.lost or row in self._orphans.taken or (m.motor_fail and row not in self._fallen)
            for row, m in enumerate(modifiers)
        ]
        for row in self._audit.look(now_s - self._zero_s, bodies, hit):
            self._fallen.add(row)
            world.modify(row, replace(world.modifiers(row), motor_fail=True))

    def truth(self) -> Truth:
        """The audit until now."""
        return self._audit.truth(time.monotonic() - self._zero_s)


def serve(world: World, stop: threading.Event, zero_s: float | None = None, parent: int | None = None) -> None:
    """Conducts until ``stop`` is set or the process ``parent`` has ended; then nobody needs the folder any more."""
    begun_s = time.monotonic()
    conductor = Conductor(world, read_faults(world.folder), begun_s if zero_s is None else zero_s)
    conductor.look()
    write_truth(world.folder, conductor.truth())
    print("ready", flush=True)
    due_s = told_s = looked_s = begun_s
    while not stop.is_set():
        due_s = max(due_s + PERIOD_S, time.monotonic())
        stop.wait(due_s - time.monotonic())
        conductor.look()
        now_s = time.monotonic()
        if now_s - told_s >= TELL_S:
            told_s = now_s
            write_truth(world.folder, conductor.truth())
        if parent is not None and now_s - looked_s >= PARENT_S:
            looked_s = now_s
            if not alive(parent):
                stop.wait(LINGER_S)  # the endpoints notice it, too, and may still write
                shutil.rmtree(world.folder, ignore_errors=True)
                return
    if world.folder.is_dir():
        write_truth(world.folder, conductor.truth())


def alive(pid: int) -> bool:
    """Whether a process exists."""
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="conductor", description="Conducts the faults and the audit of a simulated world."
    )
    parser.add_argument("--world", type=Path, required=True, metavar="FOLDER", help="folder of the simulated world")
    parser.add_argument("--zero", type=float, metavar="S", help="monotonic time at which the truth's times begin")
    parser.add_argument("--parent", type=int, metavar="PID", help="end when this process ends")
    options = parser.parse_args(arguments)
    if options.zero is not None and not math.isfinite(options.zero):
        parser.error("--zero: give a finite number")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        serve(World(options.world), stop, options.zero, options.parent)
    except SimulationError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
