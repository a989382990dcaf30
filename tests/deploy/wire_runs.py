"""Small lab missions on wire simulations, for tests."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
import yaml

from deploy.mission import Mission, load
from deploy.mission_copy import save_copy
from deploy.session import RunResult

CONFIGS = Path(__file__).resolve().parents[2] / "mission_configs"
PROGRAM = [sys.executable, "-W", "ignore", "-c", "from deploy.cli import main; main()"]


def small(tasks: int = 3, **overrides: object) -> Mission:
    """The lab with few tasks; further overrides by dotted key, dots as two underscores."""
    more = {key.replace("__", "."): value for key, value in overrides.items()}
    few = {"tasks": {"random": {"count": tasks, "seed": 2}}, "planner.iterations": 100_000}
    return load(CONFIGS / "lab.yaml", {**few, **more})


def fleet(name: str, **types: dict[str, float]) -> dict[str, Any]:
    """The fleet file ``name`` with some keys of its types changed."""
    found: dict[str, Any] = yaml.safe_load((CONFIGS / "fleets" / name).read_text())
    for kind, changes in types.items():
        found["types"][kind].update(changes)
    return found


def recharging_field() -> Mission:
    """Eight tasks around the field's depot, quick rovers, batteries half empty: each UAV has to recharge. 150 s."""
    quick = {"speed_mps": 3.0, "max_speed_mps": 3.5, "charge_w": 2000.0}
    half = {"capacity_j": 30_000.0, "energy_j": 16_000.0, "reserve_fraction": 0.2, "service_s": 1.0}
    tasks = [[-240, 160], [-180, 100], [-380, 150], [-390, 40], [-250, 20], [-180, 20], [-300, 170], [-440, 110]]
    return load(
        CONFIGS / "field.yaml",
        {
            "fleet": fleet("field.yaml", quad={**half, "climb_mps": 3.0, "descent_mps": 2.5}, rover=quick),
            "tasks": {"points": tasks},
            "path_points": {"points": [[-258, 74], [-329, 140], [-365, 86]]},
            "arena.layers": {"lowest_m": 10.0, "spacing_m": 9.0},
            "planner.iterations": 100_000,
        },
    )


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
    end_s = time.monotonic() + 15.0
    while simulated():
        assert time.monotonic() < end_s, f"processes of the simulation are still there: {simulated()}"
        time.sleep(0.1)


@dataclass
class Waited:
    """What part of the time a thread was kept waiting for a core."""

    share: float = 0.0


@contextmanager
def waiting() -> Iterator[Waited]:
    """Measures how busy the machine was for this thread: how long others there, or the machine's host, had its core."""

    def waited_s() -> float:
        stolen_s = getattr(psutil.cpu_times(), "steal", 0.0) / (psutil.cpu_count() or 1)
        try:
            # on a core, ready for one, and how often: ns
            fields = Path(f"/proc/self/task/{threading.get_native_id()}/schedstat").read_text().split()
        except OSError:
            return float(stolen_s)
        return float(stolen_s) + 1e-9 * int(fields[1])

    found, begun_s, before_s = Waited(), time.monotonic(), waited_s()
    yield found
    found.share = (waited_s() - before_s) / (time.monotonic() - begun_s)


def is_flown_safely(result: RunResult, mission: Mission, recharges: int, waited: Waited) -> None:
    """Every task visited, everybody recharged and down, nobody harmed, hardly a turn late by its own fault."""
    assert result.kind == "done", result.kind
    assert result.outcome is not None
    assert all(result.outcome.state.visited)
    truth, report = result.truth, result.report
    assert truth is not None
    assert truth.violations == (), truth.violations  # no test module: pytest adds nothing to what it says
    assert truth.min_uav_distance_m > mission.settings.separation.horizontal_m
    assert not any(v.airborne or v.tumbled or v.locked for v in truth.vehicles.values())
    assert report is not None
    assert report.safety_violations == (), report.safety_violations
    assert report.recharges >= recharges
    loop = report.loop
    late = (
        f"{loop.late_turns} of {loop.turns} turns were late; others had the core {100 * waited.share:.0f} % of the time"
    )
    assert loop.late_share < 0.01 + 0.5 * waited.share, late
