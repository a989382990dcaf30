"""Training problems of all sorts: a data set's instance with another team and other vehicles.

The paper's vehicles are all alike: they land to wait, keep no reserve, work without delay at tasks and dock in no time.
Missions are not like that. Most ranges are shares of the time that a full UAV flies, so that a laboratory and a county
are the same to the network; they hold the missions in ``mission_configs``. Some problems have no feasible plan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planner.problem import Problem, Uav, Ugv

TEAMS = ((1, 1), (2, 1), (2, 2), (3, 1), (3, 2), (4, 2), (4, 3), (6, 3))
ALIKE = 0.7  # share of problems whose UAVs are alike, and whose UGVs are


@dataclass(frozen=True, slots=True)
class Range:
    """A uniform distribution, or with probability ``plain`` a value that is usual."""

    low: float
    high: float
    usual: float
    plain: float = 0.3

    def draw(self, rng: np.random.Generator) -> float:
        """One value."""
        x, value = rng.uniform(), rng.uniform(self.low, self.high)
        return float(self.usual if x < self.plain else value)


CAPACITY = Range(0.75, 1.4, 1.0)  # of the data set's UAV
SPEED = Range(0.8, 1.25, 1.0)  # likewise
RESERVE = Range(0.0, 0.3, 0.0)  # of the capacity
FULL = Range(0.8, 1.0, 1.0)  # energy at the start, of the capacity
HOVER = Range(0.9, 1.3, 1.16)  # power when hovering, of that in cruise
SERVICE = Range(0.0, 0.04, 0.0)  # from here on: of the time that a full UAV flies
START = Range(0.0, 0.1, 0.0)  # until the first UAV is ready
STAGGER = Range(0.0, 0.06, 0.0)  # between two UAVs' starts
CHARGE = Range(0.03, 0.7, 0.2)  # of a full recharge
DOCK = Range(0.0, 0.1, 0.0)
UNDOCK = Range(0.0, 0.07, 0.0)
ENDURANCE = Range(4.0, 30.0, 10.0)  # of a UGV on the road
DRIVE = Range(0.2, 0.7, 0.45)  # a UGV's speed, of a UAV's
DRIVE_W = Range(1.5, 15.0, 12.3)  # its power on the road, of a UAV's in cruise
IDLE_W = Range(0.0, 0.15, 0.0)  # its power at rest, likewise
HOVERS, BY_POWER, SINGLE_DOCK, FEWER_TASKS = 0.6, 0.4, 0.5, 0.3  # probabilities


def varied(problem: Problem, seed: int) -> Problem:
    """``problem`` with a random team of other vehicles, some tasks left out; everybody starts at the depot.

    Tasks that one of the UAVs cannot reach from any site go as well.
    """
    rng = np.random.default_rng([seed, int(problem.digest[:8], 16)])
    n_uavs, n_ugvs = TEAMS[rng.integers(len(TEAMS))]
    waiting = rng.uniform() < HOVERS
    first_uav = _uav(problem, rng, waiting)
    alike = rng.uniform() < ALIKE
    start_s, stagger_s = START.draw(rng) * _flight_s(first_uav), STAGGER.draw(rng) * _flight_s(first_uav)
    uavs = tuple(
        replace(first_uav if alike else _uav(problem, rng, waiting), id=f"uav{i}", ready_s=start_s + i * stagger_s)
        for i in range(n_uavs)
    )
    first_ugv = _ugv(rng, first_uav)
    alike = rng.uniform() < ALIKE
    ugvs = tuple(replace(first_ugv if alike else _ugv(rng, first_uav), id=f"ugv{i}") for i in range(n_ugvs))
    keep = np.ones(len(problem.tasks), dtype=bool)
    if rng.uniform() < FEWER_TASKS:
        keep = rng.uniform(size=len(keep)) < rng.uniform(0.4, 1.0)
    away = np.linalg.norm(problem.tasks[:, None] - problem.sites[None], axis=2).min(axis=1)
    keep &= away <= min(_reach_m(u) for u in uavs)
    if not keep.any():
        keep[away.argmin()] = True
    return replace(problem, tasks=problem.tasks[keep], visited=problem.visited[keep], uavs=uavs, ugvs=ugvs)


def _flight_s(uav: Uav) -> float:
    return uav.capacity_j / uav.cruise_w


def _reach_m(uav: Uav) -> float:
    """How far from a site a task may lie so that it can be visited from there and back, with a tenth to spare."""
    usable_j = 0.9 * (uav.capacity_j - uav.reserve_j) - uav.hover_w * uav.service_s
    return 0.5 * max(0.0, usable_j) / uav.cruise_w * uav.speed_mps


def _uav(problem: Problem, rng: np.random.Generator, hovers: bool) -> Uav:
    given = problem.uavs[0]
    capacity_j = given.capacity_j * CAPACITY.draw(rng)
    uav = replace(
        given,
        position=problem.depot,
        capacity_j=capacity_j,
        energy_j=capacity_j * FULL.draw(rng),
        reserve_j=capacity_j * RESERVE.draw(rng),
        speed_mps=given.speed_mps * SPEED.draw(rng),
        hover_w=given.cruise_w * HOVER.draw(rng),
        waiting="hover" if hovers else "landed",
    )
    return replace(uav, service_s=SERVICE.draw(rng) * _flight_s(uav))


def _ugv(rng: np.random.Generator, uav: Uav) -> Ugv:
    flight_s = _flight_s(uav)
    charge_s = CHARGE.draw(rng) * flight_s
    by_power = rng.uniform() < BY_POWER
    drive_w = DRIVE_W.draw(rng) * uav.cruise_w
    capacity_j = ENDURANCE.draw(rng) * flight_s * drive_w
    return Ugv(
        "ugv",
        energy_j=capacity_j,
        capacity_j=capacity_j,
        drive_w=drive_w,
        idle_w=IDLE_W.draw(rng) * uav.cruise_w,
        speed_mps=DRIVE.draw(rng) * uav.speed_mps,
        charge_s=None if by_power else charge_s,
        charge_w=uav.capacity_j / charge_s if by_power else None,
        dock_s=DOCK.draw(rng) * flight_s,
        undock_s=UNDOCK.draw(rng) * flight_s,
        docks=1 if rng.uniform() < SINGLE_DOCK else 2,
    )
