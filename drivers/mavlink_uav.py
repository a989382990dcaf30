"""A copter of PX4 or ArduPilot behind the drivers' interface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

from drivers import mavlink_words as w
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.geodesy import GeoFrame
from drivers.limits import Pads, PoseBook, UavLimits
from drivers.mavlink_commands import request
from drivers.mavlink_dialect import Dialect
from drivers.mavlink_flight import Flight
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_pad import PadTracker, dock_place
from drivers.mavlink_setup import COMMON_STREAMS, Stream, where_streams
from drivers.mavlink_vehicle import MavlinkVehicle, numbers_are_sound
from drivers.mavlink_wants import Seen
from drivers.vehicle import Arm, Command, Disarm, Dock, GoTo, Hold, Land, StopMotors, TakeOff

ROOF = 3.0
"""Within so many docking tolerances of a dock it stands on the UGV."""
LAPSE_S = 0.5
"""Set-points or telemetry that pause for so long may be what a failsafe answers to: PX4's offboard loss, by 1 s."""
LAPSE_SHOWS_S = 2.5
"""A mode that was changed by it shows so much later at most: heartbeats come once a second, and one may be lost."""
LANDED = Stream("EXTENDED_SYS_STATE", w.EXTENDED_SYS_STATE, "status", needed=True)


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
    _limits: UavLimits

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
        self._streams = (*COMMON_STREAMS, LANDED, *where_streams(frame is not None))
        self._flight: Flight | None = None
        self._stood_m = 0.0
        self._flew = False
        self._stepped_s = self._lapsed_s = -math.inf
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
        if now_s - min(self._stepped_s, t.stamp_s) > LAPSE_S:
            self._lapsed_s = now_s
        grave = t.system_status in (w.CRITICAL, w.EMERGENCY)
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
            failsafe=t.custom_mode in self._dialect.returns or (grave and not self._is_guided()),
            lapsed=now_s - self._lapsed_s < LAPSE_SHOWS_S,
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
        self._stepped_s = now_s
        if wants.setpoint is not None:
            self._send_setpoint(wants.setpoint, wants.yaw_rad)
        self._reconcile(wants.guided, wants.armed, now_s)
        landing = self._dialect.landing_parameters
        if wants.land_mode and landing is not None and self._telemetry.airborne:
            self._desk.ask(request("landing mode", w.DO_SET_MODE, w.CUSTOM_MODE, *landing), now_s)
        else:
            self._desk.cancel("landing mode")
        if wants.takeoff_m is None:
            self._desk.cancel("take-off")
        elif self._is_guided():
            wanted = request("take-off", w.NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, wants.takeoff_m)
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
