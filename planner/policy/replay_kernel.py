"""Goes through an expert's plan in the decoder's order and writes down every decision.

Vehicles that are alike in every respect can change names without changing the plan. Of such UAVs whose turn it is, the
one that goes first is the one whose next target comes first counter-clockwise from a given direction: east is the
naming rule of ``planner.labels``; in training it is a random one, and what the others would do counts as right as well.
Of such UGVs, the one of the lowest index is met.
"""

from __future__ import annotations

import numpy as np

from planner.kernel import KIND, MASK, MEET, SITE, VEHICLE, VISIT, Codes, Floats, Ints, Work, World
from planner.policy.features_kernel import Indices, Singles, View, fill_view
from planner.policy.jit import jit
from planner.policy.tokens_kernel import Turn, acting, apply, code_of, offer, same_uav, start, twins


@jit
def _bearing(code: int, at: int, n_tasks: int, xy: Floats, angle: float) -> float:
    to = code & MASK if code >> KIND == VISIT else n_tasks + (code >> SITE & MASK)
    return float((np.arctan2(xy[to, 1] - xy[at, 1], xy[to, 0] - xy[at, 0]) - angle) % (2.0 * np.pi))


@jit
def _option(world: World, work: Work, turn: Turn, code: int, ugv_name: Ints) -> int:
    """The option that an expert's action is for the UAV whose turn it is; -1 where it is not offered."""
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    if code >> KIND == VISIT:
        m = code & MASK
        return m if turn.visits[m] != 0 else -1
    g = 0
    while ugv_name[g] != (code & MASK):
        g += 1
    for other in range(g):
        if twins(world, work, other, g):
            g = other
            break
    p = code >> SITE & MASK
    return n_tasks + g * n_sites + p if turn.meets[g, p] != 0 else -1


@jit
def _next(codes: Codes, taken: Ints, name: int) -> int:
    """Index of the next action of the expert's UAV ``name``; -1 where there is none."""
    for i in range(codes.shape[0]):
        if taken[i] == 0 and codes[i] >> VEHICLE & MASK == name:
            return i
    return -1


@jit
def replay(
    world: World,
    work: Work,
    turn: Turn,
    xy: Floats,
    reach: Floats,
    codes: Codes,  # the expert's visits and meetings in any order that keeps each UAV's
    angle: float,  # from which UAVs that are alike are ordered, in rad from east
    options: Ints,  # (>= steps, U), filled with the expert's choices, first the one taken, -1 behind the last
    order: Codes,  # (>= steps,), filled with the actions in the decoder's order, -1 for done
    task: Singles,  # (steps, ...) each, as in ``View``: filled from row ``row`` on where there are any rows
    site: Singles,
    uav: Singles,
    ugv: Singles,
    pair: Singles,
    drive: Singles,
    tasks: Indices,
    counts: Indices,
    row: int,
) -> int:
    """The number of decisions; -1 where the expert does what is not offered. ``work`` ends up behind the plan."""
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    n_uavs, n_ugvs = world.uavs.shape[0], world.ugvs.shape[0]
    write = task.shape[0] > 0
    taken = np.zeros(codes.shape[0], np.int32)
    uav_name = np.arange(n_uavs).astype(np.int32)
    ugv_name = np.arange(n_ugvs).astype(np.int32)
    start(world, work, turn)
    left = codes.shape[0]
    n = 0
    while left > 0:
        u = acting(work, turn)
        if u < 0 or n >= options.shape[0]:
            return -1
        who, i, first = u, _next(codes, taken, uav_name[u]), np.inf
        if i >= 0:
            first = _bearing(codes[i], work.node[u], n_tasks, xy, angle)
        for v in range(u + 1, n_uavs):
            if same_uav(world, work, turn, u, v):
                j = _next(codes, taken, uav_name[v])
                if j >= 0 and _bearing(codes[j], work.node[v], n_tasks, xy, angle) < first:
                    who, i, first = v, j, _bearing(codes[j], work.node[v], n_tasks, xy, angle)
        uav_name[u], uav_name[who] = uav_name[who], uav_name[u]
        offer(world, work, turn, u)
        options[n] = -1
        option = n_tasks + n_ugvs * n_sites if turn.may_end[0] != 0 else -1
        if i >= 0:
            option = _option(world, work, turn, codes[i], ugv_name)
        if option < 0:
            return -1
        options[n, 0] = option
        count = 1
        for v in range(u + 1, n_uavs):
            if i >= 0 and same_uav(world, work, turn, u, v):
                j = _next(codes, taken, uav_name[v])
                other = -1 if j < 0 else _option(world, work, turn, codes[j], ugv_name)
                known = other < 0
                for k in range(count):
                    known = known or options[n, k] == other
                if not known:
                    options[n, count] = other
                    count += 1
        if i >= 0 and codes[i] >> KIND == MEET:  # the UGV that is met takes the name of the one that the expert meets
            g, taken_name = (option - n_tasks) // n_sites, codes[i] & MASK
            h = 0
            while ugv_name[h] != taken_name:
                h += 1
            ugv_name[g], ugv_name[h] = ugv_name[h], ugv_name[g]
        if write:
            k = row + n
            one = View(task[k], site[k], uav[k], ugv[k], pair[k], drive[k], tasks[k], counts[k])
            fill_view(world, work, turn, u, xy, reach, one)
        if i < 0:
            turn.done[u] = 1
            order[n] = -1
        else:
            taken[i] = 1
            left -= 1
            order[n] = code_of(u, option, n_tasks, n_sites)
            apply(world, work, turn, order[n])
        n += 1
    return n
