"""Where everybody is predicted to be at every moment of the plan: timed 3-D paths in arena m and arena s.

The plan's precedences are run with the motions that are really flown: rest-to-rest flights in the UAV's own layer,
climbs and descents, drives on the lane, one UAV at a time in the air above a UGV. Times therefore are a little later
than the schedule's. Nobody holds for anybody else: what would need holding is what the separation check looks for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

from deploy.dispatch_ugv import keep_right
from deploy.flightpath import rest_to_rest_s
from deploy.settings import Settings
from drivers.vehicle import Vec2, Vec3
from planner.plan import Move, Plan, Recharge, Visit

Kind = Literal["climb", "fly", "serve", "wait", "descend", "drive", "park"]


@dataclass(frozen=True, slots=True)
class Leg:
    """Straight motion at constant velocity, or rest.

    Attributes:
        kind: what the vehicle does.
        t0_s, t1_s: from and to, arena s from the start.
        a_m, b_m: where from and to, arena m.
    """

    kind: Kind
    t0_s: float
    t1_s: float
    a_m: Vec3
    b_m: Vec3


@dataclass(frozen=True, slots=True)
class TeamPaths:
    """Predicted paths.

    Attributes:
        uavs: of each UAV, its legs in the air in order of time; on the ground and on docks it has none.
        ugvs: of each UGV, without gaps from 0 to ``end_s``.
        end_s: when the last vehicle has come to rest, arena s.
    """

    uavs: tuple[tuple[Leg, ...], ...]
    ugvs: tuple[tuple[Leg, ...], ...]
    end_s: float


def team_paths(settings: Settings, plan: Plan) -> TeamPaths:
    """Predicts the paths of a feasible plan.

    Raises:
        RoadError: when no road leads where a UGV must go.
    """
    return _Prediction(settings, plan).run()


class _Prediction:
    """The working state of one prediction."""

    def __init__(self, settings: Settings, plan: Plan) -> None:
        self.settings, self.plan, problem = settings, plan, settings.problem
        self.scale = settings.frame.time_scale
        self.rows = {row.action: row for row in plan.schedule.actions}
        self.uav_legs: list[list[Leg]] = [[] for _ in problem.uavs]
        self.ugv_legs: list[list[Leg]] = [[] for _ in problem.ugvs]
        self.uav_t = [0.0] * len(problem.uavs)
        self.uav_at: list[Vec3] = []
        for i in range(len(problem.uavs)):
            self.uav_at.append((*settings.pad_m(i, problem.depot_index), 0.0))
        self.site = [problem.depot_index if g.path_point is None else g.path_point for g in problem.ugvs]
        self.ugv_t = [g.ready_s * self.scale for g in problem.ugvs]
        self.ugv_at: list[Vec2] = []
        for i, g in enumerate(problem.ugvs):
            between = g.distance_to_m is not None and g.position is not None
            self.ugv_at.append(
                settings.frame.to_arena(g.position) if between and g.position else self.place(i, self.site[i])
            )
        self.yaw = [0.0] * len(problem.ugvs)
        self.leave = list(self.ugv_t)
        docks = [
            [t * self.scale for t in g.dock_ready_s] + [0.0] * (g.docks - len(g.dock_ready_s)) for g in problem.ugvs
        ]
        self.docks = docks
        self.air: list[list[tuple[float, float]]] = [[] for _ in problem.ugvs]  # when the column above is in use

    def run(self) -> TeamPaths:
        """Runs all actions and recoveries."""
        for u, uav in enumerate(self.settings.problem.uavs):
            config = self.settings.uavs[u]
            climb_s = rest_to_rest_s(config.altitude_m, config.climb_mps, config.accel_mps2)
            self.uav_t[u] = max(0.0, uav.ready_s * self.scale - climb_s)
        for k, action in enumerate(self.plan.actions):
            match action:
                case Visit(uav=u, task=m):
                    x, y = self.settings.problem.tasks[m]
                    self.fly(u, self.settings.frame.to_arena((float(x), float(y))))
                    # service_s includes stopping, which the flight itself has taken already
                    config = self.settings.uavs[u]
                    stop_s = config.speed_mps / config.accel_mps2
                    service_s = self.settings.problem.uavs[u].service_s * self.scale
                    self.rest(u, "serve", self.uav_t[u] + max(0.0, service_s - stop_s))
                case Recharge():
                    self.recharge(k, action)
                case Move(ugv=g, path_point=p):
                    self.drive(g, self.settings.problem.depot_index if p is None else p)
        self.recover()
        end_s = max([*self.uav_t, *self.ugv_t])
        for g, legs in enumerate(self.ugv_legs):
            since = legs[-1].t1_s if legs else 0.0
            here = (*self.ugv_at[g], 0.0)
            legs.append(Leg("park", since, max(end_s, since), here, here))
        return TeamPaths(tuple(map(tuple, self.uav_legs)), tuple(map(tuple, self.ugv_legs)), end_s)

    def place(self, ugv: int, site: int) -> Vec2:
        """The UGV's own stopping place at a site."""
        return self.settings.park_m(ugv, site)

    def _site_m(self, site: int) -> Vec2:
        x, y = self.settings.problem.sites[site]
        return self.settings.frame.to_arena((float(x), float(y)))

    def _pad_m(self, uav: int, site: int) -> Vec2:
        return self.settings.pad_m(uav, site)

    # --- UAVs -------------------------------------------------------------------------------------------------------

    def move(self, uav: int, kind: Kind, to: Vec3, speed_mps: float) -> None:
        """One straight motion from rest to rest, at its constant mean speed."""
        start, t0 = self.uav_at[uav], self.uav_t[uav]
        duration_s = rest_to_rest_s(math.dist(start, to), speed_mps, self.settings.uavs[uav].accel_mps2)
        if duration_s > 0:
            self.uav_legs[uav].append(Leg(kind, t0, t0 + duration_s, start, to))
        self.uav_at[uav], self.uav_t[uav] = to, t0 + duration_s

    def rest(self, uav: int, kind: Kind, until_s: float) -> None:
        """Hovers until then."""
        t0, at = self.uav_t[uav], self.uav_at[uav]
        if until_s > t0:
            self.uav_legs[uav].append(Leg(kind, t0, until_s, at, at))
            self.uav_t[uav] = until_s

    def climb(self, uav: int) -> None:
        """To its layer, where it is not there yet."""
        config, (x, y, z) = self.settings.uavs[uav], self.uav_at[uav]
        if z < config.altitude_m:
            self.move(uav, "climb", (x, y, config.altitude_m), config.climb_mps)

    def fly(self, uav: int, to: Vec2) -> None:
        """In its own layer, after a climb where it is on the ground."""
        config = self.settings.uavs[uav]
        self.climb(uav)
        self.move(uav, "fly", (*to, config.altitude_m), config.speed_mps)

    def recharge(self, k: int, action: Recharge) -> None:
        """Flies to its own waiting place, waits, docks, charges and climbs away."""
        u, g = action.uav, action.ugv
        config, ugv, row = self.settings.uavs[u], self.settings.ugvs[g], self.rows[k]
        model = self.settings.problem.ugvs[g]
        self.fly(u, self._pad_m(u, self.site[g]))
        dock = row.dock or 0
        dx, dy = ugv.dock_offsets_m[dock % len(ugv.dock_offsets_m)]
        c, s = math.cos(self.yaw[g]), math.sin(self.yaw[g])
        over = (self.ugv_at[g][0] + c * dx - s * dy, self.ugv_at[g][1] + s * dx + c * dy)
        down_m = config.altitude_m - ugv.pad_height_m
        approach_s = rest_to_rest_s(math.dist(over, self.uav_at[u][:2]), config.speed_mps, config.accel_mps2)
        descent_s = rest_to_rest_s(down_m, config.descent_mps, config.accel_mps2)
        climb_s = rest_to_rest_s(down_m, config.climb_mps, config.accel_mps2)
        ready = max(self.uav_t[u], self.ugv_t[g], self.docks[g][dock])
        begin = self._free(g, ready, approach_s + descent_s)
        self.rest(u, "wait", begin)
        self.move(u, "fly", (*over, config.altitude_m), config.speed_mps)
        self.move(u, "descend", (*over, ugv.pad_height_m), config.descent_mps)
        charged = self.uav_t[u] + max(0.0, row.end_s - row.work_s - model.dock_s - model.undock_s) * self.scale
        self.uav_t[u] = self._free(g, charged, climb_s)
        if any(_uses(a, u) for a in self.plan.actions[k + 1 :]) or any(
            _moves(a, g) for a in self.plan.actions[k + 1 :]
        ):
            self.climb(u)
        self.docks[g][dock] = self.uav_t[u]
        self.leave[g] = max(self.leave[g], self.uav_t[u])

    def _free(self, ugv: int, from_s: float, for_s: float) -> float:
        """The earliest time from then on at which the air above the UGV is free for so long; takes it."""
        at = from_s
        for t0, t1 in sorted(self.air[ugv]):
            if t0 < at + for_s and at < t1:
                at = t1
        self.air[ugv].append((at, at + for_s))
        return at

    def recover(self) -> None:
        """Every UAV in the air lands on its own pad at the site that the schedule names."""
        for r in self.plan.schedule.recovery:
            if not self.uav_legs[r.uav] or self.uav_legs[r.uav][-1].kind == "descend":
                continue
            site = self.settings.problem.depot_index if r.site is None else r.site
            config = self.settings.uavs[r.uav]
            pad = self._pad_m(r.uav, site)
            self.fly(r.uav, pad)
            self.move(r.uav, "descend", (*pad, 0.0), config.descent_mps)

    # --- UGVs -------------------------------------------------------------------------------------------------------

    def drive(self, ugv: int, site: int) -> None:
        """Drives when every UAV listed before has left, on its lane, from stopping place to stopping place."""
        begin = max(self.ugv_t[ugv], self.leave[ugv])
        legs, here = self.ugv_legs[ugv], self.ugv_at[ugv]
        since = legs[-1].t1_s if legs else 0.0
        if begin > since:
            legs.append(Leg("park", since, begin, (*here, 0.0), (*here, 0.0)))
        t, config = begin, self.settings.ugvs[ugv]
        if site != self.site[ugv] or self.settings.problem.ugvs[ugv].distance_to_m is not None:
            route = self.route(ugv, site)
            length_m = sum(math.dist(p, q) for p, q in pairwise(route))
            total_s = rest_to_rest_s(length_m, config.speed_mps, config.accel_mps2)
            for p, q in pairwise(route):
                step_s = total_s * math.dist(p, q) / length_m
                legs.append(Leg("drive", t, t + step_s, (*p, 0.0), (*q, 0.0)))
                t += step_s
            if len(route) > 1:
                (px, py), (qx, qy) = route[-2:]
                self.yaw[ugv] = math.atan2(qy - py, qx - px)
            self.ugv_at[ugv] = route[-1]
        self.site[ugv] = site
        self.ugv_t[ugv] = self.leave[ugv] = t

    def route(self, ugv: int, site: int) -> list[Vec2]:
        """As the dispatcher will command it."""
        frame, here = self.settings.frame, self.ugv_at[ugv]
        world = self.settings.roads.route(frame.to_world(here), site)
        centre = [frame.to_arena((float(x), float(y))) for x, y in world]
        lane = keep_right(centre, self.settings.ugvs[ugv].lane_offset_m)
        points = [here, *(lane[1:-1] if len(lane) > 2 else lane[:-1]), self.place(ugv, site)]
        return [p for i, p in enumerate(points) if i == 0 or math.dist(p, points[i - 1]) > 1e-6]


def _uses(action: object, uav: int) -> bool:
    return isinstance(action, Visit | Recharge) and action.uav == uav


def _moves(action: object, ugv: int) -> bool:
    return isinstance(action, Move) and action.ugv == ugv


def polyline(legs: Sequence[Leg]) -> list[Vec2]:
    """The ground track of a path, without repeated points."""
    points: list[Vec2] = []
    for leg in legs:
        for p in (leg.a_m, leg.b_m):
            if not points or math.dist(points[-1], p[:2]) > 1e-9:
                points.append((p[0], p[1]))
    return points
