"""Makes a weights file the one that is shipped: ``python -m planner.policy.shipped FILE``."""

from __future__ import annotations

import hashlib
import json
import shutil
import sys
from pathlib import Path

from planner.policy.decode import Policy
from planner.policy.shipped import FOLDER, shipped
from planner.policy.weights import read

NAME = "plus.safetensors"


def ship(path: Path, folder: Path = FOLDER) -> None:
    """Copies the file, and records its hash and how it was made.

    Raises:
        PlannerError: where it is no weights file of network ``plus``.
    """
    Policy.load(path)
    config, _, about = read(path)
    shutil.copyfile(path, folder / NAME)
    sha256 = hashlib.sha256(path.read_bytes()).hexdigest()
    made = {k: v for k, v in about.items() if k != "domain"}
    record = {"file": NAME, "sha256": sha256, "network": config.to_json(), "made": made}
    (folder / "weights.json").write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    shipped.cache_clear()
    shipped(folder)


if __name__ == "__main__":
    ship(Path(sys.argv[1]))
