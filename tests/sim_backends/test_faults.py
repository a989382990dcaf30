"""Faults validate themselves; the random draw is plausible and repeatable."""

from __future__ import annotations

from typing import Any

import pytest

from sim_backends.errors import SimulationError
from sim_backends.faults import FOR_ALL, UAV_ONLY, UGV_ONLY, Fault, FaultKind, check_faults, random_faults

UAVS, UGVS = ["uav0", "uav1"], ["ugv0", "ugv1"]


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"kind": "ugv_explodes", "vehicle": "ugv0"}, "ugv_explodes.*choose one of ugv_stall"),
        ({"kind": "ugv_stall"}, "vehicle is missing"),
        ({"kind": "ugv_stall", "vehicle": "ugv0", "value": 1.0}, "takes no value"),
        ({"kind": "ugv_stall", "vehicle": "ugv0", "at_s": -1.0}, "at_s is -1.0"),
        ({"kind": "ugv_stall", "vehicle": "ugv0", "at_s": float("nan")}, "at_s is nan"),
        ({"kind": "ugv_stall", "vehicle": "ugv0", "duration_s": 0.0}, "duration_s is 0.0"),
        ({"kind": "ugv_stall", "vehicle": "ugv0", "other": "ugv1"}, "other is only for pose_swap"),
        ({"kind": "ugv_slow", "vehicle": "ugv0"}, "value is None; give a number above 0, at most 1"),
        ({"kind": "ugv_slow", "vehicle": "ugv0", "value": 1.5}, "above 0, at most 1"),
        ({"kind": "ugv_slow", "vehicle": "ugv0", "value": True}, "value is True"),
        ({"kind": "head_wind", "value": 0.0}, "above 0"),
        ({"kind": "charge_slow", "vehicle": "uav0", "value": -0.1}, "at least 0, at most 1"),
        ({"kind": "pose_jump", "vehicle": "uav0", "value": float("inf")}, "value is inf"),
        ({"kind": "pose_swap", "vehicle": "uav0"}, "other is missing"),
        ({"kind": "pose_swap", "vehicle": "uav0", "other": "uav0"}, "are the same"),
        ({"kind": "dock_missed", "vehicle": "uav0", "value": 1.5}, "whole number"),
        ({"kind": "planner_slow", "vehicle": "uav0", "value": 1.0}, "concerns no vehicle"),
    ],
)
def test_a_wrong_fault_says_what_is_wrong(fields: dict[str, Any], words: str) -> None:
    with pytest.raises(SimulationError, match=words):
        Fault(**fields)


def test_defaults_are_filled_in() -> None:
    assert Fault(FaultKind.DOCK_MISSED, "uav0").value == 1
    assert Fault(FaultKind.VEHICLE_LOST, "uav0").value == 0
    assert Fault("pose_dropout").kind is FaultKind.POSE_DROPOUT  # type: ignore[arg-type]


def test_random_faults_are_valid_repeatable_and_of_every_kind() -> None:
    faults = random_faults(7, 400, 3000.0, UAVS, UGVS)
    assert faults == random_faults(7, 400, 3000.0, UAVS, UGVS)
    assert faults != random_faults(8, 400, 3000.0, UAVS, UGVS)
    assert {f.kind for f in faults} == set(FaultKind)
    assert all(0.0 < f.at_s <= 2700.0 for f in faults)
    assert list(faults) == sorted(faults, key=lambda f: f.at_s)
    check_faults(faults, UAVS, UGVS)


def test_random_faults_fit_a_team_of_one() -> None:
    faults = random_faults(1, 200, 100.0, ["uav0"], [])
    assert not {f.kind for f in faults} & {*UGV_ONLY, FaultKind.POSE_SWAP}
    check_faults(faults, ["uav0"], [])
    assert not UAV_ONLY & {f.kind for f in random_faults(1, 200, 100.0, [], ["ugv0"])}


def test_random_faults_scale() -> None:
    small = random_faults(3, 300, 300.0, UAVS, UGVS, speed_mps=0.5, time_scale=0.1)
    assert all(f.value is None or f.value <= 1.5 for f in small if f.kind is FaultKind.POSE_JUMP)
    assert all((f.duration_s or 0) <= 60.0 for f in small if f.kind is FaultKind.UGV_STALL)


def test_kinds_for_all_need_no_vehicle() -> None:
    for kind in FOR_ALL:
        assert Fault(kind, value=2.0 if kind is FaultKind.HEAD_WIND else None).vehicle is None
