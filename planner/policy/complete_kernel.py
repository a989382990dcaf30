"""A way to serve all tasks that are left: the proof that a plan half made can be finished.

The decoder takes an option only where this finds such a way from the state behind it, and keeps the way. Then there is
always something to do: the next action of the way, or ``done`` for a UAV that has no part in it. So decoding cannot run
into a dead end, and every plan that begins in a state with a way ends feasible.

The way is that of ``outline_kernel``: all UAVs on their own with the energy that they have, or with recharges put
into their routes. Where these are no proof, it is of one UAV and one UGV: from where the UGV is, the UAV visits what it
can return from and is recharged; then both go to the next stop from which some task that is left can be served, and all
other UAVs are done. Not every state that can be finished has such a way; those of the paper's setups have.
"""

from __future__ import annotations

import numpy as np

from planner import kernel
from planner.kernel import (
    EPS_J,
    G_SPEED,
    KIND,
    MEET,
    S_LEFT,
    SITE,
    U_CAPACITY,
    U_CRUISE,
    U_HOVER,
    U_RESERVE,
    U_SERVICE,
    U_SPEED,
    U_WAIT,
    VEHICLE,
    VISIT,
    Codes,
    Floats,
    Work,
    World,
    go,
    total,
)
from planner.policy.jit import jit
from planner.policy.outline_kernel import alone
from planner.policy.staged_kernel import staged
from planner.policy.tokens_kernel import DETAILS, P_END, Turn, acting, after_visit, rendezvous


@jit
def copy_work(source: Work, to: Work) -> None:
    """Copies the state of all vehicles."""
    to.node[:] = source.node
    to.us[:] = source.us
    to.site[:] = source.site
    to.gs[:] = source.gs
    to.docks[:] = source.docks
    to.seen[:] = source.seen
    to.sums[:] = source.sums


@jit
def _take(world: World, w: Work, acts: Codes, n: int, code: int, rows: Floats) -> None:
    acts[n] = code
    go(world, w, acts, n, n + 1, np.inf, rows)


@jit
def _sound(world: World, w: Work) -> bool:
    total(world, w)
    return bool(w.out[kernel.O_CODE] == kernel.OK)


@jit
def _trip(world: World, w: Work, u: int, g: int) -> int:
    """The nearest task from which ``u`` gets back to where ``g`` is, waits there if it has to, and can land; or -1."""
    n_tasks = world.visited.shape[0]
    uav = world.uavs[u]
    back = n_tasks + w.site[g]
    free = np.inf
    for k in range(w.docks.shape[1]):
        free = min(free, w.docks[g, k])
    here = max(w.gs[g, 0], free)
    best, to = np.inf, -1
    for m in range(n_tasks):
        away = world.dist[w.node[u], m]
        if w.seen[m] != 0 or away >= best:
            continue
        fly = (away + world.dist[m, back]) / uav[U_SPEED]
        wait = max(0.0, here - w.us[u, 0] - fly - uav[U_SERVICE])
        need = uav[U_CRUISE] * fly + uav[U_HOVER] * uav[U_SERVICE] + uav[U_WAIT] * wait
        if w.us[u, 1] - need >= uav[U_RESERVE]:
            best, to = away, m
    if to < 0 and w.sums[S_LEFT] == 1:  # the last one: landing is enough
        for m in range(n_tasks):
            if w.seen[m] == 0 and after_visit(world, w, u, m) >= -EPS_J:
                return m
    return to


@jit
def _serves(world: World, w: Work, u: int, p: int) -> bool:
    """Whether some task that is left is within half a charge of site ``p``."""
    n_tasks = world.visited.shape[0]
    uav = world.uavs[u]
    budget = uav[U_CAPACITY] - uav[U_RESERVE] - uav[U_HOVER] * uav[U_SERVICE]
    for m in range(n_tasks):
        if w.seen[m] == 0 and 2.0 * world.dist[m, n_tasks + p] / uav[U_SPEED] * uav[U_CRUISE] <= budget:
            return True
    return False


@jit
def _hop(world: World, u: int, g: int, a: int, b: int, late: float) -> bool:
    """Whether ``u``, full at ``a``, can go to ``b`` and wait for ``g``, which sets out ``late`` seconds after it."""
    if world.road[a, b] == np.inf:
        return False
    n_tasks = world.visited.shape[0]
    uav = world.uavs[u]
    fly = world.dist[n_tasks + a, n_tasks + b] / uav[U_SPEED]
    wait = max(0.0, late + world.road[a, b] / world.ugvs[g, G_SPEED] - fly)
    return bool(uav[U_CAPACITY] - uav[U_CRUISE] * fly - uav[U_WAIT] * wait >= uav[U_RESERVE])


@jit
def _stop(world: World, w: Work, u: int, g: int, away: Floats, first: Codes) -> int:
    """First hop of the shortest drive to a stop that serves a task, by hops that the UAV can follow; or -1."""
    n_sites = world.road.shape[1]
    away[:] = np.inf
    at = w.site[g]
    late = max(0.0, w.gs[g, 1] - w.us[u, 0])
    for p in range(n_sites):
        if p != at and _hop(world, u, g, at, p, late):
            away[p] = world.road[at, p]
            first[p] = p
    away[at] = -1.0
    while True:
        a = -1
        for p in range(n_sites):
            if 0.0 <= away[p] < np.inf and (a < 0 or away[p] < away[a]):
                a = p
        if a < 0:
            return -1
        if _serves(world, w, u, a):
            return int(first[a])
        for b in range(n_sites):
            if away[b] >= 0.0 and away[a] + world.road[a, b] < away[b] and _hop(world, u, g, a, b, 0.0):
                away[b] = away[a] + world.road[a, b]
                first[b] = first[a]
        away[a] = -1.0


@jit
def _through(world: World, w: Work, u: int, g: int) -> int:
    """A task on the way from here to a meeting elsewhere; or -1."""
    n_tasks = world.visited.shape[0]
    uav = world.uavs[u]
    at = w.site[g]
    for m in range(n_tasks):
        if w.seen[m] != 0:
            continue
        for p in range(world.road.shape[1]):
            metres = world.road[at, p]
            if p == at or metres == np.inf:
                continue
            fly = (world.dist[w.node[u], m] + world.dist[m, n_tasks + p]) / uav[U_SPEED]
            there = w.gs[g, 1] + metres / world.ugvs[g, G_SPEED]
            wait = max(0.0, there - w.us[u, 0] - fly - uav[U_SERVICE])
            need = uav[U_CRUISE] * fly + uav[U_HOVER] * uav[U_SERVICE] + uav[U_WAIT] * wait
            if w.us[u, 1] - need >= uav[U_RESERVE]:
                return m
    return -1


@jit
def together(world: World, w: Work, u: int, g: int, acts: Codes, rows: Floats) -> int:
    """One UAV and one UGV do all that is left; number of actions, -1 without success. ``w`` is changed."""
    n_sites = world.road.shape[1]
    details = np.empty(DETAILS)
    away = np.empty(n_sites)
    first = np.empty(n_sites, np.int64)
    n = 0
    fresh = False  # charged just now, at the UGV's place
    while w.sums[S_LEFT] > 0:
        if n >= acts.shape[0]:
            return -1
        at = w.site[g]
        m = _trip(world, w, u, g) if at < n_sites else -1
        if m < 0 and fresh:
            p = _stop(world, w, u, g, away, first)
            if p < 0:
                m = _through(world, w, u, g)
                if m < 0:
                    return -1
        elif m < 0:
            # The place of the earliest meeting; where the UGV is already, if that can be.
            p = -1
            if at < n_sites and rendezvous(world, w, u, g, at, details):
                p = at
            else:
                best = np.inf
                for q in range(n_sites):
                    if rendezvous(world, w, u, g, q, details) and details[P_END] < best:
                        best, p = details[P_END], q
            if p < 0:
                return -1
        if m >= 0:
            _take(world, w, acts, n, VISIT << KIND | u << VEHICLE | m, rows)
            fresh = False
        else:
            _take(world, w, acts, n, MEET << KIND | u << VEHICLE | p << SITE | g, rows)
            fresh = True
        n += 1
    return n if _sound(world, w) else -1


@jit
def complete(world: World, work: Work, space: Work, turn: Turn, hint: Codes, acts: Codes) -> int:
    """Finds a way from ``work`` into ``acts``; how many actions, -1 where none is found.

    Args:
        world: the problem.
        work: the state, left as it is.
        space: room for another state.
        turn: who is done already.
        hint: the pair of UAV and UGV to try first, and the one that was found, (2,).
        acts: room for at least 4 actions per task and 64 more.
    """
    if work.sums[kernel.S_CODE] != kernel.OK:
        return -1
    if work.sums[S_LEFT] > 0 and acting(work, turn) < 0:
        return -1
    n = alone(world, work, turn, acts)
    if n >= 0:
        copy_work(work, space)
        go(world, space, acts, 0, n, np.inf, turn.rows)
        if _sound(world, space):
            return n
    copy_work(work, space)
    n = staged(world, space, turn, acts)
    if n >= 0 and _sound(world, space):
        return n
    n_uavs, n_ugvs = world.uavs.shape[0], world.ugvs.shape[0]
    for k in range(-1, n_uavs * n_ugvs):
        u = hint[0] if k < 0 else k // n_ugvs
        g = hint[1] if k < 0 else k % n_ugvs
        if (k >= 0 and u == hint[0] and g == hint[1]) or g >= n_ugvs or u >= n_uavs:
            continue
        if turn.done[u] != 0 or world.ugv_on[g] == 0:
            continue
        copy_work(work, space)
        n = together(world, space, u, g, acts, turn.rows)
        if n >= 0:
            hint[0] = u
            hint[1] = g
            return n
    return -1
