"""Decodes a plan into times, energies and slack; semantics in ``docs/planning.md``, arithmetic in ``kernel.run``."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from planner import kernel
from planner.arrays import arrays_of, encode
from planner.kernel import Floats, Ints
from planner.plan import Action, Move, Recharge, Recovery, Schedule, ScheduledAction, Visit
from planner.problem import Problem
from planner.slack import slacks


class Prediction(NamedTuple):
    """What ``predict`` tells about a plan; times in s from the problem's time 0, energies in J summed over the team.

    Attributes:
        feasible: every task is visited once and no constraint is violated.
        makespan_s: end of the last visit.
        end_s: end of the plan's last action.
        recovery_s: when the last UAV can have landed at its recovery site.
        survives: no constraint is violated, but tasks may be left unvisited.
        n_unvisited: tasks that nobody visits.
    """

    feasible: bool
    makespan_s: float
    end_s: float
    recovery_s: float
    uav_energy_j: float
    ugv_energy_j: float
    energy_given_j: float
    waiting_s: float
    survives: bool
    n_unvisited: int


def predict(
    problem: Problem,
    actions: Sequence[Action],
    *,
    exclude_uavs: Collection[int] = (),
    exclude_ugvs: Collection[int] = (),
) -> Prediction:
    """As ``evaluate``, without anything per action: cheap enough for every second of a mission.

    Raises:
        PlannerError: when an action or an excluded index names something that does not exist.
    """
    _, out, _, _ = _run(problem, actions, exclude_uavs, exclude_ugvs, detail=False)
    o = out.tolist()
    code = int(o[kernel.O_CODE])
    return Prediction(
        feasible=code == kernel.OK,
        makespan_s=o[kernel.O_MAKESPAN],
        end_s=o[kernel.O_END],
        recovery_s=o[kernel.O_RECOVERY],
        uav_energy_j=o[kernel.O_UAV_J],
        ugv_energy_j=o[kernel.O_UGV_J],
        energy_given_j=o[kernel.O_GIVEN_J],
        waiting_s=o[kernel.O_WAITING],
        survives=code in (kernel.OK, kernel.V_UNVISITED),
        n_unvisited=int(o[kernel.O_UNVISITED]),
    )


def evaluate(
    problem: Problem,
    actions: Sequence[Action],
    *,
    exclude_uavs: Collection[int] = (),
    exclude_ugvs: Collection[int] = (),
) -> Schedule:
    """Decodes ``actions`` into a schedule; an infeasible plan carries its first violation in words.

    Args:
        problem: the problem.
        actions: joint actions in decision order.
        exclude_uavs: indices of UAVs that may not act and need no recovery (lost ones).
        exclude_ugvs: indices of UGVs that may not act.

    Raises:
        PlannerError: when an action or an excluded index names something that does not exist.
    """
    rows, out, node, clock = _run(problem, actions, exclude_uavs, exclude_ugvs, detail=True)
    a = arrays_of(problem)
    code = int(out[kernel.O_CODE])
    free, total = slacks(problem, actions, rows, out)
    scheduled = tuple(
        ScheduledAction(
            action=i,
            start_s=row[kernel.R_START],
            end_s=row[kernel.R_END],
            slack_s=free[i],
            total_slack_s=total[i],
            arrive_s=row[kernel.R_ARRIVE],
            work_s=row[kernel.R_WORK],
            energy_start_j=row[kernel.R_E_START],
            energy_end_j=row[kernel.R_E_END],
            energy_arrive_j=row[kernel.R_E_ARRIVE],
            dock=int(row[kernel.R_DOCK]) if row[kernel.R_DOCK] >= 0 else None,
        )
        for i, row in enumerate(rows.tolist())
    )
    recovery = []
    for u, uav in enumerate(problem.uavs):
        if u in exclude_uavs:
            continue
        site = int(a.near_site[node[u]])
        fly = float(a.near[node[u]]) / uav.speed_mps
        start, energy = float(clock[u, 0]), float(clock[u, 1])
        where = None if site == problem.depot_index else site
        recovery.append(Recovery(u, where, start, start + fly, energy - uav.cruise_w * fly))
    return Schedule(
        feasible=code == kernel.OK,
        violation=_words(problem, actions, code, int(out[kernel.O_WHERE]), float(out[kernel.O_AMOUNT])),
        makespan_s=float(out[kernel.O_MAKESPAN]),
        uav_energy_j=float(out[kernel.O_UAV_J]),
        ugv_energy_j=float(out[kernel.O_UGV_J]),
        energy_given_j=float(out[kernel.O_GIVEN_J]),
        waiting_s=float(out[kernel.O_WAITING]),
        recovery_s=float(out[kernel.O_RECOVERY]),
        actions=scheduled,
        recovery=tuple(recovery),
    )


def _run(
    problem: Problem,
    actions: Sequence[Action],
    exclude_uavs: Collection[int],
    exclude_ugvs: Collection[int],
    *,
    detail: bool,
) -> tuple[Floats, Floats, Ints, Floats]:
    a = arrays_of(problem)
    acts = encode(problem, actions)
    n = len(acts)
    rows = np.empty((n if detail else 0, 9))
    work = a.work()
    kernel.run(a.world(exclude_uavs, exclude_ugvs), work, acts, n, np.inf, rows)
    return rows, work.out, work.node, work.us


def _name(kind: str, index: int, vehicle_id: str) -> str:
    return f"{kind} {index}" if vehicle_id == f"{kind}{index}" else f"{kind} {index} ({vehicle_id})"


def _words(problem: Problem, actions: Sequence[Action], code: int, where: int, amount: float) -> str | None:
    if code == kernel.OK:
        return None
    kilojoules = f"{amount / 1e3:.1f} kJ" if amount >= 50.0 else f"{amount:.3g} J"

    def uav(index: int) -> str:
        return _name("uav", index, problem.uavs[index].id)

    def ugv(index: int) -> str:
        return _name("ugv", index, problem.ugvs[index].id)

    def site(index: int | None) -> str:
        return "the depot" if index is None else f"path point {index}"

    if code == kernel.V_UNVISITED:
        seen = {x.task for x in actions if isinstance(x, Visit)}
        missing = [m for m in range(problem.n_tasks) if not problem.visited[m] and m not in seen]
        some = ", ".join(map(str, missing))
        return f"tasks {some} are not visited" if len(missing) > 1 else f"task {some} is not visited"
    if code == kernel.V_RECOVERY:
        return f"{uav(where)} is {kilojoules} short of reaching any path point or the depot after its last action"
    if code == kernel.V_STAND:
        return f"{ugv(where)} is {kilojoules} short at the end of the plan"
    act = actions[where]
    if isinstance(act, Visit):
        if code == kernel.V_TWICE:
            before = any(isinstance(x, Visit) and x.task == act.task for x in actions[:where])
            return f"{uav(act.uav)} visits task {act.task}, which {'the plan has' if before else 'is'} visited already"
        if code == kernel.V_UAV_EXCLUDED:
            return f"{uav(act.uav)} is excluded but visits task {act.task}"
        doing = "on its way to" if code == kernel.V_TASK else "while serving"
        return f"{uav(act.uav)} is {kilojoules} short {doing} task {act.task}"
    if isinstance(act, Recharge):
        return {
            kernel.V_UAV_EXCLUDED: f"{uav(act.uav)} is excluded but recharges at {ugv(act.ugv)}",
            kernel.V_UGV_EXCLUDED: f"{ugv(act.ugv)} is excluded but recharges {uav(act.uav)}",
            kernel.V_BETWEEN: f"{ugv(act.ugv)} is between path points and must move before it recharges {uav(act.uav)}",
            kernel.V_UGV: f"{uav(act.uav)} is {kilojoules} short on its way to {ugv(act.ugv)}",
            kernel.V_WAIT: f"{uav(act.uav)} is {kilojoules} short while waiting for {ugv(act.ugv)}",
            kernel.V_GIVE: f"{ugv(act.ugv)} is {kilojoules} short while recharging {uav(act.uav)}",
        }[code]
    assert isinstance(act, Move)
    to = site(act.path_point)
    if code == kernel.V_ROAD:
        return f"no road leads {ugv(act.ugv)} from where it is to {to}"
    if code == kernel.V_UGV_EXCLUDED:
        return f"{ugv(act.ugv)} is excluded but moves to {to}"
    return f"{ugv(act.ugv)} is {kilojoules} short on its way to {to}"
