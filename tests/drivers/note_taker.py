"""A driver module for the guardian's tests: carrying out a will leaves a note in a file."""

from __future__ import annotations

from pathlib import Path
from typing import Any


def carry_out(arguments: dict[str, Any], height_m: float, deadline_s: float) -> str:
    if arguments.get("fails"):
        raise OSError("no such radio")
    Path(arguments["file"]).write_text(f"{height_m:g}")
    return f"landed from {height_m:g} m"
