"""The polynomials of the high-level commander: their extremes, durations that keep limits, brakes and legs."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from drivers.crazyflie_motion import (
    PEAK_ACCELERATION,
    PEAK_SPEED,
    Segment,
    SetPoint,
    Stage,
    brake,
    plan_leg,
    rest_to_rest_s,
)
from drivers.limits import UavLimits

LIMITS = UavLimits(max_speed_mps=1.5, accel_mps2=2.0, climb_mps=0.7, descent_mps=0.5, altitude_m=2.5)
ORIGIN = SetPoint((0.0, 0.0, 1.0))


def fly(stages: tuple[Stage, ...], start: SetPoint) -> list[tuple[float, SetPoint]]:
    """The set-point every 10 ms while the stages are sent at their times."""
    track, segment = [], Segment(start, start.position_m, 0.01, -1.0)
    waiting, t = list(stages), 0.0
    while waiting or t < segment.end_s:
        if waiting and t >= waiting[0].at_s - 1e-9:
            stage = waiting.pop(0)
            segment = Segment(segment.at(t), stage.end_m, stage.duration_s, t, stage.linear)
        track.append((t, segment.at(t)))
        t += 0.01
    return [*track, (t, segment.at(t))]


def test_rest_to_rest_has_the_known_extremes() -> None:
    speed, acceleration = Segment(ORIGIN, (2.0, 0.0, 1.0), 4.0, 0.0).peaks()
    assert speed == pytest.approx(PEAK_SPEED * 2.0 / 4.0, rel=1e-6)
    assert acceleration == pytest.approx(PEAK_ACCELERATION * 2.0 / 16.0, rel=5e-3)


def test_it_begins_and_ends_as_it_must() -> None:
    start = SetPoint((1.0, -2.0, 0.5), (0.3, 0.0, -0.1), (0.2, 0.1, 0.0))
    segment = Segment(start, (2.0, 0.0, 1.0), 3.0, 10.0)
    assert segment.at(9.0) == start
    early, late = segment.at(10.0 + 1e-6), segment.at(13.0 - 1e-6)
    assert early.velocity_mps == pytest.approx(start.velocity_mps, abs=1e-4)
    assert early.acceleration_mps2 == pytest.approx(start.acceleration_mps2, abs=1e-3)
    assert late.position_m == pytest.approx((2.0, 0.0, 1.0))
    assert late.resting
    assert segment.at(99.0) == SetPoint((2.0, 0.0, 1.0))


def test_derivatives_agree_with_differences() -> None:
    segment = Segment(SetPoint((0, 0, 0), (0.5, 0, 0)), (2.0, 1.0, 0.0), 3.0, 0.0)
    h = 1e-5
    for t in (0.4, 1.5, 2.7):
        before, here, after = segment.at(t - h), segment.at(t), segment.at(t + h)
        by_difference = (np.array(after.position_m) - np.array(before.position_m)) / (2 * h)
        assert here.velocity_mps == pytest.approx(by_difference, abs=1e-6)
        by_difference = (np.array(after.velocity_mps) - np.array(before.velocity_mps)) / (2 * h)
        assert here.acceleration_mps2 == pytest.approx(by_difference, abs=1e-5)


@pytest.mark.parametrize(
    ("end", "speed", "why"),
    [
        ((3.0, 0.0, 1.0), 0.5, "commanded speed"),
        ((3.0, 0.0, 1.0), 99.0, "own speed"),
        ((0.2, 0.0, 1.0), 99.0, "acceleration"),
        ((0.0, 0.0, 2.0), 99.0, "climb"),
        ((0.0, 0.0, 0.1), 99.0, "descent"),
        ((2.0, 1.0, 2.0), 1.0, "all at once"),
        ((0.0, 0.0, 1.0), 1.0, "nothing to do"),
    ],
)
def test_durations_keep_every_limit(end: tuple[float, float, float], speed: float, why: str) -> None:
    duration = rest_to_rest_s(ORIGIN.position_m, end, speed, LIMITS)
    segment = Segment(ORIGIN, end, duration, 0.0)
    fastest, hardest = segment.peaks()
    assert fastest <= speed + 1e-9, why
    assert hardest <= LIMITS.accel_mps2 * 1.005, why
    for s in np.linspace(0, duration, 50):
        vx, vy, vz = segment.at(float(s)).velocity_mps
        assert math.hypot(vx, vy) <= LIMITS.max_speed_mps + 1e-9
        assert -LIMITS.descent_mps - 1e-9 <= vz <= LIMITS.climb_mps + 1e-9


@pytest.mark.parametrize("at_s", [0.3, 0.8, 1.5, 2.0, 2.4, 2.9])
def test_braking_stops_ahead_without_going_back(at_s: float) -> None:
    flight = Segment(ORIGIN, (2.0, 0.0, 1.0), 3.0, 0.0)
    before = flight.at(at_s)
    stop = brake(before, at_s, LIMITS.accel_mps2)
    xs = [stop.at(float(t)).position_m[0] for t in np.linspace(at_s, stop.end_s, 60)]
    assert all(b >= a - 1e-3 for a, b in itertools.pairwise(xs))
    assert stop.at(stop.end_s).resting
    assert stop.peaks()[0] <= before.speed_mps + 0.3
    assert stop.peaks()[1] <= 1.2 * max(LIMITS.accel_mps2, math.hypot(*before.acceleration_mps2))


@pytest.mark.parametrize("end", [(3.0, 0.0, 1.0), (2.0, 2.0, 2.0), (0.0, -4.0, 0.5)])
@pytest.mark.parametrize("speed", [0.3, 0.6, 1.5])
def test_a_leg_with_a_cruise_is_straight_smooth_and_within_limits(
    end: tuple[float, float, float], speed: float
) -> None:
    track = fly(plan_leg(ORIGIN.position_m, end, speed, LIMITS, cruise=True), ORIGIN)
    a, b = np.array(ORIGIN.position_m), np.array(end)
    direction = (b - a) / np.linalg.norm(b - a)
    for (_, one), (_, two) in itertools.pairwise(track):
        assert math.dist(one.velocity_mps, two.velocity_mps) <= 0.01 * LIMITS.accel_mps2 * 1.3 + 0.012
        assert one.speed_mps <= speed * 1.03
        offset = np.array(one.position_m) - a
        assert np.linalg.norm(offset - direction * (offset @ direction)) < 1e-6
    assert track[-1][1].position_m == pytest.approx(end, abs=1e-6)


def test_a_cruise_takes_half_the_time_of_one_polynomial() -> None:
    one = plan_leg((0.0, 0.0, 1.0), (4.0, 0.0, 1.0), 0.5, LIMITS, cruise=False)
    three = plan_leg((0.0, 0.0, 1.0), (4.0, 0.0, 1.0), 0.5, LIMITS, cruise=True)
    assert len(one) == 1
    assert len(three) == 3
    assert three[-1].at_s + three[-1].duration_s < 0.55 * one[0].duration_s
    assert three[-1].at_s + three[-1].duration_s < 4.0 / 0.5 + 2 * 0.5 / LIMITS.accel_mps2 + 0.5


@pytest.mark.parametrize("lost", [0, 1, 2])
def test_whatever_packet_of_a_leg_is_lost_it_comes_to_rest_on_the_way(lost: int) -> None:
    stages = plan_leg((0.0, 0.0, 1.0), (4.0, 0.0, 1.0), 1.0, LIMITS, cruise=True)
    heard = tuple(s for i, s in enumerate(stages) if i != lost)
    track = fly(heard, ORIGIN)
    assert track[-1][1].resting
    assert all(-1e-6 <= p.position_m[0] <= 4.0 + 1e-6 for _, p in track)


def test_a_short_leg_is_one_polynomial() -> None:
    assert len(plan_leg((0.0, 0.0, 1.0), (0.3, 0.0, 1.0), 1.5, LIMITS, cruise=True)) == 1
    assert len(plan_leg((0.0, 0.0, 1.0), (0.0, 0.0, 1.0), 1.5, LIMITS, cruise=True)) == 1
