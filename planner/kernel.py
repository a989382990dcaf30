"""The compiled evaluator: what ``docs/planning.md`` says, over plain arrays. The one source of truth for all methods.

An action is one int32: ``kind << 24 | vehicle << 12 | target``. Nodes are numbered tasks first (``n_tasks``), then
sites (path points, then the depot), then one start position per UAV.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner.jit import jit

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

VISIT, RECHARGE, MOVE = 0, 1, 2
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


@jit
def run(
    acts: Ints,  # (>= n,)
    n: int,
    dist: Floats,  # (N + U, N) flying distances in m, N = n_tasks + P + 1
    near: Floats,  # (N + U,) distance to the nearest site
    road: Floats,  # (P + 1 + G, P + 1); row P + 1 + g is where UGV g starts between path points
    uavs: Floats,
    ugvs: Floats,
    site0: Ints,  # (G,) site or, between path points, P + 1 + g
    docks0: Floats,  # (G, max docks) times when docks are free; inf where there is no such dock
    visited: NDArray[np.uint8],  # (n_tasks,)
    uav_on: NDArray[np.uint8],  # (U,)
    ugv_on: NDArray[np.uint8],  # (G,)
    limit_s: float,
    rows: Floats,  # (n, 9), or (0, 9) where no details are wanted
    node: Ints,  # (U,) work space
    us: Floats,  # (U, 2) work space: time, energy
    site: Ints,  # (G,) work space
    gs: Floats,  # (G, 4) work space: present from, may leave from, driven s, given J
    docks: Floats,  # (G, max docks) work space
    seen: NDArray[np.uint8],  # (n_tasks,) work space
    out: Floats,  # (OUT_SIZE,)
) -> bool:
    """Evaluates a plan; False as soon as a visit ends after ``limit_s`` (then ``out`` is not filled)."""
    n_tasks = visited.shape[0]
    n_sites = road.shape[1]
    n_uavs = uavs.shape[0]
    n_ugvs = ugvs.shape[0]
    n_docks = docks0.shape[1]
    detail = rows.shape[0] > 0
    for u in range(n_uavs):
        node[u] = n_tasks + n_sites + u
        us[u, 0] = uavs[u, U_READY]
        us[u, 1] = uavs[u, U_ENERGY]
    for g in range(n_ugvs):
        site[g] = site0[g]
        gs[g, 0] = ugvs[g, G_READY]
        leave = ugvs[g, G_READY]
        for k in range(n_docks):
            docks[g, k] = docks0[g, k]
            if docks0[g, k] != np.inf and docks0[g, k] > leave:
                leave = docks0[g, k]
        gs[g, 1] = leave
        gs[g, 2] = 0.0
        gs[g, 3] = 0.0
    left = 0
    for m in range(n_tasks):
        seen[m] = visited[m]
        left += 1 - visited[m]

    makespan = 0.0
    last_end = 0.0
    uav_j = 0.0
    fly_s = 0.0
    waiting = 0.0
    short_s = 0.0
    code = OK
    where = 0
    amount = 0.0

    for i in range(n):
        a = acts[i]
        kind = a >> 24
        v = (a >> 12) & 4095
        target = a & 4095
        if kind != MOVE:
            t0 = us[v, 0]
            e0 = us[v, 1]
            bad = OK
            if uav_on[v] == 0:
                bad = V_UAV_EXCLUDED
            elif kind == RECHARGE:
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
                if seen[target] != 0:
                    short_s += IMPOSSIBLE_S
                    if code == OK:
                        code, where, amount = V_TWICE, i, 0.0
                else:
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
            metres = road[site[g], target]
            if ugv_on[g] == 0 or metres == np.inf:
                short_s += IMPOSSIBLE_S
                if code == OK:
                    code, where, amount = (V_UGV_EXCLUDED if ugv_on[g] == 0 else V_ROAD), i, 0.0
                drive = 0.0
            else:
                drive = metres / ugvs[g, G_SPEED]
                site[g] = target
            arrive = work = end = t0 + drive
            gs[g, 0] = end
            gs[g, 1] = end
            gs[g, 2] += drive
            e_land = e_arrive = e_end = e0 - ugvs[g, G_DRIVE] * drive
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

    recovery = 0.0
    sum_s = 0.0
    for u in range(n_uavs):
        if uav_on[u] == 0:
            continue
        home = near[node[u]]
        fly = home / uavs[u, U_SPEED]
        recovery = max(recovery, us[u, 0] + fly)
        sum_s += us[u, 0]
        short = uavs[u, U_RESERVE] - (us[u, 1] - uavs[u, U_CRUISE] * fly)
        if short > EPS_J and not (node[u] >= n_tasks + n_sites and home <= AT_SITE_M):
            short_s += short / max(1.0, uavs[u, U_CRUISE])
            if code == OK:
                code, where, amount = V_RECOVERY, u, short
    ugv_j = 0.0
    given_j = 0.0
    drive_s = 0.0
    for g in range(n_ugvs):
        if ugv_on[g] == 0:
            continue
        stand = max(0.0, last_end - ugvs[g, G_READY] - gs[g, 2])
        used = ugvs[g, G_DRIVE] * gs[g, 2] + ugvs[g, G_IDLE] * stand
        ugv_j += used
        given_j += gs[g, 3]
        drive_s += gs[g, 2]
        short = used + gs[g, 3] - ugvs[g, G_ENERGY]
        if short > EPS_J:
            short_s += short / max(1.0, ugvs[g, G_DRIVE])
            if code == OK:
                code, where, amount = V_STAND, g, short
    if code == OK and left > 0:
        code = V_UNVISITED
    out[O_MAKESPAN] = makespan
    out[O_UAV_J] = uav_j
    out[O_UGV_J] = ugv_j
    out[O_GIVEN_J] = given_j
    out[O_WAITING] = waiting
    out[O_RECOVERY] = recovery
    out[O_END] = last_end
    out[O_UNVISITED] = left
    out[O_SHORT_S] = short_s
    out[O_CODE] = code
    out[O_WHERE] = where
    out[O_AMOUNT] = amount
    out[O_SUM_S] = sum_s
    out[O_FLY_S] = fly_s
    out[O_DRIVE_S] = drive_s
    return True
