"""``copcs-deploy simulate``: a mission's endpoints, flown as if they were real; and each endpoint alone."""

from __future__ import annotations

import signal
import subprocess
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from wire_runs import PROGRAM, nothing_left, small_file

from deploy.mission import load
from deploy.recording_read import read

ROOT = Path(__file__).resolve().parents[2]


def test_help_of_all_and_of_one() -> None:
    both = [subprocess.run([*PROGRAM, "simulate", *more], capture_output=True, text=True, cwd=ROOT, check=True).stdout
            for more in ([], ["--help"])]  # fmt: skip
    assert both[0] == both[1]
    for word in ("crazyflie, limo, copter, rover or mocap", "mission file", "--save DIR"):
        assert word in " ".join(both[0].replace("│", " ").split())


def test_neither_an_endpoint_nor_a_mission() -> None:
    done = subprocess.run([*PROGRAM, "simulate", "crazyfly"], capture_output=True, text=True, cwd=ROOT, check=False)
    assert done.returncode == 2
    assert "'crazyfly' is neither one of crazyflie, limo, copter, rover, mocap nor a mission file" in done.stderr


def test_identity_needs_motion_capture() -> None:
    mission = str(ROOT / "mission_configs" / "lab.yaml")
    for more, words in (([], "does not use"), (["--json"], "talks to the operator")):
        command = [*PROGRAM, "check", mission, "--identify", *more]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False)
        assert done.returncode == 2
        assert f"--identify: {words}" in done.stderr.replace(
            "asks who moves in motion capture, which this mission ", ""
        )


@contextmanager
def running(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], list[str]]]:
    """The program until the block ends, and what it says; Ctrl-C then ends it."""
    program = subprocess.Popen(
        # as a script's `... &` starts it: with interrupts switched off
        ["sh", "-c", "trap '' INT; exec \"$@\"", "sh", *PROGRAM, "simulate", *arguments],
        stdout=subprocess.PIPE,
        text=True,
        cwd=ROOT,
    )
    lines: list[str] = []
    said = threading.Event()

    def listen() -> None:
        assert program.stdout is not None
        for line in program.stdout:
            lines.append(line)
            if line.startswith(("ready", "Ctrl-C ends")):
                said.set()

    threading.Thread(target=listen, daemon=True).start()
    try:
        assert said.wait(120.0), lines
        yield program, lines
    finally:
        program.send_signal(signal.SIGINT)
        try:
            program.wait(20.0)
        finally:
            program.kill()


@pytest.mark.wire
@pytest.mark.parametrize(
    "arguments",
    [
        ["crazyflie", "--port", "0"],
        ["limo", "--domain", "97"],
        ["copter", "--out", "127.0.0.1:24559", "--sysid", "7"],
        ["rover", "--out", "127.0.0.1:24560", "--sysid", "8"],
        ["mocap", "--address", "127.0.0.77", "--command-port", "0", "--data-port", "0"],
    ],
    ids=lambda a: a[0],
)
def test_each_endpoint_starts_alone_and_ends_with_ctrl_c(arguments: list[str]) -> None:
    with running(*arguments) as (program, lines):
        assert lines[-1].startswith("ready")
    assert program.returncode == 0


@pytest.mark.wire
def test_the_real_backend_flies_a_simulated_fleet(tmp_path: Path) -> None:
    mission = small_file(tmp_path / "mission", 2)
    with nothing_left():
        with running(str(mission), "--save", str(tmp_path / "pointed")) as (_, lines):
            said = "".join(lines)
            assert "udp://127.0.0.1:" in said
            assert "optitrack at 127." in said
            pointed = load(tmp_path / "pointed" / "mission.yaml")
            assert {v.endpoint for v in pointed.fleet if v.driver == "limo"} == {"/limo1", "/limo2"}
            command = [*PROGRAM, "run", str(pointed.path), "--backend", "real", "--out", str(tmp_path / "run")]
            flown = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=400, check=False)
        assert flown.returncode == 0, flown.stdout + flown.stderr
    assert "2 of 2" in flown.stdout
    assert read(tmp_path / "run").meta.backend == "real"
    again = subprocess.run(
        [*command[:-1], str(tmp_path / "run")], capture_output=True, text=True, cwd=ROOT, check=False
    )
    assert again.returncode == 2, "the recording of a real flight is kept"
