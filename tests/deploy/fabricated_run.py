"""A fabricated run: 2 UAVs, 2 UGVs, 15 tasks, a late UGV and a replan, from a few lines of dead reckoning."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from deploy.drawing import MapDrawing
from deploy.events import Action as Response
from deploy.events import Event, EventKind, Severity
from deploy.frames import Frame
from deploy.observation import Observation, OperatorInput, PlanReply, PlanRequest, Refusal
from deploy.recording import Recorder, RunMeta
from deploy.settings import Geofence, Monitors, Replanning, Separation, Settings, UavSettings, UgvSettings
from deploy.status import Status, VehicleStatus
from drivers.vehicle import Arm, Command, Drive, GoTo, Pose, TakeOff, VehicleState
from planner.plan import Action, Move, Plan, Recharge, Recovery, Schedule, ScheduledAction, Visit
from planner.problem import Problem, Uav, Ugv

TASKS = [
    (1200, 2300), (2100, 4200), (3300, 2700), (3900, 5400), (2600, 6900), (1100, 6100), (4300, 7900), (5300, 3400),
    (6200, 1900), (7300, 3300), (8500, 2500), (8800, 4900), (7600, 6300), (6100, 5600), (6700, 8100),
]  # fmt: skip
POINTS = [
    (2500, 3500),
    (4000, 4000),
    (3000, 6000),
    (5000, 6500),
    (6500, 4500),
    (7500, 2500),
    (7800, 5200),
    (5000, 2000),
]
DEPOT = (5000.0, 300.0)
FIRST: tuple[Action, ...] = (
    Move(0, 0), Move(1, 5), Visit(0, 0), Visit(1, 8), Visit(0, 1), Visit(1, 10), Recharge(0, 0), Recharge(1, 1),
    Move(0, 2), Move(1, 6), Visit(0, 2), Visit(1, 9), Visit(0, 3), Visit(1, 11), Visit(0, 5), Visit(1, 12),
    Recharge(0, 0), Recharge(1, 1), Visit(0, 4), Visit(1, 14), Visit(0, 6), Visit(1, 13), Visit(1, 7),
)  # fmt: skip
SECOND = (
    *FIRST[:16],
    Recharge(0, 0),
    Recharge(1, 1),
    Visit(0, 4),
    Visit(1, 13),
    Visit(0, 6),
    Visit(0, 14),
    Visit(1, 7),
)
CAPACITY_J, RESERVE_J, CRUISE_W, SPEED, UGV_SPEED, CHARGE_S = 287_700.0, 43_155.0, 198.6, 10.0, 4.5, 300.0


class GridRoads:
    """Roads that run east, then north."""

    sites = np.array([*POINTS, DEPOT], dtype=np.float64)
    distance_m = np.abs(sites[:, None] - sites[None]).sum(axis=2)

    def distances_from(self, point):
        return np.abs(self.sites - np.array(point)).sum(axis=1)

    def route(self, start, site):
        end = self.sites[site]
        return np.array([start, (end[0], start[1]), end], dtype=np.float64)

    def offset_m(self, point):
        return 0.0


def problem() -> Problem:
    return Problem(
        depot=DEPOT,
        tasks=np.array(TASKS, dtype=np.float64),
        path_points=np.array(POINTS, dtype=np.float64),
        road_distance_m=GridRoads.distance_m,
        uavs=tuple(Uav(f"uav{i}", DEPOT, reserve_j=RESERVE_J, waiting="hover") for i in range(2)),
        ugvs=tuple(Ugv(f"ugv{i}") for i in range(2)),
    )


def settings(frame: Frame | None = None) -> Settings:
    frame = frame or Frame()
    s = frame.scale
    fence = tuple(frame.to_arena(p) for p in ((-200, -200), (10200, -200), (10200, 10200), (-200, 10200)))
    return Settings(
        frame=frame,
        geofence=Geofence(polygon_m=fence, ceiling_m=120 * s, soft_margin_m=10 * s),
        separation=Separation(),
        monitors=Monitors(),
        replanning=Replanning(),
        uavs=tuple(
            UavSettings(f"uav{i}", f"body{i}", 30 + 10 * i, 10, 12, 2, 2, 1.5, (0, 10.0 * i), "virtual")
            for i in range(2)
        ),
        ugvs=tuple(
            UgvSettings(f"ugv{i}", f"rover{i}", 4.5, 5, 1, 0, (5.0 * i, 0), 0.5, ((-0.3, 0), (0.3, 0)), "virtual")
            for i in range(2)
        ),
        problem=problem(),
        roads=GridRoads(),
    )


def drawing() -> MapDrawing:
    lines = [
        GridRoads().route(tuple(GridRoads.sites[i]), j) for i in range(9) for j in range(9) if abs(i - j) in (1, 8)
    ]
    angle = np.linspace(0, 2 * math.pi, 40)
    lake = np.column_stack([8600 + 700 * np.cos(angle), 7900 + 500 * np.sin(angle) + 120 * np.sin(3 * angle)])
    wood = np.column_stack([1300 + 800 * np.cos(angle), 8600 + 600 * np.sin(angle) + 90 * np.cos(4 * angle)])
    house = np.array([(5200, 700), (5700, 700), (5700, 1000), (5200, 1000)], dtype=np.float64)
    return MapDrawing(
        (-200, 10200, -200, 10200), tuple(lines), {"water": (lake,), "forest": (wood,), "building": (house,)}
    )


@dataclass(frozen=True)
class Piece:
    """What one vehicle does from ``start`` to ``end`` (s) along ``path``, its energies at both, its action."""

    start: float
    end: float
    path: tuple[tuple[float, float], ...]
    phase: str
    doing: str
    energy: tuple[float, float]
    action: int

    def at(self, t: float) -> tuple[tuple[float, float], float]:
        share = 1.0 if self.end <= self.start else min(1.0, max(0.0, (t - self.start) / (self.end - self.start)))
        lengths = [math.dist(a, b) for a, b in pairwise(self.path)]
        left = share * sum(lengths)
        energy = self.energy[0] + share * (self.energy[1] - self.energy[0])
        for (a, b), d in zip(pairwise(self.path), lengths, strict=True):
            if left <= d and d > 0:
                return (a[0] + (b[0] - a[0]) * left / d, a[1] + (b[1] - a[1]) * left / d), energy
            left -= d
        return self.path[-1], energy


def carry_out(actions: tuple[Action, ...], late_s: dict[int, float]) -> dict[str, list[Piece]]:
    """Every vehicle's pieces when its action i (index) takes ``late_s[i]`` longer; recoveries at the end."""
    roads, pieces = GridRoads(), {v: [] for v in ("uav0", "uav1", "ugv0", "ugv1")}
    place = dict.fromkeys(pieces, DEPOT)
    clock = dict.fromkeys(pieces, 0.0)
    energy = {v: CAPACITY_J if v.startswith("uav") else 36_810_000.0 for v in pieces}

    def add(v, seconds, path, phase, doing, joules, action):
        pieces[v].append(
            Piece(clock[v], clock[v] + seconds, path, phase, doing, (energy[v], energy[v] + joules), action)
        )
        clock[v] += seconds
        energy[v] += joules
        place[v] = path[-1]

    def fly(v, to, doing, action):
        seconds = math.dist(place[v], to) / SPEED
        add(v, seconds, (place[v], to), "flying", doing, -CRUISE_W * seconds, action)

    for i, action in enumerate(actions):
        extra = late_s.get(i, 0.0)
        match action:
            case Visit(u, task):
                fly(f"uav{u}", tuple(map(float, TASKS[task])), f"task {task}", i)
            case Move(g, point):
                v = f"ugv{g}"
                path = tuple(map(tuple, roads.route(place[v], point)))
                seconds = sum(math.dist(a, b) for a, b in pairwise(path)) / UGV_SPEED + extra
                add(v, seconds, path, "driving", f"to path point {point}", -2448 * seconds, i)
            case Recharge(u, g):
                v, c = f"uav{u}", f"ugv{g}"
                fly(v, place[c], f"recharge at {c}", i)
                wait = max(0.0, clock[c] - clock[v])
                add(v, wait, (place[v],) * 2, "waiting", f"recharge at {c}", -229.6 * wait, i)
                missing = CAPACITY_J - energy[v]
                add(c, clock[v] - clock[c], (place[c],) * 2, "parked", "", 0.0, -1)
                add(v, CHARGE_S, (place[v],) * 2, "charging", f"recharge at {c}", missing, i)
                add(c, CHARGE_S, (place[c],) * 2, "parked", f"charging {v}", -missing, -1)
    for u in range(2):
        v = f"uav{u}"
        fly(v, DEPOT if u else tuple(map(float, POINTS[3])), "recovery", -2)
    return pieces


def plan(actions: tuple[Action, ...], late_s: dict[int, float] | None = None) -> Plan:
    pieces = carry_out(actions, late_s or {})
    rows = []
    for i, action in enumerate(actions):
        v = f"ugv{action.ugv}" if isinstance(action, Move) else f"uav{action.uav}"
        mine = [p for p in pieces[v] if p.action == i]
        work = mine[-1].start if isinstance(action, Recharge) else mine[-1].end
        rows.append(
            ScheduledAction(
                i, mine[0].start, mine[-1].end, math.inf if i % 3 else 12.5, 40.0, mine[0].end, work,
                mine[0].energy[0], mine[-1].energy[1], mine[len(mine) // 2].energy[1],
                0 if isinstance(action, Recharge) else None,
            )
        )  # fmt: skip
    makespan = (
        max(r.end_s for r, a in zip(rows, actions, strict=True) if isinstance(a, Visit))
        if Visit in map(type, actions)
        else 0.0
    )
    last = {u: pieces[f"uav{u}"][-1] for u in range(2)}
    recovery = tuple(Recovery(u, None if u else 3, p.start, p.end, p.energy[1]) for u, p in last.items())
    used = 250_000.0
    schedule = Schedule(True, None, makespan, used, used * 20, used / 2, 0.0, max(p.end for p in last.values()),
                        tuple(rows), recovery)  # fmt: skip
    return Plan(actions, schedule, "search", 0.137, None)


LATE = {9: 260.0}


def write(recorder: Recorder, s: Settings, dt: float = 2.0, stop_s: float = math.inf) -> int:
    """Records the run and returns its number of turns; positions go through the frame."""
    rng = random.Random(3)
    pieces = carry_out(SECOND, LATE)
    end = max(p[-1].end for p in pieces.values())
    visits = sorted(
        (p.end, v, int(p.doing.split()[1])) for v, rows in pieces.items() for p in rows if p.doing.startswith("task")
    )
    recorder.plan(plan(FIRST), 0.0, "first plan")
    visited = [False] * len(TASKS)
    ids = tuple(pieces)
    bodies = {"uav0": "body0", "uav1": "body1", "ugv0": "rover0", "ugv1": "rover1"}
    altitude = {"uav0": 30.0, "uav1": 40.0}
    previous: dict[str, Piece] = {}
    replanned, n, k = False, 0, s.frame.time_scale
    while n * dt <= min(end + 20, stop_s):
        mission = n * dt
        now = mission * k
        events: list[Event] = []
        emitted: list[Command] = [Arm(v) for v in ids] if n == 0 else []
        request = reply = None

        def event(kind, severity, vehicle, text, action=Response.NOTE, events=events, now=now):
            events.append(Event(now, kind, severity, vehicle, action, text))

        rows, poses, states = [], [], []
        for v, mine in pieces.items():
            piece = next((p for p in mine if p.start <= mission < p.end), mine[-1])
            (x, y), joules = piece.at(mission)
            over = mission >= mine[-1].end
            phase = piece.phase if not over else ("down" if v.startswith("uav") else "parked")
            z = 0.0 if over or phase == "charging" or v not in altitude else altitude[v]
            if v == "ugv1":
                x += 5.0  # its own lane
            ax, ay = s.frame.to_arena((x, y))
            at = (ax, ay, z * s.frame.scale)
            poses.append(Pose(bodies[v], (at[0] + rng.gauss(0, 0.01), at[1], at[2]), 0.1, now))
            states.append(VehicleState(v, now, True, True, z > 0, charging=phase == "charging", battery=rng.random()))
            full = CAPACITY_J if v.startswith("uav") else 36_810_000.0
            rows.append(VehicleStatus(v, v[:3], phase, at, 0.1, joules, joules / full, piece.doing, None, 10.0))
            if previous.get(v) is not piece:
                old = previous.get(v)
                if piece.phase == "charging":
                    event(EventKind.RECHARGE_STARTED, Severity.INFO, v, f"{v} charges: {piece.doing}")
                if old is not None and old.phase == "charging":
                    event(EventKind.RECHARGE_DONE, Severity.INFO, v, f"{v} is full again")
                if piece.phase == "flying":
                    emitted.append(GoTo(v, (*s.frame.to_arena(piece.path[-1]), at[2]), 10.0))
                if piece.phase == "driving":
                    emitted.append(Drive(v, tuple(s.frame.to_arena(p) for p in piece.path), 4.5))
                previous[v] = piece
        for t, v, task in visits:
            if not visited[task] and t <= mission:
                visited[task] = True
                event(EventKind.TASK_VISITED, Severity.INFO, v, f"task {task} visited, {sum(visited)} of 15")
        if n == 0:
            event(EventKind.MISSION_STATE, Severity.INFO, None, "running")
        refusals = (Refusal(TakeOff("uav1", 400.0, 2.0), "above the ceiling"),) if n == 7 else ()
        if mission >= 1300 and not replanned:
            replanned = True
            event(
                EventKind.UGV_STUCK,
                Severity.WARNING,
                "ugv1",
                "ugv1 makes no progress on its way to path point 6",
                Response.WARN,
            )
            event(EventKind.SCHEDULE_DRIFT, Severity.WARNING, "ugv1",
                  "ugv1 is 241 s late at path point 6; the mission would end 4.1 % later", Response.REPLAN)  # fmt: skip
            request = PlanRequest(1, s.problem, FIRST[16:], "ugv1 is late", False)
            reply = PlanReply(1, True, SECOND[16:], "search", 0.2, None)
            event(EventKind.PLAN_ADOPTED, Severity.INFO, None, "plan 1 is 2.9 % better")
        if n == 300:
            event(EventKind.POSE_STALE, Severity.WARNING, "uav0", "pose of uav0 is 0.6 s old", Response.HOLD)
        operator = (
            (OperatorInput("checked", "abc", 1e9), OperatorInput("arm"), OperatorInput("start")) if n == 0 else ()
        )
        status = Status(now, mission, "running" if mission < end else "done", tuple(visited), int(replanned),
                        3000.0, tuple(rows))  # fmt: skip
        recorder.tick(
            Observation(now, tuple(poses), tuple(states), operator, reply, (), 0.0),
            emitted=emitted, accepted=emitted, sent=tuple(replace(c) for c in emitted), refusals=refusals,
            events=events, status=status, plan_request=request,
        )  # fmt: skip
        if request is not None:
            recorder.plan(plan(SECOND, LATE), now, "ugv1 is late", zero_s=0.0)
        n += 1
    return n


def meta(**changes) -> RunMeta:
    return replace(RunMeta("fabricated", 7, "0" * 64, "1" * 64, command="copcs-deploy run fabricated.yaml --seed 7",
                           started_unix_s=1.7e9), **changes)  # fmt: skip
