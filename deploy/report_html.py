"""``report.html``: one page that needs nothing else, made from ``templates/report.html``."""

from __future__ import annotations

import datetime as dt
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from deploy import pictures, report_charts
from deploy.drawing import MapDrawing, vehicle_colours
from deploy.events import EventKind
from deploy.report import Report
from deploy.report_history import History

ROUTINE = frozenset(
    {
        EventKind.TASK_VISITED,
        EventKind.RECHARGE_STARTED,
        EventKind.RECHARGE_DONE,
        EventKind.UGV_ARRIVED,
        EventKind.UAV_DOWN,
    }
)
VERDICTS = {"done": "Mission done", "failed": "Mission failed", "aborted": "Mission aborted"}


def page(report: Report, history: History, drawing: MapDrawing) -> str:
    """The page, as HTML with everything inside."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(clock=clock, km=km, kj=kj, metres=metres, words=words)
    started = dt.datetime.fromtimestamp(history.meta.started_unix_s, dt.UTC)
    return environment.get_template("report.html").render(
        r=report,
        verdict=VERDICTS[report.outcome],
        started=started.strftime("%Y-%m-%d %H:%M UTC"),
        colours=vehicle_colours(history.settings.problem),
        arena_scale=history.settings.frame.scale,
        separation=history.settings.separation,
        map=_svg(pictures.run_figure(history, drawing, width_in=5.6)),
        gantt=_svg(report_charts.gantt(history)),
        energy=_svg(report_charts.energy(history)),
        flight=_svg(report_charts.flight(history)),
        events=[
            {
                "time": clock(max(0.0, history.to_mission_s(event.time_s))),
                "severity": event.severity.name.lower(),
                "kind": words(event.kind.value),
                "vehicle": event.vehicle or "mission",
                "text": event.text,
                "action": words(event.action.name.lower()),
                "routine": event.kind in ROUTINE,
            }
            for event in history.events
        ],
    )


def _svg(figure: Figure) -> Markup:
    return Markup(pictures.to_svg(figure))


def clock(seconds: float | None) -> str:
    """Mission time as m:ss or h:mm:ss."""
    if seconds is None:
        return "–"
    whole = abs(round(seconds))
    sign = "−" if seconds < 0 and whole else ""
    hours, rest = divmod(whole, 3600)
    minutes, left = divmod(rest, 60)
    return f"{sign}{hours}:{minutes:02}:{left:02}" if hours else f"{sign}{minutes}:{left:02}"


def km(metres_: float | None) -> str:
    """A way: in km from 1 km."""
    if metres_ is None:
        return "–"
    return f"{metres_ / 1000:.2f} km" if metres_ >= 1000 else f"{metres_:.1f} m"


def metres(value: float | None) -> str:
    """A distance in m, with as many digits as matter."""
    if value is None:
        return "–"
    return f"{value:.2f} m" if abs(value) < 10 else f"{value:.1f} m" if abs(value) < 1000 else f"{value:,.0f} m"


def kj(joules: float | None) -> str:
    """An energy, in kJ or MJ."""
    if joules is None:
        return "–"
    text = f"{joules / 1e6:.2f} MJ" if abs(joules) >= 1e6 else f"{joules / 1e3:.1f} kJ"
    return text.replace("-", "−")


def words(name: str) -> str:
    """``pose_stale`` as people write it."""
    return name.replace("_", " ")
