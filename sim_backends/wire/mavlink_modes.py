"""The flight modes of PX4 and ArduPilot: their numbers in the heartbeat and what a vehicle does in them."""

from __future__ import annotations

from sim_backends.wire.mavlink_autopilot import AUTO, CUSTOM, GUIDED, MANUAL, STABILIZE, Does, Mode


def px4_number(main: int, sub: int = 0) -> int:
    """custom_mode of a main and a sub mode (``px4_custom_mode.h``)."""
    return main << 16 | sub << 24


PX4_PILOT = CUSTOM | STABILIZE | MANUAL
PX4_SELF = CUSTOM | STABILIZE | GUIDED | AUTO
PX4_MODES = {
    "MANUAL": Mode(px4_number(1), Does.MANUAL, CUSTOM | MANUAL, position=False),
    "ALTCTL": Mode(px4_number(2), Does.MANUAL, PX4_PILOT, position=False),
    "POSCTL": Mode(px4_number(3), Does.HOLD, PX4_PILOT),
    "TAKEOFF": Mode(px4_number(4, 2), Does.TAKEOFF, PX4_SELF),
    "HOLD": Mode(px4_number(4, 3), Does.HOLD, PX4_SELF),
    "RTL": Mode(px4_number(4, 5), Does.RTL, PX4_SELF, arms=False),
    "LAND": Mode(px4_number(4, 6), Does.LAND, PX4_SELF, arms=False),
    "ACRO": Mode(px4_number(5), Does.MANUAL, CUSTOM | MANUAL, position=False),
    "OFFBOARD": Mode(px4_number(6), Does.FOLLOW, CUSTOM | STABILIZE),
    "STABILIZED": Mode(px4_number(7), Does.MANUAL, PX4_PILOT, position=False),
    # not to be asked for: PX4 shows blind descent as LAND and termination as MANUAL
    "DESCEND": Mode(px4_number(4, 6), Does.SINK, PX4_SELF, arms=False, position=False),
}
"""``px4_custom_mode.h``; ``get_px4_custom_mode``."""

ARDUPILOT_BASE = CUSTOM | STABILIZE | MANUAL
COPTER_MODES = {
    "STABILIZE": Mode(0, Does.MANUAL, ARDUPILOT_BASE, position=False),
    "ALT_HOLD": Mode(2, Does.MANUAL, ARDUPILOT_BASE, position=False),
    "GUIDED": Mode(4, Does.FOLLOW, ARDUPILOT_BASE | GUIDED),
    "LOITER": Mode(5, Does.HOLD, ARDUPILOT_BASE | GUIDED),
    "RTL": Mode(6, Does.RTL, ARDUPILOT_BASE | GUIDED, arms=False),
    "LAND": Mode(9, Does.LAND, ARDUPILOT_BASE, arms=False, position=False),
    "POSHOLD": Mode(16, Does.HOLD, ARDUPILOT_BASE | GUIDED),
    "BRAKE": Mode(17, Does.HOLD, ARDUPILOT_BASE | GUIDED, arms=False),
    "SMART_RTL": Mode(21, Does.RTL, ARDUPILOT_BASE | GUIDED, arms=False),
}
ROVER_MODES = {
    "MANUAL": Mode(0, Does.MANUAL, CUSTOM | MANUAL, position=False),
    "STEERING": Mode(3, Does.MANUAL, ARDUPILOT_BASE),
    "HOLD": Mode(4, Does.HOLD, ARDUPILOT_BASE, position=False),
    "LOITER": Mode(5, Does.HOLD, ARDUPILOT_BASE | GUIDED),
    "RTL": Mode(11, Does.RTL, ARDUPILOT_BASE | GUIDED),
    "SMART_RTL": Mode(12, Does.RTL, ARDUPILOT_BASE | GUIDED),
    "GUIDED": Mode(15, Does.FOLLOW, ARDUPILOT_BASE | GUIDED),
}
"""ArduPilot's numbers are those of ``mode.h`` of each vehicle."""
