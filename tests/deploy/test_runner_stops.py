"""One driver that fails must not keep another vehicle from its emergency stop."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest
import small_mission

from deploy.backends import connect
from deploy.mission import load
from deploy.operator import ScriptedOperator
from deploy.planning import InlinePlanner, plan_with_margin
from deploy.planning_settings import first_plan, replanning
from deploy.runner import fly
from drivers.errors import DriverError
from drivers.vehicle import Command, StopMotors, Vehicle


class Broken:
    """A vehicle whose driver fails at the first emergency stop, and at the first only."""

    def __init__(self, vehicle: Vehicle) -> None:
        self._vehicle = vehicle
        self.failed = False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._vehicle, name)

    def send(self, command: Command) -> Command:
        if isinstance(command, StopMotors) and not self.failed:
            self.failed = True
            raise DriverError(f"{self._vehicle.id}: the radio is gone; plug it in")
        return self._vehicle.send(command)


class Silent:
    def tick(self, *_: object) -> None:
        pass

    def plan(self, *_: object) -> None:
        pass


@pytest.mark.parametrize("broken", ["uav0", "uav1", "ugv0"])
def test_everybody_is_stopped_whoever_fails(tmp_path: Path, broken: str) -> None:
    mission = load(small_mission.write(tmp_path))
    stop, seed, params = first_plan(mission)
    plan = plan_with_margin(mission.problem, mission.settings.replanning.margin, stop, seed, params)
    fleet = connect(mission, horizon_s=plan.makespan_s)
    assert not fleet.connect(10.0)
    operator = ScriptedOperator([(fleet.clock.now() + 20.0, "stop")])
    operator.attach(fleet.clock)
    vehicles = {**fleet.vehicles, broken: Broken(fleet.vehicles[broken])}
    with pytest.raises(DriverError, match="the radio is gone"):
        fly(
            mission.settings,
            plan,
            vehicles=MappingProxyType(vehicles),
            poses=fleet.poses,
            clock=fleet.clock,
            planner=InlinePlanner(replanning(mission)),
            operator=operator,
            observer=Silent(),
            virtual=True,
        )
    fleet.clock.wait_until(fleet.clock.now() + 5.0)
    assert fleet.truth is not None
    assert {name for name, v in fleet.truth().vehicles.items() if v.locked} == {"uav0", "uav1", "ugv0"}
