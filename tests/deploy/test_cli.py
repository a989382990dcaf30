"""The command line as a user meets it: exit codes, messages without tracebacks, JSON for machines."""

import contextlib
import json
import os
import pty
import re
import select
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
import small_mission
from typer.testing import CliRunner

from deploy.cli import app
from drivers.errors import DriverError

PROGRAM = [sys.executable, "-c", "from deploy.cli import main; main()"]


@pytest.fixture
def mission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    small_mission.write(tmp_path)
    return "small.yaml"


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> tuple[int, str, Path]:
    folder = tmp_path_factory.mktemp("flown")
    path = small_mission.write(folder)
    result = CliRunner().invoke(app, ["run", str(path), "--out", str(folder / "run"), "--json"])
    return result.exit_code, result.stdout, folder / "run"


def call(*args: object) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, [str(a) for a in args])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert "Traceback" not in result.output
    return result.exit_code, result.stdout, result.stderr


def test_run(mission: str) -> None:
    code, out, err = call("run", mission, "--out", "run")
    assert (code, err) == (0, "")
    for words in (
        "plan: makespan",
        "checks:",
        "flying small",
        "3 of 3",
        "safety violations     none",
        "run/report.html",
    ):
        assert words in out
    assert "\x1b" not in out


def test_run_says_when_search_took_over(mission: str, tmp_path: Path) -> None:
    planner = {**small_mission.MISSION["planner"], "options": {"weights": "nowhere.safetensors"}}
    small_mission.write(tmp_path, planner=planner)
    code, out, _ = call("run", mission, "--planner", "copcs", "--dry-run", "--out", "run")
    assert code == 0
    assert re.search(r"plan: search took over: nowhere\.safetensors: the weights cannot be read", " ".join(out.split()))


def test_run_json(flown: tuple[int, str, Path]) -> None:
    code, out, folder = flown
    data = json.loads(out)
    assert (code, data["exit_code"], data["outcome"], data["folder"]) == (0, 0, "done", str(folder))
    assert data["checks"]["passed"] is True
    assert data["report"] == json.loads((folder / "report.json").read_text())


def test_run_has_a_folder_of_its_own(mission: str) -> None:
    assert call("run", mission)[0] == 0
    (folder,) = Path("runs").iterdir()
    assert folder.name.startswith("small-20")


def test_seed_and_planner_are_part_of_the_mission_as_run(mission: str) -> None:
    assert call("run", mission, "--out", "run", "--seed", "9", "--planner", "search")[0] == 0
    report = json.loads(Path("run/report.json").read_text())
    assert report["seed"] == 9
    assert call("replay", "run")[0] == 0


def test_dry_run_shows_the_checks_and_arms_nothing(mission: str) -> None:
    code, out, err = call("run", mission, "--dry-run")
    assert (code, err) == (0, "")
    assert "PASS" in out
    assert out.splitlines()[-1] == "dry run: nothing was armed"
    assert not Path("runs").exists()
    code, out, _ = call("run", mission, "--dry-run", "--json")
    assert code == 0
    assert json.loads(out)["outcome"] == "dry run"


def test_check(mission: str) -> None:
    code, out, err = call("check", mission)
    assert (code, err) == (0, "")
    assert re.search(r"\d+ passed, \d+ warnings?, 0 failed", out)
    code, out, _ = call("check", mission, "--json")
    rows = json.loads(out)["rows"]
    assert {row["verdict"] for row in rows} <= {"pass", "warn", "fail", "not run"}
    assert {"mission", "plan", "energy", "space", "chance", "backend"} <= {row["group"] for row in rows}


def test_a_failed_check_is_exit_code_1(mission: str) -> None:
    small_mission.write(Path(), checks={"energy_margin_warn": 0.99, "energy_margin_fail": 0.99})
    assert call("check", mission)[0] == 1
    assert call("run", mission, "--dry-run")[0] == 1
    code, _, err = call("run", mission)
    assert code == 1
    assert "error: check 'landing energy' failed: " in err
    assert f"copcs-deploy check {mission}" in err
    assert not Path("runs").exists() or not list(Path("runs").iterdir())
    code, out, _ = call("run", mission, "--json")
    assert (code, json.loads(out)["outcome"]) == (1, "refused")


def test_replay_and_report(flown: tuple[int, str, Path]) -> None:
    folder = flown[2]
    code, out, err = call("replay", folder)
    assert (code, err) == (0, "")
    assert re.match(r"identical: \d+ turns, \d+ commands", out)
    code, out, _ = call("replay", folder, "--json")
    assert json.loads(out)["identical"] is True
    before = (folder / "report.json").read_text()
    (folder / "report.html").unlink()
    code, out, _ = call("report", folder)
    assert code == 0
    assert "outcome               done" in out
    assert (folder / "report.html").exists()
    assert (folder / "report.json").read_text() == before
    code, out, _ = call("report", folder, "--json")
    assert json.loads(out)["outcome"] == "done"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["run"], "MISSION"),
        (["fly", "small.yaml"], "No such command"),
        (["run", "small.yaml", "--fast"], "--fast"),
        (["run", "small.yaml", "--backend", "dream"], "--backend"),
        (["run", "small.yaml", "--backend", "real"], "has no driver; give crazyflie, limo or mavlink"),
        (["run", "small.yaml", "--sim", "wire"], "has no driver; give crazyflie, limo or mavlink"),
        (["run", "small.yaml", "--seed", "x"], "--seed"),
        (["run", "small.yaml", "--planner", "magic"], "magic"),
        (["run", "missing.yaml"], "missing.yaml"),
        (["run", "."], "."),
        (["run", "typo.yaml"], "typo.yaml"),
        (["run", "roads.geojson"], "roads.geojson"),
        (["run", "small.yaml", "--out", "small.yaml"], "--out"),
        (["run", "small.yaml", "--out", "."], "not empty"),
        (["run", "small.yaml", "--out", "/proc/nowhere"], "--out"),
        (["check", "missing.yaml"], "missing.yaml"),
        (["check", "typo.yaml"], "typo.yaml"),
        (["check", "small.yaml", "--planner", "magic"], "magic"),
        (["replay", "missing"], "missing"),
        (["replay", "."], "recording.mcap"),
        (["replay", "small.yaml"], "folder"),
        (["report", "missing"], "missing"),
        (["report", "."], "mission.yaml"),
    ],
)
def test_what_a_user_can_get_wrong(mission: str, args: list[str], words: str) -> None:
    small_mission.write(Path("other"), tusks={})
    Path("other/small.yaml").rename("typo.yaml")
    code, out, err = call(*args)
    assert code == 2, err
    assert words in err
    assert "error" in err.lower() or "usage" in err.lower()
    assert "identical" not in out


def test_an_error_in_json(mission: str) -> None:
    for command in ("run", "check", "replay", "report"):
        code, out, err = call(command, "missing", "--json")
        assert code == 2
        assert json.loads(out)["exit_code"] == 2
        assert json.loads(out)["error"] in err


def test_ctrl_c_before_the_flight(mission: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*args: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("deploy.session.plan_with_margin", interrupted)
    code, _, err = call("run", mission)
    assert (code, err) == (3, "aborted by the operator\n")
    assert list(Path("runs").iterdir()) == []


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (DriverError("uav0: no answer; switch it on"), 1, "error: uav0: no answer; switch it on"),
        (OSError(28, "No space left on device"), 2, "error: No space left on device"),
        (OSError(28, "No space left on device", "x.json"), 2, "error: x.json: No space left on device"),
        (MemoryError(), 1, "error: not enough memory"),
        (BrokenPipeError(), 0, ""),
    ],
)
def test_errors_of_the_world_around(
    mission: str, monkeypatch: pytest.MonkeyPatch, error: Exception, code: int, words: str
) -> None:
    def fails(*args: object) -> None:
        raise error

    monkeypatch.setattr("deploy.session.plan_with_margin", fails)
    found, _, err = call("check", mission)
    assert found == code
    assert err.startswith(words)


def test_version_and_help() -> None:
    assert re.match(r"\d+\.\d+", call("--version")[1])
    code, out, _ = call("--help")
    assert code == 0
    for command in ("run", "check", "plan", "replay", "report"):
        assert command in out


def test_as_a_program(mission: str) -> None:
    done = subprocess.run([*PROGRAM, "check", mission], capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_reader_who_leaves_does_not_change_the_outcome(mission: str) -> None:
    with subprocess.Popen(
        [*PROGRAM, "run", mission, "--out", "run"], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(60) == 0
        assert process.stderr.read() == b""
    assert json.loads(Path("run/report.json").read_text())["outcome"] == "done"


def in_terminal(*args: str, until: bytes = b"", send: bytes = b"", columns: int = 100) -> tuple[int, str]:
    """Runs the program in a terminal; types ``send`` once ``until`` has been shown."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm-256color", COLUMNS=str(columns), LINES="30")
        os.execv(PROGRAM[0], [*PROGRAM, *args])
    shown, limit_s = b"", time.monotonic() + 60
    while time.monotonic() < limit_s:
        if not select.select([terminal], [], [], 0.2)[0]:
            continue
        try:
            shown += os.read(terminal, 65536)
        except OSError:  # the other end has gone
            break
        if send and until in shown:
            os.write(terminal, send)
            send = b""
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGCONT)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), shown.decode(errors="replace")


def test_the_screen_in_a_terminal(mission: str) -> None:
    code, shown = in_terminal("run", mission, "--out", "run")
    assert code == 0
    for words in ("copcs-deploy", "uav1", "ugv0", "tasks", "3/3", "DONE", "Ctrl-C"):
        assert words in shown
    assert shown.count("\x1b[?25l") == shown.count("\x1b[?25h")  # the cursor is back


def test_ctrl_c_in_a_terminal_brings_everybody_down(mission: str) -> None:
    # long enough in wall time for a key to be pressed: a flight of an hour
    tasks = {"points": [[50 + 10 * i if i % 2 else 950 - 10 * i, 200 + 10 * i] for i in range(50)]}
    small_mission.write(Path(), tasks=tasks)
    code, shown = in_terminal("run", mission, "--out", "run", until=b"RUNNING", send=b"\x03")
    assert code == 3, shown
    assert "bringing everybody down" in shown
    report: dict[str, Any] = json.loads(Path("run/report.json").read_text())
    assert report["outcome"] == "aborted"


def test_train_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out, _ = call("train", "--help")
    assert code == 0
    assert "copcs-deploy train" in out and "--labels" in out
    folder = tmp_path / "none"
    code, _, err = call("train", "--labels", folder, "--sets", "T15-P5_1-1", "--out", tmp_path / "o")
    assert code == 2
    assert f"{folder}/T15-P5_1-1: there are no labels; make them first: python -m planner.labels" in err
    assert call("train", "--sets", "T99")[0] == 2
    assert call("train", "--magic")[0] == 2
    for name in [x for x in sys.modules if x.startswith("planner.policy.train")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "torch", None)
    code, _, err = call("train")
    assert code == 2
    assert "training needs PyTorch; pip install 'copcs-deploy[train]'" in err
