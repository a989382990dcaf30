"""The simulated Limo's chassis: what becomes of a Twist, how it moves, what it measures."""

from __future__ import annotations

import math

import pytest

from drivers.limo_status import charge
from sim_backends.wire.limo_base import Frame, LimoBase, Mode, Motion, battery_v, frame_of

START = Motion(0.0, 0.0, 0.0)


def drive(base: LimoBase, frame: Frame, for_s: float, start_s: float = 0.0, **step: float) -> list[Motion]:
    track, dt_s = [], 0.01
    for k in range(round(for_s / dt_s)):
        now_s = start_s + k * dt_s
        if k % 5 == 0:
            base.command(now_s, frame)
        track.append(base.step(now_s, dt_s, **step))  # type: ignore[arg-type]
    return track


@pytest.mark.parametrize(
    ("mode", "twist", "frame"),
    [
        ("differential", (0.5, 0.1, 0.3), Frame(0.5, 0.0, 0.3)),  # nothing sideways
        ("mecanum", (0.5, 0.1, 0.3), Frame(0.5, 0.1, 0.3)),
        ("ackermann", (0.5, 0.1, 0.5), Frame(0.5, 0.0, 0.0, 1.0)),
        ("ackermann", (0.5, 0.0, -5.0), Frame(0.5, 0.0, 0.0, -2.5)),  # no tighter than its radius
        ("ackermann", (-0.5, 0.0, 0.5), Frame(-0.5, 0.0, 0.0, -1.0)),
        ("ackermann", (0.5, 0.0, 0.0), Frame(0.5)),
        ("ackermann", (0.0, 0.0, 0.2), Frame(0.0, 0.0, 0.0, 2.5)),  # on the spot: full lock, no motion
        ("ackermann", (0.0, 0.0, 0.0), None),  # 0 / 0: no number
        ("ackermann", (0.0004, 0.0, 0.0), Frame()),  # the driver's way of saying stop
        ("differential", (0.0, 0.0, 0.0), Frame()),
        ("differential", (math.nan, 0.0, 0.0), None),
        ("differential", (0.1239, 0.0, -0.0009), Frame(0.123, 0.0, 0.0)),  # whole mm/s
    ],
)
def test_what_becomes_of_a_twist(mode: Mode, twist: tuple[float, float, float], frame: Frame | None) -> None:
    assert frame_of(mode, *twist) == frame


def test_accelerates_drives_and_brakes_as_configured() -> None:
    base = LimoBase("differential", START, accel_mps2=0.5)
    track = drive(base, Frame(0.4), 2.0)
    assert track[39].vx_mps == pytest.approx(0.2, abs=0.01)
    assert track[-1].vx_mps == pytest.approx(0.4)
    before = track[-1].x_m
    drive(base, Frame(), 2.0, 2.0)
    assert base.motion.x_m - before == pytest.approx(0.4**2 / (2 * 0.5), abs=0.01)


def test_no_faster_than_its_motors() -> None:
    assert drive(LimoBase("differential", START), Frame(5.0), 3.0)[-1].vx_mps == pytest.approx(1.0)
    slow = LimoBase("mecanum", START, max_speed_mps=0.5)
    last = drive(slow, Frame(3.0, 4.0), 3.0)[-1]
    assert math.hypot(last.vx_mps, last.vy_mps) == pytest.approx(0.5)


def test_ackermann_turns_on_its_circle() -> None:
    track = drive(LimoBase("ackermann", START), Frame(0.3, curvature=2.5), 20.0)
    late = track[1000:]
    assert max(m.x_m for m in late) - min(m.x_m for m in late) == pytest.approx(0.8, abs=0.01)


def test_the_last_command_stays_in_force_until_the_firmware_stops() -> None:
    base = LimoBase("differential", START)
    drive(base, Frame(0.4), 1.0)
    for k in range(45):
        base.step(0.95 + 0.01 * k, 0.01)
    assert base.forward_mps == pytest.approx(0.4)
    for k in range(100):
        base.step(1.46 + 0.01 * k, 0.01)
    assert base.forward_mps == 0.0
    for_ever = LimoBase("differential", START, command_timeout_s=math.inf)
    for_ever.command(0.0, Frame(0.4))
    for k in range(1000):
        for_ever.step(0.01 * k, 0.01)
    assert for_ever.forward_mps == pytest.approx(0.4)


@pytest.mark.parametrize(("step", "left_m"), [({"slow": 0.0}, 0.0), ({"dead": True}, 0.0), ({"slow": 0.5}, 0.36)])
def test_faults(step: dict[str, float], left_m: float) -> None:
    track = drive(LimoBase("differential", START), Frame(0.4), 2.0, **step)
    assert track[-1].x_m == pytest.approx(left_m, abs=0.03)


def test_slips_while_it_drives_and_only_then() -> None:
    base = LimoBase("differential", START, slip_m=0.02, seed=3)
    drive(base, Frame(0.4), 20.0)
    assert 0.005 < abs(base.motion.y_m) < 0.5
    drive(base, Frame(), 2.0, 20.0)
    at = base.motion
    drive(base, Frame(), 2.0, 22.0)
    assert base.motion == at


def test_odometry_drifts_away_from_the_truth() -> None:
    base = LimoBase("differential", START, seed=1)
    drive(base, Frame(0.4), 30.0)
    off = math.dist((base.odometry.x_m, base.odometry.y_m), (base.motion.x_m, base.motion.y_m))
    assert 0.02 < off < 3.0


def test_voltage_is_that_of_its_battery_in_steps() -> None:
    assert battery_v(1.0, 0.0) == 12.6
    assert battery_v(0.0, 0.0) == pytest.approx(8.25, abs=0.06)
    for k in range(21):
        volts = battery_v(k / 20, 0.0)
        assert round(volts, 1) == volts
        assert charge(volts) == pytest.approx(k / 20, abs=0.06), "what the driver makes of it"
    assert battery_v(0.5, 1.0) < battery_v(0.5, 0.0)
