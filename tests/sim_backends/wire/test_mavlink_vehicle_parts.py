"""Tables and parts of the simulated MAVLink vehicles: set-points, parameters, estimates, bodies, streams."""

from __future__ import annotations

import math
import struct

import pytest

from drivers.geodesy import GeoFrame
from sim_backends.errors import SimulationError
from sim_backends.wire import mavlink_autopilot as words
from sim_backends.wire.mavlink_body import Copter, Rover, quaternion
from sim_backends.wire.mavlink_estimate import Estimate, Quality
from sim_backends.wire.mavlink_guidance import Limits, Sense, Wish, approach_mps, stopping_point, velocity_for
from sim_backends.wire.mavlink_link import mavlink, parse_key
from sim_backends.wire.mavlink_options import VehicleOptions, build_params
from sim_backends.wire.mavlink_params import (
    ARDUPILOT_COPTER,
    ARDUPILOT_ROVER,
    INT8,
    INT32,
    PX4_COPTER,
    PX4_ROVER,
    REAL32,
    Params,
    decode,
    encode,
)  # fmt: skip
from sim_backends.wire.mavlink_setpoints import Globe, SetPoint, Target, read_ardupilot, read_px4
from sim_backends.wire.mavlink_streams import Streams
from sim_backends.wire.mavlink_vehicle import parser

NAN = math.nan
LIMITS = Limits(5.0, 3.0, 2.0, 2.0)
HERE = Sense(10.0, ned=(1.0, 2.0, -3.0), yaw=0.5 * math.pi)
GLOBE = Globe(lambda lat, lon: (lat * 1e5, lon * 1e5), altitude_m=488.0, home_m=490.0)
P, V = (10.0, 20.0, -5.0), (1.0, 2.0, 0.5)
POSITION, VELOCITY, BOTH = 0b110111111000, 0b110111000111, 0b110111000000


def same(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return all(x == pytest.approx(y, nan_ok=True) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize(
    ("target", "position", "velocity"),
    [
        (Target(False, 1, POSITION, P, V), P, (NAN,) * 3),
        (Target(False, 1, VELOCITY, P, V), (NAN,) * 3, V),
        (Target(False, 1, BOTH, P, V), P, V),
        (Target(False, 1, 0b110111011011, P, V), (NAN, NAN, -5.0), (NAN, NAN, 0.5)),
        (Target(False, 8, VELOCITY, P, V), (NAN,) * 3, (-2.0, 1.0, 0.5)),
        (Target(True, 5, POSITION, (1e-4, 2e-4, 498.0), V), (10.0, 20.0, -10.0), (NAN,) * 3),
        (Target(True, 6, POSITION, (1e-4, 2e-4, 10.0), V), (10.0, 20.0, -12.0), (NAN,) * 3),
    ],
    ids=["position", "velocity", "both", "by axis", "body", "above the sea", "above home"],
)
def test_px4_reads_each_axis(target: Target, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
    read = read_px4(target, HERE, GLOBE)
    assert isinstance(read, SetPoint)
    assert same(read.position, position)
    assert same(read.velocity, velocity)
    assert read.at_s == HERE.now_s


@pytest.mark.parametrize(
    ("target", "words"),
    [
        (Target(False, 7, POSITION, P, V), "frame 7 unsupported"),
        (Target(False, 1, POSITION | 1 << 9, P, V), "force not supported"),
        (Target(True, 1, POSITION, P, V), "frame 1 unsupported"),
        (Target(False, 1, 0xFFF, P, V), ""),
    ],
)
def test_px4_refuses(target: Target, words: str) -> None:
    read = read_px4(target, HERE, GLOBE)
    assert isinstance(read, str)
    assert words in read


@pytest.mark.parametrize(
    ("target", "position"),
    [
        (Target(False, 1, POSITION, P, V), P),
        (Target(False, 7, POSITION, P, V), (11.0, 22.0, -8.0)),
        (Target(False, 9, POSITION, P, V), (-19.0, 12.0, -8.0)),
        (Target(True, 6, POSITION, (1e-4, 2e-4, 10.0), V), (10.0, 20.0, -12.0)),
    ],
    ids=["local", "offset", "body offset", "global"],
)
def test_ardupilot_reads_frames(target: Target, position: tuple[float, ...]) -> None:
    read = read_ardupilot(target, HERE, GLOBE)
    assert read is not None
    assert same(read.position, position)


def test_ardupilot_takes_a_vector_whole_or_not_at_all() -> None:
    assert read_ardupilot(Target(False, 1, 0b110111111001, P, V), HERE, GLOBE) is None
    read = read_ardupilot(Target(False, 1, 0b110111000001, P, V), HERE, GLOBE)
    assert read is not None
    assert not read.has_position
    assert read.velocity == V


def test_the_words_are_those_of_common_xml() -> None:
    for ours, theirs in {
        words.ARM_DISARM: "MAV_CMD_COMPONENT_ARM_DISARM",
        words.SET_MODE: "MAV_CMD_DO_SET_MODE",
        words.TAKEOFF: "MAV_CMD_NAV_TAKEOFF",
        words.LAND: "MAV_CMD_NAV_LAND",
        words.RTL: "MAV_CMD_NAV_RETURN_TO_LAUNCH",
        words.LOITER: "MAV_CMD_NAV_LOITER_UNLIM",
        words.REPOSITION: "MAV_CMD_DO_REPOSITION",
        words.CHANGE_SPEED: "MAV_CMD_DO_CHANGE_SPEED",
        words.TERMINATE: "MAV_CMD_DO_FLIGHTTERMINATION",
        words.SET_HOME: "MAV_CMD_DO_SET_HOME",
        words.PAUSE: "MAV_CMD_DO_PAUSE_CONTINUE",
        words.INT_ONLY: "MAV_RESULT_COMMAND_INT_ONLY",
        words.TERMINATED: "MAV_STATE_FLIGHT_TERMINATION",
        words.LANDING: "MAV_LANDED_STATE_LANDING",
        words.REJECTED: "MAV_RESULT_TEMPORARILY_REJECTED",
        words.IN_PROGRESS: "MAV_RESULT_IN_PROGRESS",
    }.items():
        assert ours == getattr(mavlink, theirs), theirs


@pytest.mark.parametrize("value", [0, 4, -1, 5_000_000])
def test_integers_of_parameters_in_both_dialects(value: int) -> None:
    wire = encode(INT32, value, bytewise=True)
    assert struct.pack("<f", wire) == struct.pack("<i", value)
    assert decode(INT32, wire, bytewise=True) == value
    assert encode(INT32, value, bytewise=False) == value
    assert decode(INT32, float(value), bytewise=False) == value
    assert encode(REAL32, 1.5, bytewise=True) == 1.5


def test_parameters_refuse_what_does_not_fit() -> None:
    params = Params(ARDUPILOT_COPTER, bytewise=False)
    assert not params.put("NO_SUCH", 1.0)
    assert not params.put("GUID_TIMEOUT", NAN)
    assert not params.put("FS_GCS_ENABLE", 300.0)
    assert params.types["FS_GCS_ENABLE"] == INT8
    assert params.put_wire("FS_GCS_ENABLE", 5.7)
    assert params["FS_GCS_ENABLE"] == 5
    before = params.hash
    params.put("GUID_TIMEOUT", 1.0)
    assert params.hash != before
    with pytest.raises(SimulationError, match="NO_SUCH"):
        Params(PX4_COPTER, bytewise=True, values={"NO_SUCH": 1.0})


@pytest.mark.parametrize("table", [PX4_COPTER, PX4_ROVER, ARDUPILOT_COPTER, ARDUPILOT_ROVER])
def test_names_of_parameters_fit_the_message(table: dict[str, object]) -> None:
    assert all(len(name) <= 16 for name in table)


def test_parameters_hold_the_limits_of_the_body() -> None:
    px4 = build_params(VehicleOptions(port=0, sysid=7, source="vision"), "copter", LIMITS)
    assert (px4["MPC_XY_VEL_MAX"], px4["MAV_SYS_ID"], px4["EKF2_EV_CTRL"]) == (5.0, 7.0, 15.0)
    ardupilot = build_params(VehicleOptions(port=0, autopilot="ardupilot"), "copter", LIMITS)
    assert (ardupilot["WPNAV_SPEED"], ardupilot["WPNAV_SPEED_UP"]) == (500.0, 300.0)


def test_a_point_is_reached_without_overshooting() -> None:
    copter = Copter((0.0, 0.0, 5.0), 0.0, LIMITS.accel_mps2, landed=False)
    wish = Wish(lift=True, position=(0.0, 12.0, -5.0))
    furthest = 0.0
    for _ in range(600):
        x, y, z = copter.position
        vx, vy, vz = copter.velocity
        n, e, d = velocity_for(wish, Sense(0.0, (y, x, -z), (vy, vx, -vz), contact=False), LIMITS)
        copter.fly(0.02, (e, n, -d), 0.0, 0.0)
        furthest = max(furthest, copter.position[0])
        assert math.hypot(*copter.velocity) < 5.3
        assert math.hypot(*copter.accel[:2]) <= LIMITS.accel_mps2 + 1e-9
    assert furthest < 12.2
    assert math.dist(copter.position, (12.0, 0.0, 5.0)) < 0.05


def test_speeds_near_a_point() -> None:
    assert approach_mps(0.0, 2.0) == 0.0
    assert approach_mps(1.0, 2.0) == pytest.approx(0.95)
    assert approach_mps(100.0, 2.0) ** 2 / (2 * 2.0) < 100.0
    assert stopping_point((0.0, 0.0, 0.0), (4.0, 0.0, 0.0), 2.0)[0] == pytest.approx(4.0**2 / (2 * 0.6 * 2.0))


def test_limits_hold_even_for_insane_parameters() -> None:
    wish = Wish(lift=True, velocity=(9.0, 0.0, -9.0), level_mps=-3.0, up_mps=-1.0)
    assert velocity_for(wish, HERE, LIMITS) == (0.0, 0.0, 0.0)


def test_without_motors_it_falls_and_lies_on_its_back() -> None:
    copter = Copter((0.0, 0.0, 5.0), 0.3, 3.0, landed=False)
    for _ in range(60):
        copter.fall(0.02, 0.0)
    assert copter.landed
    assert copter.tumbled
    x, y, _, _ = copter.quaternion
    assert 1.0 - 2.0 * (x * x + y * y) < -0.99, "its up points down"
    assert quaternion(0.0, 0.0, 0.3) == pytest.approx((0.0, 0.0, math.sin(0.15), math.cos(0.15)))
    low = Copter((0.0, 0.0, 0.2), 0.0, 3.0, landed=False)
    for _ in range(60):
        low.fall(0.02, 0.0)
    assert not low.tumbled


def test_rovers_turn_on_the_spot_or_in_their_radius() -> None:
    skid, car = Rover((0.0, 0.0), 0.0, 1.0), Rover((0.0, 0.0), 0.0, 1.0, turn_radius=1.0)
    furthest = 0.0
    for _ in range(300):
        skid.drive(0.02, (0.0, 1.0))
        before = car.yaw
        car.drive(0.02, (0.0, 1.0))
        assert abs(car.yaw - before) <= abs(car.speed) / 1.0 * 0.02 + 1e-9
        furthest = max(furthest, car.position[0])
    assert abs(skid.position[0]) < 0.2
    assert skid.position[1] > 3.0
    assert 0.6 < furthest < 2.0
    assert car.yaw == pytest.approx(0.5 * math.pi, abs=0.05)
    skid.speed = 1.0
    for _ in range(60):
        skid.halt(0.02)
    assert skid.speed == 0.0


def test_gps_has_true_north_whatever_the_arena() -> None:
    frame = GeoFrame(48.0, 11.0, rotation_rad=math.radians(90.0))
    estimate = Estimate("gps", frame, (5.0, 0.0, 0.0), Quality(noise_m=0.0), "seed")
    # the arena's x is the plane's minus y here: east turned by 90 degrees is the arena's y
    estimate.step(0.0, 0.02, (5.0, 3.0, 2.0), (0.0, 1.0, 0.0), 0.5 * math.pi)
    assert estimate.ned == pytest.approx((0.0, 3.0, -2.0), abs=1e-3)
    assert estimate.velocity == pytest.approx((0.0, 1.0, 0.0))
    assert estimate.yaw == pytest.approx(0.5 * math.pi), "east"
    assert estimate.arena_velocity((0.0, 1.0, -1.0)) == pytest.approx((0.0, 1.0, 1.0))
    assert estimate.global_ok
    assert frame.to_arena(*estimate.to_globe(estimate.ned)) == pytest.approx((5.0, 3.0), abs=1e-3)


def test_gps_noise_is_as_large_as_it_says() -> None:
    estimate = Estimate("gps", GeoFrame(48.0, 11.0), (0.0, 0.0, 0.0), Quality(noise_m=0.02), "seed")
    errors = []
    for i in range(20_000):
        estimate.step(0.02 * i, 0.02, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
        errors.append(estimate.ned[2])
    assert 0.012 < math.sqrt(sum(e * e for e in errors) / len(errors)) < 0.03


def test_external_poses_are_followed_and_missed() -> None:
    allowed = [True]
    quality = Quality(timeout_s=5.0, drift_mps=0.1, follow_mps=2.0)
    estimate = Estimate("vision", GeoFrame(0.0, 0.0), (0.0, 0.0, 0.0), quality, "seed", lambda: allowed[0])
    now = 0.0

    def feed(times: int, ned: tuple[float, float, float]) -> None:
        nonlocal now
        for _ in range(times):
            now += 0.02
            estimate.step(now, 0.02, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
            estimate.pose(now, ned, 0.0, 0.0)

    assert not estimate.position_ok
    feed(9, (3.0, 4.0, 0.0))
    assert not estimate.position_ok
    feed(5, (3.0, 4.0, 0.0))
    assert estimate.position_ok
    assert estimate.ned == pytest.approx((3.0, 4.0, 0.0))
    feed(25, (5.0, 4.0, 0.0))
    assert 3.8 < estimate.ned[0] < 4.2, "a jump is followed at 2 m/s"
    feed(100, (3.0, 4.0, 0.0))
    for _ in range(240):
        now += 0.02
        estimate.step(now, 0.02, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert estimate.position_ok
    assert 0.3 < math.dist(estimate.ned, (3.0, 4.0, 0.0)) < 0.6, "it drifts"
    for _ in range(20):
        now += 0.02
        estimate.step(now, 0.02, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0)
    assert not estimate.position_ok
    allowed[0] = False
    feed(20, (3.0, 4.0, 0.0))
    assert not estimate.position_ok, "EKF2_EV_CTRL 0 takes none"


def test_streams_keep_their_rates() -> None:
    streams = Streams({32: 10.0})
    found = [m for i in range(100) for m in streams.due(i * 0.02)]
    assert found.count(32) == 20
    assert found.count(0) == 2
    assert streams.set_interval(32, -1)
    assert streams.interval_us(32) == -1
    assert streams.set_interval(32, 0)
    assert streams.interval_us(32) == 100_000
    assert not streams.set_interval(9999, 1000.0)
    assert not streams.set_interval(0, -1), "heartbeats cannot be stopped"


def test_keys_and_options_are_checked() -> None:
    assert parse_key("00" * 32) == bytes(32)
    for wrong in ("", "00" * 31, "zz" * 32):
        with pytest.raises(SimulationError, match="64 hex digits"):
            parse_key(wrong)
    with pytest.raises(SimulationError, match="sysid"):
        VehicleOptions(sysid=255, port=0)
    with pytest.raises(SimulationError, match="noise_m"):
        VehicleOptions(noise_m=NAN, port=0)
    origin = parser().parse_args(["--origin=48.0,11.0,90.0,5.0,6.0"]).origin
    assert origin == GeoFrame(48.0, 11.0, math.radians(90.0), (5.0, 6.0))
