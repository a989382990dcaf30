"""A field mission through pymavlink: PX4 copters and ArduPilot rovers, by their own positions."""

from __future__ import annotations

from pathlib import Path

import pytest
from wire_runs import is_flown_safely, nothing_left, recharging_field, waiting

from deploy.check_report import Verdict
from deploy.replay import replay
from deploy.session import run_mission

pytestmark = pytest.mark.wire


def test_a_small_field_mission_flies_through_mavlink(tmp_path: Path) -> None:
    mission = recharging_field()
    with nothing_left(), waiting() as waited:
        result = run_mission(mission, out=tmp_path / "run", backend="sim", sim="wire")
    assert result.checks.failures == ()
    passed = {row.name for row in result.checks.rows if row.verdict is Verdict.PASS}
    assert {"batteries", "firmware", "links", "poses"} <= passed
    is_flown_safely(result, mission, recharges=2, waited=waited)
    assert replay(tmp_path / "run").identical
