import contextlib
import io
import math
import os

import pytest
from rich.console import Console

from deploy.display import LiveDisplay, NullDisplay, PlainDisplay, SteadyConsole, make_display
from deploy.events import Action, Event, EventKind, Severity
from deploy.screen import Header, bar, clock_text, render
from deploy.status import Status, VehicleStatus

HEADER = Header("demo", "2 UAVs, 2 UGVs, kinematic, search, seed 1", tasks=15, time_scale=0.5)


def vehicle(name: str, **changes: object) -> VehicleStatus:
    values: dict[str, object] = {
        "vehicle": name,
        "kind": name[:3],
        "phase": "flying",
        "position_m": (1.0, 2.0, 3.0),
        "yaw_rad": 0.0,
        "energy_j": 1.0,
        "energy_fraction": 0.5,
        "doing": "task 7",
        "goal_m": None,
        "slack_s": 45.0,
    }
    return VehicleStatus(**{**values, **changes})  # type: ignore[arg-type]


def status(vehicles: int = 4, **changes: object) -> Status:
    rows = tuple(vehicle(f"uav{i}") for i in range(vehicles))
    values: dict[str, object] = {
        "now_s": 110.0,
        "mission_s": 200.0,
        "mission_state": "running",
        "tasks_visited": (True, False, False),
        "plan_number": 1,
        "predicted_makespan_s": 3960.0,
        "vehicles": rows,
    }
    return Status(**{**values, **changes})  # type: ignore[arg-type]


def event(text: str = "task 7 visited", severity: Severity = Severity.INFO, time_s: float = 60.0) -> Event:
    return Event(time_s, EventKind.TASK_VISITED, severity, "uav0", Action.NOTE, text)


def picture(width: int, height: int = 24, **changes: object) -> list[str]:
    console = Console(width=width, height=height, file=io.StringIO(), force_terminal=True, color_system=None)
    console.print(render(HEADER, status(**changes), [event()], width, height))  # type: ignore[arg-type]
    return console.file.getvalue().splitlines()  # type: ignore[attr-defined]


@pytest.mark.parametrize("width", [60, 80, 120, 200])
@pytest.mark.parametrize("vehicles", [1, 4, 40])
def test_screen_fits(width: int, vehicles: int) -> None:
    lines = picture(width, vehicles=vehicles)
    assert len(lines) <= 24
    assert all(len(line) <= width for line in lines)


def test_screen_shows_what_matters() -> None:
    text = "\n".join(picture(80))
    for words in ("RUNNING", "1/3", "0:03:20 of 1:06:00", "1 replan ", "uav0", "task 7", "50 %", "45 s", "Ctrl-C"):
        assert words in text
    # an event at loop time 60 of a mission that began at 10 and runs twice as fast as its clock
    assert "0:01:40" in text


def test_what_is_over_or_said_already_is_left_out() -> None:
    def shown(**changes: object) -> str:
        console = Console(width=80, file=io.StringIO(), color_system=None)
        console.print(render(HEADER, status(**changes), [event("uav0 has visited task 7 (1/15)")], 80, 24))  # type: ignore[arg-type]
        return console.file.getvalue()  # type: ignore[attr-defined, no-any-return]

    assert "first plan" in shown(plan_number=0)
    assert "2 replans" in shown(plan_number=2)
    assert "0:03:20 of 0:03:20" in shown(predicted_makespan_s=200.0)
    assert " of " not in shown(predicted_makespan_s=199.0)  # the last visit is over
    assert shown().count("uav0 has visited task 7") == 1
    assert "uav0 uav0" not in shown()


def test_screen_of_a_vehicle_of_which_nothing_is_known() -> None:
    console = Console(width=120, file=io.StringIO(), color_system=None)
    unknown = vehicle("uav0", position_m=None, slack_s=None, energy_fraction=math.nan)
    console.print(render(HEADER, status(vehicles=0, predicted_makespan_s=None, tasks_visited=()), [], 120, 24))
    console.print(render(HEADER, status(vehicles=0) and Status(0, 0, "armed", (), 0, None, (unknown,)), [], 120, 24))
    assert "no pose" in console.file.getvalue()  # type: ignore[attr-defined]


def test_clock_and_bar() -> None:
    assert clock_text(0) == "0:00:00"
    assert clock_text(3725.4) == "1:02:05"
    assert bar(0.5, 10, "green").plain == "█████     "
    assert bar(7.0, 3, "green").plain == "███"
    assert bar(-1.0, 3, "green").plain == "   "


def test_plain_lines() -> None:
    stream = io.StringIO()
    display = PlainDisplay(stream)
    display.note("planning")
    display.begin(HEADER)
    display.update(status(), [event(), event("ugv1 stalls", Severity.WARNING)])
    display.update(None, [event("later", time_s=61.0)])
    display.end()
    lines = stream.getvalue().splitlines()
    assert lines[0] == "planning"
    assert lines[1] == "flying demo: 15 tasks, 2 UAVs, 2 UGVs, kinematic, search, seed 1"
    assert lines[2].split() == ["0:01:40", "uav0", "task", "7", "visited"]
    assert "warning: ugv1 stalls" in lines[3]
    assert "0:01:42" in lines[4]
    assert not display.due()


def test_a_closed_pipe_does_not_end_the_flight() -> None:
    read, write = os.pipe()
    os.close(read)
    stream = os.fdopen(write, "w")
    display = PlainDisplay(stream)
    display.update(status(), [event("x" * 100_000)])
    live = LiveDisplay(SteadyConsole(file=stream, force_terminal=True))
    live.begin(HEADER)
    live.update(status(), [event()])
    live.end()
    with contextlib.suppress(BrokenPipeError):
        stream.close()


def test_live_display_draws_ten_times_a_second_at_most(monkeypatch: pytest.MonkeyPatch) -> None:
    now = 100.0
    monkeypatch.setattr("deploy.display.time.monotonic", lambda: now)
    console = Console(file=io.StringIO(), force_terminal=True, width=80, height=24)
    display = LiveDisplay(console)
    display.note("planning")
    display.update(status(), [])  # nothing to draw on yet
    display.begin(HEADER)
    assert display.due()
    display.update(status(), [event("first")])
    drawn = len(console.file.getvalue())  # type: ignore[attr-defined]
    assert drawn > 0
    assert not display.due()
    display.update(status(), [event("second")])
    assert len(console.file.getvalue()) == drawn  # type: ignore[attr-defined]
    now += 0.2
    display.update(None, [])
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert "first" in text and "second" in text
    display.end()
    display.end()


def test_display_suits_where_output_goes(capsys: pytest.CaptureFixture[str]) -> None:
    assert isinstance(make_display(quiet=True), NullDisplay)
    assert isinstance(make_display(quiet=False), PlainDisplay)
    nothing = NullDisplay()
    nothing.note("x")
    nothing.begin(HEADER)
    nothing.update(status(), [event()])
    nothing.end()
    assert not nothing.due()
    assert capsys.readouterr().out == ""
