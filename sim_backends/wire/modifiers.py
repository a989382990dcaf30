"""What the scripted faults do to each body at a moment: pure, so that every fault is a row of a test."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sim_backends.faults import Fault, FaultKind
from sim_backends.wire.world import Modifiers
from sim_backends.world import WorldConfig


class FaultTimes:
    """The faults of one world over the time since its first motion.

    Args:
        config: of the world; its seed draws the directions of jumps.
        faults: checked against the world by the caller (``check_faults``).
    """

    def __init__(self, config: WorldConfig, faults: Sequence[Fault]) -> None:
        self._ids = [v.id for v in config.vehicles]
        self._n_uav = len(config.uavs)
        self._seed = config.seed
        self._faults = [f for f in faults if f.kind is not FaultKind.PLANNER_SLOW]
        self._slow = [f for f in faults if f.kind is FaultKind.PLANNER_SLOW]

    def active(self, elapsed_s: float | None) -> frozenset[int]:
        """Numbers of the faults that hold ``elapsed_s`` after the first motion; none before it (None)."""
        if elapsed_s is None:
            return frozenset()
        return frozenset(n for n, f in enumerate(self._faults) if f.at_s <= elapsed_s < f.end_s)

    def planner_delay_s(self, elapsed_s: float | None) -> float:
        """Arena s by which a planning call that begins now is slowed down."""
        if elapsed_s is None:
            return 0.0
        return sum(f.value or 0.0 for f in self._slow if f.at_s <= elapsed_s < f.end_s)

    def modifiers(self, active: frozenset[int], before: frozenset[int], now: Sequence[Modifiers]) -> list[Modifiers]:
        """What holds from now on.

        Args:
            active: faults that hold now.
            before: those that held when ``now`` was made.
            now: the modifiers as they are; dockings that must still miss are taken from there, since the UAVs count
                them down, and motors that have failed stay so.

        Returns:
            One per row.
        """
        rows = [
            Modifiers(swap=row, dock_miss=m.dock_miss, motor_fail=m.motor_fail, loss=m.loss)
            for row, m in enumerate(now)
        ]
        for number in sorted(before - active):
            fault = self._faults[number]
            if fault.kind is FaultKind.DOCK_MISSED:
                for row in self._concerned(fault):
                    rows[row] = replace(rows[row], dock_miss=0)
        for number in sorted(active):
            fault = self._faults[number]
            for row in self._concerned(fault):
                self._set(rows, row, fault, begins=number not in before)
        return rows

    def _concerned(self, fault: Fault) -> Sequence[int]:
        if fault.vehicle is not None:
            return [self._ids.index(fault.vehicle)]
        return range(self._n_uav if fault.kind is FaultKind.HEAD_WIND else len(self._ids))

    def _set(self, rows: list[Modifiers], row: int, fault: Fault, *, begins: bool) -> None:
        m, value = rows[row], fault.value or 0.0
        match fault.kind:
            case FaultKind.UGV_STALL:
                m = replace(m, slow=0.0)
            case FaultKind.UGV_SLOW:
                m = replace(m, slow=m.slow * value)
            case FaultKind.HEAD_WIND:
                m = replace(m, wind_mps=m.wind_mps + value)
            case FaultKind.BATTERY_DRAIN:
                m = replace(m, drain=m.drain * value)
            case FaultKind.CHARGE_SLOW:
                m = replace(m, charge_factor=m.charge_factor * value)
            case FaultKind.POSE_DROPOUT:
                m = replace(m, dropout=True)
            case FaultKind.POSE_FREEZE:
                m = replace(m, freeze=True)
            case FaultKind.POSE_JUMP:
                turn = self._direction_rad(row, fault)
                m = replace(m, jump_x=m.jump_x + value * math.cos(turn), jump_y=m.jump_y + value * math.sin(turn))
            case FaultKind.POSE_SWAP:
                other = self._ids.index(fault.other or "")
                rows[other] = replace(rows[other], swap=row)
                m = replace(m, swap=other)
            case FaultKind.TELEMETRY_LOSS:
                m = replace(m, silent=True)
            case FaultKind.DOCK_MISSED:
                m = replace(m, dock_miss=int(value)) if begins else m
            case FaultKind.VEHICLE_LOST:
                m = replace(m, lost=True) if value == 0 else replace(m, motor_fail=True)
        rows[row] = m

    def _direction_rad(self, row: int, fault: Fault) -> float:
        rng = np.random.default_rng([self._seed, row, int(fault.at_s * 1000)])
        return 2.0 * math.pi * float(rng.random())
