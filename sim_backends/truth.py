"""What really happened in a simulated world, told by the world itself and not by what the ground station saw."""

from __future__ import annotations

from dataclasses import dataclass

from drivers.vehicle import Vec3
from sim_backends import kernel
from sim_backends.arrays import Arrays
from sim_backends.errors import SimulationError
from sim_backends.world import WorldConfig

KINDS = {
    kernel.SEPARATION: "separation",
    kernel.UGV_SEPARATION: "ugv_separation",
    kernel.FENCE: "fence",
    kernel.CEILING: "ceiling",
    kernel.EMPTY_IN_AIR: "empty_in_air",
    kernel.CRASH: "crash",
    kernel.COLLISION: "collision",
}
CODES = {
    kernel.DOCK_MISSED: "dock missed",
    kernel.BATTERY_EMPTY: "battery empty",
    kernel.MOTOR_FAILURE: "motor failure",
    kernel.COLLIDED: "collided",
    kernel.STOPPED: "motors stopped",
}
PHASES = ("ground", "pad", "fly", "take-off", "land", "dock", "abort", "brake", "fall", "crashed")


@dataclass(frozen=True, slots=True)
class Violation:
    """One broken rule, from its beginning to its end.

    Attributes:
        time_s, end_s: first and last moment, arena s.
        kind: a value of ``KINDS``.
        vehicles: whose.
        value: least horizontal distance (separation), least distance (ugv_separation, collision), greatest altitude
            (ceiling), altitude (empty_in_air), all in m; else 0.
        cause: of a crash or collision, in words; else empty.
        scripted: a vehicle had been lost by a scripted fault, so nobody could have prevented it.
    """

    time_s: float
    end_s: float
    kind: str
    vehicles: tuple[str, ...]
    value: float
    cause: str
    scripted: bool


@dataclass(frozen=True, slots=True)
class VehicleTruth:
    """One vehicle as it really is.

    Attributes:
        position_m: arena frame.
        yaw_rad: heading.
        speed_mps: over ground.
        phase: a UAV's motion (``PHASES``); ``drive`` or ``stand`` for a UGV.
        on: the UGV on whose pad a UAV stands.
        armed, airborne, tumbled, locked: as in ``VehicleState``, without delay.
        energy_j: in the battery.
        used_j: spent on moving and standing so far.
        given_j: by a UGV to UAVs so far.
    """

    position_m: Vec3
    yaw_rad: float
    speed_mps: float
    phase: str
    on: str | None
    armed: bool
    airborne: bool
    tumbled: bool
    locked: bool
    energy_j: float
    used_j: float
    given_j: float


@dataclass(frozen=True, slots=True)
class Truth:
    """The audit of a world from its start until now, judged at every step of the physics.

    Attributes:
        time_s: now.
        min_separation_m: least horizontal distance of two flying UAVs closer in height than the audit's cylinder; inf
            where there was no such moment.
        min_uav_distance_m: least distance of two flying UAVs; inf where there was never more than one.
        min_ugv_distance_m: least distance of two UGVs; inf where there is only one.
        violations: in order of their beginning.
        vehicles: by id.
    """

    time_s: float
    min_separation_m: float
    min_uav_distance_m: float
    min_ugv_distance_m: float
    violations: tuple[Violation, ...]
    vehicles: dict[str, VehicleTruth]


def read_truth(config: WorldConfig, arrays: Arrays, step: int) -> Truth:
    """The audit after ``step``.

    Raises:
        SimulationError: when there were more violations than could be kept.
    """
    w = arrays.world[0]
    if w["lost_records"]:
        raise SimulationError(f"the audit has no room for {w['lost_records']} more violations; shorten the run")
    ids = [v.id for v in config.vehicles]
    h = config.step_s
    violations = tuple(
        Violation(
            time_s=int(r["step"]) * h,
            end_s=int(r["end"]) * h,
            kind=KINDS[int(r["kind"])],
            vehicles=tuple(ids[b] for b in sorted({int(r["a"]), int(r["b"])} - {-1})),
            value=abs(float(r["value"])),
            cause=CODES.get(int(r["cause"]), ""),
            scripted=bool(r["scripted"]),
        )
        for r in arrays.records[: int(w["n_records"])]
    )
    vehicles: dict[str, VehicleTruth] = {}
    for uav, u in zip(config.uavs, arrays.uavs, strict=True):
        phase = int(u["phase"])
        vehicles[uav.id] = VehicleTruth(
            position_m=(float(u["x"]), float(u["y"]), float(u["z"])),
            yaw_rad=float(u["yaw"]),
            speed_mps=float((u["vx"] ** 2 + u["vy"] ** 2 + u["vz"] ** 2) ** 0.5),
            phase=PHASES[phase],
            on=config.ugvs[int(u["ugv"])].id if phase == kernel.PAD else None,
            armed=bool(u["armed"]),
            airborne=bool(kernel.flying(phase)),
            tumbled=bool(u["tumbled"]),
            locked=bool(u["locked"]),
            energy_j=float(u["energy"]),
            used_j=float(u["used"]),
            given_j=0.0,
        )
    for ugv, g in zip(config.ugvs, arrays.ugvs, strict=True):
        vehicles[ugv.id] = VehicleTruth(
            position_m=(float(g["x"]), float(g["y"]), 0.0),
            yaw_rad=float(g["yaw"]),
            speed_mps=float(g["v"]),
            phase="drive" if g["v"] > 0 else "stand",
            on=None,
            armed=bool(g["armed"]),
            airborne=False,
            tumbled=False,
            locked=bool(g["locked"]),
            energy_j=float(g["energy"]),
            used_j=float(g["used"]),
            given_j=float(g["given"]),
        )
    return Truth(
        time_s=step * h,
        min_separation_m=float(w["min_h"]),
        min_uav_distance_m=float(w["min_uav"]),
        min_ugv_distance_m=float(w["min_ugv"]),
        violations=violations,
        vehicles=vehicles,
    )
