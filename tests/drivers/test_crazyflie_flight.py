"""The flight and docking state machine: pure, on its own clock, with an ideal vehicle or one that is deaf at times."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from drivers.crazyflie_bits import Bits
from drivers.crazyflie_dock import Abort, Brake, Descend, Docking, DockRules, DockView, Move
from drivers.crazyflie_flight import Flight
from drivers.crazyflie_motion import Segment, SetPoint
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
from drivers.limits import UavLimits
from drivers.vehicle import Arm, Command, Disarm, Dock, GoTo, Hold, Land, TakeOff, Vec3

LIMITS = UavLimits(max_speed_mps=1.5, accel_mps2=2.0, climb_mps=0.7, descent_mps=0.5, altitude_m=2.5)
DOCK = DockRules(tolerance_m=0.05, range_m=0.5, pad_speed_mps=0.05, align_s=10.0, touch_m=0.08)
RULES = FlightRules(LIMITS, DOCK)
PAD: Vec3 = (1.0, 0.0, 0.3)
STEP_S = 0.02


class Vehicle:
    """Does what the firmware does with orders: polynomials, arming, motors off at the end of a landing."""

    def __init__(self, brushed: bool = True, rules: FlightRules = RULES) -> None:
        self.flight = Flight(rules)
        self.now_s = 0.0
        self.brushed = brushed
        self.armed, self.flying, self.locked = brushed, False, False
        self.position: Vec3 = (0.0, 0.0, 0.0)
        self.segment: Segment | None = None
        self.lands = False
        self.pad: Vec3 | None = None
        self.pad_speed = 0.0
        self.charger: bool | None = None
        self.charges_on_pad = True
        self.answers = True
        self.deaf: Callable[[Order], bool] = lambda _: False
        self.orders: list[Order] = []
        self.refuse_take_off = 0
        self.not_ready: str | None = None
        self.sees = True
        self.drift: Vec3 = (0.0, 0.0, 0.0)
        self.speeds: list[float] = []

    @property
    def ground(self) -> float:
        near = self.pad is not None and math.dist(self.position[:2], self.pad[:2]) < 0.15
        return self.pad[2] if near and self.pad is not None and self.position[2] > 0.2 else 0.0

    def seen(self) -> Seen:
        on_pad = self.pad is not None and not self.flying and math.dist(self.position, self.pad) < 0.06
        charging = None if self.charger is None else self.charger and on_pad and self.charges_on_pad
        bits = Bits(
            can_be_armed=not self.armed, armed=self.armed, auto_arm=self.brushed, can_fly=self.armed,
            flying=self.flying, locked=self.locked,
        )  # fmt: skip
        x, y, z = (p + d for p, d in zip(self.position, self.drift, strict=True))
        return Seen(
            self.now_s, (x, y, z), self.sees, 0.0, bits, charging, self.not_ready, self.ground, self.pad,
            self.pad_speed,
        )  # fmt: skip

    def send(self, command: Command) -> None:
        if isinstance(command, Dock):
            self.flight.dock(command, 0.05, self.seen())
        else:
            self.flight.command(command, self.seen())

    def take(self, order: Order) -> None:
        self.orders.append(order)
        if self.deaf(order):
            return
        error = 0
        match order:
            case ArmOrder(arm):
                self.armed = arm and not self.locked
            case StopOrder():
                self.segment, self.flying, self.lands = None, False, False
            case TakeOffOrder(height, duration):
                if self.refuse_take_off:
                    self.refuse_take_off -= 1
                    error = 1
                elif self.armed and self.segment is None:
                    self.go((*self.position[:2], height), duration, False, SetPoint(self.position))
            case LandOrder(height, duration) if not self.lands:
                self.go((*self.position[:2], height), duration, False, SetPoint(self.position))
                self.lands = True
            case GoToOrder(end, _, duration, linear) if self.armed:
                start = self.segment.at(self.now_s) if self.segment else SetPoint(self.position)
                self.go(end, duration, linear, start)
                self.lands = False
        if self.answers and not isinstance(order, ArmOrder):
            self.flight.acknowledged(type(order), error, self.seen())

    def go(self, end: Vec3, duration: float, linear: bool, start: SetPoint) -> None:
        self.segment = Segment(start, end, duration, self.now_s, linear)
        self.flying = True

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / STEP_S)):
            for order in self.flight.step(self.seen()):
                self.take(order)
            self.now_s += STEP_S
            if self.segment is None:
                continue
            before = self.position
            x, y, z = self.segment.at(self.now_s).position_m
            self.position = (x, y, max(z, self.ground))
            self.speeds.append(math.dist(before, self.position) / STEP_S)
            if self.lands and self.now_s >= self.segment.end_s:
                self.segment, self.flying, self.lands = None, False, False

    def until(self, condition: Callable[[], bool], timeout_s: float = 30.0) -> float:
        begun = self.now_s
        while not condition():
            assert self.now_s - begun < timeout_s, f"not in time; {self.flight.phase}, {self.flight.fault}"
            self.run(STEP_S)
        return self.now_s - begun

    def fly(self, altitude: float = 1.0) -> None:
        self.send(Arm("uav0"))
        self.until(lambda: self.flight.armed(self.seen().bits))
        self.send(TakeOff("uav0", altitude, 0.7))
        self.until(lambda: abs(self.position[2] - altitude) < 0.01)
        self.run(0.5)
        assert self.flight.phase is Phase.FLY

    def sent(self, kind: type[Order]) -> int:
        return sum(isinstance(o, kind) for o in self.orders)


@pytest.fixture(params=["brushed", "brushless"])
def vehicle(request: pytest.FixtureRequest) -> Vehicle:
    return Vehicle(brushed=request.param == "brushed")


# --- arming


@pytest.mark.parametrize(
    "command", [TakeOff("uav0", 1.0, 0.5), GoTo("uav0", (1.0, 0.0, 1.0), 0.5), Land("uav0", 0.5), Hold("uav0")]
)
def test_nothing_is_ordered_before_arming(vehicle: Vehicle, command: Command) -> None:
    vehicle.send(command)
    vehicle.run(2.0)
    assert vehicle.orders == []
    assert not vehicle.flight.armed(vehicle.seen().bits)


def test_brushed_needs_no_request_and_brushless_one(vehicle: Vehicle) -> None:
    vehicle.send(Arm("uav0"))
    vehicle.until(lambda: vehicle.flight.armed(vehicle.seen().bits))
    assert vehicle.sent(ArmOrder) == (0 if vehicle.brushed else 1)
    vehicle.send(Disarm("uav0"))
    vehicle.run(0.1)
    assert not vehicle.flight.armed(vehicle.seen().bits)
    assert vehicle.armed == vehicle.brushed


def test_an_arming_request_is_repeated_and_then_given_up() -> None:
    v = Vehicle(brushed=False)
    v.deaf = lambda o: isinstance(o, ArmOrder)
    v.send(Arm("uav0"))
    v.run(4.0)
    assert v.sent(ArmOrder) > 5
    assert "refuses" in (v.flight.fault or "")
    assert v.flight.phase is Phase.GROUND


def test_not_ready_is_not_armed(vehicle: Vehicle) -> None:
    vehicle.not_ready = "its estimate has not settled"
    vehicle.send(Arm("uav0"))
    vehicle.run(1.0)
    assert not vehicle.flight.armed(vehicle.seen().bits)
    assert "settled" in (vehicle.flight.fault or "")
    vehicle.not_ready = None
    vehicle.send(Arm("uav0"))
    vehicle.run(1.0)
    assert vehicle.flight.armed(vehicle.seen().bits)
    assert vehicle.flight.fault is None


def test_arming_waits_for_a_state_that_has_gone() -> None:
    v = Vehicle(brushed=False)
    v.send(Arm("uav0"))
    v.flight.step(replace(v.seen(), bits=None))
    assert v.flight.phase is Phase.ARMING
    v.run(0.5)
    assert v.flight.armed(v.seen().bits)


def test_a_vehicle_that_disarms_itself_closes_the_gate() -> None:
    v = Vehicle(brushed=False)
    v.send(Arm("uav0"))
    v.run(0.5)
    v.armed = False
    v.run(0.1)
    v.armed = True
    v.run(0.1)
    assert not v.flight.armed(v.seen().bits)


# --- flying


def test_take_off_go_land_and_again(vehicle: Vehicle) -> None:
    for _ in range(2):
        vehicle.fly()
        x = vehicle.position[0]
        vehicle.send(GoTo("uav0", (x + 2.0, 0.0, 1.0), 0.5))
        took = vehicle.until(lambda x=x: math.dist(vehicle.position, (x + 2.0, 0.0, 1.0)) < 0.01)  # type: ignore[misc]
        assert took < 5.5, "about distance over speed"
        assert max(vehicle.speeds) < 0.75
        vehicle.run(1.0)
        vehicle.send(Land("uav0", 0.5))
        vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
        assert vehicle.position[2] == pytest.approx(0.0, abs=0.01)
        assert not vehicle.flight.armed(vehicle.seen().bits), "a landing disarms"
        vehicle.run(1.0)


def test_repeats_change_nothing(vehicle: Vehicle) -> None:
    vehicle.fly()
    n = len(vehicle.orders)
    vehicle.send(TakeOff("uav0", 1.0, 0.7))
    vehicle.run(0.5)
    assert len(vehicle.orders) == n
    for _ in range(30):
        vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
        vehicle.run(0.2)
    assert vehicle.sent(GoToOrder) == 3, "one leg: accelerate, cruise, brake"
    assert vehicle.position == pytest.approx((2.0, 0.0, 1.0))
    vehicle.send(TakeOff("uav0", 1.0, 0.7))
    vehicle.run(0.5)
    assert vehicle.sent(GoToOrder) == 3
    for _ in range(20):
        vehicle.send(Land("uav0", 0.5))
        vehicle.run(0.3)
    assert vehicle.sent(LandOrder) == 1
    assert vehicle.flight.phase is Phase.GROUND


@pytest.mark.parametrize("after_s", [0.1, 0.5, 1.0, 2.0, 3.5])
def test_hold_brakes_within_limits(vehicle: Vehicle, after_s: float) -> None:
    vehicle.fly()
    vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
    vehicle.run(after_s)
    at = vehicle.position[0]
    vehicle.send(Hold("uav0"))
    vehicle.run(2.0)
    stopped = vehicle.position
    assert at - 1e-3 <= stopped[0] < at + 0.4
    n = len(vehicle.orders)
    vehicle.send(Hold("uav0"))
    vehicle.run(1.0)
    assert vehicle.position == stopped
    assert len(vehicle.orders) == n
    vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
    vehicle.until(lambda: math.dist(vehicle.position, (2.0, 0.0, 1.0)) < 0.01)


def test_a_new_target_in_flight_brakes_first(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
    vehicle.run(2.0)
    vehicle.speeds.clear()
    vehicle.send(GoTo("uav0", (0.0, 1.0, 1.0), 0.5))
    vehicle.until(lambda: math.dist(vehicle.position, (0.0, 1.0, 1.0)) < 0.01)
    assert max(vehicle.speeds) < 0.53
    steps = [abs(b - a) / STEP_S for a, b in zip(vehicle.speeds, vehicle.speeds[1:], strict=False)]
    assert max(steps) < 1.25 * LIMITS.accel_mps2


@pytest.mark.parametrize("early_m", [0.01, 0.05, 0.1, 0.3])
def test_a_leg_out_of_a_take_off_is_level(vehicle: Vehicle, early_m: float) -> None:
    vehicle.send(Arm("uav0"))
    vehicle.until(lambda: vehicle.flight.armed(vehicle.seen().bits))
    vehicle.send(TakeOff("uav0", 1.0, 0.7))
    vehicle.until(lambda: vehicle.position[2] > 1.0 - early_m)
    vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.2))
    lowest = 1.0 - early_m - 0.01
    while math.dist(vehicle.position, (2.0, 0.0, 1.0)) > 0.01:
        vehicle.run(0.1)
        assert lowest < vehicle.position[2] < 1.01
        assert vehicle.now_s < 40.0


def test_land_out_of_a_flight_stops_first_and_may_be_taken_back(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
    vehicle.run(2.0)
    vehicle.send(Land("uav0", 0.5))
    vehicle.run(2.5)
    assert vehicle.flight.phase is Phase.LAND
    assert vehicle.position[2] < 0.9
    vehicle.send(Hold("uav0"))
    vehicle.run(2.0)
    height = vehicle.position[2]
    assert height > 0.15
    vehicle.run(2.0)
    assert vehicle.position[2] == pytest.approx(height)
    assert vehicle.flight.phase is Phase.FLY
    vehicle.send(Land("uav0", 0.5))
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)


def test_disarm_in_the_air_is_ignored(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.send(Disarm("uav0"))
    vehicle.run(1.0)
    assert vehicle.flight.armed(vehicle.seen().bits)
    assert vehicle.flying


def test_it_lands_on_what_lies_beneath(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.pad = PAD
    vehicle.send(GoTo("uav0", (1.0, 0.0, 1.0), 0.5))
    vehicle.run(5.0)
    vehicle.send(Land("uav0", 0.5))
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
    assert vehicle.position[2] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("late_s", [0.0, 1.5])
def test_without_poses_it_lands_quickly_and_aims_below_the_ground(vehicle: Vehicle, late_s: float) -> None:
    vehicle.fly()
    began_s = vehicle.now_s
    for sees in (late_s > 0.0, False):
        vehicle.sees = sees
        vehicle.send(Land("uav0", 0.5))
        vehicle.run(late_s)
    took_s = vehicle.until(lambda: vehicle.position[2] <= 0.0)
    order = vehicle.orders[-1]
    assert isinstance(order, LandOrder)
    assert order.height_m < -0.3, "its estimate is off by then: motors off at its zero would let it fall"
    assert took_s < 3.0
    assert vehicle.now_s - began_s < 5.0
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)


def test_a_landing_whose_poses_come_back_ends_on_the_ground(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.sees = False
    vehicle.send(Land("uav0", 0.5))
    vehicle.run(1.0)
    vehicle.sees = True
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
    assert vehicle.position[2] == pytest.approx(0.0, abs=0.01)


# --- lost packets


@pytest.mark.parametrize("answers", [True, False])
@pytest.mark.parametrize("kind", [TakeOffOrder, GoToOrder, LandOrder])
def test_a_lost_order_is_repeated(kind: type[Order], answers: bool) -> None:
    v = Vehicle()
    v.answers = answers
    lose = 2

    def deaf(order: Order) -> bool:
        nonlocal lose
        if isinstance(order, kind) and lose:
            lose -= 1
            return True
        return False

    v.deaf = deaf
    v.fly()
    v.send(GoTo("uav0", (2.0, 0.0, 1.0), 0.5))
    v.until(lambda: math.dist(v.position, (2.0, 0.0, 1.0)) < 0.02, 60.0)
    v.send(Land("uav0", 0.5))
    v.until(lambda: v.flight.phase is Phase.GROUND, 60.0)
    assert v.position[2] < 0.05


def test_a_busy_planner_is_stopped_on_the_ground() -> None:
    v = Vehicle()
    v.refuse_take_off = 1
    v.fly()
    assert v.sent(TakeOffOrder) == 2
    assert v.sent(StopOrder) == 2


def test_the_motors_are_never_stopped_high_up(vehicle: Vehicle) -> None:
    heights: list[float] = []
    take = vehicle.take

    def note(order: Order) -> None:
        if isinstance(order, StopOrder):
            heights.append(vehicle.position[2] - vehicle.ground)
        take(order)

    vehicle.take = note  # type: ignore[method-assign]
    vehicle.deaf = lambda o: isinstance(o, LandOrder)  # it never comes down
    vehicle.fly()
    vehicle.send(Land("uav0", 0.5))
    vehicle.run(20.0)
    assert vehicle.position[2] == pytest.approx(1.0, abs=0.01)
    assert vehicle.sent(LandOrder) > 3
    assert max(heights) < 0.02


def test_blown_astray_it_flies_back(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.drift = (0.5, 0.0, 0.0)
    vehicle.run(1.5)
    n = vehicle.sent(GoToOrder)
    assert n >= 1
    vehicle.drift = (0.0, 0.0, 0.0)
    vehicle.run(3.0)
    assert math.dist(vehicle.position, (0.0, 0.0, 1.0)) < 0.05


# --- what the vehicle does by itself


def test_one_that_hovers_already_is_taken_over() -> None:
    v = Vehicle()
    v.position, v.flying = (0.0, 0.0, 1.0), True
    v.segment = Segment(SetPoint(v.position), v.position, 0.01, -1.0)
    v.run(0.5)
    assert v.flight.phase is Phase.FLY
    v.send(Land("uav0", 0.5))
    v.until(lambda: v.flight.phase is Phase.GROUND)


def test_the_motors_may_be_stopped_only_on_the_ground() -> None:
    v = Vehicle()
    assert v.flight.may_stop(v.seen())
    v.flying = True
    assert not v.flight.may_stop(v.seen()), "it flies without our doing"
    v.flying = False
    v.fly()
    assert not v.flight.may_stop(v.seen())
    v.send(Land("uav0", 0.5))
    v.run(0.5)
    assert not v.flight.may_stop(v.seen())
    v.until(lambda: v.flight.phase is Phase.GROUND)
    v.flying = True  # as the firmware says for two more seconds
    v.run(2.0)
    assert v.flight.may_stop(v.seen())
    v.run(3.0)
    assert not v.flight.may_stop(v.seen()), "that is no echo of the landing any more"


def test_the_motors_may_be_stopped_on_a_dock() -> None:
    v = Vehicle()
    over_the_pad(v)
    v.send(DOCK_COMMAND)
    v.until(lambda: v.flight.phase is Phase.CONFIRM)
    v.flying = True
    assert v.flight.may_stop(v.seen())


def test_no_request_to_disarm_while_it_says_that_it_flies() -> None:
    v = Vehicle(brushed=False)
    v.fly()
    v.send(Land("uav0", 0.5))
    v.until(lambda: v.flight.phase is Phase.GROUND)
    v.flying = True  # as the firmware says for two more seconds
    v.send(Disarm("uav0"))
    v.run(2.0)
    v.flying = False
    v.run(3.0)
    assert ArmOrder(False) not in v.orders
    v.run(1.0)
    assert ArmOrder(False) in v.orders
    assert not v.armed


def test_arming_waits_until_the_firmware_has_got_over_the_landing(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.send(Land("uav0", 0.5))
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
    vehicle.send(Arm("uav0"))
    took = vehicle.until(lambda: vehicle.flight.armed(vehicle.seen().bits))
    assert took > 3.0
    assert vehicle.flight.fault is None


def test_one_that_stops_flying_says_so(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.flying, vehicle.segment, vehicle.position = False, None, (0.0, 0.0, 0.0)
    vehicle.run(2.0)
    assert vehicle.flight.phase is Phase.GROUND
    assert "by itself" in (vehicle.flight.fault or "")


def test_locked_ends_everything(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.locked, vehicle.flying = True, False
    vehicle.run(0.1)
    n = len(vehicle.orders)
    for command in (Arm("uav0"), TakeOff("uav0", 1.0, 0.5), GoTo("uav0", (1.0, 0.0, 1.0), 0.5)):
        vehicle.send(command)
    vehicle.run(2.0)
    assert len(vehicle.orders) == n
    assert not vehicle.flight.armed(vehicle.seen().bits)


def test_stopped_takes_no_command(vehicle: Vehicle) -> None:
    vehicle.fly()
    vehicle.flight.stop()
    n = len(vehicle.orders)
    for command in (Arm("uav0"), TakeOff("uav0", 1.0, 0.5), GoTo("uav0", (1.0, 0.0, 1.0), 0.5), Land("uav0", 0.5)):
        vehicle.send(command)
    vehicle.run(2.0)
    assert len(vehicle.orders) == n


# --- docking


def over_the_pad(v: Vehicle, beside: Vec3 = (0.06, -0.05, 0.0)) -> None:
    v.pad, v.charger = PAD, True
    v.fly()
    v.send(GoTo("uav0", (PAD[0] + beside[0], PAD[1] + beside[1], 1.0), 0.5))
    v.run(5.0)


DOCK_COMMAND = Dock("uav0", "ugv0", 0, 0.3, 1.2)


def test_it_docks_is_charged_and_takes_off_again(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.flight.docked and vehicle.flight.phase is Phase.GROUND)
    assert math.dist(vehicle.position, PAD) < 0.03
    assert vehicle.flight.fault is None
    assert not vehicle.flight.airborne(vehicle.seen().bits)
    assert not vehicle.flight.armed(vehicle.seen().bits)
    vehicle.run(4.0)
    vehicle.fly()
    assert not vehicle.flight.docked


def test_a_repeated_docking_is_the_same_docking(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    for _ in range(60):
        vehicle.send(DOCK_COMMAND)
        vehicle.run(0.3)
    assert vehicle.flight.phase is Phase.GROUND
    assert vehicle.sent(LandOrder) == 1


def climbs_away(v: Vehicle, why: str) -> None:
    v.until(lambda: abs(v.position[2] - 1.2) < 0.01)
    v.run(0.5)
    assert v.flight.phase is Phase.FLY
    assert (v.flight.fault or "").startswith("dock missed")
    assert why in (v.flight.fault or "")
    assert v.flying


def test_without_contact_it_lifts_off(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    vehicle.charges_on_pad = False
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.flight.phase is Phase.CONFIRM)
    vehicle.armed = vehicle.brushed  # a brushless one has disarmed itself by then
    climbs_away(vehicle, "charger")


@pytest.mark.parametrize("late_s", [0.0, 2.0, 3.5])
@pytest.mark.parametrize("command", [Disarm("uav0"), Land("uav0", 0.5), Hold("uav0")])
def test_whoever_waits_for_the_charger_stays_down_when_told_to(
    vehicle: Vehicle, command: Command, late_s: float
) -> None:
    late = late_s > RULES.charge_confirm_s
    if late:
        vehicle = Vehicle(brushed=False)  # a brushed one has lifted off by then
    over_the_pad(vehicle)
    vehicle.charges_on_pad = False
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.flight.phase is Phase.CONFIRM)
    if late:  # it has disarmed itself and hears no request to arm, so it waits on
        vehicle.armed = False
        vehicle.deaf = lambda o: o == ArmOrder(True)
    vehicle.run(late_s)
    n = vehicle.sent(TakeOffOrder)
    docked = vehicle.flight.docked
    vehicle.send(command)
    vehicle.deaf = lambda _: False
    vehicle.run(20.0)
    assert vehicle.flight.phase is Phase.GROUND
    assert vehicle.flight.docked == docked == (not late)
    assert vehicle.sent(TakeOffOrder) == n
    assert math.dist(vehicle.position, PAD) < 0.05
    assert not vehicle.flight.armed(vehicle.seen().bits)
    vehicle.fly()  # the supervisor's own answer to a charge that is not confirmed


def test_without_charger_telemetry_the_pose_counts(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    vehicle.charger = None
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
    assert vehicle.flight.docked


@pytest.mark.parametrize("when", ["before", "descending"])
@pytest.mark.parametrize("what", ["far", "moving", "no pad", "no pose"])
def test_it_aborts_upward(vehicle: Vehicle, when: str, what: str) -> None:
    over_the_pad(vehicle)
    if when == "descending":
        vehicle.send(DOCK_COMMAND)
        vehicle.until(lambda: vehicle.position[2] < 0.6)
    match what:
        case "far":
            vehicle.pad = (PAD[0] + 0.8, PAD[1], PAD[2])
        case "moving":
            vehicle.pad_speed = 0.2
        case "no pad":
            vehicle.pad = None
        case _:
            vehicle.sees = False
    vehicle.send(DOCK_COMMAND)
    climbs_away(vehicle, {"far": "away", "moving": "moves"}.get(what, "stale"))
    assert vehicle.sent(LandOrder) == 0


def test_it_follows_a_pad_that_is_pushed_a_little(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.position[2] < 0.7)
    vehicle.pad = (PAD[0] + 0.05, PAD[1] + 0.03, PAD[2])
    vehicle.until(lambda: vehicle.flight.phase is Phase.GROUND)
    assert vehicle.flight.docked
    assert math.dist(vehicle.position, vehicle.pad) < 0.03


def test_an_offset_of_its_estimate_does_not_count(vehicle: Vehicle) -> None:
    over_the_pad(vehicle)
    vehicle.drift = (0.08, -0.04, 0.0)
    vehicle.send(DOCK_COMMAND)
    vehicle.until(lambda: vehicle.flight.phase in (Phase.CONFIRM, Phase.GROUND))
    seen = vehicle.seen().position_m
    assert seen is not None
    assert math.dist(seen[:2], PAD[:2]) < 0.03


def test_other_commands_supersede_a_docking(vehicle: Vehicle) -> None:
    for command in (Hold("uav0"), GoTo("uav0", (0.0, 0.0, 1.0), 0.5)):
        v = Vehicle(brushed=vehicle.brushed)
        over_the_pad(v)
        v.send(DOCK_COMMAND)
        v.until(lambda v=v: v.position[2] < 0.7)  # type: ignore[misc]
        v.send(command)
        v.run(8.0)
        assert v.flight.phase is Phase.FLY
        assert v.flying
        assert v.position[2] > 0.35


def docking(stage: str = "align") -> Docking:
    made = Docking(DOCK, LIMITS, 0.3)
    made.stage = stage  # type: ignore[assignment]
    return made


def view(position: Vec3 | None, **changes: object) -> DockView:
    at = position or (1.0, 0.0, 1.0)
    base = DockView(100.0, position, PAD, 0.0, SetPoint(at), Segment(SetPoint(at), at, 1.0, 90.0))
    return replace(base, **changes)


@pytest.mark.parametrize(
    ("stage", "position", "decision"),
    [
        ("align", (1.0, 0.0, 1.0), Move),
        ("align", (1.3, 0.0, 1.0), Move),
        ("align", (1.6, 0.0, 1.0), Abort),
        ("align", None, Abort),
        ("align", (1.0, 0.0, 0.2), Abort),
        ("descend", (1.3, 0.0, 0.6), Brake),
        ("descend", (1.0, 0.0, 0.38), type(None)),
        ("settle", (1.0, 0.0, 0.38), Descend),
        ("settle", (1.045, 0.0, 0.38), Move),
    ],
)
def test_decisions(stage: str, position: Vec3 | None, decision: type[object]) -> None:
    d = docking(stage)
    d.step(view(position))
    assert isinstance(docking(stage).step(view(position)), decision)


def test_blocked_for_too_long_aborts() -> None:
    d = docking()
    off = (1.4, 0.0, 0.4)
    assert not isinstance(d.step(view(off)), Abort)
    assert not isinstance(d.step(view(off, now_s=109.0)), Abort)
    assert isinstance(d.step(view(off, now_s=111.0)), Abort)
