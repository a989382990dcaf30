"""What a motion-capture system may be told, and what its client is told of that."""

from __future__ import annotations

import math
from typing import Any

import pytest

from drivers.errors import DriverError
from drivers.mocap_options import MocapOptions


@pytest.mark.parametrize(
    ("options", "settings"),
    [
        (MocapOptions("vicon", "10.0.0.2"), {"hostname": "10.0.0.2"}),
        (MocapOptions("vicon", "tracker", 804), {"hostname": "tracker:804"}),
        (MocapOptions("vrpn", "vrpn.lab", 3884), {"hostname": "vrpn.lab:3884"}),
        (MocapOptions("qualisys", "qtm", 22223), {"hostname": "qtm", "port": "22223"}),
        (MocapOptions("optitrack", "motive"), {"hostname": "motive"}),
        (
            MocapOptions("optitrack", "10.0.0.2", 1610, interface_ip="10.0.0.9"),
            {"hostname": "10.0.0.2", "port_command": "1610", "interface_ip": "10.0.0.9"},
        ),
        (
            MocapOptions("mock", mock_bodies=(("a", (1.0, 2.0, 0.5)), ("b", (0.0, 0.0, 0.0))), mock_rate_hz=50),
            {"rigid_bodies": "a(1.0,2.0,0.5,1,0,0,0);b(0.0,0.0,0.0,1,0,0,0)", "frequency": "50"},
        ),
    ],
)
def test_each_client_gets_the_keys_that_it_reads(options: MocapOptions, settings: dict[str, str]) -> None:
    assert options.settings() == settings


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"type": "optitrak", "hostname": "x"}, "type is 'optitrak'.*mock, vicon.*did you mean optitrack"),
        ({"type": "nokov", "hostname": "x"}, "give one of"),
        ({"type": "vicon"}, "hostname is None"),
        ({"type": "vicon", "hostname": ""}, "hostname is ''"),
        ({"type": "vicon", "hostname": " tracker"}, "hostname is ' tracker'"),
        ({"type": "optitrack", "hostname": "x", "port": 0}, "port is 0"),
        ({"type": "optitrack", "hostname": "x", "port": 65536}, "port is 65536"),
        ({"type": "optitrack", "hostname": "x", "interface_ip": "eth0"}, "interface_ip is 'eth0'.*numeric"),
        ({"type": "vicon", "hostname": "x", "interface_ip": "10.0.0.2"}, "only for optitrack"),
        ({"type": "mock"}, "mock_bodies is empty"),
        ({"type": "mock", "hostname": "x", "mock_bodies": (("a", (0, 0, 0)),)}, "no hostname"),
        ({"type": "mock", "mock_bodies": (("a;b", (0, 0, 0)),)}, "plain name"),
        ({"type": "mock", "mock_bodies": (("a", (0, 0, math.nan)),)}, "finite"),
        ({"type": "vicon", "hostname": "x", "mock_bodies": (("a", (0, 0, 0)),)}, "only for type mock"),
        ({"type": "vicon", "hostname": "x", "up": "x"}, "give y or z"),
        ({"type": "vicon", "hostname": "x", "yaw_rad": math.inf}, "finite"),
        ({"type": "vicon", "hostname": "x", "translation_m": (0.0, math.nan, 0.0)}, "finite"),
        ({"type": "vicon", "hostname": "x", "silence_s": 0.0}, "silence_s is 0.0"),
        ({"type": "vicon", "hostname": "x", "attempt_s": math.inf}, "attempt_s is inf"),
    ],
)
def test_nonsense_is_one_clear_error(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(DriverError, match=message):
        MocapOptions(**arguments)


def test_messages_say_which_system() -> None:
    assert MocapOptions("qualisys", "qtm", 22223).where == "motion capture (qualisys at qtm:22223)"
    assert MocapOptions("mock", mock_bodies=(("a", (0.0, 0.0, 0.0)),)).where == "motion capture (mock)"
