"""Takes decisions so that the rest can always be done: a way to finish is kept, see ``complete_kernel``.

The parts that a decoder calls at each decision stay apart. One kernel for a whole plan would spare some microseconds
per call, but takes a minute to compile.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.kernel import (
    KIND,
    MASK,
    MEET,
    O_CODE,
    O_DRIVE_S,
    O_FLY_S,
    O_MAKESPAN,
    OK,
    VEHICLE,
    Codes,
    Floats,
    Ints,
    Work,
    World,
)
from planner.policy.complete_kernel import complete, copy_work
from planner.policy.jit import jit
from planner.policy.tokens_kernel import Turn, apply, code_of

# entries of `report`; the last two are about all that was tried, not about the plan under way
(
    D_ACTIONS, D_CERTAIN, D_DECISIONS, D_REFUSED, D_FORCED, D_CHOSEN, D_LOG_P, D_DOUBT, D_ALONE_S, D_BEST_N, D_BEST_COST
) = range(11)  # fmt: skip
REPORT = 11
FLY, DRIVE = 2e-3, 1e-3  # what a flown and a driven second count beside one of makespan


class Desk(NamedTuple):
    """Room for decoding one problem.

    Attributes:
        space, before: states of all vehicles.
        row: (U,).
        hint: (2,).
        way: a way to finish, -1 behind it, (most actions,).
        spare: room for another, (most actions,).
        best: the best whole plan known, actions so far and a way behind them, (2 * most actions,).
    """

    space: Work
    before: Work
    row: Ints
    hint: Codes
    way: Codes
    spare: Codes
    best: Codes


@jit
def cost_of(out: Floats) -> float:
    """What an evaluated plan (``kernel.Work.out``) is compared by, in s; inf where it is infeasible."""
    if out[O_CODE] != OK:
        return np.inf
    return float(out[O_MAKESPAN] + FLY * out[O_FLY_S] + DRIVE * out[O_DRIVE_S])


@jit
def _attempt(
    world: World, work: Work, turn: Turn, desk: Desk, u: int, option: int, acts: Codes, report: Floats
) -> tuple[int, int]:
    """Takes an option (-1: none) and finishes the plan behind it; the best whole plan is kept in ``desk.best``.

    Returns the number of actions so far, and of the way to finish in ``desk.spare``, -1 where none is found.
    """
    n_tasks, n_sites = world.visited.shape[0], world.road.shape[1]
    n = int(report[D_ACTIONS])
    copy_work(work, desk.before)
    desk.row[:] = turn.row
    if option == n_tasks + world.ugvs.shape[0] * n_sites:
        turn.done[u] = 1
    elif option >= 0:
        acts[n] = code_of(u, option, n_tasks, n_sites)
        apply(world, work, turn, acts[n])
        n += 1
    found = complete(world, work, desk.space, turn, desk.hint, desk.spare)
    if found >= 0 and cost_of(desk.space.out) < report[D_BEST_COST]:
        report[D_BEST_COST] = cost_of(desk.space.out)
        report[D_BEST_N] = n + found
        desk.best[:n] = acts[:n]
        desk.best[n : n + found] = desk.spare[:found]
    return n, found


@jit
def _undo(work: Work, turn: Turn, desk: Desk, u: int) -> None:
    """Goes back to before ``_attempt``."""
    turn.done[u] = 0
    turn.row[:] = desk.row
    copy_work(desk.before, work)


@jit
def probe(world: World, work: Work, turn: Turn, desk: Desk, u: int, option: int, acts: Codes, report: Floats) -> None:
    """Looks what a way to finish behind an option would be worth; changes nothing but the best plan known."""
    u_hint, g_hint = desk.hint
    _attempt(world, work, turn, desk, u, option, acts, report)
    _undo(work, turn, desk, u)
    desk.hint[0], desk.hint[1] = u_hint, g_hint


@jit
def take(
    world: World,
    work: Work,
    turn: Turn,
    desk: Desk,
    u: int,
    option: int,
    force: bool,
    thrifty: bool,
    acts: Codes,
    report: Floats,
) -> bool:
    """Takes an option where a way to finish is known behind it, or where none is known anyway; else changes nothing.

    The best plan that is known so far is kept in ``desk.best``, whatever is taken later. ``report[D_ALONE_S]`` is the
    makespan of the way that is known where it needs no recharge any more, else inf.

    Args:
        world: the problem.
        work: the state.
        turn: who is done.
        desk: room, and the way.
        u: the UAV whose turn it is.
        option: as numbered in ``tokens_kernel``; -1 takes nothing but looks for a first way.
        force: does what the way has for ``u`` instead, or ends its part; False comes back where no way is known.
        thrifty: refuses what would make a recharge needful where the way so far ends sooner without any.
        acts: the plan so far, ``report[D_ACTIONS]`` actions, added to.
        report: counts, by the entries above.
    """
    if force:
        if report[D_CERTAIN] == 0:
            return False
        report[D_FORCED] += 1
        i = 0
        while desk.way[i] >= 0 and (desk.way[i] >> VEHICLE & MASK) != u:
            i += 1
        if desk.way[i] < 0:
            turn.done[u] = 1
            return True
        n = int(report[D_ACTIONS])
        acts[n] = desk.way[i]
        report[D_ACTIONS] = n + 1
        apply(world, work, turn, acts[n])
        while desk.way[i] >= 0:
            desk.way[i] = desk.way[i + 1]
            i += 1
        return True
    n, found = _attempt(world, work, turn, desk, u, option, acts, report)
    alone_s = desk.space.out[O_MAKESPAN] if found >= 0 else np.inf
    for i in range(found):
        if desk.spare[i] >> KIND == MEET:
            alone_s = np.inf
    wasteful = thrifty and alone_s == np.inf and report[D_ALONE_S] < np.inf
    if found >= 0 and wasteful:
        wasteful = desk.space.out[O_MAKESPAN] > report[D_ALONE_S]
    if (found < 0 and report[D_CERTAIN] != 0) or wasteful:
        _undo(work, turn, desk, u)
        report[D_REFUSED] += 1
        return False
    if found >= 0:
        report[D_CERTAIN] = 1
        report[D_ALONE_S] = alone_s
        desk.way[:found] = desk.spare[:found]
        desk.way[found] = -1
    report[D_ACTIONS] = n
    return True
