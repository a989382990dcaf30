"""What MAVLink copters and rovers have in common: connecting, telemetry, arming, the emergency stop, liveness.

Threads: the loop calls the public methods, which only hand over; everything else happens in the link's thread.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from drivers import mavlink_ardupilot, mavlink_px4
from drivers import mavlink_words as w
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.geodesy import GeoFrame
from drivers.last_will import Argument, LastWill
from drivers.limits import PoseBook, UavLimits, UgvLimits
from drivers.mavlink_checks import Shown, findings
from drivers.mavlink_commands import Desk, Request, request
from drivers.mavlink_dialect import Dialect, described, kind_of
from drivers.mavlink_frames import MavlinkFrame
from drivers.mavlink_link import Link, key_is_open
from drivers.mavlink_motion import Reference
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_setup import Setup, Stream
from drivers.mavlink_stop import Stop
from drivers.mavlink_telemetry import Telemetry
from drivers.vehicle import Command, Kind, Pose, SelfCheck, StopMotors, VehicleState

logger = logging.getLogger(__name__)

DIALECTS: dict[tuple[int, str], Dialect] = {
    (w.PX4, "uav"): mavlink_px4.COPTER,
    (w.PX4, "ugv"): mavlink_px4.ROVER,
    (w.ARDUPILOT, "uav"): mavlink_ardupilot.COPTER,
    (w.ARDUPILOT, "ugv"): mavlink_ardupilot.ROVER,
}
POLL_S = 0.02


class MavlinkVehicle:
    """The common part of ``MavlinkUav`` and ``MavlinkUgv``."""

    kind: Kind
    _limits: UavLimits | UgvLimits
    _streams: tuple[Stream, ...] = ()

    def __init__(
        self,
        id: str,
        endpoint: str,
        *,
        body: str,
        sysid: int,
        book: PoseBook,
        frame: GeoFrame | None,
        clock: Clock,
        options: MavlinkOptions,
    ) -> None:
        if not 1 <= sysid <= 255 or sysid == options.system_id:
            raise DriverError(f"{id}: sysid is {sysid!r}; give 1 to 255, other than this station's {options.system_id}")
        self._id, self._endpoint, self._body, self._sysid = id, endpoint, body, sysid
        self._book, self._clock, self._options = book, clock, options
        # an own copy: projections are made and used by one thread only
        self._frame = MavlinkFrame(None if frame is None else replace(frame), options.floor_amsl_m or 0.0)
        self._floor_known = frame is None or options.floor_amsl_m is not None
        self._telemetry = Telemetry()
        self._desk = Desk(self._send_command, self._on_refusal)
        self._dialect: Dialect | None = None
        self._link: Link | None = None
        self._inbox: deque[Command] = deque()
        self._lock = threading.Lock()
        self._called_s = -math.inf
        self._pose: Pose | None = None
        self._posed_s = self._origin_s = -math.inf
        self._arrived: set[str] = set()
        self._answered = False
        self._setup = Setup(options)
        self._refusal: tuple[str, float] | None = None
        self._error: str | None = None
        self._stop = Stop()
        self._ticked_s: float | None = None
        self._snapshot = VehicleState(id, stamp_s=0.0, link=False, armed=False)

    # --------------------------------------------------------------------------------------- the loop's side

    @property
    def id(self) -> str:
        """Its id in the fleet."""
        return self._id

    @property
    def sysid(self) -> int:
        """Its MAVLink system id."""
        return self._sysid

    @property
    def body(self) -> str:
        """Its name in poses."""
        return self._body

    @property
    def outdoors(self) -> bool:
        """Positioned by satellites."""
        return self._frame.geo is not None

    def connect(self, deadline_s: float) -> None:
        """Opens the endpoint, finds the vehicle, asks for its telemetry and reads its safety parameters.

        Raises:
            DriverError: naming the endpoint, who was heard instead, and the remedy.
        """
        if self._link is not None:
            return
        self._called_s = self._clock.now()
        self._desk = Desk(self._send_command, self._on_refusal)
        # a fresh start: what was known before a close is old; a latched emergency stop is not forgotten
        self._telemetry, self._arrived, self._answered = Telemetry(), set(), False
        try:
            self._link = Link.board(
                self._endpoint, self._options, self._clock, self, max(0.1, deadline_s - self._clock.now())
            )
        except DriverError as error:
            raise DriverError(f"{self._id}: {error}") from error
        try:
            self._wait(lambda: self._telemetry.heartbeat_s > -math.inf, deadline_s, self._nobody)
            self._identify()
            self._prepare()
            needed = {stream.name for stream in self._streams if stream.needed}
            self._wait(lambda: needed <= self._arrived, deadline_s, lambda: self._mute(needed - self._arrived))
            self._wait(lambda: self._answered, deadline_s, self._deaf)
            self._wait_quietly(self._is_prepared, min(deadline_s, self._clock.now() + 10.0))
            # an answer comes before the message that it promises
            self._wait_quietly(lambda: "AUTOPILOT_VERSION" in self._arrived, min(deadline_s, self._clock.now() + 0.5))
        except BaseException:
            self.close()
            raise

    def state(self) -> VehicleState:
        """The newest snapshot; also tells that the loop lives."""
        now_s = self._called_s = self._clock.now()
        return replace(self._snapshot, link=self._link_up(now_s))

    def send(self, command: Command) -> Command:
        """Hands ``command`` to the link's thread, limited to what the vehicle may do; never blocks.

        Raises:
            DriverError: not connected, not for this vehicle, of the wrong kind, or with unusable values.
        """
        if command.vehicle != self._id:
            raise DriverError(f"{self._id}: {type(command).__name__} is for {command.vehicle!r}; send it there")
        self._check(command)
        link = self._link
        if link is None:
            raise DriverError(f"{self._id}: not connected; call connect first")
        sent = self._limits.limited(command)
        self._called_s = self._clock.now()
        with self._lock:
            if isinstance(sent, StopMotors):
                self._inbox.clear()
            self._inbox.append(sent)
        link.wake()
        return sent

    def feed_pose(self, pose: Pose) -> None:
        """Notes ``pose`` for all; indoors it is handed to the vehicle's own estimator."""
        self._book.put(pose)
        self._called_s = self._clock.now()
        link = self._link
        if link is None or pose.body != self._body or self.outdoors:
            return
        self._pose = pose
        link.wake()

    def self_checks(self) -> Sequence[SelfCheck]:
        """What its telemetry and parameters show."""
        link, dialect = self._link, self._dialect
        if link is None or dialect is None:
            return (SelfCheck("link", "fail", f"not connected to {self._endpoint}"),)
        now_s = self._clock.now()
        missing = [stream.name for stream in self._streams if stream.name not in self._arrived]
        shown = Shown(
            kind=self.kind,
            dialect=dialect,
            options=self._options,
            telemetry=self._telemetry,
            parameters=dict(self._setup.parameters),
            outdoors=self.outdoors,
            pose=self._book.get(self._body),
            now_s=now_s,
            streams_missing=tuple(missing),
            signing=link.signed,
            unsigned=link.rejected,
            key_is_open=key_is_open(self._options.signing_key_file),
            lost=link.lost(self._sysid),
        )
        return tuple(findings(shown))

    def last_will(self) -> LastWill:
        """Its autopilot lands or holds it."""
        o = self._options
        key = None if o.signing_key_file is None else str(o.signing_key_file.absolute())
        arguments: dict[str, Argument] = {
            "endpoint": self._endpoint, "sysid": self._sysid, "system_id": o.system_id,
            "component_id": o.component_id, "baud": o.baud, "signing_key_file": key,
        }  # fmt: skip
        return LastWill(self._id, "drivers.mavlink_will", arguments)

    def close(self) -> None:
        """Leaves the link and sends nothing: what the vehicle then does is its own failsafe's."""
        link, self._link = self._link, None
        if link is not None:
            link.leave(self)

    # ------------------------------------------------------------------------------------------- connecting

    def _wait(self, done: Callable[[], bool], deadline_s: float, error: Callable[[], str]) -> None:
        if not self._wait_quietly(done, deadline_s):
            raise DriverError(f"{self._id}: {error()}")

    def _wait_quietly(self, done: Callable[[], bool], deadline_s: float) -> bool:
        while not done():
            now_s = self._called_s = self._clock.now()
            if now_s >= deadline_s:
                return False
            self._clock.wait_until(min(deadline_s, now_s + POLL_S))
        return True

    def _nobody(self) -> str:
        assert self._link is not None
        heard = {k: v for k, v in self._link.heard.items() if k != self._sysid}
        said = f"no heartbeat of system {self._sysid} at {self._endpoint}"
        if heard:
            others = ", ".join(f"system {k} ({described(v.autopilot, v.type)})" for k, v in sorted(heard.items()))
            return f"{said}; heard {others}: correct `sysid` in the fleet file or the id on the vehicle"
        if self._link.rejected:
            return f"{said}; what came was not signed with our key: give all vehicles the same key"
        return f"{said}, nor of anybody else: check power, radio, address and port, and its MAVLink output"

    def _mute(self, missing: set[str]) -> str:
        names = ", ".join(sorted(missing))
        return f"it is there but does not send {names} at {self._endpoint}: check its stream rates and the link"

    def _deaf(self) -> str:
        assert self._link is not None
        if self._link.foreign:
            why = "its packets are signed: give the same key by signing_key_file"
        else:
            why = "it does not hear us: check the link's other direction and that no key is set on the vehicle"
        return f"it is there but answers no command at {self._endpoint}; {why}"

    def _identify(self) -> None:
        t = self._telemetry
        what = described(t.autopilot, t.type)
        if kind_of(t.type) != self.kind:
            wanted = "a copter" if self.kind == "uav" else "a rover"
            raise DriverError(
                f"{self._id}: system {self._sysid} at {self._endpoint} is a {what}, not {wanted}; "
                "correct the fleet file or the vehicle's frame"
            )
        dialect = DIALECTS.get((t.autopilot, self.kind))
        if dialect is None:
            raise DriverError(f"{self._id}: system {self._sysid} at {self._endpoint} is a {what}; use PX4 or ArduPilot")
        self._adopt(dialect)
        self._dialect = dialect

    def _adopt(self, dialect: Dialect) -> None:
        """Makes ready for the dialect; before the link's thread looks at it."""

    def _prepare(self) -> None:
        """Has the link's thread ask for telemetry and parameters."""
        assert self._dialect is not None
        wanted = [
            *self._streams,
            Stream(*self._dialect.estimator, "status"),
            Stream("AUTOPILOT_VERSION", w.AUTOPILOT_VERSION, "once"),
        ]
        if self._dialect.wants_origin and not self.outdoors:
            wanted.append(Stream("GPS_GLOBAL_ORIGIN", w.GPS_GLOBAL_ORIGIN, "once"))
        self._setup.begin(wanted, self._dialect.parameters)

    def _is_prepared(self) -> bool:
        return self._setup.done and self._desk.idle

    def _ask_for_telemetry(self, now_s: float) -> None:
        if self._desk.idle:
            wanted = self._setup.next_request()
            if wanted is not None:
                self._desk.ask(wanted, now_s)
        for name in self._setup.parameters_due(now_s):
            self._put("param_request_read", self._sysid, w.AUTOPILOT_COMPONENT, name.encode(), -1)

    # --------------------------------------------------------------------------------------- the link's side

    def alive(self, now_s: float) -> bool:
        """Whether the loop has called lately."""
        return now_s - self._called_s <= self._options.loop_silence_s

    def on_message(self, message: Any, now_s: float) -> None:
        """Takes a message of its autopilot."""
        name = message.get_type()
        t = self._telemetry
        if name == "GLOBAL_POSITION_INT" and not self._floor_known and not (message.lat == 0 and message.lon == 0):
            self._frame = replace(self._frame, floor_amsl_m=message.alt * 1e-3)
            self._floor_known = True
        t.take(message, now_s, self._frame)
        self._arrived.add(name)
        if name == "COMMAND_ACK":
            if message.target_system in (0, self._options.system_id):
                self._answered = True
                self._desk.answered(message.command, message.result, now_s)
                if message.result == w.ACCEPTED and message.command in (w.DO_SET_MODE, w.ARM_DISARM):
                    # heartbeats come once a second: ask for the effect
                    self._desk.settled("heartbeat")
                    self._desk.ask(request("heartbeat", w.REQUEST_MESSAGE, w.HEARTBEAT, loud=False), now_s)
        elif name == "PARAM_VALUE":
            self._take_parameter(message)
        # in the air nothing is reset: a reboot shows disarmed by the next heartbeat
        if t.rebooted and not t.armed:
            t.rebooted = False
            self._after_reboot()

    def _take_parameter(self, message: Any) -> None:
        name = message.param_id.decode() if isinstance(message.param_id, bytes) else str(message.param_id)
        if self._dialect is not None:
            self._setup.take(name, message.param_value, message.param_type, self._dialect.bytewise)

    def _after_reboot(self) -> None:
        """A rebooted vehicle is unlocked and has forgotten the rates."""
        if self._dialect is None:
            return
        self._stop.release()
        self._desk.clear()
        self._telemetry.origin_known = False
        self._reset()
        self._prepare()

    def pump(self, now_s: float) -> None:
        """Acts on commands and poses that were handed over."""
        if self._dialect is None:
            return
        pose = self._pose
        if pose is not None and now_s - self._posed_s >= 1.0 / self._options.pose_hz - 0.004:
            self._pose, self._posed_s = None, now_s
            self._send_pose(pose)
        while True:
            with self._lock:
                if not self._inbox:
                    break
                command = self._inbox.popleft()
            if isinstance(command, StopMotors):
                self._stop.begin(now_s)
                self._desk.clear()  # above all no arming that waits for its answer
                self._reset()
                self._go_on_stopping(now_s)
            elif not self._stop.latched:
                self._take(command, now_s)
        self._publish(now_s)

    def tick(self, now_s: float) -> None:
        """One step: commands under way, the emergency stop, set-points."""
        if self._dialect is None:
            return
        dt_s = 0.0 if self._ticked_s is None else min(now_s - self._ticked_s, 0.2)
        self._ticked_s = now_s
        self._ask_for_telemetry(now_s)
        self._desk.tick(now_s)
        self._go_on_stopping(now_s)
        # a silent loop must look dead to the vehicle; only an emergency stop goes on
        if not self._stop.latched and self.alive(now_s) and dt_s > 0:
            self._step(now_s, dt_s)
        self._publish(now_s)

    def _go_on_stopping(self, now_s: float) -> None:
        assert self._dialect is not None
        t = self._telemetry
        for wanted in self._stop.step(now_s, t.armed, t.heartbeat_s, self._dialect.terminates):
            self._send_command(wanted, 0, urgent=True)

    def on_error(self, error: Exception) -> None:
        """Something of ours failed in the link's thread: told, never fatal to the others."""
        if self._error is None:
            logger.exception("%s: internal error in the MAVLink driver", self._id, exc_info=error)
        self._error = f"internal error: {error}"

    # ------------------------------------------------------------------------------------------- sending

    def _put(self, name: str, *values: Any, urgent: bool = False) -> None:
        link = self._link
        if link is not None:
            link.send(self._sysid, name, *values, urgent=urgent)

    def _send_command(self, wanted: Request, confirmation: int, urgent: bool = False) -> None:
        target = (self._sysid, w.AUTOPILOT_COMPONENT)
        self._put("command_long", *target, wanted.command, confirmation, *wanted.parameters, urgent=urgent)

    def _send_pose(self, pose: Pose) -> None:
        """Motion capture for the estimator; the roll and pitch of a Pose are unknown, autopilots look at the yaw."""
        north, east, down = self._frame.to_ned(pose.position_m)
        heading = self._frame.to_heading(pose.yaw_rad)
        unknown = (math.nan, *(0.0,) * 20)
        usec = round(pose.stamp_s * 1e6)
        self._put("vision_position_estimate", usec, north, east, down, 0.0, 0.0, heading, unknown)
        t = self._telemetry
        wanted = self._dialect is not None and self._dialect.wants_origin and not (t.origin_known or t.armed)
        if wanted and self._posed_s - self._origin_s >= 1.0:
            self._origin_s = self._posed_s
            lat, lon = self._options.indoor_origin_deg
            self._put("set_gps_global_origin", self._sysid, round(lat * 1e7), round(lon * 1e7), 0, usec)

    def _send_setpoint(self, wanted: Reference, yaw_rad: float) -> None:
        """A position with the velocity of the reference there, and the yaw to keep."""
        mask = w.IGNORE_ACCELERATION | w.IGNORE_YAW_RATE
        velocity = self._frame.to_ned(wanted.velocity_mps)
        rest = (*velocity, 0.0, 0.0, 0.0, self._frame.to_heading(yaw_rad), 0.0)
        stamp_ms = round(self._clock.now() * 1000) & 0xFFFFFFFF
        target = (stamp_ms, self._sysid, w.AUTOPILOT_COMPONENT)
        if self._frame.geo is None:
            place = self._frame.to_ned(wanted.position_m)
            self._put("set_position_target_local_ned", *target, w.LOCAL_NED, mask, *place, *rest)
        else:
            lat, lon, alt = self._frame.to_global(wanted.position_m)
            self._put("set_position_target_global_int", *target, w.GLOBAL_INT, mask, lat, lon, alt, *rest)

    # ------------------------------------------------------------------------------------------- reconciling

    def _is_guided(self) -> bool:
        return self._dialect is not None and self._telemetry.custom_mode == self._dialect.guided

    def _reconcile(self, guided: bool, armed: bool | None, now_s: float) -> None:
        """Asks for mode and arming until the telemetry shows them."""
        assert self._dialect is not None
        if not guided:
            self._desk.cancel("mode")
        elif self._is_guided():
            self._desk.settled("mode")
        else:
            p2, p3 = self._dialect.guided_parameters
            self._desk.ask(request("mode", w.DO_SET_MODE, w.CUSTOM_MODE, p2, p3), now_s)
        if armed is not True:
            self._desk.cancel("arming")
        if armed is not False:
            self._desk.cancel("disarming")
        if armed is None or armed == self._telemetry.armed:
            self._desk.settled("arming" if self._telemetry.armed else "disarming")
        elif armed:
            self._desk.ask(request("arming", w.ARM_DISARM, 1.0), now_s)
        else:
            self._desk.ask(request("disarming", w.ARM_DISARM, 0.0, self._disarm_magic()), now_s)

    def _disarm_magic(self) -> float:
        """Second parameter of disarming on the ground."""
        return 0.0

    def _on_refusal(self, what: str, why: str) -> None:
        self._refusal = (f"{what} refused: {why}", self._clock.now())

    def _own_position(self, now_s: float) -> tuple[float, float, float] | None:
        t = self._telemetry
        fresh = now_s - t.position_s <= self._options.pose_stale_s and self._floor_known
        return t.position_m if fresh else None

    def _trusted_position(self, now_s: float) -> tuple[float, float, float] | None:
        if self.outdoors:
            return self._own_position(now_s)
        pose = self._book.get(self._body)
        fresh = pose is not None and now_s - pose.stamp_s <= self._options.pose_stale_s
        return pose.position_m if pose is not None and fresh else None

    def _yaw(self) -> float:
        return self._frame.from_heading(self._telemetry.heading_rad)

    def own_pose(self) -> Pose | None:
        """Its own estimate, stamped on receipt; None until there is one."""
        t = self._telemetry
        if t.position_m is None or not self._floor_known:
            return None
        return Pose(self._body, self._pose_position(t.position_m), self._yaw(), t.position_s)

    def _pose_position(self, own_m: tuple[float, float, float]) -> tuple[float, float, float]:
        return own_m

    # ------------------------------------------------------------------------------------------- state

    def _link_up(self, now_s: float) -> bool:
        return self._link is not None and now_s - self._telemetry.heartbeat_s <= self._options.link_timeout_s

    def _publish(self, now_s: float) -> None:
        t = self._telemetry
        locked = self._stop.shown or t.system_status == w.TERMINATION
        self._snapshot = VehicleState(
            vehicle=self._id,
            stamp_s=t.stamp_s if math.isfinite(t.stamp_s) else 0.0,
            link=True,
            armed=t.armed,
            airborne=self._airborne(),
            tumbled=t.tumbled(now_s) if math.isfinite(t.heading_s) else False,
            locked=locked,
            charging=self._charging(),
            battery=t.battery,
            fault=self._fault(),
        )

    def _fault(self) -> str | None:
        if self._error is not None:
            return self._error
        if self._stop.latched:
            return "stopped by the operator" if self._stop.shown else "emergency stop not confirmed yet"
        said = self._doing_fault()
        if said is None or self._refusal is None or not said.startswith(self._refusal[0].split(":")[0]):
            return said
        # its reason may come a moment after the refusal
        why = self._telemetry.why(self._refusal[1] - 2.0)
        return f"{self._refusal[0]}; it says: {why}" if why else said

    # ------------------------------------------------------------------------------- for copters and rovers

    def _check(self, command: Command) -> None:
        raise NotImplementedError

    def _take(self, command: Command, now_s: float) -> None:
        raise NotImplementedError

    def _step(self, now_s: float, dt_s: float) -> None:
        raise NotImplementedError

    def _reset(self) -> None:
        raise NotImplementedError

    def _doing_fault(self) -> str | None:
        raise NotImplementedError

    def _airborne(self) -> bool:
        return False

    def _charging(self) -> bool:
        return False


def numbers_are_sound(*values: float) -> bool:
    """Whether every number is finite."""
    with contextlib.suppress(TypeError):
        return all(map(math.isfinite, values))
    return False
