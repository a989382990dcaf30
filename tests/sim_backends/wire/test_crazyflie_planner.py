"""The high-level commander's planner and commands, without a vehicle."""

from __future__ import annotations

import errno
import math
import struct

import pytest

from sim_backends.wire.crazyflie_commander import (
    DEFINE_TRAJECTORY,
    GO_TO,
    GO_TO_2,
    LAND_2,
    SET_GROUP_MASK,
    SPIRAL,
    START_TRAJECTORY,
    STOP,
    TAKEOFF_2,
    TAKEOFF_WITH_VELOCITY,
    Commander,
)
from sim_backends.wire.crazyflie_planner import Axis, Goal, Phase, linear, smooth, spiral
from sim_backends.wire.crazyflie_setpoints import Mode, Setpoint

HERE = Goal((1.0, 2.0, 0.0), yaw_rad=0.5)


def takeoff(height: float = 1.0, seconds: float = 2.0, *, keep: bool = True, group: int = 0) -> bytes:
    return struct.pack("<BBff?f", TAKEOFF_2, group, height, 0.0, keep, seconds)


def go_to(x: float, y: float, z: float, seconds: float, *, relative: bool = False, straight: bool = False) -> bytes:
    return struct.pack("<BBBBfffff", GO_TO_2, 0, relative, straight, x, y, z, 0.0, seconds)


def land(height: float = 0.0, seconds: float = 2.0) -> bytes:
    return struct.pack("<BBff?f", LAND_2, 0, height, 0.0, True, seconds)


def commander(protocol: int = 12) -> Commander:
    result = Commander(protocol)
    result.block(False)
    result.step(0.0, HERE)
    return result


def code(to: Commander, data: bytes, now_s: float = 0.0) -> int:
    answer = to.answer(data, now_s)
    assert len(answer) == 4
    assert answer[0] == data[0]
    return answer[3]


def test_rest_to_rest_has_the_known_peaks() -> None:
    """The factors of facts.md: 2.1875 d/T and 7.513 d/T^2."""
    axis = Axis(0.0, 0.0, 0.0, 3.0, 2.0)
    samples = [axis.at(0.001 * i) for i in range(2001)]
    assert samples[-1] == (pytest.approx(3.0), 0.0, 0.0)
    assert max(v for _, v, _ in samples) == pytest.approx(2.1875 * 3.0 / 2.0, rel=1e-4)
    assert max(a for _, _, a in samples) == pytest.approx(7.513 * 3.0 / 4.0, rel=1e-3)


def test_a_moving_start_is_taken_over_without_a_jump() -> None:
    axis = Axis(1.0, 0.7, -0.3, 4.0, 2.0)
    assert axis.at(0.0) == (1.0, pytest.approx(0.7), pytest.approx(-0.3))
    assert axis.at(1.999)[0] == pytest.approx(4.0, abs=1e-3)
    assert axis.at(1.999)[1] == pytest.approx(0.0, abs=1e-2)
    step = 1e-6
    assert (axis.at(1.0 + step)[0] - axis.at(1.0)[0]) / step == pytest.approx(axis.at(1.0)[1], abs=1e-3)


def test_it_turns_the_shorter_way() -> None:
    path = smooth(Goal(yaw_rad=3.0), (1.0, 0.0, 0.0), -3.0, 1.0, 0.0)
    assert path.at(1.0).yaw_rad == pytest.approx(math.tau - 3.0)


def test_straight_flight_keeps_one_speed() -> None:
    path = linear(Goal(), (2.0, 0.0, 0.0), 0.0, 4.0, 10.0)
    assert path.at(11.0).position_m[0] == pytest.approx(0.5)
    assert path.at(11.0).velocity_mps[0] == path.at(13.0).velocity_mps[0] == pytest.approx(0.5)
    assert path.at(20.0).velocity_mps[0] == 0.0


@pytest.mark.parametrize(
    ("clockwise", "sideways", "end"),
    [(False, False, (0.0, 2.0)), (True, False, (0.0, -2.0)), (False, True, (2.0, 0.0))],
)
def test_half_a_spiral_ends_on_the_other_side(clockwise: bool, sideways: bool, end: tuple[float, float]) -> None:
    path = spiral(Goal(), math.pi, (1.0, 1.0), 0.5, sideways, clockwise, 2.0, 0.0)
    assert path.at(0.0).position_m == pytest.approx((0.0, 0.0, 0.0))
    assert path.at(5.0).position_m == pytest.approx((*end, 0.5))
    assert math.hypot(*path.at(1.0).velocity_mps[:2]) == pytest.approx(math.pi / 2.0, rel=1e-3)


def test_takeoff_needs_an_idle_planner() -> None:
    c = commander()
    assert code(c, takeoff()) == 0
    assert code(c, takeoff()) == 1
    code(c, bytes((STOP, 0)))
    assert code(c, takeoff()) == 0


def test_takeoff_keeps_or_turns_its_heading() -> None:
    keep, turn = commander(), commander()
    code(keep, takeoff())
    code(turn, takeoff(keep=False))
    assert keep.step(3.0, HERE).goal.yaw_rad == pytest.approx(0.5)
    assert turn.step(3.0, HERE).goal.yaw_rad == pytest.approx(0.0)
    assert keep.step(3.0, HERE).goal.position_m == pytest.approx((1.0, 2.0, 1.0))


def test_landing_ends_idle_with_the_motors_off() -> None:
    c = commander()
    code(c, takeoff())
    c.step(2.0, HERE)
    assert code(c, land(), 2.0) == 0
    assert code(c, land(), 2.5) == 1
    assert c.step(3.0, HERE).mode is Mode.GOAL
    c.step(4.1, HERE)
    assert c.step(4.2, HERE).mode is Mode.OFF
    assert c.planner.phase is Phase.IDLE


def test_go_to_from_the_ground_flies() -> None:
    c = commander()
    assert code(c, go_to(3.0, 2.0, 1.0, 2.0)) == 0
    assert c.step(2.0, HERE).goal.position_m == pytest.approx((3.0, 2.0, 1.0))


def test_relative_means_the_setpoint() -> None:
    c = commander()
    code(c, takeoff())
    c.step(2.0, HERE)
    code(c, go_to(1.0, 0.0, 0.0, 1.0, relative=True), 2.0)
    assert c.step(3.0, Goal((9.0, 9.0, 9.0))).goal.position_m == pytest.approx((2.0, 2.0, 1.0))


def test_overlapping_go_tos_start_from_the_moving_setpoint() -> None:
    c = commander()
    code(c, go_to(3.0, 2.0, 1.0, 2.0))
    moving = c.step(1.0, HERE).goal
    code(c, go_to(1.0, 2.0, 1.0, 2.0), 1.0)
    after = c.step(1.0, HERE).goal
    assert after.velocity_mps == pytest.approx(moving.velocity_mps)
    assert after.velocity_mps[0] > 1.0


def test_blocked_takes_no_plans() -> None:
    c = Commander(12)
    assert code(c, takeoff()) == errno.EBUSY
    assert code(c, go_to(0.0, 0.0, 1.0, 1.0)) == errno.EBUSY
    assert code(c, bytes((STOP, 0))) == 0
    c.block(False)
    code(c, takeoff())
    c.block(True)
    assert c.planner.phase is Phase.IDLE


def test_groups() -> None:
    c = commander()
    assert code(c, takeoff(group=2)) == 0
    assert c.planner.phase is Phase.IDLE
    code(c, bytes((SET_GROUP_MASK, 6)))
    code(c, takeoff(group=2))
    assert c.planner.phase is Phase.FLYING


def test_a_client_outranks_the_planner_until_it_gives_back() -> None:
    c = commander()
    code(c, takeoff())
    c.step(2.0, HERE)
    c.client(Setpoint(), 2.0)  # as cflib's close_link does
    assert c.planner.phase is Phase.IDLE
    assert code(c, takeoff(), 2.1) == 0
    assert c.step(3.0, HERE).mode is Mode.OFF
    assert c.stamp_s == 2.0
    c.relax(HERE)
    assert c.step(3.1, HERE).mode is Mode.GOAL
    assert c.stamp_s == 3.1


@pytest.mark.parametrize(
    ("protocol", "data", "expected"),
    [
        (7, go_to(0.0, 0.0, 1.0, 1.0), errno.ENOEXEC),
        (7, struct.pack("<BBBfffff", GO_TO, 0, 0, 0, 0, 1, 0, 1), 0),
        (8, go_to(0.0, 0.0, 1.0, 1.0), 0),
        (7, struct.pack("<BBBBfffff", SPIRAL, 0, 0, 0, 1, 1, 1, 0, 1), errno.ENOEXEC),
        (12, struct.pack("<BBBBfffff", SPIRAL, 0, 0, 0, 1, 1, 1, 0, 1), 0),
        (12, struct.pack("<BBBBfffff", SPIRAL, 0, 0, 0, 1, -1, 1, 0, 1), errno.EINVAL),
        (12, struct.pack("<BBBBIB", DEFINE_TRAJECTORY, 1, 1, 0, 0, 1), errno.ENOEXEC),
        (12, struct.pack("<BBBBBf", START_TRAJECTORY, 0, 0, 0, 1, 1.0), errno.ENOEXEC),
        (12, struct.pack("<BBf?f?f", TAKEOFF_WITH_VELOCITY, 0, 1.0, True, 0.0, True, 0.5), 0),
        (12, takeoff(math.nan), errno.EINVAL),
        (12, go_to(math.inf, 0.0, 1.0, 1.0), errno.EINVAL),
        (12, b"\x07\0", errno.EINVAL),
        (12, b"\x63\0", errno.ENOEXEC),
        (12, b"", None),
    ],
)
def test_error_codes(protocol: int, data: bytes, expected: int | None) -> None:
    c = commander(protocol)
    if expected is None:
        assert c.answer(data, 0.0)[3] == errno.ENOEXEC
    else:
        assert code(c, data) == expected


def test_takeoff_with_velocity_takes_as_long_as_the_way_needs() -> None:
    c = commander()
    code(c, struct.pack("<BBf?f?f", TAKEOFF_WITH_VELOCITY, 0, 1.0, True, 0.0, True, 0.5))
    assert not c.planner.finished(1.9)
    assert c.planner.finished(2.1)
