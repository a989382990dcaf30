"""How soon the program reacts when a plug is pulled in the air, over the real protocols.

    python -m benchmarks.bench_plugs [--out benchmarks/results/plugs.json]

Runs the tests ``tests/deploy/test_wire_plugs_*.py``: flights in real time against simulated endpoints (CRTP over UDP,
ROS 2, MAVLink, NatNet), whose processes run on the same machine. Times are from the moment the plug is pulled to the
turn of the loop in which the reaction was seen; ``late_s`` is the most that the loop was late meanwhile.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
TESTS = ("tests/deploy/test_wire_plugs_lab.py", "tests/deploy/test_wire_plugs_field.py")


def measured() -> tuple[list[dict[str, Any]], bool, float]:
    """Runs the tests; returns what they wrote, whether they passed, and how long they took in s."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "plugs.jsonl"
        target.touch()
        begun_s = time.monotonic()
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-m", "wire", "-q", *TESTS],
            cwd=ROOT,
            env={**os.environ, "COPCS_PLUGS": str(target)},
            check=False,
        )
        took_s = time.monotonic() - begun_s
        return [json.loads(line) for line in target.read_text().splitlines()], done.returncode == 0, took_s


def table(rows: list[dict[str, Any]]) -> str:
    """The rows for ``docs/simulation.md``: of several vehicles the slowest counts."""
    lines = ["| Plug | Told | Sent | In truth |", "|---|---|---|---|"]
    for row in rows:
        cells = [_cell(row, ("told",)), _cell(row, ("sent", "asked")), _cell(row, ("really",))]
        if "oldest_telemetry_s" in row:
            cells[2] = f"mission completed; oldest telemetry {row['oldest_telemetry_s']:.2f}"
        lines.append(f"| {row['plug']} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(row: dict[str, Any], kinds: tuple[str, ...]) -> str:
    worst: dict[str, tuple[float, float]] = {}
    for r in row["reactions"]:
        if r["kind"] in kinds:
            after_s = float("inf") if r["after_s"] is None else r["after_s"]
            worst[r["label"]] = (max(after_s, worst.get(r["label"], (0.0, 0.0))[0]), r["limit_s"])
    return ", ".join(f"{label} {after_s:.2f} ({limit_s:g})" for label, (after_s, limit_s) in worst.items())


def main() -> int:
    """Prints the table, and writes the figures where wished."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--out", type=Path, help="JSON file")
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    rows, passed, took_s = measured()
    print(table(rows))
    if arguments.out is not None:
        result = {"cores": os.cpu_count(), "load_before": round(load, 2), "took_s": round(took_s, 1), "passed": passed}
        arguments.out.write_text(json.dumps({**result, "plugs": rows}, indent=1) + "\n")
    return 0 if passed else 1


if __name__ == "__main__":
    sys.exit(main())
