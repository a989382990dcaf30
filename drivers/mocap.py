"""Motion capture through ``motioncapture``: OptiTrack, Vicon, Qualisys, VRPN; a ``PoseSource``.

The vendor's client runs in a child process (``mocap_child``), which a thread here hears, kills when it hangs or falls
silent, and starts again. ``read`` only ever takes what that thread has left for it.
"""

from __future__ import annotations

import difflib
import threading
import time
from collections import deque
from collections.abc import Sequence

from drivers import mocap_child
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.mocap_axes import to_arena
from drivers.mocap_health import UNNAMED, Frame, HealthLimits, health
from drivers.mocap_options import MocapOptions
from drivers.mocap_process import MocapProcess
from drivers.vehicle import Pose, SelfCheck

__all__ = ["Mocap", "MocapOptions"]

_KEPT_S = 5.0
"""Frames of so long are kept for the checks."""
_START_S = 15.0
"""A child that has not loaded the vendor's library by then is replaced; 0.2 s on an idle computer."""

_REMEDY = {
    "mock": "check mock_bodies",
    "vicon": "check that Tracker or Nexus runs there and that port 801 is open",
    "optitrack": "check that Motive streams (Broadcast Frame Data on, its local interface is this network), and that "
    "no firewall stops UDP 1510 and 1511",
    "qualisys": "check that QTM runs there with a measurement open, and that port 22222 is open",
    "vrpn": "check that its VRPN server runs there and that port 3883 is open",
}


class Mocap:
    """One motion-capture system.

    Args:
        options: how to reach it.
        bodies: names that the mission needs; only these are read. None at all: every body.
        clock: of the loop; poses are stamped on it.
    """

    def __init__(self, options: MocapOptions, bodies: Sequence[str], clock: Clock) -> None:
        self._options, self._wanted, self._clock = options, tuple(bodies), clock
        self._turn = to_arena(options.up, options.yaw_rad, options.translation_m)
        self._to_loop_s = 0.0
        self._changed = threading.Condition()  # guards all below
        self._newest: dict[str, Pose] = {}
        self._frames: deque[Frame] = deque()
        self._present: set[str] = set()
        self._error: str | None = None
        self._answered = False
        self._first_s: float | None = None
        self._restarts = -1
        self._child: MocapProcess | None = None
        self._thread: threading.Thread | None = None
        self._closing = threading.Event()

    @property
    def child_pid(self) -> int | None:
        """Process id of the vendor's client while it runs."""
        with self._changed:
            return None if self._child is None else self._child.pid

    def connect(self, deadline_s: float) -> None:
        """Connects, and waits until every wanted body has been seen.

        Raises:
            DriverError: when the system does not answer, sends nothing, or does not know a body; nothing is left
                running then.
        """
        self.close()
        self._closing.clear()
        # the offset of the two clocks; a pause between the two calls makes it too small
        self._to_loop_s = max(self._clock.now() - time.monotonic() for _ in range(3))
        with self._changed:
            self._newest, self._present, self._error = {}, set(), None
            self._frames.clear()
            self._answered, self._first_s, self._restarts = False, None, -1
        self._thread = threading.Thread(target=self._run, name="mocap", daemon=True)
        self._thread.start()
        problem = self._wait(time.monotonic() + deadline_s - self._clock.now())
        if problem is not None:
            self.close()
            raise DriverError(f"{self._options.where}: {problem}")

    def read(self) -> Sequence[Pose]:
        """The newest pose of each wanted body received since the last call; never blocks."""
        with self._changed:
            poses, self._newest = self._newest, {}
        return tuple(poses.values())

    def checks(self, limits: HealthLimits | None = None) -> Sequence[SelfCheck]:
        """What the last seconds of frames show; for pre-flight."""
        with self._changed:
            frames, restarts = list(self._frames), self._restarts
        found = health(frames, self._wanted, time.monotonic(), limits)
        if restarts > 0:
            why = f" ({self._error})" if self._error else ""
            text = f"the connection was lost {restarts} times{why}; check the network and the system's computer"
            found.append(SelfCheck("poses connection", "warn", text, float(restarts)))
        return found

    def close(self) -> None:
        """Ends the child and the thread; again does nothing."""
        self._closing.set()
        with self._changed:
            if self._child is not None:
                self._child.kill()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        with self._changed:
            self._newest = {}

    # --- in the caller's thread, while it connects

    def _wait(self, deadline_s: float) -> str | None:
        """Why it could not be connected until ``deadline_s`` on the monotonic clock; None when all is well."""
        begun_s = time.monotonic()
        with self._changed:
            while True:
                if self._error is not None:
                    return f"{self._error}; {_REMEDY[self._options.type]}"
                missing = [body for body in self._wanted if body not in self._present]
                if self._first_s is not None and not missing:
                    return None
                last_s = deadline_s
                if self._present and self._first_s is not None:
                    last_s = min(last_s, self._first_s + self._options.bodies_s)
                left_s = last_s - time.monotonic()
                if left_s <= 0:
                    return self._why(missing, time.monotonic() - begun_s)
                self._changed.wait(left_s)

    def _why(self, missing: list[str], waited_s: float) -> str:
        remedy = _REMEDY[self._options.type]
        if not self._answered:
            return f"no answer within {waited_s:.1f} s; {remedy}"
        if self._first_s is None:
            return f"it answers but has sent no frame for {waited_s:.1f} s; {remedy}, and interface_ip if it multicasts"
        if not self._present:
            return f"no body seen within {waited_s:.1f} s, the server may not be there at all; {remedy}"
        return _missing(missing, self._present)

    # --- in the thread

    def _run(self) -> None:
        options = self._options
        pause_s = options.retry_s
        while not self._closing.is_set():
            with self._changed:
                if self._closing.is_set():
                    return
                self._restarts += 1
                try:
                    self._child = MocapProcess(options.type, options.settings())
                except OSError as error:
                    self._fail(f"cannot start its client ({error})")
            if self._child is not None:
                lived = self._hear(self._child)
                with self._changed:
                    child, self._child = self._child, None
                child.close()
                if lived:
                    pause_s = options.retry_s
            self._closing.wait(pause_s)
            pause_s = min(2 * pause_s, options.retry_max_s)

    def _hear(self, child: MocapProcess) -> bool:
        """Hears one child until it ends, hangs or falls silent; whether a frame came from it."""
        options = self._options
        limit_s, answered, lived = time.monotonic() + _START_S, False, False
        while not self._closing.is_set():
            messages = child.receive(min(limit_s - time.monotonic(), 0.5))
            if messages is None:
                self._fail(child.how_it_ended())
                return lived
            for message in messages:
                if message[:1] == mocap_child.FRAME:
                    # VRPN sends empty frames when nobody is there: only bodies are a sign of life
                    if self._take(message) or options.type != "vrpn":
                        lived = True
                        limit_s = time.monotonic() + options.silence_s
                elif message[:1] == mocap_child.STARTED:
                    limit_s = time.monotonic() + options.attempt_s
                elif message[:1] == mocap_child.CONNECTED:
                    answered = True
                    limit_s = time.monotonic() + options.silence_s
                    with self._changed:
                        self._answered = True
                elif message[:1] == mocap_child.ERROR:
                    self._fail(message[1:].decode(errors="replace"))
                    return lived
            if time.monotonic() > limit_s:
                return lived or answered
        return lived

    def _take(self, message: bytes) -> bool:
        """Notes a frame; whether it had a body."""
        stamp_s, bodies = mocap_child.parse_frame(message)
        poses: dict[str, Pose] = {}
        for name, position, quaternion in bodies:
            turned = self._turn(position, quaternion)
            if turned is not None:
                poses[name] = Pose(name, turned[0], turned[1], stamp_s + self._to_loop_s)
        heard_s = time.monotonic()
        with self._changed:
            for name, pose in poses.items():
                if not self._wanted or name in self._wanted:
                    self._newest[name] = pose
            self._frames.append(Frame(stamp_s, heard_s, {name: pose.position_m for name, pose in poses.items()}))
            while heard_s - self._frames[0].stamp_s > _KEPT_S and len(self._frames) > 1:
                self._frames.popleft()
            if self._first_s is None or not self._present >= poses.keys():
                self._first_s = heard_s if self._first_s is None else self._first_s
                self._present |= poses.keys()
                self._changed.notify_all()
        return bool(poses)

    def _fail(self, text: str) -> None:
        with self._changed:
            self._error = text
            self._changed.notify_all()


def _missing(missing: Sequence[str], present: set[str]) -> str:
    known = sorted(name or UNNAMED for name in present)
    texts = []
    for body in missing:
        lower = {name.lower(): name for name in known}
        near = difflib.get_close_matches(body.lower(), lower, 1)
        texts.append(f"{body!r}" + (f" (did you mean {lower[near[0]]!r}?)" if near else ""))
    return (
        f"it does not see {', '.join(texts)}; it sees {', '.join(known)}. Name the bodies as the mission does, "
        "and look whether their markers are in view"
    )
