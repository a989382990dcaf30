"""Decodes a whole plan in one call: simulate, look, ask the network, choose, prove that the rest can be done, go on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.kernel import MASK, S_LEFT, VEHICLE, Codes, Floats, Ints, Work, World
from planner.policy.complete_kernel import complete, copy_work
from planner.policy.features_kernel import Singles, View, fill_view
from planner.policy.jit import jit
from planner.policy.plus_kernel import Room, Weights, logits
from planner.policy.tokens_kernel import Turn, acting, apply, code_of, offer

NEVER = np.float32(-1e9)
# entries of `report`
D_ACTIONS, D_CERTAIN, D_DECISIONS, D_REFUSED, D_FORCED, D_LOG_P, D_DOUBT = range(7)
REPORT = 7


class Desk(NamedTuple):
    """Room for decoding one problem.

    Attributes:
        space, before: states of all vehicles.
        row: (U,).
        visit: (n_tasks,).
        meet: (G, n_sites).
        done: (1,).
        hint: (2,).
        way: a way to finish, (most actions,).
        spare: room for another, (most actions,).
        room: the network's.
        sight: what it sees.
    """

    space: Work
    before: Work
    row: Ints
    visit: Singles
    meet: Singles
    done: Singles
    hint: Codes
    way: Codes
    spare: Codes
    room: Room
    sight: View


@jit
def _uniform(rng: Codes) -> float:
    """From 0 to 1, both excluded; splitmix64."""
    rng[0] += -7046029254386353131
    z = np.uint64(rng[0])
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return (float(z >> np.uint64(11)) + 0.5) / 9007199254740992.0


@jit
def _best(desk: Desk, left: int) -> int:
    """The option with the largest logit, numbered over the tasks that are left; -1 where none is left."""
    best, option = NEVER, -1
    for i in range(left):
        if desk.visit[i] > best:
            best, option = desk.visit[i], i
    n_sites = desk.meet.shape[1]
    for g in range(desk.meet.shape[0]):
        for p in range(n_sites):
            if desk.meet[g, p] > best:
                best, option = desk.meet[g, p], left + g * n_sites + p
    if desk.done[0] > best:
        option = left + desk.meet.size
    return option


@jit
def _get(desk: Desk, left: int, option: int) -> float:
    if option < left:
        return float(desk.visit[option])
    if option == left + desk.meet.size:
        return float(desk.done[0])
    n_sites = desk.meet.shape[1]
    return float(desk.meet[(option - left) // n_sites, (option - left) % n_sites])


@jit
def _close(desk: Desk, left: int, option: int) -> None:
    if option < left:
        desk.visit[option] = NEVER
    elif option == left + desk.meet.size:
        desk.done[0] = NEVER
    else:
        n_sites = desk.meet.shape[1]
        desk.meet[(option - left) // n_sites, (option - left) % n_sites] = NEVER


@jit
def _total(desk: Desk, left: int) -> float:
    """Logarithm of the sum of all options' weights."""
    most = NEVER
    for i in range(left):
        most = max(most, desk.visit[i])
    for g in range(desk.meet.shape[0]):
        for p in range(desk.meet.shape[1]):
            most = max(most, desk.meet[g, p])
    most = max(most, desk.done[0])
    total = 0.0
    for i in range(left):
        total += np.exp(float(desk.visit[i] - most))
    for g in range(desk.meet.shape[0]):
        for p in range(desk.meet.shape[1]):
            total += np.exp(float(desk.meet[g, p] - most))
    return float(float(most) + np.log(total + np.exp(float(desk.done[0] - most))))


@jit
def _perturb(desk: Desk, left: int, heat: float, rng: Codes) -> None:
    """Adds Gumbel noise: the largest is then a sample at temperature ``heat``, the next one a sample of the rest."""
    for i in range(left):
        if desk.visit[i] > NEVER:
            desk.visit[i] -= np.float32(heat * np.log(-np.log(_uniform(rng))))
    for g in range(desk.meet.shape[0]):
        for p in range(desk.meet.shape[1]):
            if desk.meet[g, p] > NEVER:
                desk.meet[g, p] -= np.float32(heat * np.log(-np.log(_uniform(rng))))
    if desk.done[0] > NEVER:
        desk.done[0] -= np.float32(heat * np.log(-np.log(_uniform(rng))))


@jit
def look(
    world: World, work: Work, turn: Turn, xy: Floats, reach: Floats, w: Weights, desk: Desk, report: Floats
) -> int:
    """Finds out whose turn it is and fills in the logits; the UAV, -1 where all are done."""
    u = acting(work, turn)
    if u >= 0:
        offer(world, work, turn, u)
        fill_view(world, work, turn, u, xy, reach, desk.sight)
        logits(w, desk.room, desk.sight, desk.visit, desk.meet, desk.done)
        report[D_DECISIONS] += 1
    return u


@jit
def take(world: World, work: Work, turn: Turn, u: int, option: int, acts: Codes, desk: Desk, report: Floats) -> bool:
    """Takes an option where a way to finish is known behind it, or where none is known anyway; else changes nothing."""
    left = desk.sight.counts[0]
    n = int(report[D_ACTIONS])
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    copy_work(work, desk.before)
    desk.row[:] = turn.row
    ends = option == left + desk.meet.size
    if ends:
        turn.done[u] = 1
    else:
        real = int(desk.sight.tasks[option]) if option < left else option - left + n_tasks
        acts[n] = code_of(u, real, n_tasks, n_sites)
        apply(world, work, turn, acts[n])
    found = complete(world, work, desk.space, turn, desk.hint, desk.spare)
    if found < 0 and report[D_CERTAIN] != 0:
        turn.done[u] = 0
        turn.row[:] = desk.row
        copy_work(desk.before, work)
        return False
    if found >= 0:
        report[D_CERTAIN] = 1
        desk.way[:found] = desk.spare[:found]
        desk.way[found] = -1
    if not ends:
        report[D_ACTIONS] = n + 1
    return True


@jit
def follow(world: World, work: Work, turn: Turn, u: int, acts: Codes, desk: Desk, report: Floats) -> bool:
    """Does what the known way has for UAV ``u``, or ends its part; False where no way is known."""
    if report[D_CERTAIN] == 0:
        return False
    i = 0
    while desk.way[i] >= 0 and (desk.way[i] >> VEHICLE & MASK) != u:
        i += 1
    if desk.way[i] < 0:
        turn.done[u] = 1
        return True
    n = int(report[D_ACTIONS])
    acts[n] = desk.way[i]
    apply(world, work, turn, acts[n])
    report[D_ACTIONS] = n + 1
    while desk.way[i] >= 0:
        desk.way[i] = desk.way[i + 1]
        i += 1
    return True


@jit
def ready(world: World, work: Work, turn: Turn, desk: Desk, report: Floats) -> None:
    """Looks for a first way to finish; called once before the first decision from a state."""
    found = complete(world, work, desk.space, turn, desk.hint, desk.way)
    report[D_CERTAIN] = found >= 0
    if found >= 0:
        desk.way[found] = -1


@jit
def decode(
    world: World,
    work: Work,
    turn: Turn,
    xy: Floats,
    reach: Floats,
    w: Weights,
    desk: Desk,
    acts: Codes,
    heat: float,
    rng: Codes,
    report: Floats,
) -> None:
    """Decodes from the state in ``work`` to the end.

    Args:
        world: the problem.
        work: the state, changed into that behind the plan.
        turn: who is done.
        xy: positions, turned as wanted, (N + U + G, 2) in m.
        reach: ranges of the UAVs, (U,) in m.
        w: the network.
        desk: room; ``ready`` was called, or a way is known from before.
        acts: the plan, filled from ``report[D_ACTIONS]`` on.
        heat: temperature, 0 for greedy.
        rng: state of the random numbers, (1,).
        report: the number of actions; whether a way to finish is known; decisions; options refused because no way was
            found behind them; decisions taken from the way; log-probability; the least probability of a choice.
    """
    while work.sums[S_LEFT] > 0 and report[D_ACTIONS] < acts.shape[0] - 1:
        u = look(world, work, turn, xy, reach, w, desk, report)
        if u < 0:
            return
        left = desk.sight.counts[0]
        total = _total(desk, left)
        if heat > 0.0:
            _perturb(desk, left, heat, rng)
        while True:
            option = _best(desk, left)
            if option < 0:
                report[D_FORCED] += 1
                if not follow(world, work, turn, u, acts, desk, report):
                    # Nothing is offered and no way is known: this UAV stays, search has to take over.
                    turn.done[u] = 1
                break
            value = _get(desk, left, option)
            if take(world, work, turn, u, option, acts, desk, report):
                if heat == 0.0:
                    report[D_LOG_P] += value - total
                    report[D_DOUBT] = min(report[D_DOUBT], np.exp(value - total))
                break
            report[D_REFUSED] += 1
            _close(desk, left, option)


@jit
def several(desk: Desk, left: int, options: Ints) -> int:
    """The options with the largest logits, best first, into ``options``; how many. The logits are used up."""
    n = 0
    while n < options.shape[0]:
        option = _best(desk, left)
        if option < 0:
            break
        options[n] = option
        n += 1
        _close(desk, left, option)
    return n
