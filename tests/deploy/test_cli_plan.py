import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.cli import app
from planner.plan import read_actions
from planner.presets import preset

DEMO = str(Path(__file__).parents[2] / "mission_configs" / "demo.yaml")


@pytest.fixture
def problem(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "small.json"
    path.write_text(json.dumps(preset("T15-P5", (2, 2), 0).to_json()))
    return path


def call(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in args])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert "Traceback" not in result.output
    return result.exit_code, result.stdout, result.stderr


def test_a_problem_becomes_plan_and_picture(problem: Path) -> None:
    code, out, err = call("plan", problem, "--time", "0.3", "--seed", "3")
    assert (code, err) == (0, "")
    assert "small.plan.json" in out
    plan = Path("small.plan.json")
    assert len(read_actions(plan)) >= 15
    assert json.loads(plan.read_text())["feasible"] is True
    assert plan.with_suffix(".png").stat().st_size > 10_000


def test_json_goes_to_standard_output_alone(problem: Path) -> None:
    code, out, err = call("plan", problem, "--time", "0.3", "--json")
    assert (code, err) == (0, "")
    assert json.loads(out)["format"] == "copcs-plan/1"
    assert sorted(p.name for p in Path().iterdir()) == ["small.json"]
    code, out, _ = call("plan", problem, "--time", "0.3", "--json", "--out", "there.json")
    assert code == 0
    assert json.loads(out) == json.loads(Path("there.json").read_text())
    assert Path("there.png").exists()


def test_a_mission(problem: Path) -> None:
    code, out, _ = call("plan", DEMO, "--time", "0.3", "--json")
    assert code == 0
    assert json.loads(out)["method"] == "copcs" and json.loads(out)["note"] is None


def test_no_feasible_plan_is_said_in_words(problem: Path) -> None:
    data = json.loads(problem.read_text())
    for uav in data["uavs"]:
        uav["capacity_j"] = uav["energy_j"] = 1000.0
    problem.write_text(json.dumps(data))
    code, out, err = call("plan", problem, "--time", "0.2")
    assert code == 1
    assert "not feasible" in out
    assert "no feasible plan: " in err
    code, out, _ = call("plan", problem, "--time", "0.2", "--json")
    assert code == 1
    assert json.loads(out)["feasible"] is False


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["missing.json"], "missing.json"),
        (["missing.yaml"], "missing.yaml"),
        (["."], "."),
        (["small.json", "--planner", "magic"], "magic"),
        (["small.json", "--time", "0"], "--time"),
        (["small.json", "--time", "nan"], "--time"),
        (["small.json", "--time", "inf"], "--time"),
        (["small.json", "--time", "soon"], "--time"),
        (["small.json", "--seed", "-1"], "--seed"),
        (["small.json", "--out", "small.json"], "--out"),
        (["small.json", "--out", "."], "folder"),
        (["small.json", "--out", "none/plan.json"], "--out"),
        (["small.json", "--out", "/dev/full"], "No space left"),
        (["broken.json"], "not a JSON file"),
        (["other.json"], "copcs-problem/1"),
        (["deep.json"], "not a JSON file"),
        (["binary.json"], "not a JSON file"),
    ],
)
def test_what_a_user_can_get_wrong(problem: Path, args: list[str], words: str) -> None:
    Path("broken.json").write_text("{")
    Path("other.json").write_text('{"format": "other"}')
    Path("deep.json").write_text("[" * 100_000)
    Path("binary.json").write_bytes(b"\xff\xfe\x00")
    code, out, err = call("plan", *args, *([] if "--time" in args else ["--time", "0.2"]))
    assert code == 2, err
    assert words in err
    assert out == ""


def test_an_error_is_json_too(problem: Path) -> None:
    code, out, err = call("plan", "missing.json", "--json")
    assert code == 2
    assert json.loads(out) == {"error": err.removeprefix("error: ").strip(), "exit_code": 2}


def test_ctrl_c_while_planning(problem: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("deploy.cli_plan.plan_with_margin", interrupted)
    code, out, err = call("plan", problem)
    assert (code, out, err) == (3, "", "aborted by the operator\n")


@pytest.mark.slow  # compiles the planner
@pytest.mark.parametrize("planner", ["copcs", "search", "milp"])
def test_compiling_does_not_count_as_planning(problem: Path, tmp_path: Path, planner: str) -> None:
    start = "from deploy.cli import main; main()"
    command = [sys.executable, "-c", start, "plan", str(problem), "--planner", planner, "--time", "0.5", "--json"]
    folder = tmp_path / "machine_code"
    folder.mkdir()
    env = {**os.environ, "NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=env)
    assert any(folder.rglob("*.nbc"))
    assert json.loads(done.stdout)["planning_s"] < 3.0
