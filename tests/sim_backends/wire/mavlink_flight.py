"""An autopilot and its body on a virtual clock: the whole behaviour but the wire, without waiting."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal

from sim_backends.wire.mavlink_ardupilot import ArduPilot
from sim_backends.wire.mavlink_autopilot import Autopilot, Order, VehicleType
from sim_backends.wire.mavlink_body import Copter, Rover
from sim_backends.wire.mavlink_guidance import Limits, Sense, Wish, velocity_for
from sim_backends.wire.mavlink_options import VehicleOptions, build_params
from sim_backends.wire.mavlink_px4 import Px4
from sim_backends.wire.mavlink_setpoints import Globe, Target

LIMITS = Limits(10.0, 3.0, 2.0, 3.0)
DT = 0.02
POSITION_ONLY, VELOCITY_ONLY = 0b110111111000, 0b110111000111


class Flight:
    """Steps of 20 ms; north, east, down are y, x, -z of the body."""

    def __init__(self, autopilot: Literal["px4", "ardupilot"], kind: VehicleType = "copter", **params: float) -> None:
        options = VehicleOptions(autopilot=autopilot, port=0, params=tuple(params.items()))
        build = Px4 if autopilot == "px4" else ArduPilot
        globe = Globe(lambda lat, lon: (1e5 * lat, 1e5 * lon), 488.0, 488.0)
        self.pilot: Autopilot = build(kind, build_params(options, kind, LIMITS), LIMITS, globe)
        self.copter = Copter((0.0, 0.0, 0.0), 0.5 * math.pi, LIMITS.accel_mps2)
        self.rover = Rover((0.0, 0.0), 0.5 * math.pi, LIMITS.accel_mps2)
        self.now_s = 100.0
        self.position_ok = self.global_ok = True
        self.battery = 1.0
        self.pushing = False
        self.streaming: Callable[[], Target] | None = None
        self.gcs: int | None = None
        self.texts: list[str] = []
        self.wish = Wish()
        self.flies = kind == "copter"

    @property
    def sense(self) -> Sense:
        x, y, z = self.copter.position if self.flies else (*self.rover.position, 0.0)
        vx, vy, vz = self.copter.velocity if self.flies else self.rover.velocity
        yaw = self.copter.yaw if self.flies else self.rover.yaw
        return Sense(
            self.now_s, (y, x, -z), (vy, vx, -vz), 0.5 * math.pi - yaw, self.copter.landed if self.flies else True,
            self.pushing, self.position_ok, self.global_ok, self.battery, self.copter.tumbled,
        )  # fmt: skip

    @property
    def ned(self) -> tuple[float, float, float]:
        return self.sense.ned

    @property
    def speed(self) -> float:
        return math.hypot(*self.sense.velocity)

    def order(self, command: int, *p: float, **more: int | bool) -> int:
        full = (*p, *([0.0] * (7 - len(p))))
        return self.pilot.order(Order(command, full, **more), self.sense)  # type: ignore[arg-type]

    def step(self) -> None:
        if self.streaming is not None:
            self.pilot.set_point(self.streaming(), self.sense)
        if self.gcs is not None:
            self.pilot.heard_gcs(self.gcs, self.now_s)
        sense = self.sense
        self.wish = wish = self.pilot.step(sense)
        n, e, d = velocity_for(wish, sense, LIMITS) if wish.motors else (0.0, 0.0, 0.0)
        if not self.flies:
            if wish.motors and math.hypot(n, e) > 0.01:
                self.rover.drive(DT, (e, n))
            else:
                self.rover.halt(DT)
        elif wish.motors and (wish.lift or not self.copter.landed):
            self.pushing = d > 0.1
            self.copter.fly(DT, (e, n, -d), 0.0, 0.0)
        elif wish.motors:
            self.pushing = True
        else:
            self.copter.fall(DT, 0.0)
        self.texts += [text for _, text in self.pilot.said]
        self.pilot.said.clear()
        self.now_s += DT

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / DT)):
            self.step()

    def until(self, condition: Callable[[], bool], seconds: float = 60.0) -> float:
        """Steps until it holds; the time that took."""
        start_s = self.now_s
        while not condition():
            assert self.now_s - start_s < seconds, f"it did not happen: {self.texts[-5:]}"
            self.step()
        return self.now_s - start_s


def velocity(n: float, e: float, d: float) -> Target:
    return Target(False, 1, VELOCITY_ONLY, (0.0, 0.0, 0.0), (n, e, d))


def position(n: float, e: float, d: float) -> Target:
    return Target(False, 1, POSITION_ONLY, (n, e, d), (0.0, 0.0, 0.0))
