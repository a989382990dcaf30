"""The benchmark: resumable rows, the paper's table, the quick run."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from reference import Reference
from typer.testing import CliRunner

from deploy.cli import app
from planner.benchmark import SEARCH_S, Entry, Row, entries, measure, quick, read_rows, run
from planner.benchmark_table import cells, markdown, plot
from planner.errors import PlannerError
from planner.instances import DATA_SETS, TEST, data_set
from planner.labels import read as read_labels
from planner.paper import METHODS, PAPER
from planner.presets import PRESETS
from planner.solve import METHODS as KNOWN
from planner.solve import Params, Stop, solve

LABELS = Path(__file__).parents[2] / "benchmarks" / "labels"
SETS = ["T15-P5_1-1", "T15-P5_4-2"]


def fast(name: str, method: str = "search", count: int = 2) -> Entry:
    return Entry(name, method, dict.fromkeys(SEARCH_S, 0.05), "a test", instances=count)


def test_the_papers_numbers() -> None:
    assert len(PAPER) == 2 * 4 * len(METHODS)
    assert PAPER["T15-P5", "4-2", "CoPCS"] == (2614.08, 1180.29, 8569.27)
    assert PAPER["T45-P10", "2-1", "SA"] == (16719.52, 2692.45, 37677.11)
    for (setup, team, method), values in PAPER.items():
        assert values[0] >= PAPER[setup, team, "CoPCS"][0], (method, "CoPCS is the best of the paper")


def test_rows_of_the_table() -> None:
    every = entries()
    names = [e.name for e in every]
    assert len(set(names)) == len(names)
    assert {"search", "gls", "ts", "sa", "gls-15s", "ts-15s", "sa-15s", "milp"} <= set(names)
    assert all(e.method in KNOWN and set(e.time_s) == set(PRESETS) for e in every)
    assert all(e.instances >= 20 for e in every if e.method != "milp")
    assert {(e.method, e.network) for e in quick(every)} == {(e.method, e.network) for e in every}
    assert sum(8 * max(e.time_s.values()) * e.instances for e in quick(every)) < 60


def test_a_run_goes_on_where_it_was_interrupted(tmp_path) -> None:
    out = tmp_path / "r.csv"
    seen: list[tuple[int, int]] = []
    first = run(out, [fast("a")], sets=SETS, instances=1, progress=lambda *x: seen.append(x))
    assert seen == [(0, 2), (1, 2), (2, 2)]
    assert [(r.data_set, r.instance, r.entry) for r in first] == [(s, TEST[0], "a") for s in SETS]
    text = out.read_text()
    out.write_text(text + "T15-P5_1-1,801,a,sear")  # the power failed
    both = run(out, [fast("a"), fast("b", "gls", 1)], sets=SETS, instances=2)
    assert len(both) == 6
    assert [r for r in both if r in first] == first
    assert out.read_text().startswith(text)
    assert sorted(read_rows(out), key=repr) == sorted(both, key=repr)
    assert run(out, [fast("a"), fast("b", "gls", 1)], sets=SETS, instances=2) == both
    assert {r.instance for r in both if r.entry == "b"} == {TEST[0]}


def test_rows_say_what_the_plan_is() -> None:
    row = measure("T15-P5_1-1", 803, fast("a"))
    problem = data_set("T15-P5_1-1").instance(803)
    plan = solve(problem, Stop(time_s=0.05), 803, Params("search")).plan
    ref = Reference(problem, list(plan.actions))
    assert row.feasible and ref.violation() is None
    assert row.planning_s < 0.5
    assert row.uav_energy_j > 5e5 and row.makespan_s > 1000.0


def test_the_experts_rows_are_the_labels() -> None:
    expert = next(e for e in entries() if e.name == "expert")
    label = next(x for x in read_labels(LABELS, "T15-P5_4-2") if x.index == 801)
    assert measure("T15-P5_4-2", 801, expert).makespan_s == pytest.approx(label.makespan_s, abs=1e-6)


def test_processes_measure_the_same(tmp_path) -> None:
    rows = run(tmp_path / "r.csv", [fast("a", count=1)], sets=SETS, instances=1, jobs=2)
    assert [r.data_set for r in rows] == SETS and all(r.feasible for r in rows)


def row(
    data: str, entry: str, span: float, feasible: bool = True, bound: float | None = None, instance: int = 800
) -> Row:
    return Row(
        data, instance, entry, entry, feasible, span, 2e6, 3e6, 0, 0, span, 0.5, bound, 9, "d", "" if feasible else "x"
    )


def test_table_and_plot(tmp_path) -> None:
    given = [fast("search"), Entry("gls", "gls", SEARCH_S, "a baseline"), Entry("milp", "milp", SEARCH_S, "exact")]
    rows = [row("T15-P5_1-1", "search", 900.0), row("T15-P5_1-1", "search", 1100.0, instance=801)]
    rows += [row("T15-P5_1-1", "gls", 2000.0), row("T15-P5_1-1", "gls", 9e9, feasible=False, instance=801)]
    rows += [row("T15-P5_1-1", "milp", 1000.0, bound=1000.0), row("T15-P5_1-1", "milp", 1000.0, bound=900.0)]
    cell = cells(rows)["T15-P5_1-1", "search"]
    assert cell.means == (1000.0, 2000.0, 3000.0) and cell.errors[0] == pytest.approx(100.0)
    text = markdown(rows, given)
    assert "| search | 1000 ± 100 | - | - | - |" in text
    assert "| gls | 2000 | - | - | - |" in text  # over feasible plans
    assert "| gls | 1/2, 0.50 s |" in text
    assert "| *paper: CoPCS* | *6618* | *3478* | *3465* | *2614* |" in text
    # over the instance that both solve: 900 against 2000 s
    assert "| published, time as search | 1-1 | gls | 1 | 55.0 % | 122.2 % | +0 % | +0 % |" in text
    assert "| *paper: CoPCS*" not in text.split("## T15-P5: feasible")[1]  # nothing of ours to compare with it
    given += [Entry("copcs", "copcs", SEARCH_S, "the network"), Entry("paper", "copcs", SEARCH_S, "x", network="hgt")]
    rows += [row("T15-P5_1-1", "copcs", 990.0), row("T15-P5_1-1", "copcs", 1100.0, instance=801)]
    more = markdown([*rows, row("T15-P5_1-1", "paper", 1800.0)], given)
    assert "| copcs | published, time as search | 50.5 % (1) | - | - | - |" in more  # 990 against 2000 s
    assert "| paper | published, time as search | 10.0 % (1) | - | - | - |" in more
    assert "| *paper: CoPCS* | *its own* | *23.6 %* | *45.6 %* | *45.2 %* | *50.1 %* |" in more
    assert "| copcs | +4.5 % (2) | - | - | - |" in more and "those of expert" not in more
    given.append(Entry("expert", "search", SEARCH_S, "steps", steps={"T15-P5": 5, "T45-P10": 5}))
    beside = markdown([*rows, row("T15-P5_1-1", "expert", 880.0)], given).split("those of expert")[1]
    assert "| search | +2.3 % (1) | - | - | - |" in beside and "| copcs | +12.5 % (1) | - | - | - |" in beside
    assert "| paper | +100.0 % (1) | - | - | - |" in more
    assert "1-1: milp proved 1 of 2 optimal, mean gap 5.0 %" in text
    assert "What cannot:" in text and "T45" not in text.split("## T15")[1]
    plot(rows, given, tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 5_000


def test_other_files_are_refused(tmp_path) -> None:
    (tmp_path / "x.csv").write_text("a,b\n1,2\n")
    with pytest.raises(PlannerError, match="these are no results of this benchmark"):
        read_rows(tmp_path / "x.csv")
    assert read_rows(tmp_path / "none.csv") == []


def test_command(tmp_path, monkeypatch) -> None:
    args = ["benchmark", "--quick", "--rows", "search,gls", "--sets", SETS[1], "--out", str(tmp_path)]
    result = CliRunner().invoke(app, args)
    assert result.exit_code == 0, result.output
    table = (tmp_path / "quick.md").read_text()
    assert "These figures mean nothing" in table and "| gls |" in table
    assert len(read_rows(tmp_path / "quick.csv")) == 2
    about = json.loads((tmp_path / "quick.json").read_text())
    assert about["cores"] >= 1 and about["packages"]["ortools"] and about["matrix_products"]
    assert (tmp_path / "quick.png").exists()
    (tmp_path / "benchmark.csv").write_bytes((tmp_path / "quick.csv").read_bytes())
    args = ["benchmark", "--table", "--out", str(tmp_path)]
    assert CliRunner().invoke(app, args).exit_code == 0
    assert "published, time as search" in (tmp_path / "benchmark.md").read_text()
    assert len(read_rows(tmp_path / "benchmark.csv")) == 2 and not (tmp_path / "benchmark.json").exists()
    nothing = CliRunner().invoke(app, [*args[:-1], str(tmp_path / "empty")])
    assert nothing.exit_code == 2 and "--table" in nothing.output
    monkeypatch.chdir(tmp_path)
    none = CliRunner().invoke(app, ["benchmark", "--rows", "mlp"])
    assert none.exit_code == 2
    assert "row 'mlp' needs benchmarks/networks/mlp_T15-P5_1-1.safetensors" in " ".join(none.output.split())
    wrong = CliRunner().invoke(app, ["benchmark", "--rows", "magic", "--out", str(tmp_path)])
    assert wrong.exit_code == 2
    wrong = CliRunner().invoke(app, ["benchmark", "--sets", "magic", "--out", str(tmp_path)])
    assert wrong.exit_code == 2


def test_every_data_set_is_in_the_default_run() -> None:
    assert [d.name for d in DATA_SETS] == [f"{s}_{t}" for s in PRESETS for t in ("1-1", "2-1", "2-2", "4-2")]
