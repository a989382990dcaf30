"""The parent's end of the motion-capture child: starts it, hears it, kills it."""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from drivers import mocap_child


class MocapProcess:
    """One child. Start it from a thread that lives as long as it: the kernel ends the two together.

    Args:
        kind: type of motion capture.
        settings: for ``motioncapture.connect``.

    Raises:
        OSError: when the machine has no room for another process.
    """

    def __init__(self, kind: str, settings: Mapping[str, str]) -> None:
        self._link, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            try:
                # a session of its own: Ctrl-C in the terminal is for the parent, which still needs poses to land
                self._process = subprocess.Popen(
                    [sys.executable, "-P", str(Path(mocap_child.__file__)), str(theirs.fileno()), str(os.getpid()),
                     kind, json.dumps(dict(settings))],
                    pass_fds=(theirs.fileno(),), start_new_session=True,
                    stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                )  # fmt: skip
            except OSError:
                self._link.close()
                raise
        self._link.setblocking(False)

    @property
    def pid(self) -> int:
        """Its process id."""
        return self._process.pid

    def receive(self, timeout_s: float) -> list[bytes] | None:
        """All messages that are there, waiting for the first one; None when the child has ended."""
        if not select.select([self._link], [], [], max(0.0, timeout_s))[0]:
            return []
        messages: list[bytes] = []
        with contextlib.suppress(BlockingIOError):
            while True:
                try:
                    message = self._link.recv(1 << 17)
                except ConnectionResetError:
                    message = b""
                if not message:
                    return messages or None
                messages.append(message)
        return messages

    def how_it_ended(self) -> str:
        """The reason in words, after ``receive`` returned None."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = self._process.wait(1.0)
            if code < 0:
                return f"its client was ended by {signal.Signals(-code).name}"
            return f"its client ended with code {code}"
        return "its client has closed its end"

    def kill(self) -> None:
        """Ends it at once; safe from any thread, again does nothing. ``receive`` returns None then."""
        if self._process.poll() is None:
            self._process.kill()

    def close(self) -> None:
        """Ends it and releases everything."""
        self.kill()
        self._process.wait()
        self._link.close()
