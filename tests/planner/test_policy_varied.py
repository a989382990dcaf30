"""Training problems of all sorts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deploy.mission import load
from planner.instances import data_set
from planner.policy.varied import TEAMS, varied
from planner.problem import Problem


@pytest.fixture(scope="module")
def drawn() -> list[Problem]:
    one = data_set("T15-P5_1-1_drawn")
    return [varied(one.instance(i), i) for i in range(300)]


def shares(problem: Problem) -> dict[str, float]:
    """What differs between missions, in units of the UAV."""
    u, g = problem.uavs[0], problem.ugvs[0]
    flight_s = u.capacity_j / u.cruise_w
    charge_s = g.charge_s if g.charge_s is not None else u.capacity_j / (g.charge_w or 1.0)
    return {
        "hovers": float(u.waiting == "hover"),
        "hover": u.hover_w / u.cruise_w,
        "reserve": u.reserve_j / u.capacity_j,
        "full": u.energy_j / u.capacity_j,
        "service": u.service_s / flight_s,
        "charge": charge_s / flight_s,
        "dock": g.dock_s / flight_s,
        "undock": g.undock_s / flight_s,
        "docks": float(g.docks),
        "drive": g.speed_mps / u.speed_mps,
        "start": u.ready_s / flight_s,
        "stagger": (problem.uavs[1].ready_s - u.ready_s) / flight_s if len(problem.uavs) > 1 else 0.0,
        "idle": g.idle_w / u.cruise_w,
        "drive power": g.drive_w / u.cruise_w,
        "endurance": g.capacity_j / g.drive_w / flight_s,
    }


def test_the_same_seed_the_same_problem(drawn: list[Problem]) -> None:
    again = varied(data_set("T15-P5_1-1_drawn").instance(7), 7)
    assert again.digest == drawn[7].digest
    assert len({p.digest for p in drawn}) == len(drawn)
    other = varied(data_set("T15-P5_2-1").instance(7), 7)
    assert shares(other) != shares(drawn[7])


def test_every_task_can_be_reached_and_flown_back_from(drawn: list[Problem]) -> None:
    for p in drawn:
        away = np.linalg.norm(p.tasks[:, None] - p.sites[None], axis=2).min(axis=1)
        for u in p.uavs:
            need_j = 2 * away / u.speed_mps * u.cruise_w + u.service_s * u.hover_w
            assert (need_j <= u.capacity_j - u.reserve_j).all()


def test_teams_and_tasks_differ(drawn: list[Problem]) -> None:
    assert {(len(p.uavs), len(p.ugvs)) for p in drawn} == set(TEAMS)
    assert len({p.n_tasks for p in drawn}) > 5
    alike = [len({(u.speed_mps, u.capacity_j) for u in p.uavs}) == 1 for p in drawn if len(p.uavs) > 1]
    assert 0.5 < np.mean(alike) < 0.9


@pytest.mark.parametrize("mission", ["demo", "lab", "field"])
def test_missions_lie_within(drawn: list[Problem], mission: str) -> None:
    every = [shares(p) for p in drawn]
    for key, value in shares(load(Path(f"mission_configs/{mission}.yaml")).problem).items():
        assert min(s[key] for s in every) <= value <= max(s[key] for s in every), key
