"""One Crazyflie's flight: which high-level command to send when, and what the vehicle is doing by our reckoning. Pure.

The firmware answers a high-level command with an error code (``crtp_commander_high_level.c``) and otherwise just
flies; so each order is repeated until it is acknowledged, and each motion is compared with the poses and repeated when
it does not happen. Motions never overlap: a new one begins where the set-point rests, after a brake where it must.
"""

from __future__ import annotations

import math
from dataclasses import replace

from drivers.crazyflie_bits import Bits
from drivers.crazyflie_dock import Abort, Brake, Descend, Docking, DockView, Move, Touched
from drivers.crazyflie_motion import PEAK_SPEED, Segment, SetPoint, Stage, brake, plan_leg, rest_to_rest_s
from drivers.crazyflie_orders import (
    ArmOrder,
    FlightRules,
    GoToOrder,
    LandOrder,
    Order,
    Phase,
    Seen,
    StopOrder,
    TakeOffOrder,
)
from drivers.vehicle import Arm, Command, Disarm, Dock, GoTo, Hold, Land, TakeOff, Vec3

ARM_EVERY_S = 0.3
DOWN_M = 0.12
"""So near the ground after a landing is landed: an estimate is off by a few cm."""
DOCK_MISSED = "dock missed"
LANDED_S = 3.5
"""So long after ``flying`` ends, the firmware has left its state "landed" by a reset that disarms it: nobody may count
on its motors before. And a request to disarm while ``flying`` is still set counts as a fall and locks it."""
RISEN_M = 0.05
TRIES = 8
SLOW_CLOCK = 0.03
"""A vehicle's clock was seen to run up to 3 % slow."""
BLIND_MPS = 1.0
"""Greatest speed of a landing without poses, whatever the limits say: the height is what the vehicle's own estimate
loses first, by its bias times the time squared, so it had better be down soon. It touches down at half of that."""
BLIND_BELOW_M = 0.5
"""So far below the ground that landing aims: motors that stop where it believes the ground to be would let it fall."""
PATIENCE_S = 1.2
"""The end of a take-off or a leg is not worth a brake: its last second is slow."""


class Flight:
    """The state machine of one vehicle; feed it commands, acknowledgements and what is seen."""

    def __init__(self, rules: FlightRules) -> None:
        self.rules = rules
        self.phase = Phase.GROUND
        self.allowed = False
        """Its own gate: nothing moves until a command has armed it."""
        self.fault: str | None = None
        self.docked = False
        """It came down on a dock by its pose."""
        self.goal: Command | None = None
        self._segment: Segment | None = None
        self._leg: list[Stage] = []
        self._leg_s = 0.0
        self._pending: Vec3 | None = None
        self._speed_mps = 0.0
        self._yaw_rad = 0.0
        self._docking: Docking | None = None
        self._final = False  # the motion under way ends with the motors off
        self._blind = False  # and is a landing without poses
        self._since_s = 0.0
        self._flew_s = -math.inf
        self._disarm = False
        self._low_s: float | None = None  # when it was last seen low while it says that it flies
        self._landed_s = -math.inf
        self._start_z = 0.0
        self._lifting: tuple[float, float] | None = None
        self._ask_s = -math.inf
        self._astray_s: float | None = None
        self._fell_s: float | None = None
        self._orders: list[Order] = []
        self._waiting: tuple[Order, float, int] | None = None
        self._answers = False

    # --- what others ask

    @property
    def up(self) -> bool:
        """Whether it flies, by our reckoning."""
        return self.phase in (Phase.TAKEOFF, Phase.FLY, Phase.LAND, Phase.DOCK)

    def armed(self, bits: Bits | None) -> bool:
        """Whether it may move: our gate and the vehicle's own."""
        return self.allowed and bits is not None and bits.armed and not bits.locked

    def airborne(self, bits: Bits | None) -> bool:
        """By the vehicle's word; ``flying`` lags a landing by 2 s, so that a landing that was seen counts first."""
        if bits is None:
            return self.up
        return bits.flying and self.phase not in (Phase.GROUND, Phase.ARMING, Phase.CONFIRM)

    def may_stop(self, seen: Seen) -> bool:
        """Whether its motors may be switched off: it stands, and does not say that it flies long after our landing."""
        flies = seen.bits is not None and seen.bits.flying and seen.now_s - self._landed_s > LANDED_S
        return not self.airborne(seen.bits) and not flies

    def set_point(self, now_s: float) -> SetPoint | None:
        """Where the set-point is; None on the ground."""
        return None if self._segment is None else self._segment.at(now_s)

    # --- commands

    def command(self, command: Command, seen: Seen) -> None:
        """Takes a command; what is impossible now is ignored."""
        if self.phase is Phase.STOPPED:
            return
        match command:
            case Arm():
                self._arm(command, seen)
            case Disarm() | Land() | Hold() if self.phase is Phase.CONFIRM:
                # it stands on the dock already: whoever wants it down or still must not see it lift off by itself
                self._down(seen)
            case Disarm() if not self.up:
                self._close_gate(seen)
                self.phase = Phase.GROUND
            case TakeOff():
                self._take_off(command, seen)
            case GoTo() if self.up and command != self.goal:
                self._fly(command, command.position_m, command.speed_mps, seen)
            case Hold() if self.up and not (isinstance(self.goal, Hold) and self.phase is Phase.FLY):
                self._hold(command, seen)
            case Land() if self.up and self.phase is not Phase.LAND:
                self._brake(seen)
                self.phase, self.goal, self._speed_mps = Phase.LAND, command, command.speed_mps
            case _:
                pass

    def dock(self, command: Dock, tolerance_m: float, seen: Seen) -> None:
        """Takes a docking command; a repeated one belongs to the attempt under way, its climb included."""
        moving = self.phase is Phase.DOCK or self._leg or self._pending or not self._rests(seen.now_s)
        if not self.up or (command == self.goal and moving):
            return
        self._brake(seen)
        rules = replace(self.rules.dock, tolerance_m=tolerance_m)
        self._docking = Docking(rules, self.rules.limits, command.speed_mps)
        self.phase, self.goal, self.fault = Phase.DOCK, command, None

    def stop(self) -> None:
        """The motors have been told to stop for good."""
        self.phase, self.allowed, self.goal = Phase.STOPPED, False, None
        self._clear()

    def acknowledged(self, order: type[Order], error: int, seen: Seen) -> None:
        """The vehicle answered a high-level command; ``error`` is 0 where it accepted it."""
        self._answers = True
        if self._waiting is None or not isinstance(self._waiting[0], order):
            return
        waiting, _, tries = self._waiting
        self._waiting = None
        refused = error and isinstance(waiting, TakeOffOrder) and tries < TRIES
        if refused and self.phase is Phase.TAKEOFF and not self._has_risen(seen):
            # its planner is not idle: stop it, on the ground only
            self._orders += [StopOrder(), waiting]
            self._waiting = (waiting, seen.now_s, tries + 1)

    # --- time

    def step(self, seen: Seen) -> list[Order]:
        """What to send now."""
        bits = seen.bits
        if bits is not None and bits.flying:
            self._flew_s = seen.now_s
        if bits is not None and self.phase is not Phase.STOPPED:
            if bits.locked or ((bits.tumbled or bits.crashed) and not bits.flying):
                self.phase, self.allowed, self.goal = Phase.GROUND, False, None
                self._clear()
            else:
                self._watch(bits, seen)
        match self.phase:
            case Phase.GROUND:
                self._on_ground(seen)
            case Phase.ARMING:
                self._arming(seen)
            case Phase.TAKEOFF | Phase.FLY:
                self._flying(seen)
            case Phase.LAND:
                self._land_step(seen)
            case Phase.DOCK:
                self._dock_step(seen)
            case Phase.CONFIRM:
                self._confirm(seen)
            case _:
                pass
        self._repeat(seen)
        orders, self._orders = self._orders, []
        return orders

    def _watch(self, bits: Bits, seen: Seen) -> None:
        """Notices a vehicle that flies without our doing, or no longer flies although it should."""
        position = seen.position_m
        if self.phase is Phase.GROUND and bits.flying:
            # the ground station has come back while it hovers: take it over where it is
            high = position is not None and position[2] > seen.ground_m + DOWN_M
            self._low_s = seen.now_s if not high or self._low_s is None else self._low_s
            if position is not None and seen.now_s - max(self._low_s, self._landed_s + LANDED_S) > 0.3:
                self.phase, self.allowed, self.goal, self._yaw_rad = Phase.FLY, True, None, seen.yaw_rad
                self._hover(position, seen.now_s)
            return
        flew = self.phase in (Phase.FLY, Phase.DOCK, Phase.LAND)
        if not flew or bits.flying:
            self._fell_s = None
            return
        self._fell_s = seen.now_s if self._fell_s is None else self._fell_s
        if seen.now_s - self._fell_s > 1.0 and not self._lifting:
            landed = self.phase is Phase.LAND
            self._down(seen)
            self.fault = None if landed else "it stopped flying by itself; look at it before it flies again"

    # --- arming

    def _arm(self, command: Arm, seen: Seen) -> None:
        if self.phase not in (Phase.GROUND, Phase.ARMING) or seen.bits is None:
            return
        if seen.not_ready is not None:
            self.fault = f"not armed: {seen.not_ready}"
            return
        if seen.bits.locked or seen.bits.tumbled or seen.bits.crashed:
            return
        self.fault = None
        if self.phase is Phase.GROUND and not self.armed(seen.bits):
            self.phase, self._since_s, self._ask_s, self._disarm = Phase.ARMING, seen.now_s, -math.inf, False
            self._arming(seen)

    def _arming(self, seen: Seen) -> None:
        if seen.bits is None:
            return
        if seen.now_s - self._flew_s < LANDED_S:
            self._since_s = seen.now_s
        elif seen.bits.armed and seen.bits.can_fly:
            self.phase, self.allowed = Phase.GROUND, True
        elif seen.now_s - self._since_s > self.rules.arm_s:
            self.phase = Phase.GROUND
            self.fault = "not armed: it refuses; look at its console, level it and check its battery"
        else:
            self._ask_to_arm(seen)

    def _ask_to_arm(self, seen: Seen) -> None:
        if seen.bits is not None and not seen.bits.auto_arm and seen.now_s - self._ask_s > ARM_EVERY_S:
            self._ask_s = seen.now_s
            self._orders.append(ArmOrder(True))

    def _on_ground(self, seen: Seen) -> None:
        # a vehicle disarms itself 30 s after arming without a flight: our gate goes with it
        if self.allowed and seen.bits is not None and not seen.bits.armed:
            self.allowed = False
        if self._disarm and seen.bits is not None and seen.now_s - self._flew_s > LANDED_S:
            self._disarm = seen.bits.armed
            if self._disarm and seen.now_s - self._ask_s > ARM_EVERY_S:
                self._ask_s = seen.now_s
                self._orders.append(ArmOrder(False))
        if self.docked and seen.seen and seen.pad_m is not None and seen.position_m is not None:
            self.docked = math.dist(seen.position_m, seen.pad_m) < 0.3

    def _close_gate(self, seen: Seen) -> None:
        self.allowed, self._ask_s = False, -math.inf
        self._disarm = seen.bits is not None and not seen.bits.auto_arm

    # --- motions

    def _take_off(self, command: TakeOff, seen: Seen) -> None:
        if self.up:
            there = self.phase is Phase.FLY and not self._pending and abs(self._end()[2] - command.altitude_m) < 1e-3
            if there or (command == self.goal and self.phase in (Phase.TAKEOFF, Phase.FLY)):
                return
            self._brake(seen)
            x, y, _ = self._end()
            self._fly(command, (x, y, command.altitude_m), command.speed_mps, seen)
            return
        if self.phase is not Phase.GROUND or not self.armed(seen.bits) or seen.position_m is None:
            return
        if command.altitude_m <= seen.position_m[2] + RISEN_M:
            return
        self.goal, self.fault = command, None
        self._lift(command.altitude_m, command.speed_mps, seen)

    def _lift(self, altitude_m: float, speed_mps: float, seen: Seen) -> None:
        """Leaves the ground."""
        assert seen.position_m is not None
        here = seen.position_m
        end = (here[0], here[1], altitude_m)
        duration_s = rest_to_rest_s(here, end, speed_mps, self.rules.limits)
        self.phase, self.docked, self._start_z, self._yaw_rad = Phase.TAKEOFF, False, here[2], seen.yaw_rad
        self._lifting = (altitude_m, speed_mps)
        self._follow(Segment(SetPoint(here), end, duration_s, seen.now_s))
        self._orders.append(StopOrder())  # its planner must be idle, and on the ground this costs nothing
        self._send(TakeOffOrder(altitude_m, duration_s), seen.now_s)

    def _has_risen(self, seen: Seen) -> bool:
        return seen.position_m is None or seen.position_m[2] > self._start_z + RISEN_M

    def _fly(self, command: Command, end_m: Vec3, speed_mps: float, seen: Seen) -> None:
        """A straight flight, as soon as the set-point rests."""
        self._brake(seen, PATIENCE_S)
        self.phase, self.goal, self.fault = Phase.FLY, command, None
        self._pending, self._speed_mps = end_m, speed_mps
        self._next_leg(seen)

    def _hold(self, command: Hold, seen: Seen) -> None:
        self._brake(seen)
        self.phase, self.goal = Phase.FLY, command

    def _brake(self, seen: Seen, patience_s: float = 0.0) -> None:
        """Stops whatever runs; from then on the set-point comes to rest.

        A motion that ends within ``patience_s``, or before a brake would, is left to end.
        """
        sp = self.set_point(seen.now_s)
        self._leg, self._pending, self._docking, self._lifting = [], None, None, None
        if sp is None or (self._over(seen.now_s) and not self._final):
            return
        segment = brake(sp, seen.now_s, self.rules.limits.accel_mps2)
        running = self._segment
        gentle = not (self._final or running is None or running.linear)
        if gentle and running is not None and running.end_s <= max(segment.end_s, seen.now_s + patience_s):
            return
        x, y, z = segment.end_m
        lowest = seen.ground_m + DOWN_M + RISEN_M
        if z < lowest:
            # who is told to hold just above the ground hovers a little higher
            z = lowest
            duration_s = max(segment.duration_s, rest_to_rest_s(sp.position_m, (x, y, z), 1.0, self.rules.limits))
            segment = Segment(sp, (x, y, z), duration_s, seen.now_s)
        self._move(segment, seen.now_s)

    def _rests(self, now_s: float) -> bool:
        sp = self.set_point(now_s)
        return sp is None or sp.resting

    def _over(self, now_s: float) -> bool:
        """Whether the motion under way has ended, in the firmware too, whose clock may run slow."""
        return self._segment is None or now_s >= self._segment.end_s + SLOW_CLOCK * self._segment.duration_s

    def _next_leg(self, seen: Seen) -> None:
        if self._pending is None or not self._over(seen.now_s):
            return
        here = self._here(seen).position_m
        self._leg = list(plan_leg(here, self._pending, self._speed_mps, self.rules.limits, self.rules.cruise))
        self._leg_s, self._pending = seen.now_s, None
        self._next_stage(seen)

    def _next_stage(self, seen: Seen) -> None:
        if self._leg and seen.now_s >= self._leg_s + self._leg[0].at_s:
            stage = self._leg.pop(0)
            self._move(Segment(self._here(seen), stage.end_m, stage.duration_s, seen.now_s, stage.linear), seen.now_s)

    def _here(self, seen: Seen) -> SetPoint:
        sp = self.set_point(seen.now_s)
        if sp is not None:
            return sp
        return SetPoint(seen.position_m or (0.0, 0.0, 0.0))

    def _end(self) -> Vec3:
        assert self._segment is not None
        return self._segment.end_m

    def _follow(self, segment: Segment) -> None:
        self._segment, self._astray_s = segment, None

    def _hover(self, at_m: Vec3, now_s: float) -> None:
        self._follow(Segment(SetPoint(at_m), at_m, 0.01, now_s - 1.0))

    def _clear(self) -> None:
        self._segment, self._leg, self._pending, self._docking, self._lifting = None, [], None, None, None
        self._final = False
        self._waiting, self._astray_s, self._fell_s, self._orders = None, None, None, []

    def _move(self, segment: Segment, now_s: float) -> None:
        self._follow(segment)
        self._final = False
        self._send(GoToOrder(segment.end_m, self._yaw_rad, segment.duration_s, segment.linear), now_s)

    def _send(self, order: Order, now_s: float) -> None:
        self._orders.append(order)
        self._waiting = (order, now_s, 0)

    def _repeat(self, seen: Seen) -> None:
        """Repeats a high-level command that was not answered, where the firmware answers at all."""
        if self._waiting is None or not self._answers:
            return
        order, sent_s, tries = self._waiting
        if seen.now_s - sent_s < self.rules.acknowledge_s or tries >= TRIES:
            return
        self._orders.append(order)
        self._waiting = (order, seen.now_s, tries + 1)
        if self._segment is not None:
            late_s = seen.now_s - sent_s
            self._follow(replace(self._segment, start_s=self._segment.start_s + late_s))
            self._leg_s += late_s

    # --- phases

    def _astray(self, seen: Seen) -> bool:
        """Whether it is not where it should be, for too long: a command was lost."""
        sp = self.set_point(seen.now_s)
        if sp is None or seen.position_m is None or not seen.seen:
            self._astray_s = None
            return False
        off = math.dist(sp.position_m, seen.position_m)
        if off <= self.rules.astray_m * (0.5 if sp.resting else 1.0) + 0.3 * sp.speed_mps:
            self._astray_s = None
            return False
        self._astray_s = seen.now_s if self._astray_s is None else self._astray_s
        return seen.now_s - self._astray_s > self.rules.astray_s

    def _flying(self, seen: Seen) -> None:
        if self._lifting is not None:
            self._lift_off(seen)
            return
        self._next_stage(seen)
        self._next_leg(seen)
        if self._astray(seen):
            self._again(seen)

    def _again(self, seen: Seen) -> None:
        """Flies to where the current motion leads, from where it really is."""
        assert self._segment is not None
        assert seen.position_m is not None
        end = self._leg[-1].end_m if self._leg else self._segment.end_m
        speed = self._speed_mps if self._speed_mps > 0 else self.rules.limits.max_speed_mps
        self._leg = []
        self._hover(seen.position_m, seen.now_s)
        duration_s = rest_to_rest_s(seen.position_m, end, speed, self.rules.limits)
        self._move(Segment(SetPoint(seen.position_m), end, duration_s, seen.now_s), seen.now_s)

    def _lift_off(self, seen: Seen) -> None:
        assert self._segment is not None
        assert self._lifting is not None
        elapsed_s = seen.now_s - self._segment.start_s
        if self._has_risen(seen):
            if elapsed_s >= self._segment.duration_s:
                self._lifting = None
                self.phase = Phase.FLY
        elif elapsed_s > 0.4 * self._segment.duration_s + 1.0:
            if self.armed(seen.bits):
                self._lift(*self._lifting, seen)
            elif isinstance(self.goal, Dock) and elapsed_s < self._segment.duration_s + 5.0:
                self._ask_to_arm(seen)
            else:
                self._down(seen)
                self.fault = "it did not take off: it disarmed itself; arm it again"

    def _land_step(self, seen: Seen) -> None:
        assert isinstance(self.goal, Land)
        assert self._segment is not None
        sp = self._here(seen)
        if not self._final:
            if sp.resting:
                self._come_down(self.goal, sp, seen)
            return
        position = seen.position_m
        if self._blind == seen.seen and seen.now_s < self._segment.end_s:  # poses have gone, or come back
            self._come_down(self.goal, SetPoint(position) if seen.seen and position is not None else sp, seen)
            return
        if seen.now_s > self._segment.end_s + 0.4:
            if position is None or position[2] < self._segment.end_m[2] + DOWN_M:
                self._down(seen)
                return
            if seen.bits is not None and not seen.bits.flying:
                return  # stands higher than expected: ``_watch`` ends it
        if self._astray(seen) and position is not None:
            self._descend(seen.ground_m, self.goal.speed_mps, SetPoint(position), seen.now_s)

    def _come_down(self, command: Land, sp: SetPoint, seen: Seen) -> None:
        """Begins the descent of a landing from ``sp``, by motion capture or without it."""
        self._blind = not seen.seen
        if not self._blind:
            self._descend(seen.ground_m, command.speed_mps, sp, seen.now_s)
            return
        height_m = seen.ground_m - BLIND_BELOW_M
        x, y, z = sp.position_m
        duration_s = max(1.0, PEAK_SPEED * (z - height_m) / BLIND_MPS)
        self._land(Segment(SetPoint(sp.position_m), (x, y, height_m), duration_s, seen.now_s))

    def _descend(self, height_m: float, speed_mps: float, sp: SetPoint, now_s: float, least_s: float = 0.6) -> None:
        end = (sp.position_m[0], sp.position_m[1], height_m)
        duration_s = max(least_s, rest_to_rest_s(sp.position_m, end, speed_mps, self.rules.limits))
        self._land(Segment(SetPoint(sp.position_m), end, duration_s, now_s))

    def _land(self, segment: Segment) -> None:
        self._follow(segment)
        self._final = True
        self._send(LandOrder(segment.end_m[2], segment.duration_s), segment.start_s)

    def _down(self, seen: Seen) -> None:
        """It stands on the ground: motors off, gate closed until it is armed again."""
        self._clear()
        self.phase, self.goal, self._landed_s = Phase.GROUND, None, seen.now_s
        self._orders.append(StopOrder())
        self._close_gate(seen)

    # --- docking

    def _dock_step(self, seen: Seen) -> None:
        assert self._docking is not None
        assert self._segment is not None
        assert isinstance(self.goal, Dock)
        view = DockView(
            seen.now_s,
            seen.position_m if seen.seen else None,
            seen.pad_m,
            seen.pad_speed_mps,
            self._here(seen),
            self._segment,
        )
        docking = self._docking
        match docking.step(view):
            case Move(end, duration_s):
                self._move(Segment(view.set_point, end, duration_s, seen.now_s), seen.now_s)
            case Brake():
                self._brake(seen)
                self._docking = docking
            case Descend(height, duration_s):
                self._descend(height, self.goal.speed_mps, view.set_point, seen.now_s, duration_s)
            case Abort(why):
                self._climb(why, seen)
            case Touched():
                self._clear()
                self.phase, self._since_s, self.docked = Phase.CONFIRM, seen.now_s, True
                self._landed_s = seen.now_s
                self._orders.append(StopOrder())
            case None:
                if not self._final and self._astray(seen):
                    self._again(seen)

    def _climb(self, why: str, seen: Seen) -> None:
        """Out of a missed docking, straight up; the command stays the goal, so that repeats mean this attempt."""
        goal = self.goal
        assert isinstance(goal, Dock)
        sp = self._here(seen)
        self._brake(seen)
        self.phase, self.fault = Phase.FLY, f"{DOCK_MISSED}: {why}"
        at = self._segment.end_m if self._segment is not None else sp.position_m
        self._pending = (at[0], at[1], max(goal.abort_altitude_m, at[2]))
        self._speed_mps = self.rules.limits.climb_mps
        self._next_leg(seen)

    def _confirm(self, seen: Seen) -> None:
        goal = self.goal
        assert isinstance(goal, Dock)
        if seen.charging or (seen.charging is None and seen.now_s - self._since_s > 1.0):
            self.phase, self.goal, self._landed_s = Phase.GROUND, None, seen.now_s
            self._close_gate(seen)
            return
        if seen.now_s - self._since_s < self.rules.charge_confirm_s:
            return
        # no contact: lift off; a vehicle that has disarmed itself meanwhile is armed for that
        self.fault = f"{DOCK_MISSED}: the charger does not answer"
        self.docked = False
        if seen.bits is None or seen.position_m is None:
            return
        if seen.bits.armed and seen.bits.can_fly:
            altitude = max(goal.abort_altitude_m, seen.position_m[2] + 2 * RISEN_M)
            self._lift(altitude, self.rules.limits.climb_mps, seen)
        else:
            self._ask_to_arm(seen)
