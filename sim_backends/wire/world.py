"""The physical world that all simulated endpoints share: a folder with the configuration and one file of rows.

Each endpoint is a process that moves its own body and writes its row; all see all rows. A row is guarded by a counter
that is odd while it is written, so that readers never see half a step. Times are ``time.monotonic()``, which all
processes of one machine share. Modifiers (the faults of ``faults.py``) are written by the conductor alone.
"""

from __future__ import annotations

import json
import math
import mmap
import time
from dataclasses import dataclass, replace
from pathlib import Path

import cattrs
import numpy as np

from drivers.vehicle import Vec2, Vec3
from sim_backends.errors import SimulationError
from sim_backends.world import SimUgv, WorldConfig

Quaternion = tuple[float, float, float, float]

CONFIG, ROWS = "world.json", "rows.bin"
FINE, DOCK_MISSED, BATTERY_EMPTY, MOTOR_FAILURE, COLLIDED, STOPPED = range(6)

_HEAD = np.dtype([("started_s", "f8"), ("created_s", "f8")])
_ROW = np.dtype(
    [
        ("seq", "u8"),
        ("time_s", "f8"),
        ("position_m", "f8", 3),
        ("velocity_mps", "f8", 3),
        ("quaternion", "f8", 4),
        ("on", "i8"),
        ("dock", "i8"),
        ("armed", "i8"),
        ("airborne", "i8"),
        ("tumbled", "i8"),
        ("locked", "i8"),
        ("charging", "i8"),
        ("code", "i8"),
        ("energy_j", "f8"),
        ("used_j", "f8"),
        ("drawn_j", "f8"),
        ("given_j", "f8"),
    ]
)
_MODIFIERS = np.dtype(
    [
        ("slow", "f8"),
        ("wind_mps", "f8"),
        ("drain", "f8"),
        ("charge_factor", "f8"),
        ("jump_x", "f8"),
        ("jump_y", "f8"),
        ("loss", "f8"),
        ("swap", "i8"),
        ("dropout", "i8"),
        ("freeze", "i8"),
        ("silent", "i8"),
        ("lost", "i8"),
        ("motor_fail", "i8"),
        ("dock_miss", "i8"),
    ]
)


@dataclass(frozen=True, slots=True)
class Body:
    """One body as it is.

    Attributes:
        time_s: of the last write, ``time.monotonic()``; 0 until its endpoint has begun.
        position_m: of the body's origin (what motion capture reports); a UAV's is where it touches the ground.
        velocity_mps: of it.
        quaternion: attitude, x y z w, body to arena.
        on: row of the UGV on whose dock a UAV stands; -1 for none.
        dock: which dock.
        armed, airborne, tumbled, locked, charging: as in ``VehicleState``, without delay.
        code: what went wrong (``FINE`` ... ``STOPPED``).
        energy_j: in the battery, world J.
        used_j: spent so far.
        drawn_j: taken from UGVs so far (UAVs).
        given_j: given to UAVs so far (UGVs).
    """

    time_s: float = 0.0
    position_m: Vec3 = (0.0, 0.0, 0.0)
    velocity_mps: Vec3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    on: int = -1
    dock: int = 0
    armed: bool = False
    airborne: bool = False
    tumbled: bool = False
    locked: bool = False
    charging: bool = False
    code: int = FINE
    energy_j: float = 0.0
    used_j: float = 0.0
    drawn_j: float = 0.0
    given_j: float = 0.0

    @property
    def yaw_rad(self) -> float:
        """Heading."""
        x, y, z, w = self.quaternion
        return math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))

    @property
    def speed_mps(self) -> float:
        """Speed over ground."""
        return math.hypot(self.velocity_mps[0], self.velocity_mps[1])


@dataclass(frozen=True, slots=True)
class Modifiers:
    """What the faults do to one body at the moment.

    Attributes:
        slow: factor of a UGV's speed; 0 is stalled.
        wind_mps: ground speed that a UAV loses in any direction of flight.
        drain: factor of its power.
        charge_factor: of the charging power; 0: no contact.
        jump_x, jump_y: false offset of its pose in motion capture, m.
        loss: probability with which each packet of its link is lost, both ways.
        swap: row of the body with which motion capture confuses it; its own when it does not.
        dropout: motion capture does not see it.
        freeze: motion capture repeats its last pose.
        silent: it says nothing, but hears and goes on.
        lost: its link is dead both ways and motion capture does not see it.
        motor_fail: its motors have failed.
        dock_miss: so many dockings touch down beside the contact.
    """

    slow: float = 1.0
    wind_mps: float = 0.0
    drain: float = 1.0
    charge_factor: float = 1.0
    jump_x: float = 0.0
    jump_y: float = 0.0
    loss: float = 0.0
    swap: int = -1
    dropout: bool = False
    freeze: bool = False
    silent: bool = False
    lost: bool = False
    motor_fail: bool = False
    dock_miss: int = 0


def yaw_quaternion(yaw_rad: float) -> Quaternion:
    """The attitude of something level."""
    return (0.0, 0.0, math.sin(0.5 * yaw_rad), math.cos(0.5 * yaw_rad))


class World:
    """A handle to the shared world; every process opens its own.

    Raises:
        SimulationError: when the folder holds no world.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        try:
            raw = json.loads((folder / CONFIG).read_text())
            self.config = cattrs.structure(raw, WorldConfig)
            with (folder / ROWS).open("r+b") as file:
                self._map = mmap.mmap(file.fileno(), 0)
        except (OSError, ValueError) as error:
            raise SimulationError(f"{folder} holds no simulated world: {error}; create one first") from error
        n = len(self.config.vehicles)
        self.ids = tuple(v.id for v in self.config.vehicles)
        self._head = np.frombuffer(self._map, _HEAD, 1)
        self._rows = np.frombuffer(self._map, _ROW, n, _HEAD.itemsize)
        self._modifiers = np.frombuffer(self._map, _MODIFIERS, n, _HEAD.itemsize + n * _ROW.itemsize)

    @classmethod
    def create(cls, folder: Path, config: WorldConfig) -> World:
        """Makes a new world in ``folder``, everybody at the start, and opens it."""
        folder.mkdir(parents=True, exist_ok=True)
        n = len(config.vehicles)
        size = _HEAD.itemsize + n * (_ROW.itemsize + _MODIFIERS.itemsize)
        temporary = folder / f"{ROWS}.new"
        temporary.write_bytes(bytes(size))
        temporary.replace(folder / ROWS)
        (folder / CONFIG).write_text(json.dumps(cattrs.unstructure(config)))
        world = cls(folder)
        world._head[0] = (math.nan, time.monotonic())
        for i, vehicle in enumerate(config.vehicles):
            world.modify(i, Modifiers(swap=i))
            energy_j = vehicle.capacity_j if vehicle.energy_j is None else vehicle.energy_j
            x, y = vehicle.start_m
            yaw_rad = vehicle.yaw_rad if isinstance(vehicle, SimUgv) else 0.0
            world.put(
                i, Body(position_m=(x, y, 0.0), quaternion=yaw_quaternion(yaw_rad), energy_j=energy_j), stamped=False
            )
        for i, uav in enumerate(config.uavs):
            if uav.on is not None:
                carrier = world.row(uav.on)
                at = world.pad_m(carrier, uav.dock)
                world.put(i, replace(world.body(i), position_m=at, on=carrier, dock=uav.dock), stamped=False)
        return world

    def row(self, vehicle: str) -> int:
        """The row of a vehicle id.

        Raises:
            SimulationError: when there is none.
        """
        if vehicle not in self.ids:
            raise SimulationError(f"the world has no {vehicle!r}; there are {', '.join(self.ids)}")
        return self.ids.index(vehicle)

    def is_uav(self, row: int) -> bool:
        """Whether the row is a UAV's; UAVs come first."""
        return row < len(self.config.uavs)

    @property
    def n_uav(self) -> int:
        """Number of UAVs; the row of UGV j is ``n_uav + j``."""
        return len(self.config.uavs)

    def body(self, row: int) -> Body:
        """The newest complete state of a body."""
        for _ in range(1000):
            before = int(self._rows["seq"][row])
            values = self._rows[row].tolist()
            if before % 2 == 0 and int(self._rows["seq"][row]) == before:
                break
            time.sleep(0)
        # after a thousand tries its writer has died in the middle of a step; what it left is all there is
        _, time_s, (x, y, z), (vx, vy, vz), (qx, qy, qz, qw), on, dock, *rest = values
        armed, airborne, tumbled, locked, charging, code, energy_j, used_j, drawn_j, given_j = rest
        return Body(
            time_s=time_s,
            position_m=(x, y, z),
            velocity_mps=(vx, vy, vz),
            quaternion=(qx, qy, qz, qw),
            on=on,
            dock=dock,
            armed=bool(armed),
            airborne=bool(airborne),
            tumbled=bool(tumbled),
            locked=bool(locked),
            charging=bool(charging),
            code=code,
            energy_j=energy_j,
            used_j=used_j,
            drawn_j=drawn_j,
            given_j=given_j,
        )

    def bodies(self) -> list[Body]:
        """All of them, by row."""
        return [self.body(i) for i in range(len(self.ids))]

    def put(self, row: int, body: Body, *, stamped: bool = True) -> None:
        """Writes a body; only its own endpoint does, or the conductor when that is dead."""
        r = self._rows
        r["seq"][row] |= 1
        time_s = time.monotonic() if stamped else body.time_s
        r[row] = (
            int(r["seq"][row]), time_s, body.position_m, body.velocity_mps, body.quaternion, body.on, body.dock,
            body.armed, body.airborne, body.tumbled, body.locked, body.charging, body.code,
            body.energy_j, body.used_j, body.drawn_j, body.given_j,
        )  # fmt: skip
        r["seq"][row] += 1

    def modifiers(self, row: int) -> Modifiers:
        """What the faults do to a body."""
        slow, wind, drain, charge, jump_x, jump_y, loss, *rest = self._modifiers[row].tolist()
        swap, dropout, freeze, silent, lost, motor_fail, dock_miss = rest
        flags = (bool(dropout), bool(freeze), bool(silent), bool(lost), bool(motor_fail))
        return Modifiers(slow, wind, drain, charge, jump_x, jump_y, loss, swap, *flags, dock_miss)

    def modify(self, row: int, modifiers: Modifiers) -> None:
        """Sets what the faults do to a body; only the conductor and tests do."""
        m = modifiers
        self._modifiers[row] = (
            m.slow, m.wind_mps, m.drain, m.charge_factor, m.jump_x, m.jump_y, m.loss, row if m.swap < 0 else m.swap,
            m.dropout, m.freeze, m.silent, m.lost, m.motor_fail, m.dock_miss,
        )  # fmt: skip

    def dock_missed(self, row: int) -> None:
        """Counts down the dockings that have to miss."""
        self._modifiers["dock_miss"][row] = max(0, int(self._modifiers["dock_miss"][row]) - 1)

    @property
    def started_s(self) -> float | None:
        """When the first motion command was accepted; faults count from there."""
        value = float(self._head["started_s"][0])
        return None if math.isnan(value) else value

    def start(self) -> None:
        """A vehicle has accepted its first take-off or drive."""
        if self.started_s is None:
            self._head["started_s"][0] = time.monotonic()

    def pad_m(self, ugv: int, dock: int) -> Vec3:
        """Where dock ``dock`` of the UGV in row ``ugv`` is now."""
        config = self.ugv(ugv)
        x, y = self._place_m(self.body(ugv), config.dock_offsets_m[dock])
        return (x, y, config.pad_height_m)

    def ugv(self, row: int) -> SimUgv:
        """The configuration of the UGV in row ``row``."""
        return self.config.ugvs[row - self.n_uav]

    @staticmethod
    def _place_m(body: Body, offset_m: Vec2) -> Vec2:
        c, s = math.cos(body.yaw_rad), math.sin(body.yaw_rad)
        return (
            body.position_m[0] + c * offset_m[0] - s * offset_m[1],
            body.position_m[1] + s * offset_m[0] + c * offset_m[1],
        )
