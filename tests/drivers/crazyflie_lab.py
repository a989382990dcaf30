"""A small lab over the wire: one simulated Crazyflie in its own process, one UGV that is a row of the world."""

from __future__ import annotations

import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from drivers.clock import RealClock
from drivers.crazyflie import Crazyflie
from drivers.crazyflie_options import CrazyflieOptions
from drivers.limits import Pads, PoseBook, UavLimits
from drivers.vehicle import Pose
from sim_backends.wire.world import World
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.drivers.contract import Harness

LIMITS = UavLimits(max_speed_mps=1.5, accel_mps2=2.0, climb_mps=1.0, descent_mps=0.7, altitude_m=2.5)
PAD_M = 0.3
TOLERANCE_M = 0.05
CONFIG = WorldConfig(
    uavs=(
        SimUav(
            "uav0", "cf0", (0.0, 0.0), max_speed_mps=1.5, accel_mps2=2.0, climb_mps=1.0, descent_mps=0.7,
            tracking_noise_m=0.01, dock_noise_m=0.005, drift_mps=0.02,
        ),
    ),
    ugvs=(SimUgv("ugv0", "limo0", (0.0, 1.5), yaw_rad=0.3, max_speed_mps=0.5, pad_height_m=PAD_M,
                 dock_offsets_m=((0.0, 0.0),)),),
    scale=0.01, time_scale=0.1, step_s=0.02, pose_noise_m=0.001, dock_tolerance_m=TOLERANCE_M, dock_range_m=0.5,
    collision_m=0.1,
)  # fmt: skip
OPTIONS = CrazyflieOptions(converge_s=1.0, fast_ms=50, slow_ms=100)


class TruePoses:
    """Poses of every body straight from the world at 100 Hz, as a perfect motion capture would see them."""

    def __init__(self, world: World, clock: RealClock) -> None:
        self._world, self._clock, self._last_s = world, clock, -1.0
        self.open = True
        self.hidden: set[str] = set()

    def connect(self, deadline_s: float) -> None:
        self.open = True

    def read(self) -> Sequence[Pose]:
        now_s = self._clock.now()
        if not self.open or now_s - self._last_s < 0.01:
            return ()
        self._last_s = now_s
        vehicles = self._world.config.vehicles
        return [
            Pose(v.body, (b.position_m[0], b.position_m[1], b.position_m[2]), b.yaw_rad, now_s)
            for v, b in zip(vehicles, self._world.bodies(), strict=True)
            if v.body not in self.hidden
        ]

    def close(self) -> None:
        self.open = False


class LoopClock(RealClock):
    """Turns of 20 ms, as the real loop has them."""

    def wait_until(self, time_s: float) -> float:
        return super().wait_until(min(time_s, self.now() + 0.02))


class Lab:
    """The server's process, the world and one driver."""

    def __init__(
        self, folder: Path, *arguments: str, options: CrazyflieOptions = OPTIONS, config: WorldConfig = CONFIG
    ) -> None:
        self.folder, self.arguments, self.options = folder, arguments, options
        self.world = World.create(folder / "world", config)
        self.clock = LoopClock()
        self.process: subprocess.Popen[str] | None = None
        self.port = 0
        self.start()
        self.book = PoseBook()
        self.poses = TruePoses(self.world, self.clock)
        self.uav = self.driver()

    def start(self) -> None:
        command = [sys.executable, "-m", "sim_backends.wire.crazyflie_server", "--world", str(self.world.folder)]
        command += ["--vehicle", "uav0", "--port", str(self.port), *self.arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        ready = self.process.stdout.readline()
        assert ready.startswith("ready"), ready
        self.port = int(ready.rsplit(":", 1)[1])

    def driver(self) -> Crazyflie:
        pads = {"ugv0": Pads("limo0", ((0.0, 0.0),), PAD_M, TOLERANCE_M)}
        return Crazyflie(
            "uav0", f"udp://127.0.0.1:{self.port}", body="cf0", limits=LIMITS, pads=pads, book=self.book,
            clock=self.clock, options=replace(self.options, cache=self.folder / "cache"),
        )  # fmt: skip

    def harness(self, **sizes: float) -> Harness:
        given = {"altitude_m": 0.7, "leg_m": 1.5, "speed_mps": 0.6, "tolerance_m": 0.1, "pad_height_m": PAD_M}
        made = Harness({"uav0": self.uav}, self.poses, self.clock, {"uav0": "cf0"}, **{**given, **sizes})  # type: ignore[arg-type]
        made.bodies = {"uav0": "cf0", "ugv0": "limo0"}
        made.vehicles["ugv0"] = _Parked(self.book)  # type: ignore[assignment]
        return made

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait()

    def close(self) -> None:
        begun = time.monotonic()
        self.uav.close()
        self.closing_s = time.monotonic() - begun
        self.kill()


MakeLab = Callable[..., Lab]


@contextmanager
def labs_in(folder: Path) -> Iterator[MakeLab]:
    """Makes labs, each in a folder of its own, and closes them all."""
    labs: list[Lab] = []

    def make(*arguments: str) -> Lab:
        labs.append(Lab(folder / str(len(labs)), *arguments))
        return labs[-1]

    yield make
    for lab in labs:
        lab.close()


class _Parked:
    """The UGV's pose is known to the loop; nobody drives it."""

    id, kind = "ugv0", "ugv"

    def __init__(self, book: PoseBook) -> None:
        self._book = book

    def connect(self, deadline_s: float) -> None: ...

    def feed_pose(self, pose: Pose) -> None:
        self._book.put(pose)


def ready(lab: Lab) -> Harness:
    harness = lab.harness()
    harness.connect()
    harness.wait_for(lambda: verdicts(lab)["estimator"] in ("pass", "warn"), 30.0)
    return harness


def verdicts(lab: Lab) -> dict[str, str]:
    return {c.name: c.verdict for c in lab.uav.self_checks()}


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def alone(uri: str, folder: Path) -> tuple[Crazyflie, LoopClock]:
    clock = LoopClock()
    options = replace(OPTIONS, cache=folder)
    made = Crazyflie("uav0", uri, body="cf0", limits=LIMITS, pads={}, book=PoseBook(), clock=clock, options=options)
    return made, clock
