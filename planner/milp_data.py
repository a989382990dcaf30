"""A problem in whole numbers for the exact method, and how many recharges an optimal plan can need at most.

Times are in ms, energies in 10 mJ, both rounded so that the model can only promise too much: its bounds hold for the
real problem, to within a few ms.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from planner.arrays import arrays_of
from planner.problem import Problem

MS = 1_000.0  # per s
UNIT = 100.0  # energy units per J
SLACK_MS, SLACK_UNITS = 64, 64  # more than all rounding along one trip
MAX_RECHARGES = 12  # of one UAV in the model
FAR_MS = 10**9  # no road

Whole = NDArray[np.int64]


def _down(values: object, scale: float) -> Whole:
    return np.floor(np.asarray(values, dtype=np.float64) * scale).astype(np.int64)


@dataclass(frozen=True)
class Data:
    """What the model is made of. Tasks are those still to be visited, sites are path points and, last, the depot.

    Attributes:
        problem: the problem.
        uav_ids, ugv_ids: vehicles that may act.
        limit_s: length of a plan that is known, inf where none is.
    """

    problem: Problem
    uav_ids: tuple[int, ...]
    ugv_ids: tuple[int, ...]
    limit_s: float

    @classmethod
    def of(cls, problem: Problem, exclude_uavs: Collection[int], exclude_ugvs: Collection[int], limit_s: float) -> Data:
        """Without the excluded vehicles and those UGVs that no road leads anywhere from."""
        uavs = tuple(u for u in range(len(problem.uavs)) if u not in exclude_uavs)
        ugvs = tuple(g for g in range(len(problem.ugvs)) if g not in exclude_ugvs)
        return cls(problem, uavs, ugvs, limit_s)

    @cached_property
    def tasks(self) -> list[int]:
        """Tasks that are not visited yet."""
        return [int(m) for m in np.flatnonzero(~self.problem.visited)]

    @property
    def n_sites(self) -> int:
        """Path points and the depot."""
        return len(self.problem.sites)

    @cached_property
    def _dist(self) -> NDArray[np.float64]:
        """(start of each UAV, tasks, sites) x (tasks, sites) in m, for tasks still to be visited."""
        a = arrays_of(self.problem)
        n = self.problem.n_tasks
        columns = [*self.tasks, *range(n, n + self.n_sites)]
        rows = [n + self.n_sites + u for u in range(len(self.problem.uavs))] + columns
        picked: NDArray[np.float64] = a.dist[np.ix_(rows, columns)]
        return picked

    def fly_m(self, u: int) -> NDArray[np.float64]:
        """(1 + tasks + sites, tasks + sites) in m; row 0 is where UAV ``u`` starts."""
        starts = len(self.problem.uavs)
        return np.vstack([self._dist[u], self._dist[starts:]])

    def fly_ms(self, u: int) -> Whole:
        """Flying times of UAV ``u``, the service at a task included; shape as ``fly_m``."""
        uav = self.problem.uavs[u]
        s = self.fly_m(u) / uav.speed_mps
        s[:, : len(self.tasks)] += uav.service_s
        return _down(s, MS)

    def soonest_ms(self) -> Whole:
        """When each task can be done at the earliest, flown to straight away, (tasks,)."""
        ready = [int(self.problem.uavs[u].ready_s * MS) for u in self.uav_ids]
        times = [t + self.fly_ms(u)[0, : len(self.tasks)] for t, u in zip(ready, self.uav_ids, strict=True)]
        soonest: Whole = np.array(times).min(axis=0)
        return soonest

    def fly_units(self, u: int) -> Whole:
        """Energies of UAV ``u``, the service at a task included; shape as ``fly_m``."""
        uav = self.problem.uavs[u]
        j = uav.cruise_w * self.fly_m(u) / uav.speed_mps
        j[:, : len(self.tasks)] += uav.hover_w * uav.service_s
        return _down(j, UNIT)

    def home_units(self, u: int) -> Whole:
        """Energy from the start and from each task to the nearest site, (1 + tasks,)."""
        uav = self.problem.uavs[u]
        away = self.fly_m(u)[: 1 + len(self.tasks), len(self.tasks) :].min(axis=1)
        if away[0] <= 1e-3:
            away[0] = 0.0
        return _down(uav.cruise_w * away / uav.speed_mps, UNIT)

    def budget_units(self, u: int, trip: int) -> int:
        """Energy that UAV ``u`` may use on its trip number ``trip``; each but the first starts full."""
        uav = self.problem.uavs[u]
        joules = (uav.energy_j if trip == 0 else max(uav.capacity_j, uav.energy_j)) - uav.reserve_j
        return int(np.ceil(joules * UNIT)) + 1  # the evaluator forgives 1e-6 J

    def charge_units(self, u: int, trip: int) -> int:
        """Energy that it has at least at the start of that trip, above its reserve."""
        uav = self.problem.uavs[u]
        return int(np.floor(((uav.energy_j if trip == 0 else uav.capacity_j) - uav.reserve_j) * UNIT))

    @cached_property
    def road_m(self) -> NDArray[np.float64]:
        """Shortest distances between sites, other sites on the way allowed, (P+1, P+1) in m."""
        road = np.array(self.problem.road_distance_m)
        for k in range(len(road)):
            road = np.minimum(road, road[:, k, None] + road[None, k, :])
        return road

    def drive_ms(self, g: int) -> Whole:
        """Driving times of UGV ``g`` between sites, (P+1, P+1); ``FAR_MS`` where no road leads."""
        s = np.where(np.isfinite(self.road_m), self.road_m, 0.0) / self.problem.ugvs[g].speed_mps
        return np.where(np.isfinite(self.road_m), _down(s, MS), FAR_MS)

    def reach_ms(self, g: int) -> Whole:
        """When UGV ``g`` can be at each site at the earliest, (P+1,); ``FAR_MS`` where it never can."""
        ugv = self.problem.ugvs[g]
        at = self.problem.depot_index if ugv.path_point is None else ugv.path_point
        leave = max([ugv.ready_s, *ugv.dock_ready_s])
        if ugv.distance_to_m is None:
            first = self.road_m[at]
        else:
            first = (np.array(ugv.distance_to_m)[:, None] + self.road_m).min(axis=0)
        s = leave + np.where(np.isfinite(first), first, 0.0) / ugv.speed_mps
        if ugv.distance_to_m is None:
            s[at] = ugv.ready_s
        return np.where(np.isfinite(first), _down(s, MS), FAR_MS)

    @cached_property
    def limit_ms(self) -> int:
        """No plan of interest takes longer."""
        if np.isfinite(self.limit_s):
            return int(np.ceil(self.limit_s * MS)) + 1
        p = self.problem
        slowest = max(1.0, *(g.charge_s or g.dock_s for g in p.ugvs)) if p.ugvs else 1.0
        return int(MS * (1e5 + len(self.tasks) * (2e3 + 4.0 * slowest)))

    def recharge_ms(self, g: int) -> int:
        """Least time at UGV ``g``."""
        ugv = self.problem.ugvs[g]
        return int((ugv.dock_s + ugv.undock_s + (ugv.charge_s or 0.0)) * MS)

    @cached_property
    def least_recharge_ms(self) -> int:
        """Least time of any recharge; 0 without UGVs."""
        return min((self.recharge_ms(g) for g in self.ugv_ids), default=0)

    @cached_property
    def ugvs_have_plenty(self) -> bool:
        """No UGV can run out within the limit, whatever it does."""
        p, s = self.problem, self.limit_ms / MS
        flown = sum(s * max(p.uavs[u].cruise_w, p.uavs[u].hover_w) + p.uavs[u].capacity_j for u in self.uav_ids)
        return all(p.ugvs[g].energy_j >= s * (p.ugvs[g].drive_w + p.ugvs[g].idle_w) + flown for g in self.ugv_ids)

    @cached_property
    def lean(self) -> bool:
        """Whether a recharge that can be left out is best left out.

        True where waiting costs no energy, charging takes constant time and UGVs have plenty: without the recharge the
        UAV flies the straight line, all that follows is no later, and docks are free earlier. Then two successive trips
        of an optimal plan with the fewest recharges always need more than one charge together.
        """
        p = self.problem
        landed = all(p.uavs[u].waiting == "landed" or p.uavs[u].hover_w == 0 for u in self.uav_ids)
        return landed and all(p.ugvs[g].charge_w is None for g in self.ugv_ids) and self.ugvs_have_plenty

    def most_recharges(self, u: int) -> int | None:
        """Recharges of UAV ``u`` beyond which no plan within the limit can be optimal; None: nothing rules out more."""
        if not self.ugv_ids or not self.tasks:
            return 0
        uav = self.problem.uavs[u]
        watts = max(uav.cruise_w, uav.hover_w if uav.service_s > 0 else 0.0, 1e-9)
        recovery = float(self.home_units(u).max()) / UNIT
        for count in range(MAX_RECHARGES + 1):
            n = count + 1  # the least time of a plan with one more
            least = uav.ready_s * MS + n * self.least_recharge_ms
            if self.lean:
                first, full = self.charge_units(u, 0) / UNIT, self.charge_units(u, 1) / UNIT
                pairs = max(first + ((n + 1) // 2 - 1) * full, (n // 2) * full)
                least += MS * max(0.0, pairs - recovery) / watts - SLACK_MS
            if least > self.limit_ms:
                return count
        return None
