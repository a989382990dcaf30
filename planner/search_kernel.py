"""The compiled part of the search: simulated annealing over the joint action list, and best insertion of tasks.

A solution is one array: the plan's ``n`` actions, then a pool of visits that are left out. A ``counts`` array holds
``n`` and the pool's size. All randomness comes from the 64-bit state in ``rng``, so a run depends on nothing else.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from planner import kernel
from planner.jit import jit
from planner.kernel import Floats, Ints, run

VISIT, RECHARGE, MOVE = kernel.VISIT, kernel.RECHARGE, kernel.MOVE
O_MAKESPAN, O_UNVISITED, O_SHORT_S = kernel.O_MAKESPAN, kernel.O_UNVISITED, kernel.O_SHORT_S
O_SUM_S, O_FLY_S, O_DRIVE_S = kernel.O_SUM_S, kernel.O_FLY_S, kernel.O_DRIVE_S
UNVISITED_S = 1e6  # what a task left out costs: more than any makespan, so the number of visits comes first
FLY, DRIVE, ACTION, FINISH = 2e-3, 1e-3, 0.02, 2e-4  # small weights per flown s, driven s, action, UAV's last end

State = NDArray[np.uint64]
Flags = NDArray[np.uint8]


@jit
def uniform(rng: State) -> float:
    """The next random number in [0, 1): xorshift64* (Vigna 2016)."""
    x = rng[0]
    x ^= x >> np.uint64(12)
    x ^= x << np.uint64(25)
    x ^= x >> np.uint64(27)
    rng[0] = x
    return float((x * np.uint64(2685821657736338717)) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@jit
def below(rng: State, n: int) -> int:
    """A random whole number in [0, n)."""
    return int(uniform(rng) * n)


@jit
def insert(acts: Ints, total: int, at: int, code: int) -> None:
    """Puts ``code`` at index ``at``; what stood there and behind moves up."""
    for i in range(total, at, -1):
        acts[i] = acts[i - 1]
    acts[at] = code


@jit
def remove(acts: Ints, total: int, at: int) -> int:
    """Takes the code at index ``at`` out; what stood behind moves down."""
    code = acts[at]
    for i in range(at, total - 1):
        acts[i] = acts[i + 1]
    return int(code)


@jit
def pick(acts: Ints, n: int, rng: State, visit: bool) -> int:
    """Index of a random visit (or of anything else but a visit), -1 where a few draws found none."""
    for _ in range(8):
        i = below(rng, n)
        if ((acts[i] >> 24) == VISIT) == visit:
            return i
    return -1


@jit
def find_visit(acts: Ints, n: int, task: int) -> int:
    """Index of the visit of ``task``, -1 where the plan has none."""
    for i in range(n):
        if (acts[i] >> 24) == VISIT and (acts[i] & 4095) == task:
            return i
    return -1


@jit
def change(
    acts: Ints,
    counts: NDArray[np.int64],  # (2,) actions in the plan, tasks in the pool
    capacity: int,
    near_tasks: Ints,  # (n_tasks, K) nearest unvisited tasks of each task
    near_sites: Ints,  # (n_tasks, L) nearest sites of each task
    uav_list: Ints,
    ugv_list: Ints,
    partial: bool,
    rng: State,
) -> bool:
    """Changes the plan in place by one random move; False where the move drawn does not apply."""
    n = counts[0]
    pool = counts[1]
    total = n + pool
    n_uavs = len(uav_list)
    n_ugvs = len(ugv_list)
    room = capacity - total >= 3
    if pool > 0 and uniform(rng) < 0.3:
        k = n + below(rng, pool)
        task = acts[k] & 4095
        if n > 0 and uniform(rng) < 0.3:  # in exchange for another one
            i = pick(acts, n, rng, True)
            if i < 0:
                return False
            acts[k] = acts[i] & 4095
            acts[i] = (acts[i] & ~4095) | task
            return True
        remove(acts, total, k)
        insert(acts, total - 1, below(rng, n + 1), uav_list[below(rng, n_uavs)] << 12 | task)
        counts[0] += 1
        counts[1] -= 1
        return True
    if n == 0:
        return False
    r = uniform(rng)
    if r < 0.34:  # a visit elsewhere: beside a neighbour, or anywhere
        i = pick(acts, n, rng, True)
        if i < 0:
            return False
        task = acts[i] & 4095
        uav = (acts[i] >> 12) & 4095
        if partial and uniform(rng) < 0.02:
            remove(acts, total, i)
            insert(acts, total - 1, n - 1, task)
            counts[0] -= 1
            counts[1] += 1
            return True
        after = -1  # sometimes the UAV's next task comes along
        if uniform(rng) < 0.3:
            for k in range(i + 1, min(n, i + 12)):
                if (acts[k] >> 24) == VISIT and ((acts[k] >> 12) & 4095) == uav:
                    after = acts[k] & 4095
                    break
        if uniform(rng) < 0.6 and near_tasks.shape[1] > 0:
            k = below(rng, near_tasks.shape[1])
            k = below(rng, k + 1)
            j = find_visit(acts, n, near_tasks[task, k])
            if j < 0:
                return False
            uav = (acts[j] >> 12) & 4095
            j += below(rng, 2)
            remove(acts, total, i)
            if j > i:
                j -= 1
        else:
            if uniform(rng) < 0.5:
                uav = uav_list[below(rng, n_uavs)]
            remove(acts, total, i)
            j = below(rng, n)
        insert(acts, total - 1, j, uav << 12 | task)
        if after >= 0:
            remove(acts, total, find_visit(acts, n, after))
            insert(acts, total - 1, find_visit(acts, n - 1, task) + 1, uav << 12 | after)
    elif r < 0.46:  # two tasks change places
        i = pick(acts, n, rng, True)
        if i < 0:
            return False
        if uniform(rng) < 0.7 and near_tasks.shape[1] > 0:
            j = find_visit(acts, n, near_tasks[acts[i] & 4095, below(rng, near_tasks.shape[1])])
        else:
            j = pick(acts, n, rng, True)
        if j < 0 or j == i:
            return False
        task = acts[i] & 4095
        acts[i] = (acts[i] & ~4095) | (acts[j] & 4095)
        acts[j] = (acts[j] & ~4095) | task
    elif r < 0.58:  # a recharge or move earlier or later
        i = pick(acts, n, rng, False)
        if i < 0:
            return False
        j = below(rng, n) if uniform(rng) < 0.3 else min(n - 1, max(0, i + below(rng, 17) - 8))
        insert(acts, total - 1, j, remove(acts, total, i))
    elif r < 0.72:  # a new recharge, often with a move of the UGV to it
        if n_ugvs == 0 or not room:
            return False
        i = below(rng, n)
        uav = (acts[i] >> 12) & 4095
        if (acts[i] >> 24) == MOVE:
            uav = uav_list[below(rng, n_uavs)]
        ugv = ugv_list[below(rng, n_ugvs)]
        i += below(rng, 2)
        what = uniform(rng)
        if what < 0.75:
            insert(acts, total, i, RECHARGE << 24 | uav << 12 | ugv)
            total += 1
            counts[0] += 1
        if what > 0.35:
            j = pick(acts, n, rng, True)
            site = below(rng, near_sites.shape[1])
            if uniform(rng) < 0.7 and j >= 0:  # near a task of its neighbourhood
                j = min(max(i + below(rng, 7) - 3, 0), n - 1)
                if (acts[j] >> 24) == VISIT:
                    site = below(rng, min(3, near_sites.shape[1]))
                    site = near_sites[acts[j] & 4095, site]
            if what < 0.75 and uniform(rng) < 0.5:  # the UGV sets out earlier
                i = max(0, i - below(rng, 9))
            insert(acts, total, i, MOVE << 24 | ugv << 12 | site)
            counts[0] += 1
    elif r < 0.82:  # without a recharge or move, or two
        for _ in range(1 + below(rng, 2)):
            n = counts[0]
            if n == 0:
                return True
            i = pick(acts, n, rng, False)
            if i < 0:
                return False
            code = remove(acts, n + pool, i)
            counts[0] -= 1
            if (code >> 24) == MOVE and uniform(rng) < 0.3:  # and all that happens there
                ugv = (code >> 12) & 4095
                while i < counts[0]:
                    if (acts[i] >> 24) == MOVE and ((acts[i] >> 12) & 4095) == ugv:
                        break
                    if (acts[i] >> 24) == RECHARGE and (acts[i] & 4095) == ugv:
                        remove(acts, counts[0] + pool, i)
                        counts[0] -= 1
                    else:
                        i += 1
    elif r < 0.90:  # other UGV, other site, other UAV
        i = pick(acts, n, rng, False)
        if i < 0 or n_ugvs == 0:
            return False
        ugv = ugv_list[below(rng, n_ugvs)]
        if (acts[i] >> 24) == RECHARGE:
            if uniform(rng) < 0.5:
                acts[i] = (acts[i] & ~4095) | ugv
            else:
                acts[i] = RECHARGE << 24 | uav_list[below(rng, n_uavs)] << 12 | (acts[i] & 4095)
        elif uniform(rng) < 0.75:
            acts[i] = (acts[i] & ~4095) | below(rng, near_sites.shape[1])
        else:
            acts[i] = MOVE << 24 | ugv << 12 | (acts[i] & 4095)
    elif r < 0.96 or n_uavs < 2:  # a stretch of one UAV's tasks the other way round
        i = pick(acts, n, rng, True)
        if i < 0:
            return False
        uav = (acts[i] >> 12) & 4095
        j = i
        length = 1 + below(rng, 6)
        for k in range(i + 1, n):
            if (acts[k] >> 24) == VISIT and ((acts[k] >> 12) & 4095) == uav:
                j = k
                length -= 1
                if length == 0:
                    break
        if j == i:
            return False
        while i < j:
            task = acts[i] & 4095
            acts[i] = (acts[i] & ~4095) | (acts[j] & 4095)
            acts[j] = (acts[j] & ~4095) | task
            i += 1
            while i < j and ((acts[i] >> 24) != VISIT or ((acts[i] >> 12) & 4095) != uav):
                i += 1
            j -= 1
            while i < j and ((acts[j] >> 24) != VISIT or ((acts[j] >> 12) & 4095) != uav):
                j -= 1
    else:  # two UAVs change roles for a while, or to the end
        one = uav_list[below(rng, n_uavs)]
        two = uav_list[below(rng, n_uavs)]
        if one == two:
            return False
        i = below(rng, n)
        j = n if uniform(rng) < 0.6 else min(n, i + 2 + below(rng, 12))
        for k in range(i, j):
            if (acts[k] >> 24) != MOVE:
                uav = (acts[k] >> 12) & 4095
                if uav == one:
                    acts[k] = (acts[k] & ~(4095 << 12)) | two << 12
                elif uav == two:
                    acts[k] = (acts[k] & ~(4095 << 12)) | one << 12
    return True


@jit
def score(out: Floats, n: int, weight: float, unvisited_s: float) -> float:
    """What the search minimises, in s; ``weight`` is that of a shortage, ``unvisited_s`` of a task left out."""
    small = FLY * out[O_FLY_S] + DRIVE * out[O_DRIVE_S] + FINISH * out[O_SUM_S] + ACTION * n
    return float(out[O_MAKESPAN] + small + weight * out[O_SHORT_S] + unvisited_s * out[O_UNVISITED])


@jit
def anneal(
    best: Ints,  # the best plan so far, feasible where any is
    best_counts: NDArray[np.int64],
    current: Ints,
    counts: NDArray[np.int64],
    dist: Floats,
    near: Floats,
    road: Floats,
    uavs: Floats,
    ugvs: Floats,
    site0: Ints,
    docks0: Floats,
    visited: Flags,
    uav_on: Flags,
    ugv_on: Flags,
    rows: Floats,  # (0, 9)
    node: Ints,
    us: Floats,
    site: Ints,
    gs: Floats,
    docks: Floats,
    seen: Flags,
    out: Floats,
    near_tasks: Ints,
    near_sites: Ints,
    uav_list: Ints,
    ugv_list: Ints,
    partial: bool,
    rng: State,
    iterations: int,
    hot_s: float,
    cold_s: float,
    weight: float,
    unvisited_s: float,
    short_s: float,
) -> float:
    """Runs ``iterations`` steps while the temperature falls from ``hot_s`` to ``cold_s``.

    ``best``, ``current`` and their counts are changed in place. A second of shortage costs ``weight`` in the walk and
    ``short_s`` where the best is chosen, a task left out ``unvisited_s`` and ``UNVISITED_S``. The return value is the
    share of steps at which the current plan was feasible.
    """
    capacity = len(current)
    a = current
    b = np.empty_like(current)
    b_counts = counts.copy()
    a_counts = counts.copy()
    run(best, best_counts[0], dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf, rows,
        node, us, site, gs, docks, seen, out)  # fmt: skip
    best_score = score(out, best_counts[0], short_s, UNVISITED_S)
    best_ok = out[O_SHORT_S] == 0.0
    run(a, a_counts[0], dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf, rows,
        node, us, site, gs, docks, seen, out)  # fmt: skip
    a_score = score(out, a_counts[0], weight, unvisited_s)
    a_ok = out[O_SHORT_S] == 0.0
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
        if not change(b, b_counts, capacity, near_tasks, near_sites, uav_list, ugv_list, partial, rng):
            continue
        limit = a_score - heat * np.log(1.0 - uniform(rng))
        if not run(b, b_counts[0], dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, limit, rows,
                   node, us, site, gs, docks, seen, out):  # fmt: skip
            continue
        b_score = score(out, b_counts[0], weight, unvisited_s)
        if b_score > limit:
            continue
        a, b = b, a
        a_score = b_score
        a_counts[0] = b_counts[0]
        a_counts[1] = b_counts[1]
        a_ok = out[O_SHORT_S] == 0.0
        if a_ok or not best_ok:
            value = score(out, a_counts[0], short_s, UNVISITED_S)
            if value < best_score or (a_ok and not best_ok):
                best_score = value
                best_ok = a_ok
                best_counts[0] = a_counts[0]
                best_counts[1] = a_counts[1]
                for i in range(a_counts[0] + a_counts[1]):
                    best[i] = a[i]
    for i in range(a_counts[0] + a_counts[1]):
        b[i] = a[i]
    for i in range(a_counts[0] + a_counts[1]):
        current[i] = b[i]
    counts[0] = a_counts[0]
    counts[1] = a_counts[1]
    return fine / max(1, iterations)


@jit
def settle(
    acts: Ints,
    counts: NDArray[np.int64],
    dist: Floats,
    near: Floats,
    road: Floats,
    uavs: Floats,
    ugvs: Floats,
    site0: Ints,
    docks0: Floats,
    visited: Flags,
    uav_on: Flags,
    ugv_on: Flags,
    rows: Floats,
    node: Ints,
    us: Floats,
    site: Ints,
    gs: Floats,
    docks: Floats,
    seen: Flags,
    out: Floats,
    uav_list: Ints,
    fill: bool,
    short_s: float,
) -> None:
    """Puts pool tasks where they cost least (with ``fill`` all, else those that make the plan better).

    Recharges and moves that are of no use are taken out as well.
    """
    trial = np.empty_like(acts)
    k = 0
    while k < counts[1]:
        n = counts[0]
        total = n + counts[1]
        task = acts[n + k] & 4095
        run(acts, n, dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf, rows,
            node, us, site, gs, docks, seen, out)  # fmt: skip
        least = np.inf if fill else score(out, n, short_s, UNVISITED_S)
        best_at = -1
        best_uav = 0
        for uav in uav_list:
            for at in range(n + 1):
                for i in range(at):
                    trial[i] = acts[i]
                trial[at] = uav << 12 | task
                for i in range(at, n):
                    trial[i + 1] = acts[i]
                run(trial, n + 1, dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf, rows,
                    node, us, site, gs, docks, seen, out)  # fmt: skip
                value = score(out, n + 1, short_s, UNVISITED_S)
                if value < least:
                    least = value
                    best_at = at
                    best_uav = uav
        if best_at < 0:
            k += 1
            continue
        remove(acts, total, n + k)
        insert(acts, total - 1, best_at, best_uav << 12 | task)
        counts[0] += 1
        counts[1] -= 1
    i = counts[0] - 1
    run(acts, counts[0], dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf, rows,
        node, us, site, gs, docks, seen, out)  # fmt: skip
    least = score(out, counts[0], short_s, UNVISITED_S)
    while i >= 0:
        if (acts[i] >> 24) != VISIT:
            total = counts[0] + counts[1]
            code = remove(acts, total, i)
            run(acts, counts[0] - 1, dist, near, road, uavs, ugvs, site0, docks0, visited, uav_on, ugv_on, np.inf,
                rows, node, us, site, gs, docks, seen, out)  # fmt: skip
            value = score(out, counts[0] - 1, short_s, UNVISITED_S)
            if value <= least:
                least = value
                counts[0] -= 1
            else:
                insert(acts, total - 1, i, code)
        i -= 1
