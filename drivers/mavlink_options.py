"""How the MAVLink drivers talk and how long they wait."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from pathlib import Path

from drivers.errors import DriverError


@dataclass(frozen=True, slots=True)
class MavlinkOptions:
    """Options of one MAVLink vehicle; validate themselves.

    Attributes:
        system_id: of this ground station; ArduPilot's GCS failsafe listens to ``SYSID_MYGCS``, by default 255.
        component_id: of this ground station, MAV_COMP_ID_MISSIONPLANNER.
        baud: of serial endpoints; 57600 is what telemetry radios are delivered with.
        signing_key_file: file with 32 bytes, or 64 hexadecimal digits; None: unsigned.
        heartbeat_hz: the protocol asks for 1; at 2 a lossy radio does not trip failsafes of 3 to 5 s.
        setpoint_hz: of streamed set-points; PX4 wants 2 Hz at least, 20 Hz is usual.
        pose_hz: most poses a second that are handed to the estimator; more than 50 Hz gains nothing.
        telemetry_hz: of attitude and position; the loop's limit on stale poses is 0.5 s.
        status_hz: of battery, landed state and sensors.
        loop_silence_s: heartbeats and set-points stop when the control loop has not called for so long, so that the
            vehicle's own failsafe acts: whoever keeps them up hides a dead application.
        link_timeout_s: a vehicle whose heartbeat is older is unreachable.
        pose_stale_s: who flies or drives by poses does not act on older ones; as the supervisor's own limit.
        arm_timeout_s: for mode and arming together; PX4 needs set-points before, heartbeats come once a second.
        takeoff_timeout_s: to leave the ground.
        land_timeout_s: to be landed after the reference has reached the floor; then the autopilot's own landing mode.
        takeoff_step_m: ArduPilot's own take-off climbs so high; above, set-points limit the speed.
        touchdown_mps: most vertical speed in the last ``touchdown_m`` above the floor.
        touchdown_m: see ``touchdown_mps``; satellite and barometric heights wander by metres within an hour.
        charge_confirm_s: a docked UAV whose charger has not confirmed takes off again; the supervisor waits 10 s.
        floor_amsl_m: outdoors, height of the arena's floor above mean sea level by this vehicle's own estimate; None:
            measured when it connects, standing on the floor. Not ``relative_alt``: autopilots move their home
            when they arm, also on a UGV's pad.
        indoor_origin_deg: latitude and longitude told to an ArduPilot without GPS, which needs some origin for its
            local frame; only its model of the magnetic field looks at it.
    """

    system_id: int = 255
    component_id: int = 190
    baud: int = 57600
    signing_key_file: Path | None = None
    heartbeat_hz: float = 2.0
    setpoint_hz: float = 20.0
    pose_hz: float = 50.0
    telemetry_hz: float = 20.0
    status_hz: float = 4.0
    loop_silence_s: float = 1.0
    link_timeout_s: float = 4.0
    pose_stale_s: float = 0.5
    arm_timeout_s: float = 10.0
    takeoff_timeout_s: float = 15.0
    land_timeout_s: float = 10.0
    takeoff_step_m: float = 2.0
    touchdown_mps: float = 0.5
    touchdown_m: float = 3.0
    charge_confirm_s: float = 5.0
    floor_amsl_m: float | None = None
    indoor_origin_deg: tuple[float, float] = (47.397742, 8.545594)

    def __post_init__(self) -> None:
        for name in ("system_id", "component_id"):
            if not 1 <= getattr(self, name) <= 255:
                raise DriverError(f"MAVLink options: {name} is {getattr(self, name)!r}; give 1 to 255")
        for field in fields(self):
            if field.name.endswith(("_hz", "_s", "_mps")) or field.name in ("baud", "takeoff_step_m", "touchdown_m"):
                value = getattr(self, field.name)
                if not (math.isfinite(value) and value > 0):
                    raise DriverError(f"MAVLink options: {field.name} is {value!r}; give a number above 0")
        if self.setpoint_hz < 2.0:
            raise DriverError(f"MAVLink options: setpoint_hz is {self.setpoint_hz}; PX4 wants 2 at least")
        if self.floor_amsl_m is not None and not math.isfinite(self.floor_amsl_m):
            raise DriverError(f"MAVLink options: floor_amsl_m is {self.floor_amsl_m}; give m or leave it out")
        lat, lon = self.indoor_origin_deg
        if not (-90 <= lat <= 90 and -180 <= lon <= 180):
            raise DriverError(f"MAVLink options: indoor_origin_deg is {self.indoor_origin_deg}; give degrees")
