"""Routes in outline for all tasks that are left: farthest insertion, then local search.

Each UAV that is not done gets an open route. The makespan counts, then the sum of the routes' ends; energy that a route
lacks counts as the recharges that it takes at the least. Where these are, and whom they wait for, is left open:
``staged_kernel`` puts them in. ``alone`` looks for routes that need none.

The inner functions take arrays, not tuples of arrays: numba counts references for every array at every call. For the
same reason the smallest are inlined.
"""

from __future__ import annotations

import numpy as np

from planner.kernel import (
    G_CHARGE_S,
    G_CHARGE_W,
    G_DOCK,
    G_UNDOCK,
    KIND,
    U_CAPACITY,
    U_CRUISE,
    U_HOVER,
    U_RESERVE,
    U_SERVICE,
    U_SPEED,
    VEHICLE,
    VISIT,
    Codes,
    Floats,
    Ints,
    Work,
    World,
)
from planner.policy.jit import inlined, jit
from planner.policy.tokens_kernel import Turn

SUM = 1e-3  # what a second of a route's end counts beside one of the makespan
SHORT = 0.1  # what a second of flight that the energy is not enough for counts, beside the recharges that it takes
SHORTER = 20.0  # likewise, where routes without any recharge are looked for
DETOUR = 0.1  # of a full charge's flight, with every recharge
ROUNDS, LONGER = 6, 12  # of local search, at most; where routes without any recharge are looked for
BETTER_S = 1e-6
NEVER_S = 1e6
HOPE, NOTHING = 0.5, 1e-9  # charges that routes may lack: where it is worth a try to do without, and no more in the end
# columns of `uavs` here: time, s per m, s per service, J per m, J per service, J above reserve, J per charge, s per
# recharge, ``short`` in s per J
A_TIME, A_PACE, A_SERVICE, A_FLY, A_SERVE, A_BUDGET, A_CHARGE, A_RECHARGE, A_SHORT = range(9)
# columns of `state`: metres flown, end in s (-inf for a UAV that takes no part)
T_METRES, T_END = range(2)


@inlined
def _lacks_j(uavs: Floats, near: Floats, u: int, metres: float, n: int, last: int) -> float:
    """Energy in J that UAV ``u`` lacks for a route of ``n`` tasks and to land; negative where some is left."""
    return float((metres + near[last]) * uavs[u, A_FLY] + n * uavs[u, A_SERVE] - uavs[u, A_BUDGET])


@jit
def _put(routes: Ints, sizes: Ints, u: int, at: int, m: int) -> None:
    """Task ``m`` becomes the ``at``-th of a route."""
    for k in range(sizes[u], at, -1):
        routes[u, k] = routes[u, k - 1]
    routes[u, at] = m
    sizes[u] += 1


@inlined
def _end_s(uavs: Floats, near: Floats, u: int, metres: float, n: int, last: int) -> float:
    """When UAV ``u`` ends a route of ``n`` tasks, with the recharges that its energy needs at the least."""
    end = uavs[u, A_TIME] + metres * uavs[u, A_PACE] + n * uavs[u, A_SERVICE]
    if n == 0:
        return float(end)
    short = _lacks_j(uavs, near, u, metres, n, last)
    if short <= 0.0:
        return float(end)
    return float(end + short * uavs[u, A_SHORT] + np.ceil(short / uavs[u, A_CHARGE]) * uavs[u, A_RECHARGE])


@inlined
def _cheapest(dist: Floats, routes: Ints, u: int, n: int, start: int, m: int, out: int) -> tuple[int, float, float]:
    """Before which task of a route ``m`` costs the fewest metres (-1: it has none), how many, and how many at the end.

    Task ``out`` of the route is ``m`` itself: it stays where it is until it has another place.
    """
    best, at = np.inf, -1
    before = start
    for k in range(n):
        to = routes[u, k]
        if (k != out and k != out + 1) or out < 0:
            grow = dist[before, m] + dist[m, to] - dist[before, to]
            if grow < best:
                best, at = grow, k
        before = to
    return at, best, dist[before, m]


@jit
def _insert(
    dist: Floats, near: Floats, uavs: Floats, node: Ints, tasks: Ints, routes: Ints, sizes: Ints, state: Floats
) -> None:
    """Farthest insertion of all tasks into empty routes; ``tasks`` is used up.

    The best place of each task inside each route is kept, and looked for anew only where it is split.
    """
    n_uavs, most = uavs.shape[0], tasks.shape[0]
    ends, changes = np.full((most, n_uavs), np.inf), np.empty((most, n_uavs))  # the best place in each route,
    places = np.empty((most, n_uavs), np.int32)  # of each task that is in none
    inner, grows = np.full((most, n_uavs), -1, np.int32), np.full((most, n_uavs), np.inf)  # the best but at the end
    changed, at = -1, 0  # the route that has changed, all at first, and where
    for left in range(most, 0, -1):
        hardest, who, what = -np.inf, 0, 0
        for i in range(left):
            m = tasks[i]
            for u in range(n_uavs):
                if state[u, T_END] == -np.inf or changed not in (-1, u):
                    continue
                n = sizes[u]
                last = node[u] if n == 0 else routes[u, n - 1]
                behind = dist[last, m]
                if changed >= 0 and inner[i, u] == at:  # what was the best place is no more
                    inner[i, u], grows[i, u], _ = _cheapest(dist, routes, u, n, node[u], m, -1)
                elif changed >= 0:
                    if inner[i, u] > at:
                        inner[i, u] += 1
                    for k in range(at, min(at + 2, n)):
                        before = node[u] if k == 0 else routes[u, k - 1]
                        grow = dist[before, m] + dist[m, routes[u, k]] - dist[before, routes[u, k]]
                        if grow < grows[i, u] or (grow == grows[i, u] and k < inner[i, u]):
                            inner[i, u], grows[i, u] = k, grow
                end = _end_s(uavs, near, u, state[u, T_METRES] + behind, n + 1, m)
                ends[i, u], places[i, u], changes[i, u] = end, n, behind
                if inner[i, u] >= 0:
                    end = _end_s(uavs, near, u, state[u, T_METRES] + grows[i, u], n + 1, routes[u, n - 1])
                    if end <= ends[i, u]:
                        ends[i, u], places[i, u], changes[i, u] = end, inner[i, u], grows[i, u]
            by = 0
            for u in range(1, n_uavs):
                if ends[i, u] < ends[i, by]:
                    by = u
            if ends[i, by] > hardest:
                hardest, who, what = ends[i, by], by, i
        changed, at = who, places[what, who]
        _put(routes, sizes, who, at, tasks[what])
        n = sizes[who]
        state[who, T_METRES] += changes[what, who]
        state[who, T_END] = _end_s(uavs, near, who, state[who, T_METRES], n, routes[who, n - 1])
        tasks[what] = tasks[left - 1]
        for u in range(n_uavs):  # number by number: rows of arrays would be counted references
            ends[what, u] = ends[left - 1, u]
            places[what, u] = places[left - 1, u]
            changes[what, u] = changes[left - 1, u]
            inner[what, u] = inner[left - 1, u]
            grows[what, u] = grows[left - 1, u]


@jit
def _turn_round(
    dist: Floats, near: Floats, uavs: Floats, node: Ints, routes: Ints, sizes: Ints, state: Floats, u: int
) -> bool:
    """Turns stretches of one route round; whether anything got better."""
    n, better = sizes[u], False
    for i in range(n - 1):
        for j in range(i + 1, n):
            before = node[u] if i == 0 else routes[u, i - 1]
            a, b = routes[u, i], routes[u, j]
            change = dist[before, b] - dist[before, a]
            if j + 1 < n:
                change += dist[a, routes[u, j + 1]] - dist[b, routes[u, j + 1]]
            if change >= -BETTER_S:
                continue
            last = a if j == n - 1 else routes[u, n - 1]
            end = _end_s(uavs, near, u, state[u, T_METRES] + change, n, last)
            if end >= state[u, T_END] - BETTER_S:
                continue
            for k in range((j - i + 1) // 2):
                routes[u, i + k], routes[u, j - k] = routes[u, j - k], routes[u, i + k]
            state[u, T_METRES] += change
            state[u, T_END] = end
            better = True
    return better


@jit
def _relocate(
    dist: Floats, near: Floats, uavs: Floats, node: Ints, routes: Ints, sizes: Ints, state: Floats, u: int, i: int
) -> int:
    """The ``i``-th task of ``u`` goes to its best place, in this route or another; whose it is then; -1: as it was."""
    n, m = sizes[u], routes[u, i]
    before = node[u] if i == 0 else routes[u, i - 1]
    without = state[u, T_METRES] - dist[before, m]
    if i + 1 < n:
        without += dist[before, routes[u, i + 1]] - dist[m, routes[u, i + 1]]
    last = before if i == n - 1 else routes[u, n - 1]
    shorter = _end_s(uavs, near, u, without, n - 1, last)
    worst, second, total = -np.inf, -np.inf, 0.0  # of the other UAVs' ends
    who = -1
    for v in range(uavs.shape[0]):
        end = state[v, T_END]
        if v != u and end > -np.inf:
            total += end
            if end > worst:
                worst, second, who = end, worst, v
            else:
                second = max(second, end)
    best = max(worst, state[u, T_END]) + SUM * (total + state[u, T_END]) - BETTER_S
    by, at, metres = -1, 0, 0.0
    for v in range(uavs.shape[0]):
        if state[v, T_END] == -np.inf:
            continue
        size = sizes[v]
        if v == u:
            rest, rest_sum, base, longer = worst, total, without, size
        else:
            rest = max(second if v == who else worst, shorter)
            rest_sum = total - state[v, T_END] + shorter
            base, longer = state[v, T_METRES], size + 1
        if rest + SUM * rest_sum >= best:
            continue
        place, grow, behind = _cheapest(dist, routes, v, size, node[v], m, i if v == u else -1)
        if place >= 0:
            end_at = routes[v, size - 2 if v == u and i == size - 1 else size - 1]
            end = _end_s(uavs, near, v, base + grow, longer, end_at)
            score = max(rest, end) + SUM * (rest_sum + end)
            if score < best:
                best, by, at, metres = score, v, place, base + grow
        if not (v == u and i == size - 1):
            end = _end_s(uavs, near, v, base + behind, longer, m)
            score = max(rest, end) + SUM * (rest_sum + end)
            if score < best:
                best, by, at, metres = score, v, size, base + behind
    if by < 0:
        return -1
    for k in range(i, n - 1):
        routes[u, k] = routes[u, k + 1]
    sizes[u] = n - 1
    state[u, T_METRES] = without
    state[u, T_END] = shorter
    if by == u and at > i:
        at -= 1
    _put(routes, sizes, by, at, m)
    n = sizes[by]
    state[by, T_METRES] = metres
    state[by, T_END] = _end_s(uavs, near, by, metres, n, routes[by, n - 1])
    return by


@jit
def _exchange(dist: Floats, near: Floats, uavs: Floats, node: Ints, routes: Ints, sizes: Ints, state: Floats) -> bool:
    """A task of the UAV that ends last changes places with one of another; whether anything got better."""
    u = 0
    for v in range(uavs.shape[0]):
        if state[v, T_END] > state[u, T_END]:
            u = v
    n = sizes[u]
    for i in range(n):
        a = routes[u, i]
        a_before = node[u] if i == 0 else routes[u, i - 1]
        for v in range(uavs.shape[0]):
            size = sizes[v]
            if v == u:
                continue
            b_before = node[v]
            for j in range(size):
                b = routes[v, j]
                one = state[u, T_METRES] + dist[a_before, b] - dist[a_before, a]
                if i + 1 < n:
                    one += dist[b, routes[u, i + 1]] - dist[a, routes[u, i + 1]]
                end = _end_s(uavs, near, u, one, n, b if i == n - 1 else routes[u, n - 1])
                if end < state[u, T_END] - BETTER_S:
                    other = state[v, T_METRES] + dist[b_before, a] - dist[b_before, b]
                    if j + 1 < size:
                        other += dist[a, routes[v, j + 1]] - dist[b, routes[v, j + 1]]
                    end_v = _end_s(uavs, near, v, other, size, a if j == size - 1 else routes[v, size - 1])
                    if end_v < state[u, T_END] - BETTER_S:
                        routes[u, i], routes[v, j] = b, a
                        state[u, T_METRES], state[v, T_METRES] = one, other
                        state[u, T_END], state[v, T_END] = end, end_v
                        return True
                b_before = b
    return False


@jit
def _improve(
    dist: Floats, near: Floats, uavs: Floats, node: Ints, routes: Ints, sizes: Ints, state: Floats, rounds: int
) -> None:
    """Local search, until nothing gets better any more or the rounds are over."""
    turned = state[:, T_END] == -np.inf  # routes in which nothing can be turned round any more
    for _ in range(rounds):
        better = False
        for u in range(uavs.shape[0]):
            if not turned[u]:
                turned[u] = not _turn_round(dist, near, uavs, node, routes, sizes, state, u)
                better |= not turned[u]
        for u in range(uavs.shape[0]):
            for i in range(sizes[u] - 1, -1, -1):
                by = _relocate(dist, near, uavs, node, routes, sizes, state, u, i)
                if by >= 0:
                    better = True
                    turned[u] = turned[by] = False
        if not better:
            if not _exchange(dist, near, uavs, node, routes, sizes, state):
                return
            turned[:] = state[:, T_END] == -np.inf


@jit
def _known(w: Work, turn: Turn) -> bool:
    """Whether the routes that are there are of this state."""
    o = turn.outline
    for u in range(w.node.shape[0]):
        if o.node[u] != w.node[u] or o.done[u] != turn.done[u]:
            return False
        if o.us[u, 0] != w.us[u, 0] or o.us[u, 1] != w.us[u, 1]:
            return False
    for m in range(w.seen.shape[0]):  # noqa: SIM110  (numba has no all() of a generator)
        if o.seen[m] != w.seen[m]:
            return False
    return True


@jit
def outline(world: World, w: Work, turn: Turn) -> None:
    """Fills ``turn.outline`` in: routes for all tasks that are left, recharges counted but not placed.

    Args:
        world: the problem.
        w: the state, left as it is; some UAV is not done.
        turn: who is done.
    """
    if _known(w, turn):
        return
    o = turn.outline
    o.node[:], o.us[:], o.seen[:], o.done[:] = w.node, w.us, w.seen, turn.done
    o.sizes[:] = 0
    o.state[:, T_METRES] = 0.0
    left = 0
    for m in range(world.visited.shape[0]):
        if w.seen[m] == 0:
            o.tasks[left] = m
            left += 1
    for u in range(w.node.shape[0]):
        uav = world.uavs[u]
        usable = max(1.0, uav[U_CAPACITY] - uav[U_RESERVE])
        charge = NEVER_S
        for g in range(world.ugvs.shape[0]):
            if world.ugv_on[g] != 0:
                ugv = world.ugvs[g]
                time = ugv[G_CHARGE_S] if ugv[G_CHARGE_W] == 0.0 else usable / ugv[G_CHARGE_W]
                charge = min(charge, time + ugv[G_DOCK] + ugv[G_UNDOCK])
        o.uavs[u, A_TIME] = w.us[u, 0]
        o.uavs[u, A_PACE] = 1.0 / uav[U_SPEED]
        o.uavs[u, A_SERVICE] = uav[U_SERVICE]
        o.uavs[u, A_FLY] = uav[U_CRUISE] / uav[U_SPEED]
        o.uavs[u, A_SERVE] = uav[U_HOVER] * uav[U_SERVICE]
        o.uavs[u, A_BUDGET] = w.us[u, 1] - uav[U_RESERVE]
        o.uavs[u, A_CHARGE] = usable
        o.uavs[u, A_RECHARGE] = charge + DETOUR * usable / max(1.0, uav[U_CRUISE])
        o.uavs[u, A_SHORT] = SHORT / max(1.0, uav[U_CRUISE])
        o.state[u, T_END] = w.us[u, 0] if turn.done[u] == 0 else -np.inf
    _insert(world.dist, world.near, o.uavs, w.node, o.tasks[:left], o.routes, o.sizes, o.state)
    _improve(world.dist, world.near, o.uavs, w.node, o.routes, o.sizes, o.state, ROUNDS)


@jit
def short_j(near: Floats, uavs: Floats, routes: Ints, sizes: Ints, state: Floats, u: int) -> float:
    """Energy in J that a UAV lacks for its route without recharges; negative where some is left."""
    n = sizes[u]
    if n == 0:
        return float(-uavs[u, A_BUDGET])
    return _lacks_j(uavs, near, u, state[u, T_METRES], n, routes[u, n - 1])


@jit
def _lack(near: Floats, uavs: Floats, routes: Ints, sizes: Ints, state: Floats) -> float:
    """Charges that all routes together lack."""
    total = 0.0
    for u in range(uavs.shape[0]):
        if sizes[u] > 0:
            total += max(0.0, short_j(near, uavs, routes, sizes, state, u)) / uavs[u, A_CHARGE]
    return total


@jit
def alone(world: World, w: Work, turn: Turn, acts: Codes) -> int:
    """Visits of all tasks that are left, each UAV by itself with the energy that it has.

    The outlined routes are such, or are made such by a search where lacking energy counts for much.

    Args:
        world: the problem.
        w: the state, left as it is.
        turn: who is done.
        acts: room for the visits, UAV by UAV.

    Returns:
        How many; -1 where no such routes were found. The evaluator has the last word on their energy.
    """
    outline(world, w, turn)
    o = turn.outline
    routes, sizes, uavs, state = o.routes, o.sizes, o.uavs, o.state
    lack = _lack(world.near, uavs, routes, sizes, state)
    if lack > HOPE:
        return -1
    if lack > 0.0:
        routes, sizes, uavs, state = routes.copy(), sizes.copy(), uavs.copy(), state.copy()
        for u in range(uavs.shape[0]):
            uavs[u, A_SHORT] *= SHORTER / SHORT
            if sizes[u] > 0:
                state[u, T_END] = _end_s(uavs, world.near, u, state[u, T_METRES], sizes[u], routes[u, sizes[u] - 1])
        _improve(world.dist, world.near, uavs, w.node, routes, sizes, state, LONGER)
        if _lack(world.near, uavs, routes, sizes, state) > NOTHING:
            return -1
    n = 0
    for u in range(w.node.shape[0]):
        for k in range(sizes[u]):
            acts[n] = VISIT << KIND | u << VEHICLE | routes[u, k]
            n += 1
    return n
