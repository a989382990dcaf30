"""The driver of one Crazyflie: a thread between the loop and the vehicle.

The loop's calls only leave notes; the thread sends poses and orders, keeps the estimator's gate and the flight, and
connects again when the link breaks. The decisions are in pure files of their own (``crazyflie_flight``, ``_dock``,
``_estimator``, ``_bits``), cflib in ``crazyflie_link``.
"""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from urllib.parse import urlparse

from drivers.clock import Clock
from drivers.crazyflie_battery import BatteryGauge
from drivers.crazyflie_bits import bits_of, charging_of, loaded_of, words
from drivers.crazyflie_checks import Facts, self_checks
from drivers.crazyflie_dock import DockRules
from drivers.crazyflie_estimator import VARIANCES, EstimatorGate
from drivers.crazyflie_flight import Flight
from drivers.crazyflie_link import LINEAR_PROTOCOL, CrazyflieLink, connect
from drivers.crazyflie_motion import rest_to_rest_s
from drivers.crazyflie_options import CrazyflieOptions, default_cache
from drivers.crazyflie_orders import FlightRules, LandOrder, Order, Phase, Seen, StopOrder
from drivers.crazyflie_senses import MOTION_S, Telemetry, Track, ground_m, pad_m
from drivers.errors import DriverError
from drivers.last_will import LastWill
from drivers.limits import Pads, PoseBook, UavLimits
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    GoTo,
    Hold,
    Kind,
    Land,
    Pose,
    SelfCheck,
    StopMotors,
    TakeOff,
    Vec3,
    VehicleState,
)

TICK_S = 0.02
NO_POSES_S = 1.0
STOP_EVERY_S = 0.05
STOP_UNCONFIRMED_S = 1.0
PING_S = 0.5
FORGOTTEN_S, LOG_AGAIN_S = 3.0, 2.0
HUNG_S = 1.0
"""A thread that has not turned for so long hangs: nothing that it is told reaches the vehicle."""
ERROR_SHOWN_S = 5.0
"""An error of the thread is told for so long."""
SCHEMES = ("radio", "usb", "udp")
COMMANDS = (Arm, Disarm, TakeOff, GoTo, Land, Dock, Hold, StopMotors)


class Crazyflie:
    """One Crazyflie behind the drivers' interface.

    Closing it on the ground stops and disarms it. Closing it in the air orders a landing, which the vehicle then does
    by itself, and drops the link without a packet (cflib's own goodbye is a zero set-point: the motors would stop).

    Raises:
        DriverError: when the URI is none of ``radio://``, ``usb://`` and ``udp://``.
    """

    def __init__(
        self,
        id: str,
        uri: str,
        *,
        body: str,
        limits: UavLimits,
        pads: Mapping[str, Pads],
        book: PoseBook,
        clock: Clock,
        options: CrazyflieOptions | None = None,
    ) -> None:
        if urlparse(uri).scheme not in SCHEMES:
            raise DriverError(f"{id}: {uri!r} is no Crazyflie's URI; it begins with radio://, usb:// or udp://")
        self._id, self._uri, self._body = id, uri, body
        self._limits, self._pads, self._book, self._clock = limits, dict(pads), book, clock
        self._options = o = options or CrazyflieOptions()
        self._dock_rules = DockRules(0.05, o.dock_range_m, o.dock_speed_mps, o.align_s, o.touch_m)
        self._telemetry = Telemetry()
        self._link: CrazyflieLink | None = None
        self._state_variable = ""
        self._reconnecting: threading.Thread | None = None
        self._flight = Flight(self._flight_rules(False))
        self._gate = EstimatorGate(o.converge_s, o.converge_samples, o.converge_m2, o.converge_timeout_s)
        self._battery = BatteryGauge(o.battery_curve, o.battery_sag_v)
        self._pad_track, self._pad_of = Track(), ""
        self._commands: deque[Command] = deque()
        self._answers: deque[tuple[type[Order], int]] = deque()
        self._variances: deque[tuple[float, list[float]]] = deque()
        self._pose: Pose | None = None
        self._newest: Pose | None = None
        self._sent_s = -math.inf
        self._attitude = False
        self._fed = 0
        self._tick: tuple[float, bool | None] = (math.nan, None)
        self._stop_s: float | None = None
        self._stop_sent_s = -math.inf
        self._ping_s = -math.inf
        self._logs_s = -math.inf
        self._reboots = 0
        self._wake = threading.Condition()
        self._closing = threading.Event()
        self._worker: threading.Thread | None = None
        self._turned_s = -math.inf
        self._error: tuple[float, str] = (-math.inf, "")

    def _flight_rules(self, cruise: bool) -> FlightRules:
        o = self._options
        return FlightRules(
            self._limits, self._dock_rules, charge_confirm_s=o.charge_confirm_s, astray_m=o.astray_m, cruise=cruise
        )

    # --- the interface

    @property
    def id(self) -> str:
        """Its id in the fleet."""
        return self._id

    @property
    def kind(self) -> Kind:
        """Always ``uav``."""
        return "uav"

    def connect(self, deadline_s: float) -> None:
        """Connects and starts its telemetry; the estimator is made ready later, as soon as poses are fed.

        Raises:
            DriverError: naming the vehicle, the cause and the remedy.
        """
        if self._link is not None:
            return
        self._closing.clear()
        timeout_s = deadline_s - self._clock.now()
        if timeout_s <= 0:
            raise DriverError(f"{self._id}: no time left to connect to {self._uri}; give a longer deadline")
        try:
            self._adopt(self._connect(timeout_s))
        except DriverError as error:
            raise DriverError(f"{self._id}: cannot connect to {self._uri} within {timeout_s:.0f} s: {error}") from error
        self._turned_s = self._clock.now()
        self._worker = threading.Thread(target=self._work, name=f"crazyflie-{self._id}", daemon=True)
        self._worker.start()

    def state(self) -> VehicleState:
        """The newest telemetry; ``link`` is down when cflib says so, the state is not logged or our thread hangs."""
        link, flight = self._link, self._flight
        stamp_s, (_, values) = self._state_s(), self._telemetry.snapshot()
        bits = bits_of(values)
        fresh = self._clock.now() - stamp_s <= self._options.telemetry_s
        charging = charging_of(values)
        if charging is None:
            charging = flight.docked and flight.phase is Phase.GROUND
        airborne = flight.airborne(bits)
        return VehicleState(
            vehicle=self._id,
            stamp_s=stamp_s,
            link=link is not None and link.up and fresh and self._works(),
            armed=flight.armed(bits) and self._stop_s is None,
            airborne=airborne,
            tumbled=bits is not None and (bits.tumbled or bits.crashed),
            locked=bits is not None and bits.locked,
            charging=charging and not airborne,
            battery=self._battery.share,
            fault=self._fault(),
        )

    def _state_s(self) -> float:
        """Receipt of the newest state: that battery or variances still come does not prove that the state does."""
        return self._telemetry.stamp_of(self._state_variable)

    def _works(self) -> bool:
        """Whether the thread lives and turns: without it, telemetry comes but no command goes."""
        worker = self._worker
        return worker is not None and worker.is_alive() and self._clock.now() - self._turned_s <= HUNG_S

    def _fault(self) -> str | None:
        _, values = self._telemetry.snapshot()
        bits = bits_of(values)
        unconfirmed = self._stop_s is not None and (bits is None or not bits.locked)
        if unconfirmed and self._clock.now() - (self._stop_s or 0.0) > STOP_UNCONFIRMED_S:
            return "it does not confirm the emergency stop, which is being repeated"
        wrong = None if bits is None else words(bits)
        error_s, error = self._error
        if wrong is None and self._clock.now() - error_s <= ERROR_SHOWN_S:
            return error
        return wrong or self._flight.fault

    def send(self, command: Command) -> Command:
        """Takes ``command`` for the driver's thread; the speed is limited to what the vehicle may do.

        Raises:
            DriverError: not connected, not for this vehicle, of the wrong kind, or with unusable values.
        """
        self._check(command)
        sent = self._limits.limited(command)
        with self._wake:
            if isinstance(sent, StopMotors):
                self._commands.clear()
                self._commands.appendleft(sent)
            else:
                self._commands.append(sent)
            self._wake.notify()
        return sent

    def _check(self, command: Command) -> None:
        name = type(command).__name__
        if command.vehicle != self._id:
            raise DriverError(f"{self._id}: {name} is for {command.vehicle!r}; send it to that vehicle")
        if not isinstance(command, COMMANDS):
            raise DriverError(f"{self._id}: a uav cannot do {name}")
        if self._worker is None:
            raise DriverError(f"{self._id}: not connected; call connect first")
        numbers: tuple[float, ...] = ()
        match command:
            case TakeOff(_, altitude, speed):
                numbers = (altitude, speed)
            case GoTo(_, position, speed):
                numbers = (*position, speed)
            case Land(_, speed):
                numbers = (speed,)
            case Dock(_, onto, dock, speed, abort):
                numbers = (speed, abort)
                if onto not in self._pads or not 0 <= dock < len(self._pads[onto].offsets_m):
                    raise DriverError(f"{self._id}: there is no dock {dock} on {onto!r}; see the fleet file")
        if not all(map(math.isfinite, numbers)) or getattr(command, "speed_mps", 1.0) <= 0:
            raise DriverError(f"{self._id}: {command} has a number that is not finite or a speed that is not above 0")

    def self_checks(self) -> Sequence[SelfCheck]:
        """What it shows of itself; nothing before it is connected."""
        link = self._link
        if link is None:
            return ()
        _, values = self._telemetry.snapshot()
        gate = self._gate
        return self_checks(
            Facts(
                protocol=link.protocol,
                values=values,
                missing=link.missing,
                bits=bits_of(values),
                estimator=gate.phase,
                resets=gate.resets,
                variance_m2=gate.variance_m2,
                quality=link.quality,
                latency_s=link.latency_s,
                fed=self._fed,
                tick_moves=self._tick[1],
                heading=self._attitude,
            )
        )

    def feed_pose(self, pose: Pose) -> None:
        """Hands a pose on to the vehicle's estimator; only the newest counts."""
        self._book.put(pose)
        with self._wake:
            self._pose = pose
            self._wake.notify()

    def last_will(self) -> LastWill:
        """It lands where it is."""
        protocol = self._link.protocol if self._link is not None else None
        return LastWill(self._id, "drivers.crazyflie_will", {"uri": self._uri, "protocol": protocol})

    def close(self) -> None:
        """Releases the link; see the class for what the vehicle does then. Again does nothing."""
        self._closing.set()
        with self._wake:
            self._wake.notify()
        if self._worker is not None:
            self._worker.join(3.0)
            self._worker = None
        link, self._link = self._link, None
        if link is None:
            return
        if link.up:
            self._part(link)
        closer = threading.Thread(target=link.close, name="crazyflie-close", daemon=True)
        closer.start()
        closer.join(2.0)  # a jammed radio may hold it; the thread is left behind then

    def _part(self, link: CrazyflieLink) -> None:
        """The last orders: land on its own in the air, stop and disarm on the ground."""
        seen = self._look()
        flight = self._flight
        if flight.phase is not Phase.STOPPED and not flight.may_stop(seen):
            at = seen.position_m or (0.0, 0.0, self._limits.altitude_m)
            down = (at[0], at[1], seen.ground_m)
            duration_s = max(1.0, rest_to_rest_s(at, down, self._limits.descent_mps, self._limits))
            orders: list[Order] = [LandOrder(seen.ground_m, duration_s)] * 3
        elif self._stop_s is None:
            flight.command(Disarm(self._id), seen)
            orders = [StopOrder(), *flight.step(seen)]
        else:
            return
        for order in orders:
            link.send(order)
            threading.Event().wait(0.03)

    # --- the thread

    def _connect(self, timeout_s: float) -> CrazyflieLink:
        o = self._options
        self._telemetry.new_link = True
        return connect(
            self._uri,
            o.cache or default_cache(),
            self._on_log,
            lambda order, error: self._answers.append((order, error)),
            timeout_s=timeout_s,
            answer_s=o.answer_s,
            fast_ms=o.fast_ms,
            slow_ms=o.slow_ms,
            stop=self._closing,
        )

    def _adopt(self, link: CrazyflieLink) -> None:
        self._flight.rules = self._flight_rules(self._options.cruise and link.protocol >= LINEAR_PROTOCOL)
        self._gate.can_tell = not any(name in link.missing for name in VARIANCES)
        self._state_variable = link.state_variable
        self._link = link
        self._set_up(link)

    def _set_up(self, link: CrazyflieLink) -> None:
        """Parameters that a reboot forgets."""
        link.set_parameter("commander.enHighLevel", 1)
        o = self._options
        self._attitude = o.send_attitude and link.set_parameter("locSrv.extQuatStdDev", o.attitude_std_rad)

    def _on_log(self, stamp_ms: int, values: Mapping[str, float]) -> None:
        now_s = self._clock.now()
        self._telemetry.put(now_s, stamp_ms, values)
        if "pm.vbat" in values or "pm.batteryLevel" in values:
            _, known = self._telemetry.snapshot()
            self._battery.put(now_s, known, loaded_of(known), bool(charging_of(known)))
        if all(name in values for name in VARIANCES):
            self._variances.append((now_s, [values[name] for name in VARIANCES]))
        if "locSrvZ.tick" in values and self._fed:
            before, _ = self._tick
            self._tick = (values["locSrvZ.tick"], values["locSrvZ.tick"] != before)

    def _work(self) -> None:
        while not self._closing.is_set():
            with self._wake:
                if not self._commands and self._pose is None:
                    self._wake.wait(TICK_S)
                commands = list(self._commands)
                self._commands.clear()
                pose, self._pose = self._pose, None
            try:
                self._turn(commands, pose)
            except Exception as error:  # a dead thread could neither land it nor stop its motors
                self._error = (self._clock.now(), f"the driver failed with {type(error).__name__} ({error}); land it")
            self._turned_s = self._clock.now()

    def _turn(self, commands: list[Command], pose: Pose | None) -> None:
        now_s, link = self._clock.now(), self._link
        if any(isinstance(c, StopMotors) for c in commands):
            self._stop_s = now_s if self._stop_s is None else self._stop_s
            self._flight.stop()
        self._stop_motors(now_s, link)
        if pose is not None:
            self._feed(pose, now_s, link)
        if self._telemetry.reboots != self._reboots:
            self._rebooted(link)
        self._settle(now_s, link)
        seen = self._look()
        while self._answers:
            self._flight.acknowledged(*self._answers.popleft(), seen)
        for command in commands:
            self._take(command, seen)
        orders = self._flight.step(self._look() if commands else seen)
        if link is None:
            return
        for order in orders:
            link.send(order)
        if now_s - self._ping_s > PING_S:
            self._ping_s = now_s
            link.ping()
        if not link.up:
            if self._options.reconnect:
                self._reconnect()
        elif now_s - self._state_s() > FORGOTTEN_S and now_s - self._logs_s > LOG_AGAIN_S:
            self._logs_s = now_s
            link.log_again()

    def _stop_motors(self, now_s: float, link: CrazyflieLink | None) -> None:
        """Repeats an emergency stop until the vehicle says that it is locked."""
        if self._stop_s is None or link is None or now_s - self._stop_sent_s < STOP_EVERY_S:
            return
        _, values = self._telemetry.snapshot()
        bits = bits_of(values)
        if bits is not None and bits.locked and self._telemetry.age_s("supervisor.info", now_s) < 1.0:
            return
        self._stop_sent_s = now_s
        link.emergency_stop()

    def _feed(self, pose: Pose, now_s: float, link: CrazyflieLink | None) -> None:
        if self._newest is None or pose.stamp_s > self._newest.stamp_s:
            self._newest = pose
        if link is None or now_s - self._sent_s < 0.8 / self._options.pose_rate_hz:
            return
        link.send_pose(pose, self._attitude)
        self._sent_s = now_s
        self._fed += 1
        self._gate.fed(now_s)

    def _settle(self, now_s: float, link: CrazyflieLink | None) -> None:
        while self._variances:
            self._gate.logged(*self._variances.popleft())
        if link is None or (self._gate.phase != "resetting" and self._flight.airborne(self._look().bits)):
            return  # who flies (taken over after a restart) must not have its estimate reset
        for order in self._gate.step(now_s, self._newest):
            # where markers show no heading, it has been set down along the x axis
            aligned = order.name == "kalman.initialYaw" and not self._options.send_attitude
            link.set_parameter(order.name, 0.0 if aligned else order.value)

    def _rebooted(self, link: CrazyflieLink | None) -> None:
        self._reboots = self._telemetry.reboots
        self._flight = Flight(self._flight.rules)
        self._gate.restart()
        self._stop_s = None
        if link is not None:
            self._set_up(link)

    def _take(self, command: Command, seen: Seen) -> None:
        if isinstance(command, StopMotors):
            return
        if isinstance(command, Dock):
            pads = self._pads[command.onto]
            if self._pad_of != pads.body:
                self._pad_of, self._pad_track = pads.body, Track()
            self._flight.dock(command, pads.tolerance_m, seen)
        else:
            self._flight.command(command, seen)

    def _look(self) -> Seen:
        now_s = self._clock.now()
        _, values = self._telemetry.snapshot()
        pose = self._newest
        seen = pose is not None and now_s - pose.stamp_s <= self._options.pose_s
        position: Vec3 | None = pose.position_m if pose is not None and seen else None
        names = ("stateEstimate.x", "stateEstimate.y", "stateEstimate.z")
        estimated = all(n in values and self._telemetry.age_s(n, now_s) <= self._options.telemetry_s for n in names)
        if position is None and estimated:
            position = (values[names[0]], values[names[1]], values[names[2]])
        yaw = math.radians(values["stateEstimate.yaw"]) if "stateEstimate.yaw" in values else None
        pad, pad_speed = self._pad(now_s)
        return Seen(
            now_s,
            position,
            seen,
            yaw if yaw is not None else (pose.yaw_rad if pose is not None else 0.0),
            bits_of(values),
            charging_of(values),
            self._not_ready(now_s),
            ground_m(position, self._pads, self._book) if position is not None else 0.0,
            pad,
            pad_speed,
        )

    def _not_ready(self, now_s: float) -> str | None:
        if now_s - self._state_s() > self._options.telemetry_s:
            return "its telemetry has stopped; check its link"
        if not self._gate.ready:
            return {
                "no poses": "its estimator has got no poses; check motion capture",
                "failed": "its estimate does not settle on the poses; check body and axes in motion capture",
            }.get(self._gate.phase, "its estimate has not settled yet; wait a few seconds")
        if now_s - self._sent_s > NO_POSES_S:
            return "its estimator gets no poses any more; check motion capture"
        return None

    def _pad(self, now_s: float) -> tuple[Vec3 | None, float]:
        """The dock that it is told to land on and how fast that moves."""
        goal = self._flight.goal
        if not isinstance(goal, Dock):
            return None, 0.0
        pads = self._pads[goal.onto]
        pose = self._book.get(pads.body)
        if pose is None or now_s - pose.stamp_s > self._options.pose_s:
            return None, 0.0
        self._pad_track.put(pose)
        return pad_m(pose, pads.offsets_m[goal.dock], pads.height_m), self._pad_track.moved_m() / MOTION_S

    def _reconnect(self) -> None:
        if self._reconnecting is not None and self._reconnecting.is_alive():
            return
        self._reconnecting = threading.Thread(target=self._again, name=f"crazyflie-again-{self._id}", daemon=True)
        self._reconnecting.start()

    def _again(self) -> None:
        old = self._link
        if old is not None:
            old.close()
        while not self._closing.is_set():
            try:
                link = self._connect(10.0)
            except DriverError:
                continue
            if self._closing.is_set():
                link.close()
            else:
                self._adopt(link)
            return
