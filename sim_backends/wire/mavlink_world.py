"""The simulated MAVLink vehicles' bodies in the shared world: ground, decks, wind, batteries, faults."""

from __future__ import annotations

import math
import random
from dataclasses import replace

from drivers.vehicle import Vec3
from sim_backends.wire import world as states
from sim_backends.wire.mavlink_autopilot import Autopilot
from sim_backends.wire.mavlink_body import Copter, Rover, wrap
from sim_backends.wire.mavlink_estimate import Estimate
from sim_backends.wire.mavlink_guidance import NAN, Limits, Sense, Wish, velocity_for
from sim_backends.wire.physics import Ground, UavBattery, UgvBattery, ground_under
from sim_backends.wire.world import Body, Modifiers, World

SLOW_TURN_S = 0.1
"""Period of what need not be looked at in every step: far ground, a rover's battery."""
PUSHING_MPS = 0.1
"""Whoever wants down faster than this on the ground is landing."""
WANDER_S = 2.0
"""Time constant of a vehicle's wandering around its reference."""
NEAR_GROUND_M = 3.0
"""Below this height the ground is looked at in every step, and there is less wind to wander in."""


class CopterInWorld:
    """A copter's body, battery and deck."""

    def __init__(self, world: World, row: int) -> None:
        self._world, self._row = world, row
        config = world.config.uavs[row]
        body = world.body(row)
        self.copter = Copter(body.position_m, body.yaw_rad, config.accel_mps2)
        self.limits = Limits(config.max_speed_mps, config.climb_mps, config.descent_mps, config.accel_mps2)
        self._config = config
        self._battery = UavBattery(world, row)
        self._random = random.Random(f"body {world.config.seed} {row}")
        self._pads_m = max((g.pad_height_m for g in world.config.ugvs), default=0.0)
        self._ground = Ground()
        self._ride: tuple[int, float, float, float] | None = None
        self._deck_mps: Vec3 = (0.0, 0.0, 0.0)
        self._missed = False
        self._code = states.FINE
        self._slow_s = 0.0
        self._sway = [0.0, 0.0, 0.0, 0.0]
        self.pushing = False
        if body.on >= 0:
            self._board(Ground(body.position_m[2], body.on, body.dock, contact=True))

    @property
    def battery(self) -> float:
        """Share that is left."""
        return self._battery.level

    @property
    def charging(self) -> bool:
        """On its charger."""
        return self._battery.charging

    @property
    def position(self) -> Vec3:
        """Of the body, with its wandering."""
        x, y, z = self.copter.position
        return (x + self._sway[0], y + self._sway[1], z)

    @property
    def velocity(self) -> Vec3:
        """Of the body; on a deck the deck's."""
        return self._deck_mps if self._ride is not None and self.copter.landed else self.copter.velocity

    @property
    def yaw(self) -> float:
        """Of the body."""
        return self.copter.yaw

    @property
    def tilt(self) -> tuple[float, float]:
        """Roll and pitch, forward-right-down."""
        return (math.pi, 0.0) if self.copter.tumbled else (self.copter.tilt[0], -self.copter.tilt[1])

    @property
    def contact(self) -> bool:
        """It touches the ground."""
        return self.copter.landed

    @property
    def tumbled(self) -> bool:
        """It lies on its back."""
        return self.copter.tumbled

    def reset(self) -> None:
        """Somebody set it upright and switched it on again."""
        self.copter.tumbled, self._code = False, states.FINE

    def step(self, now_s: float, dt: float, wish: Wish, sense: Sense, estimate: Estimate, faults: Modifiers) -> None:
        """One step of physics.

        Args:
            now_s: monotonic.
            dt: s.
            wish: of the autopilot.
            sense: what that was based on.
            estimate: which knows how its frame lies in the arena.
            faults: of this body.
        """
        copter = self.copter
        slow = now_s - self._slow_s >= SLOW_TURN_S
        if slow:
            self._slow_s = now_s
        self._look_down(slow)
        powered = wish.motors and not faults.motor_fail and self._battery.energy_j > 0.0 and not copter.tumbled
        was_landed = copter.landed
        if self._ride is not None:
            self._carry()
        if powered and (wish.lift or not copter.landed):
            wanted = velocity_for(wish, sense, self.limits)
            self.pushing = wanted[2] > PUSHING_MPS
            self._fly(dt, wish, wanted, sense, estimate, faults)
        elif powered:
            self.pushing = True
        else:
            if not copter.landed and self._code == states.FINE:
                self._code = self._cause(wish, faults)
            copter.fall(dt, self._ground.height_m)
        self._swing(dt)
        if copter.landed and not was_landed:
            self._board(self._ground)
        elif not copter.landed:
            self._ride, self._missed = None, False
        ground = replace(self._ground, contact=self._ground.contact and not self._missed) if copter.landed else None
        speed = math.hypot(copter.velocity[0], copter.velocity[1])
        air = speed + faults.wind_mps if speed > 0.01 * self.limits.level_mps else speed
        self._battery.step(
            dt, powered and not copter.landed, min(air, max(speed, self.limits.level_mps)), ground, faults
        )

    def _cause(self, wish: Wish, faults: Modifiers) -> int:
        if faults.motor_fail:
            return states.MOTOR_FAILURE
        return states.BATTERY_EMPTY if self._battery.energy_j <= 0.0 and wish.motors else states.STOPPED

    def _fly(self, dt: float, wish: Wish, wanted: Vec3, sense: Sense, estimate: Estimate, faults: Modifiers) -> None:
        x, y, z = estimate.arena_velocity(wanted)
        speed = math.hypot(x, y)
        if faults.wind_mps > 0.0 and speed > 0.0:
            # as the kinematic backend has it: wind takes its share of the ground speed in any direction
            cap = max(self.limits.level_mps - faults.wind_mps, 0.1 * self.limits.level_mps)
            x, y = (x * cap / speed, y * cap / speed) if speed > cap else (x, y)
        rate = -wish.yaw_rate if math.isfinite(wish.yaw_rate) else 0.0
        if math.isfinite(wish.yaw):
            rate = -2.0 * wrap(wish.yaw - sense.yaw)
        self.copter.fly(dt, (x, y, z), rate, self._ground.height_m)

    def _look_down(self, slow: bool) -> None:
        if self.copter.landed and self._ride is not None:
            return
        height = self.copter.position[2]
        if height > self._pads_m + NEAR_GROUND_M:
            self._ground = Ground()
        elif slow or height < self._pads_m + 0.5:
            self._ground = ground_under(self._world, self._row, self.position)

    def _board(self, ground: Ground) -> None:
        self._ground, self._ride = ground, None
        if ground.ugv < 0:
            return
        if self._world.modifiers(self._row).dock_miss > 0:
            self._missed = True
            self._world.dock_missed(self._row)
        ugv = self._world.body(ground.ugv)
        dx, dy = self.copter.position[0] - ugv.position_m[0], self.copter.position[1] - ugv.position_m[1]
        c, s = math.cos(ugv.yaw_rad), math.sin(ugv.yaw_rad)
        self._ride = (ground.ugv, c * dx + s * dy, -s * dx + c * dy, self.copter.yaw - ugv.yaw_rad)

    def _carry(self) -> None:
        if self._ride is None or not self.copter.landed:
            return
        row, x, y, yaw = self._ride
        ugv = self._world.body(row)
        self._deck_mps = ugv.velocity_mps
        c, s = math.cos(ugv.yaw_rad), math.sin(ugv.yaw_rad)
        self.copter.position = (
            ugv.position_m[0] + c * x - s * y,
            ugv.position_m[1] + s * x + c * y,
            self._ground.height_m,
        )
        self.copter.yaw = wrap(ugv.yaw_rad + yaw)

    def _swing(self, dt: float) -> None:
        """Two first-order lags in a row over noise, so that the wandering has a velocity that is not jerky."""
        if self.copter.landed:
            x, y, z = self.copter.position
            self.copter.position = (x + self._sway[0], y + self._sway[1], z)
            self._sway = [0.0] * 4
            return
        low = self.copter.position[2] < self._pads_m + NEAR_GROUND_M
        size = self._config.dock_noise_m if low else self._config.tracking_noise_m
        share, kick = dt / WANDER_S, size * math.sqrt(4.0 * dt / WANDER_S)
        for i in (0, 1):
            self._sway[i + 2] += -share * self._sway[i + 2] + self._random.gauss(0.0, kick)
            self._sway[i] += share * (self._sway[i + 2] - self._sway[i])

    def put(self, autopilot: Autopilot) -> None:
        """Writes the row."""
        copter, battery = self.copter, self._battery
        on = self._ride[0] if self._ride is not None and copter.landed else -1
        self._world.put(
            self._row,
            Body(
                position_m=self.position, velocity_mps=self.velocity, quaternion=copter.quaternion, on=on,
                dock=self._ground.dock if on >= 0 else 0, armed=autopilot.armed, airborne=not copter.landed,
                tumbled=copter.tumbled, locked=autopilot.terminated, charging=battery.charging, code=self._code,
                energy_j=battery.energy_j, used_j=battery.used_j, drawn_j=battery.drawn_j,
            ),
        )  # fmt: skip


class RoverInWorld:
    """A rover's body and battery."""

    def __init__(self, world: World, row: int, turn_radius_m: float = 0.0) -> None:
        self._world, self._row = world, row
        config = world.ugv(row)
        body = world.body(row)
        self.rover = Rover(
            (body.position_m[0], body.position_m[1]), body.yaw_rad, config.accel_mps2, turn_radius=turn_radius_m
        )
        self.limits = Limits(config.max_speed_mps, 0.0, 0.0, config.accel_mps2)
        self._battery = UgvBattery(world, row)
        self._code = states.FINE
        self._slow_s = 0.0
        self._waited_s = 0.0
        self.pushing = False
        self.contact, self.charging, self.tumbled = True, False, False
        self.tilt = (0.0, 0.0)

    @property
    def battery(self) -> float:
        """Share that is left."""
        return self._battery.level

    @property
    def position(self) -> Vec3:
        """Of the body."""
        return (*self.rover.position, 0.0)

    @property
    def velocity(self) -> Vec3:
        """Of the body."""
        return self.rover.velocity

    @property
    def yaw(self) -> float:
        """Of the body."""
        return self.rover.yaw

    def reset(self) -> None:
        """Somebody switched it on again."""
        self._code = states.FINE

    def step(self, now_s: float, dt: float, wish: Wish, sense: Sense, estimate: Estimate, faults: Modifiers) -> None:
        """One step of physics; as for copters."""
        self._waited_s += dt
        if now_s - self._slow_s >= SLOW_TURN_S:
            self._battery.step(self._waited_s, self.rover.speed, faults)
            self._slow_s, self._waited_s = now_s, 0.0
        if faults.motor_fail or self._battery.energy_j <= 0.0:
            self._code = states.MOTOR_FAILURE if faults.motor_fail else states.BATTERY_EMPTY
            self.rover.halt(dt)
            return
        if not wish.motors:
            self.rover.halt(dt, 3.0)  # a locked drive brakes as hard as the ground allows
            return
        x, y, _ = estimate.arena_velocity(velocity_for(wish, sense, self.limits))
        cap = self.limits.level_mps * faults.slow
        speed = math.hypot(x, y)
        if speed > cap:
            x, y = x * cap / speed, y * cap / speed
        turn = -wish.yaw_rate if math.isfinite(wish.yaw_rate) else NAN
        if math.isfinite(wish.yaw) and math.isnan(turn):
            turn = -2.0 * wrap(wish.yaw - sense.yaw)
        if speed < 0.01 and math.isnan(turn):
            self.rover.halt(dt)
        else:
            self.rover.drive(dt, (x, y), turn)

    def put(self, autopilot: Autopilot) -> None:
        """Writes the row."""
        rover, battery = self.rover, self._battery
        self._world.put(
            self._row,
            Body(
                position_m=self.position, velocity_mps=rover.velocity, quaternion=states.yaw_quaternion(rover.yaw),
                armed=autopilot.armed, locked=autopilot.terminated, code=self._code,
                energy_j=battery.energy_j, used_j=battery.used_j, given_j=battery.given_j,
            ),
        )  # fmt: skip
