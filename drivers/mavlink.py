"""MAVLink vehicles behind the drivers' interface: copters and rovers of PX4 and ArduPilot, and poses by satellites.

Heights outdoors: every vehicle's arena floor is the height above sea level by its own estimate where it stood when it
connected, and again whenever it is armed on the ground, less the height of the pad it stands on. So neither errors
between receivers nor the hour's drift of a barometer reach the missions, and homes that autopilots move do not matter.
It takes the arena for level. A rover's z is 0 by definition: it drives on the floor.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from drivers import mavlink_words as w
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.geodesy import GeoFrame
from drivers.limits import Pads, PoseBook, UavLimits, UgvLimits
from drivers.mavlink_commands import request
from drivers.mavlink_dialect import Dialect
from drivers.mavlink_drive import Driving
from drivers.mavlink_flight import Flight, Seen
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_pad import PadTracker, dock_place
from drivers.mavlink_vehicle import MavlinkVehicle, Stream, numbers_are_sound
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    StopMotors,
    TakeOff,
    Vec3,
)

ROOF = 3.0
"""Within so many docking tolerances of a dock it stands on the UGV."""
COMMON_STREAMS = (
    Stream("ATTITUDE", w.ATTITUDE, "fast", needed=True),
    Stream("SYS_STATUS", w.SYS_STATUS, "slow", needed=True),
    Stream("BATTERY_STATUS", w.BATTERY_STATUS, "slow"),
)
LANDED = Stream("EXTENDED_SYS_STATE", w.EXTENDED_SYS_STATE, "status", needed=True)


def _where(outdoors: bool) -> tuple[Stream, ...]:
    """Positions come only once the estimator has one: they cannot be waited for before poses are fed."""
    if outdoors:
        position = Stream("GLOBAL_POSITION_INT", w.GLOBAL_POSITION, "fast")
        return (position, Stream("GPS_RAW_INT", w.GPS_RAW_INT, "slow"))
    return (Stream("LOCAL_POSITION_NED", w.LOCAL_POSITION, "fast"),)


class MavlinkUav(MavlinkVehicle):
    """A copter.

    Args:
        id: in the fleet.
        endpoint: as ``mavlink_socket.FORMS`` says, ``udpin:0.0.0.0:14550`` for one.
        body: its name in poses.
        sysid: its MAVLink system id.
        limits: never exceeded.
        pads: docks of each UGV it may land on, by UGV id.
        book: where the UGVs' trusted poses are found.
        frame: the arena on the globe; None: motion capture.
        clock: the loop's.
        options: see there.
    """

    kind = "uav"

    def __init__(
        self,
        id: str,
        endpoint: str,
        *,
        body: str,
        sysid: int,
        limits: UavLimits,
        pads: Mapping[str, Pads],
        book: PoseBook,
        frame: GeoFrame | None,
        clock: Clock,
        options: MavlinkOptions = MavlinkOptions(),  # noqa: B008  frozen
    ) -> None:
        super().__init__(id, endpoint, body=body, sysid=sysid, book=book, frame=frame, clock=clock, options=options)
        self._limits, self._pads = limits, pads
        self._streams = (*COMMON_STREAMS, LANDED, *_where(frame is not None))
        self._flight: Flight | None = None
        self._stood_m = 0.0
        self._flew = False
        self._tracker = PadTracker()

    def _adopt(self, dialect: Dialect) -> None:
        self._flight = Flight(
            self._limits,
            self._options,
            streams_on_ground=dialect.streams_on_ground,
            lifts_by_command=dialect.lifts_by_command,
        )

    def _check(self, command: Command) -> None:
        name = type(command).__name__
        match command:
            case Arm() | Disarm() | Hold() | StopMotors():
                return
            case TakeOff(_, altitude, speed):
                numbers: tuple[float, ...] = (altitude, speed)
            case GoTo(_, position, speed):
                numbers = (*position, speed)
            case Land(_, speed):
                numbers = (speed,)
            case Dock(_, onto, dock, speed, abort):
                numbers = (speed, abort)
                if not 0 <= dock < len(self._pads[onto].offsets_m if onto in self._pads else ()):
                    raise DriverError(f"{self._id}: there is no dock {dock} on {onto!r}")
            case _:
                raise DriverError(f"{self._id}: a uav cannot do {name}")
        if not numbers_are_sound(*numbers) or speed <= 0:
            raise DriverError(f"{self._id}: {command} has a number that is not finite or a speed that is not above 0")

    def _limited(self, command: Command) -> Command:
        limits = self._limits
        match command:
            case TakeOff(vehicle, altitude, speed):
                return TakeOff(vehicle, min(altitude, limits.altitude_m), min(speed, limits.climb_mps))
            case GoTo(vehicle, (x, y, z), speed):
                return GoTo(vehicle, (x, y, min(z, limits.altitude_m)), min(speed, limits.max_speed_mps))
            case Land(vehicle, speed):
                return Land(vehicle, min(speed, limits.descent_mps))
            case Dock(vehicle, onto, dock, speed, abort):
                return Dock(vehicle, onto, dock, min(speed, limits.descent_mps), min(abort, limits.altitude_m))
        return command

    def _seen(self, now_s: float, dt_s: float) -> Seen:
        assert self._dialect is not None
        assert self._flight is not None
        t = self._telemetry
        pad = None
        if self._flight.attempt is not None:
            asked = self._flight.attempt.command
            pads = self._pads[asked.onto]
            pose = self._book.get(pads.body)
            pad = self._tracker.look(pads, asked.dock, pose, now_s, self._options.pose_stale_s)
        return Seen(
            now_s=now_s,
            dt_s=dt_s,
            own_m=self._own_position(now_s),
            pose_m=self._trusted_position(now_s),
            yaw_rad=self._yaw(),
            armed=t.armed,
            on_ground=t.on_ground,
            airborne=t.airborne,
            guided=self._is_guided(),
            link=self._link_up(now_s),
            by_pilot=self._dialect.by_pilot(t.custom_mode),
            pad=pad,
            charging=t.charging,
            battery=t.battery,
        )

    def _take(self, command: Command, now_s: float) -> None:
        assert self._flight is not None
        if isinstance(command, Arm) and not self._telemetry.armed and self._telemetry.on_ground:
            self._level()
        self._flight.command(command, self._seen(now_s, 0.0))

    def _level(self) -> None:
        """Finds the floor's height anew from where it stands."""
        self._stood_m = self._standing_m()
        amsl_m = self._telemetry.amsl_m
        if self.outdoors and self._options.floor_amsl_m is None and amsl_m is not None:
            before_m = self._frame.floor_amsl_m
            self._frame = replace(self._frame, floor_amsl_m=amsl_m - self._stood_m)
            if self._telemetry.position_m is not None:
                x, y, z = self._telemetry.position_m
                self._telemetry.position_m = (x, y, z + before_m - self._frame.floor_amsl_m)

    def _standing_m(self) -> float:
        at = self._telemetry.position_m
        if at is None:
            return 0.0
        for pads in self._pads.values():
            pose = self._book.get(pads.body)
            if pose is None:
                continue
            for dock in range(len(pads.offsets_m)):
                if math.dist(dock_place(pads, dock, pose), at[:2]) <= ROOF * pads.tolerance_m:
                    return pads.height_m
        return 0.0

    def _step(self, now_s: float, dt_s: float) -> None:
        assert self._flight is not None
        assert self._dialect is not None
        t = self._telemetry
        # until its first flight: the poses of UGVs that it may stand on come later than its own
        if not self._flew and t.on_ground and not t.armed and self._standing_m() != self._stood_m:
            self._level()
        self._flew = self._flew or t.airborne
        wants = self._flight.step(self._seen(now_s, dt_s))
        if wants.setpoint is not None:
            self._send_setpoint(wants.setpoint, wants.yaw_rad)
        landing = self._dialect.landing_parameters
        if wants.land_mode and landing is not None and self._telemetry.airborne:
            self._desk.ask(request("landing mode", w.DO_SET_MODE, w.CUSTOM_MODE, *landing), now_s)
        self._reconcile(wants.guided, wants.armed, now_s)
        if wants.takeoff_m is not None and self._is_guided():
            nan = math.nan
            if self._dialect.lifts_by_command:
                nan = 0.0  # ArduPilot does not look at them, but checks that they are numbers
            wanted = request("take-off", w.NAV_TAKEOFF, 0.0, 0.0, 0.0, nan, 0.0, 0.0, wants.takeoff_m)
            self._desk.ask(wanted, now_s)

    def _on_refusal(self, what: str, why: str) -> None:
        super()._on_refusal(what, why)
        if self._flight is not None:
            self._flight.refused(what, why)

    def _reset(self) -> None:
        if self._flight is not None:
            self._flight.reset()

    def _doing_fault(self) -> str | None:
        return None if self._flight is None else self._flight.fault

    def _airborne(self) -> bool:
        return self._telemetry.airborne

    def _charging(self) -> bool:
        told = self._telemetry.charging
        if told is not None:
            return told and not self._telemetry.airborne
        return self._flight is not None and self._flight.on_pad and not self._telemetry.armed


class MavlinkUgv(MavlinkVehicle):
    """A rover; arguments as for ``MavlinkUav``."""

    kind = "ugv"

    def __init__(
        self,
        id: str,
        endpoint: str,
        *,
        body: str,
        sysid: int,
        limits: UgvLimits,
        book: PoseBook,
        frame: GeoFrame | None,
        clock: Clock,
        options: MavlinkOptions = MavlinkOptions(),  # noqa: B008  frozen
    ) -> None:
        super().__init__(id, endpoint, body=body, sysid=sysid, book=book, frame=frame, clock=clock, options=options)
        self._limits = limits
        self._streams = (*COMMON_STREAMS, *_where(frame is not None))
        self._driving = Driving(limits)
        self._arming_s: float | None = None
        self._disarming_s: float | None = None
        self._trouble: str | None = None

    def _check(self, command: Command) -> None:
        match command:
            case Arm() | Disarm() | Hold() | StopMotors():
                return
            case Drive(_, path, speed):
                if not path:
                    raise DriverError(f"{self._id}: Drive has an empty path; give at least one point")
                if not numbers_are_sound(speed, *(c for point in path for c in point)) or speed <= 0:
                    raise DriverError(f"{self._id}: {command} has a number that is not finite or a speed not above 0")
            case _:
                raise DriverError(f"{self._id}: a ugv cannot do {type(command).__name__}")

    def _limited(self, command: Command) -> Command:
        if isinstance(command, Drive):
            return Drive(command.vehicle, command.path_m, min(command.speed_mps, self._limits.max_speed_mps))
        return command

    def _take(self, command: Command, now_s: float) -> None:
        match command:
            case Arm():
                if not (self._telemetry.armed and self._is_guided()) and self._arming_s is None:
                    self._arming_s, self._disarming_s, self._trouble = now_s, None, None
            case Disarm():
                self._driving.hold()
                self._arming_s, self._disarming_s = None, now_s
            case Hold():
                self._driving.hold()
            case Drive(_, path, speed) if self._telemetry.armed:
                at = self._trusted_position(now_s)
                if at is None:
                    self._trouble = "no fresh pose to drive by"
                elif self._dialect is not None and self._dialect.by_pilot(self._telemetry.custom_mode):
                    self._trouble = "a pilot steers; not followed until armed anew"
                else:
                    self._trouble = None
                    self._driving.drive(path, speed, (at[0], at[1]))
            case _:
                pass

    def _step(self, now_s: float, dt_s: float) -> None:
        t = self._telemetry
        armed: bool | None = None
        if self._arming_s is not None:
            if t.armed and self._is_guided():
                self._arming_s = None
            elif now_s - self._arming_s > self._options.arm_timeout_s:
                self._arming_s, self._trouble = None, self._trouble or "arming took too long"
            elif self._is_guided():
                armed = True
        if self._disarming_s is not None:
            # an answered and an old wish both end
            if not t.armed or now_s - self._disarming_s > self._options.arm_timeout_s:
                self._disarming_s = None
            else:
                armed = False
        if not t.armed and self._driving.going:
            self._driving.hold()
        at = self._trusted_position(now_s)
        motion = self._driving.step(None if at is None else (at[0], at[1]), self._yaw(), dt_s)
        if t.armed or self._arming_s is not None:
            self._send_velocity(motion.velocity_mps)
        guided = self._arming_s is not None or (self._driving.going and t.armed)
        # PX4 wants to see set-points before it changes the mode
        if self._arming_s is not None and now_s - self._arming_s < 0.6:
            guided = False
        self._reconcile(guided, armed, now_s)

    def _send_velocity(self, velocity_mps: tuple[float, float] | None) -> None:
        assert self._dialect is not None
        vx, vy = velocity_mps or (0.0, 0.0)
        mask = w.IGNORE_POSITION | w.IGNORE_ACCELERATION | w.IGNORE_YAW
        # A velocity of zero has a direction for ArduPilot (Rover/GCS_MAVLink_Rover.cpp), so that it would turn north:
        # there standing is a turn rate of zero.
        if velocity_mps is not None or not self._dialect.turns_on_spot_by_rate:
            mask |= w.IGNORE_YAW_RATE
        north, east, down = self._frame.to_ned((vx, vy, 0.0))
        stamp_ms = round(self._clock.now() * 1000) & 0xFFFFFFFF
        target = (stamp_ms, self._sysid, w.AUTOPILOT_COMPONENT)
        nothing = (0.0, 0.0, 0.0)
        values = (*nothing, north, east, down, *nothing, 0.0, 0.0)
        self._put("set_position_target_local_ned", *target, w.LOCAL_NED, mask, *values)

    def _disarm_magic(self) -> float:
        # a rover that stands may always be disarmed, whatever its land detector thinks
        return w.FORCE

    def _on_refusal(self, what: str, why: str) -> None:
        super()._on_refusal(what, why)
        self._trouble = f"{what} refused: {why}"
        if what in ("arming", "mode"):
            self._arming_s = None

    def _reset(self) -> None:
        self._driving.reset()
        self._arming_s = self._disarming_s = None

    def _doing_fault(self) -> str | None:
        return self._trouble

    def _pose_position(self, own_m: Vec3) -> Vec3:
        return (own_m[0], own_m[1], 0.0)


APART_M = 1e-6


class TelemetryPoses:
    """The vehicles' own estimates as a source of poses, for missions outdoors.

    Args:
        vehicles: MAVLink vehicles with a ``GeoFrame``; they are connected by whoever owns them.

    Raises:
        DriverError: when one of them is flown by motion capture.
    """

    def __init__(self, vehicles: Sequence[MavlinkVehicle]) -> None:
        inside = [v.id for v in vehicles if not v.outdoors]
        if inside:
            raise DriverError(f"{', '.join(inside)}: no place on the globe; such vehicles need motion capture")
        self._vehicles = tuple(vehicles)
        self._read = dict.fromkeys((v.body for v in vehicles), -math.inf)
        self._told: dict[str, Vec3] = {}
        self._connected = False

    def connect(self, deadline_s: float) -> None:
        """Nothing to connect: poses come over the vehicles' links."""
        self._connected = True

    def read(self) -> Sequence[Pose]:
        """The newest pose of each vehicle received since the last call.

        Raises:
            DriverError: when it is not connected.
        """
        if not self._connected:
            raise DriverError("poses by telemetry: not connected; call connect first")
        found = []
        for vehicle in self._vehicles:
            pose = vehicle.own_pose()
            if pose is not None and pose.stamp_s > self._read[pose.body]:
                self._read[pose.body] = pose.stamp_s
                found.append(self._told_apart(pose))
        return tuple(found)

    def _told_apart(self, pose: Pose) -> Pose:
        """``pose``, a micrometre beside the last one where they are equal.

        Autopilots send positions in 1e-7 degrees, about a centimetre: a vehicle at rest repeats itself to the last bit.
        Each message is a measurement of its own all the same, and not the sign of a frozen camera that it would be in
        motion capture.
        """
        x, y, z = pose.position_m
        if self._told.get(pose.body) == pose.position_m:
            pose = replace(pose, position_m=(x, y, z + APART_M))
        self._told[pose.body] = pose.position_m
        return pose

    def close(self) -> None:
        """Stops reading; again does nothing."""
        self._connected = False
