"""MAVLink vehicles behind the drivers' interface: copters and rovers of PX4 and ArduPilot, and poses by satellites.

Heights outdoors: every vehicle's arena floor is the height above sea level by its own estimate where it stood when it
connected, and again whenever it is armed on the ground, less the height of the pad it stands on. So neither errors
between receivers nor the hour's drift of a barometer reach the missions, and homes that autopilots move do not matter.
It takes the arena for level. A rover's z is 0 by definition: it drives on the floor.
"""

from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_poses import TelemetryPoses
from drivers.mavlink_uav import MavlinkUav
from drivers.mavlink_ugv import MavlinkUgv

__all__ = ["MavlinkOptions", "MavlinkUav", "MavlinkUgv", "TelemetryPoses"]
