"""The loop: observe, step, gate, send, record; at 50 Hz in real time, jumping between events on a virtual clock."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from deploy import supervisor
from deploy.events import Event
from deploy.gate import GateState, judge
from deploy.guard import Guard, under_way
from deploy.observation import Observation, OperatorInput, PlanReply, PlanRequest, Refusal
from deploy.planning import Planner
from deploy.settings import Settings
from deploy.state import AIRBORNE, MissionPhase, State, UavPhase, UgvPhase
from deploy.status import Status, VehicleStatus
from deploy.turn import Adopted, Turn
from deploy.wake import wake_s
from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.vehicle import Command, GoTo, Hold, Land, Pose, PoseSource, StopMotors, Vehicle
from planner.plan import Plan, Recharge, Visit
from planner.problem import Problem
from planner.schedule import evaluate

PERIOD_S = 0.02
DOWN_LEAST_S, DOWN_EXTRA_S = 1.0, 10.0
"""A loop that has failed stays so long at least, and so long beyond twice the time of a landing, until all are down."""


@dataclass(frozen=True, slots=True)
class Tick:
    """Everything about one turn of the loop."""

    observation: Observation
    emitted: tuple[Command, ...]
    accepted: tuple[Command, ...]
    sent: tuple[Command, ...]
    refusals: tuple[Refusal, ...]
    events: tuple[Event, ...]
    status: Status
    request: PlanRequest | None


class Observer(Protocol):
    """Whoever wants to know: the recording, the display, a test."""

    def tick(self, tick: Tick) -> None:
        """Called after each turn."""
        ...

    def plan(self, plan: Plan, time_s: float, mission_s: float, reason: str, problem: Problem) -> None:
        """Called when a plan is adopted; ``mission_s`` is the mission time that its schedule's 0 refers to."""
        ...


class Wishes(Protocol):
    """The operator's wishes since the last call."""

    def poll(self) -> tuple[OperatorInput, ...]:
        """Takes them."""
        ...


@dataclass(frozen=True, slots=True)
class Outcome:
    """How it ended.

    Attributes:
        kind: ``done`` (every task visited, everybody down), ``failed``, ``aborted`` (by the operator).
        state: the last one.
        turns: of the loop.
        late_turns: that began later than one period after their time.
    """

    kind: Literal["done", "failed", "aborted"]
    state: State
    turns: int
    late_turns: int


def fly(
    settings: Settings,
    plan: Plan,
    *,
    vehicles: Mapping[str, Vehicle],
    poses: PoseSource,
    clock: Clock,
    planner: Planner,
    operator: Wishes,
    observer: Observer,
    virtual: bool,
    checks_valid_s: float = math.inf,
    limit_s: float = math.inf,
    linger_s: float = 1.0,
    guard: Guard | None = None,
) -> Outcome:
    """Flies the mission to its end. Vehicles and poses are connected; the caller closes them.

    Args:
        settings: of the mission.
        plan: checked by the caller; the supervisor arms for this plan only.
        vehicles: by id.
        poses: motion capture.
        clock: of the loop.
        planner: for replans.
        operator: wishes; arming and starting are wished here, since the checks have passed.
        observer: told of each turn and plan.
        virtual: the clock may jump over turns in which nothing can be decided.
        checks_valid_s: when the checks expire, on the clock.
        limit_s: give up at this time on the clock: everybody comes down.
        linger_s: keep looking this long after the end, so that the last commands are seen to work.
        guard: told in each turn who is under way, until everybody is down.

    Raises:
        DeployError: when an observer fails. Every vehicle has been told to stop before the exception leaves.
    """
    loop = _Loop(settings, plan, vehicles, poses, clock, planner, operator, observer, guard, virtual=virtual)
    wishes: list[OperatorInput] = [OperatorInput("checked", plan.digest, checks_valid_s), OperatorInput("arm")]
    try:
        ended_s = math.inf
        while clock.now() < ended_s + linger_s:
            loop.turn(tuple(wishes))
            wishes = []
            if loop.state.phase is MissionPhase.ARMED:
                wishes.append(OperatorInput("start"))
            if loop.now_s > limit_s and loop.state.phase in (MissionPhase.RUNNING, MissionPhase.HOLDING):
                wishes.append(OperatorInput("recover"))
            if loop.state.over:
                ended_s = min(ended_s, loop.now_s)
            loop.wait()
    except BaseException:
        loop.bring_down()
        raise
    finally:
        planner.close()
    return Outcome(outcome_of(loop.state), loop.state, loop.turns, loop.late_turns)


def outcome_of(state: State) -> Literal["done", "failed", "aborted"]:
    """How a mission that ended in ``state`` ended."""
    if state.phase is MissionPhase.ABORTED:
        return "aborted"
    lost = any(u.phase is UavPhase.LOST for u in state.uavs)
    return "done" if state.phase is MissionPhase.DONE and all(state.visited) and not lost else "failed"


class _Loop:
    def __init__(
        self,
        settings: Settings,
        plan: Plan,
        vehicles: Mapping[str, Vehicle],
        poses: PoseSource,
        clock: Clock,
        planner: Planner,
        operator: Wishes,
        observer: Observer,
        guard: Guard | None,
        *,
        virtual: bool,
    ) -> None:
        self.settings, self.vehicles, self.poses, self.clock = settings, vehicles, poses, clock
        self.planner, self.operator, self.observer, self.virtual = planner, operator, observer, virtual
        self.guard = guard
        self.state = supervisor.initial(settings, plan)
        self.gate = GateState()
        self.refusals: tuple[Refusal, ...] = ()
        self.turns = self.late_turns = 0
        self.now_s = clock.now()
        self.due_s = self.now_s
        self._by_body = {c.body: vehicles[c.id] for c in settings.vehicles}
        observer.plan(plan, self.now_s, 0.0, "first plan", settings.problem)

    def turn(self, wishes: Sequence[OperatorInput]) -> None:
        """One turn."""
        self.now_s = now_s = self.clock.now()
        poses = [p for p in self.poses.read() if _finite(p)]
        late_s = max(0.0, now_s - self.due_s)
        self.late_turns += late_s > PERIOD_S
        observation = Observation(
            now_s=now_s,
            poses=tuple(poses),
            vehicles=tuple(v.state() for v in self.vehicles.values()),
            operator=(*wishes, *self.operator.poll()),
            plan_reply=self.planner.poll(now_s),
            refusals=self.refusals,
            late_s=late_s,
        )
        before = self.state
        result = supervisor.step(self.settings, before, observation)
        verdict = judge(self.settings, self.gate, observation, result.commands)
        self.state, self.gate, self.refusals = result.state, verdict.state, verdict.refused
        self._feed(poses)
        if self.guard is not None:
            self.guard.tell(under_way(self.settings, self.state, observation.vehicles), now_s)
        sent = self._send(verdict.accepted)
        if result.request is not None:
            self.planner.submit(result.request, now_s)
        status = status_of(self.settings, self.state, now_s)
        tick = Tick(
            observation, result.commands, verdict.accepted, sent, verdict.refused, result.events, status, result.request
        )
        self.observer.tick(tick)
        if result.adopted is not None:
            self._tell_plan(result.adopted, observation.plan_reply, result.events)
        self.turns += 1

    def _send(self, commands: Sequence[Command]) -> tuple[Command, ...]:
        """Sends them all, emergency stops first: a driver that fails keeps nobody else from its command."""
        sent: dict[int, Command] = {}
        failure: Exception | None = None
        for k in sorted(range(len(commands)), key=lambda k: not isinstance(commands[k], StopMotors)):
            try:
                sent[k] = self.vehicles[commands[k].vehicle].send(commands[k])
            except Exception as error:  # raised again when everybody has been told
                failure = failure or error
        if failure is not None:
            raise failure
        return tuple(sent[k] for k in range(len(commands)))

    def _feed(self, poses: Sequence[Pose]) -> None:
        """Hands each vehicle its pose, when the supervisor trusts it: a jump or a swap must not steer anybody."""
        trusted = {
            config.body: unit.track.stamp_s
            for unit, config in zip(self.state.units, self.settings.vehicles, strict=True)
            if unit.track is not None
        }
        for pose in poses:
            if trusted.get(pose.body) == pose.stamp_s:
                self._by_body[pose.body].feed_pose(pose)

    def _tell_plan(self, adopted: Adopted, reply: PlanReply | None, events: Sequence[Event]) -> None:
        schedule = evaluate(
            adopted.problem, adopted.actions, exclude_uavs=adopted.exclude[0], exclude_ugvs=adopted.exclude[1]
        )
        made = (reply.method, reply.planning_s, reply.note) if reply is not None else ("search", None, None)
        method, took_s, note = made
        plan = Plan(adopted.actions, schedule, method, took_s, note=note)
        reason = next((e.text for e in events if e.kind == "plan_adopted"), "")
        self.observer.plan(plan, self.now_s, adopted.at_s, reason, adopted.problem)

    def wait(self) -> None:
        """Lets time pass until the next turn is due."""
        self.due_s = self.now_s + PERIOD_S
        if self.virtual:
            next_s = wake_s(self.settings, self.state, self.now_s)
            planned_s = self.planner.due_s()
            until_s = next_s if planned_s is None else min(next_s, planned_s)
            if self.refusals:
                until_s = self.now_s
            self.due_s = max(self.due_s, on_grid_s(until_s))
            self.clock.wait_until(self.due_s)
            self.due_s = self.clock.now()
        else:
            self.clock.wait_until(self.due_s)

    def bring_down(self) -> None:
        """The loop cannot go on: everybody who flies lands, everybody who drives stops; nothing is asked any more.

        Links must not be closed under who flies: in real time it stays, and goes on feeding poses, until everybody
        is down or a landing has had twice its time.
        """
        ordered = {u.order.command.vehicle: u.order.command for u in self.state.units if u.order is not None}
        halted = [c for c in ordered.values() if isinstance(c, StopMotors)]  # the failure may have kept it from them
        down = [
            Land(config.id, config.descent_mps)
            for uav, config in zip(self.state.uavs, self.settings.uavs, strict=True)
            if uav.phase in AIRBORNE and not isinstance(ordered.get(config.id), StopMotors)
        ]
        stop = [Hold(road.id) for road in self.settings.ugvs]
        commands: list[StopMotors | Land | Hold] = [*halted, *down, *stop]
        for command in commands:
            _try_send(self.vehicles[command.vehicle], command)
        if not self.virtual:
            self._stay(down, stop)

    def _stay(self, down: Sequence[Land], stop: Sequence[Hold]) -> None:
        slowest_mps = min((u.descent_mps for u in self.settings.uavs), default=1.0)
        begun_s = again_s = self.clock.now()
        limit_s = begun_s + 2.0 * self.settings.geofence.ceiling_m / slowest_mps + DOWN_EXTRA_S
        while (now_s := self.clock.now()) < limit_s:
            flying = [c for c in down if _flies(self.vehicles[c.vehicle])]
            # a landing takes a moment to show; a UAV may be airborne still, or not yet again
            moving: Sequence[Land | Hold] = flying if now_s > begun_s + DOWN_LEAST_S else [*down, *stop]
            if self.guard is not None:
                heights_m = under_way(self.settings, self.state, ())
                self.guard.tell({c.vehicle: heights_m.get(c.vehicle, 0.0) for c in moving}, now_s)
            if not moving:
                return
            if now_s - again_s > self.settings.monitors.command_confirm_s:
                again_s = now_s
                again: list[Land | Hold] = [*flying, *stop]
                for command in again:
                    _try_send(self.vehicles[command.vehicle], command)
            try:
                for pose in self.poses.read():
                    if pose.body in self._by_body and _finite(pose):
                        self._by_body[pose.body].feed_pose(pose)
            except DriverError:
                pass  # without poses the vehicles land by what they know
            self.clock.wait_until(now_s + PERIOD_S)


def _flies(vehicle: Vehicle) -> bool:
    try:
        state = vehicle.state()
    except DriverError:
        return False
    return state.airborne and state.link


def _try_send(vehicle: Vehicle, command: Command) -> None:
    try:
        vehicle.send(command)
    except DriverError:  # the next vehicle must still be told
        return


def _finite(pose: Pose) -> bool:
    return all(map(math.isfinite, (*pose.position_m, pose.yaw_rad, pose.stamp_s)))


def on_grid_s(time_s: float) -> float:
    """The first turn of a 50 Hz loop that is not before ``time_s``."""
    return math.ceil(time_s / PERIOD_S - 1e-6) * PERIOD_S


# --- status -----------------------------------------------------------------------------------------------------------


def status_of(settings: Settings, state: State, now_s: float) -> Status:
    """What the operator sees of ``state``."""
    turn = Turn(
        settings, Observation(now_s), state, list(state.uavs), list(state.ugvs), state.plan, list(state.visited)
    )
    rows = [_uav_row(turn, i) for i in range(len(turn.uavs))] + [_ugv_row(turn, j) for j in range(len(turn.ugvs))]
    return Status(
        now_s=now_s,
        mission_s=turn.mission_s if state.start_s is not None else 0.0,
        mission_state=state.phase.value,
        tasks_visited=state.visited,
        plan_number=state.plan.number,
        predicted_makespan_s=state.plan.predicted_s,
        vehicles=tuple(rows),
    )


def _uav_row(turn: Turn, index: int) -> VehicleStatus:
    uav, config, model = turn.uavs[index], turn.settings.uavs[index], turn.settings.problem.uavs[index]
    k = uav.action if uav.action is not None else turn.next_of_uav(index)
    order = uav.order.command if uav.order is not None else None
    goal = order.position_m if isinstance(order, GoTo) and uav.phase in (UavPhase.FLYING, UavPhase.WAITING) else None
    return VehicleStatus(
        vehicle=config.id,
        kind="uav",
        phase=uav.phase.value,
        position_m=uav.track.position_m if uav.track is not None else None,
        yaw_rad=uav.track.yaw_rad if uav.track is not None else 0.0,
        energy_j=uav.energy_j,
        energy_fraction=uav.energy_j / model.capacity_j,
        doing=_uav_doing(turn, index, k),
        goal_m=goal,
        slack_s=_slack(turn, k),
    )


def _uav_doing(turn: Turn, index: int, k: int | None) -> str:
    uav = turn.uavs[index]
    if uav.phase in (UavPhase.DOWN, UavPhase.LOST):
        return ""
    if uav.held:
        return "holds"
    if uav.diverting:
        return "lands at the nearest site"
    if k is None:
        return "goes home" if uav.phase in AIRBORNE else ""
    action = turn.plan.actions[k]
    if isinstance(action, Visit):
        return f"task {action.task}"
    assert isinstance(action, Recharge)
    return f"recharge at {turn.settings.ugvs[action.ugv].id}"


def _ugv_row(turn: Turn, index: int) -> VehicleStatus:
    ugv, config, model = turn.ugvs[index], turn.settings.ugvs[index], turn.settings.problem.ugvs[index]
    doing, goal = "", None
    if ugv.phase is not UgvPhase.PARKED and ugv.target is not None:
        depot = ugv.target == turn.settings.problem.depot_index
        doing = "to the depot" if depot else f"to path point {ugv.target}"
        goal = (*turn.park_m(index, ugv.target), 0.0)
    guests = [turn.settings.uavs[u.index].id for u in turn.guests(index)]
    if guests:
        doing = f"serves {', '.join(guests)}"
    if ugv.stuck:
        doing = "stuck"
    return VehicleStatus(
        vehicle=config.id,
        kind="ugv",
        phase=ugv.phase.value,
        position_m=ugv.track.position_m if ugv.track is not None else None,
        yaw_rad=ugv.track.yaw_rad if ugv.track is not None else 0.0,
        energy_j=ugv.energy_j,
        energy_fraction=ugv.energy_j / model.capacity_j,
        doing=doing,
        goal_m=goal,
        slack_s=_slack(turn, turn.next_of_ugv(index)),
    )


def _slack(turn: Turn, k: int | None) -> float | None:
    """Slack of a plan action by the schedule at adoption, less the delay since; None without limit."""
    if k is None or not math.isfinite(turn.plan.slack_s[k]):
        return None
    return turn.plan.slack_s[k]
