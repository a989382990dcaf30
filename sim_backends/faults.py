"""Scripted and random faults, the same for every simulator.

A fault names what goes wrong, with whom, when and for how long. Times are arena s after the first motion
command that a vehicle accepted (``TakeOff`` or ``Drive``), so that a fault hits the same phase of a mission
however long the start took. What each fault does, and in which unit its value is: ``docs/simulation.md``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from sim_backends.errors import SimulationError


class FaultKind(StrEnum):
    """What can go wrong; the comment says what ``Fault.value`` is."""

    UGV_STALL = "ugv_stall"  # none
    UGV_SLOW = "ugv_slow"  # factor of its speed, above 0, at most 1
    HEAD_WIND = "head_wind"  # m/s of ground speed lost in any direction of flight, above 0; nobody named: all UAVs
    BATTERY_DRAIN = "battery_drain"  # factor of its power, above 0
    CHARGE_SLOW = "charge_slow"  # factor of the charging power, 0 (does not charge at all) to 1
    POSE_DROPOUT = "pose_dropout"  # none; nobody named: all bodies
    POSE_FREEZE = "pose_freeze"  # none; nobody named: all bodies
    POSE_JUMP = "pose_jump"  # m, above 0
    POSE_SWAP = "pose_swap"  # none; ``other`` is the other vehicle
    TELEMETRY_LOSS = "telemetry_loss"  # none; nobody named: all vehicles
    VEHICLE_LOST = "vehicle_lost"  # 0 (default): link and poses die and it stops or lands by itself; 1: its motors fail
    DOCK_MISSED = "dock_missed"  # how many attempts in a row fail, a whole number of at least 1 (default 1)
    PLANNER_SLOW = "planner_slow"  # s added to each planning call, above 0; for whoever runs the planner


UAV_ONLY = frozenset({FaultKind.HEAD_WIND, FaultKind.CHARGE_SLOW, FaultKind.DOCK_MISSED})
"""Kinds that mean a UAV; ``charge_slow`` and ``dock_missed`` name the UAV, not the UGV that carries it."""
UGV_ONLY = frozenset({FaultKind.UGV_STALL, FaultKind.UGV_SLOW})
"""Kinds that mean a UGV."""
FOR_ALL = frozenset({FaultKind.HEAD_WIND, FaultKind.POSE_DROPOUT, FaultKind.POSE_FREEZE, FaultKind.TELEMETRY_LOSS})
"""Kinds that mean everybody they can concern when they name nobody."""
_VALUE = {
    # kind: (default or None where it must be given, least, is the least excluded, most)
    FaultKind.UGV_SLOW: (None, 0.0, True, 1.0),
    FaultKind.HEAD_WIND: (None, 0.0, True, math.inf),
    FaultKind.BATTERY_DRAIN: (None, 0.0, True, math.inf),
    FaultKind.CHARGE_SLOW: (None, 0.0, False, 1.0),
    FaultKind.POSE_JUMP: (None, 0.0, True, math.inf),
    FaultKind.VEHICLE_LOST: (0.0, 0.0, False, 1.0),
    FaultKind.DOCK_MISSED: (1.0, 1.0, False, 1000.0),
    FaultKind.PLANNER_SLOW: (None, 0.0, True, math.inf),
}


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault; validates itself and fills in the value's default.

    Attributes:
        kind: what happens.
        vehicle: to whom; None for everybody (see ``FOR_ALL``) and for the planner.
        at_s: when, in arena s after the first accepted ``TakeOff`` or ``Drive``.
        duration_s: for how long, arena s; None: to the end.
        value: how much, in the unit that ``FaultKind`` states.
        other: the other vehicle of a pose swap.

    Raises:
        SimulationError: naming the field that is wrong and what it may be.
    """

    kind: FaultKind
    vehicle: str | None = None
    at_s: float = 0.0
    duration_s: float | None = None
    value: float | None = None
    other: str | None = None

    def __post_init__(self) -> None:
        try:
            object.__setattr__(self, "kind", FaultKind(self.kind))
        except ValueError as error:
            kinds = ", ".join(FaultKind)
            raise SimulationError(f"fault {self.kind!r} is unknown; choose one of {kinds}") from error
        self._check_vehicles()
        self._require(_number(self.at_s) and self.at_s >= 0, f"at_s is {self.at_s!r}; give s of at least 0")
        self._require(
            self.duration_s is None or (_number(self.duration_s) and self.duration_s > 0),
            f"duration_s is {self.duration_s!r}; give s above 0, or leave it out for no end",
        )
        self._check_value()

    def _require(self, condition: bool, message: str) -> None:
        if not condition:
            raise SimulationError(f"fault {self.kind.value}: {message}")

    def _check_vehicles(self) -> None:
        if self.kind is FaultKind.PLANNER_SLOW:
            self._require(self.vehicle is None, "it concerns no vehicle; leave vehicle out")
        elif self.kind not in FOR_ALL:
            self._require(bool(self.vehicle), "vehicle is missing; name the vehicle it happens to")
        if self.kind is FaultKind.POSE_SWAP:
            self._require(bool(self.other), "other is missing; name the vehicle that it swaps poses with")
            self._require(self.other != self.vehicle, "vehicle and other are the same; name two vehicles")
        else:
            self._require(self.other is None, "other is only for pose_swap; leave it out")

    def _check_value(self) -> None:
        if self.kind not in _VALUE:
            self._require(self.value is None, "it takes no value; leave it out")
            return
        default, least, excluded, most = _VALUE[self.kind]
        if self.value is None and default is not None:
            object.__setattr__(self, "value", default)
        value = self.value
        limits = f"{'above' if excluded else 'of at least'} {least:g}" + (
            f", at most {most:g}" if math.isfinite(most) else ""
        )
        in_limits = (
            value is not None
            and _number(value)
            and (value > least or (value == least and not excluded))
            and value <= most
        )
        self._require(in_limits, f"value is {value!r}; give a number {limits}")
        if self.kind in (FaultKind.DOCK_MISSED, FaultKind.VEHICLE_LOST):
            self._require(value == int(value or 0), f"value is {value!r}; give a whole number")

    @property
    def end_s(self) -> float:
        """When it ends, on the scale of ``at_s``; infinity where it does not."""
        return math.inf if self.duration_s is None else self.at_s + self.duration_s


def _number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def check_faults(faults: Sequence[Fault], uav_ids: Sequence[str], ugv_ids: Sequence[str]) -> None:
    """Checks that every vehicle named exists and is of the kind that the fault means.

    Raises:
        SimulationError: naming the fault, the vehicle and who there is.
    """
    for number, fault in enumerate(faults):
        allowed = [*uav_ids, *ugv_ids]
        if fault.kind in UAV_ONLY:
            allowed = list(uav_ids)
        elif fault.kind in UGV_ONLY:
            allowed = list(ugv_ids)
        for vehicle in (fault.vehicle, fault.other):
            if vehicle is not None and vehicle not in allowed:
                raise SimulationError(
                    f"faults[{number}] ({fault.kind.value}): vehicle {vehicle!r} is none of {', '.join(allowed)}"
                )


def random_faults(
    seed: int,
    count: int,
    horizon_s: float,
    uav_ids: Sequence[str],
    ugv_ids: Sequence[str],
    *,
    speed_mps: float = 10.0,
    time_scale: float = 1.0,
) -> tuple[Fault, ...]:
    """Draws ``count`` faults of plausible sizes; the same arguments give the same faults.

    Args:
        seed: of the draw.
        count: how many.
        horizon_s: they start between 2 % and 90 % of this, arena s.
        uav_ids: UAVs they may hit.
        ugv_ids: UGVs they may hit.
        speed_mps: the UAVs' arena cruise speed; winds and jumps are drawn relative to it.
        time_scale: arena s per mission s; shortens delays of the plan's kind (stalls), not those of sensors.

    Returns:
        The faults in order of time.
    """
    rng = np.random.default_rng([seed, 0xFA])
    kinds = [k for k in FaultKind if not (k in UGV_ONLY and not ugv_ids)]
    if len(uav_ids) + len(ugv_ids) < 2:
        kinds.remove(FaultKind.POSE_SWAP)
    if not uav_ids:
        kinds = [k for k in kinds if k not in UAV_ONLY]
    faults = [
        _draw(
            rng,
            kinds[int(rng.integers(len(kinds)))],
            horizon_s,
            list(uav_ids),
            list(ugv_ids),
            speed_mps,
            time_scale,
        )
        for _ in range(count)
    ]
    return tuple(sorted(faults, key=lambda f: (f.at_s, f.kind, f.vehicle or "")))


def _draw(
    rng: np.random.Generator,
    kind: FaultKind,
    horizon_s: float,
    uav_ids: list[str],
    ugv_ids: list[str],
    speed_mps: float,
    time_scale: float,
) -> Fault:
    def between(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 3)

    def one_of(ids: list[str]) -> str:
        return ids[int(rng.integers(len(ids)))]

    at_s = between(0.02 * horizon_s, 0.9 * horizon_s)
    anybody = [*uav_ids, *ugv_ids]
    vehicle: str | None = one_of(uav_ids if kind in UAV_ONLY else ugv_ids if kind in UGV_ONLY else anybody)
    duration_s: float | None = None
    value: float | None = None
    other: str | None = None
    match kind:
        case FaultKind.UGV_STALL:
            duration_s = between(60.0, 600.0) * time_scale
        case FaultKind.UGV_SLOW:
            duration_s, value = between(120.0, 1200.0) * time_scale, between(0.3, 0.9)
        case FaultKind.HEAD_WIND:
            duration_s, value = between(60.0, 600.0) * time_scale, between(0.05, 0.4) * speed_mps
        case FaultKind.BATTERY_DRAIN:
            duration_s, value = between(60.0, 600.0) * time_scale, between(1.1, 1.6)
        case FaultKind.CHARGE_SLOW:
            duration_s, value = None, between(0.3, 0.9)
        case FaultKind.POSE_DROPOUT | FaultKind.POSE_FREEZE:
            duration_s = between(0.2, 6.0)
        case FaultKind.POSE_JUMP:
            duration_s, value = between(0.1, 2.0), between(0.3, 3.0) * speed_mps
        case FaultKind.POSE_SWAP:
            duration_s, other = between(0.2, 4.0), one_of([i for i in anybody if i != vehicle])
        case FaultKind.TELEMETRY_LOSS:
            duration_s = between(0.5, 10.0)
        case FaultKind.VEHICLE_LOST:
            value = float(rng.integers(2))
        case FaultKind.DOCK_MISSED:
            value = float(rng.integers(1, 3))
        case FaultKind.PLANNER_SLOW:
            vehicle, duration_s, value = None, between(60.0, 600.0) * time_scale, between(0.5, 12.0)
    return Fault(kind=kind, vehicle=vehicle, at_s=at_s, duration_s=duration_s, value=value, other=other)
