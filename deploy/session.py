"""A whole run: plan, check, connect, arm, fly, report. Used by the command line, tests and benchmarks alike."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from deploy import run_folder
from deploy.backends import connect, require_ready
from deploy.check_report import CheckReport
from deploy.check_vehicles import BY_HAND, identify_fleet, settle
from deploy.checks import probe_backend, run_checks
from deploy.display import Display, NullDisplay
from deploy.errors import DeployError, InputError
from deploy.fleet import Fleet
from deploy.map_drawing import drawing_of
from deploy.mission import Mission
from deploy.mission_copy import save_copy
from deploy.operator import Operator, ScriptedOperator
from deploy.planning import LOADING, InlinePlanner, Planner, ProcessPlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.recording import Recorder, RunMeta
from deploy.report import Report, make
from deploy.runner import Outcome, fly
from deploy.screen import Header, clock_text
from deploy.watch import Watch
from drivers.vehicle import SelfCheck
from planner.plan import Plan
from planner.solve import warm_up
from sim_backends.errors import SimulationError
from sim_backends.truth import Truth

WARM_S = 30.0
"""So long the planner's process may take to start; a slower one goes on starting in flight."""
PATIENCE = 4.0
"""A mission that takes so many times its planned makespan, and an hour, is broken off: everybody comes down."""

Kind = Literal["done", "failed", "aborted", "refused", "dry run"]


@dataclass(frozen=True)
class RunResult:
    """What came of a run.

    Attributes:
        kind: ``done``; ``failed``; ``aborted`` by the operator; ``refused``, since a check failed; ``dry run``.
        plan, checks: before the flight.
        folder: of the run; None where nothing was flown.
        report: None where nothing was flown, or none was wanted.
        outcome: of the loop.
        truth: the simulated world's own audit; None where nobody knows.
        recording_failure: why the recording is not complete.
    """

    kind: Kind
    plan: Plan
    checks: CheckReport
    folder: Path | None = None
    report: Report | None = None
    outcome: Outcome | None = None
    truth: Truth | None = None
    recording_failure: str | None = None

    @property
    def exit_code(self) -> int:
        """0 done or passed, 1 the mission or a check failed, 3 aborted by the operator."""
        if self.kind == "aborted":
            return 3
        good = self.kind == "done" or (self.kind == "dry run" and self.checks.passed)
        return 0 if good and self.recording_failure is None else 1


def make_plan(mission: Mission, display: Display) -> Plan:
    """The plan before the flight.

    Raises:
        PlannerError: when the planner's settings are wrong.
    """
    stop, seed, params = first_plan(mission)
    with display.working(LOADING):
        warm_up(params.method, params.options)  # not out of the time to plan
    budget = f" for {stop.time_s:g} s" if stop.time_s is not None else ""
    with display.working(f"planning{budget}"):
        plan = plan_with_margin(mission.problem, mission.settings.replanning.margin, stop, seed, params)
    verdict = f"makespan {clock_text(plan.makespan_s)}" if plan.feasible else f"not feasible: {plan.schedule.violation}"
    display.note(f"plan: {verdict} ({plan.method}, {plan.planning_s or 0.0:.1f} s)")
    if plan.note is not None:
        display.note(f"plan: {plan.note}")
    return plan


def make_checks(
    mission: Mission, plan: Plan, fleet: Fleet, display: Display, ask: Callable[[str], None] | None = None
) -> CheckReport:
    """Connects the fleet and runs every check of the mission, the plan and the fleet; arms and moves nothing.

    Args:
        mission: as loaded.
        plan: its plan.
        fleet: not yet connected.
        display: for the operator.
        ask: tells the operator which vehicle to move by hand; None: nobody is asked to.
    """
    errors = fleet.connect(display=display)
    by_hand: list[SelfCheck] = []
    if not fleet.virtual and mission.geo is None:
        by_hand = [SelfCheck(BY_HAND, "not run", "check --identify asks to move each vehicle, and watches its body")]
        if ask is not None and not errors:
            by_hand = identify_fleet(fleet, ask)
    with display.working("listening"):
        if not fleet.virtual and not errors:
            settle(fleet)
        probe = probe_backend(
            fleet.vehicles,
            fleet.listening,
            fleet.clock.now,
            fleet.clock.wait_until,
            errors=errors,
            more=lambda: (*fleet.checks(), *by_hand),
        )
    with display.working("checking"):
        checks = run_checks(mission, plan, now_s=time.monotonic(), probe=probe)
    display.note(f"checks: {checks.summary}")
    return checks


def check_mission(
    mission: Mission,
    display: Display,
    backend: str = "sim",
    sim: str = "kinematic",
    ask: Callable[[str], None] | None = None,
) -> CheckReport:
    """Plans and checks a mission, without flying; ``ask`` as for ``make_checks``.

    Raises:
        InputError: there is no such backend.
        PlannerError: the planner's settings are wrong.
    """
    require_ready(mission, backend, sim)
    if ask is not None and (mission.geo is not None or (backend, sim) == ("sim", "kinematic")):
        raise InputError(
            "asks who moves in motion capture, which this mission does not use; leave it out", key="--identify"
        )
    plan = make_plan(mission, display)
    fleet = connect(mission, backend, sim, horizon_s=plan.makespan_s)
    try:
        return make_checks(mission, plan, fleet, display, ask)
    finally:
        fleet.close()


def run_mission(
    mission: Mission,
    *,
    out: Path | None = None,
    backend: str = "sim",
    sim: str = "kinematic",
    dry_run: bool = False,
    display: Display | None = None,
    operator: Operator | None = None,
    command: str = "",
    with_report: bool = True,
) -> RunResult:
    """Runs a mission to its end.

    Args:
        mission: as loaded.
        out: run folder; default: ``runs/<mission>-<time>``.
        backend: ``sim`` or ``real``.
        sim: ``kinematic`` or ``wire``.
        dry_run: stop before arming.
        display: for the operator; default: none.
        operator: default: nobody, who wishes nothing.
        command: what to type to do it again, for the report.
        with_report: write report and pictures.

    Raises:
        InputError: something is wrong with the folder or the backend.
        PlannerError: with the planner's settings.
    """
    display, operator = display or NullDisplay(), operator or ScriptedOperator()
    require_ready(mission, backend, sim)
    folder = None if dry_run else run_folder.prepare(out, mission.name)
    try:
        plan = make_plan(mission, display)
        fleet = connect(mission, backend, sim, horizon_s=plan.makespan_s)
        try:
            checks = make_checks(mission, plan, fleet, display)
            if folder is None or not checks.passed:
                return RunResult("dry run" if dry_run else "refused", plan, checks)
            save_copy(mission, folder / run_folder.MISSION)
            outcome, failure = _fly(mission, plan, checks, fleet, folder, display, operator, command)
            trouble = fleet.trouble()
            if trouble is not None:
                display.note(trouble)
        finally:
            fleet.close()
    finally:
        if folder is not None:
            run_folder.drop_if_empty(folder)
    kind = outcome.kind
    if kind == "aborted" and not operator.wished & {"recover", "stop"}:
        kind = "failed"  # it was broken off, but nobody asked for it
    report = None
    if with_report:
        with display.working("writing the report"):
            try:
                report = make(folder, mission.settings, drawing_of(mission.geometry), kind)
            except DeployError as error:
                failure = failure or str(error)
    return RunResult(kind, plan, checks, folder, report, outcome, _truth(fleet), failure)


def _fly(
    mission: Mission,
    plan: Plan,
    checks: CheckReport,
    fleet: Fleet,
    folder: Path,
    display: Display,
    operator: Operator,
    command: str,
) -> tuple[Outcome, str | None]:
    """Flies and records; returns the outcome and why the recording is not complete, if it is not."""
    now_s = fleet.clock.now()
    # The checks expire on the wall clock, the supervisor judges by the loop's; nothing ages in a simulated world.
    valid_s = checks.valid_s if fleet.virtual else checks.valid_until_s - time.monotonic()
    limit_s = mission.settings.frame.time_scale * (PATIENCE * plan.makespan_s + 3600.0)
    # The last commands (motors off, disarm) may get lost like any other; stay until each could be repeated.
    linger_s = mission.settings.monitors.command_attempts * mission.settings.monitors.command_confirm_s
    meta = RunMeta(
        name=mission.name,
        seed=mission.seed,
        mission_digest=mission.digest,
        plan_digest=plan.digest,
        backend=fleet.name,
        planner=mission.planner.method,
        command=command or f"copcs-deploy run {mission.path}",
        started_unix_s=time.time() - now_s,
    )
    recorder = Recorder(folder, meta, mission.settings, drawing_of(mission.geometry))
    watch = Watch(recorder, folder, display)
    # before anything is armed; it loads what it may need while the planner starts
    guardian = fleet.guarded(display.note)
    planner = _planner(mission, fleet, display)
    try:
        fleet.hand_over()
        operator.attach(fleet.clock)
        display.begin(_header(mission, fleet))
        with operator:
            outcome = fly(
                mission.settings,
                plan,
                vehicles=fleet.vehicles,
                poses=fleet.poses,
                clock=fleet.clock,
                planner=planner,
                operator=operator,
                observer=watch,
                virtual=fleet.virtual,
                checks_valid_s=now_s + valid_s,
                limit_s=now_s + limit_s,
                linger_s=linger_s,
                guard=guardian,
            )
    finally:
        if guardian is not None:
            guardian.close()
        display.end()
        planner.close()
        _close(recorder, watch)
    return outcome, watch.failure


def _truth(fleet: Fleet) -> Truth | None:
    try:
        return fleet.truth() if fleet.truth is not None else None
    except SimulationError:  # its conductor was killed before it could tell
        return None


def _close(recorder: Recorder, watch: Watch) -> None:
    try:
        recorder.close()
    except (OSError, RuntimeError, DeployError) as error:
        watch.failure = watch.failure or str(error)


def _planner(mission: Mission, fleet: Fleet, display: Display) -> Planner:
    settings = replanning(mission)
    if fleet.virtual:
        return InlinePlanner(settings, fleet.planner_delay_s)
    planner = ProcessPlanner(settings, fleet.planner_delay_s)
    with display.working("starting the planner"):
        planner.wait_warm(WARM_S)  # what compiles now neither delays the first replan nor disturbs the loop
    return planner


def _header(mission: Mission, fleet: Fleet) -> Header:
    problem = mission.problem
    team = ", ".join(
        f"{n} {what}{'' if n == 1 else 's'}" for n, what in ((len(problem.uavs), "UAV"), (len(problem.ugvs), "UGV"))
    )
    return Header(
        mission=mission.name,
        subtitle=f"{team}, {fleet.name}, seed {mission.seed}",
        tasks=problem.n_tasks,
        time_scale=mission.settings.frame.time_scale,
    )
