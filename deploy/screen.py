"""The live screen as a picture of one ``Status``: pure, so that tests can look at it at any width."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from rich import box
from rich.console import Group, RenderableType
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from deploy.events import Event, Severity
from deploy.status import Status, VehicleStatus

_STATE_STYLE = {
    "disarmed": "bold white on grey37",
    "checked": "bold white on grey37",
    "armed": "bold black on yellow3",
    "running": "bold white on dark_green",
    "holding": "bold black on dark_orange",
    "recovering": "bold black on dark_orange",
    "done": "bold white on dodger_blue3",
    "aborted": "bold white on red3",
}
_PHASE_STYLE = {
    "lost": "bold red",
    "holding": "dark_orange",
    "charging": "yellow3",
    "flying": "cyan",
    "driving": "cyan",
}
_EVENT_STYLE = {
    Severity.INFO: "default",
    Severity.WARNING: "yellow3",
    Severity.ERROR: "red",
    Severity.CRITICAL: "bold white on red3",
}
_HINT = "Ctrl-C: bring everybody down · twice: stop all motors"
WIDE = 110
"""From this width on positions and longer bars fit."""
_FRAME = 8
"""Lines that are neither vehicles nor events, with one to spare for the cursor."""


@dataclass(frozen=True, slots=True)
class Header:
    """What does not change during a run.

    Attributes:
        mission: its name.
        subtitle: fleet, backend, planner and seed in words.
        tasks: how many there are.
        time_scale: arena seconds per mission second.
    """

    mission: str
    subtitle: str
    tasks: int
    time_scale: float = 1.0


def clock_text(seconds: float) -> str:
    """Seconds as h:mm:ss."""
    whole = round(seconds)
    return f"{whole // 3600}:{whole // 60 % 60:02}:{whole % 60:02}"


def what_text(event: Event) -> str:
    """An event's text without the name of its vehicle in front, for where that stands before it already."""
    return event.text.removeprefix(f"{event.vehicle} ")


def bar(fraction: float, width: int, style: str) -> Text:
    """A bar of ``width`` cells, to an eighth of a cell."""
    cells = min(max(fraction, 0.0), 1.0) * width if math.isfinite(fraction) else 0.0
    full, eighth = int(cells), int((cells - int(cells)) * 8)
    filled = "█" * full + (" ▏▎▍▌▋▊▉"[eighth] if eighth else "")
    return Text.assemble((filled, f"{style} on grey23"), (" " * (width - len(filled)), "on grey23"))


def render(header: Header, status: Status, events: Sequence[Event], width: int, height: int) -> RenderableType:
    """The whole screen, at the most ``height`` lines."""
    rows = max(1, min(len(status.vehicles), height - _FRAME - 3))
    more = rows < len(status.vehicles)
    left = max(1, min(8, height - _FRAME - rows - more))
    parts: list[RenderableType] = [
        _head(status, width),
        Text(),
        _vehicles(status.vehicles[:rows], width),
    ]
    if more:
        parts.append(Text(f" and {len(status.vehicles) - rows} more vehicles", style="dim"))
    parts += [Text(), _events(status, events[-left:], left, header.time_scale)]
    return Panel(
        Group(*parts),
        title=Text.assemble(("copcs-deploy", "bold"), " · ", header.mission, (f" · {header.subtitle}", "dim")),
        title_align="left",
        subtitle=Text(_HINT, style="dim"),
        subtitle_align="left",
        border_style="grey50",
        box=box.ROUNDED,
        width=min(width, 140),
    )


def _head(status: Status, width: int) -> RenderableType:
    done, total = sum(status.tasks_visited), len(status.tasks_visited)
    state = Text(f" {status.mission_state.upper()} ", style=_STATE_STYLE.get(status.mission_state.lower(), "bold"))
    tasks = Text.assemble("tasks ", bar(done / total if total else 1.0, 24 if width >= WIDE else 12, "green3"))
    tasks.append(f" {done}/{total}")
    clock = Text(clock_text(status.mission_s), style="bold")
    end_s = status.predicted_makespan_s
    if (
        end_s is not None and math.isfinite(end_s) and end_s >= status.mission_s
    ):  # after the last visit it means nothing
        clock.append(f" of {clock_text(end_s)}", style="not bold dim")
    plan = Text(_plan(status.plan_number), style="dim")
    grid = Table.grid(expand=True, padding=(0, 2))
    grid.add_column(no_wrap=True, min_width=12)  # the longest state, so that nothing moves when it changes
    grid.add_column(no_wrap=True, min_width=tasks.cell_len)
    grid.add_column(no_wrap=True, ratio=1)
    grid.add_column(no_wrap=True, justify="right")
    grid.add_row(state, tasks, plan, clock)
    return grid


def _plan(number: int) -> str:
    return "first plan" if number == 0 else f"{number} replan{'s' if number > 1 else ''}"


def _vehicles(vehicles: Sequence[VehicleStatus], width: int) -> RenderableType:
    wide = width >= WIDE
    table = Table(box=box.SIMPLE_HEAD, expand=True, padding=(0, 1), show_edge=False, header_style="dim")
    table.add_column("vehicle", no_wrap=True, min_width=6)
    table.add_column("state", no_wrap=True, min_width=10)
    table.add_column("doing", no_wrap=True, ratio=1, overflow="ellipsis")
    if wide:
        table.add_column("at x, y, z (m)", justify="right", no_wrap=True)
    table.add_column("energy", no_wrap=True)
    table.add_column("slack", justify="right", no_wrap=True, min_width=7)
    for v in vehicles:
        cells: list[RenderableType] = [
            Text(v.vehicle, style="bold"),
            Text(v.phase.replace("_", " "), style=_PHASE_STYLE.get(v.phase, "default")),
            Text(v.doing),
        ]
        if wide:
            cells.append(Text(_position(v), style="dim"))
        table.add_row(*cells, _energy(v.energy_fraction, 20 if wide else 10), _slack(v.slack_s))
    return table


def _energy(fraction: float, width: int) -> Text:
    if not math.isfinite(fraction):
        return Text("unknown", style="dim")
    style = "green3" if fraction > 0.5 else "yellow3" if fraction > 0.25 else "red"
    return Text.assemble(bar(fraction, width, style), f" {100 * fraction:3.0f} %")


def _slack(slack_s: float | None) -> Text:
    if slack_s is None or not math.isfinite(slack_s):
        return Text("-", style="dim")
    style = "red" if slack_s < 0 else "yellow3" if slack_s < 30 else "default"
    if slack_s > 36_000:
        return Text("> 10 h", style="dim")
    return Text(f"{slack_s:.0f} s" if abs(slack_s) < 600 else f"{slack_s / 60:.0f} min", style=style)


def _position(v: VehicleStatus) -> str:
    if v.position_m is None:
        return "no pose"
    digits = 2 if max(abs(c) for c in v.position_m) < 100 else 0
    return " ".join(f"{round(c, digits) + 0.0:.{digits}f}" for c in v.position_m)  # + 0.0: no minus zero


def _events(status: Status, events: Sequence[Event], lines: int, time_scale: float) -> RenderableType:
    start_s = status.now_s - status.mission_s * time_scale
    grid = Table.grid(expand=True, padding=(0, 1))
    grid.add_column(no_wrap=True, justify="right", style="dim", min_width=8)
    grid.add_column(no_wrap=True, ratio=1, overflow="ellipsis")
    for event in events:
        mission_s = max(0.0, (event.time_s - start_s) / time_scale)
        who = "" if event.vehicle is None else f"{event.vehicle} "
        grid.add_row(
            clock_text(mission_s), Text.assemble((who, "bold"), (what_text(event), _EVENT_STYLE[event.severity]))
        )
    for _ in range(lines - len(events)):
        grid.add_row("", "")
    return grid
