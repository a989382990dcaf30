"""Makes a weights file the one that is shipped: ``python -m planner.policy.shipped FILE``."""

from __future__ import annotations

import argparse
import hashlib
import json
from pathlib import Path

from planner.errors import PlannerError, exit_on_error
from planner.policy.decode import Policy
from planner.policy.shipped import FOLDER, NAME, shipped
from planner.policy.weights import read


def ship(path: Path, folder: Path = FOLDER) -> None:
    """Copies the file, and records its hash and how it was made.

    Raises:
        PlannerError: where it is no weights file of network ``plus``, or does not say what it was trained on.
    """
    config, _, about = read(path)
    if Policy.load(path).domain is None:
        raise PlannerError(f"{path}: it does not say what the network was trained on; train again")
    data = path.read_bytes()
    made = {k: None if v != v else v for k, v in about.items() if k != "domain"}  # noqa: PLR0124  (not a number)
    record = {"file": NAME, "sha256": hashlib.sha256(data).hexdigest(), "network": config.to_json(), "made": made}
    text = json.dumps(record, indent=1, allow_nan=False) + "\n"
    for name, content in ((NAME, data), ("weights.json", text.encode())):
        part = folder / f"{name}.part"
        part.write_bytes(content)
        part.replace(folder / name)
    shipped.cache_clear()
    shipped(folder)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m planner.policy.shipped", description="Ships a weights file.")
    parser.add_argument("file", type=Path, help="weights of network plus")
    ship(parser.parse_args().file)


if __name__ == "__main__":
    exit_on_error(main)
