"""ArduPilot's dialect (4.3 to 4.6). Sources: ArduCopter's ``mode.h`` and ``events.cpp``, Rover's ``failsafe.cpp``."""

from __future__ import annotations

from drivers import mavlink_words as w
from drivers.mavlink_dialect import Dialect, Parameters
from drivers.vehicle import SelfCheck

COPTER_GUIDED, COPTER_LAND, ROVER_GUIDED = 4, 9, 15
COPTER_LOSS = {
    0: "does nothing", 1: "returns", 2: "goes on", 3: "returns the way it came", 4: "returns the way it came or lands",
    5: "lands", 6: "lands by its mission or returns", 7: "brakes and lands",
}  # fmt: skip
ROVER_LOSS = {0: "does nothing", 1: "returns", 2: "holds", 3: "returns the way it came", 5: "terminates"}


def copter_mode(mode: int) -> str:
    """``custom_mode`` in words."""
    return w.COPTER_MODES.get(mode, f"mode {mode}")


def rover_mode(mode: int) -> str:
    """``custom_mode`` in words."""
    return w.ROVER_MODES.get(mode, f"mode {mode}")


def copter_death(parameters: Parameters, system_id: int) -> list[SelfCheck]:
    """What ArduCopter does when this program dies: position targets persist, only the GCS failsafe ends the flight."""
    action = parameters.get("FS_GCS_ENABLE")
    found = [_listens(parameters, system_id)]
    if action is None:
        found.append(SelfCheck("link loss", "not run", "FS_GCS_ENABLE could not be read; look it up by hand"))
        return found
    does = COPTER_LOSS.get(round(action), f"does {action:g}")
    options = round(parameters.get("FS_OPTIONS", 0.0))
    after_s = parameters.get("FS_GCS_TIMEOUT", 5.0)
    if round(action) not in (5, 7):
        text = f"without heartbeats it {does} (FS_GCS_ENABLE); set it to 5 (land)"
        found.append(SelfCheck("link loss", "warn", text, after_s, "s"))
    elif options & 1 << 4:
        # bit 4: "Continue if in pilot controlled modes on GCS failsafe" does not concern GUIDED, but says intent
        text = f"{does} {after_s:g} s after the last heartbeat, but not in a pilot's mode (FS_OPTIONS bit 4)"
        found.append(SelfCheck("link loss", "pass", text, after_s, "s"))
    elif after_s > 10.0:
        text = f"waits {after_s:g} s before it {does} (FS_GCS_TIMEOUT); set it to 5"
        found.append(SelfCheck("link loss", "warn", text, after_s, "s"))
    else:
        found.append(SelfCheck("link loss", "pass", f"{does} {after_s:g} s after the last heartbeat", after_s, "s"))
    return found


def rover_death(parameters: Parameters, system_id: int) -> list[SelfCheck]:
    """The same for a rover: velocities time out after 3 s (``Rover/mode_guided.cpp``), the failsafe holds."""
    found = [_listens(parameters, system_id)]
    enabled, action = parameters.get("FS_GCS_ENABLE"), parameters.get("FS_ACTION")
    if enabled is None or action is None:
        text = "FS_GCS_ENABLE or FS_ACTION could not be read; look them up by hand"
        found.append(SelfCheck("link loss", "not run", text))
    elif round(enabled) == 0 or round(action) not in (2, 5):
        does = "does nothing" if round(enabled) == 0 else ROVER_LOSS.get(round(action), f"does {action:g}")
        text = f"without heartbeats it {does}; set FS_GCS_ENABLE to 1 and FS_ACTION to 2 (hold)"
        found.append(SelfCheck("link loss", "warn", text))
    else:
        found.append(SelfCheck("link loss", "pass", f"{ROVER_LOSS[round(action)]} without heartbeats"))
    return found


def _listens(parameters: Parameters, system_id: int) -> SelfCheck:
    """Whether the GCS failsafe listens to this ground station at all."""
    name, value = "ground station id", parameters.get("SYSID_MYGCS", parameters.get("MAV_GCS_SYSID"))
    if value is None:
        return SelfCheck(name, "not run", "SYSID_MYGCS (4.7: MAV_GCS_SYSID) could not be read; look it up by hand")
    if round(value) != system_id:
        text = f"its failsafe waits for heartbeats of system {value:g}, not of ours; set SYSID_MYGCS to {system_id}"
        return SelfCheck(name, "warn", text, value)
    return SelfCheck(name, "pass", f"its failsafe listens to system {system_id}", value)


IDS = ("SYSID_MYGCS", "MAV_GCS_SYSID")
COPTER = Dialect(
    name="ArduPilot",
    guided=COPTER_GUIDED,
    guided_parameters=(COPTER_GUIDED, 0.0),
    landing_parameters=(COPTER_LAND, 0.0),
    streams_on_ground=False,
    lifts_by_command=True,
    turns_on_spot_by_rate=True,
    terminates=False,
    bytewise=False,
    wants_origin=True,
    estimator=("EKF_STATUS_REPORT", w.EKF_STATUS_REPORT),
    parameters=("FS_GCS_ENABLE", "FS_GCS_TIMEOUT", "FS_OPTIONS", "FS_EKF_ACTION", "DISARM_DELAY", *IDS),
    returns=w.COPTER_RETURNS,
    mode_name=copter_mode,
    by_pilot=w.COPTER_PILOT.__contains__,
    death_checks=copter_death,
)
ROVER = Dialect(
    name="ArduPilot",
    guided=ROVER_GUIDED,
    guided_parameters=(ROVER_GUIDED, 0.0),
    landing_parameters=None,
    streams_on_ground=False,
    lifts_by_command=False,
    turns_on_spot_by_rate=True,
    terminates=False,
    bytewise=False,
    wants_origin=True,
    estimator=("EKF_STATUS_REPORT", w.EKF_STATUS_REPORT),
    parameters=("FS_GCS_ENABLE", "FS_ACTION", "FS_TIMEOUT", *IDS),
    returns=frozenset(),
    mode_name=rover_mode,
    by_pilot=w.ROVER_PILOT.__contains__,
    death_checks=rover_death,
)
