"""Poses between connecting and the first turn of the loop: estimators need them all the time, long before take-off."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

from drivers.errors import DriverError
from drivers.vehicle import Pose, PoseSource, SelfCheck, Vehicle

PERIOD_S = 0.02
WATCHED = 250
"""Turns that say how well this computer keeps time: the last 5 s."""
LATE_WARN_S, LATE_FAIL_S = 0.02, 0.2
"""A period of the loop; and what the supervisor calls overloaded by default."""


class PoseFeeder:
    """Hands fresh poses to the vehicles from a thread of its own, and looks at them as the loop will.

    Nothing moves meanwhile, so every finite pose is handed on; the loop, which takes over, hands on what it trusts.

    Args:
        vehicles: by id.
        bodies: vehicle id by body.
        poses: connected, or not yet: then there are none.
    """

    def __init__(self, vehicles: Mapping[str, Vehicle], bodies: Mapping[str, str], poses: PoseSource) -> None:
        self._vehicles, self._bodies, self._poses = vehicles, bodies, poses
        self._lock = threading.Lock()
        self._fresh: dict[str, Pose] = {}
        self._late_s: deque[float] = deque(maxlen=WATCHED)
        self._failures: dict[str, str] = {}
        self._open = False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="pose feeder", daemon=True)
        self._thread.start()

    def poses_connected(self) -> None:
        """From now on poses are read."""
        self._open = True

    def read(self) -> Sequence[Pose]:
        """The newest pose of each body since the last call, as ``PoseSource.read``."""
        with self._lock:
            fresh, self._fresh = self._fresh, {}
        return tuple(fresh.values())

    def timing(self) -> SelfCheck:
        """How punctually a thread runs here at the loop's rate, and whether anybody failed in it."""
        if failures := dict(self._failures):
            text = "; ".join(f"{who} failed with {why}" for who, why in sorted(failures.items()))
            return SelfCheck("clock", "fail", f"{text}; restart, and report it if it happens again")
        late = sorted(self._late_s)
        if len(late) < WATCHED // 2:
            return SelfCheck("clock", "not run", "it was not looked at for long enough")
        p99_s = late[int(0.99 * (len(late) - 1))]
        text = f"of the last {len(late)} turns at {1 / PERIOD_S:.0f} Hz 99 % began within {1e3 * p99_s:.0f} ms"
        if p99_s > LATE_WARN_S:
            text += "; close what loads this computer"
        verdict: Literal["pass", "warn", "fail"] = "pass" if p99_s <= LATE_WARN_S else "warn"
        return SelfCheck("clock", "fail" if p99_s > LATE_FAIL_S else verdict, text, p99_s, "s")

    def stop(self) -> None:
        """Ends it: the loop takes over; again does nothing."""
        self._stop.set()
        if self._thread is not threading.current_thread():
            self._thread.join(2.0)

    @contextlib.contextmanager
    def _guarded(self, who: str) -> Iterator[None]:
        """Nobody's failure keeps the others from being fed; what is no plain refusal shows in ``timing``."""
        try:
            yield
        except DriverError:
            pass  # not connected yet, or gone: its own checks tell
        except Exception as error:
            self._failures[who] = f"{type(error).__name__} ({error})"

    def _run(self) -> None:
        due_s = time.monotonic()
        while not self._stop.is_set():
            self._turn()
            due_s = max(due_s + PERIOD_S, time.monotonic())
            self._stop.wait(due_s - time.monotonic())
            self._late_s.append(time.monotonic() - due_s)

    def _turn(self) -> None:
        for vehicle_id, vehicle in self._vehicles.items():
            with self._guarded(vehicle_id):
                vehicle.state()  # drivers tell their vehicles that somebody is there only while somebody looks
        poses: Sequence[Pose] = ()
        if self._open:
            with self._guarded("motion capture"):
                poses = self._poses.read()
        for pose in poses:
            fed = self._bodies.get(pose.body)
            if fed is None or not all(map(math.isfinite, (*pose.position_m, pose.yaw_rad, pose.stamp_s))):
                continue
            with self._lock:
                self._fresh[pose.body] = pose
            with self._guarded(fed):
                self._vehicles[fed].feed_pose(pose)
