"""The joint problem as a CP-SAT model: the UAVs' trips between recharges, met by UGVs.

UGVs have no routes in the model. Any two recharges of one UGV are kept apart by its way between their sites, unless
both are at the same site: sorted by time, that is a route it can drive. Docks are a cumulative resource; the earliest
free dock, which the evaluator takes, is never later.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

from ortools.sat.python import cp_model

from planner.milp_data import FAR_MS, UNIT, Data
from planner.milp_trips import Slot, UavModel


class Model:
    """The whole model of ``data`` with ``recharges[u]`` slots of UAV ``u``; minimises the makespan.

    UAVs in ``more`` may need more recharges than slots: for them the model is a relaxation.
    """

    def __init__(self, data: Data, recharges: dict[int, int], more: Collection[int] = ()) -> None:
        self.data = data
        self.model = m = cp_model.CpModel()
        self.makespan = m.new_int_var(0, data.limit_ms, "")
        self.served: dict[int, list[list[Any]]] = {u: [[] for _ in data.tasks] for u in data.uav_ids}
        self.uavs = {
            u: UavModel(data, m, u, recharges[u], u in more, self.makespan, self.served[u]) for u in data.uav_ids
        }
        self.slots: list[Slot] = [slot for uav in self.uavs.values() for slot in uav.slots]
        for k in range(len(data.tasks)):
            m.add_exactly_one(literal for served in self.served.values() for literal in served[k])
        self.earlier: dict[tuple[int, int], Any] = {}  # by slots' numbers in ``slots``
        self.together: dict[tuple[int, int], Any] = {}
        self._driven = self._drives() if not data.ugvs_have_plenty else []
        for g in data.ugv_ids:
            self._docks(g)
        for i, j in combinations(range(len(self.slots)), 2):
            self._keep_apart(i, j)
        self._order_twins()
        m.minimize(self.makespan)

    def _docks(self, g: int) -> None:
        ugv = self.data.problem.ugvs[g]
        busy = [int(t * 1000.0) for t in ugv.dock_ready_s if t > 0]
        if len(self.slots) + len(busy) <= ugv.docks:
            return
        m = self.model
        intervals = [m.new_optional_interval_var(s.work, s.size, s.end, s.by[g], "") for s in self.slots]
        intervals += [m.new_fixed_size_interval_var(0, t, "") for t in busy]
        m.add_cumulative(intervals, [1] * len(intervals), ugv.docks)

    def _keep_apart(self, i: int, j: int) -> None:
        """Recharges of one UGV: at the same site, or far enough apart in time to drive."""
        d, m, one, two = self.data, self.model, self.slots[i], self.slots[j]
        same_uav = one.uav == two.uav
        together = self.together[i, j] = m.new_bool_var("")  # at the same site
        for p in range(d.n_sites):
            m.add_bool_or([~together, ~one.at[p], two.at[p]])
            m.add_bool_or([~together, ~two.at[p], one.at[p]])
        if same_uav:
            earlier: Any = True
        else:
            earlier = m.new_bool_var("")
            m.add(one.work <= two.work).only_enforce_if([earlier, one.used, two.used])
            m.add(two.work <= one.work).only_enforce_if([~earlier, one.used, two.used])
            m.add_bool_or([earlier, one.used])  # one order only where it does not matter
            m.add_bool_or([earlier, two.used])
            self.earlier[i, j] = earlier
        ways: dict[float, Any] = {}
        for g in d.ugv_ids:
            drive = d.drive_ms(g)
            both = [one.by[g], two.by[g]]
            for p, q in zip(*(drive >= FAR_MS).nonzero(), strict=True):
                m.add_bool_or([~one.at[int(p)], ~two.at[int(q)], *(~x for x in both)])
            speed = d.problem.ugvs[g].speed_mps
            if speed not in ways:
                ways[speed] = self._way(one, two, drive.tolist())
            way = ways[speed]
            if same_uav:
                m.add(two.work >= one.end + way).only_enforce_if(both)
            else:
                m.add(two.work >= one.end + way).only_enforce_if([*both, earlier, ~together])
                m.add(one.work >= two.end + way).only_enforce_if([*both, ~earlier, ~together])
            if self._driven:
                m.add(self._driven[j] >= self._driven[i] + way).only_enforce_if([*both, earlier])
                if not same_uav:
                    m.add(self._driven[i] >= self._driven[j] + way).only_enforce_if([*both, ~earlier])

    def _way(self, one: Slot, two: Slot, drive: list[list[int]]) -> Any:
        """Driving time between the two slots' sites."""
        m = self.model
        far = max((t for row in drive for t in row if t < FAR_MS), default=0)
        way = m.new_int_var(0, far, "")
        for here, there in ((one, two), (two, one)):
            for p, row in enumerate(drive):  # symmetric
                times = [min(t, far) for t in row]
                m.add(way >= sum(t * x for t, x in zip(times, there.at, strict=True))).only_enforce_if(here.at[p])
        return way

    def _drives(self) -> list[Any]:
        """Time that its UGV has driven before each slot; used where UGVs are short of energy."""
        d, m = self.data, self.model
        driven = [m.new_int_var(0, d.limit_ms, "") for _ in self.slots]
        for g in d.ugv_ids:
            ugv = d.problem.ugvs[g]
            start = int(max([ugv.ready_s, *ugv.dock_ready_s]) * 1000.0) + 1
            reach = [max(0, int(t) - start) if t < FAR_MS else 0 for t in d.reach_ms(g)]
            given = []
            for slot in self.slots:
                mine = m.new_int_var(0, FAR_MS, "")
                m.add(mine >= slot.given).only_enforce_if(slot.by[g])
                given.append(mine)
            idle = int(ugv.idle_w * UNIT / 1000.0)
            drive = int(ugv.drive_w * UNIT / 1000.0)
            stands = idle * (self.makespan - int(ugv.ready_s * 1000.0) - 1)
            for slot, time in zip(self.slots, driven, strict=True):
                m.add(time >= sum(t * x for t, x in zip(reach, slot.at, strict=True))).only_enforce_if(slot.by[g])
                # Driving costs at least as much as standing in the model, else less driving would not be less energy.
                used = max(0, drive - idle) * time + stands + sum(given)
                m.add(used <= int(ugv.energy_j * UNIT) + 2).only_enforce_if(slot.by[g])
        return driven

    def _order_twins(self) -> None:
        """Among UAVs (UGVs) that are alike, the first has the first task (recharge), and so on."""
        d, m = self.data, self.model
        for group in _alike([(u, d.problem.uavs[u]) for u in d.uav_ids]):
            for one, two in pairwise(group):
                for k in range(len(d.tasks)):
                    before = [literal for served in self.served[one][:k] for literal in served]
                    for literal in self.served[two][k]:
                        m.add_bool_or([~literal, *before])
        for group in _alike([(g, d.problem.ugvs[g]) for g in d.ugv_ids]):
            for one, two in pairwise(group):
                for k, slot in enumerate(self.slots):
                    m.add_bool_or([~slot.by[two], *(s.by[one] for s in self.slots[:k])])


def _alike(vehicles: list[tuple[int, Any]]) -> list[list[int]]:
    groups: dict[Any, list[int]] = {}
    for index, vehicle in vehicles:
        groups.setdefault(replace(vehicle, id=""), []).append(index)
    return [group for group in groups.values() if len(group) > 1]
