"""Safety judged from recorded positions and energies; every expected number is worked out by hand."""

from __future__ import annotations

import math

import fabricated_run
import pytest

from deploy.events import Action, Event, EventKind, Severity
from deploy.report_history import Lateness, collect
from deploy.report_safety import judge
from deploy.status import Status, VehicleStatus

RESERVE_J = fabricated_run.RESERVE_J
PLACES = {
    "uav0": ((1000.0, 1000.0, 30.0), "flying", 200_000.0),
    "uav1": ((2000.0, 1000.0, 40.0), "flying", 200_000.0),
    "ugv0": ((3000.0, 1000.0, 0.0), "parked", 3e7),
    "ugv1": ((4000.0, 1000.0, 0.0), "parked", 3e7),
}


def status(t, state="running", **changed):
    rows = []
    for vehicle, usual in PLACES.items():
        position, phase, energy = {**dict(enumerate(usual)), **changed.get(vehicle, {})}.values()
        rows.append(VehicleStatus(vehicle, vehicle[:3], phase, position, 0.0, energy, 0.5, "", None, None))
    return Status(t, t, state, (False,) * 15, 0, None, tuple(rows))


def at(*position, phase=None, energy=None):
    changes = {0: tuple(map(float, position)) if position else None, 1: phase, 2: energy}
    return {k: v for k, v in changes.items() if v is not None}


def judged(*statuses, events=()):
    lateness = Lateness(len(statuses), 0.0, 0.0, 0.0)
    return judge(collect(fabricated_run.meta(), fabricated_run.settings(), statuses, events, (), lateness))


def test_a_good_run_has_no_violation():
    safety = judged(status(1), status(2), status(3))
    assert safety.violations == ()
    assert safety.min_separation_m is None  # 10 m apart in height, downwash reaches 4 m
    assert safety.min_energy_margin_j == 200_000.0 - RESERVE_J


def test_too_close_on_one_level():
    near = status(2, uav1=at(1002.0, 1000.0, 33.0))
    safety = judged(status(1), near, near.__class__(3.0, 3.0, *_rest(near)), status(4))
    assert safety.min_separation_m == 2.0
    (found,) = safety.violations
    assert (found.kind, found.vehicles, found.worst, found.limit) == ("separation", ("uav0", "uav1"), 2.0, 3.0)
    assert found.start_s == pytest.approx(1.0)  # in the interval before as well: it came from there
    assert found.end_s == pytest.approx(4.0)
    assert "2.00 m apart" in found.text


def _rest(s):
    return s.mission_state, s.tasks_visited, s.plan_number, s.predicted_makespan_s, s.vehicles


def test_a_pass_between_two_moments_is_found():
    """uav1 crosses uav0's place from 10 m before to 10 m behind, 1 m beside it, within one interval."""
    a = status(1, uav1=at(990.0, 1001.0, 30.0))
    b = status(2, uav1=at(1010.0, 1001.0, 30.0))
    safety = judged(a, b)
    assert safety.min_separation_m == pytest.approx(1.0)
    assert [v.kind for v in safety.violations] == ["separation"]


def test_above_one_another_counts_only_within_the_downwash():
    assert judged(status(1, uav1=at(1000.0, 1000.0, 34.5))).min_separation_m is None
    assert judged(status(1, uav1=at(1000.0, 1000.0, 33.5))).min_separation_m == 0.0


def test_two_in_the_air_are_needed():
    landed = at(1000.5, 1000.0, 30.0, phase="charging")
    assert judged(status(1, uav1=landed), status(2, uav1=landed)).violations == ()


def test_ugvs_too_close_while_one_drives():
    beside = {"ugv1": at(3001.5, 1000.0, 0.0, phase="driving")}
    (found,) = judged(status(1, **beside), status(2, **beside)).violations
    assert (found.kind, found.worst, found.limit) == ("ugv_separation", pytest.approx(1.5), 2.0)
    parked = {"ugv1": at(3001.5, 1000.0, 0.0)}
    assert judged(status(1, **parked), status(2, **parked)).violations == ()


def test_outside_the_fence_and_above_the_ceiling():
    safety = judged(
        status(1),
        status(2, uav0=at(-203.0, 1000.0, 30.0), ugv0=at(3000.0, -204.0, 0.0)),
        status(3, uav1=at(2000.0, 1000.0, 125.0)),
        status(4),
    )
    found = {(v.kind, v.vehicles[0]): v for v in safety.violations}
    assert set(found) == {("geofence", "uav0"), ("geofence", "ugv0"), ("ceiling", "uav1")}
    assert found["geofence", "uav0"].worst == pytest.approx(3.0)
    assert found["geofence", "ugv0"].worst == pytest.approx(4.0)
    assert (found["ceiling", "uav1"].worst, found["ceiling", "uav1"].limit) == (125.0, 120.0)
    assert (found["geofence", "uav0"].start_s, found["geofence", "uav0"].end_s) == (2.0, 3.0)


def test_on_the_fence_is_inside():
    assert judged(status(1, uav0=at(-200.0, 1000.0, 120.0))).violations == ()


FLOOR_J = 0.08 * fabricated_run.CAPACITY_J  # monitors.energy_margin


def test_the_reserve_may_be_used():
    safety = judged(status(1), status(2, uav1=at(energy=RESERVE_J - 500.0)), status(3))
    assert safety.min_energy_margin_j == -500.0
    assert safety.violations == ()


def test_energy_below_the_floor():
    safety = judged(
        status(1), status(2, uav1=at(energy=FLOOR_J - 500.0)), status(3, uav1=at(energy=FLOOR_J - 900.0)), status(4)
    )
    assert safety.min_energy_margin_j == pytest.approx(FLOOR_J - 900.0 - RESERVE_J)
    assert safety.margin_of["uav0"] == 200_000.0 - RESERVE_J
    (found,) = safety.violations
    assert (found.kind, found.start_s, found.end_s) == ("energy", 2.0, 4.0)
    assert found.worst == pytest.approx(-900.0)


def test_a_low_battery_on_the_ground_is_no_breach_of_its_own():
    low = FLOOR_J - 500.0
    safety = judged(
        status(1),
        status(2, uav1=at(phase="down", energy=low)),
        *(status(t, uav1=at(phase="down", energy=low)) for t in (3, 4)),
    )
    assert safety.min_energy_margin_j == pytest.approx(low - RESERVE_J)
    (found,) = safety.violations  # it was below when it touched down
    assert (found.start_s, found.end_s) == (2.0, 3.0)


def test_energy_of_a_lost_uav_is_nobodys_knowledge():
    gone = at(phase="lost", energy=0.0)
    assert judged(status(1, uav1=gone)).min_energy_margin_j == 200_000.0 - RESERVE_J
    unknown = at(energy=math.nan)
    assert judged(status(1, uav0=unknown, uav1=unknown)).min_energy_margin_j is None


def test_a_crash_and_a_uav_left_in_the_air():
    crash = Event(2.0, EventKind.TUMBLED, Severity.CRITICAL, "uav0", Action.STOP_MOTORS, "uav0 lies upside down")
    safety = judged(status(1), status(3, state="done", uav0=at(phase="down")), events=[crash])
    assert [(v.kind, v.vehicles) for v in safety.violations] == [("crash", ("uav0",)), ("left_airborne", ("uav1",))]
    assert safety.violations[0].start_s == 2.0


def test_nothing_recorded_is_nothing_judged():
    safety = judged()
    assert (safety.min_separation_m, safety.min_energy_margin_j, safety.violations) == (None, None, ())
