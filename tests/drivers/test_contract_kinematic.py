"""The drivers' contract on the kinematic backend: at two scales, with noise and with a coarse and a fine step."""

from __future__ import annotations

import pytest

from sim_backends.kinematic import build
from sim_backends.world import SimUav, SimUgv, WorldConfig
from tests.drivers.contract import DockContract, Harness, UavContract, UgvContract

FIELD = WorldConfig(
    uavs=(SimUav("uav0", "cf0", (0.0, 0.0)), SimUav("uav1", "cf1", (0.0, -40.0))),
    ugvs=(SimUgv("ugv0", "limo0", (0.0, 30.0), yaw_rad=0.3),),
    occlusions_per_s=0.05,
    telemetry_drop=0.05,
)
LAB = WorldConfig(
    uavs=(
        SimUav(
            "uav0",
            "cf0",
            (0.0, 0.0),
            max_speed_mps=1.5,
            accel_mps2=1.5,
            climb_mps=0.7,
            descent_mps=0.5,
            tracking_noise_m=0.01,
            dock_noise_m=0.005,
            drift_mps=0.02,
        ),
    ),
    ugvs=(
        SimUgv(
            "ugv0",
            "limo0",
            (0.0, 1.5),
            max_speed_mps=0.5,
            tracking_noise_m=0.005,
            pad_height_m=0.3,
            dock_offsets_m=((0.0, 0.0),),
        ),
    ),
    scale=0.01,
    time_scale=0.1,
    step_s=0.02,
    pose_noise_m=0.001,
    dock_tolerance_m=0.05,
    dock_range_m=0.5,
    collision_m=0.1,
)


@pytest.fixture(params=["field", "lab"])
def harness(request: pytest.FixtureRequest) -> Harness:
    config = FIELD if request.param == "field" else LAB
    backend = build(config)
    bodies = {v.id: v.body for v in config.vehicles}
    sizes = {
        "field": {"pad_offset_m": (0.5, 0.0), "tolerance_m": 0.8},
        "lab": {
            "altitude_m": 1.0,
            "leg_m": 2.0,
            "speed_mps": 0.4,
            "tolerance_m": 0.1,
            "pad_height_m": 0.3,
        },
    }[request.param]
    made = Harness(backend.vehicles, backend.poses, backend.clock, bodies, **sizes)  # type: ignore[arg-type]
    made.connect()
    return made


class TestUav(UavContract):
    """Every UAV test on the kinematic UAV."""


class TestUgv(UgvContract):
    """Every UGV test on the kinematic UGV."""


class TestDock(DockContract):
    """Every docking test."""
