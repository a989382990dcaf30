"""Estimated probability that a plan succeeds, by a Monte Carlo over its schedule.

Each sample runs the plan's precedence graph with drawn speeds, winds, drains, charging times, delays and UGV stalls
(``Uncertainty``). No sample replans: the figure says how well the plan stands by itself, and the supervisor can only
do better. What is drawn and why: ``docs/checks.md``.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deploy import montecarlo_kernel as kernel
from deploy.check_limits import CERTAIN, Uncertainty
from deploy.errors import DeployError
from deploy.montecarlo_result import Estimate, Margin, Share, Spread
from planner.arrays import arrays_of, encode
from planner.kernel import AT_SITE_M
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem

__all__ = [
    "CERTAIN",
    "Draws",
    "Estimate",
    "Overheads",
    "Samples",
    "Share",
    "Spread",
    "Uncertainty",
    "draw",
    "estimate",
    "simulate",
]

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class MonteCarloError(DeployError):
    """The plan cannot be simulated: it asks for something impossible, whatever is drawn."""


@dataclass(frozen=True, slots=True)
class Overheads:
    """What flying adds to the schedule's straight lines at cruise speed; mission s, one value per vehicle.

    Attributes:
        leg_s: per UAV, braking and accelerating in each flight to a task, in time and at cruise power.
        down_s: per UAV, how long within ``dock_s`` it hovers down to the dock; the schedule has the time, not the
            energy. The landing at the end costs the same.
        up_s: per UAV, how long within ``undock_s`` it climbs; likewise.
        drive_s: per UGV, braking and accelerating in each drive.
    """

    leg_s: tuple[float, ...]
    down_s: tuple[float, ...]
    up_s: tuple[float, ...]
    drive_s: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Samples:
    """The raw samples; S samples, n actions, U UAVs. Times in s from the problem's time 0, energies in J.

    Attributes:
        end_s: end of each action, (S, n).
        low_j: energy at docking, at a visit's end, or of the UGV at a drive's end, (S, n).
        land_j: energy of each UAV after its recovery, (S, U).
        makespan_s: (S,).
        fail_zero: first failure of each sample, coded as in ``montecarlo_kernel.propagate``; -1 for none, (S,).
        fail_reserve: the same with the reserve as the limit, (S,).
    """

    end_s: Floats
    low_j: Floats
    land_j: Floats
    makespan_s: Floats
    fail_zero: Ints
    fail_reserve: Ints


@dataclass(frozen=True, slots=True)
class Draws:
    """Everything random of S samples, before ``Uncertainty`` scales it; n actions, U UAVs, G UGVs.

    Attributes:
        uav: standard normals for speed and drain, (2, S, U).
        ugv: likewise, (2, S, G).
        wind: of the steady wind's components, (2, S).
        action: per action and, behind them, per recovery: speed or gust, charging, departure, docking, leaving,
            (5, S, n + U).
        stall_u: uniform; a drive stalls where this is below its probability, (S, n).
        stall_z: standard normal of its duration, (S, n).
    """

    uav: Floats
    ugv: Floats
    wind: Floats
    action: Floats
    stall_u: Floats
    stall_z: Floats


def draw(problem: Problem, n_actions: int, samples: int, seed: int) -> Draws:
    """Draws for ``samples`` samples; the same arguments give the same draws."""
    rng = np.random.default_rng([seed, 0x3C])
    n_uavs, n_ugvs = len(problem.uavs), len(problem.ugvs)
    return Draws(
        uav=rng.standard_normal((2, samples, n_uavs)),
        ugv=rng.standard_normal((2, samples, n_ugvs)),
        wind=rng.standard_normal((2, samples)),
        action=rng.standard_normal((5, samples, n_actions + n_uavs)),
        stall_u=rng.random((samples, n_actions)),
        stall_z=rng.standard_normal((samples, n_actions)),
    )


def simulate(
    problem: Problem,
    actions: Sequence[Action],
    uncertainty: Uncertainty,
    *,
    samples: int = 1000,
    seed: int = 0,
    makespan_limit_s: float | None = None,
    overheads: Overheads | None = None,
    draws: Draws | None = None,
) -> Samples:
    """Draws and propagates; the same arguments give the same samples.

    The draws do not depend on ``uncertainty``, which only scales them: two settings are compared on equal luck.
    ``draws`` replaces ``samples`` and ``seed``.

    Raises:
        PlannerError: when an action names something that does not exist.
        MonteCarloError: when no road leads somewhere, or a UGV between path points must recharge.
    """
    a = arrays_of(problem)
    acts = encode(problem, actions)
    legs, drives, first, on_pad = _geometry(problem, actions)
    n, n_uavs, n_ugvs = len(acts), len(a.uavs), len(a.ugvs)
    o = overheads or Overheads((0.0,) * n_uavs, (0.0,) * n_uavs, (0.0,) * n_uavs, (0.0,) * n_ugvs)
    p, z = uncertainty, draws or draw(problem, n, samples, seed)
    samples = z.stall_u.shape[0]
    out = Samples(
        end_s=np.empty((samples, n)),
        low_j=np.empty((samples, n)),
        land_j=np.empty((samples, n_uavs)),
        makespan_s=np.empty(samples),
        fail_zero=np.empty(samples, np.int32),
        fail_reserve=np.empty(samples, np.int32),
    )
    kernel.propagate(
        acts,
        legs,
        drives,
        first,
        on_pad,
        a.uavs,
        a.ugvs,
        a.docks0,
        np.array([o.leg_s, o.down_s, o.up_s], dtype=np.float64).T.copy(),
        np.array(o.drive_s, dtype=np.float64),
        np.array(
            [
                p.uav_speed,
                p.ugv_speed,
                p.move_speed,
                p.wind,
                p.gust,
                p.wind_power,
                p.drain,
                p.ugv_drain,
                p.charge,
                p.departure_s,
                p.docking_s,
                p.delay_sigma,
                p.stalls_per_h / 3600.0,
                p.stall_s,
                p.stall_sigma,
            ]
        ),
        z.uav,
        z.ugv,
        z.wind,
        z.action,
        z.stall_u,
        z.stall_z,
        math.inf if makespan_limit_s is None else makespan_limit_s,
        out.end_s,
        out.low_j,
        out.land_j,
        out.makespan_s,
        out.fail_zero,
        out.fail_reserve,
    )
    return out


def estimate(
    problem: Problem,
    actions: Sequence[Action],
    uncertainty: Uncertainty,
    *,
    samples: int = 1000,
    seed: int = 0,
    makespan_limit_s: float | None = None,
    overheads: Overheads | None = None,
) -> Estimate:
    """Estimates the probability of success of a plan, and what is most likely to spoil it.

    Args:
        problem: the problem.
        actions: the plan's actions in decision order.
        uncertainty: what to draw.
        samples: how many.
        seed: of the draws.
        makespan_limit_s: later than this is a failure, mission s.
        overheads: what flying adds to the schedule.

    Raises:
        PlannerError: when an action names something that does not exist.
        MonteCarloError: when the plan asks for something impossible.
    """
    drawn = simulate(
        problem,
        actions,
        uncertainty,
        samples=samples,
        seed=seed,
        makespan_limit_s=makespan_limit_s,
        overheads=overheads,
    )
    missing = _unvisited(problem, actions)
    count = 0 if missing else int((drawn.fail_zero < 0).sum())
    count_reserve = 0 if missing else int((drawn.fail_reserve < 0).sum())
    words = _words(problem, actions)
    causes = [(missing, 1.0)] if missing else []
    return Estimate(
        success=Share(count, samples),
        success_reserve=Share(count_reserve, samples),
        makespan_s=Spread.of(drawn.makespan_s),
        margins=_margins(problem, actions, drawn, words),
        causes=(*causes, *_causes(drawn.fail_zero, words)),
        causes_reserve=(*causes, *_causes(drawn.fail_reserve, words)),
    )


def _geometry(
    problem: Problem, actions: Sequence[Action]
) -> tuple[Floats, Floats, NDArray[np.uint8], NDArray[np.uint8]]:
    """Where everybody flies and drives: fixed by the plan, whatever the times are."""
    a = arrays_of(problem)
    n_tasks, n_sites = problem.n_tasks, problem.depot_index + 1
    place = np.concatenate([problem.tasks, problem.sites, np.array([u.position for u in problem.uavs])])
    node = [n_tasks + n_sites + u for u in range(len(problem.uavs))]
    fresh = [True] * len(problem.uavs)
    site = a.site0.tolist()
    n = len(actions)
    legs, drives = np.zeros((n + len(node), 3)), np.zeros(n)
    first, on_pad = np.zeros(n + len(node), np.uint8), np.zeros(len(node), np.uint8)

    def fly(row: int, uav: int, to: int, metres: float) -> None:
        legs[row, 0] = metres
        if metres > 0:
            legs[row, 1:] = (place[to] - place[node[uav]]) / metres
        first[row] = fresh[uav]

    for i, act in enumerate(actions):
        if isinstance(act, Move):
            to_site = problem.depot_index if act.path_point is None else act.path_point
            drives[i] = a.road[site[act.ugv], to_site]
            if math.isinf(drives[i]):
                ugv = problem.ugvs[act.ugv].id
                raise MonteCarloError(f"actions[{i}]: no road leads {ugv} to {_site(act.path_point)}; plan again")
            site[act.ugv] = to_site
            continue
        if isinstance(act, Recharge) and site[act.ugv] >= n_sites:
            ugv = problem.ugvs[act.ugv].id
            raise MonteCarloError(f"actions[{i}]: {ugv} is between path points and must move first; plan again")
        to = act.task if isinstance(act, Visit) else n_tasks + site[act.ugv]
        fly(i, act.uav, to, float(a.dist[node[act.uav], to]))
        node[act.uav] = to
        fresh[act.uav] = False
    for u in range(len(node)):
        metres = float(a.near[node[u]])
        fly(n + u, u, n_tasks + int(a.near_site[node[u]]), metres)
        # As in the planner: a UAV that never left its place near a site has no recovery to fly.
        on_pad[u] = node[u] >= n_tasks + n_sites and metres <= AT_SITE_M
    return legs, drives, first, on_pad


def _site(path_point: int | None) -> str:
    return "the depot" if path_point is None else f"path point {path_point}"


def _unvisited(problem: Problem, actions: Sequence[Action]) -> str | None:
    seen = {act.task for act in actions if isinstance(act, Visit)}
    missing = [str(m) for m in range(problem.n_tasks) if not problem.visited[m] and m not in seen]
    if not missing:
        return None
    return f"nobody visits task{'s' if len(missing) > 1 else ''} {', '.join(missing)}"


def ordinal(number: int) -> str:
    """1st, 2nd, 3rd, 4th ..."""
    special = {1: "st", 2: "nd", 3: "rd"}
    return f"{number}{'th' if 10 <= number % 100 <= 20 else special.get(number % 10, 'th')}"


def _words(problem: Problem, actions: Sequence[Action]) -> list[str]:
    """Each failure code in words."""
    docked: Counter[int] = Counter()
    words = []
    for act in actions:
        if isinstance(act, Move):
            words.append(f"{problem.ugvs[act.ugv].id} on its way to {_site(act.path_point)}")
        elif isinstance(act, Visit):
            words.append(f"{problem.uavs[act.uav].id} on its way to task {act.task}")
        else:
            docked[act.uav] += 1
            uav, ugv = problem.uavs[act.uav].id, problem.ugvs[act.ugv].id
            words.append(f"{uav} at its {ordinal(docked[act.uav])} rendezvous ({ugv})")
    words += [f"{u.id} at its landing after its last action" for u in problem.uavs]
    words += [f"{g.id} runs out of energy itself" for g in problem.ugvs]
    return [*words, "the makespan limit is missed"]


def _causes(codes: Ints, words: Sequence[str]) -> tuple[tuple[str, float], ...]:
    found = Counter(codes[codes >= 0].tolist())
    return tuple((words[code], count / len(codes)) for code, count in found.most_common())


def _margins(problem: Problem, actions: Sequence[Action], drawn: Samples, words: Sequence[str]) -> tuple[Margin, ...]:
    rows: list[tuple[int | None, int, str, Floats]] = [
        (i, act.uav, words[i], drawn.low_j[:, i]) for i, act in enumerate(actions) if isinstance(act, Recharge)
    ]
    n = len(actions)
    rows += [(None, u, words[n + u], drawn.land_j[:, u]) for u in range(len(problem.uavs))]
    margins = []
    for action, uav, where, energy in rows:
        margin = energy - problem.uavs[uav].reserve_j
        below = int((margin < -kernel.EPS_J).sum())
        margins.append(Margin(where, action, uav, Spread.of(margin), Share(below, len(margin))))
    return tuple(margins)
