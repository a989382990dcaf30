"""``copcs-deploy benchmark``: every planning method on the paper's data sets, as a table, a CSV file and a plot."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from deploy.cli_common import DONE, print_json
from deploy.display import SteadyConsole
from deploy.errors import InputError
from planner.benchmark import Entry, entries, quick, run, write_about
from planner.benchmark_table import cells, markdown, plot
from planner.instances import DATA_SETS, TEST, data_set

QUICK_NOTE = "**A quick check that everything runs: one instance each, next to no time. These figures mean nothing.**"


def benchmark(
    *,
    is_quick: bool,
    out: Path,
    rows: str | None,
    sets: str | None,
    instances: int | None,
    jobs: int,
    as_json: bool,
    table: bool = False,
) -> int:
    """Runs what is missing in ``out`` and writes table and plot.

    Raises:
        InputError: an option is wrong.
        PlannerError: a data set does not exist, or the results file is another one's.
    """
    given = _chosen(rows)
    names = [data_set(name.strip()).name for name in sets.split(",")] if sets else [d.name for d in DATA_SETS]
    count = min(instances or len(TEST), len(TEST))
    stem = "quick" if is_quick else "benchmark"
    if is_quick:
        given, count = quick(given), 1
        (out / f"{stem}.csv").unlink(missing_ok=True)
    left_out = [] if table else _without_networks(given, names, rows)
    with Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        console=SteadyConsole(stderr=True), disable=as_json,
    ) as bar:  # fmt: skip
        task = bar.add_task("plans", total=None)
        measured = run(
            out / f"{stem}.csv", [e for e in given if e not in left_out], sets=names, instances=count, jobs=jobs,
            progress=lambda done, total: bar.update(task, completed=done, total=total), missing_too=not table,
        )  # fmt: skip
    measured += run(out / f"{stem}.csv", left_out, sets=names, instances=count, missing_too=False)
    if not measured:
        raise InputError(f"there are no results in {out / stem}.csv yet; leave out the option", key="--table")
    note = QUICK_NOTE if is_quick else ""
    (out / f"{stem}.md").write_text(markdown(measured, given, note), encoding="utf-8")
    plot(measured, given, out / f"{stem}.png")
    if not table:
        write_about(out / f"{stem}.json", shlex.join(["copcs-deploy", *sys.argv[1:]]))
    if as_json:
        found = [
            {"data_set": k[0], "row": k[1], "instances": c.count, "feasible": c.feasible, "makespan_s": c.means[0],
             "uav_energy_kj": c.means[1], "ugv_energy_kj": c.means[2], "planning_s": c.planning_s}
            for k, c in cells(measured).items()
        ]  # fmt: skip
        print_json(
            {
                "rows": [
                    {n: None if isinstance(v, float) and math.isnan(v) else v for n, v in row.items()} for row in found
                ]
            }
        )
    else:
        print(f"table:   {out / stem}.md\nresults: {out / stem}.csv\nplot:    {out / stem}.png")
    return DONE


def _chosen(rows: str | None) -> list[Entry]:
    every = entries()
    if rows is None:
        return every
    by_name = {e.name: e for e in every}
    wanted: Sequence[str] = [name.strip() for name in rows.split(",")]
    for name in wanted:
        if name not in by_name:
            raise InputError(f"has no row {name!r}; there are {', '.join(by_name)}", key="--rows")
    return [by_name[name] for name in wanted]


def _without_networks(given: Sequence[Entry], sets: Sequence[str], rows: str | None) -> list[Entry]:
    """Lines that cannot be measured, as networks are missing; an error where they were asked for by name."""
    without = [e for e in given if e.missing(sets)]
    if not without:
        return []
    if rows is not None:
        raise InputError(
            f"row {without[0].name!r} needs {without[0].missing(sets)[0]}, which is not there; "
            "docs/benchmark.md says how to train it",
            key="--rows",
        )
    print(f"not measured, as networks are missing: {', '.join(e.name for e in without)}", file=sys.stderr)
    return without
