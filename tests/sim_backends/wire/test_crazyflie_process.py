"""How the simulated Crazyflie's process starts and ends."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

pytestmark = pytest.mark.wire

ROOT = Path(__file__).parents[3]
COMMAND = [sys.executable, "-m", "sim_backends.wire.crazyflie_server", "--port", "0"]


@pytest.fixture
def alone() -> Iterator[tuple[subprocess.Popen[str], tuple[str, int]]]:
    """A server in a world of its own, and its address."""
    process = subprocess.Popen([*COMMAND, "--feed"], cwd=ROOT, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    word, _, uri = process.stdout.readline().strip().partition(" ")
    assert word == "ready"
    yield process, ("127.0.0.1", int(uri.rpartition(":")[2]))
    process.terminate()
    process.wait(20.0)


def test_answers_the_first_packet_after_it_said_ready(
    alone: tuple[subprocess.Popen[str], tuple[str, int]],
) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as client:
        client.settimeout(10.0)
        client.sendto(b"\xfd\x00", alone[1])
        assert client.recv(100)[1:19] == b"Bitcraze Crazyflie"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_ends_at_once_when_told(alone: tuple[subprocess.Popen[str], tuple[str, int]], number: int) -> None:
    alone[0].send_signal(number)
    assert alone[0].wait(3.0) == 0


def test_ends_with_its_parent() -> None:
    code = (
        "import subprocess,sys,os;"
        "p=subprocess.Popen([sys.executable,'-m','sim_backends.wire.crazyflie_server','--port','0',"
        "'--parent',str(os.getpid())],stdout=subprocess.PIPE,text=True);"
        "print(p.pid,p.stdout.readline(),flush=True);sys.stdin.read()"
    )
    parent = subprocess.Popen(
        [sys.executable, "-c", code], cwd=ROOT, stdout=subprocess.PIPE, stdin=subprocess.PIPE, text=True
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline().split()[0])
    parent.kill()
    parent.wait()
    end = time.monotonic() + 20.0
    while psutil.pid_exists(child) and psutil.Process(child).status() != "zombie":
        assert time.monotonic() < end
        time.sleep(0.05)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (["--variant", "paper"], "paper"),
        (["--protocol", "3"], "protocol"),
        (["--world", "/nonexistent"], "no simulated world"),
        (["--host", "203.0.113.1"], "203.0.113.1"),
    ],
)
def test_what_cannot_be_done_is_one_clear_line(options: list[str], word: str) -> None:
    done = subprocess.run([*COMMAND, *options], cwd=ROOT, capture_output=True, text=True, timeout=60.0, check=False)
    assert done.returncode == 2
    assert word in done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
