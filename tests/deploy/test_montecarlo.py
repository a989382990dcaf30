"""The Monte Carlo against the scheduler, against closed forms, and against itself."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.check_limits import CERTAIN, Uncertainty
from deploy.montecarlo import MonteCarloError, Overheads, Share, estimate, ordinal, simulate
from planner.plan import Action, Move, Recharge, Visit
from planner.problem import Problem, Uav, Ugv
from planner.schedule import evaluate


def line_problem(**uav: object) -> Problem:
    """One UAV, one UGV, tasks at 2, 4 and 6 km on a line, path points at 3 and 6 km; cruise costs 20 J/m."""
    values: dict[str, object] = {
        "speed_mps": 10.0,
        "cruise_w": 200.0,
        "hover_w": 230.0,
        "energy_j": 120e3,
        "capacity_j": 120e3,
    }
    values |= uav
    return Problem(
        depot=(0.0, 0.0),
        tasks=np.array([[2000.0, 0.0], [4000.0, 0.0], [6000.0, 0.0]]),
        path_points=np.array([[3000.0, 0.0], [6000.0, 0.0]]),
        road_distance_m=np.array([[0.0, 3000.0, 3000.0], [3000.0, 0.0, 6000.0], [3000.0, 6000.0, 0.0]]),
        uavs=(Uav(id="uav0", position=(0.0, 0.0), **values),),  # type: ignore[arg-type]
        ugvs=(Ugv(id="ugv0"),),
    )


LINE: tuple[Action, ...] = (Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(0, 1), Visit(0, 2))


def random_case(seed: int) -> tuple[Problem, list[Action]]:
    """A random team with random actions: feasible or not, the arithmetic must agree."""
    rng = np.random.default_rng(seed)
    n_uavs, n_ugvs, n_points, n_tasks = (int(rng.integers(1, 4)) for _ in range(4))
    sites = rng.uniform(0, 5000, (n_points + 1, 2))
    roads = 1.3 * np.linalg.norm(sites[:, None] - sites[None], axis=2)
    uavs = tuple(
        Uav(
            id=f"uav{u}",
            position=(float(sites[-1, 0]), float(sites[-1, 1])) if rng.random() < 0.7 else (100.0, 200.0),
            energy_j=float(rng.uniform(1e5, 2.8e5)),
            reserve_j=float(rng.uniform(0, 4e4)),
            waiting="hover" if rng.random() < 0.5 else "landed",
            service_s=float(rng.uniform(0, 30)),
            ready_s=float(rng.uniform(0, 100)),
        )
        for u in range(n_uavs)
    )
    ugvs = tuple(
        Ugv(
            id=f"ugv{g}",
            energy_j=float(rng.uniform(1e6, 2e7)),
            idle_w=float(rng.uniform(0, 100)),
            docks=int(rng.integers(1, 3)),
            dock_s=10.0,
            undock_s=5.0,
            ready_s=float(rng.uniform(0, 300)),
            dock_ready_s=(50.0,),
            **({"charge_s": None, "charge_w": 500.0} if rng.random() < 0.5 else {}),  # type: ignore[arg-type]
        )
        for g in range(n_ugvs)
    )
    actions: list[Action] = [Visit(int(rng.integers(n_uavs)), m) for m in range(n_tasks)]
    for _ in range(int(rng.integers(2, 9))):
        g = int(rng.integers(n_ugvs))
        if rng.random() < 0.5:
            actions.append(Move(g, int(rng.integers(n_points)) if rng.random() < 0.8 else None))
        else:
            actions.append(Recharge(int(rng.integers(n_uavs)), g))
    order = rng.permutation(len(actions))
    problem = Problem(
        depot=(float(sites[-1, 0]), float(sites[-1, 1])),
        tasks=rng.uniform(0, 5000, (n_tasks, 2)),
        path_points=sites[:-1],
        road_distance_m=(roads + roads.T) / 2,
        uavs=uavs,
        ugvs=ugvs,
    )
    return problem, [actions[i] for i in order]


@pytest.mark.parametrize("seed", range(60))
def test_without_uncertainty_it_is_the_schedule(seed: int) -> None:
    problem, actions = random_case(seed)
    schedule = evaluate(problem, actions)
    drawn = simulate(problem, actions, CERTAIN, samples=3, seed=seed)
    for row in schedule.actions:
        assert drawn.end_s[:, row.action] == pytest.approx(row.end_s, rel=1e-12)
        assert drawn.low_j[:, row.action] == pytest.approx(row.energy_arrive_j, rel=1e-9)
    assert drawn.makespan_s == pytest.approx(schedule.makespan_s, rel=1e-12)
    for r in schedule.recovery:
        assert drawn.land_j[:, r.uav] == pytest.approx(r.energy_end_j, rel=1e-9)
    assert bool((drawn.fail_reserve < 0).all()) == (schedule.violation is None)


def test_line_in_closed_form() -> None:
    found = estimate(line_problem(), LINE, CERTAIN, samples=100)
    # 2 km, 1 km back... at 10 m/s; the UGV needs 3000 / 4.5 s and the UAV waits, landed, for it
    assert found.makespan_s.p50 == pytest.approx(3000 / 4.5 + 300 + 300)
    assert found.success.estimate == 1.0
    docking, landing = found.margins
    assert docking.where == "uav0 at its 1st rendezvous (ugv0)"
    assert docking.spread_j.p50 == pytest.approx(120e3 - 300 * 200)
    assert landing.where == "uav0 at its landing after its last action"
    assert landing.spread_j.p50 == pytest.approx(120e3 - 300 * 200)


def test_certain_plan_succeeds_or_fails_for_sure() -> None:
    short = line_problem(energy_j=59e3)
    found = estimate(short, LINE, CERTAIN, samples=100)
    assert found.success.estimate == 0.0
    assert found.cause == "uav0 at its 1st rendezvous (ugv0), 100 %"
    low = line_problem(energy_j=70e3, reserve_j=20e3)
    found = estimate(low, LINE, CERTAIN, samples=100)
    assert (found.success.estimate, found.success_reserve.estimate) == (1.0, 0.0)
    assert found.causes == ()
    assert found.cause == "uav0 at its 1st rendezvous (ugv0), 100 %"


def test_makespan_limit() -> None:
    planned = 3000 / 4.5 + 600
    on_time = estimate(line_problem(), LINE, CERTAIN, samples=100, makespan_limit_s=planned + 1)
    late = estimate(line_problem(), LINE, CERTAIN, samples=100, makespan_limit_s=planned - 1)
    assert (on_time.success.estimate, late.success.estimate) == (1.0, 0.0)
    assert late.cause == "the makespan limit is missed, 100 %"


def test_unvisited_task_is_no_success() -> None:
    found = estimate(line_problem(), LINE[:-1], CERTAIN, samples=100)
    assert found.success.estimate == 0.0
    assert found.cause == "nobody visits task 2, 100 %"


def test_ugv_that_runs_empty_is_named() -> None:
    problem = line_problem()
    problem = replace(problem, ugvs=(replace(problem.ugvs[0], energy_j=1e6),))
    assert estimate(problem, LINE, CERTAIN, samples=100).cause == "ugv0 on its way to path point 0, 100 %"
    problem = replace(problem, ugvs=(replace(problem.ugvs[0], energy_j=1.66e6),))  # drives on 1.632 MJ
    assert estimate(problem, LINE, CERTAIN, samples=100).cause == "ugv0 runs out of energy itself, 100 %"


def test_more_uncertainty_never_helps() -> None:
    problem = line_problem(energy_j=70e3, waiting="hover")
    problem = replace(problem, ugvs=(replace(problem.ugvs[0], ready_s=-0.0, speed_mps=10.0),))
    probability = []
    for scale in (0.0, 0.5, 1.0, 2.0, 4.0):
        base = Uncertainty()
        scaled = Uncertainty(
            uav_speed=base.uav_speed * scale,
            ugv_speed=base.ugv_speed * scale,
            move_speed=base.move_speed * scale,
            wind=base.wind * scale,
            gust=base.gust * scale,
            wind_power=base.wind_power,
            drain=base.drain * scale,
            ugv_drain=base.ugv_drain * scale,
            charge=base.charge * scale,
            departure_s=base.departure_s * scale,
            docking_s=base.docking_s * scale,
            stalls_per_h=base.stalls_per_h * scale,
        )
        probability.append(estimate(problem, LINE, scaled, samples=2000, seed=1).success.estimate)
    assert probability[0] == 1.0
    assert probability == sorted(probability, reverse=True)
    assert probability[-1] < 0.9


def test_same_seed_same_samples_other_seed_others() -> None:
    a = simulate(line_problem(), LINE, Uncertainty(), samples=200, seed=5)
    b = simulate(line_problem(), LINE, Uncertainty(), samples=200, seed=5)
    c = simulate(line_problem(), LINE, Uncertainty(), samples=200, seed=6)
    assert np.array_equal(a.end_s, b.end_s)
    assert np.array_equal(a.land_j, b.land_j)
    assert not np.array_equal(a.end_s, c.end_s)


def test_speed_spread_is_the_one_asked_for() -> None:
    plan: tuple[Action, ...] = (Visit(0, 2),)
    drawn = simulate(line_problem(), plan, replace(CERTAIN, uav_speed=0.05), samples=20_000, seed=2)
    speed = 6000 / drawn.makespan_s
    assert speed.mean() == pytest.approx(10.0, rel=0.002)
    assert speed.std() == pytest.approx(0.5, rel=0.03)


def test_head_wind_slows_and_costs_energy_by_time_and_power() -> None:
    plan: tuple[Action, ...] = (Visit(0, 2),)
    wind = replace(CERTAIN, wind=0.1, wind_power=0.5)
    drawn = simulate(line_problem(), plan, wind, samples=5000, seed=3)
    head = 1 - 6000 / drawn.makespan_s / 10  # share of cruise speed
    assert head.std() == pytest.approx(0.1, rel=0.05)
    used = 120e3 - drawn.low_j[:, 0]
    assert used == pytest.approx(200 * drawn.makespan_s * (1 + 0.5 * np.maximum(head, 0)), rel=1e-9)


def test_steady_wind_reverses_with_the_direction_of_flight() -> None:
    plan: tuple[Action, ...] = (Visit(0, 2), Visit(0, 0))
    drawn = simulate(line_problem(), plan, replace(CERTAIN, wind=0.1), samples=500, seed=3)
    out = 1 - 600 / drawn.end_s[:, 0]
    back = 1 - 400 / (drawn.end_s[:, 1] - drawn.end_s[:, 0])
    assert out == pytest.approx(-back, abs=1e-9)


def test_delays_are_lognormal_and_docking_costs_hovering() -> None:
    problem = line_problem(waiting="landed")
    plan: tuple[Action, ...] = (Visit(0, 0), Move(0, 0), Recharge(0, 0))
    drawn = simulate(problem, plan, replace(CERTAIN, docking_s=20.0, delay_sigma=0.8), samples=20_000, seed=4)
    delay = drawn.end_s[:, 2] - (3000 / 4.5 + 300)
    assert np.median(delay) == pytest.approx(20, rel=0.03)
    assert np.quantile(delay, 0.9) == pytest.approx(20 * math.exp(0.8 * 1.2816), rel=0.05)
    assert drawn.low_j[:, 2] == pytest.approx(120e3 - 300 * 200 - 230 * delay, rel=1e-9)


def test_stalls_come_at_their_rate() -> None:
    plan: tuple[Action, ...] = (Move(0, 0),)
    stalls = replace(CERTAIN, stalls_per_h=1.0, stall_s=100.0, stall_sigma=0.0)
    drawn = simulate(line_problem(), plan, stalls, samples=20_000, seed=5)
    drive = 3000 / 4.5
    stalled = drawn.end_s[:, 0] > drive + 1
    assert stalled.mean() == pytest.approx(1 - math.exp(-drive / 3600), abs=0.01)
    assert drawn.end_s[stalled, 0] == pytest.approx(drive + 100)


def test_charging_times_vary() -> None:
    plan: tuple[Action, ...] = (Recharge(0, 0),)
    drawn = simulate(line_problem(), plan, replace(CERTAIN, charge=0.1), samples=20_000, seed=6)
    assert drawn.end_s[:, 0].mean() == pytest.approx(300, rel=0.005)
    assert drawn.end_s[:, 0].std() == pytest.approx(30, rel=0.03)


def test_overheads_add_time_and_hover_energy() -> None:
    over = Overheads(leg_s=(5.0,), down_s=(8.0,), up_s=(10.0,), drive_s=(3.0,))
    plan: tuple[Action, ...] = (Visit(0, 0), Move(0, 0), Recharge(0, 0), Visit(0, 1))
    drawn = simulate(line_problem(), plan, CERTAIN, samples=100, overheads=over)
    assert drawn.end_s[0, 0] == pytest.approx(200 + 5)
    assert drawn.low_j[0, 0] == pytest.approx(120e3 - 200 * 205)
    docked = 3000 / 4.5 + 3
    assert drawn.low_j[0, 2] == pytest.approx(120e3 - 200 * 305 - 230 * 8)
    assert drawn.end_s[0, 3] == pytest.approx(docked + 300 + 105)
    # full, climbed, flown, then home to path point 0, 1 km back, and down
    assert drawn.land_j[0, 0] == pytest.approx(120e3 - 230 * 10 - 200 * 105 - 200 * 100 - 230 * 8)


def test_a_uav_that_leaves_late_keeps_its_dock_and_its_ugv() -> None:
    plan: tuple[Action, ...] = (Recharge(0, 0), Move(0, 0))
    drawn = simulate(line_problem(), plan, replace(CERTAIN, departure_s=30.0, delay_sigma=0.0), samples=10)
    # 30 s before flying, 300 s of charging, 30 s before leaving, then 30 s before the UGV drives
    assert drawn.end_s[0] == pytest.approx([360.0, 390.0 + 3000 / 4.5])


def test_impossible_plans_are_errors() -> None:
    problem = line_problem()
    roads = problem.road_distance_m.copy()
    roads[0, 2] = roads[2, 0] = np.inf
    with pytest.raises(MonteCarloError, match=r"actions\[0\]: no road leads ugv0 to path point 0"):
        estimate(replace(problem, road_distance_m=roads), (Move(0, 0),), CERTAIN)
    between = replace(problem, ugvs=(replace(problem.ugvs[0], distance_to_m=(1.0, 2.0, 3.0)),))
    with pytest.raises(MonteCarloError, match="ugv0 is between path points and must move first"):
        estimate(between, (Recharge(0, 0),), CERTAIN)


def test_wilson_interval() -> None:
    # Wilson 1927, as tabulated by Newcombe 1998, Table I: 81/263 and 0/20
    low, high = Share(81, 263).interval
    assert (low, high) == (pytest.approx(0.2553, abs=5e-5), pytest.approx(0.3662, abs=5e-5))
    low, high = Share(0, 20).interval
    assert (low, high) == (0.0, pytest.approx(0.1611, abs=5e-5))
    assert Share(20, 20).interval[1] == 1.0


def test_ordinals() -> None:
    assert [ordinal(i) for i in (1, 2, 3, 4, 11, 12, 21, 22, 113)] == [
        "1st", "2nd", "3rd", "4th", "11th", "12th", "21st", "22nd", "113th",
    ]  # fmt: skip
