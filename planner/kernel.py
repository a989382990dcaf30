"""The compiled evaluator: what ``docs/planning.md`` says, over plain arrays. The one source of truth for all methods.

An action is one int64: ``kind << 36 | vehicle << 24 | site << 12 | target``. Nodes are numbered tasks first
(``n_tasks``), then sites (path points, then the depot), then one start position per UAV.

``MEET`` is the search's own action: UGV ``target`` drives to ``site``, unless it is there, and recharges the UAV. It
does exactly what a move and a recharge do.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.jit import jit

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Flags = NDArray[np.uint8]
Codes = NDArray[np.int64]

VISIT, RECHARGE, MOVE, MEET = 0, 1, 2, 3
KIND, VEHICLE, SITE, MASK = 36, 24, 12, 4095
EPS_J = 1e-6

# columns of `uavs`, (U, 9)
U_ENERGY, U_CAPACITY, U_RESERVE, U_SPEED, U_CRUISE, U_HOVER, U_WAIT, U_SERVICE, U_READY = range(9)
# columns of `ugvs`, (G, 9); charge_w is 0 where charging is constant
G_ENERGY, G_SPEED, G_DRIVE, G_IDLE, G_CHARGE_S, G_CHARGE_W, G_DOCK, G_UNDOCK, G_READY = range(9)
# columns of `rows`, (n, 9), written where the caller wants details
R_START, R_END, R_ARRIVE, R_WORK, R_E_START, R_E_END, R_E_ARRIVE, R_DOCK, R_E_LAND = range(9)
# entries of `out`, (15,)
(
    O_MAKESPAN,
    O_UAV_J,
    O_UGV_J,
    O_GIVEN_J,
    O_WAITING,
    O_RECOVERY,
    O_END,
    O_UNVISITED,
    O_SHORT_S,
    O_CODE,
    O_WHERE,
    O_AMOUNT,
    O_SUM_S,
    O_FLY_S,
    O_DRIVE_S,
) = range(15)
OUT_SIZE = 15
# violations, in O_CODE; O_WHERE is the action, or the vehicle for the last three
(
    OK,
    V_TASK,
    V_SERVICE,
    V_UGV,
    V_WAIT,
    V_TWICE,
    V_ROAD,
    V_BETWEEN,
    V_DRIVE,
    V_GIVE,
    V_UAV_EXCLUDED,
    V_UGV_EXCLUDED,
    V_RECOVERY,
    V_STAND,
    V_UNVISITED,
) = range(15)
IMPOSSIBLE_S = 1e5  # stands for one impossible action in O_SHORT_S
AT_SITE_M = 1e-3
# entries of `Work.sums`: what has added up so far
S_MAKESPAN, S_LAST_END, S_UAV_J, S_FLY_S, S_WAITING, S_SHORT_S, S_CODE, S_WHERE, S_AMOUNT, S_LEFT = range(10)
SUMS_SIZE = 10


class World(NamedTuple):
    """A problem as arrays, with P path points, N = n_tasks + P + 1 nodes, U UAVs and G UGVs.

    Attributes:
        dist: flying distances in m, (N + U, N).
        near: distance to the nearest site in m, (N + U,).
        road: road distances in m, (P + 1 + G, P + 1); row P + 1 + g is where UGV g starts between path points.
        uavs: by the columns above, (U, 9).
        ugvs: by the columns above, (G, 9).
        site0: where UGVs start: a site or, between path points, P + 1 + g, (G,).
        docks0: times when docks are free, inf where there is no such dock, (G, most docks).
        visited: (n_tasks,).
        uav_on, ugv_on: 0 for vehicles that take no part, (U,) and (G,).
    """

    dist: Floats
    near: Floats
    road: Floats
    uavs: Floats
    ugvs: Floats
    site0: Ints
    docks0: Floats
    visited: Flags
    uav_on: Flags
    ugv_on: Flags


class Work(NamedTuple):
    """The state of all vehicles part of the way through a plan, and its results.

    Attributes:
        node: where UAVs are, (U,).
        us: UAVs' time and energy, (U, 2).
        site: where UGVs are, (G,).
        gs: UGVs' times of being there and of leaving at the earliest, driven s, given J, (G, 4).
        docks: (G, most docks).
        seen: tasks visited so far, (n_tasks,); (0,) where the caller vouches that no task is visited twice.
        sums: (SUMS_SIZE,).
        out: the results, (OUT_SIZE,).
    """

    node: Ints
    us: Floats
    site: Ints
    gs: Floats
    docks: Floats
    seen: Flags
    sums: Floats
    out: Floats


@jit
def begin(world: World, work: Work) -> None:
    """Puts ``work`` into the state before the first action."""
    n_tasks = world.visited.shape[0]
    n_sites = world.road.shape[1]
    docks0, ugvs, gs = world.docks0, world.ugvs, work.gs
    for u in range(world.uavs.shape[0]):
        work.node[u] = n_tasks + n_sites + u
        work.us[u, 0] = world.uavs[u, U_READY]
        work.us[u, 1] = world.uavs[u, U_ENERGY]
    for g in range(ugvs.shape[0]):
        work.site[g] = world.site0[g]
        gs[g, 0] = ugvs[g, G_READY]
        leave = ugvs[g, G_READY]
        for k in range(docks0.shape[1]):
            work.docks[g, k] = docks0[g, k]
            if docks0[g, k] != np.inf and docks0[g, k] > leave:
                leave = docks0[g, k]
        gs[g, 1] = leave
        gs[g, 2] = 0.0
        gs[g, 3] = 0.0
    left = 0
    for m in range(n_tasks):
        left += 1 - world.visited[m]
        if work.seen.shape[0] > 0:
            work.seen[m] = world.visited[m]
    work.sums[:] = 0.0
    work.sums[S_CODE] = OK
    work.sums[S_LEFT] = left


@jit
def drive(g: int, to: int, road: Floats, ugvs: Floats, ugv_on: Flags, site: Ints, gs: Floats) -> float:
    """Sends UGV ``g`` to site ``to``; how long it drives in s, -1 where it cannot (then nothing is changed)."""
    metres = road[site[g], to]
    if ugv_on[g] == 0 or metres == np.inf:
        return -1.0
    away = metres / ugvs[g, G_SPEED]
    site[g] = to
    gs[g, 1] += away
    gs[g, 0] = gs[g, 1]
    gs[g, 2] += away
    return float(away)


@jit
def advance(
    dist: Floats,  # of ``World``, up to ``ugv_on``
    road: Floats,
    uavs: Floats,
    ugvs: Floats,
    uav_on: Flags,
    ugv_on: Flags,
    node: Ints,  # of ``Work``, up to ``sums``: the state before action ``first``, changed into that behind the last
    us: Floats,
    site: Ints,
    gs: Floats,
    docks: Floats,
    seen: Flags,
    sums: Floats,
    acts: Codes,  # the plan, (>= n,)
    first: int,
    n: int,
    limit_s: float,
    rows: Floats,  # (n, 9), filled with details; (0, 9) where none are wanted
) -> bool:
    """Takes actions ``first`` to ``n - 1``; False as soon as a visit ends after ``limit_s`` (the state is void then).

    The search calls it millions of times a second, so it takes the members of ``World`` and ``Work`` one by one: numba
    counts references for every array of a tuple at every call.
    """
    n_sites = road.shape[1]
    n_tasks = dist.shape[1] - n_sites
    n_docks = docks.shape[1]
    detail = rows.shape[0] > 0
    check = seen.shape[0] > 0
    makespan = sums[S_MAKESPAN]
    last_end = sums[S_LAST_END]
    uav_j = sums[S_UAV_J]
    fly_s = sums[S_FLY_S]
    waiting = sums[S_WAITING]
    short_s = sums[S_SHORT_S]
    code = int(sums[S_CODE])
    where = int(sums[S_WHERE])
    amount = sums[S_AMOUNT]
    left = int(sums[S_LEFT])

    for i in range(first, n):
        a = acts[i]
        kind = a >> KIND
        v = (a >> VEHICLE) & MASK
        target = a & MASK
        if kind == MEET and site[target] != ((a >> SITE) & MASK):
            away = drive(target, (a >> SITE) & MASK, road, ugvs, ugv_on, site, gs)
            if away < 0.0:
                short_s += IMPOSSIBLE_S
                continue
        if kind != MOVE:
            t0 = us[v, 0]
            e0 = us[v, 1]
            bad = OK
            if uav_on[v] == 0:
                bad = V_UAV_EXCLUDED
            elif kind != VISIT:
                if ugv_on[target] == 0:
                    bad = V_UGV_EXCLUDED
                elif site[target] >= n_sites:
                    bad = V_BETWEEN
            if bad != OK:
                # An impossible action is passed over: it takes no time, and the search pays for it.
                short_s += IMPOSSIBLE_S
                if code == OK:
                    code, where, amount = bad, i, 0.0
                if detail:
                    rows[i, R_START] = rows[i, R_END] = rows[i, R_ARRIVE] = rows[i, R_WORK] = t0
                    rows[i, R_E_START] = rows[i, R_E_END] = rows[i, R_E_ARRIVE] = rows[i, R_E_LAND] = e0
                    rows[i, R_DOCK] = -1.0
                continue
            reserve = uavs[v, U_RESERVE]
            to = target if kind == VISIT else n_tasks + site[target]
            fly = dist[node[v], to] / uavs[v, U_SPEED]
            node[v] = to
            arrive = t0 + fly
            e_land = e0 - uavs[v, U_CRUISE] * fly
            fly_s += fly
            if kind == VISIT:
                service = uavs[v, U_SERVICE]
                e_arrive = e_land - uavs[v, U_HOVER] * service
                end = arrive + service
                if end > limit_s:
                    return False
                makespan = max(makespan, end)
                if check and seen[target] != 0:
                    short_s += IMPOSSIBLE_S
                    if code == OK:
                        code, where, amount = V_TWICE, i, 0.0
                else:
                    if check:
                        seen[target] = 1
                    left -= 1
                if code == OK and e_arrive < reserve - EPS_J:
                    code = V_TASK if e_land < reserve - EPS_J else V_SERVICE
                    where, amount = i, reserve - e_arrive
                uav_j += e0 - e_arrive
                work = arrive
                e_end = e_arrive
                dock = -1
            else:
                g = target
                dock = 0
                free = docks[g, 0]
                for k in range(1, n_docks):
                    if docks[g, k] < free:
                        free = docks[g, k]
                        dock = k
                work = max(arrive, gs[g, 0], free)
                wait = work - arrive
                waiting += wait
                e_arrive = e_land - uavs[v, U_WAIT] * wait
                uav_j += e0 - e_arrive
                if e_arrive < reserve - EPS_J:
                    short_s += (reserve - e_arrive) / max(1.0, uavs[v, U_CRUISE])
                    if code == OK:
                        code = V_UGV if e_land < reserve - EPS_J else V_WAIT
                        where, amount = i, reserve - e_arrive
                given = max(0.0, uavs[v, U_CAPACITY] - e_arrive)
                charge = ugvs[g, G_CHARGE_S]
                if ugvs[g, G_CHARGE_W] > 0.0:
                    charge = given / ugvs[g, G_CHARGE_W]
                end = work + ugvs[g, G_DOCK] + charge + ugvs[g, G_UNDOCK]
                docks[g, dock] = end
                gs[g, 1] = max(gs[g, 1], end)
                gs[g, 3] += given
                e_end = e_arrive + given
                if code == OK:
                    stand = max(0.0, end - ugvs[g, G_READY] - gs[g, 2])
                    rest = ugvs[g, G_ENERGY] - ugvs[g, G_DRIVE] * gs[g, 2] - ugvs[g, G_IDLE] * stand - gs[g, 3]
                    if rest < -EPS_J:
                        code, where, amount = V_GIVE, i, -rest
            us[v, 0] = end
            us[v, 1] = e_end
        else:
            g = v
            t0 = gs[g, 1]
            e0 = 0.0
            if detail or code == OK:
                stand = max(0.0, t0 - ugvs[g, G_READY] - gs[g, 2])
                e0 = ugvs[g, G_ENERGY] - ugvs[g, G_DRIVE] * gs[g, 2] - ugvs[g, G_IDLE] * stand - gs[g, 3]
            away = drive(g, target, road, ugvs, ugv_on, site, gs)
            if away < 0.0:
                short_s += IMPOSSIBLE_S
                if code == OK:
                    code, where, amount = (V_UGV_EXCLUDED if ugv_on[g] == 0 else V_ROAD), i, 0.0
                away = 0.0
                gs[g, 0] = t0
            arrive = work = end = t0 + away
            e_land = e_arrive = e_end = e0 - ugvs[g, G_DRIVE] * away
            dock = -1
            if code == OK and e_end < -EPS_J:
                code, where, amount = V_DRIVE, i, -e_end
        last_end = max(last_end, end)
        if detail:
            rows[i, R_START] = t0
            rows[i, R_END] = end
            rows[i, R_ARRIVE] = arrive
            rows[i, R_WORK] = work
            rows[i, R_E_START] = e0
            rows[i, R_E_END] = e_end
            rows[i, R_E_ARRIVE] = e_arrive
            rows[i, R_DOCK] = dock
            rows[i, R_E_LAND] = e_land

    sums[S_MAKESPAN] = makespan
    sums[S_LAST_END] = last_end
    sums[S_UAV_J] = uav_j
    sums[S_FLY_S] = fly_s
    sums[S_WAITING] = waiting
    sums[S_SHORT_S] = short_s
    sums[S_CODE] = code
    sums[S_WHERE] = where
    sums[S_AMOUNT] = amount
    sums[S_LEFT] = left
    return True


@jit
def finish(
    dist: Floats,
    near: Floats,
    uavs: Floats,
    ugvs: Floats,
    uav_on: Flags,
    ugv_on: Flags,
    node: Ints,
    us: Floats,
    gs: Floats,
    sums: Floats,
    out: Floats,
) -> None:
    """Fills ``out`` from the state behind the last action; the state stays as it is."""
    first_start = dist.shape[1]
    short_s = sums[S_SHORT_S]
    code = int(sums[S_CODE])
    where = int(sums[S_WHERE])
    amount = sums[S_AMOUNT]
    recovery = 0.0
    sum_s = 0.0
    for u in range(uavs.shape[0]):
        if uav_on[u] == 0:
            continue
        home = near[node[u]]
        fly = home / uavs[u, U_SPEED]
        recovery = max(recovery, us[u, 0] + fly)
        sum_s += us[u, 0]
        short = uavs[u, U_RESERVE] - (us[u, 1] - uavs[u, U_CRUISE] * fly)
        if short > EPS_J and not (node[u] >= first_start and home <= AT_SITE_M):
            short_s += short / max(1.0, uavs[u, U_CRUISE])
            if code == OK:
                code, where, amount = V_RECOVERY, u, short
    ugv_j = 0.0
    given_j = 0.0
    drive_s = 0.0
    for g in range(ugvs.shape[0]):
        if ugv_on[g] == 0:
            continue
        stand = max(0.0, sums[S_LAST_END] - ugvs[g, G_READY] - gs[g, 2])
        used = ugvs[g, G_DRIVE] * gs[g, 2] + ugvs[g, G_IDLE] * stand
        ugv_j += used
        given_j += gs[g, 3]
        drive_s += gs[g, 2]
        short = used + gs[g, 3] - ugvs[g, G_ENERGY]
        if short > EPS_J:
            short_s += short / max(1.0, ugvs[g, G_DRIVE])
            if code == OK:
                code, where, amount = V_STAND, g, short
    if code == OK and sums[S_LEFT] > 0:
        code = V_UNVISITED
    out[O_MAKESPAN] = sums[S_MAKESPAN]
    out[O_UAV_J] = sums[S_UAV_J]
    out[O_UGV_J] = ugv_j
    out[O_GIVEN_J] = given_j
    out[O_WAITING] = sums[S_WAITING]
    out[O_RECOVERY] = recovery
    out[O_END] = sums[S_LAST_END]
    out[O_UNVISITED] = sums[S_LEFT]
    out[O_SHORT_S] = short_s
    out[O_CODE] = code
    out[O_WHERE] = where
    out[O_AMOUNT] = amount
    out[O_SUM_S] = sum_s
    out[O_FLY_S] = sums[S_FLY_S]
    out[O_DRIVE_S] = drive_s


@jit
def go(world: World, work: Work, acts: Codes, first: int, n: int, limit_s: float, rows: Floats) -> bool:
    """``advance``, for whoever has the time to pass tuples."""
    w = world
    return advance(w.dist, w.road, w.uavs, w.ugvs, w.uav_on, w.ugv_on, work.node, work.us, work.site, work.gs,
                   work.docks, work.seen, work.sums, acts, first, n, limit_s, rows)  # fmt: skip


@jit
def total(world: World, work: Work) -> None:
    """``finish``, likewise."""
    w = world
    finish(w.dist, w.near, w.uavs, w.ugvs, w.uav_on, w.ugv_on, work.node, work.us, work.gs, work.sums, work.out)


@jit
def run(world: World, work: Work, acts: Codes, n: int, limit_s: float, rows: Floats) -> bool:
    """Evaluates a plan into ``work.out``; False as soon as a visit ends after ``limit_s`` (then it is not filled)."""
    begin(world, work)
    if not go(world, work, acts, 0, n, limit_s, rows):
        return False
    total(world, work)
    return True
