"""PX4 as it behaves towards a ground station: modes, arming, offboard and its loss, failsafes, time-outs. No I/O.

After PX4 1.16: ``Commander.cpp``, ``failsafe/failsafe.cpp`` and ``framework.cpp``, ``UserModeIntention.cpp``,
``HealthAndArmingChecks``. There is no pilot with a remote control (COM_RC_IN_MODE 4).
"""

from __future__ import annotations

import math
from dataclasses import replace

from typing_extensions import override

from sim_backends.wire.mavlink_autopilot import (
    ACCEPTED,
    ARM_DISARM,
    CHANGE_SPEED,
    CRITICAL,
    CUSTOM,
    DENIED,
    FORCE_MAGIC,
    INFO,
    LAND,
    LOITER,
    REJECTED,
    REPOSITION,
    RTL,
    SET_HOME,
    SET_MODE,
    TAKEOFF,
    TERMINATE,
    UNSUPPORTED,
    WARNING,
    Autopilot,
    Order,
    VehicleType,
    whole,
    wish_of,
)  # fmt: skip
from sim_backends.wire.mavlink_guidance import IDLE, NAN, Limits, Sense, Wish
from sim_backends.wire.mavlink_modes import PX4_MODES, px4_number
from sim_backends.wire.mavlink_params import Params
from sim_backends.wire.mavlink_setpoints import Globe, SetPoint, Target, read_px4

ACTIONS = ("RTL", "RTL", "RTL", "RTL", "LAND", "HOLD", "TERMINATE", "DISARM")
"""COM_OBL_RC_ACT: the pilot's modes 0 to 2 (position, altitude, stabilised) become a return where there is no pilot."""
GCS_ACTIONS = {1: "HOLD", 2: "RTL", 3: "LAND", 5: "TERMINATE", 6: "DISARM"}
"""NAV_DLL_ACT."""
SEVERITY = ("", "HOLD", "RTL", "LAND", "DESCEND", "DISARM", "TERMINATE")


def action_in_effect(action: str, *, since_s: float, delay_s: float, position_ok: bool, global_ok: bool) -> str:
    """What a failsafe does now: first holds for COM_FAIL_ACT_T, and only what the position allows.

    Args:
        action: one of ``SEVERITY``.
        since_s: how long there has been a reason.
        delay_s: COM_FAIL_ACT_T.
        position_ok: the position may be flown by.
        global_ok: and is known on the globe.
    """
    if action in ("DISARM", "TERMINATE", ""):
        return action
    if not position_ok:
        return "DESCEND"
    if action != "HOLD" and since_s < delay_s:
        return "HOLD"
    return "LAND" if action == "RTL" and not global_ok else action


class Px4(Autopilot):
    """PX4's personality."""

    modes = PX4_MODES
    hold_mode = "HOLD"

    def __init__(self, kind: VehicleType, params: Params, limits: Limits, globe: Globe) -> None:
        super().__init__(kind, params, limits, globe)
        self._effect = ""
        self._reason_s: float | None = None
        self._point = SetPoint()
        self._gcs_s: float | None = None
        self._taken_over = False
        self._locked_down = False
        self._driving = False

    @property
    @override
    def shown(self) -> str:
        if self.terminated:
            return "MANUAL"
        return self._effect or self.mode

    def offboard_lost(self, now_s: float) -> bool:
        """No set-point for COM_OF_LOSS_T; a single one starts the stream."""
        return now_s - self._point.at_s > self.params["COM_OF_LOSS_T"]

    @override
    def heard_gcs(self, sysid: int, now_s: float) -> None:
        self._gcs_s = now_s

    @override
    def arm_reasons(self, sense: Sense) -> list[str]:
        mode = self.modes[self.mode]
        found = []
        if self.terminated or self._locked_down:
            found.append("Preflight Fail: Flight termination active")
        if sense.tumbled:
            found.append("Preflight Fail: Attitude failure (roll)")
        if mode.position and not sense.position_ok:
            found.append("Preflight Fail: ekf2 missing data: no valid local position estimate")
        if self.mode == "OFFBOARD" and self.offboard_lost(sense.now_s):
            found.append("Preflight Fail: No offboard signal")
        if sense.battery < self.params["BAT_LOW_THR"]:
            found.append("Preflight Fail: low battery")
        if not mode.arms:
            found.append(f"Preflight Fail: mode {self.mode} cannot be armed in")
        return found

    def _arm(self, sense: Sense) -> bool:
        if self.armed:
            return True
        reasons = self.arm_reasons(sense)
        for reason in reasons:
            self.say(CRITICAL, reason)
        if reasons:
            self.say(CRITICAL, "Arming denied: Resolve system health failures first")
            return False
        self._set_armed(sense)
        self.say(INFO, "Armed by external command")
        return True

    @override
    def on_disarmed(self, sense: Sense) -> None:
        if self.mode in ("LAND", "RTL", "TAKEOFF"):
            self.mode = "HOLD"
        self._effect, self._reason_s, self.failsafe = "", None, False

    @override
    def set_mode(self, name: str, sense: Sense) -> bool:
        mode = self.modes[name]
        if name == "DESCEND" or (self.kind == "rover" and name in ("TAKEOFF", "LAND")):
            return False
        lost = name == "OFFBOARD" and self.offboard_lost(sense.now_s)
        if self.armed and (lost or (mode.position and not sense.position_ok)):
            why = "no offboard signal" if lost else "no valid position estimate"
            self.say(CRITICAL, f"Switching to mode {name} is currently not possible: {why}")
            return False
        if name == "TAKEOFF" and self.mode != "TAKEOFF":
            self._takeoff_d = NAN
        if name == self.mode and self.shown == name:
            return True
        # asking for another mode in a failsafe takes over from it
        self._taken_over = self.failsafe
        self.mode = name
        return True

    @override
    def set_custom_mode(self, number: int, sense: Sense) -> bool:
        if number == px4_number(4, 4):
            self.say(CRITICAL, "Mission rejected: no mission")
            return False
        return super().set_custom_mode(number, sense)

    @override
    def order(self, order: Order, sense: Sense) -> int:
        p = order.p
        match order.command:
            case command if command == ARM_DISARM:
                forced = whole(p[1]) == FORCE_MAGIC
                if whole(p[0]) not in (0, 1):
                    return UNSUPPORTED
                by = "external command"
                done = self._arm(sense) if whole(p[0]) == 1 else self.disarm(sense, forced=forced, by=by)
                return ACCEPTED if done else REJECTED
            case command if command == SET_MODE:
                if not whole(p[0]) & CUSTOM:
                    return REJECTED
                return self._mode_result(self.set_custom_mode(px4_number(whole(p[1]), whole(p[2])), sense))
            case command if command == TAKEOFF:
                return self._take_off(order, sense)
            case command if command == LAND and self.kind == "copter":
                return self._mode_result(self.set_mode("LAND", sense), "Landing at current position")
            case command if command == RTL:
                return self._mode_result(self.set_mode("RTL", sense), "Returning to launch")
            case command if command == LOITER:
                return self._mode_result(self.set_mode("HOLD", sense))
            case command if command == REPOSITION:
                return self._reposition(order, sense)
            case command if command == CHANGE_SPEED:
                self.cruise_mps = p[1] if p[1] > 0 else NAN
                return ACCEPTED
            case command if command == TERMINATE:
                return self._terminate(p[0])
            case command if command == SET_HOME:
                if p[0] > 0.5 and sense.position_ok:
                    self.home = sense.ned
                    return ACCEPTED
                return DENIED
        return UNSUPPORTED

    def _mode_result(self, done: bool, text: str = "") -> int:
        if done and text:
            self.say(INFO, text)
        return ACCEPTED if done else REJECTED

    def _terminate(self, how: float) -> int:
        if how > 1.5:
            self._locked_down = self.terminated = True
        elif how > 0.5:
            self.terminated = True
            self.say(CRITICAL, "Flight termination active")
        elif not self.armed:
            self.terminated = self._locked_down = False
        return ACCEPTED

    def _take_off(self, order: Order, sense: Sense) -> int:
        if self.kind == "rover":
            return UNSUPPORTED
        if not self.set_mode("TAKEOFF", sense):
            self.say(CRITICAL, "Takeoff denied! Please disarm and retry")
            return REJECTED
        home_d = sense.ned[2] if self.landed or self.home is None else self.home[2]
        # the altitude is above mean sea level here, unlike ArduPilot's
        self._takeoff_d = self.globe.altitude_m - order.p[6]
        if not math.isfinite(order.p[6]):
            self._takeoff_d = home_d - self.params["MIS_TAKEOFF_ALT"]
        elif self._takeoff_d > sense.ned[2]:
            self.say(WARNING, "Already higher than takeoff altitude")
            self._takeoff_d = sense.ned[2]
        self.started = True
        return ACCEPTED

    def _reposition(self, order: Order, sense: Sense) -> int:
        if whole(order.p[1]) & 1 and not self.set_mode("HOLD", sense):
            self.say(CRITICAL, "Reposition command rejected")
            return REJECTED
        if self.mode != "HOLD":
            return ACCEPTED
        self._effect = ""
        if self._last != "HOLD":
            self.entered(sense)
            self._last = "HOLD"
        lat, lon, alt = order.p[4:]
        d = NAN
        if math.isfinite(alt):
            base = self.globe.home_m if order.is_int and order.frame in (3, 6) else 0.0
            d = self.globe.altitude_m - (alt + base)
        n = e = NAN
        if math.isfinite(lat) and math.isfinite(lon):
            placed = self.globe.place(0, lat, lon, 0.0)
            if placed is None:
                return DENIED
            n, e = placed[:2]
        if order.p[0] > 0:
            self.cruise_mps = order.p[0]
        self.hold_at((n, e, d), order.p[3])
        self.started = self.started or (self.armed and self.kind == "rover")
        self._driving = self.kind == "rover"
        return ACCEPTED

    @override
    def set_point(self, target: Target, sense: Sense) -> None:
        read = read_px4(target, sense, self.globe)
        if isinstance(read, str):
            if read:
                self.say(CRITICAL, read)
            return
        self._point = read

    @override
    def failsafes(self, sense: Sense) -> None:
        if not self.armed:
            self._effect, self.failsafe, self._reason_s = "", False, None
            return
        action = self._worst(sense)
        if not action:
            if self.failsafe:
                self.say(INFO, "Failsafe cleared")
            self._effect, self.failsafe, self._reason_s, self._taken_over = "", False, None, False
            return
        if self._reason_s is None:
            self._reason_s = sense.now_s
            self.say(CRITICAL, f"Failsafe activated: {action}")
        self.failsafe = True
        if self._taken_over and sense.position_ok and not (self.mode == "OFFBOARD" and self.offboard_lost(sense.now_s)):
            self._effect = ""
            return
        effect = action_in_effect(
            action, since_s=sense.now_s - self._reason_s, delay_s=self.params["COM_FAIL_ACT_T"],
            position_ok=sense.position_ok, global_ok=sense.global_ok,
        )  # fmt: skip
        if effect == "TERMINATE":
            self._terminate(1.0)
        elif effect == "DISARM":
            self.disarm(sense, forced=True, by="failsafe")
        elif not (self.mode == "LAND" and effect in ("HOLD", "RTL", "LAND")):
            self._effect = effect

    def _worst(self, sense: Sense) -> str:
        found = [""]
        mode = self.modes[self.mode]
        if self.mode == "OFFBOARD" and self.offboard_lost(sense.now_s):
            act = int(self.params["COM_OBL_RC_ACT"])
            found.append(ACTIONS[act] if 0 <= act < len(ACTIONS) else "RTL")
        if mode.position and not sense.position_ok and self.kind == "copter":
            found.append("RTL")
        gcs_act = GCS_ACTIONS.get(int(self.params["NAV_DLL_ACT"]))
        gone_s = -math.inf if self._gcs_s is None else sense.now_s - self._gcs_s
        if gcs_act and gone_s > self.params["COM_DL_LOSS_T"] and self.mode != "LAND":
            found.append(gcs_act)
        battery_act = int(self.params["COM_LOW_BAT_ACT"])
        if battery_act in (2, 3) and sense.battery < self.params["BAT_CRIT_THR"]:
            urgent = sense.battery < self.params["BAT_EMERGEN_THR"]
            found.append("LAND" if battery_act == 2 or urgent else "RTL")
        return max(found, key=SEVERITY.index)

    @override
    def auto_disarm(self, sense: Sense, since_s: float, flown: bool) -> None:
        wait_s = self.params["COM_DISARM_LAND" if flown else "COM_DISARM_PRFLT"]
        if wait_s > 0 and since_s >= wait_s:
            self.disarm(sense, forced=True, by="landing" if flown else "auto preflight disarming")

    @override
    def entered(self, sense: Sense) -> None:
        super().entered(sense)
        self._driving = False
        if self.shown == "TAKEOFF" and not math.isfinite(self._takeoff_d):
            self._takeoff_d = sense.ned[2] - self.params["MIS_TAKEOFF_ALT"]

    @override
    def took_off(self, sense: Sense) -> None:
        if self.mode == "TAKEOFF":
            n, e, _ = self._hold or sense.ned
            self.mode = self._last = "HOLD"
            self._hold, self._hold_yaw = (n, e, self._takeoff_d), NAN

    @override
    def speeds(self) -> tuple[float, float, float]:
        if self.kind == "rover":
            top = self.params["RO_SPEED_LIM"]
            return (min(self.cruise_mps, top) if math.isfinite(self.cruise_mps) else top, 0.0, 0.0)
        level = self.cruise_mps if math.isfinite(self.cruise_mps) else self.params["MPC_XY_CRUISE"]
        level = min(level, self.params["MPC_XY_VEL_MAX"])
        return (level, self.params["MPC_Z_VEL_MAX_UP"], self.params["MPC_Z_V_AUTO_DN"])

    @override
    def takeoff_mps(self, up_mps: float) -> float:
        return min(up_mps, self.params["MPC_TKO_SPEED"])

    @override
    def land_mps(self, height_m: float) -> float:
        high, low = self.params["MPC_LAND_ALT1"], self.params["MPC_LAND_ALT2"]
        slow, fast = self.params["MPC_LAND_SPEED"], self.params["MPC_Z_V_AUTO_DN"]
        share = min(max((height_m - low) / max(high - low, 0.1), 0.0), 1.0)
        return slow + share * (fast - slow)

    @override
    def rtl_height_m(self, distance_m: float) -> float:
        # the cone of RTL_CONE_ANG 45 degrees around home
        if distance_m <= self.params["RTL_MIN_DIST"]:
            return self.params["RTL_DESCEND_ALT"]
        return max(self.params["RTL_DESCEND_ALT"], min(distance_m, self.params["RTL_RETURN_ALT"]))

    @override
    def arrival_m(self) -> float:
        return self.params["NAV_ACC_RAD"]

    @override
    def follow(self, sense: Sense) -> Wish:
        point = self._point
        if self.offboard_lost(sense.now_s):
            return Wish(velocity=(0.0, 0.0, 0.0), lift=not self.landed)
        self.started = True
        if self.kind == "rover":
            top = self.params["RO_SPEED_LIM"]
            if point.has_position:
                return replace(self.drive_to(point.position, sense, point.velocity), level_mps=top)
            return Wish(velocity=point.velocity, yaw=point.yaw, yaw_rate=point.yaw_rate, level_mps=top)
        return wish_of(
            point,
            self.params["MPC_XY_VEL_MAX"],
            self.params["MPC_Z_VEL_MAX_UP"],
            self.params["MPC_Z_VEL_MAX_DN"],
        )

    @override
    def wish(self, sense: Sense) -> Wish:
        if self.kind == "rover" and self.shown == "HOLD" and self._driving and self._hold is not None:
            return self.drive_to(self._hold, sense)
        if self.kind == "copter" and self.landed and sense.now_s - self._armed_s < self.params["COM_SPOOLUP_TIME"]:
            return IDLE
        return super().wish(sense)
