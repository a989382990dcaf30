"""Small lab missions on wire simulations, for tests."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import psutil

from deploy.mission import Mission, load
from deploy.mission_copy import save_copy

CONFIGS = Path(__file__).resolve().parents[2] / "mission_configs"
PROGRAM = [sys.executable, "-W", "ignore", "-c", "from deploy.cli import main; main()"]


def small(tasks: int = 3, **overrides: object) -> Mission:
    """The lab with few tasks; further overrides by dotted key, dots as two underscores."""
    more = {key.replace("__", "."): value for key, value in overrides.items()}
    few = {"tasks": {"random": {"count": tasks, "seed": 2}}, "planner.iterations": 100_000}
    return load(CONFIGS / "lab.yaml", {**few, **more})


def small_file(folder: Path, tasks: int = 3, **overrides: object) -> Path:
    """The same as a file."""
    return save_copy(small(tasks, **overrides), folder)


def simulated() -> set[int]:
    """Processes of wire simulations that this process has started, and their children."""
    found = set()
    for process in psutil.Process().children(recursive=True):
        try:
            if "sim_backends.wire" in " ".join(process.cmdline()):
                found.add(process.pid)
        except psutil.Error:
            continue
    return found


@contextmanager
def nothing_left() -> Iterator[None]:
    """Afterwards no process of a simulation is there any more."""
    yield
    end_s = time.monotonic() + 5.0
    while simulated():
        assert time.monotonic() < end_s, f"processes of the simulation are still there: {simulated()}"
        time.sleep(0.1)
