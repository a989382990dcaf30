"""How late each action may be: free and total slack of a decoded plan, by one backward pass over its precedences."""

from __future__ import annotations

from collections.abc import Sequence

from planner import kernel
from planner.kernel import Floats
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem

INF = float("inf")


def slacks(problem: Problem, actions: Sequence[Action], rows: Floats, out: Floats) -> tuple[list[float], list[float]]:
    """Free and total slack of each action, in s; never over-stated (``docs/planning.md``, section Slack).

    Args:
        problem: the problem.
        actions: the plan.
        rows: per action, as ``kernel.run`` wrote them, (n, 9).
        out: the plan's results, as ``kernel.run`` wrote them, (OUT_SIZE,).
    """
    n = len(actions)
    r = rows.tolist()
    makespan = float(out[kernel.O_MAKESPAN])
    cap = _ugv_energy_cap_s(problem, actions, r, float(out[kernel.O_END]))
    free = [INF] * n
    total = [INF] * n
    next_of_uav: list[int | None] = [None] * len(problem.uavs)
    next_move: list[int | None] = [None] * len(problem.ugvs)
    on_dock: dict[tuple[int, int], int] = {}  # next recharge on that dock
    until_move: list[list[int]] = [[] for _ in problem.ugvs]  # recharges after this point and before the next move

    def before_docking(i: int, j: int) -> None:
        """Recharge ``j`` cannot dock before action ``i`` has ended: a delay makes its UAV wait."""
        room = max(0.0, r[j][kernel.R_WORK] - r[i][kernel.R_END])
        act = actions[j]
        assert isinstance(act, Recharge)
        uav, ugv = problem.uavs[act.uav], problem.ugvs[act.ugv]
        more = total[j]
        if uav.waiting == "hover" and uav.hover_w > 0:
            if ugv.charge_w is not None:  # waiting makes charging longer as well
                more /= 1.0 + uav.hover_w / ugv.charge_w
            more = min(more, max(0.0, r[j][kernel.R_E_ARRIVE] - uav.reserve_j) / uav.hover_w)
        free[i] = min(free[i], room)
        total[i] = min(total[i], room + more)

    def before_start(i: int, j: int) -> None:
        room = max(0.0, r[j][kernel.R_START] - r[i][kernel.R_END])
        free[i] = min(free[i], room)
        total[i] = min(total[i], room + total[j])

    for i in range(n - 1, -1, -1):
        act = actions[i]
        if isinstance(act, Move):
            for j in until_move[act.ugv]:
                before_docking(i, j)
            following = next_move[act.ugv]
            if following is not None:
                before_start(i, following)
            next_move[act.ugv] = i
            until_move[act.ugv] = []
        else:
            following = next_of_uav[act.uav]
            if following is not None:
                free[i] = 0.0
                # A UAV that leaves later arrives later and waits less.
                room = max(0.0, r[following][kernel.R_WORK] - r[following][kernel.R_ARRIVE])
                total[i] = min(total[i], room + total[following])
            next_of_uav[act.uav] = i
            if isinstance(act, Visit):
                total[i] = min(total[i], max(0.0, makespan - r[i][kernel.R_END]))
            else:
                key = (act.ugv, int(r[i][kernel.R_DOCK]))
                if key in on_dock:
                    before_docking(i, on_dock[key])
                on_dock[key] = i
                move = next_move[act.ugv]
                if move is not None:
                    before_start(i, move)
                until_move[act.ugv].append(i)
        free[i] = min(free[i], cap)
        total[i] = min(total[i], cap)
    return free, total


def _ugv_energy_cap_s(problem: Problem, actions: Sequence[Action], r: list[list[float]], end_s: float) -> float:
    """No delay up to this can exhaust a UGV by standing longer or by giving more to UAVs that waited longer."""
    stretch = 1.0  # how much a delay can grow on its way through recharges that waiting makes longer
    thirst_w = [g.idle_w for g in problem.ugvs]
    spent = [0.0] * len(problem.ugvs)
    for act, row in zip(actions, r, strict=True):
        if isinstance(act, Move):
            spent[act.ugv] += row[kernel.R_E_START] - row[kernel.R_E_END]
        elif isinstance(act, Recharge):
            uav, ugv = problem.uavs[act.uav], problem.ugvs[act.ugv]
            spent[act.ugv] += row[kernel.R_E_END] - row[kernel.R_E_ARRIVE]
            if uav.waiting == "hover":
                thirst_w[act.ugv] += uav.hover_w
                if ugv.charge_w is not None:
                    stretch *= 1.0 + uav.hover_w / ugv.charge_w
    cap = INF
    for g, ugv in enumerate(problem.ugvs):
        if thirst_w[g] > 0:
            margin = ugv.energy_j - spent[g] - ugv.idle_w * max(0.0, end_s - ugv.ready_s)
            cap = min(cap, max(0.0, margin) / (thirst_w[g] * stretch))
    return cap
