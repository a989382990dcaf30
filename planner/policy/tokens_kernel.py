"""What a decoder may say next: the order of decisions, the options of the UAV whose turn it is, and their masks.

Tokens are those of the search: ``visit(u, m)``, ``meet(u, g, p)`` (``kernel.MEET``: UGV g drives to site p unless it is
there, and recharges u) and ``done(u)``: u does nothing more. UGVs' moves follow from the meetings.

The UAV that is ready first acts next, the lowest index among equals; one that is done is out. Its options are numbered

    0 .. n_tasks - 1              visit that task
    n_tasks + g * n_sites + p     meet UGV g at site p
    n_tasks + G * n_sites         done

An option is offered where the evaluator finds nothing wrong with it and the UAV can land at a site afterwards, so no
UAV is ever stranded (``docs/planning.md``, "Feasible", rules 1 and 2). That the rest of the tasks can still be served
is ``complete_kernel``'s part.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planner.kernel import (
    AT_SITE_M,
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
    KIND,
    MASK,
    MEET,
    SITE,
    U_CAPACITY,
    U_CRUISE,
    U_HOVER,
    U_RESERVE,
    U_SERVICE,
    U_SPEED,
    U_WAIT,
    VEHICLE,
    VISIT,
    Codes,
    Flags,
    Floats,
    Ints,
    Work,
    World,
    begin,
    go,
)
from planner.policy.jit import jit

MEETS_IN_ROW = 3  # a UAV's meetings without a visit in between; more serve no purpose
# columns of a meeting's details, see ``rendezvous``
P_FLY, P_DRIVE, P_THERE, P_ARRIVE, P_WORK, P_END, P_ENERGY, P_CHARGE, P_LEFT = range(9)
DETAILS = 9


class Outline(NamedTuple):
    """Routes for what is left, in outline: where recharges would be, and whom they would wait for, is left open.

    ``outline_kernel`` fills it in, and says what the columns mean.

    Attributes:
        routes: of each UAV, (U, n_tasks + 1).
        sizes: tasks in them, (U,).
        uavs: what the UAVs can do, (U, 9).
        state: of the routes, (U, 2).
        tasks: room, (n_tasks,).
        node, us, seen, done: the state that the routes are for, as in ``Work`` and ``Turn``.
    """

    routes: Ints
    sizes: Ints
    uavs: Floats
    state: Floats
    tasks: Ints
    node: Ints
    us: Floats
    seen: Flags
    done: Flags


class Turn(NamedTuple):
    """What ``Work`` does not know about a plan half made.

    Attributes:
        done: 1 for UAVs that do nothing more or take no part, (U,).
        row: each UAV's meetings since its last visit, (U,).
        visits: 1 for offered visits, (n_tasks,).
        meets: 1 for offered meetings, (G, n_sites).
        details: of each possible meeting of the UAV whose turn it is, by the columns above, (G, n_sites, DETAILS).
        may_end: 1 where ``done`` is offered, (1,).
        code: room for one action, (1,).
        rows: no details wanted of ``kernel.advance``, (0, 9).
        outline: routes for the state seen last.
    """

    done: Flags
    row: Ints
    visits: Flags
    meets: Flags
    details: Floats
    may_end: Flags
    code: Codes
    rows: Floats
    outline: Outline


@jit
def start(world: World, work: Work, turn: Turn) -> None:
    """Puts ``work`` and ``turn`` into the state before the first decision."""
    begin(world, work)
    for u in range(world.uavs.shape[0]):
        turn.done[u] = 1 - world.uav_on[u]
        turn.row[u] = 0


@jit
def acting(work: Work, turn: Turn) -> int:
    """The UAV whose turn it is; -1 where all are done."""
    who = -1
    for u in range(turn.done.shape[0]):
        if turn.done[u] == 0 and (who < 0 or work.us[u, 0] < work.us[who, 0]):
            who = u
    return who


@jit
def apply(world: World, work: Work, turn: Turn, code: int) -> None:
    """Takes one visit or meeting."""
    turn.code[0] = code
    go(world, work, turn.code, 0, 1, np.inf, turn.rows)
    u = code >> VEHICLE & MASK
    turn.row[u] = 0 if code >> KIND == VISIT else turn.row[u] + 1


@jit
def code_of(u: int, option: int, n_tasks: int, n_sites: int) -> int:
    """The action that an option other than ``done`` stands for."""
    u, option = int(u), int(option)  # of any width
    if option < n_tasks:
        return VISIT << KIND | u << VEHICLE | option
    g = (option - n_tasks) // n_sites
    p = (option - n_tasks) % n_sites
    return MEET << KIND | u << VEHICLE | p << SITE | g


@jit
def after_visit(world: World, work: Work, u: int, m: int) -> float:
    """Energy above the reserve with which ``u`` would be at its nearest site after visiting ``m``; -inf: not at all.

    The arithmetic is the evaluator's, to the last bit.
    """
    uav = world.uavs[u]
    fly = world.dist[work.node[u], m] / uav[U_SPEED]
    energy = work.us[u, 1] - uav[U_CRUISE] * fly - uav[U_HOVER] * uav[U_SERVICE]
    if energy < uav[U_RESERVE] - EPS_J:
        return -np.inf
    return float(energy - uav[U_CRUISE] * (world.near[m] / uav[U_SPEED]) - uav[U_RESERVE])


@jit
def rendezvous(world: World, work: Work, u: int, g: int, p: int, out: Floats) -> bool:
    """What a meeting would be like, into ``out`` (DETAILS,); whether the evaluator would find nothing wrong with it.

    Columns: flight in m, drive in s, when the UGV is there, when the UAV, begin of docking, end, the UAV's energy on
    docking, charging in s, what the UGV has left in J.
    """
    n_tasks = world.visited.shape[0]
    n_sites = world.road.shape[1]
    uav, ugv = world.uavs[u], world.ugvs[g]
    at = work.site[g]
    there = work.gs[g, 0]
    drive = 0.0
    leave = work.gs[g, 1]
    if at != p:
        metres = world.road[at, p]
        if metres == np.inf:
            for k in range(DETAILS):
                out[k] = np.inf
            return False
        drive = metres / ugv[G_SPEED]
        there = leave + drive
        leave = there
    metres = world.dist[work.node[u], n_tasks + p]
    fly = metres / uav[U_SPEED]
    arrive = work.us[u, 0] + fly
    land = work.us[u, 1] - uav[U_CRUISE] * fly
    free = np.inf
    for k in range(work.docks.shape[1]):
        free = min(free, work.docks[g, k])
    begin_s = max(arrive, there, free)
    energy = land - uav[U_WAIT] * (begin_s - arrive)
    given = max(0.0, uav[U_CAPACITY] - energy)
    charge = ugv[G_CHARGE_S]
    if ugv[G_CHARGE_W] > 0.0:
        charge = given / ugv[G_CHARGE_W]
    end = begin_s + ugv[G_DOCK] + charge + ugv[G_UNDOCK]
    driven = work.gs[g, 2] + drive
    # The evaluator looks at the UGV's battery at the end; standing counts from its being ready.
    stand = max(0.0, end - ugv[G_READY] - driven)
    left = ugv[G_ENERGY] - ugv[G_DRIVE] * driven - ugv[G_IDLE] * stand - work.gs[g, 3] - given
    out[P_FLY] = metres
    out[P_DRIVE] = drive
    out[P_THERE] = there
    out[P_ARRIVE] = arrive
    out[P_WORK] = begin_s
    out[P_END] = end
    out[P_ENERGY] = energy
    out[P_CHARGE] = charge
    out[P_LEFT] = left
    return bool(
        world.ugv_on[g] != 0
        and at < n_sites + world.ugvs.shape[0]
        and energy >= uav[U_RESERVE] - EPS_J
        and energy + given >= uav[U_RESERVE] - EPS_J
        and left >= -EPS_J
        and begin_s < np.inf
    )


@jit
def twins(world: World, work: Work, a: int, b: int) -> bool:
    """Whether two UGVs are alike in every respect now, so that it does not matter which of them is met."""
    if work.site[a] != work.site[b] or world.ugv_on[a] != world.ugv_on[b]:
        return False
    for k in range(world.ugvs.shape[1]):
        if world.ugvs[a, k] != world.ugvs[b, k]:
            return False
    for k in range(4):
        if work.gs[a, k] != work.gs[b, k]:
            return False
    for k in range(work.docks.shape[1]):  # noqa: SIM110  (numba has no all() of a generator)
        if work.docks[a, k] != work.docks[b, k]:
            return False
    return True


@jit
def same_uav(world: World, work: Work, turn: Turn, a: int, b: int) -> bool:
    """Whether two UAVs are alike in every respect now."""
    if turn.done[a] != turn.done[b] or turn.row[a] != turn.row[b]:
        return False
    if work.us[a, 0] != work.us[b, 0] or work.us[a, 1] != work.us[b, 1]:
        return False
    for k in range(world.uavs.shape[1]):
        if world.uavs[a, k] != world.uavs[b, k]:
            return False
    for k in range(world.dist.shape[1]):  # noqa: SIM110  (both at the same place: the same distances)
        if world.dist[work.node[a], k] != world.dist[work.node[b], k]:
            return False
    return True


@jit
def offer(world: World, work: Work, turn: Turn, u: int) -> int:
    """Fills in what UAV ``u`` may do; the number of options.

    Not offered: what breaks a rule; a meeting after ``MEETS_IN_ROW`` others without a visit, of a UAV that is full and
    there already, or with a UGV that has a twin of a lower index; ``done`` where tasks are left and nobody else is.
    """
    n_sites = world.road.shape[1]
    count = 0
    for m in range(world.visited.shape[0]):
        turn.visits[m] = work.seen[m] == 0 and after_visit(world, work, u, m) >= -EPS_J
        count += turn.visits[m]
    uav = world.uavs[u]
    for g in range(world.ugvs.shape[0]):
        double = False
        for other in range(g):
            double = double or twins(world, work, other, g)
        for p in range(n_sites):
            fine = rendezvous(world, work, u, g, p, turn.details[g, p])
            idle = turn.details[g, p, P_FLY] <= AT_SITE_M and work.us[u, 1] >= uav[U_CAPACITY] - 1.0
            turn.meets[g, p] = fine and not double and not idle and turn.row[u] < MEETS_IN_ROW
            count += turn.meets[g, p]
    others = 0
    for v in range(turn.done.shape[0]):
        others += v != u and turn.done[v] == 0
    turn.may_end[0] = others > 0
    return count + int(turn.may_end[0])
