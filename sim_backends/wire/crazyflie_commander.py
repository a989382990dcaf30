"""Who commands: the high-level commander by itself, or a client that streams set-points and outranks it.

Source: ``commander.c`` and ``crtp_commander_high_level.c`` of the firmware. A low-level set-point stops the planner and
keeps the higher rank until the client gives it back ("notify set-point stop"), be it only the zero set-point that
cflib sends on closing its link.
"""

from __future__ import annotations

import errno
import math
import struct

from sim_backends.wire.crazyflie_planner import Goal, Phase, Planner, linear, smooth, spiral
from sim_backends.wire.crazyflie_setpoints import Mode, Setpoint

(
    SET_GROUP_MASK,
    TAKEOFF,
    LAND,
    STOP,
    GO_TO,
    START_TRAJECTORY,
    DEFINE_TRAJECTORY,
    TAKEOFF_2,
    LAND_2,
    TAKEOFF_WITH_VELOCITY,
    LAND_WITH_VELOCITY,
    SPIRAL,
    GO_TO_2,
    START_TRAJECTORY_2,
) = range(14)
_GROUPED = set(range(14)) - {SET_GROUP_MASK, DEFINE_TRAJECTORY}
_MOVES = {TAKEOFF, LAND, GO_TO, START_TRAJECTORY, TAKEOFF_2, LAND_2, TAKEOFF_WITH_VELOCITY, LAND_WITH_VELOCITY}
_MOVES |= {SPIRAL, GO_TO_2, START_TRAJECTORY_2}
_BY_VERSION = {SPIRAL: 8, GO_TO_2: 8, START_TRAJECTORY_2: 10}
HIGH_LEVEL, CLIENT = 1, 2


class Commander:
    """The set-point in force, its rank and its age."""

    def __init__(self, protocol: int) -> None:
        """Starts idle.

        Args:
            protocol: version; older firmware does not know the newer commands.
        """
        self._protocol = protocol
        self.planner = Planner()
        self.setpoint, self.stamp_s = Setpoint(), 0.0
        self._rank = 0
        self._mask = 0
        self.blocked = True
        self.default_mps = 0.5
        self._last = Goal()  # where planning starts: the last set-point, or the estimate while the planner is idle

    def client(self, setpoint: Setpoint, now_s: float) -> None:
        """A low-level set-point."""
        self.setpoint, self.stamp_s, self._rank = setpoint, now_s, CLIENT
        self.planner.stop()

    def relax(self, estimate: Goal) -> None:
        """The client gives its rank back."""
        self._last = estimate
        self._rank = HIGH_LEVEL

    def block(self, blocked: bool) -> None:
        """Motors may not run: forget what was planned and take no new plans."""
        if blocked and not self.blocked:
            self.planner.stop()
        self.blocked = blocked

    def step(self, now_s: float, estimate: Goal) -> Setpoint:
        """One step of the high-level commander; returns the set-point in force."""
        goal = self.planner.goal(now_s)
        if goal is None:
            self._last = estimate
            offered = Setpoint()
        else:
            self._last = goal
            offered = Setpoint(Mode.GOAL, goal)
        if self._rank <= HIGH_LEVEL:
            self.setpoint, self.stamp_s = offered, now_s
        return self.setpoint

    def answer(self, data: bytes, now_s: float) -> bytes:
        """Obeys a packet on the high-level port; the answer's fourth byte is the error code."""
        try:
            code = self._obey(data, now_s)
        except struct.error:
            code = errno.EINVAL
        return data[:3].ljust(3, b"\0") + bytes((code,))

    def _obey(self, data: bytes, now_s: float) -> int:
        command = data[0] if data else 255
        if command not in _GROUPED and command not in (SET_GROUP_MASK, DEFINE_TRAJECTORY):
            return errno.ENOEXEC
        if self._protocol < _BY_VERSION.get(command, 0):
            return errno.ENOEXEC
        if command == SET_GROUP_MASK:
            (self._mask,) = struct.unpack_from("<B", data, 1)
            return 0
        if command == DEFINE_TRAJECTORY:
            return errno.ENOEXEC  # there is no memory that could hold one
        if self.blocked and command in _MOVES:
            return errno.EBUSY
        (group,) = struct.unpack_from("<B", data, 1)
        if group != 0 and not group & self._mask:
            return 0
        if command == STOP:
            self.planner.stop()
            return 0
        if command in (TAKEOFF, TAKEOFF_2, TAKEOFF_WITH_VELOCITY):
            return self._vertical(command, data[2:], now_s, Phase.IDLE, Phase.FLYING)
        if command in (LAND, LAND_2, LAND_WITH_VELOCITY):
            return self._vertical(command, data[2:], now_s, None, Phase.LANDING)
        if command in (GO_TO, GO_TO_2):
            return self._go_to(command, data[2:], now_s)
        if command == SPIRAL:
            sideways, clockwise, angle, r0, r1, ascent, duration_s = struct.unpack_from("<BBfffff", data, 2)
            if not all(map(math.isfinite, (angle, r0, r1, ascent, duration_s))) or r0 < 0 or r1 < 0:
                return errno.EINVAL
            arc = spiral(self._last, angle, (r0, r1), ascent, bool(sideways), bool(clockwise), duration_s, now_s)
            self.planner.start(arc)
            return 0
        return errno.ENOEXEC

    def _vertical(self, command: int, data: bytes, now_s: float, needs: Phase | None, phase: Phase) -> int:
        if (needs is not None and self.planner.phase is not needs) or self.planner.phase is Phase.LANDING:
            return 1
        here = self._last
        if command in (TAKEOFF, LAND):
            height_m, duration_s = struct.unpack_from("<ff", data)
            yaw, keep = 0.0, False
        elif command in (TAKEOFF_2, LAND_2):
            height_m, yaw, keep, duration_s = struct.unpack_from("<ff?f", data)
        else:
            height_m, relative, yaw, keep, speed = struct.unpack_from("<f?f?f", data)
            if relative:
                height_m = here.position_m[2] + (height_m if phase is Phase.FLYING else -height_m)
            duration_s = abs(height_m - here.position_m[2]) / (speed if speed > 0 else self.default_mps)
        if not all(map(math.isfinite, (height_m, yaw, duration_s))):
            return errno.EINVAL
        end_m = (here.position_m[0], here.position_m[1], height_m)
        rest = Goal(here.position_m, yaw_rad=here.yaw_rad)
        self.planner.start(smooth(rest, end_m, here.yaw_rad if keep else yaw, duration_s, now_s), phase)
        return 0

    def _go_to(self, command: int, data: bytes, now_s: float) -> int:
        if command == GO_TO:
            relative, x, y, z, yaw, duration_s = struct.unpack_from("<Bfffff", data)
            straight = 0
        else:
            relative, straight, x, y, z, yaw, duration_s = struct.unpack_from("<BBfffff", data)
        if not all(map(math.isfinite, (x, y, z, yaw, duration_s))):
            return errno.EINVAL
        start = self.planner.goal(now_s) or self._last
        if relative:
            x, y, z = x + start.position_m[0], y + start.position_m[1], z + start.position_m[2]
            yaw += start.yaw_rad
        plan = linear if straight else smooth
        self.planner.start(plan(start, (x, y, z), yaw, duration_s, now_s))
        return 0
