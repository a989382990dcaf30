"""The simulated MAVLink copters indoors: external poses are the position."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from sim_backends.wire.world import World
from sim_backends.world import SimUav, WorldConfig
from tests.sim_backends.wire.mavlink_station import flying, mavlink

pytestmark = pytest.mark.wire

ARM, SET_MODE = 400, 176


def test_vision_is_the_position_and_its_loss_ends_the_flight() -> None:
    with flying("--position", "vision", "--param", "EKF2_NOAID_TOUT=1500000") as s:
        s.pump(1.2)
        assert "LOCAL_POSITION_NED" not in s.newest
        assert "GLOBAL_POSITION_INT" not in s.newest
        assert s.newest["GPS_RAW_INT"].fix_type == 0
        assert s.command(ARM, 1) == 1
        s.until(lambda: any("position" in text for text in s.texts))
        # the poses of a body that stands at (1, 2) of a frame whose north is the arena's x
        s.stream = lambda: mavlink.MAVLink_vision_position_estimate_message(0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0)
        s.until(lambda: "LOCAL_POSITION_NED" in s.newest)
        s.until(lambda: math.dist(s.ned, (1.0, 2.0, 0.0)) < 0.05)
        s.until(lambda: s.newest["ESTIMATOR_STATUS"].flags & 0x8)
        assert s.command(ARM, 1) == 0
        s.stream = None
        s.until(lambda: not s.newest["ESTIMATOR_STATUS"].flags & 0x8)
        assert "GLOBAL_POSITION_INT" not in s.newest


def test_it_flies_by_external_poses_in_whatever_frame_they_are(tmp_path: Path) -> None:
    world = World.create(tmp_path, WorldConfig(uavs=(SimUav("uav0", "u", (1.0, 2.0)),), ugvs=()))

    def seen() -> tuple[float, float, float, float]:
        body = world.body(0)
        x, y, z = body.position_m
        return (x, -y, -z, -body.yaw_rad)  # north is the arena's x here

    target = (0.0, 0.0, 0.0)

    def stream() -> list[object]:
        n, e, d, yaw = seen()
        return [
            mavlink.MAVLink_vision_position_estimate_message(0, n, e, d, 0.0, 0.0, yaw),
            s.position(*target),
        ]

    with flying("--world", str(tmp_path), "--vehicle", "uav0") as s:
        target = (1.0, -2.0, -1.5)
        s.stream = stream
        s.until(lambda: "LOCAL_POSITION_NED" in s.newest)
        s.insist(SET_MODE, 1, 6)
        s.insist(ARM, 1)
        s.until(lambda: math.dist(seen()[:3], target) < 0.3)
        target = (3.0, -4.0, -1.5)
        s.until(lambda: math.dist(seen()[:3], target) < 0.3)
        assert math.dist(world.body(0).position_m, (3.0, 4.0, 1.5)) < 0.3
        assert "GLOBAL_POSITION_INT" not in s.newest


def test_ardupilot_wants_an_origin_before_it_knows_where_it_is() -> None:
    with flying("--position", "vision", "--autopilot", "ardupilot") as s:
        s.send(mavlink.MAVLink_request_data_stream_message(1, 1, 0, 10, 1))
        s.stream = lambda: mavlink.MAVLink_vision_position_estimate_message(0, 1.0, 2.0, 0.0, 0.0, 0.0, 0.5)
        s.until(lambda: "LOCAL_POSITION_NED" in s.newest)
        assert s.command(SET_MODE, 1, 4) == 4
        s.until(lambda: any("requires position" in text for text in s.texts))
        s.send(mavlink.MAVLink_set_gps_global_origin_message(1, 473977420, 85455940, 488_000))
        s.until(lambda: "GLOBAL_POSITION_INT" in s.newest)
        assert s.command(SET_MODE, 1, 4) == 0
        assert s.command(ARM, 1) == 0
        assert abs(s.newest["GLOBAL_POSITION_INT"].lat - 473977510) < 20
