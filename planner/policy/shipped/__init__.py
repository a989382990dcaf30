"""The weights that come with the program: ``weights.json`` has name and hash, ``README.md`` is the model card."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

from planner.errors import PlannerError
from planner.policy.decode import Policy

FOLDER = Path(__file__).parent
NAME = "plus.safetensors"


@cache
def shipped(folder: Path = FOLDER) -> Policy:
    """Network ``plus`` as shipped; read once.

    Raises:
        PlannerError: where a file is missing, damaged, or not the one whose hash is on record.
    """
    index = folder / "weights.json"
    try:
        record = json.loads(index.read_text(encoding="utf-8"))
        name, sha256 = str(record["file"]), str(record["sha256"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PlannerError(f"{index}: cannot be read: {error}; install the program again") from error
    return Policy.load(folder / name, sha256)
