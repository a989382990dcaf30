"""What a UAV is doing and what it wants of its autopilot next. No I/O, no clock: ``command`` and ``step`` decide.

The driver streams the set-points and makes the autopilot's mode and arming what ``Wants`` says, by the command
protocol. Nothing here counts as done before the telemetry shows it.
"""

from __future__ import annotations

import math
from dataclasses import replace
from enum import Enum

from drivers.limits import UavLimits
from drivers.mavlink_dock import Attempt, Outcome, dock_step
from drivers.mavlink_motion import REST, Reference, along, brake, moved, patience, steer
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_wants import Seen, Wants
from drivers.vehicle import Arm, Command, Disarm, Dock, GoTo, Hold, Land, TakeOff, Vec3

STREAM_FIRST_S = 0.6
"""PX4 enters offboard mode after half a second of set-points."""
PRESS_M = 0.8
"""How far below the vehicle the reference sinks while it lands: the floor may be anywhere, contact ends it."""
KICK_M = 0.2
"""Set-point above the ground that makes PX4 take off, while the reference waits."""
REST_BELOW_M = 0.3
"""Set-point below the ground on which it stands armed: PX4 takes off for anything above (``mc_pos_control``)."""
LEFT_M = 0.1
"""Higher than where it stood: it flies, whatever the land detector still says."""
HOLD_LIFT_M = 0.5
"""Where a take-off is held that has not left the ground yet: stopping the motors there would be worse."""
LANDED_S = 0.5
BLIND_S = 0.5
"""Without any position for so long, only its own landing mode knows the way down."""
STRANDED_S = 2.0
STALLED_S = 2.0
"""Not higher since then: its own take-off is done."""
FULL = 0.98
LEFT_ALONE = "its own failsafe lands it or brings it back: moved no more until it is on the ground"


class Phase(Enum):
    """Of a UAV. ``LIFT``: leaving the ground. ``CONFIRM``: on the pad, waiting for the charger."""

    IDLE = "idle"
    LIFT = "lift"
    FLY = "fly"
    BRAKE = "brake"
    LAND = "land"
    DOCK = "dock"
    ABORT = "abort"
    CONFIRM = "confirm"


AIR = (Phase.FLY, Phase.BRAKE, Phase.LAND, Phase.DOCK, Phase.ABORT)


class Flight:
    """The state machine of one UAV.

    Args:
        limits: never exceeded.
        options: times.
        streams_on_ground, lifts_by_command: of the dialect.
    """

    def __init__(
        self, limits: UavLimits, options: MavlinkOptions, *, streams_on_ground: bool, lifts_by_command: bool
    ) -> None:
        self._limits, self._options = limits, options
        self._streams_on_ground, self._lifts_by_command = streams_on_ground, lifts_by_command
        self.phase = Phase.IDLE
        self.fault: str | None = None
        self.attempt: Attempt | None = None
        self.on_pad = False
        self._reference: Reference | None = None
        self._target: tuple[Vec3, float] | None = None
        self._speed_mps = 0.0
        self._yaw_rad: float | None = None
        self._arming_s: float | None = None
        self._disarming = False
        self._stream_s: float | None = None
        self._since_s = 0.0
        self._ground_z = 0.0
        self._count_s = self._count_m = self._blind_s = 0.0
        self._guided_seen = False
        self._land_mode = False
        self._relift_m: float | None = None
        self._failsafe = self._failsafe_seen = self._landing_seen = False

    def reset(self) -> None:
        """Forgets everything it was doing; after an emergency stop or a reboot."""
        self._enter(Phase.IDLE, self._since_s)
        self.attempt = self._arming_s = self._relift_m = self._reference = self._target = None
        self._disarming = self.on_pad = False

    @property
    def arming(self) -> bool:
        """Being made ready to fly."""
        return self._arming_s is not None

    def refused(self, what: str, why: str) -> None:
        """The autopilot has refused something for good."""
        self.fault = f"{what} refused: {why}"
        if what in ("arming", "mode") and self._arming_s is not None:
            self._arming_s = self._relift_m = None

    # ------------------------------------------------------------------------------------------------ commands

    def command(self, command: Command, seen: Seen) -> None:
        """Lets a command, within limits already, take effect; what makes no sense now changes nothing."""
        self._keep_up(seen)
        match command:
            case Arm():
                if not seen.armed and self._arming_s is None:
                    self._arming_s, self._disarming, self.fault = seen.now_s, False, None
                elif seen.armed and not self._up(seen) and not seen.guided:
                    self._arming_s = seen.now_s
            case Disarm():
                if not self._up(seen):
                    self._settle(seen.now_s)
                    self._disarming = seen.armed
            case TakeOff():
                self._take_off(command, seen)
            case GoTo() if self._claim(seen):
                target = (command.position_m, command.speed_mps)
                if self.phase is not Phase.FLY or self._target != target:
                    self._fly(target, seen.now_s)
                    self.fault = None
            case Land() if (self._failsafe or self._land_mode) and self._up(seen):
                self._land_by_itself(seen.now_s)
            case Hold() if self._failsafe and self._up(seen):
                pass  # sent by itself, too, whenever something is wrong: it must not end a failsafe's landing
            case Land() if self._up(seen) and seen.at_m is None and not seen.by_pilot:
                # nobody knows where it is: it must find the ground by itself
                self._land_by_itself(seen.now_s)
            case Land() if self._claim(seen):
                if self.phase is not Phase.LAND:
                    self._enter(Phase.LAND, seen.now_s)
                self._speed_mps = command.speed_mps
            case Dock() if self._claim(seen):
                self._dock(command, seen.now_s)
            case Hold() if self._claim(seen):
                reference = self._reference
                resting = reference is not None and reference.velocity_mps == REST
                if not (self.phase is Phase.FLY and resting and self._at_target()):
                    self._enter(Phase.BRAKE, seen.now_s)
            case Land() if self.phase is Phase.LIFT and seen.at_m is not None:
                # an autopilot that has begun to climb is stopped only by other set-points
                self._reference, self._speed_mps = Reference(seen.at_m), command.speed_mps
                self._enter(Phase.LAND, seen.now_s)
            case Land():
                if self.phase is Phase.CONFIRM or self._relift_m is not None:
                    self._settle(seen.now_s)
                    self._disarming = seen.armed
            case Hold() if self.phase is Phase.LIFT and self._target is not None:
                (x, y, top), speed = self._target
                self._target = ((x, y, min(top, self._ground_z + HOLD_LIFT_M)), speed)
            case _:
                pass

    def _land_by_itself(self, now_s: float) -> None:
        """Has the autopilot land in its own mode."""
        if self.phase is not Phase.LAND:
            self._reference = self._reference or Reference((0.0, 0.0, 0.0))
            self._enter(Phase.LAND, now_s)
        self._land_mode = True

    def _up(self, seen: Seen) -> bool:
        flies = seen.armed and seen.airborne and self.phase is not Phase.CONFIRM
        return self.phase in (*AIR, Phase.LIFT) or flies

    def _claim(self, seen: Seen) -> bool:
        """Whether it flies and is ours to move; takes over what already flies without us."""
        if not self._up(seen):
            return False
        if self._failsafe:
            self.fault = LEFT_ALONE
            return False
        if self.phase in AIR and not self._land_mode:
            return True
        if self.phase is Phase.LIFT and not self._left(seen):
            return False
        if seen.by_pilot:
            self.fault = "a pilot steers; not followed until the pilot gives it back"
            return False
        if seen.at_m is None:
            return False
        self._reference, self._yaw_rad = Reference(seen.at_m), seen.yaw_rad
        self._fly((seen.at_m, self._limits.max_speed_mps), seen.now_s)
        return True

    def _left(self, seen: Seen) -> bool:
        """Whether a lifting UAV has left the ground."""
        return seen.at_m is not None and seen.airborne and seen.at_m[2] > self._ground_z + LEFT_M

    def _take_off(self, command: TakeOff, seen: Seen) -> None:
        speed = min(command.speed_mps, self._limits.climb_mps)
        if self.phase is Phase.LIFT and self._target is not None:
            x, y, _ = self._target[0]
            self._target = ((x, y, command.altitude_m), speed)
        elif self._up(seen):
            if not self._claim(seen) or self._reference is None:
                return
            if self._target is not None and self._target[0][2] == command.altitude_m and self.phase is Phase.FLY:
                return
            x, y, _ = self._reference.position_m
            self._fly(((x, y, command.altitude_m), speed), seen.now_s)
        elif seen.armed and seen.at_m is not None and command.altitude_m > seen.at_m[2]:
            self._lift(command.altitude_m, speed, seen)

    def _lift(self, altitude_m: float, speed_mps: float, seen: Seen) -> None:
        assert seen.at_m is not None
        x, y, self._ground_z = seen.at_m
        self._reference, self._yaw_rad = Reference(seen.at_m), seen.yaw_rad
        self._target = ((x, y, altitude_m), speed_mps)
        self.on_pad, self._disarming, self.fault = False, False, None if self._relift_m is None else self.fault
        self._enter(Phase.LIFT, seen.now_s)

    def _dock(self, command: Dock, now_s: float) -> None:
        known = self.attempt
        if known is not None and self.phase in (Phase.DOCK, Phase.ABORT):
            old = known.command
            # while it climbs out of a missed attempt, a repeated command still means that attempt
            if (old.onto, old.dock, old.abort_altitude_m) == (command.onto, command.dock, command.abort_altitude_m):
                return
        self.attempt, self.fault = Attempt(command), None
        self._enter(Phase.DOCK, now_s)

    def _fly(self, target: tuple[Vec3, float], now_s: float) -> None:
        self._target = target
        self._enter(Phase.FLY, now_s)

    def _enter(self, phase: Phase, now_s: float) -> None:
        self.phase, self._since_s = phase, now_s
        self._count_s = self._count_m = self._blind_s = 0.0
        if phase not in AIR or self._land_mode:
            self._guided_seen = False
        self._land_mode = self._landing_seen = False

    def _settle(self, now_s: float) -> None:
        self._enter(Phase.IDLE, now_s)
        self._arming_s = self._relift_m = None

    def _at_target(self) -> bool:
        return (
            self._reference is not None and self._target is not None and (self._reference.position_m == self._target[0])
        )

    # ------------------------------------------------------------------------------------------------ steps

    def step(self, seen: Seen) -> Wants:
        """What is wanted now."""
        self._keep_up(seen)
        match self.phase:
            case Phase.IDLE:
                return self._idle(seen)
            case Phase.LIFT:
                return self._leave_ground(seen)
            case Phase.CONFIRM:
                return self._confirm(seen)
            case Phase.LAND:
                return self._land(seen)
            case Phase.DOCK:
                self._step_dock(seen)
            case Phase.BRAKE:
                self._step_brake(seen)
            case _:
                self._step_fly(seen)
        return self._streamed()

    def _streamed(self) -> Wants:
        return Wants(self._reference, self._yaw_rad or 0.0, guided=True)

    def _keep_up(self, seen: Seen) -> None:
        """Notices what the vehicle has decided by itself."""
        self._watch_failsafe(seen)
        if self.phase not in (*AIR, Phase.LIFT):
            return
        if not seen.link:
            # It may have landed by its own failsafe by the time it is heard again: whoever went on streaming would
            # make it take off once more. A landing must go on, though.
            self.fault = self.fault or "link lost: left to its own failsafe"
            if self.phase is Phase.LAND:
                self._land_mode = True
            else:
                self._settle(seen.now_s)
            return
        if not seen.armed:
            if self.phase is not Phase.LAND and self.phase is not Phase.DOCK:
                self.fault = self.fault or "disarmed by itself"
            self._settle(seen.now_s)
            return
        if seen.guided:
            self._guided_seen = True
        elif self._guided_seen and not self._land_mode:
            self.fault = LEFT_ALONE if self._failsafe else "its mode was changed by a pilot or by its own failsafe"
            self._settle(seen.now_s)
            return
        elif self._land_mode and self._landing_seen and seen.by_pilot:
            self.fault = "a pilot has ended its landing"
            self._settle(seen.now_s)
            return
        else:
            self._landing_seen = self._land_mode and seen.failsafe
        if self.phase in (Phase.FLY, Phase.BRAKE, Phase.ABORT):
            self._count_s = self._count_s + seen.dt_s if seen.on_ground else 0.0
            if self._count_s > STRANDED_S:
                self.fault = "on the ground without a landing"
                self._settle(seen.now_s)
                self._disarming = True

    def _watch_failsafe(self, seen: Seen) -> None:
        """Notices a failsafe for a cause of its own (battery, estimator), which no command of ours may end in the air.

        One that answers to a pause of set-points or telemetry was ours, and is over when they are back.
        """
        if not seen.link:
            return
        flies = seen.armed and seen.airborne and not seen.guided
        shown = flies and seen.failsafe and not seen.by_pilot
        if not flies or seen.by_pilot:
            self._failsafe = False
        elif shown and not self._failsafe_seen and not seen.lapsed and not self._land_mode:
            self._failsafe = True
        self._failsafe_seen = shown

    def _idle(self, seen: Seen) -> Wants:
        armed: bool | None = None
        guided = False
        if self._arming_s is not None:
            if seen.armed and seen.guided:
                self._arming_s = None
                if self._relift_m is not None and seen.at_m is not None:
                    self._lift(self._relift_m, self._limits.climb_mps, seen)
                    self._relift_m = None
                    return self._leave_ground(seen)
            elif seen.now_s - self._arming_s > self._options.arm_timeout_s:
                self._arming_s = self._relift_m = None
                self.fault = self.fault or "arming took too long"
            elif self._streams_on_ground and seen.at_m is None:
                self.fault = "no position: cannot be armed"
            else:
                guided = True
                armed = True if seen.guided else None
        if self._disarming:
            if not seen.armed or seen.airborne:
                self._disarming = False
            else:
                armed = False
        setpoint: Reference | None = None
        wanted = self._arming_s is not None or (seen.armed and not seen.airborne)
        if self._streams_on_ground and wanted and seen.at_m is not None:
            x, y, z = seen.at_m
            if self._stream_s is None:
                self._stream_s = seen.now_s
            setpoint = Reference((x, y, z - REST_BELOW_M))
            guided = guided and seen.now_s - self._stream_s >= STREAM_FIRST_S
        else:
            self._stream_s = None
        return Wants(setpoint, seen.yaw_rad, guided=guided, armed=armed)

    def _leave_ground(self, seen: Seen) -> Wants:
        assert self._target is not None
        assert self._reference is not None
        (x, y, top), speed = self._target
        at = seen.at_m
        up_m = 0.0 if at is None else at[2] - self._ground_z
        step_m = min(top - self._ground_z, self._options.takeoff_step_m)
        if up_m > self._count_m + 0.05:
            self._count_m, self._count_s = up_m, 0.0
        self._count_s += seen.dt_s
        if self._lifts_by_command:
            # its home may lie lower than it stands: then its own take-off ends lower, too
            enough = up_m > 0.8 * step_m or (up_m > LEFT_M and self._count_s > STALLED_S)
            left = at is not None and seen.airborne and enough
        else:
            left = at is not None and up_m > LEFT_M
        if left and at is not None:
            # vertical from where it stood, whatever it drifted meanwhile
            self._reference = Reference((x, y, at[2]))
            self._fly(((x, y, top), speed), seen.now_s)
            self._step_fly(seen)
            return self._streamed()
        if seen.now_s - self._since_s > self._options.takeoff_timeout_s:
            self.fault = "did not leave the ground"
            self._settle(seen.now_s)
            self._disarming = not seen.airborne
            return Wants()
        if self._lifts_by_command:
            return Wants(None, self._yaw_rad or 0.0, guided=True, takeoff_m=None if seen.airborne else step_m)
        kick = Reference((x, y, self._ground_z + KICK_M), (0.0, 0.0, min(speed, 0.3)))
        return Wants(kick, self._yaw_rad or 0.0, guided=True)

    def _step_fly(self, seen: Seen) -> None:
        assert self._reference is not None
        assert self._target is not None
        target, speed = self._target
        lag = 0.0 if seen.own_m is None else math.dist(seen.own_m, self._reference.position_m)
        # a reference that must wait brakes gently: it keeps a hair of speed so that the way goes on
        share = max(0.02, patience(lag, speed))
        self._reference = steer(self._reference, target, share * speed, self._limits, seen.dt_s)
        if self.phase is Phase.ABORT and self._at_target():
            self._fly(self._target, seen.now_s)

    def _step_brake(self, seen: Seen) -> None:
        assert self._reference is not None
        self._reference = brake(self._reference, self._limits.accel_mps2, seen.dt_s)
        if self._reference.velocity_mps == REST:
            self._fly((self._reference.position_m, self._limits.max_speed_mps), seen.now_s)

    def _land(self, seen: Seen) -> Wants:
        reference = self._reference
        assert reference is not None
        if seen.on_ground:
            self._count_s += seen.dt_s
        else:
            self._count_s = 0.0
        if self._count_s >= LANDED_S:
            return replace(self._streamed(), guided=False, armed=False, land_mode=self._land_mode)
        self._blind_s = self._blind_s + seen.dt_s if seen.at_m is None else 0.0
        if self._blind_s > BLIND_S:
            self._land_mode = True
        if self._land_mode:
            return Wants(None, self._yaw_rad or 0.0, land_mode=True)
        vx, vy, vz = reference.velocity_mps
        limits, options, dt = self._limits, self._options, seen.dt_s
        most = limits.accel_mps2 * dt
        if math.hypot(vx, vy) > 0.0:
            # first stop sideways, then down: a landing out of a flight must not drag
            self._reference = moved(reference, along((vx, vy, vz), REST, most), dt)
            return self._streamed()
        x, y, z = reference.position_m
        at_z = z if seen.at_m is None else seen.at_m[2]
        speed = min(self._speed_mps, limits.descent_mps)
        if at_z < options.touchdown_m:
            speed = min(speed, options.touchdown_mps)
        velocity = along(reference.velocity_mps, (0.0, 0.0, -speed), most)
        lowest = at_z - PRESS_M
        z = max(z + velocity[2] * dt, min(z, lowest))
        self._reference = Reference((x, y, z), velocity)
        # pressed down without contact for long: its own landing knows better
        if z > lowest + 0.05:
            self._since_s = seen.now_s
        if seen.now_s - self._since_s > options.land_timeout_s:
            self._land_mode = True
        if self._land_mode:
            return Wants(None, self._yaw_rad or 0.0, land_mode=True)
        return self._streamed()

    def _step_dock(self, seen: Seen) -> None:
        assert self.attempt is not None
        assert self._reference is not None
        self.attempt, self._reference, outcome = dock_step(
            self.attempt, self._reference, seen.pose_m, seen.on_ground, seen.pad, self._limits, seen.dt_s
        )
        if outcome is Outcome.TOUCHED:
            self._enter(Phase.CONFIRM, seen.now_s)
        elif outcome is Outcome.MISSED:
            self._miss(self.attempt.why, seen)

    def _miss(self, why: str, seen: Seen) -> None:
        assert self.attempt is not None
        assert self._reference is not None
        self.fault = f"dock missed: {why}"
        x, y, z = self._reference.position_m
        if seen.at_m is not None:
            # upwards from where it is: the reference may be below a pad
            z = max(z, seen.at_m[2])
        vx, vy, _ = self._reference.velocity_mps
        self._reference = Reference((x, y, z), (vx, vy, 0.0))
        self._target = ((x, y, max(self.attempt.command.abort_altitude_m, z)), self._limits.climb_mps)
        self._enter(Phase.ABORT, seen.now_s)

    def _confirm(self, seen: Seen) -> Wants:
        assert self.attempt is not None
        full = seen.battery is not None and seen.battery >= FULL
        if seen.armed:
            if self._streams_on_ground and seen.at_m is not None:
                x, y, z = seen.at_m
                down = Reference((x, y, z - REST_BELOW_M))
                return Wants(down, self._yaw_rad or 0.0, armed=False)
            return Wants(armed=False)
        self._count_s += seen.dt_s
        if seen.charging or ((seen.charging is None or full) and self._count_s > 1.0):
            self.on_pad = True
            self._settle(seen.now_s)
        elif self._count_s > self._options.charge_confirm_s:
            self.fault = "dock missed: the charger does not confirm"
            altitude_m = self.attempt.command.abort_altitude_m
            self._settle(seen.now_s)
            self._arming_s, self._relift_m = seen.now_s, altitude_m
        return Wants()
