"""What each scripted fault does to the shared world's modifiers, and when."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from sim_backends.faults import Fault, FaultKind
from sim_backends.wire.modifiers import FaultTimes
from sim_backends.wire.world import Modifiers
from sim_backends.world import SimUav, SimUgv, WorldConfig

CONFIG = WorldConfig(uavs=(SimUav("u0", "a"), SimUav("u1", "b")), ugvs=(SimUgv("g0", "c"),), seed=5)
CALM = [Modifiers(swap=row) for row in range(3)]


def during(*faults: Fault) -> list[Modifiers]:
    """The modifiers from the beginning of the faults on, times aside."""
    times = FaultTimes(CONFIG, faults)
    return times.modifiers(frozenset(range(len(faults))), frozenset(), CALM)


@pytest.mark.parametrize(
    ("fault", "row", "wanted"),
    [
        (Fault(FaultKind.UGV_STALL, "g0"), 2, {"slow": 0.0}),
        (Fault(FaultKind.UGV_SLOW, "g0", value=0.4), 2, {"slow": 0.4}),
        (Fault(FaultKind.HEAD_WIND, value=2.0), 0, {"wind_mps": 2.0}),
        (Fault(FaultKind.HEAD_WIND, value=2.0), 1, {"wind_mps": 2.0}),
        (Fault(FaultKind.HEAD_WIND, value=2.0), 2, {}),
        (Fault(FaultKind.BATTERY_DRAIN, "u1", value=1.5), 1, {"drain": 1.5}),
        (Fault(FaultKind.CHARGE_SLOW, "u0", value=0.0), 0, {"charge_factor": 0.0}),
        (Fault(FaultKind.POSE_DROPOUT), 2, {"dropout": True}),
        (Fault(FaultKind.POSE_FREEZE, "u0"), 0, {"freeze": True}),
        (Fault(FaultKind.POSE_FREEZE, "u0"), 1, {}),
        (Fault(FaultKind.POSE_SWAP, "u0", other="g0"), 0, {"swap": 2}),
        (Fault(FaultKind.POSE_SWAP, "u0", other="g0"), 2, {"swap": 0}),
        (Fault(FaultKind.TELEMETRY_LOSS), 1, {"silent": True}),
        (Fault(FaultKind.DOCK_MISSED, "u0", value=2), 0, {"dock_miss": 2}),
        (Fault(FaultKind.VEHICLE_LOST, "g0"), 2, {"lost": True}),
        (Fault(FaultKind.VEHICLE_LOST, "u1", value=1), 1, {"motor_fail": True}),
    ],
)
def test_each_fault_has_its_effect(fault: Fault, row: int, wanted: dict[str, object]) -> None:
    assert during(fault)[row] == replace(CALM[row], **wanted)  # type: ignore[arg-type]


def test_a_jump_has_its_length_and_always_the_same_direction() -> None:
    jump = Fault(FaultKind.POSE_JUMP, "u0", at_s=3.0, value=0.7)
    first, again = during(jump)[0], during(jump)[0]
    assert math.hypot(first.jump_x, first.jump_y) == pytest.approx(0.7)
    assert first == again
    assert during(replace(jump, at_s=4.0))[0] != first


def test_two_of_a_kind_add_up() -> None:
    assert during(*2 * [Fault(FaultKind.HEAD_WIND, "u0", value=1.5)])[0].wind_mps == 3.0
    assert during(*2 * [Fault(FaultKind.BATTERY_DRAIN, "g0", value=2.0)])[2].drain == 4.0


def test_faults_hold_from_the_first_motion_for_their_duration() -> None:
    times = FaultTimes(CONFIG, [Fault(FaultKind.UGV_STALL, "g0", at_s=2.0, duration_s=3.0)])
    assert [bool(times.active(t)) for t in (None, 0.0, 1.9, 2.0, 4.9, 5.0)] == [False, False, False, True, True, False]


def test_dockings_that_have_missed_already_do_not_come_back() -> None:
    times = FaultTimes(
        CONFIG, [Fault(FaultKind.DOCK_MISSED, "u0", value=2), Fault(FaultKind.UGV_STALL, "g0", at_s=9.0)]
    )
    counted = [replace(CALM[0], dock_miss=1), *CALM[1:]]
    assert times.modifiers(frozenset({0, 1}), frozenset({0}), counted)[0].dock_miss == 1
    assert times.modifiers(frozenset(), frozenset({0}), counted)[0].dock_miss == 0


def test_motors_that_have_failed_stay_so() -> None:
    times = FaultTimes(CONFIG, [Fault(FaultKind.VEHICLE_LOST, "u0", value=1, duration_s=1.0)])
    failed = [replace(CALM[0], motor_fail=True), *CALM[1:]]
    assert times.modifiers(frozenset(), frozenset({0}), failed)[0].motor_fail


def test_the_planners_delay_is_nobodys_modifier() -> None:
    times = FaultTimes(CONFIG, [Fault(FaultKind.PLANNER_SLOW, at_s=1.0, duration_s=2.0, value=4.0)])
    assert [times.planner_delay_s(t) for t in (None, 0.5, 1.5, 3.5)] == [0.0, 0.0, 4.0, 0.0]
    assert times.active(1.5) == frozenset()
