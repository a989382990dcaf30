"""A first plan: groups of UAVs around one UGV each go from stop to stop and serve the tasks around it.

From a stop where a UAV was filled up, every task within half a charge can be visited and the stop reached again, so
this finds a feasible plan wherever the UGVs can drive in hops that the UAVs can follow. Its plans are not good, only
sound.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from planner.arrays import arrays_of
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem, Uav

INF = float("inf")


@dataclass
class _State:
    """Of one UAV: node (``planner.kernel`` numbering), time, energy, whether it is full at its group's stop."""

    node: int
    time_s: float
    energy_j: float
    full: bool = False
    alone: bool = False  # no UGV comes to its aid


@dataclass
class _Group:
    """One UGV with the UAVs that follow it; ``site`` is None while it is between path points."""

    ugv: int
    uavs: list[int]
    site: int | None
    here_s: float
    leave_s: float
    docks: list[float] = field(default_factory=list)
    done: bool = False


class _Builder:
    def __init__(self, problem: Problem, uavs: list[int], ugvs: list[int], per_group: int) -> None:
        self.p = problem
        a = arrays_of(problem)
        self.dist = a.dist.tolist()
        self.near = a.near.tolist()
        self.road = a.road.tolist()
        self.n_tasks, self.n_sites = problem.n_tasks, len(problem.sites)
        self.left = {m for m in range(problem.n_tasks) if not problem.visited[m]}
        self.actions: list[Action] = []
        self.states = {
            u: _State(
                self.n_tasks + self.n_sites + u,
                problem.uavs[u].ready_s,
                problem.uavs[u].energy_j,
                problem.uavs[u].energy_j >= problem.uavs[u].capacity_j,
            )
            for u in uavs
        }
        self.groups = []
        for g in ugvs:
            v = problem.ugvs[g]
            site = None if v.distance_to_m is not None else int(a.site0[g])
            docks = [d for d in a.docks0[g].tolist() if d < INF]
            self.groups.append(_Group(g, [], site, v.ready_s, max(v.ready_s, *docks), docks))
        self._gather(uavs, per_group)

    def fly_s(self, u: int, node: int, to: int) -> float:
        return float(self.dist[node][to]) / self.p.uavs[u].speed_mps

    def site_node(self, site: int) -> int:
        return self.n_tasks + site

    def wait_w(self, uav: Uav) -> float:
        return uav.hover_w if uav.waiting == "hover" else 0.0

    def drive_m(self, group: _Group, to: int) -> float:
        row = self.n_sites + group.ugv if group.site is None else group.site
        return float(self.road[row][to])

    def meets(self, u: int, group: _Group, site: int, spare_s: float = 0.0) -> bool:
        """Whether UAV ``u`` can fly to ``site`` now and wait there for the UGV that sets out as early as it can."""
        uav, s, ugv = self.p.uavs[u], self.states[u], self.p.ugvs[group.ugv]
        metres = 0.0 if site == group.site else self.drive_m(group, site)
        if metres == INF:
            return False
        there = group.here_s if site == group.site else group.leave_s + metres / ugv.speed_mps
        fly = self.fly_s(u, s.node, self.site_node(site))
        wait = max(0.0, there + spare_s - s.time_s - fly)
        if site == group.site:
            wait = max(wait, min(group.docks) - s.time_s - fly)
        return s.energy_j - uav.cruise_w * fly - self.wait_w(uav) * wait >= uav.reserve_j

    def _gather(self, uavs: list[int], per_group: int) -> None:
        """Gives each UAV to the UGV with the fewest UAVs among those that can meet it somewhere."""
        for u in uavs:
            options = []
            for k, group in enumerate(self.groups):
                if len(group.uavs) >= per_group:
                    continue
                sites = [s for s in range(self.n_sites) if self.meets(u, group, s)]
                if sites:
                    near = min(self.drive_m(group, s) if s != group.site else 0.0 for s in sites)
                    options.append((len(group.uavs), near, k))
            if options:
                self.groups[min(options)[2]].uavs.append(u)
            else:
                self.states[u].alone = True

    # ---- one step of a vehicle

    def visit(self, u: int, m: int) -> None:
        uav, s = self.p.uavs[u], self.states[u]
        fly = self.fly_s(u, s.node, m)
        self.states[u] = _State(
            m,
            s.time_s + fly + uav.service_s,
            s.energy_j - uav.cruise_w * fly - uav.hover_w * uav.service_s,
            False,
            s.alone,
        )
        self.left.discard(m)
        self.actions.append(Visit(u, m))

    def recharge(self, u: int, group: _Group) -> None:
        uav, s, ugv = self.p.uavs[u], self.states[u], self.p.ugvs[group.ugv]
        assert group.site is not None
        node = self.site_node(group.site)
        fly = self.fly_s(u, s.node, node)
        k = min(range(len(group.docks)), key=lambda i: group.docks[i])
        work = max(s.time_s + fly, group.here_s, group.docks[k])
        energy = s.energy_j - uav.cruise_w * fly - self.wait_w(uav) * (work - s.time_s - fly)
        given = max(0.0, uav.capacity_j - energy)
        charge = given / ugv.charge_w if ugv.charge_w is not None else ugv.charge_s or 0.0
        end = work + ugv.dock_s + charge + ugv.undock_s
        group.docks[k] = end
        group.leave_s = max(group.leave_s, end)
        self.states[u] = _State(node, end, energy + given, True, s.alone)
        self.actions.append(Recharge(u, group.ugv))

    def move(self, group: _Group, site: int) -> None:
        metres = self.drive_m(group, site)
        group.here_s = group.leave_s = group.leave_s + metres / self.p.ugvs[group.ugv].speed_mps
        group.site = site
        self.actions.append(Move(group.ugv, None if site == self.p.depot_index else site))

    # ---- what to do next

    def next_task(self, u: int, back: int | None, group: _Group | None) -> int | None:
        """The nearest task from which the UAV still gets to node ``back`` (None: to its nearest site) above reserve."""
        uav, s = self.p.uavs[u], self.states[u]
        for m in sorted(self.left, key=lambda m: (self.dist[s.node][m], m)):
            home = self.near[m] if back is None else self.dist[m][back]
            fly = (self.dist[s.node][m] + home) / uav.speed_mps
            wait = 0.0
            if group is not None:
                wait = max(0.0, max(group.here_s, min(group.docks)) - s.time_s - fly - uav.service_s)
            need = uav.cruise_w * fly + uav.hover_w * uav.service_s + self.wait_w(uav) * wait
            if s.energy_j - need >= uav.reserve_j:
                return m
        return None

    def serves(self, u: int, site: int) -> bool:
        """Whether some task that is left is within half a charge of ``site``."""
        uav = self.p.uavs[u]
        budget = uav.capacity_j - uav.reserve_j - uav.hover_w * uav.service_s
        node = self.site_node(site)
        return any(2.0 * self.dist[m][node] / uav.speed_mps * uav.cruise_w <= budget for m in self.left)

    def next_stop(self, group: _Group) -> int | None:
        """The first hop of the shortest drive to a stop that serves a task, by hops that all UAVs can follow."""
        ugv = self.p.ugvs[group.ugv]
        stagger = max((self.states[u].time_s for u in group.uavs), default=0.0)
        stagger -= min((self.states[u].time_s for u in group.uavs), default=0.0)

        def follows(a: int, b: int) -> bool:
            for u in group.uavs:
                uav = self.p.uavs[u]
                fly = self.fly_s(u, self.site_node(a), self.site_node(b))
                wait = max(0.0, float(self.road[a][b]) / ugv.speed_mps + stagger - fly)
                if uav.capacity_j - uav.cruise_w * fly - self.wait_w(uav) * wait < uav.reserve_j:
                    return False
            return True

        start = group.site
        reach: list[tuple[float, int, int]] = []
        for s in range(self.n_sites):
            metres = self.drive_m(group, s)
            if s != start and metres < INF and all(self.meets(u, group, s) for u in group.uavs):
                heapq.heappush(reach, (metres, s, s))
        settled: set[int] = set() if start is None else {start}
        while reach:
            metres, s, first = heapq.heappop(reach)
            if s in settled:
                continue
            settled.add(s)
            if any(self.serves(u, s) for u in group.uavs):
                return first
            for b in range(self.n_sites):
                if b not in settled and self.road[s][b] < INF and follows(s, b):
                    heapq.heappush(reach, (metres + float(self.road[s][b]), b, first))
        return None

    def step(self, group: _Group) -> None:
        """Lets the group's earliest UAV visit a task or recharge; where none can, the group goes to its next stop."""
        if group.site is None:
            sites = [s for s in range(self.n_sites) if self.drive_m(group, s) < INF]
            good = [s for s in sites if all(self.meets(u, group, s) for u in group.uavs)]
            if not (good or sites) or not group.uavs:
                group.done = True
                return
            self.move(group, min(good or sites, key=lambda s: (self.drive_m(group, s), s)))
            for u in group.uavs:
                self.recharge(u, group)
            return
        node = self.site_node(group.site)
        for u in sorted(group.uavs, key=lambda u: (self.states[u].time_s, u)):
            m = self.next_task(u, node, group)
            if m is not None:
                self.visit(u, m)
                return
            if not self.states[u].full and self.meets(u, group, group.site):
                self.recharge(u, group)
                return
        stop = self.next_stop(group) if group.uavs and self.left else None
        if stop is None:
            group.done = True
            return
        self.move(group, stop)
        for u in sorted(group.uavs, key=lambda u: (self.states[u].time_s, u)):
            self.recharge(u, group)

    def build(self) -> list[Action]:
        while self.left:
            active = [g for g in self.groups if not g.done and g.uavs]
            if not active:
                break
            self.step(min(active, key=lambda g: (min(self.states[u].time_s for u in g.uavs), g.ugv)))
        for u in self.states:  # whatever energy is left
            while (m := self.next_task(u, None, None)) is not None:
                self.visit(u, m)
        return self.actions


def construct(
    problem: Problem, exclude_uavs: Collection[int] = (), exclude_ugvs: Collection[int] = ()
) -> list[list[Action]]:
    """First plans to choose from: with all UAVs, and with as many per UGV as it has docks, and with one per UGV.

    Tasks that a plan does not reach are left out.
    """
    uavs = [u for u in range(len(problem.uavs)) if u not in exclude_uavs]
    ugvs = [g for g in range(len(problem.ugvs)) if g not in exclude_ugvs]
    # The fullest UAVs lead: they are the ones that can wait for others.
    uavs.sort(key=lambda u: (-problem.uavs[u].energy_j, u))
    sizes = {len(uavs), 1, int(np.min([problem.ugvs[g].docks for g in ugvs], initial=len(uavs)))}
    return [_Builder(problem, uavs, ugvs, size).build() for size in sorted(sizes, reverse=True) if size >= 1]
