"""The example in docs/simulation.md runs, and its table of faults is complete."""

from __future__ import annotations

import re
from pathlib import Path

from sim_backends.faults import FaultKind

PAGE = (Path(__file__).parents[2] / "docs" / "simulation.md").read_text(encoding="utf-8")


def test_the_example_runs() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(compile(code, "docs/simulation.md", "exec"), {})


def test_every_fault_is_in_the_table() -> None:
    assert {str(k) for k in FaultKind} <= set(re.findall(r"^\| `(\w+)`", PAGE, re.MULTILINE))
