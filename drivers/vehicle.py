"""The interface to every vehicle, real or simulated, and the words it speaks: commands, states, poses.

All positions are in the arena frame in m (z up, 0 on the floor), all times on the loop's clock in s. Commands are
absolute and idempotent: sending one again changes nothing, so that a lost one can be repeated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol

from drivers.last_will import LastWill

Kind = Literal["uav", "ugv"]
Vec2 = tuple[float, float]
Vec3 = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Pose:
    """One rigid body as motion capture saw it; ``stamp_s`` is the time of receipt. Every number is finite."""

    body: str
    position_m: Vec3
    yaw_rad: float
    stamp_s: float


@dataclass(frozen=True, slots=True)
class VehicleState:
    """The newest telemetry of one vehicle.

    Attributes:
        vehicle: its id.
        stamp_s: receipt of the newest telemetry.
        link: the link is up as far as the SDK knows.
        armed: motors may turn (a UGV: it may drive).
        airborne: the UAV flies by its own judgement.
        tumbled: upside down or crashed by its own judgement.
        locked: motors stopped until it is rebooted or reset.
        charging: its charger says so.
        battery: usable energy left, 0..1; None where it cannot be told.
        fault: the vehicle's own words about what is wrong.
    """

    vehicle: str
    stamp_s: float
    link: bool
    armed: bool
    airborne: bool = False
    tumbled: bool = False
    locked: bool = False
    charging: bool = False
    battery: float | None = None
    fault: str | None = None


@dataclass(frozen=True, slots=True)
class SelfCheck:
    """One finding of a driver about its own vehicle before the start.

    Attributes:
        name: what was looked at, in one or two words: ``estimator``, ``firmware``, ``mode``, ``radio``.
        verdict: ``not run`` where the vehicle cannot tell.
        text: what was found and, unless it passed, what to do.
        value, unit: where it was measured.
    """

    name: str
    verdict: Literal["pass", "warn", "fail", "not run"]
    text: str
    value: float | None = None
    unit: str = ""


@dataclass(frozen=True, slots=True)
class Arm:
    """Allow the vehicle to move."""

    vehicle: str


@dataclass(frozen=True, slots=True)
class Disarm:
    """Forbid the vehicle to move; refused in the air."""

    vehicle: str


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Climb vertically to ``altitude_m`` (absolute) and hover there; from a UGV's pad as well."""

    vehicle: str
    altitude_m: float
    speed_mps: float


@dataclass(frozen=True, slots=True)
class GoTo:
    """Fly straight to ``position_m``, rest to rest, at ``speed_mps`` at the most, and hover there."""

    vehicle: str
    position_m: Vec3
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Land:
    """Descend vertically to the floor and stop the motors."""

    vehicle: str
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Dock:
    """Land on dock ``dock`` of UGV ``onto``, tracking its pad; abort upward to ``abort_altitude_m`` when misaligned."""

    vehicle: str
    onto: str
    dock: int
    speed_mps: float
    abort_altitude_m: float


@dataclass(frozen=True, slots=True)
class Drive:
    """Drive along ``path_m`` (the first point is near the vehicle) at ``speed_mps`` at the most; stop at its end."""

    vehicle: str
    path_m: tuple[Vec2, ...]
    speed_mps: float


@dataclass(frozen=True, slots=True)
class Hold:
    """Stop where you are: a UAV brakes and hovers, a UGV brakes. On the ground it changes nothing."""

    vehicle: str


@dataclass(frozen=True, slots=True)
class StopMotors:
    """Emergency stop: motors off at once, in the air too; the vehicle stays locked."""

    vehicle: str


Command = Arm | Disarm | TakeOff | GoTo | Land | Dock | Drive | Hold | StopMotors


class Vehicle(Protocol):
    """One vehicle. Blocking SDK calls live in the implementation's own thread or process."""

    @property
    def id(self) -> str:
        """Its id in the fleet."""
        ...

    @property
    def kind(self) -> Kind:
        """``uav`` or ``ugv``."""
        ...

    def connect(self, deadline_s: float) -> None:
        """Connects within ``deadline_s`` (on the clock) and makes ready, without arming.

        Raises:
            DriverError: naming the vehicle, the cause and the remedy.
        """
        ...

    def state(self) -> VehicleState:
        """The newest snapshot; never blocks."""
        ...

    def send(self, command: Command) -> Command:
        """Sends ``command`` and returns what was really sent after the driver's own limits; never blocks.

        Not armed, a vehicle ignores every motion command. The effect shows in ``state`` and in the poses.

        Raises:
            DriverError: when the command is not for this vehicle or of the wrong kind.
        """
        ...

    def self_checks(self) -> Sequence[SelfCheck]:
        """What the connected vehicle shows of itself before the start; arms and moves nothing, never blocks."""
        ...

    def feed_pose(self, pose: Pose) -> None:
        """Hands a fresh motion-capture pose to the vehicle's own estimator, where it has one."""
        ...

    def last_will(self) -> LastWill | None:
        """What the guardian process does for it when this program dies; None where it dies with the program.

        Asked for once, when the vehicle is connected.
        """
        ...

    def close(self) -> None:
        """Releases the link; call it only on the ground or when the vehicle is lost."""
        ...


class PoseSource(Protocol):
    """A motion-capture system."""

    def connect(self, deadline_s: float) -> None:
        """Connects within ``deadline_s``.

        Raises:
            DriverError: naming the cause and the remedy.
        """
        ...

    def read(self) -> Sequence[Pose]:
        """The newest pose of each body received since the last call, with its own stamp; never blocks."""
        ...

    def close(self) -> None:
        """Releases the link and every child process."""
        ...
