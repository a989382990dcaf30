"""The canonical order of a plan's actions: many orders give one schedule, files hold this one."""

from __future__ import annotations

import heapq
from collections.abc import Sequence

from planner.plan import Action, Move, Recharge
from planner.problem import Problem
from planner.schedule import evaluate


def canonical(problem: Problem, actions: Sequence[Action]) -> tuple[Action, ...]:
    """``actions`` by start time, then vehicle (UAVs first, by index), as far as precedence allows.

    The order among one UAV's actions, and among the moves and recharges of one UGV, stays: so does the schedule.
    """
    rows = evaluate(problem, actions).actions
    last_of: dict[tuple[str, int], int] = {}
    followers: list[list[int]] = [[] for _ in actions]
    waits_for = [0] * len(actions)
    for i, act in enumerate(actions):
        vehicles = [("ugv", act.ugv)] if isinstance(act, Move) else [("uav", act.uav)]
        if isinstance(act, Recharge):
            vehicles.append(("ugv", act.ugv))
        for vehicle in vehicles:
            if vehicle in last_of:
                followers[last_of[vehicle]].append(i)
                waits_for[i] += 1
            last_of[vehicle] = i
    n_uavs = len(problem.uavs)

    def key(i: int) -> tuple[float, int, int]:
        act = actions[i]
        return rows[i].start_s, n_uavs + act.ugv if isinstance(act, Move) else act.uav, i

    ready = [key(i) for i in range(len(actions)) if waits_for[i] == 0]
    heapq.heapify(ready)
    ordered: list[Action] = []
    while ready:
        i = heapq.heappop(ready)[2]
        ordered.append(actions[i])
        for j in followers[i]:
            waits_for[j] -= 1
            if waits_for[j] == 0:
                heapq.heappush(ready, key(j))
    return tuple(ordered)
