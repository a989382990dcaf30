"""The dispatcher, the presets and the compilation helper."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from planner import jit, kernel
from planner.errors import PlannerError
from planner.policy import jit as policy_jit
from planner.policy import tokens_kernel
from planner.presets import DEPOT, PRESETS, preset, random_roads
from planner.solve import METHODS, Params, Stop, solve, warm_up


def test_unknown_method() -> None:
    with pytest.raises(PlannerError, match="method 'magic' does not exist; there are copcs, search, milp, gls, ts, sa"):
        solve(preset("T15-P5"), Stop(iterations=1), 0, Params("magic"))


# the policy takes half a minute to compile
@pytest.mark.parametrize("method", [pytest.param(m, marks=pytest.mark.slow if m == "copcs" else ()) for m in METHODS])
def test_every_method_fills_in_its_name(method: str) -> None:
    result = solve(preset("T15-P5"), Stop(iterations=1), 0, Params(method))
    assert result.plan.method == method
    assert result.plan.planning_s is not None


@pytest.mark.parametrize("seed", [-1, 1.0, "1", True, 1 << 64])
def test_wrong_seed(seed: object) -> None:
    with pytest.raises(PlannerError, match="seed is"):
        solve(preset("T15-P5"), Stop(iterations=1), seed)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", [0, 1, (1 << 64) - 1])
def test_any_seed_works(seed: int) -> None:
    assert solve(preset("T15-P5"), Stop(iterations=500), seed).plan.feasible


def test_stop_needs_a_limit() -> None:
    for values in ({}, {"time_s": 0.0}, {"iterations": -1}):
        with pytest.raises(PlannerError, match="stop:"):
            Stop(**values)


@pytest.mark.parametrize("name", PRESETS)
def test_presets(name: str) -> None:
    problem = preset(name, (4, 2), 3, uav={"waiting": "hover"}, ugv={"docks": 1})
    assert (problem.n_tasks, len(problem.path_points)) == PRESETS[name]
    assert problem.depot == DEPOT
    assert np.isfinite(problem.road_distance_m).all()
    away = np.linalg.norm(problem.tasks[:, None] - problem.sites[None], axis=2).min(axis=1)
    assert away.max() <= 6_500.0
    assert problem.uavs[3].waiting == "hover" and problem.ugvs[1].docks == 1
    assert preset(name, (4, 2), 3, uav={"waiting": "hover"}, ugv={"docks": 1}).digest == problem.digest
    assert preset(name, (4, 2), 4).digest != preset(name, (4, 2), 3).digest
    flying = problem.uavs[0]
    assert flying.capacity_j / flying.cruise_w * flying.speed_mps == pytest.approx(14_490, abs=10)


def test_presets_on_given_roads() -> None:
    class Given:
        sites, distance_m = random_roads(5, np.random.default_rng(1))

    one, two = preset("T15-P5", seed=1, roads=Given), preset("T15-P5", seed=2, roads=Given)  # type: ignore[arg-type]
    np.testing.assert_array_equal(one.road_distance_m, two.road_distance_m)
    assert (one.tasks != two.tasks).any()
    with pytest.raises(PlannerError, match="T45-P10 has 10 path points, the roads have 5"):
        preset("T45-P10", roads=Given)  # type: ignore[arg-type]
    with pytest.raises(PlannerError, match="preset 'T99' does not exist; there are T15-P5, T45-P10"):
        preset("T99")


def test_roads_are_shortest_paths() -> None:
    sites, road = random_roads(8, np.random.default_rng(2))
    straight = np.linalg.norm(sites[:, None] - sites[None], axis=2)
    assert (road >= straight - 1e-9).all() and (road == road.T).all()
    for k in range(9):
        assert (road <= road[:, k, None] + road[None, k, :] + 1e-6).all()


@pytest.mark.parametrize("options", [{"magic": 1}, {"solve_s": 30.0}, {"weights": "no such file"}, {}])
@pytest.mark.parametrize("method", ["magic", "search", "gls"])
def test_warming_up_says_nothing(method: str, options: dict[str, Any]) -> None:
    warm_up(method, options)
    if method == "search" and "weights" in options:
        warm_up("copcs", options)


def twice(x: int) -> int:
    return 2 * x


def test_machine_code_that_cannot_be_kept_is_made_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    space: dict[str, Any] = {}
    exec("def thrice(x):\n    return 3 * x\n", space)  # of no file
    assert jit.compiled(space["thrice"], "text")(2) == 6
    monkeypatch.setattr(jit, "FILE", ("_elsewhere",))  # of another numba
    made: Any = jit.compiled(twice, "text")
    assert made(3) == 6
    assert not hasattr(made._cache, "_cache_file")


def test_machine_code_is_kept_until_a_kernel_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(tmp_path))
    pair = "from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    a: int\n    b: int\n"

    def call(text: str) -> tuple[int, int]:
        for name in ("pair_before", "pair_after", "adds"):
            sys.modules.pop(name, None)
        importlib.invalidate_caches()
        adds = importlib.import_module("adds")
        add: Any = jit.compiled(adds.add, text)
        one = adds.Pair(2, 3)
        return add(one), sum(add.stats.cache_hits.values())

    def kept() -> list[Path]:
        return sorted((tmp_path / "__pycache__").glob("*.nb?"))

    (tmp_path / "pair_before.py").write_text(pair)
    (tmp_path / "adds.py").write_text("from pair_before import Pair\n\ndef add(p):\n    return p.a + p.b\n")
    assert call("one") == (5, 0)
    assert call("one") == (5, 1)
    assert call("two") == (5, 0)
    assert len(kept()) == 2  # the older ones are gone
    # An update moves the class elsewhere: what is kept names one that is gone.
    (tmp_path / "pair_before.py").write_text("")
    (tmp_path / "pair_after.py").write_text(pair)
    (tmp_path / "adds.py").write_text("from pair_after import Pair\n\ndef add(p):\n    return p.a + p.b\n")
    assert call("three") == (5, 0)
    assert call("three") == (5, 1)
    for file in kept():  # the power failed
        file.write_bytes(b"")
        assert call("three") == (5, 0)
        assert call("three") == (5, 1)
        file.write_bytes(b"no machine code at all")
        assert call("three") == (5, 0)

    def full(self: object, name: str, data: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("numba.core.caching.IndexDataCacheFile._save_data", full)
    assert call("four") == (5, 0)


def test_kernels_are_bound_to_their_text_and_how_they_are_compiled(tmp_path: Path) -> None:
    for cache, text in ((kernel.run._cache, jit._STAMP), (tokens_kernel.start._cache, policy_jit._STAMP)):  # type: ignore[attr-defined]
        assert text[:16] in cache._cache_file._index_name
    assert jit._STAMP == jit.stamp(jit.HERE) != policy_jit._STAMP
    for name in ("a_kernel.py", "jit.py", "other.py"):
        (tmp_path / name).write_text("1")
    stamps = [jit.stamp(tmp_path)]
    for name in ("other.py", "a_kernel.py", "jit.py"):
        (tmp_path / name).write_text("2")
        stamps.append(jit.stamp(tmp_path))
    assert stamps[0] == stamps[1]
    assert len(set(stamps)) == 3
