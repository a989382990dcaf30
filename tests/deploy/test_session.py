"""Whole runs of a small mission: what they leave behind, and what they do when something goes wrong."""

import dataclasses
import errno
import json
from pathlib import Path
from typing import Any

import pytest
import small_mission

from deploy import backends, session, watch
from deploy.display import NullDisplay
from deploy.errors import DeployError, InputError
from deploy.events import Event
from deploy.gate import judge
from deploy.mission import load
from deploy.operator import ScriptedOperator
from deploy.recording import Recorder, read
from deploy.replay import ReplayResult, replay
from deploy.screen import Header
from deploy.session import RunResult, run_mission
from deploy.status import Status
from planner.errors import PlannerError

FAILING = {"checks": {"energy_margin_warn": 0.99, "energy_margin_fail": 0.99}}


class Listener(NullDisplay):
    """Remembers what it was told."""

    def __init__(self) -> None:
        self.notes: list[str] = []
        self.events: list[Event] = []
        self.headers: list[Header] = []

    def note(self, text: str) -> None:
        self.notes.append(text)

    def begin(self, header: Header) -> None:
        self.headers.append(header)

    def update(self, status: Status | None, events: Any) -> None:
        self.events.extend(events)


def fly(folder: Path, *, mission: dict[str, Any] | None = None, **options: Any) -> RunResult:
    path = small_mission.write(folder / "mission", **(mission or {}))
    return run_mission(load(path), out=folder / "run", **options)


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> tuple[RunResult, Path, Listener]:
    folder = tmp_path_factory.mktemp("done")
    listener = Listener()
    result = fly(folder, display=listener)
    return result, folder / "run", listener


def test_a_mission_from_file_to_report(done: tuple[RunResult, Path, Listener]) -> None:
    result, folder, listener = done
    assert (result.kind, result.exit_code, result.recording_failure) == ("done", 0, None)
    assert {p.name for p in folder.iterdir()} >= {
        "mission", "plan-0.json", "recording.mcap", "report.json", "report.html", "picture.png", "log.txt",
    }  # fmt: skip
    report = json.loads((folder / "report.json").read_text())
    assert report["outcome"] == "done"
    assert report["tasks_visited"] == report["tasks_total"] == 3
    assert report["safety_violations"] == []
    assert result.truth is not None
    assert result.truth.violations == ()
    assert listener.headers[0].subtitle == "2 UAVs, 1 UGV, kinematic, seed 1"
    assert any("3 of 3 tasks" in e.text for e in listener.events)
    assert listener.notes[0].startswith("plan: makespan")
    assert load(folder / "mission" / "mission.yaml").digest == read(folder).meta.mission_digest


def test_replay_gives_identical_commands(done: tuple[RunResult, Path, Listener]) -> None:
    result, folder, _ = done
    assert result.outcome is not None
    replayed = replay(folder)
    assert replayed == ReplayResult(result.outcome.turns, replayed.commands, False, None, {})
    assert replayed.identical
    assert replayed.commands > 5


def test_a_run_again_is_the_same_run(done: tuple[RunResult, Path, Listener], tmp_path: Path) -> None:
    again = fly(tmp_path, with_report=False)
    first, second = (list(read(folder).ticks()) for folder in (done[1], tmp_path / "run"))
    for a, b in zip(first, second, strict=True):
        assert (a.observation.now_s, a.observation.poses) == (b.observation.now_s, b.observation.poses)
        assert (a.observation.vehicles, a.observation.operator) == (b.observation.vehicles, b.observation.operator)
        assert (a.sent, a.events, a.refusals) == (b.sent, b.events, b.refusals)
    assert again.report is None


def test_replay_finds_the_first_difference(
    done: tuple[RunResult, Path, Listener], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stricter(settings: Any, state: Any, observation: Any, commands: Any) -> Any:
        verdict = judge(settings, state, observation, commands)
        return dataclasses.replace(verdict, accepted=verdict.accepted[1:])

    monkeypatch.setattr("deploy.replay.judge", stricter)
    result = replay(done[1])
    assert not result.identical
    assert result.difference is not None
    assert result.difference.what == "passed the gate"
    assert "Arm" in str(result.difference)


def test_replay_of_what_is_no_run(done: tuple[RunResult, Path, Listener], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        replay(tmp_path)
    (tmp_path / "recording.mcap").write_bytes((done[1] / "recording.mcap").read_bytes())
    with pytest.raises(InputError, match="is missing"):
        replay(tmp_path)
    path = small_mission.write(tmp_path / "mission", seed=77)
    path.rename(path.with_name("mission.yaml"))
    with pytest.raises(InputError, match="not the mission that was flown"):
        replay(tmp_path)


def test_a_recording_that_breaks_off_is_replayed_as_far_as_it_goes(
    done: tuple[RunResult, Path, Listener], tmp_path: Path
) -> None:
    (tmp_path / "mission").mkdir()
    for file in (done[1] / "mission").iterdir():
        (tmp_path / "mission" / file.name).write_bytes(file.read_bytes())
    whole = (done[1] / "recording.mcap").read_bytes()
    (tmp_path / "recording.mcap").write_bytes(whole[: int(len(whole) * 0.9)])
    result = replay(tmp_path)
    assert result.truncated
    assert result.identical


@pytest.mark.parametrize("wish", ["recover", "stop"])
@pytest.mark.parametrize("drop", [0.01, 0.4])
def test_the_operator_ends_it(tmp_path: Path, wish: Any, drop: float, monkeypatch: pytest.MonkeyPatch) -> None:
    worse = backends.world_of
    monkeypatch.setattr(backends, "world_of", lambda m, s: dataclasses.replace(worse(m, s), command_drop=drop))
    operator = ScriptedOperator([(20.0, wish)])
    result = fly(tmp_path, operator=operator, with_report=False)
    assert (result.kind, result.exit_code) == ("aborted", 3)
    assert operator.wished == {wish}
    assert result.truth is not None
    assert not any(v.airborne for v in result.truth.vehicles.values())
    assert replay(tmp_path / "run").identical


def test_a_mission_that_takes_for_ever_is_broken_off_as_failed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = session.fly
    monkeypatch.setattr(session, "fly", lambda *args, **kwargs: real(*args, **{**kwargs, "limit_s": 15.0}))
    result = fly(tmp_path, with_report=False)
    assert (result.kind, result.exit_code) == ("failed", 1)
    assert result.truth is not None
    assert not any(v.airborne for v in result.truth.vehicles.values())


def test_a_failed_check_refuses_to_arm(tmp_path: Path) -> None:
    result = fly(tmp_path, mission=FAILING)
    assert (result.kind, result.exit_code, result.folder) == ("refused", 1, None)
    assert [row.name for row in result.checks.failures] == ["landing energy"]
    assert not (tmp_path / "run").exists()


def test_a_dry_run_flies_nothing(tmp_path: Path) -> None:
    result = fly(tmp_path, dry_run=True)
    assert (result.kind, result.exit_code, result.folder) == ("dry run", 0, None)
    assert not (tmp_path / "run").exists()
    failing = fly(tmp_path, dry_run=True, mission=FAILING)
    assert failing.exit_code == 1


def test_a_full_disk_ends_the_recording_but_not_the_flight(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls = 0
    real = Recorder.tick

    def full(self: Recorder, *args: Any) -> None:
        nonlocal calls
        calls += 1
        if calls > 50:
            raise DeployError("recording.mcap: cannot write the recording: No space left on device")
        real(self, *args)

    monkeypatch.setattr(Recorder, "tick", full)
    listener = Listener()
    result = fly(tmp_path, display=listener)
    assert result.outcome is not None
    assert result.outcome.kind == "done"
    assert result.exit_code == 1
    assert result.recording_failure is not None
    assert "No space left" in result.recording_failure
    assert calls == 51
    assert any("the flight goes on" in note for note in listener.notes)


def test_a_broken_display_does_not_end_the_flight(tmp_path: Path) -> None:
    class Broken(Listener):
        def update(self, status: Status | None, events: Any) -> None:
            raise RuntimeError("no such colour")

    display = Broken()
    result = fly(tmp_path, display=display, with_report=False)
    assert result.kind == "done"
    assert sum("the display has failed" in note for note in display.notes) == 1


def test_a_display_that_cannot_even_be_told() -> None:
    class Mute(Listener):
        def note(self, text: str) -> None:
            raise OSError(errno.EPIPE, "Broken pipe")

    watcher = watch.Watch(None, Path("/nowhere"), Mute())  # type: ignore[arg-type]
    watcher.plan(None, 0.0, 0.0, "", None)  # type: ignore[arg-type]
    assert watcher.failure is not None


def test_a_folder_of_somebody_else(tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"thesis\.tex"):
        fly(tmp_path)


def test_the_planner_dying_leaves_no_folder(tmp_path: Path) -> None:
    lost = {"method": "copcs", "options": {"polish": False, "weights": str(tmp_path / "lost.safetensors")}}
    with pytest.raises(PlannerError, match=r"nothing to plan with: .*lost\.safetensors"):
        fly(tmp_path, mission={"planner": lost})
    assert not (tmp_path / "run").exists()
