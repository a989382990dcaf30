"""A tiny world of perfect physics to fly the pure core in: vehicles go straight to where they are told, at once.

It holds no code of ours but the supervisor and the gate. Faults are plain sets and counters that a test changes, and
every turn is audited: see ``audit``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from deploy import supervisor
from deploy.events import Event, EventKind
from deploy.gate import GateState, judge
from deploy.observation import Observation, OperatorInput, PlanReply, PlanRequest, Refusal
from deploy.settings import Settings
from deploy.state import AIRBORNE, MissionPhase, State, UavPhase, UgvPhase
from deploy.supervisor import Step
from deploy.wake import wake_s
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    StopMotors,
    TakeOff,
    Vec3,
    VehicleState,
)
from planner.plan import Plan

DT_S = 0.1
MOTION = TakeOff | GoTo | Dock | Drive


@dataclass
class Body:
    """One vehicle. ``path`` is the way it still has to go; ``aboard`` the UGV and dock that a UAV stands on."""

    id: str
    at: Vec3
    yaw_rad: float = 0.0
    path: list[Vec3] = field(default_factory=list)
    speed_mps: float = 0.0
    command: Command | None = None
    armed: bool = False
    airborne: bool = False
    tumbled: bool = False
    locked: bool = False
    charging: bool = False
    battery: float = 1.0
    aboard: tuple[str, int] | None = None


@dataclass
class World:
    """The fleet, its faults, the loop and what came of it.

    Attributes:
        planner: answers a replan request; None: no answer ever comes.
        reply_after_s: how long that takes.
        blind, mute, deaf: ids of vehicles without poses, without telemetry, that hear no command.
        stalled: ids of vehicles that do not move.
        slow: share of the commanded speed, by id.
        misses: dockings that will still be missed, by UAV.
        no_charge: UAVs that find no contact on the dock.
        drain: measured battery per second in the air; charging gains ``charge``.
        wishes: operator's wishes by time.
    """

    settings: Settings
    plan: Plan
    planner: Callable[[PlanRequest], PlanReply | None] | None = None
    reply_after_s: float = 1.0
    blind: set[str] = field(default_factory=set)
    mute: set[str] = field(default_factory=set)
    deaf: set[str] = field(default_factory=set)
    stalled: set[str] = field(default_factory=set)
    slow: dict[str, float] = field(default_factory=dict)
    misses: dict[str, int] = field(default_factory=dict)
    no_charge: set[str] = field(default_factory=set)
    drain: float = 0.002
    charge: float = 0.02
    use_gate: bool = True
    auto_start: bool = True
    now_s: float = 0.0
    state: State = field(init=False)
    gate: GateState = field(default_factory=GateState)
    bodies: dict[str, Body] = field(init=False)
    telemetry: dict[str, VehicleState] = field(default_factory=dict)
    refusals: tuple[Refusal, ...] = ()
    helpless: set[str] = field(default_factory=set)
    replies: list[tuple[float, PlanReply]] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    commands: list[tuple[float, Command]] = field(default_factory=list)
    requests: list[PlanRequest] = field(default_factory=list)
    history: list[tuple[State, Observation, Step]] = field(default_factory=list)
    turns: int = 0

    def __post_init__(self) -> None:
        self.state = supervisor.initial(self.settings, self.plan)
        depot = self.settings.problem.depot_index
        self.bodies = {}
        for c in self.settings.uavs:
            x, y = self._site_m(depot)
            self.bodies[c.id] = Body(c.id, (x + c.pad_offset_m[0], y + c.pad_offset_m[1], 0.0))
        for g, model in zip(self.settings.ugvs, self.settings.problem.ugvs, strict=True):
            x, y = self._site_m(depot if model.path_point is None else model.path_point)
            self.bodies[g.id] = Body(g.id, (x + g.park_offset_m[0], y + g.park_offset_m[1], 0.0))

    # --- what a test asks -------------------------------------------------------------------------------------------

    def told(self, kind: EventKind, vehicle: str | None = None) -> list[Event]:
        """Events of a kind so far."""
        return [e for e in self.events if e.kind is kind and (vehicle is None or e.vehicle == vehicle)]

    def sent(self, kind: type, vehicle: str | None = None) -> list[Command]:
        """Commands of a kind so far."""
        return [c for _, c in self.commands if isinstance(c, kind) and (vehicle is None or c.vehicle == vehicle)]

    def fly(
        self, *, limit_s: float = 1500.0, until: Callable[[World], bool] | None = None, skip: bool = False
    ) -> World:
        """Flies on until the mission is over, ``until`` holds or ``limit_s`` has passed.

        ``skip`` runs the supervisor only when ``wake_s`` or a change that it can see asks for it.
        """
        end_s, seen = self.now_s + limit_s, None
        wake = self.now_s
        while self.now_s < end_s and not self.state.over and not (until is not None and until(self)):
            changed = self._visible() != seen
            if not skip or self.now_s >= wake - 1e-9 or changed or self.refusals or self._due():
                self.turn(self._standing_wishes())
                wake = wake_s(self.settings, self.state, self.now_s)
                assert self.now_s < wake <= self.now_s + self.settings.replanning.review_s
                seen = self._visible()
            self._move()
            self.now_s = round(self.now_s + DT_S, 6)
        return self

    def turn(self, wishes: Sequence[OperatorInput] = ()) -> Step:
        """One turn of the loop at the present time."""
        seen = self.observe(tuple(wishes))
        before = self.state
        result = supervisor.step(self.settings, before, seen)
        self.history.append((before, seen, result))
        accepted, self.refusals = result.commands, ()
        if self.use_gate:
            verdict = judge(self.settings, self.gate, seen, result.commands)
            self.gate, accepted, self.refusals = verdict.state, verdict.accepted, verdict.refused
        self.state = result.state
        self.turns += 1
        self.events.extend(result.events)
        self.commands.extend((self.now_s, c) for c in result.commands)
        for command in accepted:
            if command.vehicle not in self.deaf | self.mute:
                self._obey(command)
        if result.request is not None:
            self.requests.append(result.request)
            reply = self.planner(result.request) if self.planner is not None else None
            if reply is not None:
                self.replies = [(self.now_s + self.reply_after_s, reply)]
        self.audit(before, result)
        return result

    def wish(self, wish: str) -> Step:
        """The operator wishes something right now, in a turn of its own."""
        return self.turn((OperatorInput(wish, self.plan.digest, math.inf),))  # type: ignore[arg-type]

    def observe(self, wishes: tuple[OperatorInput, ...] = ()) -> Observation:
        """What the loop would see now."""
        jitter = 1e-8 * (1 + round(self.now_s / DT_S))  # real poses carry noise
        poses = tuple(
            Pose(f"body-{b.id}", (b.at[0] + jitter, b.at[1], b.at[2]), b.yaw_rad, self.now_s)
            for b in self.bodies.values()
            if b.id not in self.blind
        )
        for b in self.bodies.values():
            if b.id not in self.mute:
                self.telemetry[b.id] = VehicleState(
                    b.id, self.now_s, True, b.armed, b.airborne, b.tumbled, b.locked, b.charging, b.battery
                )
        reply = None
        if self._due():
            reply = self.replies.pop(0)[1]
        return Observation(self.now_s, poses, tuple(self.telemetry.values()), wishes, reply, self.refusals)

    # --- the audit --------------------------------------------------------------------------------------------------

    def audit(self, before: State, result: Step) -> None:
        """What must hold in every turn, whatever happens."""
        after, settings = result.state, self.settings
        unarmed = {MissionPhase.DISARMED, MissionPhase.CHECKED, MissionPhase.ARMED}
        if before.phase in unarmed and after.phase in unarmed:
            assert all(isinstance(c, Arm | StopMotors) for c in result.commands), result.commands
        for uav, was in zip(after.uavs, before.uavs, strict=True):
            mine = [c for c in result.commands if c.vehicle == settings.uavs[uav.index].id]
            body = self.bodies[settings.uavs[uav.index].id]
            if was.phase in (UavPhase.DOWN, UavPhase.LOST):
                assert all(isinstance(c, StopMotors | Land | Disarm) for c in mine), mine
            helpless = body.id in self.mute | self.deaf | self.stalled  # it cannot be told to land, or does not
            self.helpless |= {body.id} if helpless else set()
            if uav.phase in AIRBORNE and body.airborne and body.id not in self.helpless:
                assert uav.energy_j > 0, f"{body.id} runs dry in the air at {self.now_s:.1f} s in {uav.phase}"
        for ugv, was_g in zip(after.ugvs, before.ugvs, strict=True):
            name = settings.ugvs[ugv.index].id
            mine = [c for c in result.commands if c.vehicle == name]
            if was_g.phase is UgvPhase.LOST:
                assert all(isinstance(c, StopMotors | Disarm) for c in mine), mine
            guests = [u for u in after.uavs if u.docked is not None and u.docked[0] == ugv.index]
            if guests:
                assert ugv.phase is not UgvPhase.DRIVING, f"{name} drives with {len(guests)} UAVs at its docks"
        for event in result.events:
            if event.kind is EventKind.TASK_VISITED:
                new = [m for m, v in enumerate(after.visited) if v and not before.visited[m]]
                body = self.bodies[event.vehicle or ""]
                assert any(
                    math.dist(body.at[:2], settings.frame.to_arena(tuple(settings.problem.tasks[m]))) < 1.5 for m in new
                )
        if after.over and not before.over and MissionPhase.ABORTED is not after.phase:
            assert all(u.phase in (UavPhase.DOWN, UavPhase.LOST) for u in after.uavs)

    # --- physics ----------------------------------------------------------------------------------------------------

    def _site_m(self, site: int) -> tuple[float, float]:
        x, y = self.settings.problem.sites[site]
        return self.settings.frame.to_arena((float(x), float(y)))

    def _standing_wishes(self) -> tuple[OperatorInput, ...]:
        if not self.auto_start:
            return ()
        if self.state.phase is MissionPhase.DISARMED:
            return (OperatorInput("checked", self.plan.digest, math.inf), OperatorInput("arm"))
        return (OperatorInput("start"),) if self.state.phase is MissionPhase.ARMED else ()

    def _due(self) -> bool:
        return bool(self.replies) and self.now_s >= self.replies[0][0] - 1e-9

    def _visible(self) -> object:
        return [
            (b.armed, b.airborne, b.tumbled, b.locked, b.charging, bool(b.path), b.id in self.blind)
            for b in self.bodies.values()
        ]

    def _dock_m(self, ugv: str, dock: int) -> Vec3:
        config = next(g for g in self.settings.ugvs if g.id == ugv)
        body, (dx, dy) = self.bodies[ugv], config.dock_offsets_m[dock]
        c, s = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
        return (body.at[0] + c * dx - s * dy, body.at[1] + s * dx + c * dy, config.pad_height_m)

    def _obey(self, command: Command) -> None:
        body = self.bodies[command.vehicle]
        if isinstance(command, StopMotors):
            body.locked, body.armed, body.airborne, body.path = True, False, False, []
            body.at = (body.at[0], body.at[1], min(body.at[2], 0.5))
            return
        if isinstance(command, Arm | Disarm):
            if not body.airborne and not body.locked:
                body.armed = isinstance(command, Arm)
            return
        if not body.armed or body.locked:
            return
        x, y, _z = body.at
        if isinstance(command, Dock):
            pad = self._dock_m(command.onto, command.dock)
            if self.misses.get(body.id, 0) > 0:
                self.misses[body.id] -= 1
                body.path = [(pad[0], pad[1], 1.5), (pad[0], pad[1], command.abort_altitude_m)]
            else:
                body.path = [pad]
        elif isinstance(command, TakeOff):
            body.path, body.airborne, body.charging, body.aboard = [(x, y, command.altitude_m)], True, False, None
        elif isinstance(command, GoTo):
            body.path = [command.position_m] if body.airborne else []
        elif isinstance(command, Land):
            body.path = [(x, y, 0.0)] if body.airborne else []
        elif isinstance(command, Hold):
            body.path = []
        elif isinstance(command, Drive):
            body.path = [(px, py, 0.0) for px, py in command.path_m[1:]]
        body.command = command
        body.speed_mps = getattr(command, "speed_mps", 0.0)

    def _move(self) -> None:
        for body in self.bodies.values():
            left_m = 0.0 if body.id in self.stalled else body.speed_mps * self.slow.get(body.id, 1.0) * DT_S
            begin = body.at
            while body.path and left_m > 0:
                goal = body.path[0]
                far_m = math.dist(body.at, goal)
                if far_m <= left_m:
                    body.at, left_m = goal, left_m - far_m
                    body.path.pop(0)
                else:
                    f = left_m / far_m
                    body.at = (
                        body.at[0] + f * (goal[0] - body.at[0]),
                        body.at[1] + f * (goal[1] - body.at[1]),
                        body.at[2] + f * (goal[2] - body.at[2]),
                    )
                    left_m = 0.0
            if isinstance(body.command, Drive) and body.at != begin:
                body.yaw_rad = math.atan2(body.at[1] - begin[1], body.at[0] - begin[0])
                aboard = [b.id for b in self.bodies.values() if b.aboard is not None and b.aboard[0] == body.id]
                assert not aboard, f"{body.id} drives off with {aboard} on its docks"
            self._settle(body)
            if body.airborne:
                body.battery = max(0.0, body.battery - self.drain * DT_S)
            elif body.charging:
                body.battery = min(1.0, body.battery + self.charge * DT_S)

    def _settle(self, body: Body) -> None:
        if not body.airborne or body.path:
            return
        if isinstance(body.command, Land) and body.at[2] <= 0.0:
            body.airborne = body.armed = False
        elif isinstance(body.command, Dock) and body.at[2] <= 1.0:
            body.airborne = body.armed = False
            body.aboard = (body.command.onto, body.command.dock)
            body.charging = body.id not in self.no_charge


def no_better(request: PlanRequest) -> PlanReply:
    """A planner that always answers with the plan it was given."""
    return PlanReply(request.number, True, request.start, "test", 0.1)


def nothing_works(request: PlanRequest) -> PlanReply:
    """A planner that never finds a plan."""
    return PlanReply(request.number, False, (), "test", 0.1, "there is no way", usable=False)
