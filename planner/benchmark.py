"""The benchmark: every method on the test instances of all data sets, one CSV row each, resumable.

``copcs-deploy benchmark`` runs it. A row that is in the file is not measured again, so a run may be interrupted, and
methods and instances may be added later.
"""

from __future__ import annotations

import csv
import json
import multiprocessing
import os
import platform
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from planner.errors import PlannerError
from planner.instances import DATA_SETS, TEST, data_set
from planner.labels import Expert
from planner.policy.blas import kernels
from planner.solve import Params, Stop, solve, warm_up


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the table: a method with its time and options, and on how many test instances it runs.

    Attributes:
        name: as in the table; results are kept by it, so another time or option needs another name.
        method: of ``planner.solve``.
        time_s: for a problem of each setup.
        words: what the table says about it.
        options: of the method.
        instances: of each data set, at most; the first ones.
        network: "" or the name of networks in ``NETWORKS``, one for each data set.
        steps: of search for each setup, instead of a time.
    """

    name: str
    method: str
    time_s: Mapping[str, float]
    words: str
    options: Mapping[str, Any] = field(default_factory=dict)
    instances: int = len(TEST)
    network: str = ""
    steps: Mapping[str, int] = field(default_factory=dict)

    def stop(self, setup: str) -> Stop:
        """When planning ends."""
        return Stop(iterations=self.steps[setup]) if self.steps else Stop(time_s=self.time_s[setup])

    def weights(self, data_set_name: str) -> Path:
        """The file of its network for a data set."""
        return NETWORKS / f"{self.network}_{data_set_name}.safetensors"

    def missing(self, sets: Sequence[str]) -> list[Path]:
        """The files of networks for these data sets that are not there."""
        return [self.weights(name) for name in sets if self.network and not self.weights(name).exists()]


NETWORKS = Path("benchmarks/networks")  # of the paper, and its baseline; see docs/benchmark.md
SEARCH_S = {"T15-P5": 1.0, "T45-P10": 5.0}
PUBLISHED_S = 15.0
PUBLISHED_COUNT = 20
EXACT_COUNT = 5
THRIFTY_COUNT = 50
DRIVE = 0.2  # what a driven second counts for `search-thrifty`
POLISH_S = 0.3
CORES = 2  # for `copcs+search` and `search-0.3s`; all others plan on one
BEAM_S = {"T15-P5": 2.0, "T45-P10": 10.0}  # at most; it ends by itself
AS_COPCS_S = {"T15-P5": 0.005, "T45-P10": 0.03}  # what `copcs` takes on the machine of the results
AS_BEAM_S = {"T15-P5": 0.12, "T45-P10": 2.2}  # likewise, `copcs+beam`
_NAMES = {"gls": "guided local search", "ts": "tabu search", "sa": "simulated annealing"}


def entries() -> list[Entry]:
    """The table's lines."""
    short, bare, both = dict.fromkeys(SEARCH_S, POLISH_S), {"polish": False}, {"workers": CORES}
    brief = " and ".join(f"{1e3 * x:.0f}" for x in AS_COPCS_S.values())
    longer = " and ".join(f"{x:g}" for x in AS_BEAM_S.values())
    expert = {setup: Expert().steps(setup) for setup in SEARCH_S}
    least, most = expert.values()
    made = [
        Entry("search", "search", SEARCH_S, "ours: annealing over the joint plan"),
        Entry("expert", "search", SEARCH_S, f"the labels' expert: {least:,} or {most:,} steps", steps=expert),
        Entry("copcs", "copcs", SEARCH_S, "ours: the network, greedy; ends by itself", bare),
        Entry("copcs-net", "copcs", SEARCH_S, "ours: the same without looking ahead", {**bare, "look_ahead": False}),
        Entry("paper", "copcs", SEARCH_S, "the paper's network, greedy; one for each data set", bare, network="hgt"),
        Entry("mlp", "copcs", SEARCH_S, "the paper's MLP baseline, greedy; one for each data set", bare,
              network="mlp"),
        Entry("copcs+beam", "copcs", BEAM_S, "ours: the network, beam search; ends by itself",
              {**bare, "decode": "beam"}),
        Entry("copcs+search", "copcs", short, f"ours: greedy, then search, {POLISH_S:g} s in all, two cores", both),
        Entry("search-0.3s", "search", short, f"search alone, {POLISH_S:g} s, two cores", both),
        Entry("search-as-copcs", "search", AS_COPCS_S, f"search alone, as long as copcs: {brief} ms"),
        Entry("search-as-beam", "search", AS_BEAM_S, f"search alone, as long as copcs+beam: {longer} s"),
    ]  # fmt: skip
    thrifty = f"search where a second driven counts as {DRIVE:g} s of makespan"
    made.append(Entry("search-thrifty", "search", SEARCH_S, thrifty, {"drive": DRIVE}, THRIFTY_COUNT))
    for method, words in _NAMES.items():
        made.append(Entry(method, method, SEARCH_S, f"OR-Tools {words}, fewest stops; time as search"))
    for method in _NAMES:
        made.append(
            Entry(
                f"{method}-15s", method, dict.fromkeys(SEARCH_S, 2.0 * PUBLISHED_S),
                f"as {method}, {PUBLISHED_S:g} s for each stop as published", {"solve_s": PUBLISHED_S}, PUBLISHED_COUNT,
            )
        )  # fmt: skip
    for method, words in _NAMES.items():
        tour = {"every_site": True}
        says = f"OR-Tools {words}, UGVs tour the path points"
        made.append(Entry(f"{method}-tour", method, SEARCH_S, says, tour, PUBLISHED_COUNT))
    for method, words in _NAMES.items():
        free = {"meet": False}
        says = f"OR-Tools {words}, meets UGVs only when needed"
        made.append(Entry(f"{method}-free", method, SEARCH_S, says, free, PUBLISHED_COUNT))
    made.append(
        Entry("milp", "milp", {"T15-P5": 60.0, "T45-P10": 60.0}, "exact method, 60 s on one core", {}, EXACT_COUNT)
    )
    return made


def quick(given: Sequence[Entry]) -> list[Entry]:
    """Some of these lines with one instance each and next to no time: a check that all works, not a result."""
    made = []
    for entry in given:
        if entry.name.endswith(("-15s", "ts-tour", "sa-tour", "ts-free", "sa-free")):
            continue
        options = {k: 0.1 if k == "solve_s" else v for k, v in entry.options.items()}
        made.append(replace(entry, time_s={"T15-P5": 0.25, "T45-P10": 0.4}, options=options, instances=1, steps={}))
    return made


@dataclass(frozen=True, slots=True)
class Row:
    """One plan; energies in J, what is not known is empty."""

    data_set: str
    instance: int
    entry: str
    method: str
    feasible: bool
    makespan_s: float
    uav_energy_j: float
    ugv_energy_j: float
    energy_given_j: float
    waiting_s: float
    recovery_s: float
    planning_s: float
    lower_bound_s: float | None
    n_actions: int
    digest: str
    violation: str


@cache
def _warm_up(method: str, name: str, weights: str) -> None:
    """No method pays for loading and compiling in its first plan."""
    if not weights:
        warm_up(method)
        return
    solve(data_set(name).instance(0), Stop(iterations=1), 0, Params(method, options={"weights": weights}))


def measure(name: str, instance: int, entry: Entry) -> Row:
    """Plans one instance with one entry."""
    one = data_set(name)
    weights = {"weights": str(entry.weights(name))} if entry.network else {}
    _warm_up(entry.method, name if weights else "", weights.get("weights", ""))
    options = {**entry.options, **weights}
    plan = solve(one.instance(instance), entry.stop(one.setup), instance, Params(entry.method, options=options)).plan
    s = plan.schedule
    return Row(
        name, instance, entry.name, entry.method, plan.feasible, s.makespan_s, s.uav_energy_j, s.ugv_energy_j,
        s.energy_given_j, s.waiting_s, s.recovery_s, plan.planning_s or 0.0, plan.lower_bound_s, len(plan.actions),
        plan.digest[:16], s.violation or "",
    )  # fmt: skip


def run(
    out: Path,
    given: Sequence[Entry],
    *,
    sets: Sequence[str] | None = None,
    instances: int = len(TEST),
    jobs: int = 1,
    progress: Callable[[int, int], None] = lambda done, total: None,
    missing_too: bool = True,
) -> list[Row]:
    """Measures what ``out`` does not hold yet; all rows that belong to the entries, old and new.

    Args:
        out: CSV file, made where it is missing.
        given: the lines.
        sets: names of data sets; None: the eight.
        instances: of each data set, at most; the first test instances.
        jobs: processes at once. More than there are free cores make every method's time worth less.
        progress: called with the numbers of rows done and wanted.
        missing_too: False: measure nothing.
    """
    have = {(r.data_set, r.instance, r.entry): r for r in read_rows(out)}
    wanted = [
        (name, TEST[k], entry)
        for k in range(instances)  # instance by instance, so that an interrupted run is even over all sets
        for name in (sets or [one.name for one in DATA_SETS])
        for entry in given
        if k < min(entry.instances, len(TEST))
    ]
    missing = [w for w in wanted if (w[0], w[1], w[2].name) not in have]
    if not missing_too:
        return [have[key] for name, index, entry in wanted if (key := (name, index, entry.name)) in have]
    done = len(wanted) - len(missing)
    progress(done, len(wanted))
    out.parent.mkdir(parents=True, exist_ok=True)
    fresh = not out.exists() or out.stat().st_size == 0
    with out.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Row)])
        if fresh:
            writer.writeheader()
        for row in _measured(missing, jobs):
            writer.writerow({k: "" if v is None else v for k, v in asdict(row).items()})
            file.flush()
            have[row.data_set, row.instance, row.entry] = row
            done += 1
            progress(done, len(wanted))
    return [have[name, index, entry.name] for name, index, entry in wanted]


def _measured(todo: Sequence[tuple[str, int, Entry]], jobs: int) -> Iterable[Row]:
    if jobs <= 1:
        for one in todo:
            yield measure(*one)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context) as pool:
        left = iter(todo)
        running = {pool.submit(measure, *one) for _, one in zip(range(2 * jobs), left, strict=False)}
        while running:
            finished, running = wait(running, return_when=FIRST_COMPLETED)
            for future in finished:
                yield future.result()
            running |= {pool.submit(measure, *one) for _, one in zip(range(len(finished)), left, strict=False)}


def read_rows(path: Path) -> list[Row]:
    """The rows of a results file; none where there is no file. A last line that was cut off is left out.

    Raises:
        PlannerError: when it is not such a file.
    """
    if not path.exists():
        return []
    _mend(path)
    with path.open(newline="", encoding="utf-8") as file:
        reader = csv.DictReader(file)
        if reader.fieldnames is not None and list(reader.fieldnames) != [f.name for f in fields(Row)]:
            raise PlannerError(f"{path}: these are no results of this benchmark; give another file")
        return [_row(values) for values in reader]


def _mend(path: Path) -> None:
    """Cuts off a last line without an end: a run was interrupted while it wrote."""
    data = path.read_bytes()
    if data and not data.endswith(b"\n"):
        path.write_bytes(data[: data.rfind(b"\n") + 1])


def _row(values: Mapping[str, str]) -> Row:
    return Row(
        values["data_set"],
        int(values["instance"]),
        values["entry"],
        values["method"],
        values["feasible"] == "True",
        float(values["makespan_s"]),
        float(values["uav_energy_j"]),
        float(values["ugv_energy_j"]),
        float(values["energy_given_j"]),
        float(values["waiting_s"]),
        float(values["recovery_s"]),
        float(values["planning_s"]),
        float(values["lower_bound_s"]) if values["lower_bound_s"] else None,
        int(values["n_actions"]),
        values["digest"],
        values["violation"],
    )


def about(command: str) -> dict[str, object]:
    """The machine and the versions that results were made with."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        models = [x.split(":", 1)[1].strip() for x in info.read_text().splitlines() if x.startswith("model name")]
        cpu = models[0] if models else cpu
    packages = ("numpy", "numba", "ortools", "scipy")
    return {
        "command": command,
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "cpu": cpu,
        "cores": os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()],
        "python": platform.python_version(),
        "packages": {name: metadata.version(name) for name in packages},
        "matrix_products": kernels(),
        "clock": time.get_clock_info("perf_counter").implementation,
    }


def write_about(path: Path, command: str) -> None:
    """Writes ``about`` as JSON."""
    path.write_text(json.dumps(about(command), indent=1) + "\n", encoding="utf-8")
