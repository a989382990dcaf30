"""Re-timing and replanning: three tiers, decided by slack at every review (design section 4)."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

from deploy.events import Action, EventKind
from deploy.failsafe import Situation, action_for
from deploy.observation import PlanReply, PlanRequest
from deploy.recovery import call_off
from deploy.retime import excluded, landing_s, plan_state, problem_now, remaining
from deploy.state import AIRBORNE, UAV_FINAL, Pending, UavPhase, UgvPhase
from deploy.turn import Adopted, Turn
from planner.plan import Action as PlanAction
from planner.plan import Recharge, Visit
from planner.schedule import Prediction, evaluate, predict

DOCKED = frozenset({UavPhase.DOCKING, UavPhase.CHARGING})
URGENT_RETRY_S = 5.0
AGAIN = 4.0  # replanning intervals after which tasks given up are tried again
GIVE_UP = 6  # times the time after which a replan is late: then it is taken for one without a plan


def review(turn: Turn) -> None:
    """Takes in a planner's reply, re-times the rest of the plan once per review interval, asks for replans."""
    reply = turn.observation.plan_reply
    if reply is not None and turn.pending is not None and reply.number == turn.pending.number:
        _take(turn, reply)
    due_s = turn.state.review_s + turn.settings.replanning.review_s
    if turn.now_s >= due_s - 1e-9 or turn.state.replan_reason is not None:
        turn.state = replace(turn.state, review_s=turn.now_s)
        _retime(turn)
    _late(turn)
    _request(turn)


def finished(turn: Turn) -> bool:
    """Nothing is left to do: no action, and nobody who might still be planned for."""
    if turn.pending is not None or turn.state.replan_reason is not None:
        return False
    if remaining(turn) or (turn.plan.given_up and not turn.state.tried_again):
        return False
    return all(
        u.phase in UAV_FINAL or u.phase in (UavPhase.ON_PAD, UavPhase.FLYING, UavPhase.LANDING) or u.out
        for u in turn.uavs
    ) and all(g.phase is not UgvPhase.DRIVING or g.stuck or g.out for g in turn.ugvs)


def _retime(turn: Turn) -> None:
    rest = remaining(turn)
    limits, plan = turn.settings.replanning, turn.plan
    exclude = excluded(turn)
    open_tasks = {m for m, v in enumerate(turn.visited) if not v} - plan.given_up
    if plan.given_up and turn.pending is None and turn.state.replan_reason is None:
        _try_again(turn, idle=not rest)
    if not rest and not open_tasks:
        if not plan.given_up:  # nothing is left to plan: everybody comes down where he can
            turn.state = replace(turn.state, replan_reason=None, replan_urgent=False)
        return
    problem = problem_now(turn, plan.given_up, limits.tolerance, landed=plan.landed)
    now = predict(problem, rest, exclude_uavs=exclude[0], exclude_ugvs=exclude[1])
    if not now.feasible:
        violation = evaluate(problem, rest, exclude_uavs=exclude[0], exclude_ugvs=exclude[1]).violation
        if plan.violation is None:
            action = action_for(EventKind.ENERGY_RENDEZVOUS, Situation.MISSION, turn.settings.failsafe)
            turn.tell(EventKind.ENERGY_RENDEZVOUS, f"the plan cannot be finished: {violation}", None, action)
        turn.plan = replace(plan, predicted_s=None, violation=violation)
        turn.want_replan(f"the plan cannot be finished: {violation}", urgent=True)
        return
    predicted_s = turn.mission_s + now.makespan_s if open_tasks else plan.predicted_s
    turn.plan = plan = replace(plan, predicted_s=predicted_s, violation=None)
    if not open_tasks or predicted_s is None:
        return
    loss_s = predicted_s - plan.baseline_s
    drifted = loss_s > min(limits.loss_s, limits.loss_ratio * plan.baseline_s)
    if drifted and turn.pending is None and turn.state.replan_reason is None and _interval_over(turn):
        action = action_for(EventKind.SCHEDULE_DRIFT, Situation.MISSION, turn.settings.failsafe)
        text = f"the mission will take {loss_s:.0f} s longer than planned ({predicted_s:.0f} s)"
        turn.tell(EventKind.SCHEDULE_DRIFT, text, None, action)
        if action >= Action.REPLAN:
            turn.want_replan(text, urgent=False)


def _try_again(turn: Turn, *, idle: bool) -> None:
    """Tasks that were given up may have come within reach: asks now and then, and once more when all else is done."""
    again_s = AGAIN * turn.settings.replanning.interval_s * turn.settings.frame.time_scale
    if turn.now_s - turn.state.last_request_s >= again_s or (idle and not turn.state.tried_again and _settled(turn)):
        turn.state = replace(turn.state, tried_again=idle)
        turn.want_replan("tasks have been given up", urgent=idle)


def _settled(turn: Turn) -> bool:
    """Nobody who could take part is under way."""
    flying = any(u.phase in AIRBORNE and not u.out for u in turn.uavs)
    return not flying and not any(g.phase is UgvPhase.DRIVING and not g.stuck and not g.out for g in turn.ugvs)


def _interval_over(turn: Turn) -> bool:
    interval_s = turn.settings.replanning.interval_s * turn.settings.frame.time_scale
    return turn.now_s - turn.state.last_request_s >= interval_s


def _late(turn: Turn) -> None:
    pending, limit_s = turn.pending, turn.settings.monitors.planner_late_s
    if pending is not None and not pending.late and turn.now_s - pending.asked_s > limit_s:
        action = action_for(EventKind.PLANNER_LATE, Situation.MISSION, turn.settings.failsafe)
        turn.tell(EventKind.PLANNER_LATE, f"no replan after {limit_s:g} s; the old plan is flown on", None, action)
        turn.pending = replace(pending, late=True)
    if pending is not None and turn.now_s - pending.asked_s > GIVE_UP * limit_s:
        _take(turn, PlanReply(pending.number, False, (), "none", 0.0, "the planner does not answer", usable=False))


def _request(turn: Turn) -> None:
    """Sends the replan that is wanted, when none is on its way and the interval is over (a short one if urgent)."""
    state = turn.state
    if state.replan_reason is None or turn.pending is not None:
        return
    waited_s = turn.now_s - state.last_request_s
    if not (waited_s >= URGENT_RETRY_S if state.replan_urgent else _interval_over(turn)):
        return
    uavs, ugvs = excluded(turn)
    if len(uavs) == len(turn.uavs):
        _hopeless(turn, "no UAV can take part any more")
        return
    number = state.requests + 1
    turn.request = PlanRequest(
        number,
        problem_now(turn),
        remaining(turn),
        state.replan_reason,
        state.replan_urgent,
        uavs,
        ugvs,
        turn.settings.replanning.margin,
        landing_s(turn.settings) if any(u.waiting == "hover" for u in turn.settings.problem.uavs) else (),
    )
    docked = frozenset(u.index for u in turn.uavs if u.phase in DOCKED)
    turn.pending = Pending(number, turn.now_s, state.replan_urgent, docked, turn.plan.given_up, state.replan_reason)
    turn.tell(EventKind.PLAN_REQUESTED, f"replan {number}: {state.replan_reason}")
    turn.state = replace(state, requests=number, replan_reason=None, replan_urgent=False, last_request_s=turn.now_s)


def _take(turn: Turn, reply: PlanReply) -> None:
    """Adopts a reply that is better by the wanted share, or that works where the current plan does not."""
    pending = turn.pending
    assert pending is not None  # the caller has asked
    turn.pending = None
    actions = _still_to_do(turn, reply.actions, pending)
    exclude = excluded(turn)
    rest = remaining(turn)
    open_tasks = frozenset(m for m, v in enumerate(turn.visited) if not v)
    given_up = open_tasks - {a.task for a in actions if isinstance(a, Visit)}
    # Time has passed since it was asked for, energy is spent.
    new = _predict(turn, actions, given_up, exclude, landed=reply.landed)
    old_given_up = open_tasks - {a.task for a in rest if isinstance(a, Visit)}
    old = _predict(turn, rest, old_given_up, exclude, landed=turn.plan.landed)
    if not (reply.usable and new.survives):
        text = f"replan {reply.number} found no plan: {reply.violation or 'it does not fit any more'}"
        if old.survives:
            turn.tell(EventKind.PLAN_KEPT, text)
            _keep(turn, rest, old_given_up, exclude, old)
        elif reply.usable or turn.state.replan_reason is not None:  # things have changed while it was made
            turn.tell(EventKind.PLAN_KEPT, text)
            turn.want_replan(text, urgent=True)
        else:
            _hopeless(turn, text)
        return
    served = len(given_up) < len(old_given_up)
    faster = len(given_up) == len(old_given_up) and turn.mission_s + new.makespan_s <= (
        1 - turn.settings.replanning.adopt_ratio
    ) * (turn.mission_s + old.makespan_s)
    if old.survives and not served and not faster:
        promised_s, offered_s = turn.mission_s + old.makespan_s, turn.mission_s + new.makespan_s
        text = f"replan {reply.number} ({offered_s:.0f} s) is no better than the plan ({promised_s:.0f} s)"
        turn.tell(EventKind.PLAN_KEPT, text)
        _keep(turn, rest, old_given_up, exclude, old)
        return
    problem = problem_now(turn, given_up, turn.settings.replanning.tolerance, landed=reply.landed)
    number = turn.plan.number + 1
    turn.plan = plan_state(
        turn.settings,
        problem,
        actions,
        number=number,
        at_s=turn.mission_s,
        exclude=exclude,
        given_up=given_up,
        landed=reply.landed,
    )
    turn.state = replace(turn.state, tried_again=False)
    turn.adopted = Adopted(problem, actions, exclude, turn.mission_s)
    turn.uavs = [replace(u, action=None) for u in turn.uavs]
    left_out = f", without task {', '.join(map(str, sorted(given_up)))}" if given_up else ""
    note = f"; {reply.note}" if reply.note is not None else ""
    before = f"{turn.mission_s + old.makespan_s:.0f} s" if old.survives and not old_given_up else "no way to finish"
    turn.tell(
        EventKind.PLAN_ADOPTED,
        f"plan {number} ends at {turn.plan.planned_s:.0f} s instead of {before}{left_out} ({pending.reason}){note}",
    )


def _keep(
    turn: Turn,
    rest: tuple[PlanAction, ...],
    given_up: frozenset[int],
    exclude: tuple[tuple[int, ...], tuple[int, ...]],
    now: Prediction,
) -> None:
    """The plan stays in force, less what those were to do who take no part: nobody may wait for them."""
    plan = turn.plan
    under_way = sum(u.action is not None for u in turn.uavs)
    if plan.done.count(False) - under_way > len(rest):
        problem = problem_now(turn, given_up, turn.settings.replanning.tolerance, landed=plan.landed)
        plan = plan_state(
            turn.settings,
            problem,
            rest,
            number=plan.number,
            at_s=turn.mission_s,
            exclude=exclude,
            landed=plan.landed,
        )
        plan = replace(plan, planned_s=turn.plan.planned_s)
        turn.uavs = [replace(u, action=None) for u in turn.uavs]
    turn.plan = replace(plan, given_up=given_up, violation=None, baseline_s=turn.mission_s + now.makespan_s)


def _predict(
    turn: Turn,
    actions: tuple[PlanAction, ...],
    given_up: frozenset[int],
    exclude: tuple[tuple[int, ...], tuple[int, ...]],
    *,
    landed: bool,
) -> Prediction:
    problem = problem_now(turn, given_up, turn.settings.replanning.tolerance, landed=landed)
    return predict(problem, actions, exclude_uavs=exclude[0], exclude_ugvs=exclude[1])


def _still_to_do(turn: Turn, actions: tuple[PlanAction, ...], pending: Pending) -> tuple[PlanAction, ...]:
    """The reply's actions without what has been done, or begun at a dock, since it was asked for."""
    begun = Counter(u.index for u in turn.uavs if u.phase in DOCKED and u.index not in pending.docked)
    kept: list[PlanAction] = []
    for action in actions:
        if isinstance(action, Visit) and turn.visited[action.task]:
            continue
        if isinstance(action, Recharge) and begun[action.uav] > 0:
            begun[action.uav] -= 1
            continue
        kept.append(action)
    return tuple(kept)


def _hopeless(turn: Turn, text: str) -> None:
    """No plan works any more: what the failsafe table says, by default everybody comes down."""
    action = action_for(EventKind.PLANNER_INFEASIBLE, Situation.MISSION, turn.settings.failsafe)
    turn.tell(EventKind.PLANNER_INFEASIBLE, text, None, action)
    turn.state = replace(turn.state, replan_reason=None, replan_urgent=False)
    if action >= Action.TEAM_RECOVERY:
        call_off(turn, "everybody comes down")
    else:
        turn.plan = replace(turn.plan, given_up=frozenset(m for m, v in enumerate(turn.visited) if not v))
