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
    """Mean makespans as bars with standard errors; the paper's CoPCS and best baseline as marks."""
    import matplotlib as mpl  # noqa: PLC0415  (slow, and only for pictures)

    mpl.use("agg")
    import matplotlib.pyplot as plt  # noqa: PLC0415

    found = cells(rows)
    names = [e.name for e in given if any(key[1] == e.name for key in found)]
    figure, panels = plt.subplots(1, len(PRESETS), figsize=(13, 5), layout="constrained")
    width = 0.84 / max(1, len(names))
    for axes, setup in zip(panels, PRESETS, strict=True):
        teams = [d.name.split("_")[1] for d in DATA_SETS if d.setup == setup]
        for i, name in enumerate(names):
            here = [found.get((f"{setup}_{team}", name)) for team in teams]
            x = [t + (i - 0.5 * (len(names) - 1)) * width for t in range(len(teams))]
            heights = [c.means[0] if c is not None else math.nan for c in here]
            errors = [0.0 if c is None or math.isnan(c.errors[0]) else c.errors[0] for c in here]
            axes.bar(x, heights, width, yerr=errors, color=_colour(name), label=name, error_kw={"linewidth": 0.8})
        for method, marker in (("CoPCS", "D"), ("GLS", "o")):
            y = [PAPER[setup, team, method][0] for team in teams]
            label = f"paper: {method}"
            axes.plot(range(len(teams)), y, marker, mfc="none", mec="#b91c1c", ms=9, ls="none", label=label)
        axes.set_xticks(range(len(teams)), teams)
        axes.set(title=setup, xlabel="UAVs-UGVs", ylabel="mean makespan, s")
        axes.set_ylim(bottom=0)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=8, fontsize=8)
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
        "expert": "#1f2937",
        "search-0.3s": "#4b5563",
        "search-as-copcs": "#9ca3af",
        "search-as-beam": "#d1d5db",
        "copcs": "#be185d",
        "copcs-net": "#fbcfe8",
        "copcs+beam": "#db2777",
        "copcs+search": "#f472b6",
        "paper": "#0f766e",
        "mlp": "#5eead4",
        "milp": "#a16207",
    }
    return ours.get(name, "#6b7280")
