"""Who counts as under way, for the guardian."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
import world as w

from deploy.guard import under_way, wills_of
from deploy.state import Order, UavPhase, UgvPhase
from drivers.last_will import LastWill
from drivers.vehicle import StopMotors

SETTINGS = w.settings()


def told(uavs: dict[str, object] | None = None, ugv: dict[str, object] | None = None, **report: object) -> set[str]:
    """Who of ``uav0`` and ``ugv0`` is under way, with these members of their states."""
    first = w.state(SETTINGS)
    state = replace(
        first,
        uavs=(w.uav(0, **(uavs or {})), *first.uavs[1:]),  # type: ignore[arg-type]
        ugvs=(w.ugv(0, **(ugv or {})), *first.ugvs[1:]),  # type: ignore[arg-type]
    )
    return set(under_way(SETTINGS, state, (w.report("uav0", **report),)))


def test_nobody_at_the_start() -> None:
    assert told() == set()


@pytest.mark.parametrize(
    ("phase", "there"),
    [
        (UavPhase.ON_PAD, False),
        (UavPhase.TAKING_OFF, True),
        (UavPhase.FLYING, True),
        (UavPhase.WAITING, True),
        (UavPhase.DOCKING, True),
        (UavPhase.CHARGING, False),
        (UavPhase.LANDING, True),
        (UavPhase.DOWN, False),
        (UavPhase.LOST, False),
    ],
)
def test_uavs_by_what_they_were_told(phase: UavPhase, there: bool) -> None:
    assert told({"phase": phase}) == ({"uav0"} if there else set())


def test_a_uav_given_up_counts_while_it_says_that_it_flies() -> None:
    lost = {"phase": UavPhase.LOST}
    assert told(lost, airborne=True) == {"uav0"}
    assert told(lost, airborne=True, link=False) == set()
    assert told(lost, airborne=True, locked=True) == set()


def test_a_uav_whose_motors_were_stopped_is_left_alone() -> None:
    order = Order(StopMotors("uav0"), 0.0, 0.0)
    assert told({"phase": UavPhase.FLYING, "order": order}, airborne=True) == set()


@pytest.mark.parametrize("phase", list(UgvPhase))
def test_ugvs_that_drive_or_brake(phase: UgvPhase) -> None:
    assert told(ugv={"phase": phase}) == ({"ugv0"} if phase in (UgvPhase.DRIVING, UgvPhase.HOLDING) else set())


@pytest.mark.parametrize(("z_m", "height_m"), [(1.5, 1.5), (-0.2, 0.0), (1e9, SETTINGS.geofence.ceiling_m)])
def test_heights_are_those_of_the_poses_within_reason(z_m: float, height_m: float) -> None:
    first = w.state(SETTINGS)
    uav = w.uav(0, (0.0, 0.0, z_m), phase=UavPhase.FLYING)
    assert under_way(SETTINGS, replace(first, uavs=(uav, *first.uavs[1:])), ()) == {"uav0": height_m}


def test_without_any_pose_it_may_be_as_high_as_the_ceiling() -> None:
    first = w.state(SETTINGS)
    uav = replace(w.uav(0, phase=UavPhase.FLYING), track=None)
    found = under_way(SETTINGS, replace(first, uavs=(uav, *first.uavs[1:])), ())
    assert found == {"uav0": SETTINGS.geofence.ceiling_m}


def test_who_dies_with_the_program_has_no_will() -> None:
    class Body:
        def last_will(self) -> None:
            return None

    class Real:
        def last_will(self) -> LastWill:
            return LastWill("a", "drivers.limo_will")

    assert wills_of({"a": Real(), "b": Body()}) == (LastWill("a", "drivers.limo_will"),)  # type: ignore[dict-item]


def test_it_costs_next_to_nothing() -> None:
    state = w.state(SETTINGS)
    reports = tuple(w.report(f"uav{i}", airborne=True) for i in range(4))
    begun_s, turns = time.perf_counter(), 2000
    for _ in range(turns):
        under_way(SETTINGS, state, reports)
    each_s = (time.perf_counter() - begun_s) / turns
    print(f"{1e6 * each_s:.1f} us")
    assert each_s < 1e-4
