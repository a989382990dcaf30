"""The folder of a run: where it is, and that it takes the place of nothing it should not."""

from __future__ import annotations

import contextlib
import re
import time
from collections.abc import Callable
from pathlib import Path

from deploy.errors import InputError
from deploy.recording import FILE as RECORDING
from deploy.recording import read

DEFAULT_ROOT = Path("runs")
PICTURE, REPORT_JSON, REPORT_HTML, LOG, MISSION = "picture.png", "report.json", "report.html", "log.txt", "mission"
_OURS = re.compile(r"plan-\d+\.json")


def prepare(out: Path | None, mission_name: str, *, now: Callable[[], float] = time.time) -> Path:
    """Makes the folder of a new run, empty.

    Args:
        out: the folder asked for; None for ``runs/<mission>-<date>-<time>``.
        mission_name: for the default.
        now: the wall clock.

    Returns:
        The folder.

    Raises:
        InputError: when it cannot be made or written, or holds something that must not be overwritten: files of
            somebody else, or the recording of a flight with real vehicles.
    """
    folder = out if out is not None else _fresh(DEFAULT_ROOT, mission_name, now())
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError("--out is a file; give a folder", file=folder)
        folder.mkdir(parents=True, exist_ok=True)
        _clear(folder)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise InputError(f"cannot be written: {error.strerror}; give another folder as --out", file=folder) from error
    return folder


def drop_if_empty(folder: Path) -> None:
    """Takes the folder of a run away that never began."""
    with contextlib.suppress(OSError):
        folder.rmdir()


def _fresh(root: Path, mission_name: str, now_s: float) -> Path:
    name = re.sub(r"[^\w.-]+", "-", mission_name).strip("-.") or "mission"
    stamp = time.strftime("%Y%m%d-%H%M%S", time.localtime(now_s))
    folder, number = root / f"{name}-{stamp}", 1
    while folder.exists():
        number += 1
        folder = root / f"{name}-{stamp}-{number}"
    return folder


def _clear(folder: Path) -> None:
    """Empties the folder of an earlier simulated run; refuses anything else that is not empty."""
    entries = list(folder.iterdir())
    foreign = sorted(e.name for e in entries if not _known(e.name))
    if foreign:
        raise InputError(
            f"is not empty ({foreign[0]!r} is no file of a run); give another folder as --out", file=folder
        )
    if (folder / RECORDING).exists():
        _keep_real_flights(folder)
    for entry in entries:
        _remove(entry)


def _keep_real_flights(folder: Path) -> None:
    try:
        backend = read(folder).meta.backend
    except InputError as error:
        what = "holds a recording that cannot be read, perhaps of a real flight; delete it or give another --out"
        raise InputError(what, file=folder) from error
    if backend == "real":
        raise InputError("holds the recording of a real flight, which is kept; give another --out", file=folder)


def _known(name: str) -> bool:
    return name in (RECORDING, PICTURE, REPORT_JSON, REPORT_HTML, LOG, MISSION) or bool(_OURS.fullmatch(name))


def _remove(entry: Path) -> None:
    if entry.is_dir() and not entry.is_symlink():
        for child in entry.iterdir():
            _remove(child)
        entry.rmdir()
    else:
        entry.unlink()
