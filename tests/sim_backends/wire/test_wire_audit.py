"""The audit of the shared world, and bodies that nobody moves any more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import pytest

from drivers.vehicle import Vec3
from sim_backends.truth import Violation
from sim_backends.wire.audit import ROOM, Audit
from sim_backends.wire.orphans import DEAD_S, LOOKS, Orphans
from sim_backends.wire.world import BATTERY_EMPTY, MOTOR_FAILURE, Body
from sim_backends.world import SimUav, SimUgv, WorldConfig

CONFIG = WorldConfig(
    uavs=(SimUav("u0", "a"), SimUav("u1", "b")),
    ugvs=(SimUgv("g0", "c"), SimUgv("g1", "d")),
    collision_m=0.1,
    separation_h_m=0.3,
    separation_v_m=0.5,
    separation_ugv_m=0.4,
    fence_m=((-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)),
    ceiling_m=2.0,
)


def up(*at: float) -> Body:
    return Body(position_m=(at[0], at[1], at[2]), airborne=True, armed=True, energy_j=100.0)


def at_rest(*at: float) -> Body:
    return Body(position_m=(at[0], at[1], 0.0), energy_j=100.0)


CALM = (up(-1, 0, 1), up(1, 0, 1), at_rest(-1, -1), at_rest(1, -1))


def audited(*looks: Sequence[Body], hit: Sequence[bool] = (False,) * 4) -> tuple[Violation, ...]:
    audit = Audit(CONFIG)
    for k, bodies in enumerate(looks):
        audit.look(float(k), bodies, hit)
    return audit.truth(float(len(looks))).violations


def with_(row: int, body: Body) -> list[Body]:
    return [body if r == row else b for r, b in enumerate(CALM)]


def test_a_calm_world_breaks_no_rule() -> None:
    assert audited(CALM, CALM) == ()


@pytest.mark.parametrize(
    ("bodies", "kind", "vehicles", "value"),
    [
        (with_(0, up(0.8, 0, 1)), "separation", ("u0", "u1"), 0.2),
        (with_(0, up(0.8, 0, 1.4)), "separation", ("u0", "u1"), 0.2),
        (with_(2, at_rest(0.7, -1)), "ugv_separation", ("g0", "g1"), 0.3),
        (with_(0, up(3, 0, 1)), "fence", ("u0",), 0.0),
        (with_(2, at_rest(0, -3)), "fence", ("g0",), 0.0),
        (with_(1, up(1, 0, 2.5)), "ceiling", ("u1",), 2.5),
    ],
)
def test_each_rule(bodies: list[Body], kind: str, vehicles: tuple[str, ...], value: float) -> None:
    (found,) = audited(CALM, bodies, CALM)
    assert (found.kind, found.vehicles) == (kind, vehicles)
    assert found.value == pytest.approx(value)
    assert (found.time_s, found.end_s, found.scripted) == (1.0, 1.0, False)


def test_nobody_is_too_near_above_the_cylinder_or_on_the_ground() -> None:
    assert audited(with_(0, up(0.8, 0, 1.6))) == ()
    assert audited(with_(0, at_rest(0.95, 0))) == ()
    assert audited(with_(0, at_rest(9.0, 0))) == (), "a UAV on the ground is nobody's fence violation"


def test_one_violation_lasts_from_begin_to_end_with_its_worst_value() -> None:
    near, nearer = with_(0, up(0.75, 0, 1)), with_(0, up(0.8, 0, 1))
    first, second = audited(near, nearer, near, CALM, near)
    assert (first.time_s, first.end_s) == (0.0, 2.0)
    assert first.value == pytest.approx(0.2)
    assert second.time_s == 4.0


def test_the_highest_altitude_is_a_ceiling_violations_value() -> None:
    (found,) = audited(with_(0, up(-1, 0, 2.1)), with_(0, up(-1, 0, 2.6)), with_(0, up(-1, 0, 2.2)))
    assert found.value == 2.6


def test_who_touches_falls_and_is_told_once() -> None:
    audit = Audit(CONFIG)
    touching = with_(0, up(0.95, 0, 1.02))
    assert audit.look(0.0, touching, [False] * 4) == {0, 1}
    assert audit.look(0.1, touching, [False] * 4) == set()
    assert [v.kind for v in audit.truth(0.1).violations].count("collision") == 1


def test_an_empty_battery_in_the_air_and_the_crash_that_follows() -> None:
    empty = replace(CALM[0], energy_j=0.0, code=BATTERY_EMPTY)
    down = replace(empty, position_m=(-1.0, 0.0, 0.0), airborne=False, tumbled=True)
    first, second = audited(CALM, with_(0, empty), with_(0, down), with_(0, down))
    assert (first.kind, first.cause, first.value) == ("empty_in_air", "battery empty", 1.0)
    assert (second.kind, second.cause, second.scripted) == ("crash", "battery empty", False)


def test_what_a_scripted_fault_has_done_is_marked() -> None:
    fallen = replace(at_rest(-1, 0), tumbled=True, code=MOTOR_FAILURE)
    (found,) = audited(CALM, with_(0, fallen), hit=(True, False, False, False))
    assert (found.kind, found.scripted) == ("crash", True)


def test_least_distances_and_final_states() -> None:
    audit = Audit(CONFIG)
    audit.look(0.0, with_(0, up(0.0, 0, 1)), [False] * 4)
    audit.look(1.0, [replace(CALM[0], on=3, airborne=False), *CALM[1:]], [False] * 4)
    truth = audit.truth(1.0)
    assert (truth.min_separation_m, truth.min_uav_distance_m, truth.min_ugv_distance_m) == (1.0, 1.0, 2.0)
    assert (truth.vehicles["u0"].on, truth.vehicles["u0"].phase, truth.vehicles["u1"].phase) == ("g1", "pad", "fly")
    assert truth.vehicles["g0"].phase == "stand"


def test_more_violations_than_there_is_room_for_are_counted() -> None:
    audit = Audit(CONFIG)
    for k in range(2 * ROOM + 20):
        audit.look(float(k), CALM if k % 2 else with_(0, up(3, 0, 1)), [False] * 4)
    assert len(audit.truth(0.0).violations) == ROOM
    assert audit.dropped == 10


# --- orphans ------------------------------------------------------------------------------------------------------


def watched(orphans: Orphans, body: Body, looks: int, from_s: float) -> bool:
    return [orphans.look(from_s + 0.05 * (k + 1), 0, body) for k in range(looks)][-1]


def test_who_writes_is_nobodys_orphan() -> None:
    orphans = Orphans(1, 2)
    assert not any(orphans.look(0.02 * k, 0, Body(time_s=0.02 * k, airborne=True)) for k in range(1, 100))


def test_who_has_not_begun_is_nobodys_orphan() -> None:
    assert not watched(Orphans(1, 2), Body(time_s=0.0, airborne=True), 100, 0.0)


def test_a_silent_row_is_taken_over_and_given_back() -> None:
    orphans = Orphans(1, 2)
    assert watched(orphans, Body(time_s=1.0), 2 * LOOKS, 1.0)
    assert orphans.taken == {0}
    orphans.wrote(0, Body(time_s=2.0))
    assert orphans.look(2.02, 0, Body(time_s=2.0)), "what the conductor wrote is no sign of life"
    assert not orphans.look(2.5, 0, Body(time_s=2.4)), "somebody else writes again"
    assert orphans.taken == set()


def test_a_machine_that_stood_still_has_killed_nobody() -> None:
    orphans = Orphans(1, 2)
    orphans.look(1.0, 0, Body(time_s=1.0))
    assert not orphans.look(1.0 + 10 * DEAD_S, 0, Body(time_s=1.0))


def fall(body: Body, seconds: float, pad_m: Vec3 | None = None) -> Body:
    orphans = Orphans(1, 2)
    for _ in range(round(seconds / 0.02)):
        body = orphans.moved(0, body, 0.02, pad_m)
    return body


def test_what_flies_falls_and_has_crashed() -> None:
    body = replace(up(0, 0, 1.5), velocity_mps=(1.0, 0.0, 0.0))
    halfway = fall(body, 0.3)
    assert 0.5 < halfway.position_m[2] < 1.2
    assert halfway.airborne
    down = fall(body, 1.0)
    assert (down.position_m[2], down.airborne, down.tumbled, down.locked) == (0.0, False, True, True)
    assert 0.2 < down.position_m[0] < 1.0
    assert math.hypot(*down.velocity_mps) == 0.0


def test_what_stands_stays_and_what_stands_on_a_dock_rides_along() -> None:
    assert fall(at_rest(1, 1), 1.0).position_m == (1.0, 1.0, 0.0)
    assert not fall(at_rest(1, 1), 1.0).tumbled
    assert fall(replace(at_rest(0, 0), on=1), 1.0, (3.0, 1.0, 0.3)).position_m == (3.0, 1.0, 0.3)


def test_what_drives_stops() -> None:
    stopped = Orphans(1, 2).moved(1, Body(velocity_mps=(0.2, 0.0, 0.0), armed=True), 0.02, None)
    assert (stopped.velocity_mps, stopped.armed, stopped.locked) == ((0.0, 0.0, 0.0), False, True)
