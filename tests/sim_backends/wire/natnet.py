"""A NatNet server as a process, for tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil


class Server:
    """One server; a context manager."""

    def __init__(self, *arguments: str, port: int = 0) -> None:
        command = [sys.executable, "-m", "sim_backends.wire.natnet_server"]
        command += ["--command-port", str(port), "--data-port", "0", *arguments]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        assert line.startswith("ready natnet "), (line, self.process.stderr.read() if self.process.stderr else "")
        host, number = line.split()[-1].split(":")
        self.host, self.port = host, int(number)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.process.send_signal(signal.SIGCONT)
        self.process.terminate()
        self.process.wait(20.0)
        for pipe in (self.process.stdout, self.process.stderr):
            if pipe is not None:
                pipe.close()

    def kill(self) -> None:
        """Ends it without a word, stopped or not."""
        self.process.kill()
        self.process.wait()

    def signal(self, number: signal.Signals) -> None:
        """Sends it a signal."""
        os.kill(self.process.pid, number)


def world_server(folder: Path, *arguments: str, port: int = 0) -> Server:
    """A server of a world."""
    return Server("--world", str(folder), *arguments, port=port)


def wait_for(condition: Callable[[], object], deadline_s: float = 20.0) -> None:
    """Waits until something holds."""
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s, "waited too long"
        time.sleep(0.005)


def alive(pid: int) -> bool:
    """Whether a process runs."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
