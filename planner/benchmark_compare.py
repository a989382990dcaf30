"""How the methods of the benchmark compare, over the instances that both solve; the paper's own ratios beside ours."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from planner.benchmark import Entry, Row
from planner.paper import PAPER

BASELINES = ("gls", "ts", "sa")
READINGS = {"": "published, time as search", "-15s": "published, 15 s a stop"}  # others by their suffix
Solved = Mapping[tuple[str, str], Mapping[int, Row]]  # feasible rows by data set and entry, then by instance


def solved(rows: Sequence[Row]) -> Solved:
    """The feasible rows, to look up."""
    found: dict[tuple[str, str], dict[int, Row]] = {}
    for row in rows:
        if row.feasible:
            found.setdefault((row.data_set, row.entry), {})[row.instance] = row
    return found


def ratio(fine: Solved, data_set: str, mine: str, theirs: str, measure: str = "makespan_s") -> tuple[float, int]:
    """Mean of ``mine`` by mean of ``theirs`` over the instances that both solve, and how many these are.

    Args:
        fine: feasible rows.
        data_set: its name.
        mine: name of an entry.
        theirs: likewise.
        measure: attribute of ``Row``.
    """
    one, other = fine.get((data_set, mine), {}), fine.get((data_set, theirs), {})
    both = sorted(one.keys() & other.keys())
    if not both:
        return math.nan, 0
    means = [float(np.mean([getattr(rows[i], measure) for i in both])) or 1e-9 for rows in (one, other)]
    return means[0] / means[1], len(both)


def _readings(given: Sequence[Entry]) -> dict[str, list[str]]:
    """The names of the entries of each reading of the baselines."""
    found: dict[str, list[str]] = {}
    for e in given:
        if e.method in BASELINES:
            suffix = e.name.removeprefix(e.method)
            found.setdefault(READINGS.get(suffix, suffix.lstrip("-")), []).append(e.name)
    return found


def _best(fine: Solved, data_set: str, mine: str, names: Sequence[str]) -> tuple[float, str, int] | None:
    """The largest ratio of makespans of ``mine`` by one of ``names``, whose it is, over how many instances."""
    found = ((name, *ratio(fine, data_set, mine, name)) for name in names)
    return max(((r, name, n) for name, r, n in found if n), key=lambda x: x[0], default=None)


def _table(text: str, head: Sequence[str], words: int, lines: Sequence[str]) -> list[str]:
    """A table with a sentence above, nothing where it would be empty; behind ``words`` columns come numbers."""
    if not lines:
        return []
    return [text, "", f"| {' | '.join(head)} |", "|" + "---|" * words + "---:|" * (len(head) - words), *lines, ""]


def against_baselines(fine: Solved, setup: str, teams: Sequence[str], given: Sequence[Entry]) -> list[str]:
    """Search, and search that saves driving, against the best of each reading of the baselines, with energies."""
    return [line for name in ("search", "search-thrifty") for line in _energies(name, fine, setup, teams, given)]


def _energies(mine: str, fine: Solved, setup: str, teams: Sequence[str], given: Sequence[Entry]) -> list[str]:
    lines = []
    for reading, names in _readings(given).items():
        for team in teams:
            best = _best(fine, f"{setup}_{team}", mine, names)
            if best is None:
                continue
            share, name, n = best
            energies = ("uav_energy_j", "ugv_energy_j")
            more = [ratio(fine, f"{setup}_{team}", mine, name, x)[0] - 1 for x in energies]
            lines.append(
                f"| {reading} | {team} | {name} | {n} | {100 * (1 - share):.1f} % | {100 * (1 / share - 1):.1f} % "
                f"| {100 * more[0]:+.0f} % | {100 * more[1]:+.0f} % |"
            )
    head = ("Baselines", "Team", "Best", "Instances", f"{mine} is shorter by", "It is longer by",
            "UAV energy", "UGV energy")  # fmt: skip
    text = f"{mine} against the best of gls, ts and sa, {setup}, over the instances that both solve. "
    return _table(text + f"Energies: those of {mine}, more or less than theirs.", head, 3, lines)


def against_search(fine: Solved, setup: str, teams: Sequence[str], given: Sequence[Entry]) -> list[str]:
    """How much longer all of our other plans are than those of search, and of the labels' expert."""
    return [line for name in ("search", "expert") for line in _against(name, fine, setup, teams, given)]


def _against(name: str, fine: Solved, setup: str, teams: Sequence[str], given: Sequence[Entry]) -> list[str]:
    lines = []
    for e in given:
        if e.name == name or e.method not in ("search", "copcs"):
            continue
        found = [ratio(fine, f"{setup}_{team}", e.name, name) for team in teams]
        if any(n for _, n in found):
            texts = [f"{100 * (r - 1):+.1f} % ({n})" if n else "-" for r, n in found]
            lines.append(f"| {e.name} | {' | '.join(texts)} |")
    text = f"Makespans against those of {name}, {setup}, over the instances that both solve (how many)."
    return _table(text, ("Row", *teams), 1, lines)


def against_paper(fine: Solved, setup: str, teams: Sequence[str], given: Sequence[Entry]) -> list[str]:
    """How much shorter the networks' plans are than the best baseline's, for each reading; the paper's CoPCS last."""
    lines = []
    for reading, names in _readings(given).items():
        for e in given:
            if e.method != "copcs":
                continue
            found = [_best(fine, f"{setup}_{team}", e.name, names) for team in teams]
            if any(found):
                texts = ["-" if best is None else f"{100 * (1 - best[0]):.1f} % ({best[2]})" for best in found]
                lines.append(f"| {e.name} | {reading} | {' | '.join(texts)} |")
    if lines:
        theirs = []
        for team in teams:
            best = min(PAPER[setup, team, method][0] for method in ("GLS", "TS", "SA"))
            theirs.append(f"*{100 * (1 - PAPER[setup, team, 'CoPCS'][0] / best):.1f} %*")
        lines.append(f"| *paper: CoPCS* | *its own* | {' | '.join(theirs)} |")
    text = (
        f"How much shorter than the best of gls, ts and sa, {setup}: mean makespans over the instances that both solve "
        "(how many)."
    )
    return _table(text, ("Row", "Baselines", *teams), 2, lines)
