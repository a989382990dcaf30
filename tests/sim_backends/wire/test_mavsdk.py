"""MAVSDK as it comes from PyPI flies the simulated copters: it knows nothing of us, nor we of it."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from tests.sim_backends.wire.mavlink_station import process

pytestmark = pytest.mark.wire

mavsdk = pytest.importorskip("mavsdk")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


def wait_for(condition: Callable[[], Any], seconds: float = 30.0) -> None:
    end_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end_s, "it did not happen"
        time.sleep(0.05)


@pytest.fixture
def sdk() -> Iterator[Any]:
    configuration = mavsdk.Configuration.create_with_component_type(mavsdk.ComponentType.GROUND_STATION)
    instance = mavsdk.Mavsdk(configuration)
    yield instance
    instance.destroy()


def connect(sdk: Any, port: int) -> Any:
    assert sdk.add_any_connection(f"udpin://127.0.0.1:{port}") == mavsdk.ConnectionResult.SUCCESS
    system = sdk.first_autopilot(30.0)
    assert system is not None
    return system


def test_flies_a_px4_copter_offboard(sdk: Any) -> None:
    from mavsdk.plugins.action import Action  # noqa: PLC0415
    from mavsdk.plugins.offboard import Offboard, PositionNedYaw, VelocityNedYaw  # noqa: PLC0415
    from mavsdk.plugins.param import Param  # noqa: PLC0415
    from mavsdk.plugins.telemetry import Telemetry  # noqa: PLC0415

    port = free_port()
    with process("--out", f"127.0.0.1:{port}"):
        system = connect(sdk, port)
        action, offboard, telemetry, param = Action(system), Offboard(system), Telemetry(system), Param(system)
        wait_for(telemetry.health_all_ok)
        param.set_param_float("MPC_LAND_SPEED", 1.5)
        assert param.get_param_float("MPC_LAND_SPEED") == 1.5
        param.set_param_int("COM_OBL_RC_ACT", 5)
        assert param.get_param_int("COM_OBL_RC_ACT") == 5
        action.set_takeoff_altitude(3.0)
        assert action.get_takeoff_altitude() == 3.0
        action.arm()
        action.takeoff()
        wait_for(lambda: telemetry.position().relative_altitude_m > 2.7)
        wait_for(telemetry.in_air)
        offboard.set_position_ned(PositionNedYaw(4.0, 2.0, -3.0, 0.0))
        offboard.start()
        wait_for(offboard.is_active)

        def ned() -> Any:
            return telemetry.position_velocity_ned().position

        wait_for(lambda: abs(ned().north_m - 4.0) < 0.3 and abs(ned().east_m - 2.0) < 0.3)
        offboard.set_velocity_ned(VelocityNedYaw(-1.0, 0.0, 0.0, 90.0))
        wait_for(lambda: ned().north_m < 2.5)
        offboard.stop()
        action.land()
        wait_for(lambda: not telemetry.armed())
        wait_for(lambda: not telemetry.in_air())


def test_flies_an_ardupilot_copter(sdk: Any) -> None:
    from mavsdk.plugins.action import Action  # noqa: PLC0415
    from mavsdk.plugins.telemetry import Telemetry  # noqa: PLC0415

    port = free_port()
    with process("--out", f"127.0.0.1:{port}", "--autopilot", "ardupilot", "--param", "LAND_SPEED=150"):
        system = connect(sdk, port)
        action, telemetry = Action(system), Telemetry(system)
        telemetry.set_rate_position(5.0)
        telemetry.set_rate_in_air(5.0)
        action.set_takeoff_altitude(3.0)
        wait_for(lambda: telemetry.position().relative_altitude_m > -1.0)
        action.arm()
        action.takeoff()
        wait_for(lambda: telemetry.position().relative_altitude_m > 2.7)
        action.land()
        wait_for(lambda: not telemetry.armed())
