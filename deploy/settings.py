"""Everything the pure core needs to know about a mission: frozen, in the arena frame unless a name says otherwise.

The classes with defaults are, key by key, sections of ``mission.yaml``; their defaults are written here only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from deploy.frames import Frame, Vec2
from planner.problem import Problem
from planner.roads import Roads

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Fraction = Annotated[float, Ge(0), Le(1)]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Separation:
    """Least distances between vehicles, in arena m."""

    horizontal_m: Positive = 3.0
    """Radius of the cylinder around a flying UAV that no other flying UAV may enter."""
    vertical_m: Positive = 4.0
    """Half height of that cylinder; downwash reaches furthest below."""
    buffer_m: NotNegative = 1.0
    """Added to both when flights are planned, for tracking errors and timing."""
    ugv_m: Positive = 2.0
    """Least distance between the centres of two UGVs."""

    @property
    def near_m(self) -> tuple[float, float]:
        """Horizontal and vertical distance, half the buffer included, below which flights are stopped."""
        return self.horizontal_m + self.buffer_m / 2, self.vertical_m + self.buffer_m / 2


@dataclass(frozen=True, slots=True)
class Monitors:
    """Thresholds of the monitors; times in arena s, lengths in arena m."""

    pose_stale_s: Positive = 0.5
    """A pose older than this is stale: no motion command is sent, a flying UAV holds."""
    pose_lost_s: Positive = 3.0
    """A pose older than this is lost: a flying UAV lands where it is."""
    pose_frozen_s: Positive = 0.5
    """A pose that repeats to the last bit for this long is frozen (real poses carry noise)."""
    pose_jump_m: Positive = 2.0
    """A pose further than this from where the vehicle could be is a jump."""
    telemetry_stale_s: Positive = 1.5
    """Telemetry older than this is stale."""
    link_lost_s: Positive = 5.0
    """Telemetry older than this means that the link is lost."""
    tracking_error_m: Positive = 5.0
    """Distance from the commanded straight path at which a UAV is off its path."""
    tracking_error_s: Positive = 1.0
    """How long before it counts."""
    ugv_off_road_m: Positive = 10.0
    """Distance from the commanded drive path at which a UGV is off the road."""
    ugv_stuck_s: Positive = 60.0
    """A driving UGV without progress for this long is stuck."""
    ugv_stuck_m: Positive = 2.0
    """Progress that counts."""
    dock_timeout_s: Positive = 90.0
    """A docking that takes longer has missed."""
    dock_attempts: Annotated[int, Ge(1)] = 3
    """Docking attempts at one rendezvous."""
    charge_confirm_s: Positive = 10.0
    """Charging must be reported this long after touching the dock."""
    command_confirm_s: Positive = 2.0
    """A command without visible effect is repeated after this time."""
    command_attempts: Annotated[int, Ge(1)] = 5
    """Attempts before a command has failed."""
    planner_late_s: Positive = 10.0
    """A replan that takes longer is late."""
    loop_late_s: Positive = 0.2
    """A loop that runs later than this is overloaded."""
    energy_margin: Fraction = 0.08
    """Share of capacity left after landing at the nearest site; a UAV that would have less flies there at once. Below
    the planner's reserve, so that it acts only when the plan has gone wrong."""
    arrival_m: Positive = 1.0
    """A place counts as reached at this distance."""


@dataclass(frozen=True, slots=True)
class Replanning:
    """When to replan; times in mission s, ratios of the makespan."""

    loss_ratio: Positive = 0.03
    """A predicted loss of makespan over this share asks for a replan..."""
    loss_s: Positive = 60.0
    """... as does one over this time, whichever is reached first."""
    adopt_ratio: NotNegative = 0.02
    """A replan is adopted when it is better by this share (always when the old plan is infeasible)."""
    interval_s: NotNegative = 30.0
    """Least time between replans that are not urgent."""
    margin: Fraction = 0.04
    """Share of capacity kept above reserve when planning, so that small delays in flight leave the plan feasible; given
    up where no plan exists otherwise."""
    tolerance: Fraction = 0.02
    """Share of capacity by which energy may be predicted to fall below reserve before the plan in force counts as
    infeasible: a plan that was just feasible must not be thrown away for a breath of wind."""
    review_s: Positive = 1.0
    """Arena time between reviews of the schedule."""


@dataclass(frozen=True, slots=True)
class Geofence:
    """Where vehicles may be.

    Attributes:
        polygon_m: vertices (x, y) of a simple polygon.
        ceiling_m: highest altitude.
        soft_margin_m: this close to the fence or the ceiling is a warning and turns the vehicle back.
    """

    polygon_m: tuple[Vec2, ...]
    ceiling_m: float
    soft_margin_m: float


@dataclass(frozen=True, slots=True)
class UavSettings:
    """One UAV.

    Attributes:
        id: vehicle id; its place in ``Settings.uavs`` is its index in the problem and its priority (0 goes first).
        body: its name in motion capture.
        altitude_m: its cruise layer.
        speed_mps, max_speed_mps: cruise speed; what the gate lets pass.
        accel_mps2: of rest-to-rest flights.
        climb_mps, descent_mps: vertical speeds.
        pad_offset_m: its own landing place relative to any site (depot or path point).
        energy: ``measured`` by its battery or ``virtual`` by the planner's model.
    """

    id: str
    body: str
    altitude_m: float
    speed_mps: float
    max_speed_mps: float
    accel_mps2: float
    climb_mps: float
    descent_mps: float
    pad_offset_m: Vec2
    energy: Literal["virtual", "measured"]


@dataclass(frozen=True, slots=True)
class UgvSettings:
    """One UGV.

    Attributes:
        id, body: as for UAVs; its place in ``Settings.ugvs`` is its index in the problem and its priority.
        speed_mps, max_speed_mps: driving speed; what the gate lets pass.
        accel_mps2: of starts and stops.
        lane_offset_m: how far right of the road's centre line it drives (0: on it).
        park_offset_m: its own stopping place relative to any site.
        pad_height_m: height of the charging docks.
        dock_offsets_m: each dock relative to the UGV's body frame (x forward, y left).
        energy: as for UAVs.
    """

    id: str
    body: str
    speed_mps: float
    max_speed_mps: float
    accel_mps2: float
    lane_offset_m: float
    park_offset_m: Vec2
    pad_height_m: float
    dock_offsets_m: tuple[Vec2, ...]
    energy: Literal["virtual", "measured"]


def beside(offset_m: Vec2, away_m: float, direction_rad: float) -> Vec2:
    """An offset from a site after its places have been pushed ``away_m`` off and turned.

    Args:
        offset_m: where the place would be at the site itself; x runs along the row of places.
        away_m: how far all places are pushed off the road.
        direction_rad: into which direction, counter-clockwise from x.
    """
    x, y = offset_m[0], offset_m[1] + away_m
    c, s = math.cos(direction_rad - math.pi / 2), math.sin(direction_rad - math.pi / 2)
    return (c * x - s * y, s * x + c * y)


@dataclass(frozen=True)
class Settings:
    """All of it.

    Attributes:
        problem: the mission's problem at the start, world frame; vehicle order is the order of ``uavs`` and ``ugvs``.
        roads: world frame.
        beside: per site, how far (m) and in which direction (rad) its places lie beside the road; empty: at the site.
        failsafe: overrides of the failsafe table, "event" or "event/situation" -> action.
    """

    frame: Frame
    geofence: Geofence
    separation: Separation
    monitors: Monitors
    replanning: Replanning
    uavs: tuple[UavSettings, ...]
    ugvs: tuple[UgvSettings, ...]
    problem: Problem
    roads: Roads
    failsafe: dict[str, str] = field(default_factory=dict)
    beside: tuple[tuple[float, float], ...] = ()

    def site_m(self, site: int) -> Vec2:
        """A site in the arena."""
        return self.sites_m[site]

    @cached_property
    def sites_m(self) -> tuple[Vec2, ...]:
        """Every site in the arena: path points, then the depot."""
        return tuple(self.frame.to_arena((float(x), float(y))) for x, y in self.problem.sites)

    def pad_m(self, uav: int, site: int) -> Vec2:
        """A UAV's own landing place at a site; it waits above it too."""
        return self._place_m(self.uavs[uav].pad_offset_m, site)

    def park_m(self, ugv: int, site: int) -> Vec2:
        """A UGV's own stopping place at a site."""
        return self._place_m(self.ugvs[ugv].park_offset_m, site)

    def _place_m(self, offset_m: Vec2, site: int) -> Vec2:
        x, y = self.site_m(site)
        dx, dy = beside(offset_m, *self.beside[site]) if self.beside else offset_m
        return (x + dx, y + dy)

    @property
    def vehicles(self) -> tuple[UavSettings | UgvSettings, ...]:
        """UAVs, then UGVs."""
        return (*self.uavs, *self.ugvs)
