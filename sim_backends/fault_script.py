"""Turns scripted faults into the modifiers that the kernel works with, at the steps where they begin and end."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim_backends import kernel
from sim_backends.arrays import Arrays
from sim_backends.faults import Fault, FaultKind
from sim_backends.world import WorldConfig

NEVER = 1 << 62


class FaultScript:
    """The faults of one world; they wait for the first accepted motion command."""

    def __init__(self, config: WorldConfig, faults: Sequence[Fault], arrays: Arrays) -> None:
        self._arrays, self._h, self._seed = arrays, config.step_s, config.seed
        self._n_uav = len(config.uavs)
        self._ids = [v.id for v in config.vehicles]
        self._faults = [f for f in faults if f.kind is not FaultKind.PLANNER_SLOW]
        self._slow = [f for f in faults if f.kind is FaultKind.PLANNER_SLOW]
        self._spans: list[tuple[int, int]] = []
        self.started: int | None = None
        self.next_step = NEVER

    def start(self, step: int) -> None:
        """The first motion command was accepted at ``step``; later calls change nothing."""
        if self.started is not None:
            return
        self.started = step
        for fault in self._faults:
            first = step + math.ceil(fault.at_s / self._h - 1e-9)
            last = NEVER
            if fault.duration_s is not None:
                last = max(first + 1, step + math.ceil(fault.end_s / self._h - 1e-9))
            self._spans.append((first, last))
        self._find_next(step - 1)

    def planner_delay_s(self, now_s: float) -> float:
        """Arena s by which a planning call that begins at ``now_s`` is slowed down."""
        if self.started is None:
            return 0.0
        t = now_s - self.started * self._h
        return sum(f.value or 0.0 for f in self._slow if f.at_s <= t < f.end_s)

    def apply(self, step: int) -> None:
        """Sets every modifier to what holds from ``step`` on."""
        a = self._arrays
        a.uavs["wind"], a.uavs["drain"], a.uavs["charge_factor"], a.uavs["lost"] = 0.0, 1.0, 1.0, 0
        a.ugvs["slow"], a.ugvs["drain"], a.ugvs["lost"] = 1.0, 1.0, 0
        for name in ("jump_x", "jump_y", "dropout", "freeze", "tele_lost"):
            a.out[name] = 0
        a.out["swap"] = range(len(self._ids))
        for fault, (first, last) in zip(self._faults, self._spans, strict=True):
            if first <= step < last:
                for b in self._concerned(fault):
                    self._set(fault, b, begins=step == first)
            elif step == last and fault.kind is FaultKind.DOCK_MISSED:
                for b in self._concerned(fault):
                    a.uavs[b]["dock_miss"] = 0
        self._find_next(step)

    def _find_next(self, step: int) -> None:
        self.next_step = min((s for span in self._spans for s in span if s > step), default=NEVER)

    def _concerned(self, fault: Fault) -> Sequence[int]:
        if fault.vehicle is not None:
            return [self._ids.index(fault.vehicle)]
        return range(self._n_uav if fault.kind is FaultKind.HEAD_WIND else len(self._ids))

    def _set(self, fault: Fault, b: int, begins: bool) -> None:
        a, value = self._arrays, fault.value or 0.0
        is_uav = b < self._n_uav
        body, out = (a.uavs[b] if is_uav else a.ugvs[b - self._n_uav]), a.out[b]
        match fault.kind:
            case FaultKind.UGV_STALL:
                body["slow"] = 0.0
            case FaultKind.UGV_SLOW:
                body["slow"] *= value
            case FaultKind.HEAD_WIND:
                body["wind"] += value
            case FaultKind.BATTERY_DRAIN:
                body["drain"] *= value
            case FaultKind.CHARGE_SLOW:
                body["charge_factor"] *= value
            case FaultKind.POSE_DROPOUT:
                out["dropout"] = 1
            case FaultKind.POSE_FREEZE:
                out["freeze"] = 1
            case FaultKind.POSE_JUMP:
                turn = 2 * math.pi * kernel.uniform(self._seed, b, int(fault.at_s * 1000), 16)
                out["jump_x"] += value * math.cos(turn)
                out["jump_y"] += value * math.sin(turn)
            case FaultKind.POSE_SWAP:
                other = self._ids.index(fault.other or "")
                out["swap"], a.out[other]["swap"] = other, b
            case FaultKind.TELEMETRY_LOSS:
                out["tele_lost"] = 1
            case FaultKind.DOCK_MISSED:
                if begins:
                    body["dock_miss"] = int(value)
            case FaultKind.VEHICLE_LOST if value == 0:
                body["lost"] = 1
            case FaultKind.VEHICLE_LOST if is_uav:
                body["motor_fail"] = 1
            case FaultKind.VEHICLE_LOST:
                body["locked"], body["armed"], body["driving"], body["code"] = 1, 0, 0, kernel.MOTOR_FAILURE
