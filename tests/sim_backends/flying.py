"""A small world and a way of flying it, for the tests of the kinematic backend."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from drivers.vehicle import Arm, Command, Pose, VehicleState
from sim_backends.faults import Fault
from sim_backends.kinematic import KinematicBackend, build
from sim_backends.truth import VehicleTruth
from sim_backends.world import SimUav, SimUgv, WorldConfig

WORLD = WorldConfig(
    uavs=(SimUav("uav0", "cf0", (0.0, 0.0)), SimUav("uav1", "cf1", (0.0, 100.0))),
    ugvs=(
        SimUgv("ugv0", "limo0", (50.0, 0.0), dock_offsets_m=((0.0, 0.0), (3.0, 0.0))),
        SimUgv("ugv1", "limo1", (50.0, 60.0)),
    ),
    separation_h_m=3.0,
    separation_v_m=4.0,
    separation_ugv_m=2.0,
    fence_m=((-500.0, -500.0), (1500.0, -500.0), (1500.0, 1500.0), (-500.0, 1500.0)),
    ceiling_m=60.0,
)


class Team:
    """A connected, armed team; ``step_s`` is how often its loop looks at the most."""

    def __init__(self, *faults: Fault, look_s: float = 0.5, **changes: Any) -> None:
        self.config = replace(WORLD, **changes)
        self.backend: KinematicBackend = build(self.config, faults)
        self.look_s = look_s
        self.bodies = {v.body: v.id for v in self.config.vehicles}
        self.poses: dict[str, Pose] = {}
        self.feeding = True
        self.backend.poses.connect(1.0)
        for vehicle in self.backend.vehicles.values():
            vehicle.connect(1.0)
        self.send(*(Arm(v) for v in self.backend.vehicles))
        self.until(1.0)

    @property
    def now_s(self) -> float:
        return self.backend.clock.now()

    def send(self, *commands: Command) -> None:
        for command in commands:
            self.backend.vehicles[command.vehicle].send(command)

    def look(self, until_s: float) -> None:
        self.backend.clock.wait_until(min(until_s, self.now_s + self.look_s))
        for pose in self.backend.poses.read():
            vehicle = self.bodies[pose.body]
            self.poses[vehicle] = pose
            if self.feeding:
                self.backend.vehicles[vehicle].feed_pose(pose)

    def until(self, time_s: float) -> None:
        while self.now_s < time_s - 1e-6:
            self.look(time_s)

    def wait(self, duration_s: float) -> None:
        self.until(self.now_s + duration_s)

    def state(self, vehicle: str) -> VehicleState:
        return self.backend.vehicles[vehicle].state()

    def truth(self, vehicle: str) -> VehicleTruth:
        return self.backend.truth().vehicles[vehicle]

    def kinds(self) -> list[str]:
        return [v.kind for v in self.backend.truth().violations]
