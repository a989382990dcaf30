"""The Monte Carlo's model against flights in the kinematic world, as ``benchmarks/bench_montecarlo.py`` does it."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_flights_take_the_time_and_energy_that_their_samples_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import bench_montecarlo as bench  # noqa: PLC0415

    path = ROOT / "mission_configs" / "demo.yaml"
    mission = bench.load(path)
    plan = bench.plan_of(mission)
    found = bench.compare(path, plan, runs=5, workers=2)
    sys.stdout.write(f"{found}\n")
    assert found["flown_to_the_end"] >= 4
    # Measured: 1.000 and -3.5 kJ of 287.7 kJ in the median.
    assert found["makespan_flown_to_sampled"][1] == pytest.approx(1.0, abs=0.03)
    for _, median_kj, _ in found["least_energy_flown_less_sampled_kj"]:
        assert -9.0 < median_kj < 3.0
