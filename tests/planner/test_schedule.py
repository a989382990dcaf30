"""Semantics of ``docs/planning.md``, one by one, with numbers worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from planner.errors import PlannerError
from planner.plan import Move, Recharge, Visit
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate, predict

INF = math.inf


def line(uavs=None, ugvs=None, tasks=(1000.0, 3000.0), points=(2000.0, 4000.0), visited=()) -> Problem:
    """Everything on the x axis, depot at 0, roads straight; 10 m/s at 100 W, hovering 200 W, 5 m/s at 1000 W."""
    sites = np.array([*points, 0.0])
    return Problem(
        depot=(0.0, 0.0),
        tasks=[(x, 0.0) for x in tasks],
        path_points=[(x, 0.0) for x in points],
        road_distance_m=np.abs(sites[:, None] - sites[None]),
        uavs=uavs or (uav(0),),
        ugvs=(ugv(0),) if ugvs is None else ugvs,
        visited=visited,
    )


def uav(i: int, **more) -> Uav:
    return Uav(
        f"uav{i}",
        **{"position": (0.0, 0.0), "energy_j": 1e5, "capacity_j": 1e5, "cruise_w": 100.0, "hover_w": 200.0} | more,
    )


def ugv(i: int, **more) -> Ugv:
    return Ugv(f"ugv{i}", **{"energy_j": 1e7, "speed_mps": 5.0, "drive_w": 1000.0, "charge_s": 60.0} | more)


def test_visit_takes_flight_and_service() -> None:
    plan = evaluate(line((uav(0, service_s=30.0),)), [Visit(0, 0), Visit(0, 1)])
    first, second = plan.actions
    assert (first.start_s, first.arrive_s, first.work_s, first.end_s) == (0.0, 100.0, 100.0, 130.0)
    assert first.energy_end_j == 1e5 - 100 * 100 - 30 * 200
    assert (second.start_s, second.end_s) == (130.0, 360.0)
    assert plan.feasible and plan.violation is None
    assert plan.makespan_s == 360.0
    assert plan.uav_energy_j == 300 * 100 + 60 * 200
    assert plan.ugv_energy_j == 0.0
    (home,) = plan.recovery
    assert (home.uav, home.site, home.start_s, home.end_s) == (0, 0, 360.0, 460.0)
    assert plan.recovery_s == 460.0


def test_landed_waiting_costs_nothing_and_hovering_does() -> None:
    actions = [Visit(0, 0), Move(0, 0), Recharge(0, 0)]
    for waiting, cost in (("landed", 0.0), ("hover", 200.0)):
        plan = evaluate(line((uav(0, waiting=waiting),)), actions)
        recharge = plan.actions[2]
        assert (recharge.start_s, recharge.arrive_s, recharge.work_s, recharge.end_s) == (100.0, 200.0, 400.0, 460.0)
        assert recharge.energy_arrive_j == 1e5 - 200 * 100 - 200 * cost
        assert recharge.energy_end_j == 1e5
        assert plan.waiting_s == 200.0
        assert plan.uav_energy_j == plan.energy_given_j == 200 * 100 + 200 * cost
        assert plan.ugv_energy_j == 400 * 1000


def test_charging_with_constant_power_lasts_as_long_as_it_needs() -> None:
    problem = line(ugvs=(ugv(0, charge_s=None, charge_w=500.0, dock_s=5.0, undock_s=7.0),))
    plan = evaluate(problem, [Visit(0, 0), Recharge(0, 0)])
    assert plan.actions[1].end_s == 200 + 5 + 20_000 / 500 + 7
    assert plan.energy_given_j == 20_000


def test_ugv_stands_at_the_depot_until_it_moves_and_can_come_back() -> None:
    plan = evaluate(line(), [Recharge(0, 0), Move(0, 1), Move(0, None), Recharge(0, 0)])
    assert [a.end_s for a in plan.actions] == [60.0, 860.0, 1660.0, 1720.0]
    assert plan.recovery[0].site is None


def test_move_waits_for_recharges_listed_before_it() -> None:
    plan = evaluate(line((uav(0), uav(1))), [Visit(1, 0), Recharge(0, 0), Recharge(1, 0), Move(0, 0)])
    assert plan.actions[3].start_s == 260.0  # uav 1 comes back at 200 s


def test_move_to_where_it_is_takes_no_time_but_still_waits() -> None:
    plan = evaluate(line(), [Recharge(0, 0), Move(0, None)])
    assert (plan.actions[1].start_s, plan.actions[1].end_s) == (60.0, 60.0)


def test_docks_are_taken_in_decision_order_earliest_free_first() -> None:
    problem = line(tuple(uav(i) for i in range(3)))
    plan = evaluate(problem, [Recharge(0, 0), Recharge(1, 0), Recharge(2, 0)])
    assert [a.dock for a in plan.actions] == [0, 1, 0]
    assert [a.work_s for a in plan.actions] == [0.0, 0.0, 60.0]
    plan = evaluate(replace(problem, ugvs=(ugv(0, docks=1),)), [Recharge(0, 0), Recharge(1, 0), Recharge(2, 0)])
    assert [a.work_s for a in plan.actions] == [0.0, 60.0, 120.0]


def test_docks_that_are_busy_at_the_start_hold_the_ugv() -> None:
    problem = line(ugvs=(ugv(0, dock_ready_s=(500.0,)),))
    plan = evaluate(problem, [Recharge(0, 0), Move(0, 0)])
    assert plan.actions[0].dock == 1 and plan.actions[0].work_s == 0.0
    assert plan.actions[1].start_s == 500.0


def test_vehicles_start_when_they_are_ready() -> None:
    problem = line((uav(0, ready_s=40.0),), (ugv(0, ready_s=70.0, path_point=1),))
    plan = evaluate(problem, [Visit(0, 0), Recharge(0, 0)])
    assert plan.actions[0].start_s == 40.0
    assert plan.actions[1].end_s == 40 + 100 + 300 + 60
    assert evaluate(problem, [Recharge(0, 0)]).actions[0].end_s == 440 + 60
    assert evaluate(problem, [Move(0, 1)]).actions[0].end_s == 70.0


def test_standing_costs_idle_power_to_the_plans_end() -> None:
    problem = line(ugvs=(ugv(0, idle_w=10.0), ugv(1, idle_w=20.0, ready_s=100.0)))
    plan = evaluate(problem, [Move(0, 0), Visit(0, 0), Visit(0, 1), Recharge(0, 0)])
    assert plan.actions[3].end_s == 460.0
    assert plan.ugv_energy_j == 400 * 1000 + 60 * 10 + 360 * 20


def test_ugv_between_path_points_drives_by_its_own_distances() -> None:
    problem = line(ugvs=(ugv(0, distance_to_m=(500.0, INF, 1500.0)),))
    plan = evaluate(problem, [Move(0, 0), Recharge(0, 0)])
    assert plan.actions[0].end_s == 100.0
    assert plan.actions[1].work_s == 200.0
    assert evaluate(problem, [Recharge(0, 0)]).violation == (
        "ugv 0 is between path points and must move before it recharges uav 0"
    )
    assert evaluate(problem, [Move(0, 1)]).violation == "no road leads ugv 0 from where it is to path point 1"


def test_visited_tasks_are_done() -> None:
    problem = line(visited=[True, False])
    assert evaluate(problem, [Visit(0, 1)]).feasible
    assert evaluate(problem, [Visit(0, 1), Visit(0, 0)]).violation == "uav 0 visits task 0, which is visited already"
    twice = evaluate(problem, [Visit(0, 1), Visit(0, 1)])
    assert twice.violation == "uav 0 visits task 1, which the plan has visited already"


def test_empty_plan() -> None:
    plan = evaluate(line(), [])
    assert plan.violation == "tasks 0, 1 are not visited"
    assert (plan.makespan_s, plan.recovery_s, plan.actions) == (0.0, 0.0, ())
    done = evaluate(line(visited=[True, True]), [])
    assert done.feasible and done.recovery[0].site is None
    assert evaluate(line(visited=[True, False]), []).violation == "task 1 is not visited"


def with_energy(joules: float, **more) -> Problem:
    return line((uav(0, energy_j=joules, **more),))


@pytest.mark.parametrize(
    ("problem", "actions", "words"),
    [
        (with_energy(12e3), [Visit(0, 0), Visit(0, 1)], "uav 0 is 18.0 kJ short on its way to task 1"),
        (with_energy(10_030.0, service_s=1.0), [Visit(0, 0)], "uav 0 is 0.2 kJ short while serving task 0"),
        (with_energy(12e3), [Visit(0, 0), Recharge(0, 0)], "uav 0 is 8.0 kJ short on its way to ugv 0"),
        (
            with_energy(30e3, waiting="hover"),
            [Visit(0, 0), Move(0, 0), Recharge(0, 0)],
            "uav 0 is 30.0 kJ short while waiting for ugv 0",
        ),
        (
            with_energy(19_999.0),
            [Visit(0, 0)],
            "uav 0 is 1 J short of reaching any path point or the depot after its last action",
        ),
        (line((uav(0, reserve_j=75e3),)), [Visit(0, 0), Visit(0, 1)], "uav 0 is 5.0 kJ short on its way to task 1"),
        (line(ugvs=(ugv(0, energy_j=1e5),)), [Move(0, 0)], "ugv 0 is 300.0 kJ short on its way to path point 0"),
        (
            line(ugvs=(ugv(0, energy_j=6e5),)),
            [Move(0, 0), Move(0, None)],
            "ugv 0 is 200.0 kJ short on its way to the depot",
        ),
        (
            line(ugvs=(ugv(0, energy_j=15e3),)),
            [Visit(0, 0), Recharge(0, 0)],
            "ugv 0 is 5.0 kJ short while recharging uav 0",
        ),
        (
            line(ugvs=(ugv(0, energy_j=1e3, idle_w=10.0),)),
            [Visit(0, 0), Visit(0, 1)],
            "ugv 0 is 2.0 kJ short at the end of the plan",
        ),
    ],
)  # fmt: skip
def test_violations_in_words(problem: Problem, actions: list, words: str) -> None:
    plan = evaluate(problem, actions)
    assert not plan.feasible
    assert plan.violation == words
    assert not predict(problem, actions).survives


def test_other_ids_are_named() -> None:
    problem = line((uav(0, energy_j=12e3),), (Ugv("limo-a"),))
    problem = replace(problem, uavs=(replace(problem.uavs[0], id="cf7"),))
    words = evaluate(problem, [Visit(0, 0), Recharge(0, 0)]).violation
    assert words == "uav 0 (cf7) is 8.0 kJ short on its way to ugv 0 (limo-a)"


def test_energy_may_touch_the_reserve() -> None:
    problem = line((uav(0, reserve_j=60e3),))
    assert evaluate(problem, [Visit(0, 0), Visit(0, 1)]).feasible


def test_uav_that_is_down_at_a_site_needs_no_recovery() -> None:
    empty = uav(0, energy_j=10.0, reserve_j=1e3, position=(4000.0, 0.0))
    assert evaluate(line((empty,), visited=[True, True]), []).feasible
    in_the_air = replace(empty, position=(4100.0, 0.0))
    assert "short of reaching" in (evaluate(line((in_the_air,), visited=[True, True]), []).violation or "")


def test_lost_vehicles_are_left_alone() -> None:
    lost = uav(0, energy_j=0.0, position=(9000.0, 9000.0))
    problem = line((lost, uav(1)), (ugv(0), ugv(1)))
    actions = [Visit(1, 0), Visit(1, 1)]
    assert not evaluate(problem, actions).feasible
    plan = evaluate(problem, actions, exclude_uavs={0}, exclude_ugvs={0})
    assert plan.feasible
    assert [r.uav for r in plan.recovery] == [1]
    assert predict(problem, actions, exclude_uavs=[0]).feasible
    for act, words in (
        (Visit(0, 0), "uav 0 is excluded but visits task 0"),
        (Recharge(0, 1), "uav 0 is excluded but recharges at ugv 1"),
        (Recharge(1, 0), "ugv 0 is excluded but recharges uav 1"),
        (Move(0, 1), "ugv 0 is excluded but moves to path point 1"),
    ):
        assert evaluate(problem, [act], exclude_uavs={0}, exclude_ugvs={0}).violation == words


def test_excluded_ugv_costs_nothing() -> None:
    problem = line(ugvs=(ugv(0, idle_w=10.0),))
    assert evaluate(problem, [Visit(0, 0)], exclude_ugvs={0}).ugv_energy_j == 0.0


@pytest.mark.parametrize(
    ("action", "words"),
    [
        (Visit(1, 0), r"actions\[0\]: uav 1 does not exist; there are 1"),
        (Visit(0, 2), r"task 2 does not exist; there are 2"),
        (Move(0, 2), r"path point 2 does not exist; there are 2"),
        (Move(1, None), r"ugv 1 does not exist"),
        (Recharge(0, 1), r"ugv 1 does not exist"),
        (Recharge(-1, 0), r"uav -1 does not exist"),
        ("visit", r"actions\[0\] is 'visit'; give a Visit, Move or Recharge"),
    ],
)
def test_actions_that_name_nothing_are_bad_input(action, words: str) -> None:
    with pytest.raises(PlannerError, match=words):
        evaluate(line(), [action])
    with pytest.raises(PlannerError, match=words):
        predict(line(), [action])


def test_excluded_indices_must_exist() -> None:
    with pytest.raises(PlannerError, match="excluded uav 3 does not exist; there are 1"):
        evaluate(line(), [], exclude_uavs={3})


def test_problem_too_large_for_the_kernels() -> None:
    with pytest.raises(PlannerError, match="too large"):
        evaluate(line(tasks=[0.0] * 5000), [])


# ---- slack


def test_slack_of_a_ugv_that_waits_for_its_uav() -> None:
    plan = evaluate(line(ugvs=(ugv(0, path_point=1),)), [Move(0, 0), Visit(0, 0), Visit(0, 1), Recharge(0, 0)])
    drive, _, _, recharge = plan.actions
    assert recharge.arrive_s == 400.0 and drive.end_s == 400.0
    plan = evaluate(line(ugvs=(ugv(0, path_point=0),)), [Move(0, 0), Visit(0, 0), Recharge(0, 0), Visit(0, 1)])
    drive, first, recharge, last = plan.actions
    assert (drive.slack_s, drive.total_slack_s) == (200.0, 200.0)
    assert (first.slack_s, first.total_slack_s) == (0.0, 0.0)
    assert (last.slack_s, last.total_slack_s) == (INF, 0.0)


def test_slack_of_a_uav_that_waits_for_its_ugv() -> None:
    plan = evaluate(line(), [Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(0, 1)])
    visit, drive, recharge, _ = plan.actions
    assert (visit.slack_s, visit.total_slack_s) == (0.0, 200.0)
    assert (drive.slack_s, drive.total_slack_s) == (0.0, 0.0)
    assert recharge.total_slack_s == 0.0


def test_slack_is_bounded_by_the_hovering_uavs_energy() -> None:
    other = uav(1, position=(0.0, 0.0), speed_mps=1.0, cruise_w=1.0)
    plan = evaluate(
        line((uav(0, waiting="hover", reserve_j=30e3), other)),
        [Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(1, 1)],
    )
    drive, recharge = plan.actions[1], plan.actions[2]
    assert plan.feasible and plan.makespan_s == 3000.0
    assert recharge.energy_arrive_j == 1e5 - 20e3 - 40e3
    assert drive.total_slack_s == pytest.approx(10e3 / 200.0)
    landed = evaluate(line((uav(0), other)), [Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(1, 1)])
    assert landed.actions[1].total_slack_s == INF  # nothing that counts depends on it


def test_slack_on_a_shared_dock() -> None:
    problem = line((uav(0), uav(1)), (ugv(0, docks=1),))
    plan = evaluate(problem, [Recharge(0, 0), Visit(1, 0), Recharge(1, 0), Visit(1, 1), Visit(0, 0)])
    first = plan.actions[0]
    assert plan.actions[2].work_s == 200.0
    assert (first.slack_s, first.total_slack_s) == (0.0, 140.0)  # uav 0 leaves at once, the dock is wanted at 200 s


def test_slack_of_a_recharge_before_a_move() -> None:
    problem = line((uav(0), uav(1)))
    plan = evaluate(problem, [Recharge(0, 0), Visit(1, 0), Recharge(1, 0), Move(0, 0), Recharge(1, 0), Visit(1, 1)])
    assert plan.actions[3].start_s == 260.0
    assert plan.actions[0].slack_s == plan.actions[0].total_slack_s == 200.0


def test_slack_is_bounded_by_a_ugv_that_stands_on_a_small_battery() -> None:
    problem = line(ugvs=(ugv(0, idle_w=10.0, energy_j=4e3),))
    plan = evaluate(problem, [Visit(0, 0), Visit(0, 1)])
    assert plan.actions[1].slack_s == pytest.approx((4e3 - 3e3) / 10.0)


def test_slack_where_waiting_makes_charging_longer() -> None:
    problem = line((uav(0, waiting="hover"),), (ugv(0, charge_s=None, charge_w=400.0),), visited=[False, True])
    problem = replace(problem, uavs=(*problem.uavs, uav(1, speed_mps=0.5, cruise_w=1.0)))
    plan = evaluate(problem, [Move(0, 0), Recharge(0, 0), Visit(0, 0), Visit(1, 0)])
    assert plan.actions[0].total_slack_s < plan.makespan_s - plan.actions[2].end_s


def test_free_docks_of_other_sizes() -> None:
    problem = line((uav(0), uav(1)), (ugv(0, docks=1), ugv(1, docks=3)))
    plan = evaluate(problem, [Recharge(0, 0), Recharge(1, 0)])
    assert [a.dock for a in plan.actions] == [0, 0]


def test_slack_of_a_hovering_uav_that_is_critical() -> None:
    plan = evaluate(line((uav(0, waiting="hover"),)), [Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(0, 1)])
    assert plan.feasible and plan.actions[2].energy_arrive_j > 0.0
    assert plan.actions[1].total_slack_s == 0.0  # there is energy to wait, but the last visit would be later
