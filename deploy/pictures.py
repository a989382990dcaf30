"""Pictures of plans and runs on the map, world frame. matplotlib's figures are used without its global state."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import shapely
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.path import Path as Outline
from matplotlib.patheffects import withStroke

from deploy.drawing import (
    OTHER_POLYGON,
    POLYGON_COLOURS,
    ROAD_COLOUR,
    Array,
    MapDrawing,
    PlannedPath,
    planned_paths,
    vehicle_colours,
)
from deploy.errors import DeployError
from deploy.labels import Label, place
from deploy.report_history import History, charger, phase_spans
from deploy.state import UavPhase
from planner.plan import Plan, Visit
from planner.problem import Problem
from planner.roads import Roads

__all__ = ["MapDrawing", "plan_picture", "run_figure", "run_picture", "to_svg"]

INK, FAINT, ALARM = "#2B2B2B", "#8A8A8A", "#C1121F"
STYLE: Any = {
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.edgecolor": "#C8C8C8",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.axisbelow": True,
    "text.color": INK,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "svg.fonttype": "path",  # looks the same wherever it is opened
    "svg.hashsalt": "copcs",  # the same run gives the same file
    "path.simplify": True,
}
BOLT = Outline([(0.15, 1.0), (-0.55, -0.12), (-0.05, -0.12), (-0.2, -1.0), (0.55, 0.2), (0.02, 0.2), (0.15, 1.0)])
RECHARGE = "#F0B400"
TIGHT: Any = {"bbox_inches": "tight", "pad_inches": 0.08}  # maps keep their shape, so that paper is left over
MARGIN = 0.025  # of the map's size, around it: what lies on its edge is drawn whole
KM_FROM_M = 2000.0  # maps wider than this are drawn in km


def new_figure(width_in: float, height_in: float) -> Figure:
    """An empty figure; make and save it inside ``mpl.rc_context(STYLE)``."""
    return Figure(figsize=(width_in, height_in), layout="constrained", facecolor="white")


def to_svg(figure: Figure) -> str:
    """The figure as an ``<svg>`` element that fills its parent's width and refers to nothing outside."""
    buffer = BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(buffer, format="svg", metadata={"Date": None}, **TIGHT)
    text = buffer.getvalue().decode("utf-8")
    text = text[text.index("<svg") :]
    if "<metadata>" in text:
        text = text[: text.index("<metadata>")] + text[text.index("</metadata>") + len("</metadata>") :]
    head, rest = text.split(">", 1)
    kept = [part for part in head.split() if not part.startswith(("width=", "height="))]
    return " ".join(kept) + ' role="img">' + rest


def plan_picture(
    problem: Problem, plan: Plan, path: Path, roads: Roads | None = None, drawing: MapDrawing | None = None
) -> None:
    """Draws a plan into ``path`` (``.png`` or ``.svg``).

    Raises:
        DeployError: when the file cannot be written.
    """
    with mpl.rc_context(STYLE):
        drawing = drawing or _bare(problem)
        figure = new_figure(7.4, _height(drawing, 7.4))
        axes = figure.add_subplot()
        unit = draw_map(axes, drawing)
        colours = vehicle_colours(problem)
        paths, recharges = planned_paths(problem, plan, roads)
        for row in sorted(paths, key=lambda p: p.kind, reverse=True):
            if len(row.points_m):
                _draw_line(axes, row.points_m / unit, colours[row.vehicle], row.kind)
        who = {a.task: problem.uavs[a.uav].id for a in plan.actions if isinstance(a, Visit)}
        labels = draw_sites(axes, problem, unit)
        labels += draw_recharges(axes, [(r.position_m, colours[r.ugv]) for r in recharges], unit)
        draw_tasks(axes, problem, unit, {task: colours[uav] for task, uav in who.items()})
        _label_and_legend(
            axes, labels, problem, unit, _vehicle_handles(colours, problem) + _site_handles(bool(recharges))
        )
        words = (
            f"last visit after {plan.makespan_s / 60:.1f} min"
            if plan.feasible
            else f"infeasible: {plan.schedule.violation}"
        )
        axes.set_title(f"{plan.method}: {words}", loc="left", fontsize=10)
        save(figure, path)


def run_picture(history: History, drawing: MapDrawing, path: Path) -> None:
    """Draws a run into ``path`` (``.png`` or ``.svg``).

    Raises:
        DeployError: when the file cannot be written.
    """
    figure = run_figure(history, drawing)
    with mpl.rc_context(STYLE):
        save(figure, path)


def save(figure: Figure, path: Path) -> None:
    """Writes the figure, pixels at twice the usual density.

    Raises:
        DeployError: when the file cannot be written.
    """
    try:
        figure.savefig(path, dpi=200, metadata={"Date": None} if path.suffix == ".svg" else None, **TIGHT)
    except (OSError, ValueError) as error:
        raise DeployError(f"{path}: cannot write the picture: {error}; give a .png or .svg file") from error


def run_figure(history: History, drawing: MapDrawing, width_in: float = 7.4) -> Figure:
    """The map with the first plan (dashed) and what was flown and driven (solid)."""
    with mpl.rc_context(STYLE):
        figure = new_figure(width_in, _height(drawing, width_in))
        axes = figure.add_subplot()
        unit = draw_map(axes, drawing)
        problem = history.settings.problem
        colours = vehicle_colours(problem)
        fenced = _draw_fence(axes, history, unit)
        paths: Sequence[PlannedPath] = ()
        if history.plans:
            first = history.plans[0]
            paths, _ = planned_paths(first.problem or problem, first.plan, history.settings.roads)
        for row in paths:
            if len(row.points_m):
                axes.plot(
                    *(row.points_m / unit).T, color=colours[row.vehicle], lw=1.1, ls=(0, (4, 2.5)), alpha=0.75, zorder=4
                )
        span = drawing.extent[1] - drawing.extent[0]
        for v in sorted(range(len(history.ids)), reverse=True):
            trail = _thin(history.world_m[:, v], span / 3000)
            if len(trail) > 1:
                _draw_line(axes, trail / unit, colours[history.ids[v]], "uav" if v < history.n_uavs else "ugv")
        labels = draw_sites(axes, problem, unit)
        spots = []
        for u in range(history.n_uavs):
            for charge in phase_spans(history, u, UavPhase.CHARGING):
                x, y = history.world_m[charge.first, u]
                ugv = charger(history, u, charge)
                spots.append(((float(x), float(y)), colours[ugv] if ugv else INK))
        labels += draw_recharges(axes, spots, unit)
        by = {visit.task: colours[visit.uav] if visit.uav else INK for visit in history.visits}
        draw_tasks(axes, problem, unit, by)
        handles = [
            *_vehicle_handles(colours, problem),
            Line2D([], [], color=FAINT, lw=1.8, label="flown, driven"),
            Line2D([], [], color=FAINT, lw=1.1, ls=(0, (4, 2.5)), label="first plan"),
            *_site_handles(bool(spots)),
        ]
        if fenced:
            handles.append(Line2D([], [], color=ALARM, lw=1.0, ls=":", label="geofence"))
        if len(by) < problem.n_tasks:
            handles.append(_disc("white", ALARM, "task not visited"))
        _label_and_legend(axes, labels, problem, unit, handles)
    return figure


def draw_map(axes: Axes, drawing: MapDrawing) -> float:
    """Draws the map, sets up the axes, and returns how many m the axes' unit has (1000 for km)."""
    x0, x1, y0, y1 = drawing.extent
    unit, name = (1000.0, "km") if max(x1 - x0, y1 - y0) > KM_FROM_M else (1.0, "m")
    if drawing.image is not None:
        cover = np.array(drawing.image_extent or drawing.extent) / unit
        axes.imshow(drawing.image, extent=tuple(cover), cmap="gray", vmin=0, vmax=255, alpha=0.25, zorder=0)
    for kind, rings in drawing.polygons.items():
        colour = POLYGON_COLOURS.get(kind, OTHER_POLYGON)
        for ring in rings:
            axes.add_patch(Polygon(ring / unit, closed=True, facecolor=colour, edgecolor="none", zorder=1))
    for line in drawing.lines:
        axes.plot(*(line / unit).T, color=ROAD_COLOUR, lw=2.6, solid_capstyle="round", zorder=2)
    for line in drawing.lines:
        axes.plot(*(line / unit).T, color="white", lw=1.2, solid_capstyle="round", zorder=2.1)
    margin = MARGIN * max(x1 - x0, y1 - y0)
    axes.set_xlim((x0 - margin) / unit, (x1 + margin) / unit)
    axes.set_ylim((y0 - margin) / unit, (y1 + margin) / unit)
    axes.set_aspect("equal")
    axes.set_xlabel(f"east, {name}")
    axes.set_ylabel(f"north, {name}")
    axes.tick_params(length=0)
    return unit


def draw_sites(axes: Axes, problem: Problem, unit: float) -> list[Label]:
    """Draws path points and the depot; returns their labels, to be placed when everything else is drawn."""
    points = problem.path_points / unit
    if len(points):
        axes.scatter(
            points[:, 0],
            points[:, 1],
            s=26,
            marker="s",
            facecolor="white",
            edgecolor="#555555",
            linewidth=1.0,
            zorder=6,
        )
    x, y = problem.depot[0] / unit, problem.depot[1] / unit
    axes.scatter([x], [y], s=95, marker="p", facecolor=INK, edgecolor="white", linewidth=1.0, zorder=6.5)
    labels = [Label(float(p[0]), float(p[1]), f"P{i}", 8.0, "#444444") for i, p in enumerate(points)]
    return [Label(x, y, "depot", 9.0, INK, bold=True), *labels]


def draw_tasks(axes: Axes, problem: Problem, unit: float, colour_of: Mapping[int, str]) -> None:
    """Draws tasks as numbered discs in their UAV's colour; the others stay hollow."""
    size = 150 if problem.n_tasks <= 60 else 40
    for task, (x, y) in enumerate(problem.tasks / unit):
        colour = colour_of.get(task)
        face, edge, ink = (colour, "white", "white") if colour else ("white", ALARM, ALARM)
        axes.scatter([x], [y], s=size, facecolor=face, edgecolor=edge, linewidth=1.2, zorder=8)
        if size > 100:
            axes.text(
                x, y, str(task), color=ink, ha="center", va="center_baseline", fontsize=7.0, weight="bold", zorder=8.5
            )


def draw_recharges(axes: Axes, spots: Iterable[tuple[tuple[float, float], str]], unit: float) -> list[Label]:
    """Draws a bolt in a ring of the UGV's colour; returns their counts, where several are at one place, as labels."""
    x0, x1 = axes.get_xlim()
    near = (x1 - x0) / 60
    groups: list[tuple[float, float, str, int]] = []
    for (x, y), colour in spots:
        at = (x / unit, y / unit)
        for i, (gx, gy, gc, n) in enumerate(groups):
            if gc == colour and abs(gx - at[0]) < near and abs(gy - at[1]) < near:
                groups[i] = (gx, gy, gc, n + 1)
                break
        else:
            groups.append((*at, colour, 1))
    for x, y, colour, _ in groups:
        axes.scatter([x], [y], s=170, facecolor="white", edgecolor=colour, linewidth=2.0, zorder=7)
        axes.scatter([x], [y], s=75, marker=BOLT, facecolor=RECHARGE, edgecolor=INK, linewidth=0.5, zorder=7.2)
    return [Label(x, y, f"×{n}", 8.0, INK, bold=True) for x, y, _, n in groups if n > 1]


def _draw_line(axes: Axes, points: Array, colour: str, kind: str) -> None:
    width, z = (1.7, 5.0) if kind == "uav" else (3.0, 4.5)
    stroke = [withStroke(linewidth=width + 1.6, foreground="white", alpha=0.8)]
    axes.plot(*points.T, color=colour, lw=width, zorder=z, path_effects=stroke, solid_joinstyle="round")


def _draw_fence(axes: Axes, history: History, unit: float) -> bool:
    """Draws the geofence and says whether it is within the picture."""
    to_world = history.settings.frame.to_world
    ring = np.array([to_world(p) for p in history.settings.geofence.polygon_m]) / unit
    (x0, x1), (y0, y1) = axes.get_xlim(), axes.get_ylim()
    inside = (ring >= (x0, y0)).all(axis=1) & (ring <= (x1, y1)).all(axis=1)
    if not inside.all():
        return False
    axes.add_patch(Polygon(ring, closed=True, fill=False, edgecolor=ALARM, lw=1.0, ls=":", zorder=3))
    return True


def _height(drawing: MapDrawing, width_in: float) -> float:
    x0, x1, y0, y1 = drawing.extent
    return float(min(1.6, (y1 - y0) / (x1 - x0)) * (width_in - 0.6) + 1.2)


def _thin(points: Array, tolerance_m: float) -> Array:
    points = points[~np.isnan(points[:, 0])]
    if len(points) < 3:
        return points
    return np.asarray(shapely.LineString(points).simplify(tolerance_m).coords)


def _bare(problem: Problem) -> MapDrawing:
    points = np.vstack([problem.tasks, problem.sites, *(np.array([u.position]) for u in problem.uavs)])
    low, high = points.min(axis=0), points.max(axis=0)
    middle, half = (low + high) / 2, max(float((high - low).max()), 1.0) * 0.55
    return MapDrawing((middle[0] - half, middle[0] + half, middle[1] - half, middle[1] + half))


def _vehicle_handles(colours: Mapping[str, str], problem: Problem) -> list[Line2D]:
    uavs = [Line2D([], [], color=colours[u.id], lw=1.7, label=u.id) for u in problem.uavs[:12]]
    return uavs + [Line2D([], [], color=colours[g.id], lw=3.2, label=g.id) for g in problem.ugvs[:12]]


def _disc(face: str, edge: str, label: str) -> Line2D:
    return Line2D([], [], ls="", marker="o", ms=8, mfc=face, mec=edge, mew=1.2, label=label)


def _site_handles(recharges: bool) -> list[Line2D]:
    handles = [
        _disc(FAINT, "white", "task"),
        Line2D([], [], ls="", marker="s", ms=5, mfc="white", mec="#555555", label="path point"),
    ]
    if recharges:
        handles.append(Line2D([], [], ls="", marker=BOLT, ms=10, mfc=RECHARGE, mec=INK, mew=0.5, label="recharge"))
    return handles


def _label_and_legend(
    axes: Axes, labels: Sequence[Label], problem: Problem, unit: float, handles: Sequence[Line2D]
) -> None:
    columns = min(5, len(handles))
    axes.figure.legend(
        handles=list(handles), loc="outside lower center", ncols=columns, frameon=False, fontsize=9, handlelength=2.2
    )
    place(axes, labels, np.vstack([problem.tasks, problem.sites]) / unit)
