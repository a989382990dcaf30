"""Parameters of the simulated autopilots: PX4 sends integers bytewise in the float field, ArduPilot as numbers.

Names, types and defaults are those of PX4 1.16 and ArduPilot 4.6 for what the simulation knows; the limits of motion
are set from the simulated body.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass

from sim_backends.errors import SimulationError

REAL32, INT8, INT16, INT32, UINT32 = 9, 2, 4, 6, 5
"""MAV_PARAM_TYPE of common.xml."""
BOUNDS = {INT8: 2**7, INT16: 2**15, INT32: 2**31}
HASH_NAME = "_HASH_CHECK"


@dataclass(frozen=True, slots=True)
class Param:
    """One parameter: its MAV_PARAM_TYPE and its value in a new vehicle."""

    type: int
    default: float


PX4_COMMON = {
    "COM_ARM_WO_GPS": Param(INT32, 1),
    "COM_DISARM_LAND": Param(REAL32, 2.0),
    "COM_DISARM_PRFLT": Param(REAL32, 10.0),
    "COM_DL_LOSS_T": Param(INT32, 10),
    "COM_FAIL_ACT_T": Param(REAL32, 5.0),
    "COM_LOW_BAT_ACT": Param(INT32, 0),
    "COM_OBL_RC_ACT": Param(INT32, 0),
    "COM_OF_LOSS_T": Param(REAL32, 1.0),
    "COM_RC_IN_MODE": Param(INT32, 4),
    "BAT_LOW_THR": Param(REAL32, 0.15),
    "BAT_CRIT_THR": Param(REAL32, 0.07),
    "BAT_EMERGEN_THR": Param(REAL32, 0.05),
    "EKF2_EV_CTRL": Param(INT32, 0),
    "EKF2_GPS_CTRL": Param(INT32, 7),
    "EKF2_NOAID_TOUT": Param(INT32, 5_000_000),
    "MAV_SYS_ID": Param(INT32, 1),
    "MAV_TYPE": Param(INT32, 2),
    "NAV_ACC_RAD": Param(REAL32, 10.0),
    "NAV_DLL_ACT": Param(INT32, 0),
    "RTL_DESCEND_ALT": Param(REAL32, 30.0),
    "RTL_MIN_DIST": Param(REAL32, 10.0),
    "RTL_RETURN_ALT": Param(REAL32, 60.0),
    "SYS_AUTOSTART": Param(INT32, 4001),
}
PX4_COPTER = PX4_COMMON | {
    "COM_SPOOLUP_TIME": Param(REAL32, 1.0),
    "MIS_TAKEOFF_ALT": Param(REAL32, 2.5),
    "MPC_ACC_HOR": Param(REAL32, 3.0),
    "MPC_LAND_ALT1": Param(REAL32, 10.0),
    "MPC_LAND_ALT2": Param(REAL32, 5.0),
    "MPC_LAND_SPEED": Param(REAL32, 0.7),
    "MPC_TKO_SPEED": Param(REAL32, 1.5),
    "MPC_XY_CRUISE": Param(REAL32, 5.0),
    "MPC_XY_VEL_MAX": Param(REAL32, 12.0),
    "MPC_Z_V_AUTO_DN": Param(REAL32, 1.5),
    "MPC_Z_VEL_MAX_DN": Param(REAL32, 1.5),
    "MPC_Z_VEL_MAX_UP": Param(REAL32, 3.0),
}
PX4_ROVER = PX4_COMMON | {
    "NAV_ACC_RAD": Param(REAL32, 0.5),
    "RO_ACCEL_LIM": Param(REAL32, 1.0),
    "RO_SPEED_LIM": Param(REAL32, 2.0),
    "RO_YAW_RATE_LIM": Param(REAL32, 90.0),
}
ARDUPILOT_COMMON = {
    "ARMING_CHECK": Param(INT32, 1),
    "BATT_CRT_MAH": Param(REAL32, 0.0),
    "BATT_FS_CRT_ACT": Param(INT8, 0),
    "BATT_FS_LOW_ACT": Param(INT8, 0),
    "BATT_LOW_MAH": Param(REAL32, 0.0),
    "EK3_SRC1_POSXY": Param(INT8, 3),
    "FS_GCS_ENABLE": Param(INT8, 0),
    "FS_GCS_TIMEOUT": Param(REAL32, 5.0),
    "GUID_TIMEOUT": Param(REAL32, 3.0),
    "SYSID_MYGCS": Param(INT16, 255),
    "SYSID_THISMAV": Param(INT16, 1),
    "VISO_TYPE": Param(INT8, 0),
    **{
        f"SR0_{name}": Param(INT16, 0)
        for name in ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS")
    },
}
ARDUPILOT_COPTER = ARDUPILOT_COMMON | {
    "DISARM_DELAY": Param(INT8, 10),
    "FRAME_CLASS": Param(INT8, 1),
    "FS_EKF_ACTION": Param(INT8, 1),
    "GUID_OPTIONS": Param(INT32, 0),
    "LAND_ALT_LOW": Param(REAL32, 1000.0),
    "LAND_SPEED": Param(REAL32, 50.0),
    "LAND_SPEED_HIGH": Param(REAL32, 0.0),
    "RTL_ALT": Param(REAL32, 1500.0),
    "RTL_LOIT_TIME": Param(REAL32, 5000.0),
    "WPNAV_ACCEL": Param(REAL32, 250.0),
    "WPNAV_SPEED": Param(REAL32, 1000.0),
    "WPNAV_SPEED_DN": Param(REAL32, 150.0),
    "WPNAV_SPEED_UP": Param(REAL32, 250.0),
}
ARDUPILOT_ROVER = ARDUPILOT_COMMON | {
    "ATC_ACCEL_MAX": Param(REAL32, 1.0),
    "CRUISE_SPEED": Param(REAL32, 2.0),
    "FS_ACTION": Param(INT8, 2),
    "FS_TIMEOUT": Param(REAL32, 1.5),
    "TURN_RADIUS": Param(REAL32, 0.9),
    "WP_RADIUS": Param(REAL32, 2.0),
    "WP_SPEED": Param(REAL32, 2.0),
}


def encode(type_: int, value: float, *, bytewise: bool) -> float:
    """The float that goes on the wire.

    Args:
        type_: MAV_PARAM_TYPE.
        value: of the parameter.
        bytewise: PX4's way: the bytes of the integer, whatever float they make.
    """
    if type_ == REAL32 or not bytewise:
        return value
    code = "<I" if type_ == UINT32 else "<i"
    return float(struct.unpack("<f", struct.pack(code, int(value)))[0])


def decode(type_: int, wire: float, *, bytewise: bool) -> float:
    """The value of a float from the wire; the inverse of ``encode``."""
    if type_ == REAL32:
        return wire
    if bytewise:
        return float(struct.unpack("<i", struct.pack("<f", wire))[0])
    return float(math.trunc(wire)) if math.isfinite(wire) else math.nan


class Params:
    """The parameters of one vehicle, by name in alphabetical order, which is their index."""

    def __init__(
        self, table: Mapping[str, Param], *, bytewise: bool, values: Mapping[str, float] | None = None
    ) -> None:
        """Takes a table of parameters.

        Args:
            table: what there is.
            bytewise: encoding of integers (PX4).
            values: other than the defaults.

        Raises:
            SimulationError: when ``values`` names none of the table or does not fit its type.
        """
        self.bytewise = bytewise
        self.names = tuple(sorted(table))
        self.types = {name: table[name].type for name in self.names}
        self._values = {name: table[name].default for name in self.names}
        for name, value in (values or {}).items():
            if not self.put(name, value):
                raise SimulationError(f"parameter {name} cannot be {value!r}; there are {', '.join(self.names)}")

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __contains__(self, name: str) -> bool:
        return name in self._values

    def put(self, name: str, value: float) -> bool:
        """Sets a parameter; False where there is none or the value does not fit its type."""
        if name not in self._values or not math.isfinite(value):
            return False
        bound = BOUNDS.get(self.types[name])
        if bound is not None and not -bound <= value < bound:
            return False
        self._values[name] = value if bound is None else float(int(value))
        return True

    def put_wire(self, name: str, wire: float) -> bool:
        """As ``put``, from the wire; the type is the vehicle's own, as in both firmwares."""
        return name in self._values and self.put(name, decode(self.types[name], wire, bytewise=self.bytewise))

    def wire(self, name: str) -> float:
        """The value as it goes on the wire."""
        return encode(self.types[name], self._values[name], bytewise=self.bytewise)

    @property
    def hash(self) -> int:
        """PX4's check word, by which a ground station knows that its copy is current."""
        return zlib.crc32("".join(f"{n}={self._values[n]!r};" for n in self.names).encode())
