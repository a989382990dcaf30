"""``copcs-deploy run``, ``check``, ``replay`` and ``report``."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import orjson

from deploy.backends import require
from deploy.check_report import CheckReport
from deploy.check_table import check_lines, check_table
from deploy.cli_common import DONE, FAILED, duration_text, orderly_end, print_json, show_rows, working
from deploy.display import SteadyConsole, make_display
from deploy.errors import InputError
from deploy.map_drawing import drawing_of
from deploy.operator import SignalOperator
from deploy.planning_settings import load_with
from deploy.replay import mission_of
from deploy.replay import replay as replay_run
from deploy.report import Report, make
from deploy.run_folder import REPORT_HTML, REPORT_JSON
from deploy.session import RunResult, check_mission, run_mission


def run(
    mission_file: Path,
    *,
    backend: str,
    sim: str,
    dry_run: bool,
    planner: str | None,
    seed: int | None,
    out: Path | None,
    as_json: bool,
) -> int:
    """Flies a mission; see ``cli.run``."""
    require(backend, sim)
    mission = load_with(mission_file, planner, seed)
    display = make_display(quiet=as_json)
    with orderly_end():
        result = run_mission(
            mission,
            out=out,
            backend=backend,
            sim=sim,
            dry_run=dry_run,
            display=display,
            operator=SignalOperator(display.note),
            command=shlex.join(["copcs-deploy", *sys.argv[1:]]),
        )
    if as_json:
        print_json(_run_json(result))
    elif result.kind == "dry run":
        show_checks(result.checks)
        print("dry run: nothing was armed")
    elif result.kind == "refused":
        for row in result.checks.failures:
            print(f"error: check {row.name!r} failed: {row.text}", file=sys.stderr)
        print(f"error: not armed; all checks: copcs-deploy check {mission_file}", file=sys.stderr)
    elif result.report is not None:
        show_report(result.report, result.folder)
    if result.recording_failure is not None:
        print(f"error: the recording is not complete: {result.recording_failure}", file=sys.stderr)
    return result.exit_code


def _run_json(result: RunResult) -> dict[str, object]:
    report = None if result.report is None else orjson.loads(result.report.to_json())
    return {
        "outcome": result.kind,
        "exit_code": result.exit_code,
        "folder": None if result.folder is None else str(result.folder),
        "recording_failure": result.recording_failure,
        "checks": result.checks.to_json(),
        "report": report,
    }


def check(
    mission_file: Path,
    *,
    backend: str = "sim",
    sim: str = "kinematic",
    identify: bool = False,
    planner: str | None,
    seed: int | None,
    as_json: bool,
) -> int:
    """Plans and checks a mission; see ``cli.check``."""
    require(backend, sim)
    if identify and as_json:
        raise InputError("talks to the operator, which --json forbids; leave one of them out", key="--identify")
    mission = load_with(mission_file, planner, seed)
    display = make_display(quiet=as_json)
    with orderly_end():
        checks = check_mission(mission, display, backend, sim, ask=display.note if identify else None)
    if as_json:
        print_json(checks.to_json())
    else:
        show_checks(checks)
    return DONE if checks.passed else FAILED


def show_checks(checks: CheckReport) -> None:
    """The checks as a table in a terminal, as lines elsewhere."""
    console = SteadyConsole()
    if console.is_terminal:
        console.print(check_table(checks))
    else:
        print("\n".join(check_lines(checks)))


def replay(folder: Path, *, as_json: bool) -> int:
    """Replays a run; see ``cli.replay``."""
    with working("replaying", quiet=as_json):
        result = replay_run(_folder(folder))
    if as_json:
        difference = None if result.difference is None else asdict(result.difference)
        print_json({**asdict(result), "identical": result.identical, "difference": difference})
        return DONE if result.identical else FAILED
    counted = f"{result.turns} turns, {result.commands} commands"
    if result.truncated:
        print("the recording breaks off; everything that is there was replayed")
    if result.difference is None:
        print(f"identical: {counted}")
        return DONE
    print(f"different: {result.difference}")
    if result.other_versions:
        changed = ", ".join(f"{name} {then} -> {now}" for name, (then, now) in result.other_versions.items())
        print(f"it was recorded with other versions: {changed}")
    return FAILED


def report(folder: Path, *, as_json: bool) -> int:
    """Writes a run's report again; see ``cli.report``."""
    mission = mission_of(_folder(folder))
    with working("writing the report", quiet=as_json):
        made = make(folder, mission.settings, drawing_of(mission.geometry))
    if as_json:
        sys.stdout.write(made.to_json().decode())
    else:
        show_report(made, folder)
    return DONE


def _folder(folder: Path) -> Path:
    if not folder.is_dir():
        raise InputError("is no folder; give the folder of a run", file=folder)
    return folder


def show_report(made: Report, folder: Path | None) -> None:
    """A report's summary for people."""
    rows = [
        ("outcome", made.outcome),
        ("tasks", f"{made.tasks_visited} of {made.tasks_total}"),
        ("makespan", f"{duration_text(made.makespan_actual_s)} (planned {duration_text(made.makespan_planned_s)})"),
        ("energy of UAVs, UGVs", f"{_mega(made.uav_energy_j)}, {_mega(made.ugv_energy_j)}"),
        ("recharges, replans", f"{made.recharges}, {len(made.replans)}"),
        ("least separation", _least(made.min_separation_m, "m")),
        ("least energy margin", _least(made.min_energy_margin_j, "kJ", 1e-3)),
        ("safety violations", str(len(made.safety_violations)) if made.safety_violations else "none"),
    ]
    rows += [("", f"{v.kind} at {duration_text(v.start_s)}: {v.text}") for v in made.safety_violations[:5]]
    if made.loop.late_turns:
        rows.append(("late turns", f"{made.loop.late_turns} of {made.loop.turns} ({100 * made.loop.late_share:.2f} %)"))
    if folder is not None:
        rows += [("report", _path(folder / REPORT_HTML)), ("numbers", _path(folder / REPORT_JSON))]
    show_rows(rows)


def _path(path: Path) -> str:
    near = os.path.relpath(path)
    return str(path.absolute()) if near.startswith("..") else near


def _mega(value: float | None) -> str:
    return "-" if value is None else f"{value / 1e6:.2f} MJ"


def _least(value: float | None, unit: str, factor: float = 1.0) -> str:
    return "-" if value is None else f"{value * factor:.3g} {unit}"


__all__: Sequence[str] = ["check", "replay", "report", "run", "show_checks", "show_report"]
