from pathlib import Path

import pytest

from deploy import run_folder
from deploy.errors import InputError
from deploy.run_folder import prepare


def test_default_is_named_after_mission_and_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first = prepare(None, "My mission: 1/2", now=lambda: 0.0)
    second = prepare(None, "My mission: 1/2", now=lambda: 0.0)
    assert first.parent == Path("runs")
    assert first.name.startswith("My-mission-1-2-19")
    assert second.name == first.name + "-2"
    assert prepare(None, "..", now=lambda: 0.0).name.startswith("mission-")


def test_an_earlier_run_is_replaced(tmp_path: Path) -> None:
    for name in ("plan-0.json", "plan-12.json", "report.html", "log.txt", "recording.mcap"):
        (tmp_path / name).touch()
    (tmp_path / "recording.mcap").unlink()
    (tmp_path / "mission").mkdir()
    (tmp_path / "mission" / "mission.yaml").touch()
    assert prepare(tmp_path, "x") == tmp_path
    assert list(tmp_path.iterdir()) == []


def test_files_of_somebody_else_stay(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    (tmp_path / "plan-0.json").touch()
    with pytest.raises(InputError, match=r"thesis\.tex.*--out"):
        prepare(tmp_path, "x")
    assert (tmp_path / "plan-0.json").exists()


def test_a_real_flight_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Meta:
        backend = "real"

    class Recording:
        meta = Meta

    (tmp_path / "recording.mcap").touch()
    with pytest.raises(InputError, match="cannot be read"):
        prepare(tmp_path, "x")
    monkeypatch.setattr(run_folder, "read", lambda folder: Recording)
    with pytest.raises(InputError, match="real flight"):
        prepare(tmp_path, "x")
    Meta.backend = "kinematic"
    assert prepare(tmp_path, "x") == tmp_path


def test_unusable_folders(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="is a file"):
        prepare(file, "x")
    with pytest.raises(InputError, match="cannot be written"):
        prepare(file / "below", "x")
    with pytest.raises(InputError, match="cannot be written"):
        prepare(Path("/proc/runs"), "x")
