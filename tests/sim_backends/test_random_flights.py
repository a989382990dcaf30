"""Random commands and random faults: the world stays finite and does not depend on how often the loop looks."""

from __future__ import annotations

import random

import numpy as np
import pytest

from drivers.vehicle import Arm, Command, Disarm, Dock, Drive, GoTo, Hold, Land, StopMotors, TakeOff
from sim_backends.faults import random_faults
from tests.sim_backends.flying import Team
from tests.sim_backends.test_world import NOISY, fingerprint

UAVS, UGVS = ["uav0", "uav1"], ["ugv0", "ugv1"]


def commands(rng: random.Random) -> list[tuple[float, Command]]:
    result: list[tuple[float, Command]] = []
    time_s = 1.0
    while time_s < 120.0:
        time_s += round(rng.uniform(0.02, 8.0), 2)
        uav, ugv = rng.choice(UAVS), rng.choice(UGVS)
        over = (50.0, 0.0 if ugv == "ugv0" else 60.0, 12.0)
        anywhere = (rng.uniform(-100, 200), rng.uniform(-50, 200), rng.uniform(3, 40))
        path = tuple((rng.uniform(0, 100), rng.uniform(0, 100)) for _ in range(rng.randrange(1, 40)))
        choices: list[Command] = [
            TakeOff(uav, rng.uniform(5, 40), 4.0),
            GoTo(uav, anywhere, rng.uniform(1, 15)),
            GoTo(uav, over, 12.0),
            Land(uav, 2.0),
            Dock(uav, ugv, rng.randrange(2), 2.0, 15.0),
            Hold(uav),
            Hold(ugv),
            Drive(ugv, path, rng.uniform(1, 6)),
            Arm(uav),
            Arm(ugv),
            Disarm(uav) if rng.random() < 0.3 else Hold(uav),
            StopMotors(uav) if rng.random() < 0.1 else Arm(uav),
        ]
        result.append((time_s, rng.choice(choices)))
    return result


@pytest.mark.parametrize("seed", range(12))
def test_random_flights(seed: int) -> None:
    timetable = commands(random.Random(seed))
    faults = random_faults(seed, 6, 120.0, UAVS, UGVS)
    worlds = []
    for look_s in (0.02, 1.0):
        team = Team(*faults, look_s=look_s, **{**NOISY, "seed": seed, "step_s": 0.1 if seed % 2 else 0.02})
        for time_s, command in timetable:
            team.until(time_s)
            team.send(command)
        team.until(140.0)
        arrays = team.backend.world.arrays
        for array in (arrays.uavs, arrays.ugvs):
            assert all(np.isfinite(array[name].astype(float)).all() for name in array.dtype.names or ())
        worlds.append(fingerprint(team))
    assert worlds[0] == worlds[1]
