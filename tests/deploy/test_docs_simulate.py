"""Every command by which docs/simulation.md starts an endpoint alone does start it."""

from __future__ import annotations

import re
import shlex
import socket
import subprocess
import threading
from pathlib import Path

import pytest
from wire_runs import PROGRAM

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "simulation.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\| `copcs-deploy simulate ([^`]*)`", PAGE, re.MULTILINE)


def free_port(kind: socket.SocketKind) -> str:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        return str(probe.getsockname()[1])


def test_every_endpoint_is_shown() -> None:
    assert [command.split()[0] for command in COMMANDS] == ["crazyflie", "limo", "copter", "rover", "mocap"]


@pytest.mark.wire
@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.split()[0])
def test_it_starts(command: str) -> None:
    kind = socket.SOCK_STREAM if "--tcp" in command else socket.SOCK_DGRAM
    # ports of the page may be somebody else's here
    words = shlex.split(re.sub(r"\b(19850|14540|5760)\b", free_port(kind), command))
    if words[0] == "mocap":
        words += ["--command-port", "0", "--data-port", "0"]
    program = subprocess.Popen([*PROGRAM, "simulate", *words], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    killer = threading.Timer(120.0, program.kill)
    killer.start()
    try:
        assert program.stdout is not None
        assert program.stdout.readline().startswith("ready"), command
        program.terminate()
        assert program.wait(20.0) == 0
    finally:
        killer.cancel()
        program.kill()
        program.wait()
        program.stdout.close()
