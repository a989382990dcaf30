"""What the driver of one Crazyflie knows: newest log values, poses, the pads around. Safe to share between threads."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

from drivers.limits import Pads, PoseBook
from drivers.vehicle import Pose, Vec2, Vec3

MOTION_S = 0.5
REBOOT_MS, QUIET_MS = 1000, 3000
WRAP_MS = 1 << 24


@dataclass
class Telemetry:
    """The newest value of each log variable and when anything came at all."""

    stamp_s: float = -math.inf
    values: dict[str, float] = field(default_factory=dict)
    stamps: dict[str, float] = field(default_factory=dict)
    reboots: int = 0
    new_link: bool = False
    _clock_ms: int = 0
    _lock: threading.Lock = field(default_factory=threading.Lock)

    def put(self, now_s: float, clock_ms: int, values: Mapping[str, float]) -> None:
        """Notes one log block.

        A clock that has gone back is a reboot (it wraps after 4.6 hours), and so is one that has advanced by much less
        than ours while nothing was heard. While something is heard that comparison would mean nothing: blocks may have
        waited for this process.
        """
        with self._lock:
            ahead_ms = (clock_ms - self._clock_ms + WRAP_MS // 2) % WRAP_MS - WRAP_MS // 2
            gap_ms = 1000.0 * (now_s - self.stamp_s)
            quiet = math.isfinite(gap_ms) and (gap_ms > QUIET_MS or self.new_link)
            if math.isfinite(gap_ms) and (ahead_ms < -REBOOT_MS or (quiet and ahead_ms < 0.9 * gap_ms - REBOOT_MS)):
                self.reboots += 1
                self.values.clear()
                self._clock_ms = clock_ms
            self.new_link = False
            # two blocks may overtake each other by a few ms
            self._clock_ms = clock_ms if ahead_ms > 0 else self._clock_ms
            self.stamp_s = now_s
            self.values.update(values)
            self.stamps.update(dict.fromkeys(values, now_s))

    def snapshot(self) -> tuple[float, dict[str, float]]:
        """When the newest came, and all values."""
        with self._lock:
            return self.stamp_s, dict(self.values)

    def stamp_of(self, name: str) -> float:
        """When the newest value of one variable came."""
        with self._lock:
            return self.stamps.get(name, -math.inf)

    def age_s(self, name: str, now_s: float) -> float:
        """Age of one variable."""
        return now_s - self.stamp_of(name)


class Track:
    """The last moments of one body: where it is and how fast it has been."""

    def __init__(self) -> None:
        self._poses: deque[Pose] = deque(maxlen=200)

    def put(self, pose: Pose) -> None:
        """Notes a pose."""
        if not self._poses or pose.stamp_s > self._poses[-1].stamp_s:
            self._poses.append(pose)

    @property
    def newest(self) -> Pose | None:
        """The newest pose."""
        return self._poses[-1] if self._poses else None

    def moved_m(self, over_s: float = MOTION_S) -> float:
        """How far it has come in the last ``over_s``, m; 0 where less is known."""
        if not self._poses:
            return 0.0
        last = self._poses[-1]
        early = [p for p in self._poses if p.stamp_s >= last.stamp_s - over_s]
        if last.stamp_s - early[0].stamp_s < 0.5 * over_s:
            return 0.0
        return math.dist(early[0].position_m, last.position_m)


def pad_m(pose: Pose, offset_m: Vec2, height_m: float) -> Vec3:
    """Where a dock is on a UGV that stands at ``pose``."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    x, y, _ = pose.position_m
    return (x + c * offset_m[0] - s * offset_m[1], y + s * offset_m[0] + c * offset_m[1], height_m)


def ground_m(at_m: Vec3, pads: Mapping[str, Pads], book: PoseBook) -> float:
    """Height of what lies beneath a point: a dock above which it is, or the floor.

    Beside a dock by up to three times its tolerance still counts: a UGV's roof is larger than the contact.
    """
    highest = 0.0
    for pad in pads.values():
        pose = book.get(pad.body)
        if pose is None or at_m[2] < 0.7 * pad.height_m:
            continue
        for offset in pad.offsets_m:
            x, y, z = pad_m(pose, offset, pad.height_m)
            if math.hypot(at_m[0] - x, at_m[1] - y) <= 3.0 * pad.tolerance_m:
                highest = max(highest, z)
    return highest
