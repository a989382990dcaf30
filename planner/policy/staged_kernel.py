"""The outlined routes made a plan: flown in order of time, recharges put in where they cost the least."""

from __future__ import annotations

import numpy as np

from planner.kernel import (
    EPS_J,
    G_CHARGE_S,
    G_CHARGE_W,
    G_DOCK,
    G_SPEED,
    G_UNDOCK,
    S_LEFT,
    U_CAPACITY,
    U_CRUISE,
    U_HOVER,
    U_RESERVE,
    U_SERVICE,
    U_SPEED,
    U_WAIT,
    Codes,
    Flags,
    Floats,
    Ints,
    Work,
    World,
    go,
)  # fmt: skip
from planner.policy.jit import jit
from planner.policy.outline_kernel import A_CHARGE, A_RECHARGE
from planner.policy.tokens_kernel import DETAILS, MEETS_IN_ROW, Turn, after_visit, code_of, rendezvous


@jit
def _needs_j(dist: Floats, near: Floats, uavs: Floats, node: Ints, u: int, route: Ints) -> float:
    """Energy in J that a UAV needs for the rest of its route and to land."""
    metres, at = 0.0, node[u]
    for k in range(route.shape[0]):
        metres += dist[at, route[k]]
        at = route[k]
    fly = uavs[u, U_CRUISE] * (metres + near[at]) / uavs[u, U_SPEED]
    return float(fly + route.shape[0] * uavs[u, U_HOVER] * uavs[u, U_SERVICE])


@jit
def _recharge(
    dist: Floats,
    near: Floats,
    road: Floats,
    uavs: Floats,
    ugvs: Floats,
    ugv_on: Flags,
    node: Ints,
    us: Floats,
    site: Ints,
    gs: Floats,
    docks: Floats,
    u: int,
    route: Ints,
    again_s: float,
    most: float,
    out: Ints,
) -> bool:
    """Where on the rest of its route a UAV is best recharged next, by what the UGVs do now; whether anywhere.

    Each way to go on is judged by when the route ends: with one recharge there and then, and ``again_s`` for each one
    that is needed later, ``most`` at most. ``out`` is (tasks before it, UGV, site), (3,).
    """
    n_sites = road.shape[1]
    n_tasks = dist.shape[1] - n_sites
    n = route.shape[0]
    speed, cruise, reserve = uavs[u, U_SPEED], uavs[u, U_CRUISE], uavs[u, U_RESERVE]
    serve, serve_j = uavs[u, U_SERVICE], uavs[u, U_SERVICE] * uavs[u, U_HOVER]
    usable = max(1.0, uavs[u, U_CAPACITY] - reserve)
    rest = 0.0  # flight from the next task on, in m
    for k in range(1, n):
        rest += dist[route[k - 1], route[k]]
    home = near[route[n - 1]]
    at, now, energy = node[u], us[u, 0], us[u, 1]
    best = np.inf
    for k in range(n):
        for g in range(ugvs.shape[0]):
            if ugv_on[g] == 0:
                continue
            free = np.inf
            for i in range(docks.shape[1]):
                free = min(free, docks[g, i])
            for p in range(n_sites):
                fly = dist[at, n_tasks + p] / speed
                arrive = now + fly
                there = gs[g, 0]
                if site[g] != p:
                    there = gs[g, 1] + road[site[g], p] / ugvs[g, G_SPEED]
                begin = max(arrive, there, free)
                have = energy - cruise * fly - uavs[u, U_WAIT] * (begin - arrive)
                if begin >= best or have < reserve:
                    continue
                charge = ugvs[g, G_CHARGE_S]
                if ugvs[g, G_CHARGE_W] > 0.0:
                    charge = max(0.0, uavs[u, U_CAPACITY] - have) / ugvs[g, G_CHARGE_W]
                metres = dist[route[k], n_tasks + p]
                if cruise * (metres + near[route[k]]) / speed + serve_j > usable:
                    continue  # the next task is out of reach from there
                need = cruise * (metres + rest + home) / speed + serve_j * (n - k)
                again = max(0.0, np.ceil(need / usable) - 1.0)
                if again > most:
                    continue
                end = begin + ugvs[g, G_DOCK] + charge + ugvs[g, G_UNDOCK]
                end += (metres + rest) / speed + serve * (n - k)
                end += again_s * again
                if end < best:
                    best = end
                    out[0], out[1], out[2] = k, g, p
        energy -= cruise * dist[at, route[k]] / speed + serve_j
        now += dist[at, route[k]] / speed + serve
        at = route[k]
        if energy - cruise * near[at] / speed < reserve:
            break
        if k + 1 < n:
            rest -= dist[route[k], route[k + 1]]
    return best < np.inf


@jit
def staged(world: World, w: Work, turn: Turn, acts: Codes) -> int:
    """The outlined routes, flown in order of time, with recharges on the way where they cost the least time.

    Args:
        world: the problem.
        w: the state that ``turn.outline`` is for; changed into that behind the last action.
        turn: who is done.
        acts: room for the actions.

    Returns:
        How many; -1 where some task stays out of reach. The evaluator has the last word.
    """
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    o = turn.outline
    at = np.zeros(o.sizes.shape[0], np.int32)
    until = np.zeros(o.sizes.shape[0], np.int32)  # how far each goes before it looks for a recharge again
    rows = turn.row.copy()
    found = np.zeros(3, np.int32)
    details = np.empty(DETAILS)
    n = 0
    while w.sums[S_LEFT] > 0:
        u = -1
        for v in range(at.shape[0]):
            if at[v] < o.sizes[v] and (u < 0 or w.us[v, 0] < w.us[u, 0]):
                u = v
        if u < 0 or n >= acts.shape[0]:
            return -1
        route = o.routes[u, at[u] : o.sizes[u]]
        option = route[0]
        reached = after_visit(world, w, u, option) >= -EPS_J
        if at[u] >= until[u] or not reached:
            until[u] = o.sizes[u]
            lack = _needs_j(world.dist, world.near, world.uavs, w.node, u, route)
            lack -= w.us[u, 1] - world.uavs[u, U_RESERVE]
            if lack > 0.0:
                # A recharge has to spare one later, unless there is no going on without it.
                most = np.ceil(lack / o.uavs[u, A_CHARGE]) - 1.0 if reached else np.inf
                fine = _recharge(world.dist, world.near, world.road, world.uavs, world.ugvs, world.ugv_on, w.node, w.us,
                                 w.site, w.gs, w.docks, u, route, o.uavs[u, A_RECHARGE], most, found)  # fmt: skip
                if fine and found[0] > 0:
                    until[u] = at[u] + found[0]
                elif fine and rows[u] < MEETS_IN_ROW and rendezvous(world, w, u, found[1], found[2], details):
                    option = n_tasks + found[1] * n_sites + found[2]
        if option < n_tasks:
            if not reached:
                return -1
            at[u] += 1
            rows[u] = 0
        else:
            rows[u] += 1
            until[:] = at  # the UGV is elsewhere now: others look again where to be recharged
        acts[n] = code_of(u, option, n_tasks, n_sites)
        go(world, w, acts, n, n + 1, np.inf, turn.rows)
        n += 1
    return n
