"""The numbers of MAVLink that the drivers use; names and values from ``common.xml``, PX4 and ArduPilot.

They are repeated here so that everything that decides can be read and tested without the SDK; a test compares them
with pymavlink's own. Modes: PX4 ``px4_custom_mode.h``; ArduPilot ``ArduCopter/mode.h`` and ``Rover/mode.h``.
"""

from __future__ import annotations

from typing import Final

# MAV_AUTOPILOT, MAV_TYPE
ARDUPILOT: Final = 3
PX4: Final = 12
GCS_TYPE: Final = 6
NO_AUTOPILOT: Final = 8
COPTERS: Final = {
    2: "quadrotor",
    3: "coaxial copter",
    4: "helicopter",
    13: "hexarotor",
    14: "octorotor",
    15: "tricopter",
    29: "dodecarotor",
}
ROVERS: Final = {10: "ground rover"}
AUTOPILOT_COMPONENT: Final = 1

# MAV_MODE_FLAG
CUSTOM_MODE: Final = 1
ARMED_FLAG: Final = 128

# MAV_STATE
STANDBY, ACTIVE, CRITICAL, EMERGENCY, TERMINATION = 3, 4, 5, 6, 8

# MAV_LANDED_STATE
ON_GROUND, IN_AIR, TAKING_OFF, LANDING = 1, 2, 3, 4

# MAV_CMD
NAV_TAKEOFF: Final = 22
DO_SET_MODE: Final = 176
DO_FLIGHT_TERMINATION: Final = 185
ARM_DISARM: Final = 400
SET_MESSAGE_INTERVAL: Final = 511
REQUEST_MESSAGE: Final = 512
FORCE: Final = 21196.0
"""Magic second parameter of ``ARM_DISARM``: in the air, too."""

# MAV_RESULT
ACCEPTED, BUSY, DENIED, UNSUPPORTED, FAILED, IN_PROGRESS, CANCELLED = range(7)
RESULTS: Final = {
    BUSY: "temporarily rejected",
    DENIED: "denied",
    UNSUPPORTED: "not supported",
    FAILED: "failed",
    CANCELLED: "cancelled",
}

# message ids
HEARTBEAT, SYS_STATUS, GPS_RAW_INT, ATTITUDE, LOCAL_POSITION, GLOBAL_POSITION = 0, 1, 24, 30, 32, 33
GPS_GLOBAL_ORIGIN, BATTERY_STATUS, AUTOPILOT_VERSION = 49, 147, 148
EKF_STATUS_REPORT, ESTIMATOR_STATUS, EXTENDED_SYS_STATE = 193, 230, 245

# MAV_FRAME
GLOBAL, LOCAL_NED, GLOBAL_INT = 0, 1, 5

# POSITION_TARGET_TYPEMASK: what to ignore
IGNORE_POSITION, IGNORE_VELOCITY, IGNORE_ACCELERATION = 0b111, 0b111000, 0b111000000
IGNORE_YAW, IGNORE_YAW_RATE = 1 << 10, 1 << 11

# MAV_BATTERY_CHARGE_STATE
CHARGE_UNDEFINED, CHARGE_CHARGING = 0, 7

# MAV_SYS_STATUS_SENSOR
SENSOR_RC_RECEIVER: Final = 1 << 16
SENSOR_PREARM: Final = 1 << 28

# ESTIMATOR_STATUS_FLAGS and EKF_STATUS_FLAGS (the same bits)
EKF_ATTITUDE, EKF_VELOCITY_HORIZONTAL, EKF_POSITION_RELATIVE, EKF_POSITION_ABSOLUTE, EKF_ALTITUDE = 1, 2, 8, 16, 32
EKF_CONSTANT_POSITION: Final = 128

# MAV_PARAM_TYPE of integers, which PX4 sends byte by byte inside the float
INTEGERS: Final = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i"}

# severities of STATUSTEXT up to which a text may explain a refusal (MAV_SEVERITY_WARNING and worse)
WARNING: Final = 4

COPTER_MODES: Final = {
    0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
    11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW", 20: "GUIDED_NOGPS",
    21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG",
}  # fmt: skip
COPTER_RETURNS: Final = frozenset({6, 9, 21, 27})
"""RTL, LAND, SMART_RTL, AUTO_RTL."""
COPTER_PILOT: Final = frozenset({0, 1, 2, 5, 11, 13, 14, 15, 16, 22, 24})
ROVER_MODES: Final = {
    0: "MANUAL", 1: "ACRO", 3: "STEERING", 4: "HOLD", 5: "LOITER", 6: "FOLLOW", 7: "SIMPLE", 10: "AUTO", 11: "RTL",
    12: "SMART_RTL", 15: "GUIDED", 16: "INITIALISING",
}  # fmt: skip
ROVER_PILOT: Final = frozenset({0, 1, 3, 7})

PX4_MAIN: Final = {
    1: "MANUAL", 2: "ALTCTL", 3: "POSCTL", 4: "AUTO", 5: "ACRO", 6: "OFFBOARD", 7: "STABILIZED", 8: "RATTITUDE",
    9: "SIMPLE", 10: "TERMINATION",
}  # fmt: skip
PX4_AUTO: Final = {
    1: "READY", 2: "TAKEOFF", 3: "HOLD", 4: "MISSION", 5: "RETURN", 6: "LAND", 8: "FOLLOW", 9: "PRECISION LAND",
}  # fmt: skip
PX4_PILOT: Final = frozenset({1, 2, 3, 5, 7, 8})
