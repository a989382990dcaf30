"""What each part of the learned planner is worth: networks trained alike but for one part.

python -m benchmarks.bench_ablation --more runs/improved/*/*.npz [--variants A,B] [--count 25] [--runs runs/ablation]

Every network is trained from random weights on as many plans as the others see (``--labels`` instances of each data
set, and the examples in ``--more``, ``--epochs`` times; without the latter, the labels more often), then plans the
first ``--count`` test instances of each data set, greedy, with and without looking ahead. Compared with ``search``,
from the benchmark's results. Both training and planning are resumable; about 25 minutes of one core for each network.
Plans of networks that were trained otherwise are made anew.
"""

from __future__ import annotations

import argparse
import hashlib
from pathlib import Path

from benchmarks.rows import Rows
from planner.benchmark import read_rows
from planner.errors import PlannerError, exit_on_error
from planner.instances import DATA_SETS, TEST
from planner.policy.decode import Policy
from planner.policy.examples import load
from planner.policy.train import main as train

FIELDS = ("variant", "trained", "data_set", "instance", "greedy_s", "alone_s")
VARIANTS: dict[str, tuple[str, ...]] = {
    "plus": (),
    "without self-improvement": (),
    "without augmentation": ("--no-augment",),
    "without UGV edges": ("--no-ugv-edges",),
    "without UAV edges": ("--no-uav-edges",),
}
NETWORK = [
    "--dim",
    "128",
    "--heads",
    "4",
    "--hidden",
    "256",
    "--batch",
    "256",
    "--parts",
    "2",
    "--bfloat16",
    "--valid",
    "0",
    "--rate",
    "8e-4",
]


def trained(given: argparse.Namespace, variant: str, plans: int, runs: Path) -> Policy:
    """The variant's network, trained where it is not yet."""
    out = runs / variant.replace(" ", "_")
    labels, more = given.labels * len(DATA_SETS), [str(path) for path in given.more]
    epochs = given.epochs
    if variant == "without self-improvement":
        epochs, more = round(given.epochs * (labels + plans) / labels), []
    options = ["--count", str(given.labels), "--epochs", str(epochs), "--out", str(out), "--cache"]
    train([*NETWORK, *options, str(given.runs / "cache"), *VARIANTS[variant], "--more", *more])
    return Policy.load(out / "last.safetensors")


def main() -> None:
    parser = argparse.ArgumentParser(description="What each part of the learned planner is worth.")
    parser.add_argument("--more", type=Path, nargs="+", required=True, help="examples of planner.policy.improve")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    parser.add_argument("--labels", type=int, default=200, help="instances of each data set")
    parser.add_argument("--epochs", type=int, default=8)
    parser.add_argument("--count", type=int, default=25, help="test instances of each data set")
    parser.add_argument("--runs", type=Path, default=Path("runs/ablation"))
    parser.add_argument("--out", type=Path, default=Path("benchmarks/results/ablation.csv"))
    given = parser.parse_args()
    if not 0 < given.count <= len(TEST):
        parser.error(f"--count is {given.count}; give 1 to {len(TEST)}")
    variants = [name.strip() for name in given.variants.split(",")]
    if wrong := [name for name in variants if name not in VARIANTS]:
        parser.error(f"there is no variant {wrong[0]!r}; there are {', '.join(VARIANTS)}")
    counts = [len(load(path)) for path in given.more]
    how = hashlib.sha256(repr((NETWORK, given.labels, given.epochs, counts)).encode()).hexdigest()[:16]
    table = Rows(given.out, FIELDS)
    table.keep(lambda r: r["variant"] not in variants or r["trained"] == how)
    have = {(r["variant"], r["data_set"], int(r["instance"])) for r in table.rows}
    for variant in variants:
        todo = [(one, i) for one in DATA_SETS for i in TEST[: given.count] if (variant, one.name, i) not in have]
        if not todo:
            continue
        policy = trained(given, variant, sum(counts), given.runs / how)
        for one, i in todo:
            problem = one.instance(i)
            both = policy.greedy(problem), policy.alone().greedy(problem)
            if not all(plan.complete for plan in both):
                raise PlannerError(f"{variant}: the plan for {one.name} {i} leaves tasks out")
            spans = (round(plan.makespan_s, 3) for plan in both)
            table.add(dict(zip(FIELDS, (variant, how, one.name, i, *spans), strict=True)))
        print(f"{variant}: done", flush=True)
    print(markdown(table.rows))


def markdown(rows: list[dict[str, str]]) -> str:
    """How much longer than search's plans, over the instances that search has solved; left alone in braces."""
    expert = {
        (r.data_set, r.instance): r.makespan_s
        for r in read_rows(Path("benchmarks/results/benchmark.csv"))
        if r.entry == "search"
    }
    names = [one.name for one in DATA_SETS]
    lines = [f"| Network | {' | '.join(names)} |", f"|---|{'---:|' * len(names)}"]
    for variant in dict.fromkeys(r["variant"] for r in rows):
        cells = []
        for name in names:
            mine = [
                r for r in rows
                if (r["variant"], r["data_set"]) == (variant, name) and (name, int(r["instance"])) in expert
            ]  # fmt: skip
            best = sum(expert[name, int(r["instance"])] for r in mine) or float("nan")
            gaps = (100 * (sum(float(r[key]) for r in mine) / best - 1) for key in ("greedy_s", "alone_s"))
            cells.append("{:.1f} ({:.1f}) %".format(*gaps))
        lines.append(f"| {variant} | {' | '.join(cells)} |")
    return "\n".join(lines)


if __name__ == "__main__":
    exit_on_error(main)
