"""One turn of the supervisor: the working copy that its parts share, and the orders that it repeats until confirmed.

A turn lives only inside ``supervisor.step``; what goes in and comes out is frozen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeVar

from deploy.events import Action, Event, EventKind
from deploy.failsafe import severity_of
from deploy.flightpath import TimedPath, conflict, resting
from deploy.observation import Observation, PlanRequest
from deploy.settings import Settings
from deploy.state import AIRBORNE, Order, Pending, PlanState, State, UavState, UgvState
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    StopMotors,
    TakeOff,
    Vec2,
    Vec3,
)
from planner.plan import Action as PlanAction
from planner.plan import Move, Recharge, Visit
from planner.problem import Problem

Unit = TypeVar("Unit", UavState, UgvState)
PASSING_S = 4.0  # a drive that passes a parked UGV within this time has to wait for it
RESTING = 0.2  # of cruise speed: slower counts as standing still


@dataclass(frozen=True, slots=True)
class Adopted:
    """A plan that has just come into force.

    Attributes:
        problem: that its actions refer to.
        actions: joint actions.
        exclude: indices of UAVs and of UGVs that take no part.
        at_s: mission time of the problem's time 0.
    """

    problem: Problem
    actions: tuple[PlanAction, ...]
    exclude: tuple[tuple[int, ...], tuple[int, ...]]
    at_s: float


@dataclass(slots=True)
class Turn:
    """The working copy; names as in ``State``."""

    settings: Settings
    observation: Observation
    state: State
    uavs: list[UavState]
    ugvs: list[UgvState]
    plan: PlanState
    visited: list[bool]
    commands: list[Command] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    request: PlanRequest | None = None
    adopted: Adopted | None = None
    pending: Pending | None = None

    @property
    def now_s(self) -> float:
        """The loop's clock."""
        return self.observation.now_s

    @property
    def mission_s(self) -> float:
        """Mission time since start."""
        start_s = self.state.start_s
        return 0.0 if start_s is None else (self.now_s - start_s) / self.settings.frame.time_scale

    def tell(self, kind: EventKind, text: str, vehicle: str | None = None, action: Action = Action.NOTE) -> None:
        """Records an event."""
        self.events.append(Event(self.now_s, kind, severity_of(kind), vehicle, action, text))

    def want_replan(self, reason: str, *, urgent: bool) -> None:
        """Asks for a replan at the end of this turn."""
        urgent = urgent or self.state.replan_urgent
        self.state = replace(self.state, replan_reason=self.state.replan_reason or reason, replan_urgent=urgent)

    # --- where things are -------------------------------------------------------------------------------------------

    def site_m(self, site: int) -> Vec2:
        """A site in the arena."""
        return self.settings.site_m(site)

    def pad_m(self, uav: int, site: int) -> Vec2:
        """The UAV's own landing place at a site; it waits above it too."""
        return self.settings.pad_m(uav, site)

    def park_m(self, ugv: int, site: int) -> Vec2:
        """The UGV's own stopping place at a site."""
        return self.settings.park_m(ugv, site)

    def dock_m(self, ugv: int, dock: int) -> Vec2:
        """Where a dock of a UGV is now, by its trusted pose."""
        track = self.ugvs[ugv].track
        offsets = self.settings.ugvs[ugv].dock_offsets_m
        assert track is not None  # a UGV that is parked at a rendezvous has been seen
        dx, dy = offsets[dock % len(offsets)]
        c, s = math.cos(track.yaw_rad), math.sin(track.yaw_rad)
        return (track.position_m[0] + c * dx - s * dy, track.position_m[1] + s * dx + c * dy)

    def nearest_site(self, position_m: Vec3) -> tuple[int, float]:
        """The nearest site and its distance, in arena m."""
        distances = [math.dist(position_m[:2], site_m) for site_m in self.settings.sites_m]
        best = min(range(len(distances)), key=distances.__getitem__)
        return best, distances[best]

    def fresh(self, unit: UavState | UgvState) -> bool:
        """Whether the unit's trusted pose may be steered by."""
        return unit.track is not None and self.now_s - unit.track.stamp_s <= self.settings.monitors.pose_stale_s

    # --- the plan ---------------------------------------------------------------------------------------------------

    def next_of_uav(self, uav: int) -> int | None:
        """Index of the UAV's next plan action, the one in progress at a dock excepted."""
        unit = self.uavs[uav]
        if unit.out:
            return None
        for k, action in enumerate(self.plan.actions):
            if (
                not self.plan.done[k]
                and k != unit.action
                and isinstance(action, Visit | Recharge)
                and action.uav == uav
            ):
                return k
        return None

    def next_of_ugv(self, ugv: int) -> int | None:
        """Index of the UGV's next move, when everything listed before it at this UGV is done; else None."""
        for k, action in enumerate(self.plan.actions):
            if self.plan.done[k]:
                continue
            if isinstance(action, Recharge) and action.ugv == ugv:
                return None
            if isinstance(action, Move) and action.ugv == ugv:
                return k
        return None

    def mark_done(self, k: int) -> None:
        """Marks a plan action as done."""
        done = list(self.plan.done)
        done[k] = True
        self.plan = replace(self.plan, done=tuple(done))

    def guests(self, ugv: int) -> Iterator[UavState]:
        """UAVs at the UGV's docks or about to be there."""
        return (u for u in self.uavs if u.docked is not None and u.docked[0] == ugv)

    def in_its_place(self, ugv: UgvState) -> bool:
        """Whether a parked UGV is seen where it stopped: nobody docks at or drives from where a false pose puts it."""
        if ugv.site is None or ugv.track is None or not self.fresh(ugv):
            return False
        aside_m = math.dist(ugv.track.position_m[:2], self.park_m(ugv.index, ugv.site))
        return aside_m <= self.settings.monitors.ugv_off_road_m

    def rendezvous_ready(self, k: int) -> bool:
        """Whether recharge ``k`` may dock now: UGV parked there, nobody before it, dock and approach free."""
        action = self.plan.actions[k]
        assert isinstance(action, Recharge)
        ugv = self.ugvs[action.ugv]
        if ugv.site != self.plan.sites[k] or ugv.target is not None or ugv.out or not self.in_its_place(ugv):
            return False
        for j in range(k):
            earlier = self.plan.actions[j]
            if self.plan.done[j]:
                continue
            if isinstance(earlier, Move) and earlier.ugv == action.ugv:
                return False
            if isinstance(earlier, Recharge) and earlier.ugv == action.ugv and self.plan.docks[j] == self.plan.docks[k]:
                return False
        for guest in self.guests(action.ugv):
            if guest.index != action.uav and (
                guest.phase in AIRBORNE or guest.docked == (action.ugv, self.plan.docks[k])
            ):
                return False
        return True

    # --- room in the air and on the road ----------------------------------------------------------------------------

    def way_of(self, unit: UavState | UgvState) -> TimedPath | None:
        """The unit's committed path from where it is now: one that is late is not yet where its path says."""
        if isinstance(unit, UgvState) and unit.stuck and unit.path is not None and unit.track is not None:
            return resting(unit.track.position_m, self.now_s)
        return None if unit.path is None else unit.path.later(self.lateness_s(unit))

    def lateness_s(self, unit: UavState | UgvState) -> float:
        """How far the unit is behind the time of its committed path."""
        path, order, track = unit.path, unit.order, unit.track
        if path is None or track is None or order is None or not isinstance(order.command, GoTo | Drive):
            return 0.0
        if isinstance(unit, UgvState):
            left_s = unit.left_m / order.command.speed_mps
        else:
            first, end_m = path.knots[0], path.end_m
            length_m = math.dist(first[1:], end_m)
            share = math.dist(track.position_m, end_m) / length_m if length_m > 0 else 0.0
            left_s = min(1.0, share) * (path.rests_from_s - first[0])
        return max(0.0, self.now_s + left_s - path.rests_from_s)

    def uav_in_the_way(self, uav: int, path: TimedPath) -> str | None:
        """The flying UAV whose committed path conflicts with ``path``, or None.

        One that hovers is where it is seen as well, and half the buffer below or above it is enough: layers may lie
        just as far apart as the whole of it asks for, and then a centimetre that either errs would bar the way past it,
        for ever if it waits in its turn. What is left is what the monitors stop flights at.
        """
        s = self.settings.separation
        for other in self.uavs:
            theirs = self.way_of(other)
            if other.index == uav or theirs is None:
                continue
            ways, vertical_m = [theirs], s.vertical_m + s.buffer_m
            if other.track is not None and theirs.rests_from_s <= self.now_s:
                ways, vertical_m = [theirs, resting(other.track.position_m, self.now_s)], s.near_m[1]
            if any(conflict(path, way, self.now_s, s.horizontal_m + s.buffer_m, vertical_m) for way in ways):
                return self.settings.uavs[other.index].id
        return None

    def ugv_in_the_way(self, ugv: int, path: TimedPath) -> str | None:
        """The UGV that the drive ``path`` would come too near to, or None.

        Those under way are judged by their whole paths, those stopped between sites by their place. One parked at a
        site counts only where the drive passes it at once: it may have left when a longer drive comes there, and the
        monitors stop the drive if it has not.
        """
        config, least_m = self.settings.ugvs[ugv], self.settings.separation.ugv_m
        soon_s = self.now_s + PASSING_S + 2 * config.speed_mps / config.accel_mps2
        for other in self.ugvs:
            if other.index == ugv or other.track is None:
                continue
            theirs = self.way_of(other) or resting(other.track.position_m, self.now_s)
            mine = path.until(soon_s) if other.site is not None and other.path is None else path
            if conflict(mine, theirs, self.now_s, least_m, math.inf):
                return self.settings.ugvs[other.index].id
        return None

    # --- orders -----------------------------------------------------------------------------------------------------

    def order(self, unit: Unit, command: Command) -> Unit:
        """Puts the unit under ``command``: sends it now, and again while its effect is not seen."""
        m = self.settings.monitors
        order = unit.order
        if order is None or order.command != command:
            self.commands.append(command)
            return replace(unit, order=Order(command, self.now_s, self.now_s))
        if order.confirmed or self.now_s - order.sent_s < m.command_confirm_s:
            return unit
        if order.attempts >= m.command_attempts and not isinstance(command, Land | Hold | StopMotors | Drive | Dock):
            return unit
        self.commands.append(command)
        return replace(unit, order=replace(order, sent_s=self.now_s, attempts=order.attempts + 1))

    def confirm(self, unit: Unit, cruise_mps: float) -> Unit:
        """Looks for the effect of the unit's order."""
        order = unit.order
        if order is None:
            return unit
        done, left_m = self._effect(unit, order.command, cruise_mps)
        if left_m is None:  # an effect that is there or not
            return unit if done == order.confirmed else replace(unit, order=replace(order, confirmed=done))
        if done:
            return unit if order.confirmed else replace(unit, order=replace(order, confirmed=True), refused="")
        step_m = self.settings.monitors.arrival_m / 2
        if order.mark_m is None:
            return replace(unit, order=replace(order, mark_m=left_m))
        if left_m <= order.mark_m - step_m:
            moved = replace(order, mark_m=left_m, confirmed=True, sent_s=self.now_s, attempts=1)
            return replace(unit, order=moved, refused="")
        if order.confirmed and self.now_s - order.sent_s >= 2 * self.settings.monitors.command_confirm_s:
            return replace(unit, order=replace(order, confirmed=False, mark_m=left_m))
        return unit

    def _effect(self, unit: UavState | UgvState, command: Command, cruise_mps: float) -> tuple[bool, float | None]:
        """Whether the effect is complete, and for motions how much is left, in m (None: it is there or it is not)."""
        telemetry, track = unit.telemetry, unit.track
        if telemetry is None or track is None:
            return False, None
        match command:
            case Arm():
                return telemetry.armed, None
            case Disarm():
                return not telemetry.armed, None
            case StopMotors():
                return telemetry.locked and not telemetry.airborne, None
            case Hold():
                return self.fresh(unit) and track.speed_mps <= RESTING * cruise_mps, None
            case Land() | Dock():
                return not telemetry.airborne, track.position_m[2]
            case TakeOff(altitude_m=altitude_m):
                left_m = abs(altitude_m - track.position_m[2])
                return left_m <= self.settings.monitors.arrival_m, left_m
            case GoTo(position_m=goal_m):
                left_m = math.dist(goal_m, track.position_m)
                return left_m <= self.settings.monitors.arrival_m, left_m
            case _:
                return math.dist(command.path_m[-1], track.position_m[:2]) <= self.settings.monitors.arrival_m, left_on(
                    unit
                )


def left_on(unit: UavState | UgvState) -> float:
    """Way left on a UGV's route, in m."""
    assert isinstance(unit, UgvState)  # only UGVs are ordered to drive
    return unit.left_m
