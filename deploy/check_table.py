"""The checks as a table for the terminal."""

from __future__ import annotations

from rich import box
from rich.table import Table
from rich.text import Text

from deploy.check_report import CheckReport, CheckRow, Verdict

_STYLE = {Verdict.PASS: "green", Verdict.WARN: "yellow", Verdict.FAIL: "bold red", Verdict.NOT_RUN: "dim"}


def check_table(report: CheckReport) -> Table:
    """A rich table: verdict, name, measured and limit, and what it means; one section per group."""
    # no frame: at 80 columns the words need the room
    table = Table(
        title="Pre-flight checks", caption=report.summary, header_style="bold", box=box.SIMPLE_HEAD, show_edge=False,
        pad_edge=False, padding=(0, 2, 0, 0),
    )  # fmt: skip
    table.add_column("", no_wrap=True)
    table.add_column("check", no_wrap=True)
    table.add_column("measured", justify="right", no_wrap=True)
    table.add_column("limit", justify="right", no_wrap=True)
    table.add_column("what it means", overflow="fold")
    group = None
    for row in report.rows:
        if group is not None and row.group != group:
            table.add_section()
        group = row.group
        style = _STYLE[row.verdict]
        table.add_row(
            Text(row.verdict.value, style=style),
            Text(row.name),
            Text(shown(row.measured, row.unit)),
            Text(shown(row.limit, row.unit)),
            Text(row.text, style=style if row.verdict in (Verdict.WARN, Verdict.FAIL) else ""),
        )
    return table


def check_lines(report: CheckReport) -> list[str]:
    """The same as plain lines, for pipes and logs."""
    lines = [_line(row) for row in report.rows]
    return [*lines, report.summary]


def _line(row: CheckRow) -> str:
    numbers = "" if row.measured is None else f" [{shown(row.measured, row.unit)}"
    if numbers:
        numbers += "]" if row.limit is None else f", limit {shown(row.limit, row.unit)}]"
    return f"{row.verdict.value.upper():7s} {row.name}{numbers}: {row.text}"


def shown(value: float | None, unit: str) -> str:
    """A number with its unit; shares as percentages; a dash where there is none."""
    if value is None:
        return "-"
    if unit == "" or unit.startswith("of "):
        return f"{100 * value:.1f} %"
    return f"{value:.4g} {unit}"
