"""The kinematic world: determinism, independence of the loop, energy, lost commands, the audit, what is refused."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from drivers.errors import DriverError
from drivers.vehicle import Arm, Dock, Drive, GoTo, Hold, Land, StopMotors, TakeOff
from sim_backends.errors import SimulationError
from sim_backends.faults import Fault, FaultKind, random_faults
from sim_backends.kinematic import build
from sim_backends.world import SimUav, SimUgv, WorldConfig, line_power_w
from tests.sim_backends.flying import WORLD, Team

NOISY: dict[str, Any] = {
    "gust_mps": 0.5,
    "occlusions_per_s": 0.05,
    "telemetry_drop": 0.1,
    "command_drop": 0.05,
    "seed": 5,
}
TIMETABLE = (
    (1.0, TakeOff("uav0", 20.0, 4.0)),
    (1.0, TakeOff("uav0", 20.0, 4.0)),
    (1.0, Drive("ugv0", ((50.0, 0.0), (150.0, 0.0), (150.0, 100.0)), 4.0)),
    (2.0, TakeOff("uav1", 30.0, 4.0)),
    (2.5, TakeOff("uav1", 30.0, 4.0)),
    (12.0, GoTo("uav0", (300.0, 50.0, 20.0), 10.0)),
    (14.0, GoTo("uav1", (50.0, 60.0, 30.0), 10.0)),
    (20.0, Hold("ugv0")),
    (24.0, Drive("ugv0", ((50.0, 0.0), (150.0, 0.0), (150.0, 100.0)), 4.0)),
    (26.0, GoTo("uav1", (50.5, 60.0, 8.0), 10.0)),
    (40.0, Dock("uav1", "ugv1", 0, 2.0, 12.0)),
    (45.0, Dock("uav1", "ugv1", 0, 2.0, 12.0)),
    (55.0, Hold("uav0")),
    (70.0, TakeOff("uav1", 25.0, 3.0)),
    (75.0, Land("uav0", 3.0)),
)
LOOP_ONLY = {"fed_t"}  # when it was last fed: the loop's doing, without effect as long as it feeds once a second


def fly(look_s: float, *faults: Fault, **changes: Any) -> Team:
    team = Team(*faults, look_s=look_s, **changes)
    for time_s, command in TIMETABLE:
        team.until(time_s)
        team.send(command)
    team.until(100.0)
    return team


def fingerprint(team: Team) -> bytes:
    a = team.backend.world.arrays
    uavs = [a.uavs[n] for n in a.uavs.dtype.names or () if n not in LOOP_ONLY]
    return b"".join(array.tobytes() for array in (*uavs, a.ugvs, a.out, a.hist, a.records))


FAULTED = (
    Fault(FaultKind.POSE_JUMP, "uav0", 15.0, 3.0, 5.0),
    Fault(FaultKind.POSE_DROPOUT, "uav0", 20.0, 5.0),
    Fault(FaultKind.POSE_SWAP, "uav0", 30.0, 3.3, None, "uav1"),
    Fault(FaultKind.POSE_FREEZE, "uav1", 14.0, 1.0),
    Fault(FaultKind.TELEMETRY_LOSS, None, 34.0, 2.0),
    Fault(FaultKind.DOCK_MISSED, "uav1", 0.0),
    Fault(FaultKind.HEAD_WIND, None, 20.0, 20.0, 2.0),
)


@pytest.mark.parametrize("faults", [(), FAULTED], ids=["calm", "faulted"])
@pytest.mark.parametrize("step_s", [0.1, 0.02])
def test_the_world_does_not_depend_on_how_often_the_loop_looks(step_s: float, faults: tuple[Fault, ...]) -> None:
    often, seldom, odd = (fly(look_s, *faults, step_s=step_s, **NOISY) for look_s in (0.02, 1.0, 0.14))
    assert often.truth("uav1").position_m != (0.0, 100.0, 0.0)
    assert fingerprint(often) == fingerprint(seldom) == fingerprint(odd)
    assert often.backend.truth() == seldom.backend.truth()


def test_random_faults_do_not_make_it_depend_on_the_loop_either() -> None:
    for seed in range(6):
        faults = random_faults(seed, 6, 90.0, ["uav0", "uav1"], ["ugv0", "ugv1"])
        assert fingerprint(fly(0.02, *faults, **NOISY)) == fingerprint(fly(1.0, *faults, **NOISY)), f"seed {seed}"


def test_the_seed_decides_everything() -> None:
    changed = {**NOISY, "seed": 6}
    assert fingerprint(fly(0.5, **NOISY)) == fingerprint(fly(0.5, **NOISY))
    assert fingerprint(fly(0.5, **NOISY)) != fingerprint(fly(0.5, **changed))


def test_the_clock_stops_early_only_when_there_is_something_to_see() -> None:
    team = Team()
    clock = team.backend.clock
    assert clock.wait_until(50.0) == 50.0, "nothing happens on the ground"
    team.send(TakeOff("uav0", 20.0, 4.0))
    seen = []
    while clock.now() < 100.0:
        seen.append((clock.wait_until(100.0), team.state("uav0").airborne))
    first, arrived, last = seen
    assert first[0] < 50.5
    assert first[1]
    assert 54.0 < arrived[0] < 60.0
    assert last[0] == 100.0


def test_the_clock_keeps_to_the_loop_s_grid_and_always_goes_on() -> None:
    team = Team()
    for _ in range(200):
        before = team.now_s
        after = team.backend.clock.wait_until(before + 0.02)
        assert after == pytest.approx(before + 0.02)
        assert after * 50 == pytest.approx(round(after * 50))
    assert team.backend.clock.wait_until(team.now_s - 1.0) == team.now_s
    assert team.backend.clock.wait_until(math.nextafter(team.now_s, math.inf)) > 0


def test_an_arrival_is_noticed_when_its_pose_has_been_received() -> None:
    team = Team()
    team.send(TakeOff("uav0", 20.0, 4.0))
    team.wait(10.0)
    team.send(GoTo("uav0", (50.0, 0.0, 20.0), 10.0))
    team.look_s = 100.0
    team.look(100.0)
    assert team.now_s < 30.0
    assert team.truth("uav0").speed_mps == 0.0
    assert math.dist(team.poses["uav0"].position_m, team.truth("uav0").position_m) < 0.1


def test_lost_commands_have_no_effect_and_repeating_helps() -> None:
    team = Team(command_drop=1.0)
    team.wait(5.0)
    assert not any(team.state(v).armed for v in team.backend.vehicles)
    armed = []
    for repeat in (1, 10):
        team = Team(command_drop=0.7, seed=3, ugvs=(), uavs=tuple(SimUav(f"u{i}", f"b{i}") for i in range(20)))
        for _ in range(repeat - 1):
            team.send(*(Arm(v) for v in team.backend.vehicles))
            team.wait(0.5)
        armed.append(sum(team.state(v).armed for v in team.backend.vehicles))
    assert 1 <= armed[0] <= 12
    assert armed[1] >= 18


def test_commands_arrive_after_their_latency() -> None:
    team = Team(command_latency_s=1.0)
    assert not team.state("uav0").armed
    team.until(1.3)
    assert team.state("uav0").armed


def test_charging_fills_up_in_its_constant_time_from_the_ugv_s_battery() -> None:
    uavs = (SimUav("uav0", "cf0", on="ugv0", energy_j=7_700.0),)
    team = Team(uavs=uavs, time_scale=0.1, scale=0.02)
    team.until(29.0)
    assert team.truth("uav0").energy_j < 287_700.0
    team.until(30.2)
    assert team.truth("uav0").energy_j == 287_700.0
    assert team.truth("ugv0").given_j == pytest.approx(280_000.0)
    assert team.truth("ugv0").energy_j == pytest.approx(36_810_000.0 - 280_000.0)
    assert team.state("uav0").charging, "its charger stays connected"


def test_an_empty_ugv_does_not_charge() -> None:
    ugv = replace(WORLD.ugvs[0], energy_j=10_000.0)
    team = Team(uavs=(SimUav("uav0", "cf0", on="ugv0", energy_j=7_700.0),), ugvs=(ugv,))
    team.until(100.0)
    assert team.truth("uav0").energy_j == pytest.approx(17_700.0)
    assert not team.state("uav0").charging


def test_energy_is_the_world_s() -> None:
    """Flying a kilometre's worth of world in a small, slow arena costs what the kilometre costs."""
    used = []
    for scale, time_scale in ((1.0, 1.0), (0.1, 0.5)):
        speed = scale / time_scale
        uav = SimUav(
            "uav0",
            "cf0",
            max_speed_mps=10 * speed,
            accel_mps2=50.0,
            climb_mps=20.0,
            tracking_noise_m=0.0,
            power_w=line_power_w(229.6, 198.6, 10.0),
        )
        team = Team(uavs=(uav,), scale=scale, time_scale=time_scale)
        team.send(TakeOff("uav0", 1.0, 20.0))
        team.wait(1.0)
        before = team.truth("uav0").used_j
        team.send(GoTo("uav0", (1000.0 * scale, 0.0, 1.0), 10 * speed))
        team.wait(100.0 * time_scale)
        used.append(team.truth("uav0").used_j - before)
    assert used[0] == pytest.approx(19_860.0, rel=0.01)
    assert used[1] == pytest.approx(used[0], rel=0.01)


def test_driving_and_standing_cost_energy() -> None:
    ugv = replace(WORLD.ugvs[0], idle_w=100.0, power_w=line_power_w(356.3, 2447.9, 4.5), accel_mps2=50.0)
    team = Team(ugvs=(ugv,))
    used = team.truth("ugv0").used_j
    assert used == pytest.approx(100.0 * team.now_s)
    team.send(Drive("ugv0", ((50.0, 0.0), (500.0, 0.0)), 4.5))
    team.wait(50.0)
    assert team.truth("ugv0").used_j - used == pytest.approx(50 * 2447.9, rel=0.01)


def test_without_poses_the_estimate_drifts_and_comes_back() -> None:
    team = Team()
    team.send(TakeOff("uav0", 20.0, 4.0))
    team.wait(15.0)
    team.feeding = False
    team.wait(1.9)
    assert math.dist(team.truth("uav0").position_m, (0.0, 0.0, 20.0)) < 0.4
    team.wait(19.0)
    assert math.dist(team.truth("uav0").position_m, (0.0, 0.0, 20.0)) > 0.8
    team.feeding = True
    team.wait(10.0)
    assert math.dist(team.truth("uav0").position_m, (0.0, 0.0, 20.0)) < 0.4


def test_an_idle_uav_disarms_itself_where_told() -> None:
    team = Team(auto_disarm_s=3.0)
    team.wait(1.0)
    assert team.state("uav0").armed
    team.wait(4.0)
    assert not team.state("uav0").armed


def test_a_landing_over_a_dock_ends_on_it() -> None:
    team = Team()
    team.send(TakeOff("uav0", 10.0, 4.0))
    team.wait(8.0)
    team.send(GoTo("uav0", (50.0, 0.0, 10.0), 10.0))
    team.wait(15.0)
    team.send(Land("uav0", 2.0))
    team.wait(10.0)
    assert team.truth("uav0").on == "ugv0"


def test_a_docked_uav_travels_along() -> None:
    team = Team(uavs=(SimUav("uav0", "cf0", on="ugv0", dock=1),))
    team.send(Drive("ugv0", ((50.0, 0.0), (50.0, 100.0)), 4.0))
    team.wait(40.0)
    x, y, z = team.truth("uav0").position_m
    gx, gy, _ = team.truth("ugv0").position_m
    assert (x - gx, y - gy, z) == pytest.approx((0.0, 3.0, 0.5), abs=1e-6)
    assert gy == pytest.approx(100.0, abs=0.3)


# --- the audit


def test_the_audit_of_a_harmless_flight_is_clean() -> None:
    team = fly(1.0)
    truth = team.backend.truth()
    assert truth.violations == ()
    assert truth.min_uav_distance_m > 3.0
    assert truth.min_ugv_distance_m > 2.0


def test_the_audit_sees_two_uavs_collide() -> None:
    team = Team()
    team.send(TakeOff("uav0", 20.0, 4.0), TakeOff("uav1", 20.0, 4.0))
    team.wait(10.0)
    team.send(GoTo("uav0", (0.0, 50.0, 20.0), 5.0), GoTo("uav1", (0.0, 50.0, 20.0), 5.0))
    team.wait(40.0)
    truth = team.backend.truth()
    assert truth.min_separation_m < 0.5
    assert [v.kind for v in truth.violations] == ["separation", "collision", "crash", "crash"]
    separation = truth.violations[0]
    assert separation.vehicles == ("uav0", "uav1")
    assert 10.0 < separation.time_s < separation.end_s < 51.0
    assert separation.value == truth.min_separation_m
    assert not any(v.scripted for v in truth.violations)
    assert {truth.vehicles[v].phase for v in ("uav0", "uav1")} == {"crashed"}
    assert team.state("uav0").tumbled


def test_the_audit_knows_the_cylinder() -> None:
    """5 m above one another is outside of a cylinder of half height 4 m, 3 m is inside."""
    kinds = []
    for height in (25.0, 23.0):
        team = Team()
        team.send(TakeOff("uav0", 20.0, 4.0), TakeOff("uav1", height, 4.0))
        team.wait(10.0)
        team.send(GoTo("uav1", (0.0, -100.0, height), 10.0))
        team.wait(40.0)
        kinds.append(team.kinds())
    assert kinds == [[], ["separation"]]


def test_the_audit_sees_fence_ceiling_and_ugvs() -> None:
    team = Team()
    team.send(TakeOff("uav0", 20.0, 4.0), TakeOff("uav1", 70.0, 5.0))
    team.send(Drive("ugv0", ((50.0, 0.0), (50.0, 59.0)), 4.0))
    team.wait(30.0)
    team.send(GoTo("uav0", (-510.0, 0.0, 20.0), 15.0))
    team.wait(60.0)
    truth = team.backend.truth()
    assert {v.kind for v in truth.violations} == {"fence", "ceiling", "ugv_separation"}
    assert {v.vehicles for v in truth.violations} == {("uav0",), ("uav1",), ("ugv0", "ugv1")}
    (ceiling,) = (v for v in truth.violations if v.kind == "ceiling")
    assert ceiling.value == pytest.approx(70.0, abs=0.5)
    assert truth.min_ugv_distance_m == pytest.approx(1.0, abs=0.3)


def test_the_audit_sees_an_empty_battery_and_an_emergency_stop() -> None:
    uavs = (SimUav("uav0", "cf0", energy_j=2_000.0), WORLD.uavs[1])
    team = Team(uavs=uavs)
    team.send(TakeOff("uav0", 20.0, 4.0), TakeOff("uav1", 20.0, 4.0))
    team.wait(15.0)
    team.send(StopMotors("uav1"))
    team.wait(5.0)
    violations = team.backend.truth().violations
    assert [(v.kind, v.vehicles, v.cause) for v in violations] == [
        ("empty_in_air", ("uav0",), "battery empty"),
        ("crash", ("uav0",), "battery empty"),
        ("crash", ("uav1",), "motors stopped"),
    ]
    assert team.state("uav0").fault == "battery empty"


# --- what is refused


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"step_s": 0.03}, "multiple of 0.02"),
        ({"uavs": (), "ugvs": ()}, "no vehicles"),
        ({"uavs": (SimUav("a", "x"), SimUav("a", "y"))}, "id a is given more than once"),
        ({"uavs": (SimUav("a", "x"), SimUav("b", "x"))}, "body x is given more than once"),
        ({"uavs": (SimUav("a", "x", on="ugv0", dock=5),)}, "does not exist"),
        ({"uavs": (SimUav("a", "x", on="ugv0"), SimUav("b", "y", on="ugv0"))}, "taken by another"),
        ({"telemetry_drop": 1.5}, "at most 1"),
        ({"pose_rate_hz": 0.0}, "above 0"),
        ({"pose_noise_m": -1.0}, "at least 0"),
        ({"seed": -1}, "seed is -1"),
        ({"fence_m": ((0.0, 0.0), (1.0, 0.0))}, "at least 3"),
    ],
)
def test_a_wrong_world_says_what_is_wrong(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SimulationError, match=words):
        replace(WORLD, **changes)


def test_a_wrong_vehicle_says_what_is_wrong() -> None:
    with pytest.raises(SimulationError, match=r"'u'.*max_speed_mps"):
        SimUav("u", "b", max_speed_mps=0.0)
    with pytest.raises(SimulationError, match=r"'u'.*energy_j"):
        SimUav("u", "b", energy_j=1e9)
    with pytest.raises(SimulationError, match=r"'g'.*either charge_s or charge_w"):
        SimUgv("g", "b", charge_w=100.0)
    with pytest.raises(SimulationError, match=r"'g'.*power_w"):
        SimUgv("g", "b", power_w=())


def test_nothing_is_sent_or_read_unconnected() -> None:
    backend = build(WORLD)
    with pytest.raises(DriverError, match=r"uav0.*connect"):
        backend.vehicles["uav0"].send(Arm("uav0"))
    with pytest.raises(DriverError, match="connect"):
        backend.poses.read()
    with pytest.raises(DriverError, match="no dock 7"):
        Team().send(Dock("uav0", "ugv0", 7, 1.0, 10.0))


def test_forty_vehicles_fit() -> None:
    config = WorldConfig(
        uavs=tuple(SimUav(f"u{i}", f"bu{i}", (20.0 * i, 0.0)) for i in range(30)),
        ugvs=tuple(SimUgv(f"g{i}", f"bg{i}", (20.0 * i, 50.0)) for i in range(10)),
    )
    backend = build(config)
    assert backend.clock.wait_until(0.1) == 0.1
    assert len(backend.truth().vehicles) == 40
