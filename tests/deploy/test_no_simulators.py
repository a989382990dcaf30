"""Nothing between the loop and the vehicles knows whether they are simulated."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
WORDS = re.compile(r"""simulat|sim_backends|kinematic|["']wire["']""", re.IGNORECASE)
MAY_START_THEM = {"backends.py", "wire.py", "cli.py", "cli_run.py", "cli_common.py", "cli_simulate.py", "session.py"}
"""Of ``deploy``: what starts simulators, or offers to."""
MAY_NAME_THEIR_TYPES = {"mission.py", "mission_model.py", "fleet.py", "recording_meta.py"}
"""Of ``deploy``: mission files script faults, a fleet carries its world's audit, recordings name their backend."""
OF_THE_PLAN = {"montecarlo.py", "montecarlo_kernel.py"}
"""What they simulate is a plan."""


def words_of(path: Path) -> list[str]:
    """Names and text in the code of a file that speak of simulators; comments and docstrings may."""
    source = path.read_text(encoding="utf-8")
    docs = {
        (node.value.lineno, node.value.col_offset)
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    found = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type in (tokenize.NAME, tokenize.STRING) and token.start not in docs and WORDS.search(token.string):
            found.append(f"{path.name}:{token.start[0]}: {token.string}")
    return found


def files(folder: str, *, but: set[str]) -> list[Path]:
    return [p for p in sorted((ROOT / folder).rglob("*.py")) if p.name not in but]


@pytest.mark.parametrize("path", files("drivers", but=set()), ids=lambda p: p.name)
def test_no_driver_knows(path: Path) -> None:
    assert words_of(path) == []


@pytest.mark.parametrize(
    "path", files("deploy", but=MAY_START_THEM | MAY_NAME_THEIR_TYPES | OF_THE_PLAN), ids=lambda p: p.name
)
def test_nothing_of_the_ground_station_knows(path: Path) -> None:
    assert words_of(path) == []


def test_the_search_finds_what_it_looks_for(tmp_path: Path) -> None:
    file = tmp_path / "knows.py"
    file.write_text('"""Simulated."""\n# wire\nif backend == "wire":\n    import sim_backends.world\n')
    assert [w.split(": ")[1] for w in words_of(file)] == ['"wire"', "sim_backends"]
