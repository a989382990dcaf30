"""A lab mission through cflib, rclpy and NatNet: planned, checked, flown, recorded and replayed."""

from __future__ import annotations

from pathlib import Path

import pytest
from wire_runs import CONFIGS, is_flown_safely, nothing_left, waiting

from deploy.check_report import Verdict
from deploy.mission import load
from deploy.recording_read import read
from deploy.replay import replay
from deploy.session import run_mission

pytestmark = pytest.mark.wire


def test_the_lab_mission_flies_through_the_real_protocols(tmp_path: Path) -> None:
    mission = load(CONFIGS / "lab.yaml")
    with nothing_left(), waiting() as waited:
        result = run_mission(mission, out=tmp_path / "run", backend="sim", sim="wire")
    assert result.checks.failures == ()
    passed = {row.name for row in result.checks.rows if row.verdict is Verdict.PASS}
    assert {"firmware", "estimator", "pose path", "radio", "mode", "poses rate"} <= passed
    is_flown_safely(result, mission, recharges=2, waited=waited)
    assert read(tmp_path / "run").meta.backend == "wire"
    assert replay(tmp_path / "run").identical
