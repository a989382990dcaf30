"""The shortest plan of a tiny problem by trying everything; written from the design's text, shares no code."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from planner.plan import Move, Recharge, Visit
from planner.problem import Problem

TINY_J = 1e-6


@dataclass(frozen=True)
class Air:
    xy: tuple[float, float]
    t: float
    e: float
    acted: bool = False


@dataclass(frozen=True)
class Ground:
    site: int | None  # None: between path points
    here: float
    leave: float
    docks: tuple[float, ...]
    moved: bool = False  # since its last recharge


class Brute:
    """``best`` and ``actions`` after construction; ``recharges`` limits how many a plan has."""

    def __init__(self, problem: Problem, recharges: int) -> None:
        self.p = problem
        self.best, self.actions = math.inf, None
        self.seen: dict[object, float] = {}
        sites = [tuple(map(float, s)) for s in problem.sites]
        self.sites = sites
        air = tuple(Air(tuple(map(float, u.position)), u.ready_s, u.energy_j) for u in problem.uavs)
        ground = []
        for g in problem.ugvs:
            docks = tuple(g.dock_ready_s) + (0.0,) * (g.docks - len(g.dock_ready_s))
            at = len(sites) - 1 if g.path_point is None else g.path_point
            ground.append(Ground(None if g.distance_to_m is not None else at, g.ready_s, max(g.ready_s, *docks), docks))
        left = frozenset(m for m in range(problem.n_tasks) if not problem.visited[m])
        self.dive(air, tuple(ground), left, 0.0, recharges, ())

    def home(self, s: Air) -> float:
        return min(math.dist(s.xy, site) for site in self.sites)

    def dive(self, air, ground, left, span, recharges, done) -> None:
        if span >= self.best - 1e-9:
            return
        key = (air, ground, left, recharges)
        if self.seen.get(key, math.inf) <= span:
            return
        self.seen[key] = span
        if not left and all(self.lands(u, s) for u, s in enumerate(air)):
            self.best, self.actions = span, list(done)
            return
        for u, s in enumerate(air):
            uav = self.p.uavs[u]
            for m in left:
                to = tuple(map(float, self.p.tasks[m]))
                fly = math.dist(s.xy, to) / uav.speed_mps
                e = s.e - uav.cruise_w * fly - uav.hover_w * uav.service_s
                if e < uav.reserve_j - TINY_J:
                    continue
                t = s.t + fly + uav.service_s
                after = Air(to, t, e, True)
                self.dive(put(air, u, after), ground, left - {m}, max(span, t), recharges, (*done, Visit(u, m)))
            for g, r in enumerate(ground):
                if r.site is None or recharges == 0:
                    continue
                ugv = self.p.ugvs[g]
                fly = math.dist(s.xy, self.sites[r.site]) / uav.speed_mps
                k = r.docks.index(min(r.docks))
                work = max(s.t + fly, r.here, r.docks[k])
                e = s.e - uav.cruise_w * fly
                if uav.waiting == "hover":
                    e -= uav.hover_w * (work - s.t - fly)
                if e < uav.reserve_j - TINY_J:
                    continue
                given = max(0.0, uav.capacity_j - e)
                charge = ugv.charge_s if ugv.charge_w is None else given / ugv.charge_w
                end = work + ugv.dock_s + charge + ugv.undock_s
                up = Air(self.sites[r.site], end, e + given, True)
                down = replace(r, leave=max(r.leave, end), docks=put(r.docks, k, end), moved=False)
                self.dive(put(air, u, up), put(ground, g, down), left, span, recharges - 1, (*done, Recharge(u, g)))
        if recharges == 0:
            return
        for g, r in enumerate(ground):
            if r.moved:
                continue  # road distances are shortest: driving on without a recharge is of no use
            row = self.p.ugvs[g].distance_to_m if r.site is None else self.p.road_distance_m[r.site]
            for site in range(len(self.sites)):
                if site == r.site or math.isinf(row[site]):
                    continue
                there = r.leave + float(row[site]) / self.p.ugvs[g].speed_mps
                after = Ground(site, there, there, r.docks, True)
                to = None if site == len(self.sites) - 1 else site
                self.dive(air, put(ground, g, after), left, span, recharges, (*done, Move(g, to)))

    def lands(self, u: int, s: Air) -> bool:
        uav, away = self.p.uavs[u], self.home(s)
        if not s.acted and away <= 1e-3:
            return True
        return s.e - uav.cruise_w * away / uav.speed_mps >= uav.reserve_j - TINY_J


def put(values: tuple, index: int, value: object) -> tuple:
    return (*values[:index], value, *values[index + 1 :])
