"""What the wire tests of the Limo share: simulated Limos in their own processes, and the truth as motion capture."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from drivers.clock import Clock
from drivers.vehicle import Pose
from sim_backends.wire.world import World
from sim_backends.world import SimUgv, WorldConfig

# other people's tests, and robots, on this network are none of ours
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
DOMAIN = 10 + os.getpid() % 90


def lab(ugvs: int = 1, **changes: float) -> WorldConfig:
    """A lab with some Limos 2 m from each other."""
    limos = tuple(
        SimUgv(
            f"ugv{i}", f"limo{i}", (0.0, 2.0 * i), max_speed_mps=0.6, tracking_noise_m=0.005,
            pad_height_m=0.3, dock_offsets_m=((0.0, 0.0),), **changes,  # type: ignore[arg-type]
        )
        for i in range(ugvs)
    )  # fmt: skip
    return WorldConfig(uavs=(), ugvs=limos, scale=0.01, time_scale=0.25)


def namespace(name: str) -> str:
    """A namespace that no other test run uses."""
    return f"/{name}_{os.getpid()}"


@dataclass
class Process:
    """One simulated Limo."""

    popen: subprocess.Popen[str]
    first_line: str

    def end(self) -> float:
        """Asks it to end; returns how long that took, s."""
        start_s = time.monotonic()
        self.popen.send_signal(signal.SIGTERM)
        try:
            self.popen.wait(5.0)
        except subprocess.TimeoutExpired:
            self.popen.kill()
            self.popen.wait()
        return time.monotonic() - start_s


def start(*arguments: str, timeout_s: float = 60.0, parent: int | None = None, domain: int = DOMAIN) -> Process:
    """Starts a node and waits until it says that it is ready."""
    command = [sys.executable, "-m", "sim_backends.wire.limo_node", *arguments]
    command += ["--domain", str(domain), "--parent", str(parent or os.getpid())]
    root = Path(__file__).parents[2]
    popen = subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, text=True)
    assert popen.stdout is not None
    ready, _, _ = select.select([popen.stdout], [], [], timeout_s)
    assert ready, "the node says nothing"
    return Process(popen, popen.stdout.readline().strip())


def until(condition: Callable[[], bool], timeout_s: float = 20.0, what: str = "it did not happen in time") -> float:
    """Waits for a condition; returns how long that took, s."""
    start_s = time.monotonic()
    while not condition():
        assert time.monotonic() - start_s < timeout_s, what
        time.sleep(0.01)
    return time.monotonic() - start_s


@dataclass
class TruePoses:
    """Motion capture that sees the bodies as they are; a ``PoseSource``."""

    world: World
    clock: Clock
    hidden: set[str] = field(default_factory=set)
    seen_s: dict[int, float] = field(default_factory=dict)

    def connect(self, deadline_s: float) -> None:
        """There is nothing to connect."""

    def read(self) -> Sequence[Pose]:
        """Each body that has moved on since the last call."""
        poses = []
        for row, vehicle in enumerate(self.world.config.vehicles):
            body = self.world.body(row)
            if body.time_s != self.seen_s.get(row, 0.0) and vehicle.body not in self.hidden:
                self.seen_s[row] = body.time_s
                x, y, z = map(float, body.position_m)
                poses.append(Pose(vehicle.body, (x, y, z), body.yaw_rad, self.clock.now()))
        return poses

    def close(self) -> None:
        """Nor to close."""
