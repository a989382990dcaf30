"""A lab mission through cflib, rclpy and NatNet: planned, checked, flown, recorded and replayed."""

from __future__ import annotations

from pathlib import Path

import pytest
from wire_runs import nothing_left, small

from deploy.check_report import Verdict
from deploy.recording_read import read
from deploy.replay import replay
from deploy.session import run_mission

pytestmark = pytest.mark.wire


def test_a_small_lab_mission_flies_through_the_real_protocols(tmp_path: Path) -> None:
    mission = small(4)
    with nothing_left():
        result = run_mission(mission, out=tmp_path / "run", backend="sim", sim="wire")
    assert result.checks.failures == ()
    passed = {row.name for row in result.checks.rows if row.verdict is Verdict.PASS}
    assert {"firmware", "estimator", "pose path", "radio", "mode", "poses rate"} <= passed
    assert result.kind == "done"
    assert result.outcome is not None
    assert all(result.outcome.state.visited)
    truth = result.truth
    assert truth is not None
    assert truth.violations == ()
    assert truth.min_uav_distance_m > mission.settings.separation.horizontal_m
    assert not any(v.airborne or v.tumbled or v.locked for v in truth.vehicles.values())
    assert read(tmp_path / "run").meta.backend == "wire"
    assert result.report is not None
    loop = result.report.loop
    assert loop.late_share < 0.01, f"{loop.late_turns} of {loop.turns} turns were late"
    assert replay(tmp_path / "run").identical
