"""What the paper's decoder may say next: every action of the list that the evaluator finds nothing wrong with.

Numbers are those of ``graph.index_of``: visits (U x M), moves (G x S), recharges (U x G).
"""

from __future__ import annotations

import numpy as np

from planner.kernel import EPS_J, KIND, MASK, MOVE, RECHARGE, VEHICLE, VISIT, Flags, Work, World, go
from planner.policy.jit import jit
from planner.policy.tokens_kernel import MEETS_IN_ROW, Turn, after_visit, rendezvous


@jit
def offer_all(world: World, work: Work, turn: Turn, moved: Flags, offered: Flags) -> int:
    """Fills ``offered`` in, (actions,); how many.

    Not offered: what breaks a rule or keeps a UAV from landing; a second move of a UGV before it has recharged anyone
    (``moved``, (G,)), or one to where no UAV could meet it; a recharge after ``MEETS_IN_ROW`` others without a visit.
    """
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    n_uavs, n_ugvs = world.uavs.shape[0], world.ugvs.shape[0]
    offered[:] = 0
    moves, recharges = n_uavs * n_tasks, n_uavs * n_tasks + n_ugvs * n_sites
    for u in range(n_uavs):
        if turn.done[u] != 0:
            continue
        for m in range(n_tasks):
            offered[u * n_tasks + m] = work.seen[m] == 0 and after_visit(world, work, u, m) >= -EPS_J
        if turn.row[u] >= MEETS_IN_ROW:
            continue
        for g in range(n_ugvs):
            for p in range(n_sites):
                if rendezvous(world, work, u, g, p, turn.details[g, p]):
                    if work.site[g] == p:
                        offered[recharges + u * n_ugvs + g] = 1
                    elif moved[g] == 0:
                        offered[moves + g * n_sites + p] = 1
    return int(np.sum(offered))


@jit
def say(world: World, work: Work, turn: Turn, moved: Flags, index: int) -> int:
    """Takes the action with that number; its code."""
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    n_uavs, n_ugvs = world.uavs.shape[0], world.ugvs.shape[0]
    moves, recharges = n_uavs * n_tasks, n_uavs * n_tasks + n_ugvs * n_sites
    if index < moves:
        code = VISIT << KIND | (index // n_tasks) << VEHICLE | index % n_tasks
        turn.row[index // n_tasks] = 0
    elif index < recharges:
        g = (index - moves) // n_sites
        code = MOVE << KIND | g << VEHICLE | (index - moves) % n_sites
        moved[g] = 1
    else:
        u = (index - recharges) // n_ugvs
        code = RECHARGE << KIND | u << VEHICLE | (index - recharges) % n_ugvs
        turn.row[u] += 1
        moved[code & MASK] = 0
    turn.code[0] = code
    go(world, work, turn.code, 0, 1, np.inf, turn.rows)
    return int(code)
