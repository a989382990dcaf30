"""What becomes of bodies whose endpoint has died: what flies falls, what drives stops. Pure."""

from __future__ import annotations

from dataclasses import replace

from drivers.vehicle import Vec3
from sim_backends.wire.world import MOTOR_FAILURE, Body

DEAD_S = 0.5
"""An endpoint that has not written its row for so long is dead; they write at 100 Hz or more."""
LOOKS = 10
"""And so many looks of the conductor must have shown the same row: a machine that stood still has killed nobody."""
GRAVITY = 9.81


class Orphans:
    """Watches the rows of endpoints and moves the bodies of those that have died.

    Args:
        n_uav: rows before this are UAVs.
        rows: how many there are.
    """

    def __init__(self, n_uav: int, rows: int) -> None:
        self._n_uav = n_uav
        self._same = [0] * rows
        self._seen = [0.0] * rows
        self.taken: set[int] = set()

    def look(self, now_s: float, row: int, body: Body) -> bool:
        """Whether the body in ``row`` has nobody who moves it.

        Args:
            now_s: ``time.monotonic()``.
            row: of the body.
            body: as its row shows it, or as ``wrote`` was told.
        """
        if body.time_s <= 0.0:  # its endpoint has not begun yet
            return False
        if body.time_s != self._seen[row]:
            # a body that was taken over and is written again has an endpoint after all
            self._seen[row], self._same[row] = body.time_s, 0
            self.taken.discard(row)
            return False
        self._same[row] += 1
        if row not in self.taken and self._same[row] >= LOOKS and now_s - body.time_s > DEAD_S:
            self.taken.add(row)
        return row in self.taken

    def wrote(self, row: int, body: Body) -> None:
        """The conductor itself has written ``body``."""
        self._seen[row] = body.time_s

    def moved(self, row: int, body: Body, dt_s: float, pad_m: Vec3 | None) -> Body:
        """The body ``dt_s`` later.

        Args:
            row: of the body.
            body: as it is.
            dt_s: s.
            pad_m: the dock that it stands on; None elsewhere.
        """
        if row >= self._n_uav:
            return replace(body, velocity_mps=(0.0, 0.0, 0.0), armed=False, locked=True, code=MOTOR_FAILURE)
        if pad_m is not None:
            return replace(body, position_m=pad_m, velocity_mps=(0.0, 0.0, 0.0), armed=False, charging=False)
        if not body.airborne:
            return replace(body, velocity_mps=(0.0, 0.0, 0.0), armed=False)
        (x, y, z), (vx, vy, vz) = body.position_m, body.velocity_mps
        keep = max(0.0, 1.0 - 0.5 * dt_s)
        vx, vy, vz = vx * keep, vy * keep, vz - GRAVITY * dt_s
        at = (x + vx * dt_s, y + vy * dt_s, z + vz * dt_s)
        if at[2] <= 0.0:
            return replace(
                body, position_m=(at[0], at[1], 0.0), velocity_mps=(0.0, 0.0, 0.0), armed=False, airborne=False,
                tumbled=True, locked=True, code=MOTOR_FAILURE,
            )  # fmt: skip
        return replace(body, position_m=at, velocity_mps=(vx, vy, vz), armed=False, code=MOTOR_FAILURE)
