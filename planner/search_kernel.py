"""The compiled part of the search: simulated annealing over the joint action list, and best insertion of tasks.

Moves are in ``moves_kernel`` (small) and ``ruin_kernel`` (large). A changed plan is evaluated from the last mark before
its first change: the state of all vehicles is kept at every ``EVERY``-th action of the current plan.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner import kernel
from planner.jit import jit
from planner.kernel import Codes, Floats, Ints, Work, World, advance, begin, finish, run
from planner.moves_kernel import Around, Counts, State, change, insert, remove, uniform
from planner.ruin_kernel import Tools, put_back, take_out

VISIT, KIND, VEHICLE, MASK = kernel.VISIT, kernel.KIND, kernel.VEHICLE, kernel.MASK
O_MAKESPAN, O_UNVISITED, O_SHORT_S = kernel.O_MAKESPAN, kernel.O_UNVISITED, kernel.O_SHORT_S
O_SUM_S, O_FLY_S, O_DRIVE_S = kernel.O_SUM_S, kernel.O_FLY_S, kernel.O_DRIVE_S
UNVISITED_S = 1e6  # what a task left out costs: more than any makespan, so the number of visits comes first
FLY, ACTION, FINISH = 2e-3, 0.02, 2e-4  # small weights per flown s, action, s of a UAV's last end
OVER = 10.0  # of a second of makespan above a cap
EVERY = 16


class Marks(NamedTuple):
    """The state of all vehicles before every ``EVERY``-th action; members as in ``kernel.Work``, one row a mark."""

    node: Ints
    us: Floats
    site: Ints
    gs: Floats
    docks: Floats
    sums: Floats


@jit
def keep(
    k: int, m_node: Ints, m_us: Floats, m_site: Ints, m_gs: Floats, m_docks: Floats, m_sums: Floats,
    node: Ints, us: Floats, site: Ints, gs: Floats, docks: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Keeps the state as mark ``k``."""
    for u in range(node.shape[0]):
        m_node[k, u] = node[u]
        m_us[k, u, 0] = us[u, 0]
        m_us[k, u, 1] = us[u, 1]
    for g in range(site.shape[0]):
        m_site[k, g] = site[g]
        for i in range(4):
            m_gs[k, g, i] = gs[g, i]
        for i in range(docks.shape[1]):
            m_docks[k, g, i] = docks[g, i]
    for i in range(sums.shape[0]):
        m_sums[k, i] = sums[i]


@jit
def back(
    k: int, m_node: Ints, m_us: Floats, m_site: Ints, m_gs: Floats, m_docks: Floats, m_sums: Floats,
    node: Ints, us: Floats, site: Ints, gs: Floats, docks: Floats, sums: Floats,
) -> None:  # fmt: skip
    """Goes back to the state of mark ``k``."""
    for u in range(node.shape[0]):
        node[u] = m_node[k, u]
        us[u, 0] = m_us[k, u, 0]
        us[u, 1] = m_us[k, u, 1]
    for g in range(site.shape[0]):
        site[g] = m_site[k, g]
        for i in range(4):
            gs[g, i] = m_gs[k, g, i]
        for i in range(docks.shape[1]):
            docks[g, i] = m_docks[k, g, i]
    for i in range(sums.shape[0]):
        sums[i] = m_sums[k, i]


@jit
def score(out: Floats, n: int, weight: float, unvisited_s: float, cap_s: float, drive: float) -> float:
    """What the search minimises, in s.

    Args:
        out: results of the evaluator.
        n: number of actions.
        weight: of a second of shortage.
        unvisited_s: of a task left out.
        cap_s: a makespan that is good enough: below it nothing is gained, above it much is lost. 0 for none.
        drive: of a second that a UGV drives.
    """
    span = out[O_MAKESPAN]
    if cap_s > 0.0:
        span = cap_s if span <= cap_s else cap_s + OVER * (span - cap_s)
    small = FLY * out[O_FLY_S] + drive * out[O_DRIVE_S] + FINISH * out[O_SUM_S] + ACTION * n
    return float(span + small + weight * out[O_SHORT_S] + unvisited_s * out[O_UNVISITED])


@jit
def anneal(
    best: Codes,  # the best plan so far, feasible where any is
    best_counts: Counts,
    current: Codes,
    counts: Counts,
    world: World,
    work: Work,
    around: Around,
    tools: Tools,
    marks: Marks,
    rows: Floats,  # (0, 9)
    partial: bool,
    rng: State,
    iterations: int,
    hot_s: float,
    cold_s: float,
    weight: float,
    unvisited_s: float,
    short_s: float,
    ruin: float,
    cap_s: float,
    drive: float,
    best_drive: float,
) -> float:
    """Runs ``iterations`` steps while the temperature falls from ``hot_s`` to ``cold_s``.

    ``best``, ``current`` and their counts are changed in place. A second of shortage costs ``weight`` in the walk and
    ``short_s`` where the best is chosen, a task left out ``unvisited_s`` and ``UNVISITED_S``. ``ruin`` is the share of
    large moves. ``cap_s`` and ``drive`` are those of ``score``, ``best_drive`` likewise where the best is chosen. The
    return value is the share of steps at which the current plan was feasible.
    """
    capacity = len(current)
    out = work.out
    a = current
    b = np.empty_like(current)
    b_counts = counts.copy()
    a_counts = counts.copy()
    run(world, work, best, best_counts[0], np.inf, rows)
    best_score = score(out, best_counts[0], short_s, UNVISITED_S, cap_s, best_drive)
    best_ok = out[O_SHORT_S] == 0.0
    dist, near, road, uavs, ugvs = world.dist, world.near, world.road, world.uavs, world.ugvs
    uav_on, ugv_on = world.uav_on, world.ugv_on
    node, us, site, gs, docks, seen, sums = work.node, work.us, work.site, work.gs, work.docks, work.seen, work.sums
    m_node, m_us, m_site, m_gs, m_docks, m_sums = (
        marks.node, marks.us, marks.site, marks.gs, marks.docks, marks.sums
    )  # fmt: skip
    near_tasks, near_sites, uav_list, ugv_list = around.tasks, around.sites, around.uavs, around.ugvs
    begin(world, work)
    keep(0, m_node, m_us, m_site, m_gs, m_docks, m_sums, node, us, site, gs, docks, sums)
    marked = 0  # marks up to this one are those of the current plan
    run(world, work, a, a_counts[0], np.inf, rows)
    a_score = score(out, a_counts[0], weight, unvisited_s, cap_s, drive)
    a_ok = out[O_SHORT_S] == 0.0
    a_span = out[O_MAKESPAN]
    a_ends = work.us[:, 0].copy()
    fine = 0
    ratio = (cold_s / hot_s) ** (1.0 / max(1, iterations))
    heat = hot_s
    for _ in range(iterations):
        heat *= ratio
        fine += a_ok
        total = a_counts[0] + a_counts[1]
        for i in range(total):
            b[i] = a[i]
        b_counts[0] = a_counts[0]
        b_counts[1] = a_counts[1]
        if uniform(rng) < ruin:
            for u in around.uavs:
                tools.ends[u] = a_ends[u]
            taken = take_out(b, b_counts, around, tools, rng)
            if taken == 0:
                continue
            put_back(b, b_counts, taken, a_span, world, around, tools, rng)
        elif not change(b, b_counts, capacity, near_tasks, near_sites, uav_list, ugv_list, partial, rng):
            continue
        n = b_counts[0]
        first = 0
        same = min(n, a_counts[0])
        while first < same and b[first] == a[first]:
            first += 1
        limit = a_score - heat * np.log(1.0 - uniform(rng))
        k = min(first // EVERY, marked)
        back(k, m_node, m_us, m_site, m_gs, m_docks, m_sums, node, us, site, gs, docks, sums)
        while marked < first // EVERY:  # what both plans have in common
            advance(dist, road, uavs, ugvs, uav_on, ugv_on, node, us, site, gs, docks, seen, sums,
                    b, EVERY * k, EVERY * (k + 1), np.inf, rows)  # fmt: skip
            k += 1
            marked = k
            keep(k, m_node, m_us, m_site, m_gs, m_docks, m_sums, node, us, site, gs, docks, sums)
        if not advance(dist, road, uavs, ugvs, uav_on, ugv_on, node, us, site, gs, docks, seen, sums,
                       b, EVERY * k, n, limit, rows):  # fmt: skip
            continue
        finish(dist, near, uavs, ugvs, uav_on, ugv_on, node, us, gs, sums, out)
        b_score = score(out, n, weight, unvisited_s, cap_s, drive)
        if b_score > limit:
            continue
        a, b = b, a
        a_score = b_score
        a_counts[0] = b_counts[0]
        a_counts[1] = b_counts[1]
        a_ok = out[O_SHORT_S] == 0.0
        a_span = out[O_MAKESPAN]
        for u in uav_list:
            a_ends[u] = us[u, 0]
        if a_ok or not best_ok:
            value = score(out, n, short_s, UNVISITED_S, cap_s, best_drive)
            if value < best_score or (a_ok and not best_ok):
                best_score = value
                best_ok = a_ok
                best_counts[0] = a_counts[0]
                best_counts[1] = a_counts[1]
                for i in range(a_counts[0] + a_counts[1]):
                    best[i] = a[i]
        marked = min(marked, first // EVERY)
    for i in range(a_counts[0] + a_counts[1]):
        b[i] = a[i]
    for i in range(a_counts[0] + a_counts[1]):
        current[i] = b[i]
    counts[0] = a_counts[0]
    counts[1] = a_counts[1]
    return fine / max(1, iterations)


@jit
def settle(
    acts: Codes,
    counts: Counts,
    world: World,
    work: Work,
    rows: Floats,
    uav_list: Ints,
    fill: bool,
    short_s: float,
    drive: float,
) -> None:
    """Puts pool tasks where they cost least (with ``fill`` all, else those that make the plan better).

    Recharges and moves that are of no use are taken out as well.
    """
    out = work.out
    trial = np.empty_like(acts)
    k = 0
    while k < counts[1]:
        n = counts[0]
        total = n + counts[1]
        task = acts[n + k] & MASK
        run(world, work, acts, n, np.inf, rows)
        least = np.inf if fill else score(out, n, short_s, UNVISITED_S, 0.0, drive)
        best_at = -1
        best_uav = 0
        for uav in uav_list:
            for at in range(n + 1):
                for i in range(at):
                    trial[i] = acts[i]
                trial[at] = uav << VEHICLE | task
                for i in range(at, n):
                    trial[i + 1] = acts[i]
                run(world, work, trial, n + 1, np.inf, rows)
                value = score(out, n + 1, short_s, UNVISITED_S, 0.0, drive)
                if value < least:
                    least = value
                    best_at = at
                    best_uav = uav
        if best_at < 0:
            k += 1
            continue
        remove(acts, total, n + k)
        insert(acts, total - 1, best_at, best_uav << VEHICLE | task)
        counts[0] += 1
        counts[1] -= 1
    i = counts[0] - 1
    run(world, work, acts, counts[0], np.inf, rows)
    least = score(out, counts[0], short_s, UNVISITED_S, 0.0, drive)
    while i >= 0:
        if (acts[i] >> KIND) != VISIT:
            total = counts[0] + counts[1]
            code = remove(acts, total, i)
            run(world, work, acts, counts[0] - 1, np.inf, rows)
            value = score(out, counts[0] - 1, short_s, UNVISITED_S, 0.0, drive)
            if value <= least:
                least = value
                counts[0] -= 1
            else:
                insert(acts, total - 1, i, code)
        i -= 1
