"""A mission small enough to compute by hand, for the tests of the checks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deploy.check_limits import CERTAIN, CheckLimits
from deploy.check_report import CheckReport
from deploy.checks import check_plan
from deploy.frames import Frame
from deploy.settings import Geofence, Monitors, Replanning, Separation, Settings, UavSettings, UgvSettings
from planner.plan import Action, Move, Plan, Recharge, Visit
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate

SURE = CheckLimits(uncertainty=CERTAIN, energy_margin_warn=0.1, energy_margin_fail=0.05)


class StraightRoads:
    """A road straight from anywhere to any site."""

    def __init__(self, sites: NDArray[np.float64]) -> None:
        self.sites = sites
        self.distance_m = np.linalg.norm(sites[:, None] - sites[None], axis=2)

    def distances_from(self, point: tuple[float, float]) -> NDArray[np.float64]:
        return np.asarray(np.linalg.norm(self.sites - np.array(point), axis=1))

    def route(self, start: tuple[float, float], site: int) -> NDArray[np.float64]:
        return np.array([start, self.sites[site]])

    def offset_m(self, point: tuple[float, float]) -> float:
        return 0.0


def make_settings(**changes: object) -> Settings:
    """Two UAVs, two UGVs; depot in the middle, path points 3 km east and west, tasks 2 km east and west."""
    sites = np.array([[3000.0, 0.0], [-3000.0, 0.0], [0.0, 0.0]])
    roads = StraightRoads(sites)
    problem = Problem(
        depot=(0.0, 0.0),
        tasks=np.array([[2000.0, 0.0], [-2000.0, 0.0]]),
        path_points=sites[:-1],
        road_distance_m=roads.distance_m,
        uavs=tuple(
            Uav(
                id=f"uav{i}",
                position=(0.0, 0.0),
                energy_j=100e3,
                capacity_j=100e3,
                reserve_j=10e3,
                cruise_w=200.0,
                hover_w=250.0,
                waiting="hover",
            )
            for i in range(2)
        ),
        ugvs=tuple(Ugv(id=f"ugv{i}", speed_mps=15.0) for i in range(2)),
    )
    values: dict[str, object] = {
        "frame": Frame(),
        "geofence": Geofence(((-4000.0, -500.0), (4000.0, -500.0), (4000.0, 500.0), (-4000.0, 500.0)), 100.0, 10.0),
        "separation": Separation(horizontal_m=5.0, vertical_m=6.0, buffer_m=2.0, ugv_m=3.0),
        "monitors": Monitors(),
        "replanning": Replanning(),
        "uavs": tuple(
            UavSettings(
                f"uav{i}", f"body{i}", 60.0 + 10 * i, 10.0, 15.0, 2.0, 3.0, 2.0, (0.0, 10.0 + 10 * i), "measured"
            )
            for i in range(2)
        ),
        "ugvs": tuple(
            UgvSettings(
                f"ugv{i}",
                f"ugv{i}",
                15.0,
                18.0,
                1.0,
                0.0,
                (0.0, 4.0 * i - 2.0),
                0.5,
                ((0.0, 0.0), (1.0, 0.0)),
                "measured",
            )
            for i in range(2)
        ),
        "problem": problem,
        "roads": roads,
    }
    return Settings(**(values | changes))  # type: ignore[arg-type]


# one UAV and one UGV to each side: out, task, recharge
EAST_WEST: tuple[Action, ...] = (
    Move(0, 0), Move(1, 1), Visit(0, 0), Visit(1, 1), Recharge(0, 0), Recharge(1, 1),
)  # fmt: skip


def plan_of(settings: Settings, actions: tuple[Action, ...] = EAST_WEST) -> Plan:
    return Plan(actions, evaluate(settings.problem, actions), "test")


def check(settings: Settings, actions: tuple[Action, ...] = EAST_WEST, limits: CheckLimits = SURE) -> CheckReport:
    return check_plan(settings, plan_of(settings, actions), limits, now_s=100.0)


def with_uav(settings: Settings, index: int, **changes: object) -> Settings:
    uavs = list(settings.uavs)
    uavs[index] = replace(uavs[index], **changes)  # type: ignore[arg-type]
    return replace(settings, uavs=tuple(uavs))


def with_problem(settings: Settings, **changes: object) -> Settings:
    return replace(settings, problem=replace(settings.problem, **changes))  # type: ignore[arg-type]
