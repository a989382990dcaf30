"""What is known about a run before it starts: which mission, which program, which versions."""

from __future__ import annotations

import platform
import subprocess
import time
from dataclasses import dataclass, field
from functools import cache
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "cattrs",
    "foxglove-sdk",
    "jinja2",
    "matplotlib",
    "mcap",
    "numba",
    "numpy",
    "orjson",
    "pydantic",
    "pyproj",
    "scikit-image",
    "scipy",
    "shapely",
    "torch",
)


@cache
def versions() -> dict[str, str]:
    """Versions of the program (``copcs-deploy``), its git commit where there is one, Python and packages.

    A commit with changes on top ends in ``+``.
    """
    found = {"copcs-deploy": _version("copcs-deploy") or "not installed", "python": platform.python_version()}
    commit = _git_commit(Path(__file__).resolve().parent.parent)
    if commit:
        found["git"] = commit
    return found | {name: version for name in PACKAGES if (version := _version(name))}


def _version(package: str) -> str | None:
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return None


def _git_commit(root: Path) -> str | None:
    if not (root / ".git").exists():  # installed from a wheel: some other repository around it would mislead
        return None
    try:
        answers = [
            subprocess.run(
                ["git", "-C", str(root), *args], capture_output=True, text=True, timeout=5, check=True
            ).stdout
            for args in (("rev-parse", "HEAD"), ("status", "--porcelain", "--untracked-files=no"))
        ]
    except (OSError, subprocess.SubprocessError):
        return None
    return answers[0].strip() + ("+" if answers[1].strip() else "")


@dataclass(frozen=True, slots=True)
class RunMeta:
    """The head of a recording.

    Attributes:
        name: of the mission.
        seed: of everything random in the run.
        mission_digest: SHA-256 of the mission as run.
        plan_digest: of the first plan, ``Plan.digest``.
        backend: ``kinematic``, ``wire`` or ``real``.
        planner: method asked for.
        command: what to type to do it again.
        started_unix_s: wall-clock time at the loop clock's 0; a fixed value makes recordings of a seed equal.
        versions: as ``versions()`` gives them.
    """

    name: str
    seed: int
    mission_digest: str
    plan_digest: str | None = None
    backend: str = "kinematic"
    planner: str = "search"
    command: str = ""
    started_unix_s: float = field(default_factory=time.time)
    versions: dict[str, str] = field(default_factory=versions)
