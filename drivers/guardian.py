"""A process that outlives the ground station: when that dies or hangs, it brings the vehicles down.

The ground station holds the writing end of the guardian's standard input and tells it several times a second who is
under way. When the pipe closes without a farewell (the program was killed), or nothing comes for ``silence_s`` (it
hangs), every vehicle that was under way gets its last will (``drivers.last_will``). A ground station that hangs is
killed first: it holds the radios and ports that the wills need, and must not wake up and fly who was just landed.

The guardian runs in a session of its own and is deaf to signals: Ctrl-C, a lost terminal or the end of a service are
the ground station's to handle, and whoever ends both at once wants nobody left in the air.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path

from drivers.last_will import LastWill

SILENCE_S = 3.0
"""A ground station that says nothing for so long hangs; its loop turns 50 times a second."""
DEADLINE_S = 60.0
"""A will that is not carried out by then cannot be. A copter that comes down from 40 m needs most of it."""
TELL_EVERY_S = 0.2
DEAF_TO = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

log = logging.getLogger(__name__)


class Guardian:
    """The ground station's end: starts the process, keeps it informed, sends it home.

    Args:
        wills: of the fleet.
        silence_s: after this the ground station counts as hanging while anybody is under way.
        say: told when it guards no more.

    Attributes:
        lost: why it guards no more; None while it does.
    """

    def __init__(
        self, wills: Iterable[LastWill], silence_s: float = SILENCE_S, say: Callable[[str], None] = log.warning
    ) -> None:
        self.lost: str | None = None
        self._say_lost = say
        self._told_s = -TELL_EVERY_S
        self._under_way: dict[str, float] = {}
        root = str(Path(__file__).resolve().parents[1])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        # deaf from its first moment on: it inherits what is blocked here; what comes to us meanwhile is only late
        before = signal.pthread_sigmask(signal.SIG_BLOCK, DEAF_TO)
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "drivers.guardian"],
                bufsize=0,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,  # whoever reads the ground station's must not wait for the guardian's
                start_new_session=True,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
            )
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        assert self._process.stdin is not None  # it was made with a pipe
        self._pipe = self._process.stdin
        self._say({"wills": [asdict(w) for w in wills], "silence_s": silence_s, "station": os.getpid()})
        os.set_blocking(self._pipe.fileno(), False)

    @property
    def pid(self) -> int | None:
        """Its process, while it runs."""
        return self._process.pid if self._process.poll() is None else None

    def tell(self, under_way: Mapping[str, float], now_s: float) -> None:
        """Says who is under way and how high above the ground, in m; call it every turn. Never blocks.

        It is sent at once when somebody sets out or comes to rest, else a few times a second.

        Args:
            under_way: height by vehicle id; only these get their last will.
            now_s: on any clock that goes on.
        """
        if now_s - self._told_s >= TELL_EVERY_S or under_way.keys() != self._under_way.keys():
            self._told_s, self._under_way = now_s, dict(under_way)
            self._say({"under_way": self._under_way})

    def close(self) -> None:
        """The flight is over. With nobody under way the process ends; else it carries out their last wills.

        Again does nothing. ``wait`` waits for its end.
        """
        if not self._under_way:
            self._say({"farewell": True})
        with contextlib.suppress(OSError):
            self._pipe.close()

    def wait(self, timeout_s: float = DEADLINE_S + 5.0) -> None:
        """Waits, after ``close``, until it has ended; ends it after ``timeout_s``."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _say(self, message: Mapping[str, object]) -> None:
        if self.lost is not None or self._pipe.closed:
            return
        data = json.dumps(message).encode() + b"\n"
        try:
            if os.write(self._pipe.fileno(), data) == len(data):
                return
            why = "does not listen"
        except BlockingIOError:  # a pipe takes minutes of messages
            why = "does not listen"
        except OSError:
            why = "has died"
        # one that wakes up later would take the silence for our death
        self._process.kill()
        self.lost = f"the guardian process {why}; if this program is killed now, nobody brings the vehicles down"
        with contextlib.suppress(Exception):  # a broken display must not end the flight
            self._say_lost(self.lost)


def watch(fd: int) -> list[str]:
    """The guardian's own life: listens until the end and carries out what has to be.

    Returns:
        what was done for whom; empty after a farewell.
    """
    wills: dict[str, LastWill] = {}
    under_way: dict[str, float] = {}
    silence_s: float | None = None
    station = 0
    rest = b""
    while True:
        ready, _, _ = select.select([fd], [], [], silence_s if under_way else None)
        if not ready:
            _kill(station)
            break
        chunk = os.read(fd, 65536)
        if not chunk:
            break
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            message = json.loads(line)
            if message.get("farewell"):
                return []
            if "wills" in message:
                wills = {w["vehicle"]: LastWill(**w) for w in message["wills"]}
                silence_s, station = float(message["silence_s"]), int(message["station"])
                _prepare({w.module for w in wills.values()})
            under_way = {str(v): float(h) for v, h in message.get("under_way", under_way).items()}
    return _carry_out([wills[v] for v in under_way if v in wills], under_way)


def _kill(station: int) -> None:
    """Ends our parent; not somebody who has got its number since."""
    if station and os.getppid() == station:
        with contextlib.suppress(OSError):
            os.kill(station, signal.SIGKILL)


def _prepare(modules: Iterable[str]) -> None:
    """Loads now what takes seconds to load."""
    for name in modules:
        with contextlib.suppress(Exception):  # said when it is needed
            getattr(importlib.import_module(name), "prepare", lambda: None)()


def _carry_out(wills: list[LastWill], heights_m: Mapping[str, float]) -> list[str]:
    deadline_s = time.monotonic() + DEADLINE_S

    def one(will: LastWill) -> str:
        try:
            said = importlib.import_module(will.module).carry_out(will.arguments, heights_m[will.vehicle], deadline_s)
        except Exception as error:  # whatever fails for one vehicle, the others still get theirs
            said = f"failed: {error or type(error).__name__}"
        line = f"guardian: the ground station is gone; {will.vehicle}: {said}"
        with contextlib.suppress(OSError):  # standard error may have gone with the terminal
            print(line, file=sys.stderr, flush=True)
        return line

    if not wills:
        return []
    with ThreadPoolExecutor(len(wills)) as pool:
        return list(pool.map(one, wills))


if __name__ == "__main__":
    watch(sys.stdin.fileno())
    os._exit(0)  # a vendor's thread must not keep it
