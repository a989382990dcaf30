"""How one simulated MAVLink vehicle is: its options, and the parameters that follow from them and from its body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from drivers.geodesy import GeoFrame
from sim_backends.errors import SimulationError
from sim_backends.wire import mavlink_params as tables
from sim_backends.wire.mavlink_autopilot import VehicleType
from sim_backends.wire.mavlink_estimate import Source
from sim_backends.wire.mavlink_guidance import Limits
from sim_backends.wire.mavlink_link import Address
from sim_backends.wire.mavlink_params import Params

ZURICH = GeoFrame(47.397742, 8.545594)
"""Where PX4's simulators stand."""

AutopilotName = Literal["px4", "ardupilot"]


@dataclass(frozen=True)
class VehicleOptions:
    """How one vehicle is.

    Attributes:
        autopilot: whose behaviour it has.
        sysid: MAVLink id, 1..254.
        host: address to listen on.
        port: UDP port to listen on; None: any.
        outs: where it sends to from the start.
        tcp_port: of a TCP server; None: none.
        key: for signing; None: unsigned.
        source: of its position.
        frame: of the arena on the globe.
        altitude_m: of the arena's floor above mean sea level; not 0, so that nobody mixes up altitudes.
        noise_m: of GPS; 2 cm is RTK.
        turn_radius_m: of a rover; 0 turns on the spot.
        params: other than the defaults.
    """

    autopilot: AutopilotName = "px4"
    sysid: int = 1
    host: str = "127.0.0.1"
    port: int | None = None
    outs: tuple[Address, ...] = ()
    tcp_port: int | None = None
    key: bytes | None = None
    source: Source = "gps"
    frame: GeoFrame = ZURICH
    altitude_m: float = 488.0
    noise_m: float = 0.02
    turn_radius_m: float = 0.0
    params: tuple[tuple[str, float], ...] = ()

    def __post_init__(self) -> None:
        if not 1 <= self.sysid <= 254:
            raise SimulationError(f"sysid is {self.sysid}; give 1 to 254")
        for name in ("noise_m", "turn_radius_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise SimulationError(f"{name} is {getattr(self, name)}; give m of at least 0")
        if self.port is None and not self.outs and self.tcp_port is None:
            raise SimulationError("nobody could hear the vehicle; give a port, a TCP port or an address to send to")


def build_params(options: VehicleOptions, kind: VehicleType, limits: Limits) -> Params:
    """The parameters of a vehicle whose limits are those of its body.

    Raises:
        SimulationError: when ``options.params`` names none.
    """
    rover, vision = kind == "rover", options.source == "vision"
    values: dict[str, float]
    if options.autopilot == "px4":
        table = tables.PX4_ROVER if rover else tables.PX4_COPTER
        values = {"MAV_SYS_ID": options.sysid, "MAV_TYPE": 10 if rover else 2}
        values |= {"EKF2_EV_CTRL": 15, "EKF2_GPS_CTRL": 0} if vision else {}
        if rover:
            values |= {"RO_SPEED_LIM": limits.level_mps, "RO_ACCEL_LIM": limits.accel_mps2}
        else:
            values |= {
                "MPC_ACC_HOR": limits.accel_mps2, "MPC_XY_VEL_MAX": limits.level_mps,
                "MPC_XY_CRUISE": min(5.0, limits.level_mps), "MPC_Z_VEL_MAX_UP": limits.up_mps,
                "MPC_Z_VEL_MAX_DN": limits.down_mps, "MPC_Z_V_AUTO_DN": min(1.5, limits.down_mps),
                "MPC_LAND_SPEED": min(0.7, limits.down_mps), "MPC_TKO_SPEED": min(1.5, limits.up_mps),
            }  # fmt: skip
    else:
        table = tables.ARDUPILOT_ROVER if rover else tables.ARDUPILOT_COPTER
        values = {"SYSID_THISMAV": options.sysid}
        values |= {"VISO_TYPE": 1, "EK3_SRC1_POSXY": 6} if vision else {}
        if rover:
            speed = limits.level_mps
            values |= {"WP_SPEED": speed, "CRUISE_SPEED": speed, "ATC_ACCEL_MAX": limits.accel_mps2}
        else:
            values |= {
                "WPNAV_SPEED": 100 * limits.level_mps, "WPNAV_SPEED_UP": 100 * limits.up_mps,
                "WPNAV_SPEED_DN": 100 * min(1.5, limits.down_mps), "WPNAV_ACCEL": 100 * limits.accel_mps2,
                "LAND_SPEED": min(50.0, 100 * limits.down_mps),
            }  # fmt: skip
    return Params(table, bytewise=options.autopilot == "px4", values=values | dict(options.params))
