"""Who has connected already: one row each, as a picture for the terminal or as plain lines."""

from __future__ import annotations

import time

from rich.console import Console, ConsoleOptions, RenderResult
from rich.spinner import Spinner
from rich.table import Table
from rich.text import Text

from deploy.startup import Phase

_MARKS: dict[Phase, tuple[str, str]] = {"ready": ("✓", "green3"), "failed": ("✗", "bold red")}


class StartupScreen:
    """Rows in the order in which they were first told of; redraws itself."""

    def __init__(self) -> None:
        self._rows: dict[str, tuple[Phase, str]] = {}
        self._begun_s = time.monotonic()
        self._spinner = Spinner("dots")

    def tell(self, name: str, phase: Phase, text: str) -> None:
        """What has become of one of them."""
        self._rows[name] = (phase, text)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """The table as it is now."""
        table = Table.grid(padding=(0, 1))
        table.add_column(no_wrap=True)
        table.add_column(no_wrap=True)
        table.add_column(overflow="fold")
        for name, (phase, text) in self._rows.items():
            if phase == "connecting":
                passed = f"connecting, {time.monotonic() - self._begun_s:.0f} s"
                table.add_row(self._spinner, Text(name), Text(passed, style="dim"))
            else:
                mark, style = _MARKS[phase]
                words = f"ready {text}" if phase == "ready" else text
                table.add_row(Text(mark, style=style), Text(name), Text(words, style="dim" if phase == "ready" else ""))
        yield table


def startup_line(name: str, phase: Phase, text: str) -> str | None:
    """One of them as a line; None where it is not worth one."""
    if phase == "connecting":
        return None
    return f"{name}: ready {text}" if phase == "ready" else f"{name}: failed: {text.removeprefix(f'{name}: ')}"
