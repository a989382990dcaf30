"""The command line: ``copcs-deploy run | check | plan | simulate | replay | report | benchmark | train``."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from deploy.cli_common import ABORTED, DONE, guarded

app = typer.Typer(
    name="copcs-deploy",
    help="Ground station for teams of UAVs and the UGVs that recharge them.",
    epilog="Exit codes: 0 done or passed, 1 the mission or a check failed, 2 bad input, 3 aborted by the operator.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class Backend(StrEnum):
    """What executes the commands."""

    SIM = "sim"
    REAL = "real"


class Sim(StrEnum):
    """How it is simulated."""

    KINEMATIC = "kinematic"
    WIRE = "wire"


Mission = Annotated[Path, typer.Argument(metavar="MISSION", help="A mission file (YAML).", show_default=False)]
Run = Annotated[Path, typer.Argument(metavar="RUN", help="The folder of a run.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, nothing else.")]
OfBackend = Annotated[Backend, typer.Option(help="Simulated or real vehicles.")]
OfSim = Annotated[
    Sim, typer.Option(help="How they are simulated: in process, or as processes that speak the real protocols.")
]
Method = Annotated[
    str | None, typer.Option("--planner", metavar="NAME", help="Planning method.", show_default="mission's")
]
Seed = Annotated[
    int | None, typer.Option("--seed", min=0, max=2**32 - 1, help="Of everything random.", show_default="mission's")
]


def _version(wanted: bool) -> None:
    if wanted:
        from deploy.recording_meta import versions  # noqa: PLC0415  (see below)

        print(versions()["copcs-deploy"])
        raise typer.Exit


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version and leave.")
    ] = False,
) -> None:
    pass


# Each command imports what it needs itself: `--help` and usage errors answer at once, without compiling a planner.


@app.command()
@guarded
def run(
    mission: Mission,
    backend: OfBackend = Backend.SIM,
    sim: OfSim = Sim.KINEMATIC,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Plan and check, then stop before arming.")] = False,
    planner: Method = None,
    seed: Seed = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Run folder.", show_default="runs/<mission>-<time>")
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Plan a mission, check it, fly it and report.

    Ctrl-C once brings everybody down; twice stops all motors at once.
    """
    from deploy.cli_run import run as command  # noqa: PLC0415

    return command(
        mission,
        backend=backend.value,
        sim=sim.value,
        dry_run=dry_run,
        planner=planner,
        seed=seed,
        out=out,
        as_json=as_json,
    )


@app.command()
@guarded
def check(
    mission: Mission,
    backend: OfBackend = Backend.SIM,
    sim: OfSim = Sim.KINEMATIC,
    identify: Annotated[
        bool, typer.Option("--identify", help="Ask to move each vehicle by hand, and see whether its body moves.")
    ] = False,
    planner: Method = None,
    seed: Seed = None,
    as_json: AsJson = False,
) -> int:
    """Plan a mission and run every pre-flight check, without arming or flying.

    With --backend real it connects the vehicles and the motion capture of the fleet file.
    """
    from deploy.cli_run import check as command  # noqa: PLC0415

    return command(
        mission, backend=backend.value, sim=sim.value, identify=identify, planner=planner, seed=seed, as_json=as_json
    )


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
@guarded
def simulate(
    context: typer.Context,
    target: Annotated[
        str | None,
        typer.Argument(
            metavar="TARGET",
            help="crazyflie, limo, copter, rover or mocap: one endpoint; or a mission file: all of its endpoints.",
        ),
    ] = None,
) -> int:
    """Start simulated vehicles or motion capture that speak the real protocols, for any program.

    With crazyflie, limo, copter, rover or mocap: one endpoint; its options: simulate crazyflie --help.

    With a mission file: all of its endpoints, whose addresses are printed. With --save DIR it also writes a mission
    whose fleet is at these addresses, so that `copcs-deploy run DIR/mission.yaml --backend real` flies it.
    """
    from deploy.cli_simulate import simulate as command  # noqa: PLC0415

    if target in (None, "-h", "--help"):
        print(context.get_help())
        return DONE
    assert target is not None
    return command(target, context.args)


@app.command()
@guarded
def plan(
    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A mission (YAML) or a copcs-problem/1 file (JSON).", show_default=False),
    ],
    planner: Method = None,
    time: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Time to plan.", show_default="mission's, or 5")
    ] = None,
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Plan file; the picture lies beside it as .png.", show_default="FILE.plan.json"
        ),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Plan without flying: a plan file (copcs-plan/1) and a picture of it.

    With --json the plan goes to standard output; files are written then only where --out asks for them.
    """
    from deploy.cli_plan import plan as command  # noqa: PLC0415

    return command(file, planner=planner, time_s=time, seed=seed, out=out, as_json=as_json)


@app.command()
@guarded
def replay(run: Run, as_json: AsJson = False) -> int:
    """Feed a recording through supervisor and gate again; every command must come out the same."""
    from deploy.cli_run import replay as command  # noqa: PLC0415

    return command(run, as_json=as_json)


@app.command()
@guarded
def report(run: Run, as_json: AsJson = False) -> int:
    """Write the report of a run again, and its summary to the terminal."""
    from deploy.cli_run import report as command  # noqa: PLC0415

    return command(run, as_json=as_json)


@app.command()
@guarded
def benchmark(
    quick: Annotated[
        bool, typer.Option("--quick", help="One instance each, next to no time: does it all run?")
    ] = False,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where results are kept.")] = Path("benchmarks/results"),
    rows: Annotated[
        str | None, typer.Option(metavar="A,B", help="These rows of the table only.", show_default="all")
    ] = None,
    sets: Annotated[
        str | None, typer.Option(metavar="A,B", help="These data sets only, such as T15-P5_2-2.", show_default="all")
    ] = None,
    instances: Annotated[
        int | None,
        typer.Option(min=1, max=200, help="Test instances of each data set.", show_default="as each row says"),
    ] = None,
    jobs: Annotated[int, typer.Option(min=1, help="Processes at once; no more than free cores.")] = 1,
    table: Annotated[
        bool, typer.Option("--table", help="Measure nothing, write table and plot of what is there.")
    ] = False,
    as_json: AsJson = False,
) -> int:
    """Compare all planning methods on the paper's data sets; what is measured already is kept."""
    from deploy.cli_benchmark import benchmark as command  # noqa: PLC0415

    return command(
        is_quick=quick, out=out, rows=rows, sets=sets, instances=instances, jobs=jobs, as_json=as_json, table=table
    )


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
@guarded
def train(context: typer.Context) -> int:
    """Train the planning network (copcs); resumable. Its options: train --help. Needs PyTorch."""
    from deploy.cli_train import train as command  # noqa: PLC0415

    return command(context.args)


def main() -> None:
    """Entry point."""
    try:
        app()
    except KeyboardInterrupt:
        sys.exit(ABORTED)
