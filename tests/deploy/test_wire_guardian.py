"""A ground station that is killed or hangs in flight: the guardian lands the UAVs and stops the UGVs, soon."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from wire_runs import PROGRAM, nothing_left, recharging_field, small

from deploy.backends import world_of
from deploy.cli_simulate import save_pointed
from deploy.mission import Mission
from deploy.wire import launch_mission
from drivers.guardian import SILENCE_S
from sim_backends.wire.world import Body, World

pytestmark = pytest.mark.wire
ROOT = Path(__file__).resolve().parents[2]
MOVES_MPS = 0.02


@dataclass
class Flight:
    """A ground station over a simulated fleet that does not depend on it."""

    program: subprocess.Popen[bytes]
    world: World
    said: Path

    def uavs(self) -> list[Body]:
        return self.world.bodies()[: self.world.n_uav]

    def ugvs(self) -> list[Body]:
        return self.world.bodies()[self.world.n_uav :]

    def until(self, condition: Callable[[], bool], timeout_s: float, what: str) -> float:
        """Waits; returns how long, s."""
        begun_s = time.monotonic()
        while not condition():
            assert time.monotonic() - begun_s < timeout_s, f"{what}: {self.world.bodies()}\n{self.said.read_text()}"
            time.sleep(0.01)
        return time.monotonic() - begun_s

    def relatives(self) -> dict[str, list[psutil.Process]]:
        """The program's children, the guardian apart."""
        found: dict[str, list[psutil.Process]] = {"guardian": [], "other": []}
        for process in psutil.Process(self.program.pid).children(recursive=True):
            with contextlib.suppress(psutil.Error):
                found["guardian" if "drivers.guardian" in process.cmdline() else "other"].append(process)
        return found


@contextmanager
def flight(mission: Mission, folder: Path) -> Iterator[Flight]:
    """Starts a simulation in this process and the ground station in another, with the simulation's addresses."""
    simulation = launch_mission(mission, world_of(mission, mission.seed), ())
    said = folder / "said.txt"
    try:
        file = save_pointed(mission, simulation, folder / "pointed")
        command = [*PROGRAM, "run", str(file), "--backend", "real", "--out", str(folder / "run")]
        with said.open("wb") as out:
            program = subprocess.Popen(command, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, start_new_session=True)
        try:
            yield Flight(program, simulation.world, said)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(program.pid, signal.SIGKILL)
            program.wait()
    finally:
        simulation.close()


def all_fly(f: Flight, above_m: float) -> bool:
    return all(b.airborne and b.position_m[2] > above_m for b in f.uavs())


def drives(f: Flight) -> bool:
    return any(abs(b.velocity_mps[0]) + abs(b.velocity_mps[1]) > 5 * MOVES_MPS for b in f.ugvs())


def stand(f: Flight) -> bool:
    return all(abs(b.velocity_mps[0]) + abs(b.velocity_mps[1]) < MOVES_MPS for b in f.ugvs())


def end(
    f: Flight, number: signal.Signals, down_s: float, stop_s: float, drift_m: float, silence_s: float = 0.0
) -> None:
    """Ends the ground station and watches what follows; the times count from the signal."""
    relatives = f.relatives()
    assert len(relatives["guardian"]) == 1
    others = relatives["other"]
    assert others, "motion capture or the planner is a child"
    at = [b.position_m[:2] for b in f.uavs()]
    begun_s = time.monotonic()
    os.kill(f.program.pid, number)
    f.until(lambda: f.program.poll() == -signal.SIGKILL, silence_s + 3.0, "the program is still there")
    dead_s = time.monotonic() - begun_s
    f.until(lambda: not any(map(running, others)), 10.0, "children of the dead program are still there")
    f.until(lambda: stand(f), stop_s, "UGVs still drive")
    stopped_s = time.monotonic() - begun_s
    f.until(lambda: not any(b.airborne for b in f.uavs()), down_s, "UAVs still fly")
    landed_s = time.monotonic() - begun_s
    drifts_m = [math.dist(a, b.position_m[:2]) for a, b in zip(at, f.uavs(), strict=True)]
    print(f"\n{number.name}: dead after {dead_s:.1f} s, UGVs stand after {stopped_s:.1f} s, UAVs down after "
          f"{landed_s:.1f} s, {max(drifts_m):.1f} m away at the most")  # fmt: skip
    assert not any(b.tumbled or b.locked for b in f.uavs()), f.uavs()
    f.until(lambda: not any(map(running, relatives["guardian"])), 30.0, "the guardian is still there")
    text = f.said.read_text()
    said = text[text.index("guardian:") :]
    print(said)
    for name in f.world.ids[: f.world.n_uav]:
        assert f"guardian: the ground station is gone; {name}: landed" in said, said
    assert "failed" not in said, said
    assert max(drifts_m) < drift_m


def running(process: psutil.Process) -> bool:
    with contextlib.suppress(psutil.Error):
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    return False


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hangs"])
def test_a_lab_comes_down_without_its_ground_station(number: signal.Signals, tmp_path: Path) -> None:
    with nothing_left(), flight(small(6), tmp_path) as f:
        killed = number is signal.SIGKILL  # a loop that hangs feeds no poses, so that Limos brake by themselves
        f.until(lambda: all_fly(f, 0.4) and (drives(f) or not killed), 60.0, "they never flew and drove")
        silence_s = 0.0 if killed else SILENCE_S + 0.5
        end(f, number, down_s=15.0, stop_s=3.0, drift_m=0.6, silence_s=silence_s)


def test_a_field_comes_down_without_its_ground_station(tmp_path: Path) -> None:
    with nothing_left(), flight(recharging_field(), tmp_path) as f:
        f.until(lambda: all_fly(f, 5.0), 90.0, "they never flew")
        end(f, signal.SIGKILL, down_s=60.0, stop_s=6.0, drift_m=15.0)
