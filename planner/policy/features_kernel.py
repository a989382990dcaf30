"""What the ``plus`` network sees at a decision: features of nodes, meetings and drives, all without dimension.

Everything is told from the UAV whose turn it is: positions relative to it, in units of its range per charge; times from
its being ready, in units of the flight of that range; energies in units of what it may use. So neither scale nor place
of a map matters, nor what time it is. Values are cut off at ``CUT``. Tasks and UAVs also tell which routes a plain
heuristic would give to whom (``outline_kernel``).

The graph is the paper's (section "Approach"), as it stands at the decision: tasks that are left, sites (path points and
the depot), UAVs that still act, UGVs. The UAV whose turn it is comes first among the UAVs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner.kernel import (
    EPS_J,
    G_CHARGE_S,
    G_CHARGE_W,
    G_DOCK,
    G_DRIVE,
    G_ENERGY,
    G_IDLE,
    G_READY,
    G_SPEED,
    G_UNDOCK,
    S_MAKESPAN,
    U_CAPACITY,
    U_CRUISE,
    U_HOVER,
    U_RESERVE,
    U_SERVICE,
    U_SPEED,
    U_WAIT,
    Floats,
    Work,
    World,
)
from planner.policy.jit import jit
from planner.policy.outline_kernel import A_CHARGE, T_END, outline, short_j
from planner.policy.tokens_kernel import (
    P_ARRIVE,
    P_CHARGE,
    P_DRIVE,
    P_END,
    P_ENERGY,
    P_FLY,
    P_LEFT,
    P_THERE,
    P_WORK,
    Turn,
    after_visit,
)

Singles = NDArray[np.float32]
Indices = NDArray[np.int32]

N_TASK, N_SITE, N_UAV, N_UGV, N_PAIR = 17, 12, 25, 14, 11
CUT = 5.0
NEAR, AROUND = 0.12, 0.3  # radii in ranges for counting tasks


class View(NamedTuple):
    """One decision as the network takes it; rows beyond the counts are left as they are.

    Attributes:
        task: (>= tasks left, N_TASK).
        site: (n_sites, N_SITE).
        uav: (>= UAVs that act, N_UAV), the one whose turn it is first.
        ugv: (G, N_UGV).
        pair: of meetings, (G, n_sites, N_PAIR); the first is 1 where it is offered.
        drive: driving times, sites and then UGVs to sites, (n_sites + G, n_sites).
        tasks: which task each row is, (>= tasks left,).
        counts: tasks left, sites, UAVs that act, UGVs, whether ``done`` is offered, (5,).
    """

    task: Singles
    site: Singles
    uav: Singles
    ugv: Singles
    pair: Singles
    drive: Singles
    tasks: Indices
    counts: Indices


@jit
def _cut(value: float) -> float:
    return max(-CUT, min(CUT, value))


@jit
def reach_m(world: World, u: int) -> float:
    """Range of a UAV per charge, at most three times the largest distance and at least 1 m."""
    uav = world.uavs[u]
    most = 1.0
    for i in range(world.dist.shape[0]):
        for j in range(world.dist.shape[1] - world.road.shape[1], world.dist.shape[1]):
            most = max(most, 3.0 * world.dist[i, j])
    usable = max(0.0, uav[U_CAPACITY] - uav[U_RESERVE])
    if uav[U_CRUISE] * most >= usable * uav[U_SPEED]:
        most = usable * uav[U_SPEED] / uav[U_CRUISE]
    return max(1.0, most)


@jit
def fill_view(world: World, work: Work, turn: Turn, u: int, xy: Floats, reach: Floats, out: View) -> None:
    """Fills ``out`` in; ``tokens_kernel.offer`` was called before.

    Args:
        world: the problem.
        work: the state.
        turn: what is offered to ``u``.
        u: the UAV whose turn it is.
        xy: positions of nodes in m: tasks, sites, UAVs' and UGVs' starts, (N + U + G, 2).
        reach: ``reach_m`` of each UAV, (U,).
        out: the result.
    """
    n_tasks = world.visited.shape[0]
    n_sites = world.road.shape[1]
    n_uavs, n_ugvs = world.uavs.shape[0], world.ugvs.shape[0]
    me = world.uavs[u]
    scale = reach[u]
    unit_s = scale / me[U_SPEED]
    unit_j = max(1.0, me[U_CAPACITY] - me[U_RESERVE])
    now, energy, here = work.us[u, 0], work.us[u, 1], work.node[u]
    x0, y0 = xy[here, 0], xy[here, 1]

    left = 0
    for m in range(n_tasks):
        if work.seen[m] == 0:
            out.tasks[left] = m
            left += 1
    active = 0
    latest = now
    for v in range(n_uavs):
        if turn.done[v] == 0:
            active += 1
            latest = max(latest, work.us[v, 0])

    outline(world, work, turn)
    plain = turn.outline
    owner = np.zeros(n_tasks, np.int32)
    place = np.zeros(n_tasks, np.int32)
    end = now
    for v in range(n_uavs):
        end = max(end, plain.state[v, T_END])
        for i in range(plain.sizes[v]):
            owner[plain.routes[v, i]] = v
            place[plain.routes[v, i]] = i

    for i in range(left):
        m = out.tasks[i]
        away = world.dist[here, m]
        arrive = now + away / me[U_SPEED]
        spare = after_visit(world, work, u, m)
        after = energy - me[U_CRUISE] * (away / me[U_SPEED]) - me[U_HOVER] * me[U_SERVICE] - me[U_RESERVE]
        ahead, rank = 2.0, 0.0
        for v in range(n_uavs):
            if v != u and turn.done[v] == 0:
                other = work.us[v, 0] + world.dist[work.node[v], m] / world.uavs[v, U_SPEED]
                ahead = min(ahead, (other - arrive) / unit_s)
                rank += other < arrive
        first, second, near, around = 2.0, 2.0, 0.0, 0.0
        for j in range(left):
            if j != i:
                d = world.dist[m, out.tasks[j]] / scale
                if d < first:
                    first, second = d, first
                elif d < second:
                    second = d
                near += d < NEAR
                around += d < AROUND
        back = -1.0
        for g in range(n_ugvs):
            if world.ugv_on[g] != 0 and work.site[g] < n_sites:
                home = world.dist[m, n_tasks + work.site[g]] / me[U_SPEED]
                back = max(back, (after - me[U_CRUISE] * home) / unit_j)
        row = out.task[i]
        row[0] = _cut((xy[m, 0] - x0) / scale)
        row[1] = _cut((xy[m, 1] - y0) / scale)
        row[2] = _cut(away / scale)
        row[3] = _cut(world.near[m] / scale)
        row[4] = _cut(spare / unit_j) if spare > -np.inf else -1.0
        row[5] = turn.visits[m]
        row[6] = max(-2.0, ahead)
        row[7] = rank / max(1, active - 1)
        row[8] = first
        row[9] = second
        row[10] = 0.1 * near
        row[11] = around / left
        row[12] = _cut(back)
        row[13] = _cut((arrive + me[U_SERVICE] - latest) / unit_s)
        row[14] = owner[m] == u
        row[15] = 1.0 / (1.0 + place[m]) if owner[m] == u else 0.0
        row[16] = owner[m] != u and place[m] == 0

    for p in range(n_sites):
        node = n_tasks + p
        away = world.dist[here, node]
        fly = away / me[U_SPEED]
        soonest, wait, present, offered = CUT, CUT, 0.0, 0.0
        for g in range(n_ugvs):
            if world.ugv_on[g] != 0 and turn.details[g, p, P_WORK] < np.inf:
                soonest = min(soonest, (turn.details[g, p, P_THERE] - now) / unit_s)
                wait = min(wait, (turn.details[g, p, P_WORK] - now - fly) / unit_s)
                present += work.site[g] == p
                if turn.meets[g, p] != 0:
                    offered = 1.0
        first, near, around = 2.0, 0.0, 0.0
        for j in range(left):
            d = world.dist[out.tasks[j], node] / scale
            first = min(first, d)
            near += d < NEAR
            around += d < AROUND
        row = out.site[p]
        row[0] = _cut((xy[node, 0] - x0) / scale)
        row[1] = _cut((xy[node, 1] - y0) / scale)
        row[2] = _cut(away / scale)
        row[3] = _cut((energy - me[U_CRUISE] * fly - me[U_RESERVE]) / unit_j)
        row[4] = offered
        row[5] = _cut(soonest)
        row[6] = _cut(wait)
        row[7] = present
        row[8] = first
        row[9] = 0.1 * near
        row[10] = around / max(1, left)
        row[11] = p == n_sites - 1

    k = 0
    for turn_of in range(-1, n_uavs):
        v = u if turn_of < 0 else turn_of
        if turn.done[v] != 0 or (turn_of >= 0 and v == u):
            continue
        uav = world.uavs[v]
        at = work.node[v]
        usable = max(1.0, uav[U_CAPACITY] - uav[U_RESERVE])
        dx, dy = (xy[at, 0] - x0) / scale, (xy[at, 1] - y0) / scale
        first = 2.0
        for j in range(left):
            first = min(first, world.dist[at, out.tasks[j]] / scale)
        row = out.uav[k]
        row[0] = _cut(dx)
        row[1] = _cut(dy)
        row[2] = _cut(np.sqrt(dx * dx + dy * dy))
        row[3] = _cut((work.us[v, 1] - uav[U_RESERVE]) / usable)
        row[4] = _cut((work.us[v, 0] - now) / unit_s)
        row[5] = _cut(world.near[at] / scale)
        row[6] = v == u
        row[7] = _cut(uav[U_SPEED] / me[U_SPEED] - 1.0)
        row[8] = _cut(reach[v] / scale - 1.0)
        row[9] = _cut(left / (10.0 * active))
        row[10] = _cut(uav[U_WAIT] / max(1.0, uav[U_CRUISE]))
        row[11] = _cut(uav[U_SERVICE] / unit_s)
        row[12] = first
        row[13] = uav[U_CAPACITY] - work.us[v, 1] <= 1.0
        row[14] = _cut(left / 45.0)
        row[15] = _cut(active / 4.0)
        row[16] = _cut((latest - work.us[v, 0]) / unit_s)
        row[17] = _cut(0.5 * turn.row[v])
        row[18] = _cut((work.sums[S_MAKESPAN] - work.us[v, 0]) / unit_s)
        row[19] = turn.may_end[0]
        row[20] = left == 1
        row[21] = _cut((plain.state[v, T_END] - now) / unit_s)
        row[22] = _cut(
            short_j(world.near, plain.uavs, plain.routes, plain.sizes, plain.state, v) / plain.uavs[v, A_CHARGE]
        )
        row[23] = _cut(0.1 * plain.sizes[v])
        row[24] = _cut((end - plain.state[v, T_END]) / unit_s)
        k += 1

    for g in range(n_ugvs):
        ugv = world.ugvs[g]
        at = work.site[g]
        node = n_tasks + at if at < n_sites else n_tasks + n_sites + n_uavs + g
        dx, dy = (xy[node, 0] - x0) / scale, (xy[node, 1] - y0) / scale
        stood = max(0.0, work.gs[g, 1] - ugv[G_READY] - work.gs[g, 2])
        rest = ugv[G_ENERGY] - ugv[G_DRIVE] * work.gs[g, 2] - ugv[G_IDLE] * stood - work.gs[g, 3]
        charge = ugv[G_CHARGE_S]
        if ugv[G_CHARGE_W] > 0.0:
            charge = max(0.0, me[U_CAPACITY] - energy) / ugv[G_CHARGE_W]
        first, second, docks = np.inf, np.inf, 0.0
        for i in range(work.docks.shape[1]):
            free = work.docks[g, i]
            docks += free < np.inf
            if free < first:
                first, second = free, first
            elif free < second:
                second = free
        row = out.ugv[g]
        row[0] = _cut(dx)
        row[1] = _cut(dy)
        row[2] = _cut(np.sqrt(dx * dx + dy * dy))
        row[3] = _cut((work.gs[g, 0] - now) / unit_s)
        row[4] = _cut((work.gs[g, 1] - now) / unit_s)
        row[5] = _cut(0.1 * rest / max(1.0, ugv[G_DRIVE]) / unit_s)
        row[6] = _cut(0.02 * rest / unit_j)
        row[7] = _cut(ugv[G_SPEED] / me[U_SPEED])
        row[8] = _cut(charge / unit_s)
        row[9] = _cut((ugv[G_DOCK] + ugv[G_UNDOCK]) / unit_s)
        row[10] = _cut((first - now) / unit_s)
        row[11] = _cut((second - now) / unit_s)
        row[12] = at >= n_sites
        row[13] = world.ugv_on[g] * 0.25 * docks
        for p in range(n_sites):
            d = turn.details[g, p]
            some = out.pair[g, p]
            if d[P_WORK] == np.inf:
                some[:] = 0.0
            else:
                some[0] = turn.meets[g, p]
                some[1] = _cut(d[P_FLY] / scale)
                some[2] = _cut(d[P_DRIVE] / unit_s)
                some[3] = _cut((d[P_THERE] - now) / unit_s)
                some[4] = _cut((d[P_WORK] - d[P_ARRIVE]) / unit_s)
                some[5] = _cut(max(0.0, d[P_ARRIVE] - d[P_THERE]) / unit_s)
                some[6] = _cut((d[P_END] - now) / unit_s)
                some[7] = _cut((d[P_ENERGY] - me[U_RESERVE]) / unit_j)
                some[8] = at == p
                some[9] = _cut(d[P_CHARGE] / unit_s)
                some[10] = _cut(0.1 * d[P_LEFT] / max(1.0, ugv[G_DRIVE]) / unit_s)
            out.drive[n_sites + g, p] = _cut(world.road[at, p] / ugv[G_SPEED] / unit_s)
    quickest = EPS_J
    for g in range(n_ugvs):
        if world.ugv_on[g] != 0:
            quickest = max(quickest, world.ugvs[g, G_SPEED])
    for p in range(n_sites):
        for q in range(n_sites):
            out.drive[p, q] = _cut(world.road[p, q] / quickest / unit_s)
    out.counts[0] = left
    out.counts[1] = n_sites
    out.counts[2] = active
    out.counts[3] = n_ugvs
    out.counts[4] = turn.may_end[0]
