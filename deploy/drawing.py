"""What the scene in the recording and the pictures in the report have in common: map, colours, planned paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from planner.plan import Action, Move, Plan, Recharge, Recovery, Visit
from planner.problem import Problem
from planner.roads import RoadError, Roads

Array = NDArray[np.float64]

# From Okabe and Ito's and Tol's palettes, which people with any colour vision tell apart; none near charging's yellow
UAV_COLOURS = ("#0072B2", "#D55E00", "#AA4499", "#56606B", "#3A9AD9", "#882255")
UGV_COLOURS = ("#009E73", "#7A5230", "#5A5A8C", "#8A9A1F", "#44AA99", "#A0522D")
POLYGON_COLOURS = {"water": "#CFE3F2", "building": "#DDD8D2", "forest": "#DCEAD3"}
OTHER_POLYGON = "#E8E8E8"
ROAD_COLOUR = "#B9B4AC"


@dataclass(frozen=True)
class MapDrawing:
    """The map as it is drawn, world frame, m.

    Attributes:
        extent: (x0, x1, y0, y1) of the picture.
        lines: road centre lines, each (n, 2).
        polygons: ``water``, ``building``, ``forest`` or another kind -> outer rings, each (n, 2).
        image: occupancy image, (h, w) grey or (h, w, 3) RGB uint8, first row at the top (largest y); None where the
            map is no image.
        image_extent: (x0, x1, y0, y1) that ``image`` covers; None for ``extent``.
    """

    extent: tuple[float, float, float, float]
    lines: tuple[Array, ...] = ()
    polygons: Mapping[str, tuple[Array, ...]] = field(default_factory=dict)
    image: NDArray[np.uint8] | None = None
    image_extent: tuple[float, float, float, float] | None = None


@dataclass(frozen=True)
class PlannedPath:
    """Where one vehicle is to go: ``points_m`` (n, 2), world frame, m; empty where it stays."""

    vehicle: str
    kind: str
    points_m: Array


@dataclass(frozen=True)
class PlannedRecharge:
    """Where ``uav`` is to be recharged by ``ugv``, world frame, m."""

    uav: str
    ugv: str
    position_m: tuple[float, float]


def vehicle_colours(problem: Problem) -> dict[str, str]:
    """A colour for each vehicle, by its place in the team; they repeat in large teams."""
    colours = {u.id: UAV_COLOURS[i % len(UAV_COLOURS)] for i, u in enumerate(problem.uavs)}
    return colours | {g.id: UGV_COLOURS[i % len(UGV_COLOURS)] for i, g in enumerate(problem.ugvs)}


def planned_paths(
    problem: Problem, plan: Plan, roads: Roads | None
) -> tuple[tuple[PlannedPath, ...], tuple[PlannedRecharge, ...]]:
    """The paths of every vehicle in ``plan`` and its recharges; straight lines where no road is known."""
    return follow(problem, plan.actions, plan.schedule.recovery, roads)


def follow(
    problem: Problem, actions: Sequence[Action], recovery: Sequence[Recovery], roads: Roads | None
) -> tuple[tuple[PlannedPath, ...], tuple[PlannedRecharge, ...]]:
    """As ``planned_paths``, from the plan's actions and its recovery."""
    sites, depot = problem.sites, problem.depot_index
    flights: list[list[Array]] = [[np.array(u.position, dtype=np.float64)] for u in problem.uavs]
    place: list[Array] = []
    for g in problem.ugvs:
        if g.position is not None:
            place.append(np.array(g.position, dtype=np.float64))
        else:
            place.append(sites[depot if g.path_point is None else g.path_point])
    drives: list[list[Array]] = [[start[None, :]] for start in place]
    recharges: list[PlannedRecharge] = []
    for action in actions:
        match action:
            case Visit(uav, task):
                flights[uav].append(problem.tasks[task])
            case Move(ugv, point):
                site = depot if point is None else point
                drives[ugv].append(_route(roads, place[ugv], site, sites[site]))
                place[ugv] = sites[site]
            case Recharge(uav, ugv):
                flights[uav].append(place[ugv])
                x, y = place[ugv]
                recharges.append(PlannedRecharge(problem.uavs[uav].id, problem.ugvs[ugv].id, (float(x), float(y))))
    for last in recovery:
        flights[last.uav].append(sites[depot if last.site is None else last.site])
    paths = [PlannedPath(u.id, "uav", _array(np.array(f))) for u, f in zip(problem.uavs, flights, strict=True)]
    paths += [PlannedPath(g.id, "ugv", _array(np.vstack(d))) for g, d in zip(problem.ugvs, drives, strict=True)]
    return tuple(paths), tuple(recharges)


def _array(points: Array) -> Array:
    return points if len(points) > 1 else np.zeros((0, 2))


def _route(roads: Roads | None, start: Array, site: int, end: Array) -> Array:
    if roads is not None:
        try:
            return roads.route((float(start[0]), float(start[1])), site)
        except RoadError:
            pass  # a picture of an infeasible plan is still wanted
    return np.vstack([start, end])
