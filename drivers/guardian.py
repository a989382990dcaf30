"""A process that outlives the ground station: when that dies or hangs, it brings the vehicles down.

The ground station holds the writing end of the guardian's standard input and tells it several times a second who is
under way. When the pipe closes without a farewell (the program was killed), or nothing comes for ``silence_s`` (it
hangs), every vehicle that was under way gets its last will (``drivers.last_will``). The guardian runs in a session of
its own, so that Ctrl-C or a lost terminal, which the ground station handles itself, do not reach it.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import os
import select
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict

from drivers.last_will import LastWill

SILENCE_S = 3.0
"""A ground station that says nothing for so long hangs; its loop turns 50 times a second."""
DEADLINE_S = 20.0
"""A will that is not carried out by then cannot be."""
TELL_EVERY_S = 0.2

log = logging.getLogger(__name__)


class Guardian:
    """The ground station's end: starts the process, keeps it informed, sends it home."""

    def __init__(self, wills: Iterable[LastWill], silence_s: float = SILENCE_S) -> None:
        self._told_s = -TELL_EVERY_S
        self._process: subprocess.Popen[bytes] | None = subprocess.Popen(
            [sys.executable, "-m", "drivers.guardian"],
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        self._say({"wills": [asdict(w) for w in wills], "silence_s": silence_s})

    @property
    def pid(self) -> int | None:
        """Its process, while it runs."""
        return None if self._process is None or self._process.poll() is not None else self._process.pid

    def tell(self, under_way: Mapping[str, float], now_s: float) -> None:
        """Says who is under way and how high above the ground, in m; call it every turn, it is sent when it is due.

        Args:
            under_way: height by vehicle id; only these get their last will.
            now_s: on any clock that goes on.
        """
        if now_s - self._told_s >= TELL_EVERY_S:
            self._told_s = now_s
            self._say({"under_way": dict(under_way)})

    def dismiss(self) -> None:
        """Everybody is down: the process ends without doing anything; again does nothing."""
        process, self._process = self._process, None
        if process is None:
            return
        self._process = process
        self._say({"farewell": True})
        self._process = None
        assert process.stdin is not None  # it was made with a pipe
        with contextlib.suppress(BrokenPipeError):
            process.stdin.close()
        try:
            process.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    def _say(self, message: Mapping[str, object]) -> None:
        if self._process is None or self._process.stdin is None:
            return
        try:
            self._process.stdin.write(json.dumps(message).encode() + b"\n")
            self._process.stdin.flush()
        except (BrokenPipeError, ValueError):
            log.warning("the guardian process has died; if this program is killed now, nobody brings the vehicles down")
            self._process = None


def watch(fd: int) -> list[str]:
    """The guardian's own life: listens until the end and carries out what has to be.

    Returns:
        what was done for whom; empty after a farewell.
    """
    wills: dict[str, LastWill] = {}
    under_way: dict[str, float] = {}
    silence_s: float | None = None
    rest = b""
    while True:
        ready, _, _ = select.select([fd], [], [], silence_s if under_way else None)
        chunk = os.read(fd, 65536) if ready else b""
        if not chunk:
            if not under_way:
                if ready:
                    return []
                continue
            done = _carry_out([wills[v] for v in under_way if v in wills], under_way)
            under_way = {}
            if ready:
                return done
            continue  # it hung; it may yet come back, or die
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            message = json.loads(line)
            if message.get("farewell"):
                return []
            if "wills" in message:
                wills = {w["vehicle"]: LastWill(**w) for w in message["wills"]}
                silence_s = float(message["silence_s"])
            under_way = {str(v): float(h) for v, h in message.get("under_way", under_way).items()}


def _carry_out(wills: list[LastWill], heights_m: Mapping[str, float]) -> list[str]:
    deadline_s = time.monotonic() + DEADLINE_S

    def one(will: LastWill) -> str:
        try:
            said = importlib.import_module(will.module).carry_out(will.arguments, heights_m[will.vehicle], deadline_s)
        except Exception as error:  # whatever fails for one vehicle, the others still get theirs
            said = f"failed: {type(error).__name__}: {error}"
        line = f"guardian: the ground station is gone; {will.vehicle}: {said}"
        print(line, file=sys.stderr, flush=True)
        return line

    if not wills:
        return []
    with ThreadPoolExecutor(len(wills)) as pool:
        return list(pool.map(one, wills))


if __name__ == "__main__":
    try:
        watch(sys.stdin.fileno())
    except OSError:  # standard error may have gone with the terminal
        sys.exit(1)
