"""ArduPilot as it behaves towards a ground station: modes, arming, guided and its time-outs, failsafes. No I/O.

After ArduPilot 4.6: ``GCS_MAVLink_Copter.cpp``, ``mode_guided.cpp``, ``events.cpp`` and ``motors.cpp`` of ArduCopter,
``GCS_MAVLink_Rover.cpp``, ``mode_guided.cpp`` and ``failsafe.cpp`` of Rover. There is no pilot with a remote control.
"""

from __future__ import annotations

import math
from dataclasses import replace

from typing_extensions import override

from sim_backends.wire.mavlink_autopilot import (
    ACCEPTED,
    ACTIVE,
    ARM_DISARM,
    CHANGE_SPEED,
    CRITICAL,
    CUSTOM,
    DENIED,
    FAILED,
    FORCE_MAGIC,
    IN_FAILSAFE,
    INFO,
    INT_ONLY,
    LAND,
    LOITER,
    PAUSE,
    REPOSITION,
    RTL,
    SET_HOME,
    SET_MODE,
    STANDBY,
    TAKEOFF,
    TERMINATE,
    UNSUPPORTED,
    WARNING,
    Autopilot,
    Does,
    Order,
    VehicleType,
    whole,
    wish_of,
)  # fmt: skip
from sim_backends.wire.mavlink_guidance import IDLE, Limits, Sense, Wish, stopping_point
from sim_backends.wire.mavlink_modes import COPTER_MODES, ROVER_MODES
from sim_backends.wire.mavlink_params import Params
from sim_backends.wire.mavlink_setpoints import ACCELERATION_BITS, Globe, SetPoint, Target, read_ardupilot

FORCE_ARM_MAGIC = 2989
"""In the second parameter of arming: without checks."""
COPTER_GCS_ACTIONS = {1: "RTL", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 5: "LAND", 6: "RTL", 7: "BRAKE"}
"""FS_GCS_ENABLE of ArduCopter."""
ROVER_ACTIONS = {1: "RTL", 2: "HOLD", 3: "SMART_RTL", 4: "SMART_RTL", 5: ""}
"""FS_ACTION of Rover; 5 disarms."""
BATTERY_ACTIONS = {1: "LAND", 2: "RTL", 3: "SMART_RTL", 4: "SMART_RTL", 7: "BRAKE"}
"""BATT_FS_LOW_ACT and BATT_FS_CRT_ACT of ArduCopter; 5 terminates."""
CAPACITY_MAH = 5200.0
"""Of the simulated battery: the failsafes' thresholds are in mAh."""


def timed_out(point: SetPoint, now_s: float, timeout_s: float) -> bool:
    """Whether the velocity of a set-point no longer counts; its position persists."""
    return math.isfinite(point.velocity[0]) and now_s - point.at_s > max(timeout_s, 0.1)


class ArduPilot(Autopilot):
    """ArduPilot's personality."""

    hold_mode = ""

    def __init__(self, kind: VehicleType, params: Params, limits: Limits, globe: Globe) -> None:
        self.modes = COPTER_MODES if kind == "copter" else ROVER_MODES
        self.hold_mode = "STABILIZE" if kind == "copter" else "MANUAL"
        super().__init__(kind, params, limits, globe)
        self._point: SetPoint | None = None
        self._rising = False
        self._gcs_s: float | None = None
        self._gcs_lost = self._low = self._critical = self._ekf = False
        self._said_timeout = False

    @property
    @override
    def system_status(self) -> int:
        if self.failsafe:
            return IN_FAILSAFE
        if self.kind == "rover":
            return ACTIVE if self.armed else STANDBY
        return STANDBY if self.landed else ACTIVE

    @property
    @override
    def landed_state(self) -> int:
        if self._rising and not self.landed:
            return 3
        return super().landed_state

    @override
    def heard_gcs(self, sysid: int, now_s: float) -> None:
        if sysid == int(self.params["SYSID_MYGCS"]):
            self._gcs_s = now_s

    @override
    def arm_reasons(self, sense: Sense) -> list[str]:
        mode, found = self.modes[self.mode], []
        if not mode.arms:
            found.append(f"{self.mode} mode not armable" if self.kind == "copter" else "Mode not armable")
        if int(self.params["ARMING_CHECK"]) == 0:
            return found
        if mode.position and not sense.position_ok:
            found.append("Need Position Estimate")
        if mode.position and not sense.global_ok:
            found.append("AHRS: waiting for home")
        if sense.tumbled:
            found.append("Leaning")
        if 0.0 < sense.battery * CAPACITY_MAH < self.params["BATT_LOW_MAH"] or sense.battery <= 0.0:
            found.append("Battery 1 low capacity failsafe")
        return found

    def _arm(self, sense: Sense, *, forced: bool) -> bool:
        if self.armed:
            return True
        reasons = [] if forced else self.arm_reasons(sense)
        for reason in reasons:
            self.say(CRITICAL, f"Arm: {reason}")
        if reasons:
            return False
        self.terminated = False
        self._set_armed(sense)
        self.say(INFO, "Arming motors" if self.kind == "copter" else "Throttle armed")
        return True

    @override
    def set_mode(self, name: str, sense: Sense) -> bool:
        mode = self.modes[name]
        need = mode.position and not (sense.position_ok and sense.global_ok)
        if need and (self.armed or self.kind == "copter"):
            # a copter refuses disarmed as well (Copter::set_mode, ignore_checks only for manual modes)
            self.say(WARNING, f"Mode change to {name} failed: requires position")
            return False
        if name == self.mode:
            return True
        self.mode = name
        self._point, self._rising = None, False
        return True

    def _fail_to(self, name: str, sense: Sense) -> None:
        if not self.set_mode(name, sense):
            self.set_mode("LAND" if self.kind == "copter" else "HOLD", sense)

    @override
    def order(self, order: Order, sense: Sense) -> int:
        p = order.p
        match order.command:
            case command if command == ARM_DISARM:
                if whole(p[0]) == 1:
                    return ACCEPTED if self._arm(sense, forced=whole(p[1]) == FORCE_ARM_MAGIC) else FAILED
                if whole(p[0]) == 0:
                    forced = whole(p[1]) == FORCE_MAGIC
                    return ACCEPTED if self.disarm(sense, forced=forced, by="MAVLink") else FAILED
                return UNSUPPORTED
            case command if command == SET_MODE:
                if not whole(p[0]) & CUSTOM:
                    return DENIED
                return ACCEPTED if self.set_custom_mode(whole(p[1]), sense) else FAILED
            case command if command == TAKEOFF:
                return self._take_off(order, sense)
            case command if command in (LAND, RTL, LOITER):
                if command == LAND and self.kind == "rover":
                    return UNSUPPORTED
                name = {LAND: "LAND", RTL: "RTL", LOITER: "LOITER"}[command]
                return ACCEPTED if self.set_mode(name, sense) else FAILED
            case command if command == REPOSITION:
                return self._reposition(order, sense)
            case command if command == CHANGE_SPEED:
                return self._change_speed(p[0], p[1])
            case command if command == TERMINATE:
                if p[0] <= 0.5:
                    return FAILED
                self.disarm(sense, forced=True, by="termination")
                return ACCEPTED
            case command if command == SET_HOME:
                if p[0] > 0.5 and sense.position_ok:
                    self.home = sense.ned
                    return ACCEPTED
                return FAILED
            case command if command == PAUSE and self.mode == "GUIDED" and whole(p[0]) == 0:
                self._point = None
                self._hold = stopping_point(sense.ned, sense.velocity, self.limits.accel_mps2)
                return ACCEPTED
        return UNSUPPORTED

    def _take_off(self, order: Order, sense: Sense) -> int:
        if self.kind == "rover":
            return UNSUPPORTED
        if order.is_int and order.frame not in (3, 6):
            return DENIED
        home_d = sense.ned[2] if self.home is None else self.home[2]
        wanted = home_d - order.p[6]
        # Mode::do_user_takeoff: armed, on the ground, guided, upwards
        if self._rising and self.armed:
            return ACCEPTED if abs(wanted - self._takeoff_d) < 0.01 else FAILED
        if not (self.armed and self.landed and self.mode == "GUIDED") or wanted >= sense.ned[2]:
            return FAILED
        self._enter_now(sense)
        self._takeoff_d, self._rising, self._point = wanted, True, None
        self._hold = sense.ned
        self.started = True
        return ACCEPTED

    def _reposition(self, order: Order, sense: Sense) -> int:
        if not order.is_int:
            return INT_ONLY
        if self.mode != "GUIDED" and not whole(order.p[1]) & 1:
            return DENIED
        lat, lon, alt = order.p[4:]
        placed = self.globe.place(order.frame, lat, lon, alt) if lat or lon else None
        if placed is None:
            return DENIED
        if not self.set_mode("GUIDED", sense):
            return FAILED
        if order.p[0] > 0 and self.kind == "rover":
            self.cruise_mps = order.p[0]
        self._enter_now(sense)
        self._take(SetPoint(position=placed, at_s=sense.now_s), sense)
        return ACCEPTED

    def _change_speed(self, which: float, speed_mps: float) -> int:
        if self.kind == "rover":
            if whole(which) not in (0, 1):
                return DENIED
            self.cruise_mps = speed_mps
            return ACCEPTED
        names = {0: "WPNAV_SPEED", 1: "WPNAV_SPEED", 2: "WPNAV_SPEED_UP", 3: "WPNAV_SPEED_DN"}
        if not speed_mps > 0 or whole(which) not in names:
            return DENIED
        self.params.put(names[whole(which)], 100.0 * speed_mps)
        return ACCEPTED

    def _enter_now(self, sense: Sense) -> None:
        if self._last != self.mode:
            self.entered(sense)
            self._last = self.mode

    @override
    def set_point(self, target: Target, sense: Sense) -> None:
        if self.mode != "GUIDED":
            return
        self._enter_now(sense)
        if self.kind == "rover" and not target.mask & ACCELERATION_BITS:
            self.say(INFO, "Ignoring SET_POSITION_TARGET; set ACC_IGNORE in mask")
            return
        point = read_ardupilot(target, sense, self.globe)
        if point is None:
            self._point = None
            self._hold = stopping_point(sense.ned, sense.velocity, self.limits.accel_mps2)
            return
        self._take(point, sense)

    def _take(self, point: SetPoint, sense: Sense) -> None:
        self._point, self._said_timeout = point, False
        if not self.landed:
            self._rising = False
        if self.armed and self.kind == "rover":
            self.started = True

    @override
    def entered(self, sense: Sense) -> None:
        super().entered(sense)
        self._rising = False

    @override
    def failsafes(self, sense: Sense) -> None:
        self._watch_gcs(sense)
        if not self.armed:
            self._low = self._critical = self._ekf = False
            self.failsafe = self._gcs_lost
            return
        if not sense.position_ok and self.modes[self.mode].position and not self._ekf and not self.landed:
            self._ekf = True
            self.say(CRITICAL, "EKF Failsafe: changed to LAND Mode" if self.kind == "copter" else "EKF failsafe")
            self.set_mode("LAND" if self.kind == "copter" else "HOLD", sense)
        elif sense.position_ok:
            self._ekf = False
        left_mah = sense.battery * CAPACITY_MAH
        for name, seen in (("LOW", self._low), ("CRT", self._critical)):
            if not seen and left_mah < self.params[f"BATT_{name}_MAH"]:
                self._battery_failsafe(name, sense)
        self.failsafe = self._gcs_lost or self._low or self._critical or self._ekf

    def _watch_gcs(self, sense: Sense) -> None:
        if self._gcs_s is None or int(self.params["FS_GCS_ENABLE"]) == 0:
            self._gcs_lost = False
            return
        lost = sense.now_s - self._gcs_s > self.params["FS_GCS_TIMEOUT"]
        if lost == self._gcs_lost:
            return
        self._gcs_lost = lost
        if not lost:
            self.say(WARNING, "GCS Failsafe Cleared")
            return
        self.say(WARNING, "GCS Failsafe")
        if not self.armed:
            return
        if self.kind == "copter":
            if self.landed and self.mode == "STABILIZE":
                self.disarm(sense, forced=True, by="GCS failsafe")
            else:
                self._fail_to(COPTER_GCS_ACTIONS.get(int(self.params["FS_GCS_ENABLE"]), "RTL"), sense)
            return
        action = int(self.params["FS_ACTION"])
        if action == 5:
            self.disarm(sense, forced=True, by="GCS failsafe")
        elif action in ROVER_ACTIONS:
            self._fail_to(ROVER_ACTIONS[action], sense)

    def _battery_failsafe(self, name: str, sense: Sense) -> None:
        if name == "LOW":
            self._low = True
        else:
            self._critical = True
        self.say(CRITICAL, f"Battery 1 is {'low' if name == 'LOW' else 'critical'}")
        action = int(self.params[f"BATT_FS_{name}_ACT"])
        if action == 5:
            self.disarm(sense, forced=True, by="battery failsafe")
        elif action in BATTERY_ACTIONS and not self.landed:
            self._fail_to(BATTERY_ACTIONS[action] if self.kind == "copter" else "HOLD", sense)

    @override
    def auto_disarm(self, sense: Sense, since_s: float, flown: bool) -> None:
        if flown and self.modes[self.mode].does in (Does.LAND, Does.RTL):
            self.disarm(sense, forced=True, by="landing")
        elif 0 < self.params["DISARM_DELAY"] <= since_s and not self._rising:
            self.disarm(sense, forced=True, by="auto disarm")

    @override
    def speeds(self) -> tuple[float, float, float]:
        if self.kind == "rover":
            top = self.params["WP_SPEED"]
            return (self.cruise_mps if math.isfinite(self.cruise_mps) else top, 0.0, 0.0)
        p = self.params
        return (0.01 * p["WPNAV_SPEED"], 0.01 * p["WPNAV_SPEED_UP"], 0.01 * p["WPNAV_SPEED_DN"])

    @override
    def land_mps(self, height_m: float) -> float:
        p = self.params
        if height_m > 0.01 * p["LAND_ALT_LOW"]:
            return 0.01 * (p["LAND_SPEED_HIGH"] or p["WPNAV_SPEED_DN"])
        return 0.01 * p["LAND_SPEED"]

    @override
    def rtl_height_m(self, distance_m: float) -> float:
        return 0.01 * self.params["RTL_ALT"]

    @override
    def rtl_wait_s(self) -> float:
        return 0.001 * self.params["RTL_LOIT_TIME"]

    @override
    def arrival_m(self) -> float:
        return self.params["WP_RADIUS"]

    @override
    def took_off(self, sense: Sense) -> None:
        n, e, _ = self._hold or sense.ned
        self._hold, self._rising = (n, e, self._takeoff_d), False

    @override
    def follow(self, sense: Sense) -> Wish:
        point = self._point
        if self.kind == "rover":
            return self._follow_rover(point, sense)
        level, up, down = self.speeds()
        if self._rising:
            return self.takeoff_wish(sense)
        if self.landed:
            return IDLE  # nothing but a take-off leaves the ground here
        if point is not None and timed_out(point, sense.now_s, self.params["GUID_TIMEOUT"]):
            hold = stopping_point(sense.ned, sense.velocity, self.limits.accel_mps2)
            self._hold = point.position if point.has_position else hold
            self._point = point = None
        if point is None:
            return Wish(lift=True, position=self._hold or sense.ned, level_mps=level, up_mps=up, down_mps=down)
        return wish_of(point, level, up, down)

    def _follow_rover(self, point: SetPoint | None, sense: Sense) -> Wish:
        stop = Wish(velocity=(0.0, 0.0, 0.0))
        if point is None:
            return stop
        if point.has_position:
            return self.drive_to(point.position, sense)
        if timed_out(replace(point, velocity=(0.0, 0.0, 0.0)), sense.now_s, self.params["GUID_TIMEOUT"]):
            if not self._said_timeout:
                self._said_timeout = True
                self.say(WARNING, f"target not received last {self.params['GUID_TIMEOUT']:.1f}secs, stopping")
            return stop
        velocity = point.velocity if math.isfinite(point.velocity[0]) else (0.0, 0.0, 0.0)
        return Wish(velocity=velocity, yaw=point.yaw, yaw_rate=point.yaw_rate, level_mps=self.speeds()[0])
