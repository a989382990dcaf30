"""A rover of PX4 or ArduPilot behind the drivers' interface."""

from __future__ import annotations

from drivers import mavlink_words as w
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.geodesy import GeoFrame
from drivers.limits import PoseBook, UgvLimits
from drivers.mavlink_drive import Driving
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_setup import COMMON_STREAMS, where_streams
from drivers.mavlink_vehicle import MavlinkVehicle, numbers_are_sound
from drivers.vehicle import Arm, Command, Disarm, Drive, Hold, StopMotors, Vec3


class MavlinkUgv(MavlinkVehicle):
    """A rover; arguments as for ``MavlinkUav``."""

    kind = "ugv"
    _limits: UgvLimits

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
        self._streams = (*COMMON_STREAMS, *where_streams(frame is not None))
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
        if self._driving.going and not (t.armed and self._link_up(now_s)):
            # who is heard again after a while does not drive off by itself
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
