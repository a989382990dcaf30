"""Where a dock is and how fast its UGV moves, from the UGV's trusted poses. Pure."""

from __future__ import annotations

import math
from collections import deque

from drivers.limits import Pads
from drivers.mavlink_dock import PadSeen
from drivers.vehicle import Pose, Vec2

WINDOW_S = 0.6
"""Speed is measured over so long: poses wobble by a centimetre."""


class PadTracker:
    """Follows the UGV that carries a dock."""

    def __init__(self) -> None:
        self._seen: deque[Pose] = deque()

    def look(self, pads: Pads, dock: int, pose: Pose | None, now_s: float, stale_s: float) -> PadSeen | None:
        """The dock now; None where its UGV's pose is stale or the dock does not exist."""
        if pose is None or now_s - pose.stamp_s > stale_s or not 0 <= dock < len(pads.offsets_m):
            return None
        if not self._seen or self._seen[-1].body != pose.body:
            self._seen.clear()
        if not self._seen or pose.stamp_s > self._seen[-1].stamp_s:
            self._seen.append(pose)
        while len(self._seen) > 2 and self._seen[1].stamp_s <= pose.stamp_s - WINDOW_S:
            self._seen.popleft()
        old = self._seen[0]
        passed_s = pose.stamp_s - old.stamp_s
        velocity = (0.0, 0.0)
        if passed_s >= 0.5 * WINDOW_S:
            velocity = (
                (pose.position_m[0] - old.position_m[0]) / passed_s,
                (pose.position_m[1] - old.position_m[1]) / passed_s,
            )
        x, y = dock_place(pads, dock, pose)
        return PadSeen((x, y, pads.height_m), velocity, pads.tolerance_m)


def dock_place(pads: Pads, dock: int, pose: Pose) -> Vec2:
    """Where a dock is when its UGV is at ``pose``."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    ox, oy = pads.offsets_m[dock]
    return (pose.position_m[0] + c * ox - s * oy, pose.position_m[1] + s * ox + c * oy)
