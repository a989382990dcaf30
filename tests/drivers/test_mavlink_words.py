"""The numbers that the drivers repeat are MAVLink's, and the firmwares' tables are judged rightly."""

from __future__ import annotations

import pytest

from drivers import mavlink_ardupilot, mavlink_px4
from drivers import mavlink_words as w
from drivers.mavlink_dialect import described, kind_of
from drivers.mavlink_link import mavlink as m


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (w.ARDUPILOT, m.MAV_AUTOPILOT_ARDUPILOTMEGA),
        (w.PX4, m.MAV_AUTOPILOT_PX4),
        (w.NO_AUTOPILOT, m.MAV_AUTOPILOT_INVALID),
        (w.GCS_TYPE, m.MAV_TYPE_GCS),
        (w.CUSTOM_MODE, m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED),
        (w.ARMED_FLAG, m.MAV_MODE_FLAG_SAFETY_ARMED),
        (w.STANDBY, m.MAV_STATE_STANDBY),
        (w.ACTIVE, m.MAV_STATE_ACTIVE),
        (w.TERMINATION, m.MAV_STATE_FLIGHT_TERMINATION),
        (w.ON_GROUND, m.MAV_LANDED_STATE_ON_GROUND),
        (w.IN_AIR, m.MAV_LANDED_STATE_IN_AIR),
        (w.TAKING_OFF, m.MAV_LANDED_STATE_TAKEOFF),
        (w.LANDING, m.MAV_LANDED_STATE_LANDING),
        (w.NAV_TAKEOFF, m.MAV_CMD_NAV_TAKEOFF),
        (w.DO_SET_MODE, m.MAV_CMD_DO_SET_MODE),
        (w.DO_FLIGHT_TERMINATION, m.MAV_CMD_DO_FLIGHTTERMINATION),
        (w.ARM_DISARM, m.MAV_CMD_COMPONENT_ARM_DISARM),
        (w.SET_MESSAGE_INTERVAL, m.MAV_CMD_SET_MESSAGE_INTERVAL),
        (w.REQUEST_MESSAGE, m.MAV_CMD_REQUEST_MESSAGE),
        (w.ACCEPTED, m.MAV_RESULT_ACCEPTED),
        (w.BUSY, m.MAV_RESULT_TEMPORARILY_REJECTED),
        (w.DENIED, m.MAV_RESULT_DENIED),
        (w.UNSUPPORTED, m.MAV_RESULT_UNSUPPORTED),
        (w.FAILED, m.MAV_RESULT_FAILED),
        (w.IN_PROGRESS, m.MAV_RESULT_IN_PROGRESS),
        (w.HEARTBEAT, m.MAVLINK_MSG_ID_HEARTBEAT),
        (w.SYS_STATUS, m.MAVLINK_MSG_ID_SYS_STATUS),
        (w.GPS_RAW_INT, m.MAVLINK_MSG_ID_GPS_RAW_INT),
        (w.ATTITUDE, m.MAVLINK_MSG_ID_ATTITUDE),
        (w.LOCAL_POSITION, m.MAVLINK_MSG_ID_LOCAL_POSITION_NED),
        (w.GLOBAL_POSITION, m.MAVLINK_MSG_ID_GLOBAL_POSITION_INT),
        (w.GPS_GLOBAL_ORIGIN, m.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN),
        (w.BATTERY_STATUS, m.MAVLINK_MSG_ID_BATTERY_STATUS),
        (w.AUTOPILOT_VERSION, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION),
        (w.EKF_STATUS_REPORT, m.MAVLINK_MSG_ID_EKF_STATUS_REPORT),
        (w.ESTIMATOR_STATUS, m.MAVLINK_MSG_ID_ESTIMATOR_STATUS),
        (w.EXTENDED_SYS_STATE, m.MAVLINK_MSG_ID_EXTENDED_SYS_STATE),
        (w.LOCAL_NED, m.MAV_FRAME_LOCAL_NED),
        (w.GLOBAL_INT, m.MAV_FRAME_GLOBAL_INT),
        (w.IGNORE_POSITION, 1 | 2 | 4),
        (w.IGNORE_VELOCITY, m.POSITION_TARGET_TYPEMASK_VX_IGNORE * 7),
        (w.IGNORE_ACCELERATION, m.POSITION_TARGET_TYPEMASK_AX_IGNORE * 7),
        (w.IGNORE_YAW, m.POSITION_TARGET_TYPEMASK_YAW_IGNORE),
        (w.IGNORE_YAW_RATE, m.POSITION_TARGET_TYPEMASK_YAW_RATE_IGNORE),
        (w.CHARGE_UNDEFINED, m.MAV_BATTERY_CHARGE_STATE_UNDEFINED),
        (w.CHARGE_CHARGING, m.MAV_BATTERY_CHARGE_STATE_CHARGING),
        (w.SENSOR_RC_RECEIVER, m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER),
        (w.SENSOR_PREARM, m.MAV_SYS_STATUS_PREARM_CHECK),
        (w.EKF_ATTITUDE, m.ESTIMATOR_ATTITUDE),
        (w.EKF_ATTITUDE, m.EKF_ATTITUDE),
        (w.EKF_VELOCITY_HORIZONTAL, m.ESTIMATOR_VELOCITY_HORIZ),
        (w.EKF_VELOCITY_HORIZONTAL, m.EKF_VELOCITY_HORIZ),
        (w.EKF_POSITION_RELATIVE, m.EKF_POS_HORIZ_REL),
        (w.EKF_POSITION_ABSOLUTE, m.EKF_POS_HORIZ_ABS),
        (w.EKF_ALTITUDE, m.EKF_POS_VERT_ABS),
        (w.EKF_CONSTANT_POSITION, m.EKF_CONST_POS_MODE),
        (w.WARNING, m.MAV_SEVERITY_WARNING),
    ],
)
def test_numbers_are_those_of_the_protocol(ours: int, theirs: int) -> None:
    assert ours == theirs


def test_copters_and_rovers_are_told_apart() -> None:
    assert kind_of(m.MAV_TYPE_QUADROTOR) == kind_of(m.MAV_TYPE_DODECAROTOR) == "uav"
    assert kind_of(m.MAV_TYPE_GROUND_ROVER) == "ugv"
    assert kind_of(m.MAV_TYPE_FIXED_WING) is None
    assert described(12, 2) == "PX4 quadrotor"
    assert "MAV_TYPE 1" in described(3, 1)


@pytest.mark.parametrize(
    ("main", "sub", "name", "pilot"),
    [(6, 0, "OFFBOARD", False), (4, 6, "LAND", False), (4, 5, "RETURN", False), (3, 0, "POSCTL", True)],
)
def test_px4_modes(main: int, sub: int, name: str, pilot: bool) -> None:
    mode = mavlink_px4.custom_mode(main, sub)
    assert mavlink_px4.mode_name(mode) == name
    assert mavlink_px4.by_pilot(mode) is pilot


def test_guided_modes_are_nobodys_but_ours() -> None:
    for dialect in (mavlink_px4.COPTER, mavlink_px4.ROVER, mavlink_ardupilot.COPTER, mavlink_ardupilot.ROVER):
        assert not dialect.by_pilot(dialect.guided)
        assert dialect.mode_name(dialect.guided) in ("OFFBOARD", "GUIDED")


@pytest.mark.parametrize(
    ("parameters", "verdicts"),
    [
        ({"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 4.0, "NAV_DLL_ACT": 3.0}, ["pass", "pass"]),
        ({"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 0.0, "NAV_DLL_ACT": 0.0}, ["warn", "warn"]),
        ({"COM_OF_LOSS_T": 20.0, "COM_OBL_RC_ACT": 4.0, "NAV_DLL_ACT": 2.0}, ["warn", "warn"]),
        ({}, ["not run", "not run"]),
    ],
)
def test_what_px4_does_when_we_die(parameters: dict[str, float], verdicts: list[str]) -> None:
    assert [c.verdict for c in mavlink_px4.copter_death(parameters, 255)] == verdicts


@pytest.mark.parametrize(
    ("parameters", "verdicts"),
    [
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 5.0}, ["pass", "pass"]),
        ({"SYSID_MYGCS": 252.0, "FS_GCS_ENABLE": 5.0}, ["warn", "pass"]),
        ({"MAV_GCS_SYSID": 255.0, "FS_GCS_ENABLE": 0.0}, ["pass", "warn"]),
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 1.0}, ["pass", "warn"]),
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 5.0, "FS_GCS_TIMEOUT": 60.0}, ["pass", "warn"]),
        ({}, ["not run", "not run"]),
    ],
)
def test_what_arducopter_does_when_we_die(parameters: dict[str, float], verdicts: list[str]) -> None:
    assert [c.verdict for c in mavlink_ardupilot.copter_death(parameters, 255)] == verdicts


@pytest.mark.parametrize(
    ("parameters", "verdict"),
    [
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 1.0, "FS_ACTION": 2.0}, "pass"),
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 0.0, "FS_ACTION": 2.0}, "warn"),
        ({"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 1.0, "FS_ACTION": 1.0}, "warn"),
        ({}, "not run"),
    ],
)
def test_what_a_rover_does_when_we_die(parameters: dict[str, float], verdict: str) -> None:
    assert mavlink_ardupilot.rover_death(parameters, 255)[-1].verdict == verdict
    assert mavlink_px4.rover_death({"COM_OF_LOSS_T": 1.0, "COM_OBL_RC_ACT": 5.0, "NAV_DLL_ACT": 1.0}, 255)[
        0
    ].verdict == ("pass")
