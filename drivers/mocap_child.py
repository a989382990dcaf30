"""The process that talks to motion capture: ``motioncapture.connect`` holds the GIL and may hang for ever.

It is run as a file of its own, imports nothing of ours, and is the only one that imports ``motioncapture``. Its parent
kills it whenever it likes. Over a socket it sends one message per event, the first byte says which:

* ``S``: started, about to connect.
* ``C``: connected.
* ``E``: why it cannot go on, as text; then it ends.
* ``F``: a frame: time of receipt (``time.monotonic()``, which all processes share), number of bodies, and per body its
  name, position in m and attitude as x y z w.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import signal
import socket
import struct
import sys
import time
from collections.abc import Iterable

STARTED, CONNECTED, ERROR, FRAME = b"S", b"C", b"E", b"F"
BODY = struct.Struct("<7f")
HEAD = struct.Struct("<dH")

Body = tuple[str, tuple[float, float, float], tuple[float, float, float, float]]

_PDEATHSIG = 1  # prctl(2)
_SPIN_S, _SPINS = 5e-5, 1000  # a client that returns so fast, so often, has lost its server and repeats old data


def frame(stamp_s: float, bodies: Iterable[Body]) -> bytes:
    """Packs a frame."""
    parts = []
    for name, position, quaternion in bodies:
        text = name.encode()[:255]
        parts.append(bytes((len(text),)) + text + BODY.pack(*position, *quaternion))
    return FRAME + HEAD.pack(stamp_s, len(parts)) + b"".join(parts)


def parse_frame(message: bytes) -> tuple[float, list[Body]]:
    """The receipt stamp and the bodies of a packed frame."""
    stamp_s, count = HEAD.unpack_from(message, 1)
    at = 1 + HEAD.size
    bodies: list[Body] = []
    for _ in range(count):
        end = at + 1 + message[at]
        name = message[at + 1 : end].decode(errors="replace")
        x, y, z, qx, qy, qz, qw = BODY.unpack_from(message, end)
        bodies.append((name, (x, y, z), (qx, qy, qz, qw)))
        at = end + BODY.size
    return stamp_s, bodies


def _end_with_parent(parent: int) -> None:
    """Has the kernel end this process with the thread that started it: a hanging ``connect`` runs no Python."""
    with contextlib.suppress(OSError, AttributeError):  # only Linux has it
        ctypes.CDLL(None, use_errno=True).prctl(_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    if os.getppid() != parent:
        os._exit(0)


def _stream(link: socket.socket, kind: str, settings: dict[str, str]) -> None:
    import motioncapture  # noqa: PLC0415  # slow, and only here
    import numpy as np  # noqa: F401, PLC0415  # positions need it; loaded at the first frame, it would delay that

    link.send(STARTED)
    if kind == "optitrack":  # its client takes numbers only
        host = settings["hostname"]
        try:
            settings = {**settings, "hostname": socket.gethostbyname(host)}
        except OSError as error:
            raise RuntimeError(f"the host name {host!r} cannot be resolved ({error}); give its address") from None
    client = motioncapture.connect(kind, settings)
    link.send(CONNECTED)
    spins = 0
    while True:
        before_s = time.monotonic()
        client.waitForNextFrame()
        stamp_s = time.monotonic()
        spins = spins + 1 if stamp_s - before_s < _SPIN_S else 0
        if spins > _SPINS:
            raise RuntimeError("the connection to its server is lost")
        try:
            bodies = [(name, b.position, b.rotation) for name, b in client.rigidBodies.items()]
        except RuntimeError:  # the Vicon client raises when one of its subjects is hidden
            bodies = []
        message = frame(stamp_s, ((name, at, (q.x, q.y, q.z, q.w)) for name, at, q in bodies))
        with contextlib.suppress(BlockingIOError):  # the parent is busy: it will want the newest frames, not all
            link.send(message, socket.MSG_DONTWAIT)


def main(arguments: list[str]) -> int:
    """Entry point; arguments: file descriptor of the socket, process id of the parent, type, settings as JSON."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    link = socket.socket(fileno=int(arguments[0]))
    _end_with_parent(int(arguments[1]))
    try:
        _stream(link, arguments[2], json.loads(arguments[3]))
    except (BrokenPipeError, ConnectionResetError):  # the parent has closed its end
        return 0
    except Exception as error:  # whatever the vendor's library raises: the parent says it to the operator
        with contextlib.suppress(OSError):
            link.send(ERROR + str(error).encode()[:2000])
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
