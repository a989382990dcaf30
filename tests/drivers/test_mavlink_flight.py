"""The UAV's state machine and its docking, with an autopilot of a few lines and time that passes at once."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import pytest

from drivers.limits import UavLimits
from drivers.mavlink_dock import PadSeen
from drivers.mavlink_flight import LEFT_ALONE, Flight, Phase
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_wants import Seen, Wants
from drivers.vehicle import Arm, Command, Disarm, Dock, GoTo, Hold, Land, TakeOff, Vec3

LIMITS = UavLimits(max_speed_mps=3.0, accel_mps2=2.0, climb_mps=1.5, descent_mps=1.0, altitude_m=30.0)
OPTIONS = MavlinkOptions()
DT = 0.05
PAD = PadSeen((5.0, 0.0, 0.5), (0.0, 0.0), 0.2)


@dataclass
class Rig:
    """A vehicle that does what it is told, one step late, and stands on the floor or on the pad."""

    px4: bool = True
    seen: Seen = field(
        default_factory=lambda: Seen(
            0.0, DT, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, armed=False, on_ground=True, airborne=False, guided=False,
            charging=False, battery=0.5,
        )
    )  # fmt: skip
    pad: PadSeen | None = PAD
    charger: bool = True
    wind: tuple[float, float] = (0.0, 0.0)
    obeys: bool = True
    wants: Wants = field(default_factory=Wants)
    track: list[Vec3] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.flight = Flight(LIMITS, OPTIONS, streams_on_ground=self.px4, lifts_by_command=not self.px4)

    @property
    def at(self) -> Vec3:
        assert self.seen.own_m is not None
        return self.seen.own_m

    def send(self, command: Command) -> None:
        self.flight.command(command, self.seen)

    def ground(self) -> float:
        over = self.pad is not None and math.dist(self.at[:2], self.pad.position_m[:2]) < 0.6
        return self.pad.position_m[2] if over and self.pad is not None and self.at[2] > 0.3 else 0.0

    def turn(self) -> None:
        self.wants = w = self.flight.step(self.seen)
        s = self.seen
        armed, guided = s.armed, s.guided or (w.guided and self.obeys)
        if w.armed is not None and self.obeys and (s.on_ground or w.armed):
            armed = w.armed
        x, y, z = self.at
        ground = self.ground()
        if armed and guided and w.setpoint is not None:
            tx, ty, tz = w.setpoint.position_m
            x, y = tx + self.wind[0], ty + self.wind[1]
            z = max(tz, ground) if s.airborne or tz > ground + 0.1 else ground
        elif armed and w.takeoff_m is not None:
            z = min(z + 1.0 * DT, ground + w.takeoff_m)
        elif armed and s.airborne and w.takeoff_m is None and not self.px4 and self.flight.phase is Phase.LIFT:
            z += 1.0 * DT
        airborne = armed and z > ground + 0.02
        on_pad = not airborne and z > 0.1
        place = (x, y, z)
        self.seen = replace(
            s, now_s=s.now_s + DT, own_m=place, pose_m=None if s.pose_m is None else place, armed=armed, guided=guided,
            airborne=airborne, on_ground=not airborne, pad=self.pad, charging=self.charger and on_pad and not armed,
        )  # fmt: skip
        self.track.append(place)

    def until(self, condition: Callable[[], bool], most_s: float = 60.0) -> None:
        end_s = self.seen.now_s + most_s
        while not condition():
            assert self.seen.now_s < end_s, f"{self.flight.phase}: {self.flight.fault}"
            self.turn()

    def wait(self, duration_s: float) -> None:
        end_s = self.seen.now_s + duration_s
        self.until(lambda: self.seen.now_s >= end_s, duration_s + 1)

    def fly(self, altitude_m: float = 3.0) -> None:
        self.send(Arm("u"))
        self.until(lambda: self.seen.armed)
        self.wait(0.2)
        self.send(TakeOff("u", altitude_m, 1.0))
        self.until(lambda: math.dist(self.at, (self.at[0], self.at[1], altitude_m)) < 0.01)
        self.wait(0.5)

    def over_the_pad(self) -> None:
        self.fly()
        self.send(GoTo("u", (5.0, 0.0, 3.0), 2.0))
        self.until(lambda: math.dist(self.at, (5.0, 0.0, 3.0)) < 0.01)


@pytest.fixture(params=[True, False], ids=["px4", "ardupilot"])
def rig(request: pytest.FixtureRequest) -> Rig:
    return Rig(px4=request.param)


DOCK = Dock("u", "g", 0, 0.5, 4.0)


def test_px4_gets_set_points_before_its_mode_and_arms_last() -> None:
    rig = Rig()
    rig.send(Arm("u"))
    first_s: dict[str, float] = {}
    while not rig.seen.armed:
        rig.turn()
        for name, value in (("stream", rig.wants.setpoint), ("mode", rig.wants.guided), ("arm", rig.wants.armed)):
            if value:
                first_s.setdefault(name, rig.seen.now_s)
    assert first_s["stream"] + 0.5 <= first_s["mode"] < first_s["arm"]


def test_armed_on_the_ground_px4_is_kept_down(rig: Rig) -> None:
    rig.send(Arm("u"))
    rig.until(lambda: rig.seen.armed)
    rig.wait(3.0)
    assert rig.at[2] == 0.0
    if rig.px4:
        assert rig.wants.setpoint is not None
        assert rig.wants.setpoint.position_m[2] < -0.1
    else:
        assert rig.wants.setpoint is None


def test_takes_off_vertically_within_its_speed(rig: Rig) -> None:
    rig.fly(6.0)
    assert all(p[:2] == (0.0, 0.0) for p in rig.track)
    own_part = 0 if rig.px4 else OPTIONS.takeoff_step_m
    high = [p[2] for p in rig.track if p[2] > max(own_part, 0.5)]
    assert all(b - a <= 1.0 * DT + 1e-6 for a, b in itertools.pairwise(high))


def test_nothing_moves_unarmed(rig: Rig) -> None:
    for command in (TakeOff("u", 3.0, 1.0), GoTo("u", (5.0, 0.0, 3.0), 1.0), Land("u", 1.0), Hold("u"), DOCK):
        rig.send(command)
        rig.wait(0.5)
        assert rig.flight.phase is Phase.IDLE
        assert rig.wants == Wants(None, 0.0)


def test_an_arming_without_effect_ends_with_a_fault(rig: Rig) -> None:
    rig.obeys = False
    rig.send(Arm("u"))
    rig.wait(OPTIONS.arm_timeout_s + 1.0)
    assert rig.flight.fault is not None
    assert not rig.wants.guided


def test_a_refused_arming_is_not_tried_for_ever(rig: Rig) -> None:
    rig.obeys = False
    rig.send(Arm("u"))
    rig.wait(1.0)
    rig.flight.refused("arming", "denied")
    rig.turn()
    assert "arming refused" in (rig.flight.fault or "")
    assert rig.wants.armed is None


def test_without_a_position_px4_is_not_armed() -> None:
    rig = Rig()
    rig.seen = replace(rig.seen, own_m=None, pose_m=None)
    rig.send(Arm("u"))
    assert rig.flight.step(rig.seen) == Wants()
    assert "no position" in (rig.flight.fault or "")


def test_a_take_off_that_stays_on_the_ground_ends_with_a_fault(rig: Rig) -> None:
    rig.send(Arm("u"))
    rig.until(lambda: rig.seen.armed)
    rig.wait(0.2)
    rig.send(TakeOff("u", 3.0, 1.0))
    for _ in range(round((OPTIONS.takeoff_timeout_s + 1.0) / DT)):
        rig.wants = rig.flight.step(rig.seen)
        rig.seen = replace(rig.seen, now_s=rig.seen.now_s + DT)
    assert rig.flight.fault == "did not leave the ground"
    assert rig.wants.armed is False


def test_repeated_commands_change_nothing(rig: Rig) -> None:
    rig.fly()
    rig.send(TakeOff("u", 3.0, 1.0))
    rig.turn()
    assert rig.at == pytest.approx((0.0, 0.0, 3.0))
    go = GoTo("u", (10.0, 0.0, 3.0), 2.0)
    once, often = Rig(px4=rig.px4), Rig(px4=rig.px4)
    for r, every in ((once, 10_000), (often, 3)):
        r.fly()
        r.track.clear()
        for k in range(200):
            if k % every == 0:
                r.send(go)
            r.turn()
    assert once.track == often.track


def test_hold_brakes_within_the_stopping_distance_and_is_idempotent(rig: Rig) -> None:
    rig.fly()
    rig.send(GoTo("u", (30.0, 0.0, 3.0), 2.0))
    rig.wait(3.0)
    x = rig.at[0]
    for _ in range(5):
        rig.send(Hold("u"))
        rig.wait(0.5)
    assert 0.0 <= rig.at[0] - x <= 2.0**2 / (2 * LIMITS.accel_mps2) + 0.2
    there = rig.at
    rig.wait(1.0)
    assert rig.at == there
    assert rig.flight.phase is Phase.FLY


def test_lands_with_a_gentle_touch_down_and_disarms(rig: Rig) -> None:
    rig.fly(6.0)
    rig.send(Land("u", 5.0))
    rig.track.clear()
    rig.until(lambda: not rig.seen.armed)
    sinking = [(a[2], (a[2] - b[2]) / DT) for a, b in zip(rig.track, rig.track[1:], strict=False)]
    assert max(v for _, v in sinking) <= LIMITS.descent_mps + 1e-6
    assert max(v for z, v in sinking if z < OPTIONS.touchdown_m - 0.3) <= OPTIONS.touchdown_mps + 1e-6
    rig.turn()
    assert rig.flight.phase is Phase.IDLE
    assert rig.flight.fault is None


def test_a_landing_without_a_land_detector_becomes_the_autopilots_own(rig: Rig) -> None:
    rig.fly()
    rig.send(Land("u", 1.0))
    rig.until(lambda: rig.seen.on_ground)
    for _ in range(round((OPTIONS.land_timeout_s + 3.0) / DT)):
        rig.wants = rig.flight.step(rig.seen)
        rig.seen = replace(rig.seen, now_s=rig.seen.now_s + DT, on_ground=False, airborne=True)
    assert rig.wants.land_mode
    assert rig.wants.setpoint is None


def test_disarming_is_for_the_ground(rig: Rig) -> None:
    rig.fly()
    rig.send(Disarm("u"))
    rig.wait(1.0)
    assert rig.seen.armed
    rig.send(Land("u", 1.0))
    rig.until(lambda: not rig.seen.armed)
    rig.send(Arm("u"))
    rig.until(lambda: rig.seen.armed)
    rig.send(Disarm("u"))
    rig.until(lambda: not rig.seen.armed)
    rig.wait(1.0)
    assert not rig.seen.armed


def test_landing_while_it_takes_off_ends_on_the_ground(rig: Rig) -> None:
    rig.send(Arm("u"))
    rig.until(lambda: rig.seen.armed)
    rig.wait(0.2)
    rig.send(TakeOff("u", 5.0, 1.0))
    rig.turn()
    rig.send(Land("u", 1.0))
    rig.until(lambda: not rig.seen.armed)
    assert max(p[2] for p in rig.track) < 0.5


def test_holding_while_it_takes_off_stays_low(rig: Rig) -> None:
    rig.send(Arm("u"))
    rig.until(lambda: rig.seen.armed)
    rig.wait(0.2)
    rig.send(TakeOff("u", 8.0, 1.0))
    rig.turn()
    rig.send(Hold("u"))
    rig.wait(10.0)
    assert 0.1 < rig.at[2] < 3.0


def test_a_pilot_is_not_fought(rig: Rig) -> None:
    rig.fly()
    rig.seen = replace(rig.seen, guided=False, by_pilot=True)
    rig.obeys = False
    rig.turn()
    assert "pilot" in (rig.flight.fault or "")
    for command in (GoTo("u", (9.0, 0.0, 3.0), 1.0), Hold("u"), Land("u", 1.0), DOCK):
        rig.send(command)
        rig.turn()
        assert not rig.wants.guided
        assert rig.wants.setpoint is None or rig.seen.on_ground


def test_a_mode_that_is_no_landing_is_left_by_the_next_command(rig: Rig) -> None:
    rig.fly()
    rig.seen = replace(rig.seen, guided=False)
    rig.obeys = False
    rig.wait(0.3)
    assert rig.flight.phase is Phase.IDLE
    rig.obeys = True
    rig.send(Hold("u"))
    rig.turn()
    assert rig.wants.guided
    assert rig.wants.setpoint is not None
    assert rig.wants.setpoint.position_m == pytest.approx(rig.at, abs=0.1)


def failed(rig: Rig, lapsed: bool = False) -> None:
    """Its own failsafe takes over, and goes on whatever it is asked for."""
    rig.seen = replace(rig.seen, guided=False, failsafe=True, lapsed=lapsed)
    rig.obeys = False
    rig.turn()


@pytest.mark.parametrize("command", [GoTo("u", (9.0, 0.0, 3.0), 1.0), DOCK, TakeOff("u", 5.0, 1.0), Hold("u")])
def test_no_command_ends_a_failsafes_landing(rig: Rig, command: Command) -> None:
    rig.fly()
    failed(rig)
    assert rig.flight.phase is Phase.IDLE
    for _ in range(5):
        rig.send(command)
        rig.wait(1.0)
        assert rig.wants == Wants(None, rig.seen.yaw_rad)
    assert rig.flight.fault == LEFT_ALONE


def test_a_failsafe_that_begins_while_nothing_is_asked_for_is_left_alone_too(rig: Rig) -> None:
    rig.fly()
    rig.seen = replace(rig.seen, guided=False)
    rig.obeys = False
    rig.turn()
    failed(rig)
    rig.send(GoTo("u", (9.0, 0.0, 3.0), 1.0))
    assert rig.flight.phase is Phase.IDLE
    assert rig.flight.fault == LEFT_ALONE


def test_a_failsafes_return_can_be_made_a_landing_but_nothing_else(rig: Rig) -> None:
    rig.fly()
    failed(rig)
    for command in (Land("u", 1.0), GoTo("u", (9.0, 0.0, 3.0), 1.0), Hold("u"), Land("u", 1.0)):
        rig.send(command)
        rig.turn()
        assert rig.wants.land_mode
        assert rig.wants.setpoint is None
        assert not rig.wants.guided


def test_a_failsafes_landing_is_over_on_the_ground(rig: Rig) -> None:
    rig.fly()
    failed(rig)
    rig.seen = replace(rig.seen, own_m=(0.0, 0.0, 0.0), airborne=False, on_ground=True, armed=False, failsafe=False)
    rig.turn()
    rig.obeys = True
    rig.fly()
    assert rig.flight.fault is None


def test_who_lands_because_we_paused_is_taken_over_again(rig: Rig) -> None:
    rig.fly()
    failed(rig, lapsed=True)
    rig.seen = replace(rig.seen, lapsed=False)
    rig.turn()
    rig.send(GoTo("u", (9.0, 0.0, 3.0), 1.0))
    assert rig.flight.step(rig.seen).guided


def test_its_own_landing_mode_that_we_asked_for_is_no_failsafe(rig: Rig) -> None:
    rig.fly()
    at = rig.at
    rig.seen = replace(rig.seen, own_m=None, pose_m=None)
    rig.send(Land("u", 1.0))
    rig.seen = replace(rig.seen, guided=False, failsafe=True)
    assert rig.flight.step(rig.seen).land_mode
    at = (at[0] + 2.0, at[1], at[2])
    rig.seen = replace(rig.seen, own_m=at)
    rig.send(Land("u", 1.0))
    assert rig.flight.step(rig.seen).land_mode, "a repeated command leaves it alone"
    rig.send(GoTo("u", (9.0, 0.0, 3.0), 1.0))
    wants = rig.flight.step(rig.seen)
    assert wants.guided
    assert wants.setpoint is not None
    assert wants.setpoint.position_m == pytest.approx(at, abs=0.1), "from where it is by now"


def test_a_pilot_ends_a_landing_of_its_own(rig: Rig) -> None:
    rig.fly()
    failed(rig)
    rig.send(Land("u", 1.0))
    rig.turn()
    rig.seen = replace(rig.seen, failsafe=False, by_pilot=True)
    rig.turn()
    assert not rig.wants.land_mode
    rig.send(Land("u", 1.0))
    rig.turn()
    assert not rig.wants.land_mode
    assert "pilot" in (rig.flight.fault or "")


def test_disarmed_in_the_air_is_told(rig: Rig) -> None:
    rig.fly()
    rig.seen = replace(rig.seen, armed=False, airborne=False, on_ground=True)
    rig.turn()
    assert rig.flight.phase is Phase.IDLE
    assert rig.flight.fault == "disarmed by itself"


def test_docks_disarms_and_confirms(rig: Rig) -> None:
    rig.over_the_pad()
    rig.send(DOCK)
    rig.until(lambda: rig.flight.on_pad)
    assert not rig.seen.armed
    assert rig.at == pytest.approx((5.0, 0.0, 0.5), abs=0.02)
    assert rig.flight.fault is None
    rig.send(DOCK)
    rig.wait(1.0)
    assert rig.flight.phase is Phase.IDLE, "docked is docked"
    rig.fly()
    assert not rig.flight.on_pad


def test_docks_with_wind_that_pushes_it_aside(rig: Rig) -> None:
    rig.over_the_pad()
    rig.wind = (0.0, 0.25)
    rig.send(DOCK)
    rig.until(lambda: rig.flight.on_pad)
    assert math.dist(rig.at[:2], PAD.position_m[:2]) <= PAD.tolerance_m


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"pad": None}, "stale"),
        ({"pad": replace(PAD, velocity_mps=(0.5, 0.0))}, "moves"),
        ({"pad": replace(PAD, position_m=(9.0, 0.0, 0.5))}, "aside"),
    ],
)
def test_aborts_upward(rig: Rig, change: dict[str, PadSeen | None], why: str) -> None:
    rig.over_the_pad()
    rig.send(DOCK)
    rig.until(lambda: rig.at[2] < 2.0)
    rig.pad = change["pad"]
    rig.until(lambda: rig.at[2] > 3.99)
    assert why in (rig.flight.fault or "")
    assert rig.flight.fault is not None
    assert rig.flight.fault.startswith("dock missed")
    assert rig.seen.airborne
    rig.wait(2.0)
    assert rig.flight.phase is Phase.FLY
    assert rig.at == pytest.approx((5.0, 0.0, 4.0), abs=0.02)


def test_aborts_when_its_own_pose_is_stale(rig: Rig) -> None:
    rig.over_the_pad()
    rig.send(DOCK)
    rig.until(lambda: rig.at[2] < 2.0)
    rig.seen = replace(rig.seen, pose_m=None)
    rig.until(lambda: rig.at[2] > 3.99)
    assert "own pose" in (rig.flight.fault or "")


def test_misaligned_for_too_long_is_missed(rig: Rig) -> None:
    rig.over_the_pad()
    rig.wind = (0.0, 1.5)
    rig.send(DOCK)
    rig.until(lambda: rig.flight.phase is Phase.ABORT, 12.0)
    assert rig.at[2] > 2.0, "it did not descend misaligned"


def test_a_repeated_dock_still_means_the_missed_attempt(rig: Rig) -> None:
    rig.over_the_pad()
    rig.send(DOCK)
    rig.until(lambda: rig.at[2] < 1.5)
    rig.pad = None
    rig.until(lambda: rig.flight.phase is Phase.ABORT)
    rig.pad = PAD
    rig.send(DOCK)
    assert rig.flight.phase is Phase.ABORT
    rig.until(lambda: rig.flight.phase is Phase.FLY)
    rig.send(DOCK)
    assert rig.flight.phase is Phase.DOCK


def test_a_charger_that_does_not_confirm_makes_it_take_off_again(rig: Rig) -> None:
    rig.over_the_pad()
    rig.charger = False
    rig.send(DOCK)
    rig.until(lambda: rig.flight.phase is Phase.CONFIRM)
    rig.until(lambda: rig.at[2] > 3.99)
    assert "charger" in (rig.flight.fault or "")
    assert rig.seen.airborne


@pytest.mark.parametrize(("charging", "battery"), [(None, 0.5), (False, 1.0)])
def test_a_charger_that_cannot_tell_is_believed(rig: Rig, charging: bool | None, battery: float) -> None:
    rig.over_the_pad()
    rig.charger = False
    rig.send(DOCK)
    rig.until(lambda: rig.flight.phase is Phase.CONFIRM and not rig.seen.armed)
    for _ in range(100):
        rig.turn()
        rig.seen = replace(rig.seen, charging=charging, battery=battery)
    assert rig.flight.on_pad
    assert rig.flight.phase is Phase.IDLE


@pytest.mark.parametrize("command", [Disarm("u"), Land("u", 1.0)])
def test_who_waits_for_the_charger_can_be_told_to_stay(rig: Rig, command: Command) -> None:
    rig.over_the_pad()
    rig.charger = False
    rig.send(DOCK)
    rig.until(lambda: rig.flight.phase is Phase.CONFIRM)
    rig.send(command)
    rig.wait(OPTIONS.charge_confirm_s + 10.0)
    assert not rig.seen.armed
    assert rig.at[2] == pytest.approx(0.5)


def test_after_a_reset_it_wants_nothing(rig: Rig) -> None:
    rig.fly()
    rig.flight.reset()
    rig.seen = replace(rig.seen, armed=False, airborne=False, on_ground=True)
    rig.turn()
    assert rig.wants == Wants(None, 0.0)


def test_a_lost_link_ends_the_stream_for_good(rig: Rig) -> None:
    rig.fly()
    rig.seen = replace(rig.seen, link=False)
    rig.turn()
    assert rig.wants.setpoint is None
    assert "link lost" in (rig.flight.fault or "")
    rig.seen = replace(rig.seen, link=True)
    rig.turn()
    assert rig.wants.setpoint is None
    assert not rig.wants.guided


def test_a_landing_goes_on_without_link_and_without_position(rig: Rig) -> None:
    rig.fly()
    rig.send(Land("u", 1.0))
    rig.turn()
    rig.seen = replace(rig.seen, link=False)
    rig.turn()
    assert rig.wants.land_mode
    other = Rig(px4=rig.px4)
    other.fly()
    other.seen = replace(other.seen, link=False)
    other.turn()
    other.seen = replace(other.seen, own_m=None, pose_m=None)
    other.send(Land("u", 1.0))
    assert other.flight.step(other.seen).land_mode


def test_a_landing_without_position_is_the_autopilots_own_from_the_start(rig: Rig) -> None:
    rig.fly()
    rig.send(GoTo("u", (30.0, 0.0, 3.0), 2.0))
    rig.wait(2.0)
    rig.seen = replace(rig.seen, own_m=None, pose_m=None)
    rig.send(Land("u", 1.0))
    wants = rig.flight.step(rig.seen)
    assert wants.land_mode
    assert wants.setpoint is None


def test_a_landing_that_loses_its_position_becomes_the_autopilots_own(rig: Rig) -> None:
    rig.fly(6.0)
    rig.send(Land("u", 1.0))
    rig.wait(1.0)
    at = rig.at
    steps = []
    for _ in range(30):
        rig.seen = replace(rig.seen, now_s=rig.seen.now_s + DT, own_m=None, pose_m=None)
        steps.append(rig.flight.step(rig.seen).land_mode)
    assert not any(steps[:9]), "a gap of a moment changes nothing"
    assert all(steps[12:])
    rig.seen = replace(rig.seen, own_m=at)
    assert rig.flight.step(rig.seen).land_mode, "it does not go back and forth"
