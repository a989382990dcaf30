"""What PX4 and ArduPilot have in common: arming, modes, landing, auto-disarm and the simple flights. No I/O.

The personalities (``mavlink_px4``, ``mavlink_ardupilot``) bring tables of modes, their rules and their time-outs.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

from drivers.vehicle import Vec3
from sim_backends.wire.mavlink_guidance import IDLE, NAN, NOWHERE, OFF, Limits, Sense, Wish, stopping_point
from sim_backends.wire.mavlink_params import Params
from sim_backends.wire.mavlink_setpoints import Globe, SetPoint, Target

VehicleType = Literal["copter", "rover"]

ACCEPTED, REJECTED, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS = range(6)
INT_ONLY = 8
"""MAV_RESULT of common.xml (REJECTED is TEMPORARILY_REJECTED)."""
EMERGENCY, CRITICAL, ERROR, WARNING, INFO = 0, 2, 3, 4, 6
"""MAV_SEVERITY."""
CUSTOM, AUTO, GUIDED, STABILIZE, MANUAL, ARMED = 1, 4, 8, 16, 64, 128
"""MAV_MODE_FLAG."""
STANDBY, ACTIVE, IN_FAILSAFE, TERMINATED = 3, 4, 5, 8
"""MAV_STATE."""
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4
"""MAV_LANDED_STATE."""
FORCE_MAGIC = 21196
LANDED_S = 1.0
"""Touching ground and wanting down for this long is landed (LNDMC_TRIG_TIME; LAND_DETECTOR_TRIGGER_SEC)."""
THERE_M = 0.3
"""A take-off that is this near to its altitude is done."""

ARM_DISARM, SET_MODE, TAKEOFF, LAND, RTL, LOITER, REPOSITION, CHANGE_SPEED, TERMINATE, SET_HOME, PAUSE = (
    400, 176, 22, 21, 20, 17, 192, 178, 185, 179, 193,
)  # fmt: skip
"""MAV_CMD."""


def whole(value: float) -> int:
    """A parameter of an order as an integer; ground stations send NaN for what they do not give."""
    return round(value) if math.isfinite(value) else 0


class Does(enum.Enum):
    """What a vehicle does in a mode."""

    MANUAL = enum.auto()
    HOLD = enum.auto()
    TAKEOFF = enum.auto()
    LAND = enum.auto()
    RTL = enum.auto()
    FOLLOW = enum.auto()
    SINK = enum.auto()


@dataclass(frozen=True, slots=True)
class Mode:
    """One flight mode.

    Attributes:
        number: custom_mode of the heartbeat.
        does: what it does.
        flags: base_mode of the heartbeat, without the armed bit.
        arms: it may be armed in.
        position: it needs a position.
    """

    number: int
    does: Does
    flags: int = CUSTOM | STABILIZE | AUTO
    arms: bool = True
    position: bool = True


@dataclass(frozen=True, slots=True)
class Order:
    """A command of COMMAND_LONG or COMMAND_INT; latitude and longitude in degrees.

    Attributes:
        command: MAV_CMD.
        p: its seven parameters.
        frame: MAV_FRAME of COMMAND_INT.
        is_int: it came as COMMAND_INT.
    """

    command: int
    p: tuple[float, float, float, float, float, float, float] = (0.0,) * 7
    frame: int = 0
    is_int: bool = False


class Autopilot:
    """The state of an autopilot; ``step`` once a turn, orders and set-points in between.

    Attributes:
        kind: copter or rover.
        armed, landed, terminated: as they are.
        mode: what was asked for; ``shown`` is what is in effect.
        home: where it was armed, NED.
        said: what is to go out as STATUSTEXT, with its severity.
        started: it has accepted its first take-off or drive.
    """

    modes: Mapping[str, Mode] = {}
    hold_mode = ""

    def __init__(self, kind: VehicleType, params: Params, limits: Limits, globe: Globe) -> None:
        self.kind: VehicleType = kind
        self.params, self.limits, self.globe = params, limits, globe
        self.mode = self.hold_mode
        self.armed = self.terminated = self.started = self.failsafe = False
        self.landed = True
        self.home: Vec3 | None = None
        self.said: list[tuple[int, str]] = []
        self.cruise_mps = NAN
        self._flown = False
        self._since: float | None = 0.0
        self._armed_s = 0.0
        self._landed_s = 0.0
        self._hold: Vec3 | None = None
        self._hold_yaw = NAN
        self._takeoff_d = NAN
        self._rtl_up: float | None = None
        self._rtl_s: float | None = None
        self._last = ""

    # what it shows

    @property
    def shown(self) -> str:
        """The mode in effect."""
        return self.mode

    @property
    def base_mode(self) -> int:
        """Of the heartbeat."""
        return self.modes[self.shown].flags | (ARMED if self.armed else 0)

    @property
    def custom_mode(self) -> int:
        """Of the heartbeat."""
        return self.modes[self.shown].number

    @property
    def system_status(self) -> int:
        """Of the heartbeat."""
        if self.terminated:
            return TERMINATED
        if self.failsafe:
            return IN_FAILSAFE
        return ACTIVE if self.armed else STANDBY

    @property
    def landed_state(self) -> int:
        """Of EXTENDED_SYS_STATE."""
        if self.landed:
            return ON_GROUND
        does = self.modes[self.shown].does
        return {Does.TAKEOFF: TAKING_OFF, Does.LAND: LANDING, Does.SINK: LANDING}.get(does, IN_AIR)

    def say(self, severity: int, text: str) -> None:
        """Puts a line out for the operator."""
        self.said.append((severity, text))

    # arming

    def arm_reasons(self, sense: Sense) -> list[str]:
        """Why it may not be armed."""
        raise NotImplementedError

    def may_arm(self, sense: Sense) -> bool:
        """Whether it could be armed now; of SYS_STATUS."""
        return not self.arm_reasons(sense)

    def _set_armed(self, sense: Sense) -> None:
        self.armed, self._armed_s, self._flown = True, sense.now_s, False
        self._last = ""
        self.home = sense.ned
        self.globe = replace(self.globe, home_m=self.globe.altitude_m - sense.ned[2])

    def disarm(self, sense: Sense, *, forced: bool, by: str) -> bool:
        """Stops the motors; in the air only when ``forced``."""
        if self.armed and self.kind == "copter" and not self.landed and not forced:
            self.say(CRITICAL, "Disarming denied: not landed")
            return False
        if self.armed:
            self.armed = False
            self.say(INFO, f"Disarmed by {by}")
            self.on_disarmed(sense)
        return True

    def on_disarmed(self, sense: Sense) -> None:
        """Which mode follows."""

    # orders

    def order(self, order: Order, sense: Sense) -> int:
        """Obeys, or not; the MAV_RESULT."""
        raise NotImplementedError

    def set_point(self, target: Target, sense: Sense) -> None:
        """Takes a set-point."""
        raise NotImplementedError

    def set_custom_mode(self, number: int, sense: Sense) -> bool:
        """Asks for the mode of a custom_mode; False where it is refused."""
        names = [name for name, mode in self.modes.items() if mode.number == number]
        return bool(names) and self.set_mode(names[0], sense)

    def set_mode(self, name: str, sense: Sense) -> bool:
        """Asks for a mode; False where it is refused."""
        raise NotImplementedError

    def heard_gcs(self, sysid: int, now_s: float) -> None:
        """A ground station's heartbeat came."""

    # the turn

    def step(self, sense: Sense) -> Wish:
        """Judges the situation and says what the vehicle shall do."""
        self._detect_landing(sense)
        self.failsafes(sense)
        if self.armed and self.kind == "copter" and self.landed:
            self.auto_disarm(sense, sense.now_s - max(self._landed_s, self._armed_s), self._flown)
        if not self.armed or self.terminated:
            self._last = ""
            return OFF
        entered = self._last != self.shown
        self._last = self.shown
        if entered:
            self.entered(sense)
        wish = self.wish(sense)
        if not sense.contact:
            self._flown = True
        return wish

    def _detect_landing(self, sense: Sense) -> None:
        if self.kind == "rover":
            return
        down = sense.contact and (not self.armed or self.terminated or sense.pushing)
        if not sense.contact:
            self._since = None
            if self.landed:
                self.landed = False
                self.say(INFO, "Takeoff detected")
        elif not self.landed:
            self._since = None if not down else sense.now_s if self._since is None else self._since
            if self._since is not None and sense.now_s - self._since >= LANDED_S:
                self.landed, self._landed_s = True, sense.now_s
                self.say(INFO, "Landing detected")

    def failsafes(self, sense: Sense) -> None:
        """Acts on what is wrong."""
        raise NotImplementedError

    def auto_disarm(self, sense: Sense, since_s: float, flown: bool) -> None:
        """Disarms on the ground after a while."""
        raise NotImplementedError

    def entered(self, sense: Sense) -> None:
        """The mode in effect is a new one."""
        self._hold = stopping_point(sense.ned, sense.velocity, self.limits.accel_mps2)
        self._hold_yaw = NAN
        self._rtl_up = self._rtl_s = None

    def hold_at(self, position: Vec3, yaw: float = NAN) -> None:
        """Moves the place where it holds; NaN axes stay."""
        old = self._hold or position
        n, e, d = (new if math.isfinite(new) else o for new, o in zip(position, old, strict=True))
        self._hold, self._hold_yaw = (n, e, d), yaw

    def speeds(self) -> tuple[float, float, float]:
        """Level, up and down speed of its own flights, m/s."""
        raise NotImplementedError

    def land_mps(self, height_m: float) -> float:
        """Speed of descent at a height above home."""
        raise NotImplementedError

    def rtl_height_m(self, distance_m: float) -> float:
        """Height above home at which it returns."""
        raise NotImplementedError

    def rtl_wait_s(self) -> float:
        """How long it waits above home."""
        return 0.0

    def arrival_m(self) -> float:
        """How near a rover drives to a point."""
        raise NotImplementedError

    def follow(self, sense: Sense) -> Wish:
        """Follows the outer set-points."""
        raise NotImplementedError

    def wish(self, sense: Sense) -> Wish:
        """By what the mode in effect does."""
        does = self.modes[self.shown].does
        if self.kind == "rover":
            return self._drive_wish(does, sense)
        level, up, down = self.speeds()
        if does is Does.FOLLOW:
            return self.follow(sense)
        if does is Does.TAKEOFF:
            return self.takeoff_wish(sense)
        if self.landed or does is Does.MANUAL:
            return IDLE if self.landed else Wish(velocity=(0.0, 0.0, 0.0), lift=True)
        if does is Does.SINK or not sense.position_ok:
            return Wish(velocity=(0.0, 0.0, self.land_mps(0.0)), blind=True)
        if does is Does.LAND:
            return self._land_wish(sense)
        if does is Does.RTL:
            return self._rtl_wish(sense)
        return Wish(
            lift=True, position=self._hold or sense.ned, yaw=self._hold_yaw,
            level_mps=level, up_mps=up, down_mps=down,
        )  # fmt: skip

    def takeoff_wish(self, sense: Sense) -> Wish:
        """Climbs to its altitude."""
        level, up, down = self.speeds()
        if self.landed and sense.contact and self._hold is not None:
            self._hold = sense.ned  # on a rover's deck it starts from where that is
        n, e, _ = self._hold or sense.ned
        if sense.ned[2] - self._takeoff_d < THERE_M:
            self.took_off(sense)
        return Wish(
            lift=True, position=(n, e, self._takeoff_d), level_mps=level, up_mps=self.takeoff_mps(up), down_mps=down
        )

    def takeoff_mps(self, up_mps: float) -> float:
        """Speed of the take-off."""
        return up_mps

    def took_off(self, sense: Sense) -> None:
        """The take-off is done."""

    def _land_wish(self, sense: Sense) -> Wish:
        home_d = 0.0 if self.home is None else self.home[2]
        n, e, _ = self._hold or sense.ned
        speed = self.land_mps(home_d - sense.ned[2])
        return Wish(
            position=(n, e, NAN), velocity=(NAN, NAN, speed), level_mps=self.speeds()[0], down_mps=speed, lift=True
        )

    def _rtl_wish(self, sense: Sense) -> Wish:
        level, up, down = self.speeds()
        n, e, d = self.home or sense.ned
        away = math.hypot(n - sense.ned[0], e - sense.ned[1])
        if self._rtl_up is None:
            self._rtl_up = min(sense.ned[2], d - self.rtl_height_m(away))
        if self._rtl_s is None and away > 0.5:
            if sense.ned[2] - self._rtl_up > THERE_M and self._hold is not None:
                n, e, _ = self._hold
            return Wish(lift=True, position=(n, e, self._rtl_up), level_mps=level, up_mps=up, down_mps=down)
        self._rtl_s = sense.now_s if self._rtl_s is None else self._rtl_s
        if sense.now_s - self._rtl_s < self.rtl_wait_s():
            return Wish(lift=True, position=(n, e, self._rtl_up), level_mps=level, up_mps=up, down_mps=down)
        self._hold = (n, e, d)
        return self._land_wish(sense)

    def _drive_wish(self, does: Does, sense: Sense) -> Wish:
        stop = Wish(velocity=(0.0, 0.0, 0.0))
        if does is Does.FOLLOW:
            return self.follow(sense)
        if does is Does.RTL and self.home is not None:
            return self.drive_to(self.home, sense)
        return stop

    def drive_to(self, place: Vec3, sense: Sense, velocity: Vec3 = NOWHERE) -> Wish:
        """A rover's way to a place, where it stops."""
        if math.hypot(place[0] - sense.ned[0], place[1] - sense.ned[1]) <= self.arrival_m():
            return Wish(velocity=(0.0, 0.0, 0.0))
        return Wish(position=(place[0], place[1], NAN), velocity=velocity, level_mps=self.speeds()[0])


def wish_of(point: SetPoint, level_mps: float, up_mps: float, down_mps: float) -> Wish:
    """A copter's wish that follows a set-point."""
    return Wish(
        lift=True, position=point.position, velocity=point.velocity, yaw=point.yaw, yaw_rate=point.yaw_rate,
        level_mps=level_mps, up_mps=up_mps, down_mps=down_mps,
    )  # fmt: skip
