"""The benchmark's results as the paper's table (Markdown) and as a plot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from planner.benchmark import Entry, Row
from planner.benchmark_compare import BASELINES, against_baselines, against_paper, against_search, solved
from planner.instances import DATA_SETS
from planner.paper import METHODS, PAPER
from planner.presets import PRESETS, TEAMS

COMPARABLE = """\
**What can be compared.** All rows of this run: the same instances, the same evaluator, the same machine, one core each
(two where a row says so). Ratios between methods of one run. **What cannot:** absolute figures with the paper's. Its
maps, tasks, recharge times, docks and what waiting costs are not published; ours are in docs/instances.md and
docs/planning.md. The paper's baselines are our reading of a scheme that it names but does not describe; its UGV
energies fit UGVs that tour all path points (`-tour`), the scheme in the literature stops as rarely as it can (`gls`,
`ts`, `sa`).

Means over the test instances of each data set, plus or minus the standard error, over feasible plans only: a method
that is feasible on fewer is judged on the easier ones. Energies are flying and hovering (UAV), driving and standing
(UGV); the energy given to UAVs is in neither. Rows with fewer instances (see the feasible plans) are not to be compared
with others by their means; the comparisons below are over the same instances.
"""


@dataclass(frozen=True, slots=True)
class Cell:
    """One method on one data set: means and standard errors of makespan (s), UAV and UGV energy (kJ)."""

    count: int
    feasible: int
    means: tuple[float, float, float]
    errors: tuple[float, float, float]
    planning_s: float
    gap: float | None
    proven: int


def cells(rows: Sequence[Row]) -> dict[tuple[str, str], Cell]:
    """By data set and entry."""
    grouped: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        grouped.setdefault((row.data_set, row.entry), []).append(row)
    return {key: _cell(group) for key, group in grouped.items()}


def _cell(rows: Sequence[Row]) -> Cell:
    fine = [r for r in rows if r.feasible]
    values = np.array([(r.makespan_s, r.uav_energy_j / 1e3, r.ugv_energy_j / 1e3) for r in fine]).reshape(-1, 3)
    means, errors = [math.nan] * 3, [math.nan] * 3
    if len(fine) > 0:
        means = values.mean(axis=0).tolist()
    if len(fine) > 1:
        errors = (values.std(axis=0, ddof=1) / math.sqrt(len(fine))).tolist()
    bounded = [r for r in fine if r.lower_bound_s is not None]
    gaps = [1.0 - (r.lower_bound_s or 0.0) / r.makespan_s for r in bounded if r.makespan_s > 0]
    return Cell(
        len(rows),
        len(fine),
        (means[0], means[1], means[2]),
        (errors[0], errors[1], errors[2]),
        float(np.mean([r.planning_s for r in rows])),
        float(np.mean(gaps)) if gaps else None,
        sum(g <= 1e-9 for g in gaps),
    )


def markdown(rows: Sequence[Row], given: Sequence[Entry], note: str = "") -> str:
    """The table: one block a setup and measure, our methods above the paper's."""
    found, fine = cells(rows), solved(rows)
    names = [e for e in given if any(key[1] == e.name for key in found)]
    lines = ["# Benchmark", "", *([note, ""] if note else []), COMPARABLE]
    lines += ["| Row | What it is |", "|---|---|", *(f"| {e.name} | {e.words} |" for e in names), ""]
    teams = [f"{u}-{g}" for u, g in TEAMS]
    for setup in PRESETS:
        if not any(key[0].startswith(setup) for key in found):
            continue
        for k, measure in enumerate(("Makespan, s", "UAV energy, kJ", "UGV energy, kJ")):
            lines += [f"## {setup}: {measure}", "", f"| Method | {' | '.join(teams)} |", "|---|" + "---:|" * len(teams)]
            for e in names:
                texts = [_number(found.get((f"{setup}_{team}", e.name)), k) for team in teams]
                lines.append(f"| {e.name} | {' | '.join(texts)} |")
            for method in METHODS:
                texts = [f"{PAPER[setup, team, method][k]:.0f}" for team in teams]
                lines.append(f"| *paper: {method}* | {' | '.join(f'*{t}*' for t in texts)} |")
            lines.append("")
        lines += [f"## {setup}: feasible plans, planning time", "", f"| Method | {' | '.join(teams)} |"]
        lines.append("|---|" + "---:|" * len(teams))
        for e in names:
            texts = [_share(found.get((f"{setup}_{team}", e.name))) for team in teams]
            lines.append(f"| {e.name} | {' | '.join(texts)} |")
        lines.append("")
        for compare in (against_baselines, against_paper, against_search):
            lines += compare(fine, setup, teams, names)
        lines += _proofs(found, setup, teams, names)
    return "\n".join(lines).rstrip() + "\n"


def _number(cell: Cell | None, k: int) -> str:
    if cell is None or cell.feasible == 0:
        return "-"
    error = "" if math.isnan(cell.errors[k]) else f" ± {cell.errors[k]:.0f}"
    return f"{cell.means[k]:.0f}{error}"


def _share(cell: Cell | None) -> str:
    return "-" if cell is None else f"{cell.feasible}/{cell.count}, {cell.planning_s:.2f} s"


def _proofs(found: dict[tuple[str, str], Cell], setup: str, teams: Sequence[str], names: Sequence[Entry]) -> list[str]:
    lines = []
    for e in names:
        for team in teams:
            cell = found.get((f"{setup}_{team}", e.name))
            if cell is not None and cell.gap is not None:
                gap = 100 * cell.gap
                lines.append(f"- {team}: {e.name} proved {cell.proven} of {cell.count} optimal, mean gap {gap:.1f} %")
    return [f"Proofs, {setup}:", "", *lines, ""] if lines else []


def plot(rows: Sequence[Row], given: Sequence[Entry], path: Path) -> None:
    """Mean makespans as bars with standard errors, a panel for each data set; the paper's figures below, hollow."""
    import matplotlib as mpl  # noqa: PLC0415  (slow, and only for pictures)

    mpl.use("agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    found = cells(rows)
    names = [e.name for e in given if any(key[1] == e.name for key in found)]
    y, labels = range(len(names) + len(METHODS)), [*names, *(f"paper: {method}" for method in METHODS)]
    size = (13, 1.5 + 2 * 0.17 * len(labels))
    figure, panels = plt.subplots(
        len(PRESETS), len(TEAMS), figsize=size, sharex="row", sharey=True, layout="constrained"
    )
    for axes, one in zip(panels.flat, DATA_SETS, strict=True):
        here = [found.get((one.name, name)) for name in names]
        means = [c.means[0] if c is not None else math.nan for c in here]
        errors = [0.0 if c is None or math.isnan(c.errors[0]) else c.errors[0] for c in here]
        axes.barh(
            y[: len(names)], means, 0.76, xerr=errors, color=[_colour(name) for name in names],
            error_kw={"linewidth": 0.8},
        )  # fmt: skip
        team = one.name.split("_")[1]
        published = [PAPER[one.setup, team, method][0] for method in METHODS]
        axes.barh(y[len(names) :], published, 0.76, facecolor="none", edgecolor="#b91c1c")
        if names and not math.isnan(means[0]):
            axes.axvline(means[0], color=_colour(names[0]), linewidth=0.8, linestyle=":")
        axes.set(title=f"{one.setup}, {team}", xlim=(0, None))
        axes.set_yticks(y, labels, fontsize=8)
        axes.tick_params(axis="x", labelsize=8)
        axes.grid(axis="x", linewidth=0.4)
        axes.set_axisbelow(True)
    panels[0, 0].set_ylim(len(labels) - 0.4, -0.6)  # first row on top
    says = "mean makespan, s (with standard error; dotted: the first row; hollow: the paper's figures)"
    figure.supxlabel(says, fontsize="medium")
    figure.savefig(path, dpi=90)
    plt.close(figure)


def _colour(name: str) -> str:
    """A hue for each reading of the baselines, a shade for each metaheuristic; dark for ours."""
    hues = {
        "": ("#1d4ed8", "#60a5fa", "#bfdbfe"),
        "15s": ("#c2410c", "#fb923c", "#fed7aa"),
        "tour": ("#15803d", "#4ade80", "#bbf7d0"),
        "free": ("#7e22ce", "#c084fc", "#e9d5ff"),
    }
    method, _, reading = name.partition("-")
    if method in BASELINES and reading in hues:
        return hues[reading][BASELINES.index(method)]
    ours = {
        "search": "#111827",
        "expert": "#374151",
        "search-0.3s": "#6b7280",
        "search-as-copcs": "#9ca3af",
        "search-as-beam": "#d1d5db",
        "search-thrifty": "#4d7c0f",
        "copcs": "#be185d",
        "copcs-net": "#fbcfe8",
        "copcs+beam": "#db2777",
        "copcs+search": "#f472b6",
        "paper": "#0f766e",
        "mlp": "#5eead4",
        "milp": "#a16207",
    }
    return ours.get(name, "#6b7280")
