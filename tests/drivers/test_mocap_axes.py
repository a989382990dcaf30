"""From a motion-capture system's axes to the arena's."""

from __future__ import annotations

import math

import pytest

from drivers.mocap_axes import Quaternion, to_arena, yaw_of

R = math.sqrt(0.5)
LEVEL: Quaternion = (0.0, 0.0, 0.0, 1.0)


def yaw(angle_rad: float) -> Quaternion:
    return (0.0, 0.0, math.sin(angle_rad / 2), math.cos(angle_rad / 2))


@pytest.mark.parametrize("angle_rad", [-3.0, -1.2, 0.0, 0.4, math.pi / 2, 3.1])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_yaw_is_read_from_either_of_the_two_quaternions(angle_rad: float, sign: float) -> None:
    x, y, z, w = yaw(angle_rad)
    assert yaw_of((sign * x, sign * y, sign * z, sign * w)) == pytest.approx(angle_rad)


def test_yaw_of_a_tilted_body_is_its_heading() -> None:
    # heading 90 deg, then pitched by 0.3 rad about its own y axis
    x, y, z, w = yaw(math.pi / 2)
    s, c = math.sin(0.15), math.cos(0.15)
    tilted = (x * c - z * s, y * c + w * s, z * c + x * s, w * c - y * s)
    assert yaw_of(tilted) == pytest.approx(math.pi / 2)


@pytest.mark.parametrize("none", [(0.0, 0.0, 0.0, 0.0), (math.nan, 0.0, 0.0, 1.0), (0.0, math.inf, 0.0, 1.0)])
def test_no_attitude_is_no_pose(none: Quaternion) -> None:
    assert yaw_of(none) is None
    assert to_arena("z", 0.0, (0.0, 0.0, 0.0))((1.0, 2.0, 3.0), none) is None


def test_no_place_is_no_pose() -> None:
    assert to_arena("z", 0.0, (0.0, 0.0, 0.0))((1.0, math.nan, 3.0), LEVEL) is None


def test_z_up_passes_through() -> None:
    assert to_arena("z", 0.0, (0.0, 0.0, 0.0))((1.0, 2.0, 3.0), yaw(0.5)) == (
        (1.0, 2.0, 3.0),
        pytest.approx(0.5),
    )


def test_y_up_becomes_z_up() -> None:
    # Motive: x right, y up, z towards the viewer; a body turned left by 90 deg about y
    turned = to_arena("y", 0.0, (0.0, 0.0, 0.0))((1.0, 2.0, 3.0), (0.0, R, 0.0, R))
    assert turned is not None
    assert turned[0] == (1.0, -3.0, 2.0)
    assert turned[1] == pytest.approx(math.pi / 2)


def test_the_system_is_turned_and_moved_into_the_arena() -> None:
    turned = to_arena("z", math.pi / 2, (10.0, 20.0, 0.5))((1.0, 2.0, 3.0), yaw(math.pi * 0.75))
    assert turned is not None
    assert turned[0] == pytest.approx((8.0, 21.0, 3.5))
    assert turned[1] == pytest.approx(-math.pi * 0.75)
