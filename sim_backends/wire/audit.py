"""Compares the truth of the shared world with the rules, look by look: pure, no clock and no files.

The same rules, kinds and dataclasses as the kinematic simulator's audit (``kernel.audit``, ``truth``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim_backends.truth import CODES, Truth, VehicleTruth, Violation
from sim_backends.wire.world import BATTERY_EMPTY, COLLIDED, MOTOR_FAILURE, Body
from sim_backends.world import WorldConfig

ROOM = 4096
"""So many violations are kept; further ones are counted only."""


@dataclass(slots=True)
class _Episode:
    kind: str
    rows: tuple[int, ...]
    begin_s: float
    end_s: float
    value: float
    cause: str = ""
    scripted: bool = False


class Audit:
    """The audit of one world.

    Args:
        config: what must hold: separations, fence, ceiling.
    """

    def __init__(self, config: WorldConfig) -> None:
        self._config = config
        self._n_uav = len(config.uavs)
        self._episodes: list[_Episode] = []
        self._open: dict[tuple[str, int, int], _Episode] = {}
        self._before: Sequence[Body] = ()
        self._collided: set[frozenset[int]] = set()
        self.dropped = 0
        self.min_separation_m = self.min_uav_m = self.min_ugv_m = math.inf

    def look(self, now_s: float, bodies: Sequence[Body], hit: Sequence[bool]) -> set[int]:
        """Judges one moment.

        Args:
            now_s: of the moment, on the scale that violations shall have.
            bodies: of all vehicles, by row.
            hit: by row, whether a scripted fault has taken the vehicle out of anybody's hands.

        Returns:
            Rows of UAVs that have touched another one since the last look; they fall now.
        """
        touched: set[int] = set()
        n = self._n_uav
        for i in range(n):
            self._alone(now_s, i, bodies[i], hit=hit[i])
            for j in range(i + 1, n):
                touched |= self._two_uavs(now_s, i, j, bodies, scripted=hit[i] or hit[j])
        for i in range(n, len(bodies)):
            outside = not self._inside(bodies[i])
            self._episode(now_s, ("fence", i, i), outside, 0.0, scripted=hit[i])
            for j in range(i + 1, len(bodies)):
                near_m = math.dist(bodies[i].position_m[:2], bodies[j].position_m[:2])
                self.min_ugv_m = min(self.min_ugv_m, near_m)
                bad = near_m < self._config.separation_ugv_m
                self._episode(now_s, ("ugv_separation", i, j), bad, near_m, scripted=hit[i] or hit[j])
        self._before = list(bodies)
        return touched

    def _alone(self, now_s: float, i: int, body: Body, *, hit: bool) -> None:
        up, z_m = body.airborne, body.position_m[2]
        outside = up and not self._inside(body)
        self._episode(now_s, ("fence", i, i), outside, 0.0, scripted=hit)
        high = up and not outside and z_m > self._config.ceiling_m
        self._episode(now_s, ("ceiling", i, i), high, z_m, scripted=hit, most=True)
        before = self._before[i] if self._before else Body(energy_j=math.inf)
        if up and body.energy_j <= 0.0 < before.energy_j:
            self._note("empty_in_air", (i,), now_s, z_m, CODES[BATTERY_EMPTY], scripted=False)
        if body.tumbled and not before.tumbled:
            scripted = body.code == MOTOR_FAILURE and hit
            self._note("crash", (i,), now_s, 0.0, CODES.get(body.code, ""), scripted=scripted)

    def _two_uavs(self, now_s: float, i: int, j: int, bodies: Sequence[Body], *, scripted: bool) -> set[int]:
        a, b = bodies[i], bodies[j]
        key, pair = ("separation", i, j), frozenset((i, j))
        if not (a.airborne and b.airborne):
            self._open.pop(key, None)
            self._collided.discard(pair)
            return set()
        level_m = math.dist(a.position_m[:2], b.position_m[:2])
        height_m = abs(a.position_m[2] - b.position_m[2])
        near_m = math.hypot(level_m, height_m)
        self.min_uav_m = min(self.min_uav_m, near_m)
        within = height_m < self._config.separation_v_m
        if within:
            self.min_separation_m = min(self.min_separation_m, level_m)
        self._episode(now_s, key, within and level_m < self._config.separation_h_m, level_m, scripted=scripted)
        if near_m >= self._config.collision_m or pair in self._collided:
            return set()
        self._collided.add(pair)
        self._note("collision", (i, j), now_s, near_m, CODES[COLLIDED], scripted=scripted)
        return {i, j}

    def _inside(self, body: Body) -> bool:
        """Whether a body is within the fence (even-odd rule); always where none is watched."""
        fence = self._config.fence_m
        x, y = body.position_m[0], body.position_m[1]
        result, (xj, yj) = False, fence[-1] if fence else (0.0, 0.0)
        for xi, yi in fence:
            if (yi > y) != (yj > y) and x < (xj - xi) * (y - yi) / (yj - yi) + xi:
                result = not result
            xj, yj = xi, yi
        return result or not fence

    def _episode(
        self, now_s: float, key: tuple[str, int, int], bad: bool, value: float, *, scripted: bool, most: bool = False
    ) -> None:
        """Keeps one record for as long as a violation lasts, with its worst value."""
        if not bad:
            self._open.pop(key, None)
            return
        episode = self._open.get(key)
        if episode is None:
            kind, a, b = key
            found = self._note(kind, (a,) if a == b else (a, b), now_s, value, "", scripted=scripted)
            if found is not None:
                self._open[key] = found
            return
        episode.end_s = now_s
        episode.value = (max if most else min)(episode.value, value)
        episode.scripted = episode.scripted or scripted

    def _note(
        self, kind: str, rows: tuple[int, ...], now_s: float, value: float, cause: str, *, scripted: bool
    ) -> _Episode | None:
        if len(self._episodes) >= ROOM:
            self.dropped += 1
            return None
        self._episodes.append(_Episode(kind, rows, now_s, now_s, value, cause, scripted))
        return self._episodes[-1]

    def truth(self, now_s: float) -> Truth:
        """The audit until now."""
        ids = [v.id for v in self._config.vehicles]
        return Truth(
            time_s=now_s,
            min_separation_m=self.min_separation_m,
            min_uav_distance_m=self.min_uav_m,
            min_ugv_distance_m=self.min_ugv_m,
            violations=tuple(
                Violation(e.begin_s, e.end_s, e.kind, tuple(ids[r] for r in e.rows), e.value, e.cause, e.scripted)
                for e in self._episodes
            ),
            vehicles={ids[row]: self._vehicle(row, body) for row, body in enumerate(self._before)},
        )

    def _vehicle(self, row: int, body: Body) -> VehicleTruth:
        uav = row < self._n_uav
        speed_mps = math.hypot(*body.velocity_mps) if uav else body.speed_mps
        return VehicleTruth(
            position_m=body.position_m,
            yaw_rad=body.yaw_rad,
            speed_mps=speed_mps,
            phase=_uav_phase(body) if uav else ("drive" if speed_mps > 1e-3 else "stand"),
            on=self._config.ugvs[body.on - self._n_uav].id if body.on >= 0 else None,
            armed=body.armed,
            airborne=body.airborne,
            tumbled=body.tumbled,
            locked=body.locked,
            energy_j=body.energy_j,
            used_j=body.used_j,
            given_j=body.given_j,
        )


def _uav_phase(body: Body) -> str:
    if body.tumbled:
        return "crashed"
    if body.airborne:
        return "fly"
    return "pad" if body.on >= 0 else "ground"
