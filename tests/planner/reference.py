"""An independent evaluator written from the design's text: plain recursion over who waits for whom, no arrays.

It shares nothing with ``planner.kernel`` but the meaning, and is slow on purpose.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem

TINY_J = 1e-6


@dataclass(frozen=True)
class Event:
    """Times and energies of one action; of no account where the action is impossible."""

    start: float
    arrive: float
    work: float
    end: float
    energy_start: float
    energy_land: float
    energy_dock: float
    energy_end: float
    given: float = 0.0
    dock: int | None = None
    impossible: str | None = None


class Reference:
    """Evaluates ``actions`` on ``problem``; ``late_s`` delays the end of single actions."""

    def __init__(
        self,
        problem: Problem,
        actions: list[Action],
        late_s: dict[int, float] | None = None,
        no_uavs: tuple[int, ...] = (),
        no_ugvs: tuple[int, ...] = (),
    ) -> None:
        self.p, self.actions, self.late = problem, actions, late_s or {}
        self.no_uavs, self.no_ugvs = no_uavs, no_ugvs
        self.memo: dict[int, Event] = {}

    # ---- who did what before

    def of_uav(self, u: int, before: int) -> list[int]:
        return [i for i, a in enumerate(self.actions[:before]) if not isinstance(a, Move) and a.uav == u]

    def moves(self, g: int, before: int) -> list[int]:
        """Moves of g that were possible."""
        rows = [i for i, a in enumerate(self.actions[:before]) if isinstance(a, Move) and a.ugv == g]
        return [i for i in rows if self.event(i).impossible is None]

    def recharges(self, g: int, before: int) -> list[int]:
        rows = [i for i, a in enumerate(self.actions[:before]) if isinstance(a, Recharge) and a.ugv == g]
        return [i for i in rows if self.event(i).impossible is None]

    def where_uav(self, u: int, before: int) -> tuple[float, float]:
        for i in reversed(self.of_uav(u, before)):
            if self.event(i).impossible is None:
                a = self.actions[i]
                if isinstance(a, Visit):
                    return tuple(self.p.tasks[a.task])
                return self.site_xy(self.where_ugv(a.ugv, i))
        return self.p.uavs[u].position

    def where_ugv(self, g: int, before: int) -> int | str | None:
        """A path point, None for the depot, or the word between."""
        moves = self.moves(g, before)
        if moves:
            return self.actions[moves[-1]].path_point
        return "between" if self.p.ugvs[g].distance_to_m is not None else self.p.ugvs[g].path_point

    def site_xy(self, site: int | None) -> tuple[float, float]:
        return tuple(self.p.depot) if site is None else tuple(self.p.path_points[site])

    def metres(self, g: int, before: int, to: int | None) -> float:
        column = len(self.p.path_points) if to is None else to
        here = self.where_ugv(g, before)
        if here == "between":
            return self.p.ugvs[g].distance_to_m[column]
        return float(self.p.road_distance_m[len(self.p.path_points) if here is None else here][column])

    def uav_before(self, u: int, before: int) -> tuple[float, float]:
        """Time and energy when UAV u is free for its next action."""
        mine = self.of_uav(u, before)
        if not mine:
            return self.p.uavs[u].ready_s, self.p.uavs[u].energy_j
        return self.event(mine[-1]).end, self.event(mine[-1]).energy_end

    def may_leave(self, g: int, before: int) -> float:
        ugv = self.p.ugvs[g]
        times = [ugv.ready_s, *ugv.dock_ready_s]
        times += [self.event(i).end for i in self.all_moves(g, before) + self.recharges(g, before)]
        return max(times)

    def all_moves(self, g: int, before: int) -> list[int]:
        return [i for i, a in enumerate(self.actions[:before]) if isinstance(a, Move) and a.ugv == g]

    # ---- one action

    def event(self, i: int) -> Event:
        if i not in self.memo:
            a = self.actions[i]
            if isinstance(a, Visit):
                self.memo[i] = self.visit(i, a)
            elif isinstance(a, Move):
                self.memo[i] = self.move(i, a)
            else:
                self.memo[i] = self.recharge(i, a)
        return self.memo[i]

    def nothing(self, u: int, i: int, why: str) -> Event:
        t, e = self.uav_before(u, i)
        return Event(t, t, t, t, e, e, e, e, impossible=why)

    def visit(self, i: int, a: Visit) -> Event:
        if a.uav in self.no_uavs:
            return self.nothing(a.uav, i, "excluded")
        uav = self.p.uavs[a.uav]
        t, e = self.uav_before(a.uav, i)
        fly = math.dist(self.where_uav(a.uav, i), self.p.tasks[a.task]) / uav.speed_mps
        land = e - uav.cruise_w * fly
        rest = land - uav.hover_w * uav.service_s
        end = t + fly + uav.service_s + self.late.get(i, 0.0)
        return Event(t, t + fly, t + fly, end, e, land, rest, rest)

    def move(self, i: int, a: Move) -> Event:
        ugv = self.p.ugvs[a.ugv]
        t = self.may_leave(a.ugv, i)
        e = self.ugv_energy(a.ugv, i, t)
        way = self.metres(a.ugv, i, a.path_point)
        why = "excluded" if a.ugv in self.no_ugvs else "no road" if math.isinf(way) else None
        drive = 0.0 if why else way / ugv.speed_mps
        rest = e - ugv.drive_w * drive
        end = t + drive + self.late.get(i, 0.0)
        return Event(t, t + drive, t + drive, end, e, rest, rest, rest, impossible=why)

    def recharge(self, i: int, a: Recharge) -> Event:
        uav, ugv = self.p.uavs[a.uav], self.p.ugvs[a.ugv]
        here = self.where_ugv(a.ugv, i)
        if a.uav in self.no_uavs or a.ugv in self.no_ugvs:
            return self.nothing(a.uav, i, "excluded")
        if here == "between":
            return self.nothing(a.uav, i, "between")
        t, e = self.uav_before(a.uav, i)
        fly = math.dist(self.where_uav(a.uav, i), self.site_xy(here)) / uav.speed_mps
        docks = list(ugv.dock_ready_s) + [0.0] * (ugv.docks - len(ugv.dock_ready_s))
        for j in self.recharges(a.ugv, i):
            docks[self.event(j).dock] = self.event(j).end
        dock = docks.index(min(docks))
        there = max([ugv.ready_s, *[self.event(j).end for j in self.all_moves(a.ugv, i)]])
        work = max(t + fly, there, docks[dock])
        land = e - uav.cruise_w * fly
        low = land - (uav.hover_w * (work - t - fly) if uav.waiting == "hover" else 0.0)
        given = max(0.0, uav.capacity_j - low)
        charge = ugv.charge_s if ugv.charge_w is None else given / ugv.charge_w
        end = work + ugv.dock_s + charge + ugv.undock_s + self.late.get(i, 0.0)
        return Event(t, t + fly, work, end, e, land, low, low + given, given, dock)

    # ---- sums

    def driven_s(self, g: int, before: int) -> float:
        return sum(
            self.metres(g, i, self.actions[i].path_point) / self.p.ugvs[g].speed_mps for i in self.moves(g, before)
        )

    def ugv_used(self, g: int, before: int, until: float) -> float:
        """Driving and standing."""
        ugv, drive = self.p.ugvs[g], self.driven_s(g, before)
        return ugv.drive_w * drive + ugv.idle_w * max(0.0, until - ugv.ready_s - drive)

    def ugv_energy(self, g: int, before: int, at: float) -> float:
        given = sum(self.event(i).given for i in self.recharges(g, before))
        return self.p.ugvs[g].energy_j - self.ugv_used(g, before, at) - given

    @cached_property
    def events(self) -> list[Event]:
        return [self.event(i) for i in range(len(self.actions))]

    @property
    def end(self) -> float:
        alive = [
            e.end for a, e in zip(self.actions, self.events, strict=True) if isinstance(a, Move) or e.impossible is None
        ]
        return max(alive, default=0.0)

    @property
    def makespan(self) -> float:
        rows = zip(self.actions, self.events, strict=True)
        return max((e.end for a, e in rows if isinstance(a, Visit) and not e.impossible), default=0.0)

    @property
    def uav_energy(self) -> float:
        return sum(
            e.energy_start - e.energy_dock
            for a, e in zip(self.actions, self.events, strict=True)
            if not isinstance(a, Move)
        )

    @property
    def ugv_energy_used(self) -> float:
        n = len(self.actions)
        return sum(self.ugv_used(g, n, self.end) for g in range(len(self.p.ugvs)) if g not in self.no_ugvs)

    @property
    def given(self) -> float:
        return sum(e.given for e in self.events)

    @property
    def waiting(self) -> float:
        return sum(
            e.work - e.arrive
            for a, e in zip(self.actions, self.events, strict=True)
            if isinstance(a, Recharge) and not e.impossible
        )

    def recovery(self, u: int) -> tuple[float, float, float]:
        """Distance to the nearest site, end and energy of the recovery."""
        n = len(self.actions)
        here = self.where_uav(u, n)
        away = min(math.dist(here, self.site_xy(s)) for s in [None, *range(len(self.p.path_points))])
        t, e = self.uav_before(u, n)
        fly = away / self.p.uavs[u].speed_mps
        return away, t + fly, e - self.p.uavs[u].cruise_w * fly

    def violation(self) -> tuple[str, int] | None:
        """The first violated constraint and its action or vehicle."""
        seen = {m for m in range(self.p.n_tasks) if self.p.visited[m]}
        n = len(self.actions)
        for i, (a, e) in enumerate(zip(self.actions, self.events, strict=True)):
            if e.impossible:
                return e.impossible, i
            if isinstance(a, Move):
                if e.energy_end < -TINY_J:
                    return "drive", i
                continue
            reserve = self.p.uavs[a.uav].reserve_j - TINY_J
            if isinstance(a, Visit):
                if a.task in seen:
                    return "twice", i
                seen.add(a.task)
            if e.energy_land < reserve:
                return "way", i
            if e.energy_dock < reserve:
                return "wait", i
            if isinstance(a, Recharge) and self.ugv_energy(a.ugv, i + 1, e.end) < -TINY_J:
                return "give", i
        for u, uav in enumerate(self.p.uavs):
            if u in self.no_uavs:
                continue
            away, _, rest = self.recovery(u)
            if rest < uav.reserve_j - TINY_J and not (not self.did_anything(u) and away <= 1e-3):
                return "recovery", u
        for g in range(len(self.p.ugvs)):
            if g not in self.no_ugvs and self.ugv_energy(g, n, self.end) < -TINY_J:
                return "stand", g
        if len(seen) < self.p.n_tasks:
            return "unvisited", 0
        return None

    def did_anything(self, u: int) -> bool:
        return any(self.event(i).impossible is None for i in self.of_uav(u, len(self.actions)))
