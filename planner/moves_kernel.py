"""The search's small moves: single tasks, recharges and UGV moves change their place in the joint action list.

A solution is one array: the plan's ``n`` actions, then a pool of visits that are left out. A ``counts`` array holds
``n`` and the pool's size, (2,). All randomness comes from the 64-bit state in ``rng``: a run depends on nothing else.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from planner import kernel
from planner.jit import jit
from planner.kernel import Codes, Ints

VISIT, MEET = kernel.VISIT, kernel.MEET
KIND, VEHICLE, SITE, MASK = kernel.KIND, kernel.VEHICLE, kernel.SITE, kernel.MASK
PLACE = MASK << SITE | MASK  # the bits of a meeting's UGV and site
NEAREST = 8  # a single task moves beside one of so many neighbours

State = NDArray[np.uint64]
Counts = NDArray[np.int64]


class Around(NamedTuple):
    """What the moves know of a problem.

    Attributes:
        tasks: nearest unvisited tasks of each task, nearest first, (n_tasks, K).
        sites: nearest sites of each task, nearest first, (n_tasks, P + 1).
        uavs, ugvs: those that take part.
    """

    tasks: Ints
    sites: Ints
    uavs: Ints
    ugvs: Ints


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
def insert(acts: Codes, total: int, at: int, code: int) -> None:
    """Puts ``code`` at index ``at``; what stood there and behind moves up."""
    for i in range(total, at, -1):
        acts[i] = acts[i - 1]
    acts[at] = code


@jit
def remove(acts: Codes, total: int, at: int) -> int:
    """Takes the code at index ``at`` out; what stood behind moves down."""
    code = acts[at]
    for i in range(at, total - 1):
        acts[i] = acts[i + 1]
    return int(code)


@jit
def pick(acts: Codes, n: int, rng: State, visit: bool) -> int:
    """Index of a random visit (or of anything else but a visit), -1 where a few draws found none."""
    for _ in range(8):
        i = below(rng, n)
        if ((acts[i] >> KIND) == VISIT) == visit:
            return i
    return -1


@jit
def find_visit(acts: Codes, n: int, task: int) -> int:
    """Index of the visit of ``task``, -1 where the plan has none."""
    for i in range(n):
        if (acts[i] >> KIND) == VISIT and (acts[i] & MASK) == task:
            return i
    return -1


@jit
def somewhere(acts: Codes, n: int, i: int, near_sites: Ints, ugv_list: Ints, rng: State) -> int:
    """A UGV and a site for a meeting about action ``i``: as at a stop nearby in the plan, near a task, or anywhere."""
    what = uniform(rng)
    if what < 0.4:
        step = 1 - 2 * below(rng, 2)
        j = i + step
        while 0 <= j < n:
            if (acts[j] >> KIND) == MEET and uniform(rng) < 0.7:
                return int(acts[j] & PLACE)
            j += step
    site = below(rng, near_sites.shape[1])
    if what < 0.85:
        j = min(max(i + below(rng, 9) - 4, 0), n - 1)
        if (acts[j] >> KIND) == VISIT:
            site = near_sites[acts[j] & MASK, below(rng, min(3, near_sites.shape[1]))]
    return int(site << SITE | ugv_list[below(rng, len(ugv_list))])


@jit
def stop_of(acts: Codes, n: int, i: int) -> tuple[int, int]:
    """First and last index of the meetings that UGV and site of meeting ``i`` share without a drive between them."""
    ugv = acts[i] & MASK
    place = acts[i] & PLACE
    first = i
    for k in range(i - 1, -1, -1):
        if (acts[k] >> KIND) == MEET and (acts[k] & MASK) == ugv:
            if (acts[k] & PLACE) != place:
                break
            first = k
    last = i
    for k in range(i + 1, n):
        if (acts[k] >> KIND) == MEET and (acts[k] & MASK) == ugv:
            if (acts[k] & PLACE) != place:
                break
            last = k
    return first, last


@jit
def change(
    acts: Codes,
    counts: Counts,
    capacity: int,
    near_tasks: Ints,  # as in ``Around``, like the following three
    near_sites: Ints,
    uav_list: Ints,
    ugv_list: Ints,
    partial: bool,
    rng: State,
) -> bool:
    """Changes the plan in place by one random move; False where the move drawn does not apply."""
    nearest = min(NEAREST, near_tasks.shape[1])
    n = counts[0]
    pool = counts[1]
    total = n + pool
    n_uavs = len(uav_list)
    n_ugvs = len(ugv_list)
    room = capacity - total >= 3
    if pool > 0 and uniform(rng) < 0.3:
        k = n + below(rng, pool)
        task = acts[k] & MASK
        if n > 0 and uniform(rng) < 0.3:  # in exchange for another one
            i = pick(acts, n, rng, True)
            if i < 0:
                return False
            acts[k] = acts[i] & MASK
            acts[i] = (acts[i] & ~MASK) | task
            return True
        remove(acts, total, k)
        insert(acts, total - 1, below(rng, n + 1), uav_list[below(rng, n_uavs)] << VEHICLE | task)
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
        task = acts[i] & MASK
        uav = (acts[i] >> VEHICLE) & MASK
        if partial and uniform(rng) < 0.02:
            remove(acts, total, i)
            insert(acts, total - 1, n - 1, task)
            counts[0] -= 1
            counts[1] += 1
            return True
        after = -1  # sometimes the UAV's next task comes along
        if uniform(rng) < 0.3:
            for k in range(i + 1, min(n, i + 12)):
                if (acts[k] >> KIND) == VISIT and ((acts[k] >> VEHICLE) & MASK) == uav:
                    after = acts[k] & MASK
                    break
        if uniform(rng) < 0.6 and nearest > 0:
            k = below(rng, nearest)
            k = below(rng, k + 1)
            j = find_visit(acts, n, near_tasks[task, k])
            if j < 0:
                return False
            uav = (acts[j] >> VEHICLE) & MASK
            j += below(rng, 2)
            remove(acts, total, i)
            if j > i:
                j -= 1
        else:
            if uniform(rng) < 0.5:
                uav = uav_list[below(rng, n_uavs)]
            remove(acts, total, i)
            j = below(rng, n)
        insert(acts, total - 1, j, uav << VEHICLE | task)
        if after >= 0:
            remove(acts, total, find_visit(acts, n, after))
            insert(acts, total - 1, find_visit(acts, n - 1, task) + 1, uav << VEHICLE | after)
    elif r < 0.46:  # two tasks change places
        i = pick(acts, n, rng, True)
        if i < 0:
            return False
        if uniform(rng) < 0.7 and nearest > 0:
            j = find_visit(acts, n, near_tasks[acts[i] & MASK, below(rng, nearest)])
        else:
            j = pick(acts, n, rng, True)
        if j < 0 or j == i:
            return False
        task = acts[i] & MASK
        acts[i] = (acts[i] & ~MASK) | (acts[j] & MASK)
        acts[j] = (acts[j] & ~MASK) | task
    elif r < 0.58:  # a meeting earlier or later
        i = pick(acts, n, rng, False)
        if i < 0:
            return False
        j = below(rng, n) if uniform(rng) < 0.3 else min(n - 1, max(0, i + below(rng, 17) - 8))
        insert(acts, total - 1, j, remove(acts, total, i))
    elif r < 0.70:  # a new meeting
        if n_ugvs == 0 or not room:
            return False
        i = below(rng, n)
        uav = (acts[i] >> VEHICLE) & MASK
        place = somewhere(acts, n, i, near_sites, ugv_list, rng)
        insert(acts, total, i + below(rng, 2), MEET << KIND | uav << VEHICLE | place)
        counts[0] += 1
    elif r < 0.79:  # without a meeting, or without all at one stop
        i = pick(acts, n, rng, False)
        if i < 0:
            return False
        if uniform(rng) < 0.7:
            remove(acts, total, i)
            counts[0] -= 1
        else:
            i, j = stop_of(acts, n, i)
            place = acts[i] & PLACE
            while i < counts[0] and i <= j:
                if (acts[i] >> KIND) == MEET and (acts[i] & PLACE) == place:
                    remove(acts, counts[0] + pool, i)
                    counts[0] -= 1
                    j -= 1
                else:
                    i += 1
    elif r < 0.90:  # another UGV, site or UAV
        i = pick(acts, n, rng, False)
        if i < 0 or n_ugvs == 0:
            return False
        what = uniform(rng)
        if what < 0.15:
            acts[i] = (acts[i] & ~(MASK << VEHICLE)) | uav_list[below(rng, n_uavs)] << VEHICLE
            return True
        place = somewhere(acts, n, i, near_sites, ugv_list, rng)
        if uniform(rng) < 0.6:  # of the same UGV
            place = (place & ~MASK) | (acts[i] & MASK)
        if what < 0.55:
            acts[i] = (acts[i] & ~PLACE) | place
        else:
            old = acts[i] & PLACE
            i, j = stop_of(acts, n, i)
            for k in range(i, j + 1):
                if (acts[k] >> KIND) == MEET and (acts[k] & PLACE) == old:
                    acts[k] = (acts[k] & ~PLACE) | place
    elif r < 0.92:  # a stretch of the whole plan the other way round
        i = below(rng, n)
        j = min(n - 1, i + 1 + below(rng, 24))
        while i < j:
            code = acts[i]
            acts[i] = acts[j]
            acts[j] = code
            i += 1
            j -= 1
    elif r < 0.94:  # a stretch of the whole plan elsewhere
        i = below(rng, n)
        length = min(n - i, 2 + below(rng, 14))
        j = below(rng, n - length + 1)
        for k in range(length):
            if j < i:
                insert(acts, total - 1, j + k, remove(acts, total, i + k))
            else:
                insert(acts, total - 1, j + length - 1, remove(acts, total, i))
    elif r < 0.97 or n_uavs < 2:  # a stretch of one UAV's tasks the other way round
        i = pick(acts, n, rng, True)
        if i < 0:
            return False
        uav = (acts[i] >> VEHICLE) & MASK
        j = i
        length = 1 + below(rng, 6)
        for k in range(i + 1, n):
            if (acts[k] >> KIND) == VISIT and ((acts[k] >> VEHICLE) & MASK) == uav:
                j = k
                length -= 1
                if length == 0:
                    break
        if j == i:
            return False
        while i < j:
            task = acts[i] & MASK
            acts[i] = (acts[i] & ~MASK) | (acts[j] & MASK)
            acts[j] = (acts[j] & ~MASK) | task
            i += 1
            while i < j and ((acts[i] >> KIND) != VISIT or ((acts[i] >> VEHICLE) & MASK) != uav):
                i += 1
            j -= 1
            while i < j and ((acts[j] >> KIND) != VISIT or ((acts[j] >> VEHICLE) & MASK) != uav):
                j -= 1
    else:  # two UAVs change roles for a while, or to the end
        one = uav_list[below(rng, n_uavs)]
        two = uav_list[below(rng, n_uavs)]
        if one == two:
            return False
        i = below(rng, n)
        j = n if uniform(rng) < 0.6 else min(n, i + 2 + below(rng, 12))
        for k in range(i, j):
            uav = (acts[k] >> VEHICLE) & MASK
            if uav == one:
                acts[k] = (acts[k] & ~(MASK << VEHICLE)) | two << VEHICLE
            elif uav == two:
                acts[k] = (acts[k] & ~(MASK << VEHICLE)) | one << VEHICLE
    return True
