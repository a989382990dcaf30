"""The failsafe table: complete, overridden in the right order, fixed where it must be, and printed in the manual."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy import failsafe
from deploy.events import Action, EventKind, Severity
from deploy.failsafe import FIXED, TABLE, UAV_SITUATION, UGV_SITUATION, Situation, action_for, override_problem
from deploy.failsafe_manual import WORDS, page
from deploy.state import AIRBORNE, UavPhase, UgvPhase

MANUAL = Path(__file__).resolve().parents[2] / "docs" / "failsafe.md"
G, A, D, L = Situation.GROUND, Situation.AIR, Situation.DOCKING, Situation.LANDING
R, P, X, M = Situation.DRIVING, Situation.PARKED, Situation.GONE, Situation.MISSION

# What must happen, written a second time by hand; everything that is not here is only written down.
EXPECTED: dict[EventKind, dict[Situation, Action]] = {
    EventKind.POSE_STALE: {A: Action.HOLD, D: Action.HOLD, R: Action.HOLD},
    EventKind.POSE_LOST: {A: Action.LAND_HERE, D: Action.LAND_HERE, R: Action.HOLD},
    EventKind.POSE_FROZEN: {A: Action.HOLD, D: Action.HOLD, R: Action.HOLD},
    EventKind.POSE_JUMP: {A: Action.HOLD, D: Action.HOLD, R: Action.HOLD},
    EventKind.POSE_SWAP: {A: Action.HOLD, D: Action.HOLD, R: Action.HOLD, G: Action.WARN, P: Action.WARN},
    EventKind.TELEMETRY_STALE: {A: Action.HOLD, D: Action.WARN, L: Action.WARN, R: Action.HOLD},
    EventKind.LINK_LOST: {
        G: Action.REPLAN_WITHOUT,
        A: Action.LAND_HERE,
        D: Action.LAND_HERE,
        L: Action.WARN,
        R: Action.REPLAN_WITHOUT,
        P: Action.REPLAN_WITHOUT,
    },
    EventKind.TRACKING_ERROR: {A: Action.HOLD, D: Action.HOLD},
    EventKind.GEOFENCE_SOFT: {A: Action.WARN, D: Action.WARN, R: Action.WARN},
    EventKind.GEOFENCE_HARD: {A: Action.LAND_HERE, D: Action.LAND_HERE, R: Action.REPLAN_WITHOUT},
    EventKind.SEPARATION: {A: Action.HOLD, R: Action.HOLD},
    EventKind.TUMBLED: dict.fromkeys((G, A, D, L, R, P), Action.STOP_MOTORS),
    EventKind.UGV_OFF_ROAD: {R: Action.REPLAN_WITHOUT},
    EventKind.UGV_STUCK: {R: Action.REPLAN_WITHOUT},
    EventKind.COMMAND_FAILED: {
        G: Action.REPLAN_WITHOUT,
        A: Action.LAND_HERE,
        D: Action.DIVERT,
        L: Action.WARN,
        R: Action.REPLAN_WITHOUT,
        P: Action.REPLAN_WITHOUT,
    },
    EventKind.ENERGY_NO_RETURN: {A: Action.DIVERT},
    EventKind.ENERGY_RENDEZVOUS: {M: Action.REPLAN},
    EventKind.DOCK_MISSED: {D: Action.HOLD, A: Action.DIVERT},
    EventKind.CHARGE_UNCONFIRMED: {G: Action.HOLD},
    EventKind.SCHEDULE_DRIFT: {M: Action.REPLAN},
    EventKind.PLANNER_LATE: {M: Action.WARN},
    EventKind.PLANNER_INFEASIBLE: {M: Action.TEAM_RECOVERY},
    EventKind.GROUND_OVERLOADED: {M: Action.WARN},
    EventKind.OPERATOR_HOLD: {M: Action.HOLD},
    EventKind.OPERATOR_RECOVER: {M: Action.TEAM_RECOVERY},
    EventKind.OPERATOR_STOP: {M: Action.STOP_MOTORS},
}


def test_every_event_has_a_row_and_a_reason() -> None:
    assert set(TABLE) == set(EventKind)
    assert all(row.why for row in TABLE.values())


@pytest.mark.parametrize("situation", Situation)
@pytest.mark.parametrize("kind", EventKind)
def test_the_action_of_every_event_in_every_situation(kind: EventKind, situation: Situation) -> None:
    assert action_for(kind, situation) is EXPECTED.get(kind, {}).get(situation, Action.NOTE)


@pytest.mark.parametrize("situation", Situation)
@pytest.mark.parametrize("kind", EventKind)
def test_overrides_situation_before_event_before_table(kind: EventKind, situation: Situation) -> None:
    other = next(s for s in Situation if s is not situation)
    row = action_for(kind, situation)
    both = {f"{kind}/{situation}": "warn", kind.value: "divert"}
    if kind in FIXED:
        assert action_for(kind, situation, both) is row
        return
    assert action_for(kind, situation, both) is Action.WARN
    assert action_for(kind, other, both) is Action.DIVERT
    assert action_for(kind, situation, {kind.value: "divert"}) is Action.DIVERT
    assert action_for(kind, situation, {f"{kind}/{other}": "divert"}) is row
    assert action_for(kind, situation, {}) is row


def test_what_stops_people_from_being_hurt_cannot_be_changed() -> None:
    assert {EventKind.OPERATOR_STOP, EventKind.OPERATOR_RECOVER, EventKind.TUMBLED} == FIXED
    assert action_for(EventKind.TUMBLED, A, {"tumbled/air": "note", "tumbled": "note"}) is Action.STOP_MOTORS
    assert action_for(EventKind.OPERATOR_STOP, M, {"operator_stop": "note"}) is Action.STOP_MOTORS
    assert action_for(EventKind.OPERATOR_RECOVER, M, {"operator_recover": "note"}) is Action.TEAM_RECOVERY


def test_motors_stop_in_the_air_only_for_what_cannot_fly_any_more() -> None:
    stopping = {k for k, row in TABLE.items() if Action.STOP_MOTORS in row.actions.values()}
    assert stopping == {EventKind.TUMBLED, EventKind.OPERATOR_STOP}


def test_a_lost_vehicle_is_only_watched() -> None:
    assert all(Situation.GONE not in row.actions for row in TABLE.values())


def test_every_phase_has_its_situation() -> None:
    assert set(UAV_SITUATION) == set(UavPhase)
    assert set(UGV_SITUATION) == set(UgvPhase)
    assert {p for p, s in UAV_SITUATION.items() if s in (A, D, L)} == AIRBORNE
    assert UGV_SITUATION[UgvPhase.HOLDING] is R  # it stands on the road, so it counts as under way


@pytest.mark.parametrize(
    ("kind", "severity"),
    [
        (EventKind.TASK_VISITED, Severity.INFO),
        (EventKind.POSE_STALE, Severity.WARNING),
        (EventKind.LINK_LOST, Severity.ERROR),
        (EventKind.TUMBLED, Severity.CRITICAL),
    ],
)
def test_severity(kind: EventKind, severity: Severity) -> None:
    assert failsafe.severity_of(kind) is severity


@pytest.mark.parametrize("action", Action)
@pytest.mark.parametrize("key", ["pose_stale", "pose_stale/air", "schedule_drift/mission"])
def test_good_overrides(key: str, action: Action) -> None:
    assert override_problem(key, action.name.lower()) is None


@pytest.mark.parametrize(
    ("key", "value", "word"),
    [
        ("pose_stail", "hold", "no event 'pose_stail'"),
        ("", "hold", "no event ''"),
        ("pose_stale/sky", "hold", "no situation 'sky'"),
        ("pose_stale/", "hold", "no situation ''"),
        ("pose_stale/air/air", "hold", "no situation 'air/air'"),
        ("tumbled", "note", "cannot be changed"),
        ("operator_stop/mission", "note", "cannot be changed"),
        ("pose_stale", "jump", "no action 'jump'"),
        ("pose_stale", "HOLD", "no action 'HOLD'"),
    ],
)
def test_wrong_overrides_say_what_is_wrong(key: str, value: str, word: str) -> None:
    assert word in (override_problem(key, value) or "")


def test_every_override_that_is_let_pass_is_used() -> None:
    for kind in set(EventKind) - FIXED:
        for situation in Situation:
            key = f"{kind}/{situation}"
            assert override_problem(key, "land_here") is None
            assert action_for(kind, situation, {key: "land_here"}) is Action.LAND_HERE


def test_the_manual_shows_the_table_as_it_is() -> None:
    assert MANUAL.read_text(encoding="utf-8") == page(), (
        "run: python -c \"from deploy.failsafe_manual import page; print(page(), end='')\" > docs/failsafe.md"
    )


def test_the_manual_names_every_event_and_action() -> None:
    rows = [line for line in page().splitlines() if line.startswith("| `")]
    assert len(rows) == len(EventKind)
    assert all(f"`{k}`" in row for k, row in zip(TABLE, rows, strict=True))
    assert [f"`{k}` †" in row for k, row in zip(TABLE, rows, strict=True)] == [k in FIXED for k in TABLE]
    assert set(WORDS) == set(Action)
    stale = next(row for row in rows if "`pose_stale`" in row)
    assert [cell.strip() for cell in stale.split("|")][2:10] == ["warning", "", "hold", "hold", "", "hold", "", ""]
