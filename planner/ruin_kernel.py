"""The search's large move: tasks near one another are taken out and put back where they cost least.

After slack induction by string removals (Christiaens and Vanden Berghe 2020), with insertion costs that know the energy
that is left on each UAV's trip between two recharges, and when each UAV ends.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner import kernel
from planner.jit import jit
from planner.kernel import Codes, Flags, Floats, Ints, World
from planner.moves_kernel import Around, Counts, State, below, insert, pick, somewhere, uniform

VISIT, MEET = kernel.VISIT, kernel.MEET
KIND, VEHICLE, SITE, MASK = kernel.KIND, kernel.VEHICLE, kernel.SITE, kernel.MASK
U_ENERGY, U_CAPACITY, U_RESERVE = kernel.U_ENERGY, kernel.U_CAPACITY, kernel.U_RESERVE
U_SPEED, U_CRUISE, U_HOVER, U_SERVICE = kernel.U_SPEED, kernel.U_CRUISE, kernel.U_HOVER, kernel.U_SERVICE
MOST = 10  # tasks taken out at once
BLINK = 0.03  # share of places that are overlooked
DROP = 0.3  # share of stretches whose meetings are taken out as well
MEND = 0.5  # share of tasks that come with a meeting, where the energy does not suffice
SHORT = 4.0  # what a second of flight beyond a trip's energy counts


class Tools(NamedTuple):
    """Work space, for plans of up to C actions.

    Attributes:
        out: tasks that are taken out, as flags, (n_tasks,).
        bag: and as a list, (MOST,).
        leg: distance flown to the place of each action, in m, (C,).
        here, there: nodes from and to which the UAV flies for each action, (C,).
        trip: of each action, (C,).
        spare: distance for which a trip's energy would last besides, in m, (C + U,).
        open: current trip of each UAV, (U,).
        at: node of each UAV, (U,).
        ends: when each UAV ends, in s, (U,).
    """

    out: Flags
    bag: Ints
    leg: Floats
    here: Ints
    there: Ints
    trip: Ints
    spare: Floats
    open: Ints
    at: Ints
    ends: Floats


@jit
def range_m(world: World, uav: int, energy: float) -> float:
    """How far a UAV with ``energy`` flies to its reserve, in m."""
    return float((energy - world.uavs[uav, U_RESERVE]) / world.uavs[uav, U_CRUISE] * world.uavs[uav, U_SPEED])


@jit
def service_m(world: World, uav: int) -> float:
    """Distance that takes as much energy as serving a task, in m."""
    u = world.uavs
    return float(u[uav, U_HOVER] * u[uav, U_SERVICE] / u[uav, U_CRUISE] * u[uav, U_SPEED])


@jit
def take_out(acts: Codes, counts: Counts, around: Around, tools: Tools, rng: State) -> int:
    """Takes some tasks out of the plan into ``tools.bag``; how many."""
    n = counts[0]
    first = pick(acts, n, rng, True)
    if first < 0:
        return 0
    most = 2 + below(rng, MOST - 1)
    seed = acts[first] & MASK
    tools.out[:] = 0
    wanted = 1
    tools.out[seed] = 1
    near = around.tasks.shape[1]
    if uniform(rng) < 0.5:  # what is around one task
        for k in range(near):
            if wanted == most:
                break
            if uniform(rng) < 0.7:
                tools.out[around.tasks[seed, k]] = 1
                wanted += 1
    else:  # stretches of the routes that pass there
        length = 1 + below(rng, most)
        k = -1
        while wanted < most:
            uav = (acts[first] >> VEHICLE) & MASK
            back = below(rng, length)
            i = first
            j = first
            while j > 0 and back > 0:
                j -= 1
                if (acts[j] >> KIND) == VISIT and ((acts[j] >> VEHICLE) & MASK) == uav:
                    i = j
                    back -= 1
            taken = 0
            drop = uniform(rng) < DROP
            while i < n and taken < length and wanted < most:
                if drop and (acts[i] >> KIND) == MEET and ((acts[i] >> VEHICLE) & MASK) == uav:
                    acts[i] = -1
                    drop = uniform(rng) < DROP
                if (acts[i] >> KIND) == VISIT and ((acts[i] >> VEHICLE) & MASK) == uav:
                    if tools.out[acts[i] & MASK] == 0:
                        tools.out[acts[i] & MASK] = 1
                        wanted += 1
                    taken += 1
                i += 1
            if uniform(rng) < 0.3:
                break
            found = -1
            while k + 1 < near and found < 0:
                k += 1
                task = around.tasks[seed, k]
                if tools.out[task] == 0:
                    for i in range(n):
                        if (acts[i] >> KIND) == VISIT and (acts[i] & MASK) == task:
                            if ((acts[i] >> VEHICLE) & MASK) != uav:
                                found = i
                            break
            if found < 0:
                break
            first = found
    count = 0
    kept = 0
    for i in range(n):
        if (acts[i] >> KIND) == VISIT and tools.out[acts[i] & MASK] != 0 and count < MOST:
            tools.bag[count] = acts[i] & MASK
            count += 1
        elif acts[i] >= 0:
            acts[kept] = acts[i]
            kept += 1
    for i in range(n, n + counts[1]):
        acts[kept + i - n] = acts[i]
    counts[0] = kept
    return count


@jit
def measure(acts: Codes, n: int, world: World, around: Around, tools: Tools) -> None:
    """Fills the work space with the legs and the spare distances of all trips of a plan."""
    n_tasks = world.visited.shape[0]
    n_sites = world.road.shape[1]
    trips = 0
    for u in around.uavs:
        tools.at[u] = n_tasks + n_sites + u
        tools.open[u] = trips
        tools.spare[trips] = range_m(world, u, world.uavs[u, U_ENERGY])
        trips += 1
    for i in range(n):
        v = (acts[i] >> VEHICLE) & MASK
        to = acts[i] & MASK
        if (acts[i] >> KIND) == MEET:
            to = n_tasks + ((acts[i] >> SITE) & MASK)
        tools.here[i] = tools.at[v]
        tools.there[i] = to
        tools.trip[i] = tools.open[v]
        leg = world.dist[tools.at[v], to]
        tools.leg[i] = leg
        tools.at[v] = to
        tools.spare[tools.open[v]] -= leg
        if (acts[i] >> KIND) == VISIT:
            tools.spare[tools.open[v]] -= service_m(world, v)
        else:
            tools.open[v] = trips
            tools.spare[trips] = range_m(world, v, world.uavs[v, U_CAPACITY])
            trips += 1
    for u in around.uavs:
        tools.spare[tools.open[u]] -= world.near[tools.at[u]]


@jit
def put_back(
    acts: Codes, counts: Counts, count: int, span_s: float, world: World, around: Around, tools: Tools, rng: State
) -> None:
    """Puts the tasks of ``tools.bag`` back, one after the other, each where it costs least.

    Args:
        acts: the plan without them.
        counts: its sizes.
        count: number of tasks in the bag.
        span_s: makespan of the plan that they came from.
        world: the problem.
        around: neighbours and vehicles.
        tools: work space; ``ends`` is read and changed.
        rng: random state.
    """
    bag = tools.bag
    order = below(rng, 4)
    for i in range(count):  # by chance, or by distance from the nearest site
        best = i
        if order < 2:
            best = i + below(rng, count - i)
        else:
            for j in range(i + 1, count):
                if (world.near[bag[j]] > world.near[bag[best]]) == (order == 2):
                    best = j
        task = bag[best]
        bag[best] = bag[i]
        bag[i] = task
    late = 4.0 * uniform(rng)
    for k in range(count):
        task = bag[k]
        n = counts[0]
        measure(acts, n, world, around, tools)
        least = np.inf
        lack = 0.0
        where = n
        who = around.uavs[0]
        extra = 0.0
        for i in range(n):
            if uniform(rng) < BLINK:
                continue
            v = (acts[i] >> VEHICLE) & MASK
            more = world.dist[tools.here[i], task] + world.dist[task, tools.there[i]] - tools.leg[i]
            speed = world.uavs[v, U_SPEED]
            cost = more / speed + world.uavs[v, U_SERVICE]
            value = cost + late * max(0.0, tools.ends[v] + cost - span_s)
            over = max(0.0, more + service_m(world, v) - tools.spare[tools.trip[i]])
            value += SHORT * over / speed
            if value < least:
                least = value
                lack = over
                where = i
                who = v
                extra = cost
        for v in around.uavs:
            here = tools.at[v]
            speed = world.uavs[v, U_SPEED]
            cost = world.dist[here, task] / speed + world.uavs[v, U_SERVICE]
            more = world.dist[here, task] + world.near[task] - world.near[here] + service_m(world, v)
            value = cost + late * max(0.0, tools.ends[v] + cost - span_s)
            over = max(0.0, more - tools.spare[tools.open[v]])
            value += SHORT * over / speed
            if value < least:
                least = value
                lack = over
                where = n
                who = v
                extra = cost
        insert(acts, n + counts[1], where, who << VEHICLE | task)
        counts[0] += 1
        tools.ends[who] += extra
        if lack > 0.0 and len(acts) - counts[0] - counts[1] > 3 and len(around.ugvs) > 0 and uniform(rng) < MEND:
            place = somewhere(acts, counts[0], where, around.sites, around.ugvs, rng)
            insert(acts, counts[0] + counts[1], where + below(rng, 2), MEET << KIND | who << VEHICLE | place)
            counts[0] += 1
