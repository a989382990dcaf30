"""What a Crazyflie's flight is told, sees and orders: the words between the driver, the flight and the link."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from drivers.crazyflie_bits import Bits
from drivers.crazyflie_dock import DockRules
from drivers.limits import UavLimits
from drivers.vehicle import Vec3


@dataclass(frozen=True, slots=True)
class ArmOrder:
    """Ask for arming or disarming."""

    arm: bool


@dataclass(frozen=True, slots=True)
class TakeOffOrder:
    """Climb from the ground to an absolute height."""

    height_m: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class GoToOrder:
    """Fly to a point."""

    end_m: Vec3
    yaw_rad: float
    duration_s: float
    linear: bool = False


@dataclass(frozen=True, slots=True)
class LandOrder:
    """Descend to an absolute height; the motors stop there."""

    height_m: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class StopOrder:
    """Motors off and planner idle; only on the ground."""


Order = ArmOrder | TakeOffOrder | GoToOrder | LandOrder | StopOrder


class Phase(Enum):
    """What the vehicle is doing."""

    GROUND = "on the ground"
    ARMING = "arming"
    TAKEOFF = "taking off"
    FLY = "flying"
    LAND = "landing"
    DOCK = "docking"
    CONFIRM = "waiting for the charger"
    STOPPED = "stopped"


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known at one moment.

    Attributes:
        now_s: the time.
        position_m: from motion capture while fresh, else the vehicle's own estimate; None when both are stale.
        seen: ``position_m`` is from motion capture.
        yaw_rad: heading by the vehicle's own estimate, by which it flies.
        bits: the supervisor's; None before the first.
        charging: by its charger; None where it cannot tell.
        not_ready: why it must not be armed yet; None when it may.
        ground_m: height of what lies beneath it.
        pad_m: the dock that it is told to land on; None when that pose is stale.
        pad_speed_mps: how fast that dock moves.
    """

    now_s: float
    position_m: Vec3 | None = None
    seen: bool = False
    yaw_rad: float = 0.0
    bits: Bits | None = None
    charging: bool | None = None
    not_ready: str | None = None
    ground_m: float = 0.0
    pad_m: Vec3 | None = None
    pad_speed_mps: float = 0.0


@dataclass(frozen=True)
class FlightRules:
    """Numbers of ``CrazyflieOptions`` that the flight needs.

    Attributes:
        limits: of the vehicle.
        dock: of every docking; its tolerance is replaced by the pad's.
        charge_confirm_s: the charger must answer within, after touch-down.
        arm_s: the vehicle must say that it is armed within.
        acknowledge_s: a high-level command is repeated when it is not answered within.
        astray_m, astray_s: so far off the set-point for so long means that a command was lost.
        cruise: linear ``go_to`` may be used.
    """

    limits: UavLimits
    dock: DockRules
    charge_confirm_s: float = 3.0
    arm_s: float = 3.0
    acknowledge_s: float = 0.25
    astray_m: float = 0.3
    astray_s: float = 1.0
    cruise: bool = True
