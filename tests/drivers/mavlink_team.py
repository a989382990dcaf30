"""Simulated MAVLink vehicles as processes and the drivers that fly them, for the tests over the wire."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from drivers.clock import RealClock
from drivers.geodesy import GeoFrame
from drivers.limits import Pads, PoseBook, UavLimits, UgvLimits
from drivers.mavlink import MavlinkUav, MavlinkUgv, TelemetryPoses
from drivers.mavlink_options import MavlinkOptions
from drivers.vehicle import Pose, PoseSource, Vehicle
from sim_backends.wire.world import World
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.drivers.contract import Harness

GEO = GeoFrame(48.0, 11.0, 0.3, (5.0, -3.0))
SAFE = {
    "px4": ("COM_OBL_RC_ACT=4", "NAV_DLL_ACT=3", "COM_FAIL_ACT_T=1"),
    "ardupilot": ("FS_GCS_ENABLE=5",),
}
"""Parameters as docs and checks ask for them, with short times."""
OPTIONS = MavlinkOptions()
TOLERANCE_M = 0.2
CONFIG = WorldConfig(
    uavs=(
        SimUav(
            "uav0", "uav0", (0.0, 0.0), max_speed_mps=3.0, accel_mps2=3.0, climb_mps=1.5, descent_mps=1.5,
            tracking_noise_m=0.01, dock_noise_m=0.005,
        ),
    ),
    ugvs=(
        SimUgv(
            "ugv0", "ugv0", (0.0, 1.5), yaw_rad=0.3, max_speed_mps=1.5, accel_mps2=1.5, pad_height_m=0.3,
            dock_offsets_m=((0.1, 0.0), (-0.3, 0.0)),
        ),
    ),
    step_s=0.02,
    dock_tolerance_m=0.1,
    collision_m=0.2,
)  # fmt: skip


class WorldPoses:
    """The shared world as a motion capture that never fails, 50 frames a second."""

    def __init__(self, world: World, clock: RealClock) -> None:
        self._world, self._clock, self._read_s = world, clock, -1.0
        self.hidden: set[str] = set()

    def connect(self, deadline_s: float) -> None:
        pass

    def read(self) -> Sequence[Pose]:
        now_s = self._clock.now()
        if now_s - self._read_s < 0.02:
            return ()
        self._read_s = now_s
        bodies = zip(self._world.config.vehicles, self._world.bodies(), strict=True)
        return tuple(Pose(c.body, b.position_m, b.yaw_rad, now_s) for c, b in bodies if c.body not in self.hidden)

    def close(self) -> None:
        pass


@dataclass
class Team:
    """Everything of one test."""

    world: World
    processes: dict[str, subprocess.Popen[str]]
    ports: dict[str, int]
    harness: Harness
    book: PoseBook = field(default_factory=PoseBook)

    def kill(self, vehicle: str) -> None:
        self.processes[vehicle].kill()
        self.processes[vehicle].wait(5.0)

    def uav(self) -> MavlinkUav:
        vehicle = self.harness.vehicles["uav0"]
        assert isinstance(vehicle, MavlinkUav)
        return vehicle

    def truth(self, vehicle: str) -> tuple[float, float, float]:
        return self.world.body(self.world.row(vehicle)).position_m


def failures(vehicle: Vehicle) -> list[str]:
    return [f.name for f in vehicle.self_checks() if f.verdict == "fail"]


def start(arguments: Sequence[str]) -> tuple[subprocess.Popen[str], int]:
    """Starts a vehicle and waits until it can be talked to; its UDP port."""
    command = [sys.executable, "-m", "sim_backends.wire.mavlink_vehicle", "--port", "0", "--parent", str(os.getpid())]
    process = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    line = process.stdout.readline().split()
    assert line[:1] == ["ready"], line
    return process, int(line[line.index("udp") + 1])


def stop(process: subprocess.Popen[str]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(5.0)
    if process.stdout is not None:
        process.stdout.close()


@contextmanager
def team(
    folder: Path,
    autopilot: str,
    *,
    outdoors: bool,
    vehicles: Sequence[str] = ("uav0", "ugv0"),
    config: WorldConfig = CONFIG,
    options: MavlinkOptions = OPTIONS,
    params: Sequence[str] = (),
    arguments: Sequence[str] = (),
    connect: bool = True,
) -> Iterator[Team]:
    """A world, its vehicles' processes, and the connected drivers."""
    world = World.create(folder, config)
    if outdoors:
        where = ["--position", "gps", f"--origin=48.0,11.0,{57.29577951308232 * 0.3},5.0,-3.0"]
    else:
        where = ["--position", "vision"]
    clock, book = RealClock(), PoseBook()
    processes: dict[str, subprocess.Popen[str]] = {}
    ports: dict[str, int] = {}
    drivers: dict[str, Vehicle] = {}
    try:
        for number, name in enumerate(vehicles, 1):
            rover = name.startswith("ugv")
            set_ = [f"--param={p}" for p in (*SAFE[autopilot], *params) if not (rover and "FS_GCS_ENABLE=5" in p)]
            place = ["--world", str(folder), "--vehicle", name, "--sysid", str(number), "--autopilot", autopilot]
            processes[name], ports[name] = start([*place, *where, *set_, *arguments])
            drivers[name] = driver(world, name, number, ports[name], clock, book, outdoors, options)
        poses: PoseSource
        if outdoors:
            poses = TelemetryPoses([v for v in drivers.values() if isinstance(v, MavlinkUav | MavlinkUgv)])
        else:
            poses = WorldPoses(world, clock)
        harness = Harness(
            drivers, poses, clock, {name: name for name in vehicles},
            altitude_m=1.5, leg_m=2.0, speed_mps=1.2, tolerance_m=TOLERANCE_M, pad_offset_m=(0.1, 0.0),
            pad_height_m=0.3, timeout_s=25.0,
        )  # fmt: skip
        made = Team(world, processes, ports, harness, book)
        if connect:
            harness.connect()
            # an estimator takes some poses before it has a position
            harness.wait_for(lambda: all(not failures(v) for v in drivers.values()))
        yield made
    finally:
        for vehicle in drivers.values():
            vehicle.close()
        for process in processes.values():
            stop(process)


def driver(
    world: World, name: str, sysid: int, port: int, clock: RealClock, book: PoseBook, outdoors: bool,
    options: MavlinkOptions,
) -> Vehicle:  # fmt: skip
    endpoint, frame = f"udpout:127.0.0.1:{port}", GEO if outdoors else None
    config = world.config.vehicles[world.row(name)]
    if isinstance(config, SimUav):
        pads = {
            g.id: Pads(g.body, g.dock_offsets_m, g.pad_height_m, world.config.dock_tolerance_m)
            for g in world.config.ugvs
        }
        limits = UavLimits(config.max_speed_mps, config.accel_mps2, config.climb_mps, config.descent_mps, 20.0)
        return MavlinkUav(
            name, endpoint, body=name, sysid=sysid, limits=limits, pads=pads, book=book, frame=frame, clock=clock,
            options=options,
        )  # fmt: skip
    return MavlinkUgv(
        name, endpoint, body=name, sysid=sysid, limits=UgvLimits(config.max_speed_mps, config.accel_mps2),
        book=book, frame=frame, clock=clock, options=replace(options),
    )  # fmt: skip
