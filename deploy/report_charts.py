"""The report's charts over mission time: planned against actual, energy, altitude and distances."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke
from matplotlib.ticker import NullLocator

from deploy.drawing import Array, vehicle_colours
from deploy.pictures import ALARM, FAINT, INK, RECHARGE, STYLE, new_figure
from deploy.recording_read import Adopted
from deploy.report_history import History, charger, phase_spans, standstills
from deploy.report_safety import both_airborne, pair_distance_m
from deploy.state import AIRBORNE, UavPhase, UgvPhase
from planner.plan import Move, Recharge, Visit

WIDTH_IN = 11.4
WAITING = "#C9C9C9"
TAIL = "#F1F3F5"
FIRST, LATER = (0, (4, 2.5)), (0, (1, 1.4))  # dashes of what the first and the later plans predicted
POINTS = 1500  # more than the page has pixels adds only bytes


def gantt(history: History) -> Figure:
    """What each vehicle did (thick) under the plan in force at the time (thin) and, once replanned, the first plan."""
    with mpl.rc_context(STYLE):
        n = len(history.ids)
        figure = new_figure(WIDTH_IN, 1.2 + 0.68 * n)
        axes = figure.add_subplot()
        colours = vehicle_colours(history.settings.problem)
        several = len(history.plans) > 1
        for v, name in enumerate(history.ids):
            row = n - 1 - v
            if several:
                _bars(axes, _planned_bars(history, history.plans[0], v, colours[name]), row + 0.31, 0.11, alpha=0.3)
            for adopted, begin, end in _in_force(history):
                wanted = _clipped(_planned_bars(history, adopted, v, colours[name]), begin, end)
                _bars(axes, wanted, row + 0.16, 0.12, alpha=0.6)
            done = _actual_bars(history, v, colours[name])
            axes.broken_barh(
                [(x0, x1 - x0) for x0, x1, _ in done], (row - 0.3, 0.42), facecolor=[c for *_, c in done],
                edgecolor="white", lw=0.5,
            )  # fmt: skip
        _task_marks(axes, history)
        promised = history.plans[0].plan.makespan_s / 60 if history.plans else np.nan
        axes.set_xlim(0, max(_end_min(history), promised if np.isfinite(promised) else 0.0) * 1.01 or 1)
        axes.set_ylim(-0.5, n - 0.25)
        axes.set_yticks(range(n), history.ids[::-1])
        axes.tick_params(axis="y", labelsize=10, labelcolor=INK)
        handles: list[Artist] = [
            Patch(facecolor=FAINT, label="flown, driven"),
            Patch(facecolor=WAITING, label="standing, waiting"),
        ]
        handles += [Patch(facecolor=RECHARGE, label="charging"), _strip(0.6, "plan in force" if several else "plan")]
        if several:
            handles.append(_strip(0.3, "first plan"))
        lines = _replans(axes, history, label=True)
        if np.isfinite(promised):
            axes.axvline(promised, color=INK, lw=1.1, ls=":")
            lines.append(Line2D([], [], color=INK, lw=1.1, ls=":", label="first plan's last visit"))
        handles += [*lines, *_tail(axes, history)]
        _finish(axes)
        axes.spines[["top", "right", "left"]].set_visible(False)
        axes.set_xlabel("mission time, min")
        _legend(figure, handles)
    return figure


def energy(history: History) -> Figure:
    """Energy of each UAV with its reserve, its recharges and what the plans predicted."""
    with mpl.rc_context(STYLE):
        n = history.n_uavs
        columns = 1 if n <= 4 else 2
        rows = -(-n // columns)
        figure = new_figure(WIDTH_IN, 0.9 + 1.6 * rows)
        grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        colours = vehicle_colours(history.settings.problem)
        t, keep = history.mission_s / 60, _spread(len(history.mission_s))
        handles: list[Artist] = [Line2D([], [], color=FAINT, lw=1.8, label="energy")]
        if history.plans:
            handles.append(
                Line2D([], [], color=FAINT, lw=1.2, ls=FIRST, label="first plan" if len(history.plans) > 1 else "plan")
            )
        if len(history.plans) > 1:
            handles.append(Line2D([], [], color=INK, lw=1.2, ls=LATER, label="replanned"))
        handles.append(Patch(facecolor=RECHARGE, alpha=0.3, label="charging"))
        for u, uav in enumerate(history.settings.problem.uavs):
            axes: Axes = grid[u // columns, u % columns]
            for span in phase_spans(history, u, UavPhase.CHARGING):
                axes.axvspan(span.start_s / 60, span.end_s / 60, color=RECHARGE, alpha=0.22, lw=0)
            axes.plot(t[keep], history.energy_j[keep, u] / 1000, color=colours[uav.id], lw=1.8)
            for adopted in history.plans[:1]:
                axes.plot(*_planned_energy(adopted, u, uav.energy_j), color=FAINT, lw=1.2, ls=FIRST)
            for adopted, begin, end in _in_force(history)[1:]:
                have = adopted.problem.uavs[u].energy_j if adopted.problem else np.nan
                x, y = _within(*_planned_energy(adopted, u, have), begin, end)
                axes.plot(x, y, color=INK, lw=1.2, ls=LATER)
            axes.axhline(uav.reserve_j / 1000, color=ALARM, lw=1.0)
            axes.set_ylim(0, uav.capacity_j / 1000 * 1.08)
            axes.set_xlim(0, _end_min(history) * 1.01 or 1)
            _named(axes, uav.reserve_j / 1000, "reserve", above=False)
            marks = [*_replans(axes, history), *_tail(axes, history)]
            _finish(axes)
            axes.set_ylabel("energy, kJ")
            axes.set_title(uav.id, loc="left", pad=3, fontsize=10, color=colours[uav.id], weight="bold")
        for axes in grid[-1]:
            axes.set_xlabel("mission time, min")
        for u in range(n, rows * columns):
            grid[u // columns, u % columns].set_visible(False)
        _legend(figure, [*handles, *marks])
    return figure


def flight(history: History) -> Figure:
    """Altitude of every UAV under the ceiling and, below it, how close the nearest two in the air were."""
    with mpl.rc_context(STYLE):
        pairs = list(combinations(range(history.n_uavs), 2))
        figure = new_figure(WIDTH_IN, 4.3 if pairs else 2.5)
        grid = figure.subplots(2 if pairs else 1, 1, sharex=True, squeeze=False)[:, 0]
        t, keep = history.mission_s / 60, _spread(len(history.mission_s))
        colours = vehicle_colours(history.settings.problem)
        axes = grid[0]
        handles: list[Artist] = []
        for u, name in enumerate(history.ids[: history.n_uavs]):
            handles += axes.plot(t[keep], history.position_m[keep, u, 2], color=colours[name], lw=1.5, label=name)
        for axes in grid:
            axes.set_xlim(0, _end_min(history) * 1.01 or 1)
            marks = [*_replans(axes, history), *_tail(axes, history)]
            _finish(axes)
        axes = grid[0]
        ceiling = history.settings.geofence.ceiling_m
        axes.axhline(ceiling, color=ALARM, lw=1.0)
        axes.set_ylim(0, ceiling * 1.2)
        _named(axes, ceiling, "ceiling", above=True)
        axes.set_ylabel("altitude, m")
        if pairs and len(t):
            axes = grid[1]
            limit_m = history.settings.separation.horizontal_m
            flat, steep = _nearest(history, pairs)
            handles += axes.plot(t[: len(flat)], flat, color="#5B6C8F", lw=1.4, label="distance of the nearest two")
            handles.append(
                axes.scatter(t[: len(steep)], steep, s=7, color=INK, zorder=4, label="the same, on one level")
            )
            axes.axhline(limit_m, color=ALARM, lw=1.0)
            axes.set_yscale("log")
            axes.yaxis.set_major_formatter(lambda y, _: f"{y:,g}")
            axes.yaxis.set_minor_locator(NullLocator())
            axes.set_ylim(bottom=limit_m / 3)
            _named(axes, limit_m, "least allowed on one level", above=False)
            axes.set_ylabel("horizontal, m")
        grid[-1].set_xlabel("mission time, min")
        _legend(figure, [*handles, *marks])
    return figure


def _nearest(history: History, pairs: Iterable[tuple[int, int]]) -> tuple[Array, Array]:
    """Least horizontal distance of any two airborne UAVs per interval, and of those on one level; nan where none."""
    limit = history.settings.separation.vertical_m
    flat = np.full(max(1, len(history.mission_s) - 1), np.inf)
    level = flat.copy()
    for a, b in pairs:
        distance, vertical = pair_distance_m(history, a, b)
        distance = np.where(both_airborne(history, a, b), distance, np.inf)
        flat = np.minimum(flat, distance)
        level = np.minimum(level, np.where(vertical < limit, distance, np.inf))
    for series in (flat, level):
        series[~np.isfinite(series)] = np.nan
    return flat, level


def _planned_bars(history: History, adopted: Adopted, vehicle: int, colour: str) -> list[tuple[float, float, str]]:
    """(start, end, colour) in min of what the plan wanted of one vehicle."""
    bars = []
    n, zero = history.n_uavs, adopted.zero_s
    for row in adopted.plan.schedule.actions:
        action = adopted.plan.actions[row.action]
        start, arrive, work, end = ((zero + s) / 60 for s in (row.start_s, row.arrive_s, row.work_s, row.end_s))
        match action:
            case Visit(uav, _) if uav == vehicle:
                bars.append((start, end, colour))
            case Move(ugv, _) if ugv + n == vehicle:
                bars.append((start, end, colour))
            case Recharge(uav, ugv) if vehicle in (uav, ugv + n):
                if uav == vehicle:
                    bars += [(start, arrive, colour), (arrive, work, WAITING)]
                bars.append((work, end, RECHARGE))
    for last in adopted.plan.schedule.recovery:
        if last.uav == vehicle:
            bars.append(((zero + last.start_s) / 60, (zero + last.end_s) / 60, colour))
    return [bar for bar in bars if np.isfinite(bar[:2]).all()]


def _actual_bars(history: History, vehicle: int, colour: str) -> list[tuple[float, float, str]]:
    """(start, end, colour) in min of what one vehicle did."""
    of_phase = {str(phase): colour for phase in AIRBORNE} | {
        str(UavPhase.WAITING): WAITING,
        str(UavPhase.CHARGING): RECHARGE,
        str(UgvPhase.DRIVING): colour,
        str(UgvPhase.HOLDING): WAITING,
    }
    bars: list[tuple[float, float, str]] = []
    for span in history.spans(vehicle):
        tone = of_phase.get(span.phase)
        if tone is None or span.end_s <= span.start_s:
            continue
        start = bars.pop()[0] if bars and bars[-1][1:] == (span.start_s / 60, tone) else span.start_s / 60
        bars.append((start, span.end_s / 60, tone))
    bars += [(s.start_s / 60, s.end_s / 60, WAITING) for s in standstills(history, vehicle)]
    if vehicle >= history.n_uavs:
        name = history.ids[vehicle]
        for u in range(history.n_uavs):
            charges = [s for s in phase_spans(history, u, UavPhase.CHARGING) if charger(history, u, s) == name]
            bars += [(s.start_s / 60, s.end_s / 60, RECHARGE) for s in charges]
    return bars


def _task_marks(axes: Axes, history: History) -> None:
    """Task numbers at the moments of the visits; those that would cover another are left out."""
    width = float(history.mission_s.max(initial=60.0)) / 60
    last: dict[str, float] = {}
    for visit in history.visits:
        if visit.uav is None:
            continue
        x, row = visit.time_s / 60, len(history.ids) - 1 - history.ids.index(visit.uav)
        axes.plot([x, x], [row - 0.3, row + 0.12], color="white", lw=1.6)
        if x - last.get(visit.uav, -1e9) < width * (0.003 + 0.006 * len(str(visit.task))):
            continue
        last[visit.uav] = x
        axes.text(
            x, row - 0.09, str(visit.task), ha="right", va="center", fontsize=7.5, color="white", weight="bold",
            path_effects=[withStroke(linewidth=1.6, foreground=INK, alpha=0.55)],
        )  # fmt: skip


def _planned_energy(adopted: Adopted, uav: int, start_j: float) -> tuple[list[float], list[float]]:
    ready_s = adopted.problem.uavs[uav].ready_s if adopted.problem else 0.0
    times, joules = [adopted.zero_s + ready_s], [start_j]
    for row in adopted.plan.schedule.actions:
        action = adopted.plan.actions[row.action]
        if isinstance(action, Move) or action.uav != uav:
            continue
        times.append(adopted.zero_s + (row.work_s if isinstance(action, Recharge) else row.end_s))
        joules.append(row.energy_arrive_j if isinstance(action, Recharge) else row.energy_end_j)
        if isinstance(action, Recharge):
            times.append(adopted.zero_s + row.end_s)
            joules.append(row.energy_end_j)
    for last in adopted.plan.schedule.recovery:
        if last.uav == uav:
            times.append(adopted.zero_s + last.end_s)
            joules.append(last.energy_end_j)
    return [s / 60 for s in times], [j / 1000 for j in joules]


def _in_force(history: History) -> list[tuple[Adopted, float, float]]:
    """Each plan with the time in min from which and to which it was in force; the last one to its own end."""
    changes = [history.to_mission_s(adopted.time_s) / 60 for adopted in history.plans[1:]]
    return list(zip(history.plans, [-np.inf, *changes], [*changes, np.inf], strict=False))


def _clipped(bars: list[tuple[float, float, str]], begin: float, end: float) -> list[tuple[float, float, str]]:
    return [(max(a, begin), min(b, end), colour) for a, b, colour in bars if a < end and b > begin]


def _within(x: list[float], y: list[float], begin: float, end: float) -> tuple[Array, Array]:
    """The part of a line, given by its corners, from x ``begin`` to ``end``."""
    start, stop = max(begin, x[0]), min(end, x[-1])
    at = np.array(sorted({start, stop, *(v for v in x if start < v < stop)})) if start < stop else np.zeros(0)
    return at, np.interp(at, x, y)


def _bars(axes: Axes, bars: list[tuple[float, float, str]], bottom: float, height: float, alpha: float) -> None:
    spans, colours = [(x0, x1 - x0) for x0, x1, _ in bars], [colour for *_, colour in bars]
    axes.broken_barh(spans, (bottom, height), facecolor=colours, alpha=alpha, lw=0)


def _strip(alpha: float, label: str) -> Line2D:
    return Line2D([], [], color=INK, lw=3, alpha=alpha, solid_capstyle="butt", label=label)


def _end_min(history: History) -> float:
    return float(history.mission_s.max(initial=0.0)) / 60


def _tail(axes: Axes, history: History) -> list[Artist]:
    """Shades what came after the last visit, if anything did; returns what the legend says of it."""
    last, end = max((v.time_s for v in history.visits), default=0.0) / 60, axes.get_xlim()[1]
    if len(history.visits) < history.settings.problem.n_tasks or last >= _end_min(history):
        return []
    axes.axvspan(last, end, color=TAIL, lw=0, zorder=0)
    return [Patch(facecolor=TAIL, label="after the last visit")]


def _named(axes: Axes, y: float, text: str, *, above: bool) -> None:
    """Writes what a level line is at its right end."""
    axes.annotate(
        text, (1.0, y), xycoords=("axes fraction", "data"), xytext=(-3, 2 if above else -2),
        textcoords="offset points", ha="right", va="bottom" if above else "top", fontsize=8, color=ALARM,
        path_effects=[withStroke(linewidth=2, foreground="white", alpha=0.8)],
    )  # fmt: skip


def _legend(figure: Figure, handles: Sequence[Artist]) -> None:
    columns = len(handles) if len(handles) <= 6 else -(-len(handles) // 2)
    figure.legend(handles=list(handles), loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def _replans(axes: Axes, history: History, label: bool = False) -> list[Artist]:
    """A line for each replan; those close together share a label. Returns what the legend says of them."""
    times = [history.to_mission_s(adopted.time_s) / 60 for adopted in history.plans[1:]]
    for x in times:
        axes.axvline(x, color=ALARM, lw=1.1, ls="--", zorder=0.5)
    if label:
        _replan_labels(axes, times)
    return [Line2D([], [], color=ALARM, lw=1.1, ls="--", label="replan")] if times else []


def _replan_labels(axes: Axes, times: list[float]) -> None:
    room = axes.get_xlim()[1] * 0.075
    groups: list[tuple[float, list[str]]] = []
    for number, x in enumerate(times, start=1):
        if groups and x - groups[-1][0] < room:
            groups[-1][1].append(str(number))
        else:
            groups.append((x, [str(number)]))
    for x, numbers in groups:
        shown = numbers if len(numbers) <= 3 else [numbers[0], "…", numbers[-1]]
        axes.annotate(
            f"replan {', '.join(shown)}", (x, 1.0), xycoords=("data", "axes fraction"), xytext=(3, -1),
            textcoords="offset points", va="top", fontsize=8, color=ALARM,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )  # fmt: skip


def _finish(axes: Axes) -> None:
    axes.grid(axis="x", color="#EDEDED", lw=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(length=0)


def _spread(n: int) -> list[int]:
    """At most ``POINTS`` indices, evenly over n, both ends included."""
    return sorted({round(i) for i in np.linspace(0, max(0, n - 1), min(n, POINTS)).tolist()})
