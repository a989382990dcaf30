"""Every check's pass, warning, failure and not-run cases, on missions small enough to compute by hand."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from checks_world import EAST_WEST, SURE, check, make_settings, plan_of, with_problem, with_uav
from rich.console import Console

from deploy.check_backend import BackendProbe, probe_backend
from deploy.check_chance import planner_row
from deploy.check_limits import CERTAIN, CheckLimits
from deploy.check_report import CheckReport, CheckRow, Verdict
from deploy.check_table import check_lines, check_table
from deploy.checks import check_plan
from deploy.frames import Frame
from deploy.settings import Geofence, Settings
from drivers.vehicle import Pose, SelfCheck, VehicleState
from planner.plan import Action, Move, Visit

ROOT = Path(__file__).parents[2]
PASS, WARN, FAIL, NOT_RUN = Verdict.PASS, Verdict.WARN, Verdict.FAIL, Verdict.NOT_RUN


# --- the report -----------------------------------------------------------------------------------------------------


def test_a_sound_mission_passes() -> None:
    report = check(make_settings())
    assert report.passed
    assert {r.verdict for r in report.rows if r.group != "backend"} <= {PASS, NOT_RUN}
    assert {r.name for r in report.rows if r.verdict is NOT_RUN} == {
        "planner", "links", "readiness", "batteries", "poses", "placement", "identity",
    }  # fmt: skip


def test_results_are_bound_to_problem_and_plan_and_expire() -> None:
    settings = make_settings()
    plan = plan_of(settings)
    report = check_plan(settings, plan, replace(SURE, validity_s=60.0), now_s=100.0)
    problem = settings.problem.digest
    assert report.valid_until_s == 160.0
    assert report.valid_for(problem, plan.digest, 100.0)
    assert report.valid_for(problem, plan.digest, 159.9)
    assert not report.valid_for(problem, plan.digest, 160.0)
    assert not report.valid_for(problem, plan.digest, 99.0)  # a clock that was set back proves nothing
    assert not report.valid_for(problem, plan_of(settings, EAST_WEST[:4]).digest, 100.0)
    other = with_problem(settings, tasks=settings.problem.tasks + 1.0)
    assert not report.valid_for(other.problem.digest, plan.digest, 100.0)


def test_only_failures_fail() -> None:
    rows = [CheckRow(v.value, "g", v, None, "", None, "text") for v in Verdict]
    assert not CheckReport(tuple(rows), "", "", 0.0, 1.0).passed
    assert CheckReport(tuple(r for r in rows if r.verdict is not FAIL), "", "", 0.0, 1.0).passed


def test_json_has_every_row_and_no_infinities() -> None:
    report = check(make_settings())
    broken = replace(report, rows=(replace(report.rows[0], measured=math.inf), *report.rows[1:]))
    data = json.loads(json.dumps(broken.to_json(), allow_nan=False))
    assert data["passed"] is True
    assert data["rows"][0]["measured"] is None
    assert [r["name"] for r in data["rows"]] == [r.name for r in report.rows]


def test_table_and_lines_show_all() -> None:
    report = check(make_settings())
    console = Console(width=160, record=True, file=None, quiet=False)
    with console.capture() as captured:
        console.print(check_table(report))
    text = captured.get()
    lines = check_lines(report)
    for row in report.rows:
        assert row.name in text
        assert any(row.name in line and row.text in line for line in lines)
    assert lines[-1] == report.summary
    assert "failed" in report.summary


def test_unless_passed_every_row_says_what_to_do() -> None:
    settings = with_uav(make_settings(), 0, altitude_m=200.0, pad_offset_m=(0.0, 20.0))
    settings = replace(
        settings, geofence=replace(settings.geofence, polygon_m=((-900.0, -50.0), (900.0, -50.0), (0.0, 90.0)))
    )
    report = check(settings, limits=replace(SURE, makespan_limit_s=10.0))
    bad = [r for r in report.rows if r.verdict in (WARN, FAIL)]
    assert len(bad) >= 5
    for row in bad:
        assert re.search(r"[;:] .*\b(widen|lower|set|move|keep|raise|expect|plan|put|give|spread)\b", row.text), row


def test_every_check_is_documented() -> None:
    text = (ROOT / "docs" / "checks.md").read_text(encoding="utf-8")
    documented = re.findall(r"^\| \*\*(.+?)\*\* \|", text, flags=re.MULTILINE)
    assert documented == [r.name for r in check(make_settings()).rows]


def test_limits_that_contradict_each_other() -> None:
    with pytest.raises(ValueError, match="a failure is worse than a warning"):
        CheckLimits(energy_margin_warn=0.1, energy_margin_fail=0.2)


# --- mission --------------------------------------------------------------------------------------------------------


def test_roads() -> None:
    settings = make_settings()
    assert check(settings).row("roads").verdict is PASS
    roads = settings.problem.road_distance_m.copy()
    roads[1, :] = roads[:, 1] = np.inf
    roads[1, 1] = 0.0
    row = check(with_problem(settings, road_distance_m=roads), (Visit(0, 0),)).row("roads")
    assert (row.verdict, row.measured) == (WARN, 1.0)
    assert "path point 1" in row.text
    roads[0, :] = roads[:, 0] = np.inf
    roads[0, 0] = 0.0
    row = check(with_problem(settings, road_distance_m=roads), (Visit(0, 0),)).row("roads")
    assert (row.verdict, row.measured) == (FAIL, 2.0)


@pytest.mark.parametrize(("edge", "verdict"), [(2500.0, PASS), (2005.0, WARN), (1950.0, FAIL)])
def test_tasks_inside(edge: float, verdict: Verdict) -> None:
    polygon = ((-4000.0, -500.0), (edge, -500.0), (edge, 500.0), (-4000.0, 500.0))
    settings = make_settings(geofence=Geofence(polygon, 100.0, 10.0))
    row = check(settings).row("tasks inside")
    assert row.verdict is verdict
    assert row.measured == pytest.approx(edge - 2000)
    assert "task 0" in row.text


@pytest.mark.parametrize(("edge", "verdict"), [(3100.0, PASS), (3009.0, WARN), (2997.0, FAIL)])
def test_places_inside(edge: float, verdict: Verdict) -> None:
    polygon = ((-4000.0, -500.0), (edge, -500.0), (edge, 500.0), (-4000.0, 500.0))
    row = check(make_settings(geofence=Geofence(polygon, 100.0, 10.0))).row("places inside")
    assert row.verdict is verdict
    assert row.measured == pytest.approx(edge - 3000)
    assert "at path point 0" in row.text


@pytest.mark.parametrize(("y", "verdict"), [(20.0, PASS), (16.0, WARN), (14.0, FAIL)])
def test_pads_apart(y: float, verdict: Verdict) -> None:
    row = check(with_uav(make_settings(), 1, pad_offset_m=(0.0, y))).row("pads apart")
    assert (row.verdict, row.measured) == (verdict, y - 10)


def test_parking_apart() -> None:
    settings = make_settings()
    assert check(settings).row("parking apart").measured == 4.0
    near = replace(settings, ugvs=(settings.ugvs[0], replace(settings.ugvs[1], park_offset_m=(0.0, 0.0))))
    row = check(near).row("parking apart")
    assert (row.verdict, row.measured, row.limit) == (FAIL, 2.0, pytest.approx(3.0))


@pytest.mark.parametrize(
    ("altitudes", "verdict", "measured"),
    [((60.0, 70.0), PASS, 30.0), ((60.0, 92.0), WARN, 8.0), ((60.0, 110.0), FAIL, -10.0), ((60.0, 64.0), FAIL, 4.0)],
)
def test_layers(altitudes: tuple[float, float], verdict: Verdict, measured: float) -> None:
    settings = make_settings()
    for i, altitude in enumerate(altitudes):
        settings = with_uav(settings, i, altitude_m=altitude)
    row = check(settings).row("layers")
    assert (row.verdict, row.measured) == (verdict, measured)


def test_layers_shared() -> None:
    row = check(with_uav(make_settings(), 1, altitude_m=60.0)).row("layers")
    assert (row.verdict, row.measured, row.limit) == (WARN, 1.0, 2.0)


def test_speeds() -> None:
    settings = make_settings()
    row = check(settings).row("speeds")
    assert (row.verdict, row.measured) == (PASS, pytest.approx(15 / 18))
    row = check(with_uav(settings, 0, max_speed_mps=9.0)).row("speeds")
    assert (row.verdict, row.measured) == (FAIL, pytest.approx(10 / 9))
    row = check(replace(settings, frame=Frame(time_scale=0.5))).row("speeds")
    assert (row.verdict, row.measured, row.limit) == (FAIL, 20.0, 10.0)


# --- plan and energy ------------------------------------------------------------------------------------------------


def test_feasible() -> None:
    settings = make_settings()
    row = check(settings).row("feasible")
    assert (row.verdict, row.measured) == (PASS, 2.0)
    report = check(settings, (Visit(0, 0),))
    assert report.row("feasible").verdict is FAIL
    assert "task 1 is not visited" in report.row("feasible").text
    for name in (
        "rendezvous energy",
        "landing energy",
        "ugv energy",
        "waiting slack",
        "separation",
        "success probability",
    ):
        assert report.row(name).verdict is NOT_RUN


def test_makespan() -> None:
    settings = make_settings()
    row = check(settings).row("makespan")
    assert (row.verdict, row.measured, row.limit) == (PASS, 200.0, None)
    assert check(settings, limits=replace(SURE, makespan_limit_s=300.0)).row("makespan").verdict is PASS
    row = check(settings, limits=replace(SURE, makespan_limit_s=150.0)).row("makespan")
    assert (row.verdict, row.limit) == (FAIL, 150.0)
    assert "50 s too late" in row.text


@pytest.mark.parametrize(("energy", "verdict"), [(100e3, PASS), (79e3, WARN), (74e3, FAIL)])
def test_rendezvous_energy(energy: float, verdict: Verdict) -> None:
    settings = make_settings()
    u0, u1 = settings.problem.uavs
    settings = with_problem(settings, uavs=(replace(u0, energy_j=energy), u1))
    row = check(settings).row("rendezvous energy")
    assert row.verdict is verdict
    # 3 km at 10 m/s and 200 W, 10 kJ of reserve, 100 kJ of capacity
    assert row.measured == pytest.approx((min(energy, 100e3) - 60e3 - 10e3) / 100e3)
    assert "uav0 at its 1st rendezvous (ugv0)" in row.text or verdict is PASS


def test_no_rendezvous_no_number() -> None:
    row = check(make_settings(), (Visit(0, 0), Visit(1, 1))).row("rendezvous energy")
    assert (row.verdict, row.measured) == (PASS, None)


@pytest.mark.parametrize(("energy", "verdict"), [(100e3, PASS), (79e3, WARN), (74e3, FAIL)])
def test_landing_energy(energy: float, verdict: Verdict) -> None:
    settings = make_settings()
    u0, u1 = settings.problem.uavs
    settings = with_problem(settings, uavs=(u0, replace(u1, energy_j=energy)))
    row = check(settings, (Visit(0, 0), Visit(1, 1))).row("landing energy")
    assert row.verdict is verdict
    assert row.measured == pytest.approx((energy - 60e3 - 10e3) / 100e3)  # to the task, then 1 km to a path point


@pytest.mark.parametrize(("energy", "verdict"), [(36.81e6, PASS), (3.3e6, WARN), (2.0e6, FAIL)])
def test_ugv_energy(energy: float, verdict: Verdict) -> None:
    settings = make_settings()
    g0, g1 = settings.problem.ugvs
    settings = with_problem(settings, ugvs=(g0, replace(g1, energy_j=energy)))
    row = check(settings).row("ugv energy")
    assert row.verdict is verdict
    used = 2447.9 * 200 + 60e3
    assert row.measured == pytest.approx((energy - used) / 36.81e6)
    assert "ugv1" in row.text or verdict is PASS


def test_waiting_slack() -> None:
    settings = make_settings()
    row = check(settings).row("waiting slack")
    assert (row.verdict, row.measured) == (PASS, pytest.approx(30e3 / 250))
    row = check(settings, limits=replace(SURE, slack_warn_s=130.0)).row("waiting slack")
    assert (row.verdict, row.limit) == (WARN, 130.0)
    landed = with_problem(settings, uavs=tuple(replace(u, waiting="landed") for u in settings.problem.uavs))
    assert check(landed).row("waiting slack").measured is None


# --- space ----------------------------------------------------------------------------------------------------------


def test_drives_that_meet_on_the_road_hold() -> None:
    settings = make_settings()
    assert check(settings).row("ugv separation").verdict is PASS
    on_the_road = (replace(g, park_offset_m=(4.0 * i, 0.0)) for i, g in enumerate(settings.ugvs))
    settings = replace(settings, ugvs=tuple(on_the_road))
    # ugv0 comes back from the east while ugv1 drives out to the east on the same centre line
    actions: tuple[Action, ...] = (Visit(0, 0), Visit(1, 1), Move(0, 0), Move(0, None), Move(1, 1), Move(1, 0))
    row = check(settings, actions).row("ugv separation")
    assert row.verdict is WARN
    assert row.measured is not None
    assert row.measured < 0
    assert "ugv1 will hold" in row.text


def test_ugvs_that_park_too_near_fail() -> None:
    settings = make_settings()
    near = replace(settings, ugvs=(settings.ugvs[0], replace(settings.ugvs[1], park_offset_m=(0.0, -1.5))))
    row = check(near, (Visit(0, 0), Visit(1, 1))).row("ugv separation")
    assert (row.verdict, row.measured) == (FAIL, pytest.approx(-2.5))
    assert "holding cannot resolve it" in row.text


@pytest.mark.parametrize(("top", "verdict"), [(4000.0, PASS), (25.0, WARN), (15.0, FAIL)])
def test_flights_inside(top: float, verdict: Verdict) -> None:
    polygon = ((-4000.0, -500.0), (4000.0, -500.0), (4000.0, top), (-4000.0, top))
    row = check(make_settings(geofence=Geofence(polygon, 100.0, 10.0))).row("flights inside")
    assert row.verdict is verdict
    if verdict is not PASS:
        assert row.measured == pytest.approx(top - 20)  # the pad of uav1 lies 20 m north
        assert "uav1 flies" in row.text


def test_a_flight_across_a_notch_is_outside() -> None:
    notch = (
        (-4000.0, -500.0),
        (4000.0, -500.0),
        (4000.0, 500.0),
        (1050.0, 500.0),
        (1000.0, -100.0),
        (950.0, 500.0),
        (-4000.0, 500.0),
    )
    row = check(make_settings(geofence=Geofence(notch, 100.0, 10.0))).row("flights inside")
    assert row.verdict is FAIL
    assert "uav0 flies" in row.text
    row = check(make_settings(geofence=Geofence(notch, 100.0, 10.0))).row("drives inside")
    assert row.verdict is FAIL


def test_drives_inside() -> None:
    row = check(make_settings()).row("drives inside")
    assert (row.verdict, row.measured) == (PASS, pytest.approx(498.0))  # on their parking places, 2 m off the road


# --- chance ---------------------------------------------------------------------------------------------------------


def test_success_probability() -> None:
    settings = make_settings()
    row = check(settings).row("success probability")
    assert (row.verdict, row.measured) == (PASS, 1.0)
    wild = replace(SURE, uncertainty=replace(CERTAIN, docking_s=150.0, delay_sigma=0.5), samples=2000)
    report = check(settings, limits=wild)
    # 40 kJ above empty at docking, less the 29.75 s of descent and braking that the schedule does not count
    measured = report.row("success probability").measured
    assert measured is not None
    assert 0.0 < measured < 1.0
    assert report.row("success probability").verdict in (WARN, FAIL)
    assert "uav" in report.row("success probability").text
    assert report.row("reserve probability").measured < measured  # type: ignore[operator]
    hopeless = replace(SURE, uncertainty=replace(CERTAIN, docking_s=1000.0, delay_sigma=0.0))
    row = check(settings, limits=hopeless).row("success probability")
    assert (row.verdict, row.measured) == (FAIL, 0.0)


def test_late_finish() -> None:
    settings = make_settings()
    row = check(settings).row("late finish")
    assert (row.verdict, row.measured) == (PASS, pytest.approx(205.0))  # each flight brakes: 10 m/s at 2 m/s^2
    row = check(settings, limits=replace(SURE, makespan_limit_s=203.0)).row("late finish")
    assert (row.verdict, row.limit) == (WARN, 203.0)


@pytest.mark.parametrize(
    ("took", "feasible", "verdict"), [(1.0, True, PASS), (6.0, True, WARN), (1.0, False, WARN), (11.0, True, FAIL)]
)
def test_planner(took: float, feasible: bool, verdict: Verdict) -> None:
    ticks = iter([5.0, 5.0 + took])
    row = planner_row(lambda: feasible, 10.0, lambda: next(ticks))
    assert (row.verdict, row.measured, row.limit) == (verdict, took, 10.0)
    assert planner_row(None, 10.0).verdict is NOT_RUN


# --- backend --------------------------------------------------------------------------------------------------------

START = {"uav0": (0.0, 10.0), "uav1": (0.0, 20.0), "ugv0": (0.0, -2.0), "ugv1": (0.0, 2.0)}
BODY = {"uav0": "body0", "uav1": "body1", "ugv0": "ugv0", "ugv1": "ugv1"}


def probe_of(**changes: object) -> BackendProbe:
    states = {i: VehicleState(i, 9.9, True, False, battery=1.0) for i in START}
    poses = {BODY[i]: Pose(BODY[i], (x, y, 0.0), 0.0, 9.9) for i, (x, y) in START.items()}
    values: dict[str, object] = {"now_s": 10.0, "states": states, "poses": poses}
    return BackendProbe(**(values | changes))  # type: ignore[arg-type]


def look(probe: BackendProbe, settings: Settings | None = None) -> CheckReport:
    settings = settings or make_settings()
    return check_plan(settings, plan_of(settings), SURE, now_s=0.0, probe=probe)


def with_state(vehicle: str, **changes: object) -> BackendProbe:
    probe = probe_of()
    return replace(probe, states={**probe.states, vehicle: replace(probe.states[vehicle], **changes)})  # type: ignore[arg-type]


def test_a_sound_backend_passes() -> None:
    report = look(probe_of())
    assert {r.verdict for r in report.rows if r.group == "backend"} == {PASS}
    assert report.row("links").measured == pytest.approx(0.1)


def test_links() -> None:
    row = look(with_state("uav1", link=False)).row("links")
    assert row.verdict is FAIL
    assert "uav1 does not answer" in row.text
    row = look(with_state("uav1", stamp_s=7.0)).row("links")
    assert (row.verdict, row.measured) == (FAIL, pytest.approx(3.0))
    row = look(probe_of(errors={"ugv0": "no route to host"})).row("links")
    assert row.verdict is FAIL
    assert "ugv0: no route to host" in row.text
    row = look(probe_of(states={})).row("links")
    assert (row.verdict, row.measured) == (FAIL, None)


@pytest.mark.parametrize("what", ["airborne", "armed", "tumbled", "locked"])
def test_readiness(what: str) -> None:
    row = look(with_state("uav0", **{what: True})).row("readiness")
    assert (row.verdict, row.measured) == (FAIL, 1.0)
    assert f"uav0 is {what}" in row.text


def test_a_fault_is_told_in_the_vehicles_words() -> None:
    assert "reports 'motor 3 hot'" in look(with_state("uav0", fault="motor 3 hot")).row("readiness").text


@pytest.mark.parametrize(("level", "verdict"), [(1.0, PASS), (0.9, WARN), (0.7, FAIL), (None, FAIL)])
def test_batteries(level: float | None, verdict: Verdict) -> None:
    row = look(with_state("uav1", battery=level)).row("batteries")
    assert (row.verdict, row.measured) == (verdict, level)


def test_virtual_energy_asks_no_battery() -> None:
    settings = make_settings()
    settings = replace(
        settings,
        uavs=tuple(replace(u, energy="virtual") for u in settings.uavs),
        ugvs=tuple(replace(g, energy="virtual") for g in settings.ugvs),
    )
    row = look(with_state("uav0", battery=None), settings).row("batteries")
    assert (row.verdict, row.measured) == (PASS, None)


def test_poses() -> None:
    probe = probe_of()
    row = look(replace(probe, poses={k: v for k, v in probe.poses.items() if k != "body1"})).row("poses")
    assert row.verdict is FAIL
    assert "uav1 (body 'body1') is not seen" in row.text
    old = replace(probe, poses={**probe.poses, "body0": replace(probe.poses["body0"], stamp_s=9.0)})
    row = look(old).row("poses")
    assert (row.verdict, row.measured) == (FAIL, pytest.approx(1.0))
    assert "motion capture: no host" in look(replace(probe, errors={"poses": "no host"})).row("poses").text


def test_placement_and_identity() -> None:
    probe = probe_of()
    moved = replace(probe, poses={**probe.poses, "body1": Pose("body1", (0.0, 25.0, 0.0), 0.0, 9.9)})
    report = look(moved)
    assert (report.row("placement").verdict, report.row("placement").measured) == (FAIL, pytest.approx(5.0))
    assert report.row("identity").verdict is PASS
    a, b = probe.poses["body0"], probe.poses["body1"]
    swapped = replace(
        probe,
        poses={
            **probe.poses,
            "body0": replace(a, position_m=b.position_m),
            "body1": replace(b, position_m=a.position_m),
        },
    )
    row = look(swapped).row("identity")
    assert (row.verdict, row.measured) == (FAIL, 2.0)
    assert "uav0 (body 'body0') stands where uav1 should" in row.text
    blind = look(replace(probe, poses={}))
    assert (blind.row("placement").verdict, blind.row("identity").verdict) == (NOT_RUN, NOT_RUN)


def test_probe_listens_and_moves_nothing() -> None:
    class Silent:
        """A vehicle that can only be looked at."""

        def state(self) -> VehicleState:
            return VehicleState("uav0", 0.0, True, False)

        def self_checks(self) -> list[SelfCheck]:
            return [SelfCheck("radio", "pass", "the link is good")]

    class Stream:
        def __init__(self) -> None:
            self.reads = 0

        def read(self) -> list[Pose]:
            self.reads += 1
            return [Pose("body0", (float(self.reads), 0.0, 0.0), 0.0, time[0])]

    time = [0.0]
    stream = Stream()
    probe = probe_backend(
        {"uav0": Silent()},  # type: ignore[dict-item]
        stream,
        lambda: time[0],
        lambda t: time.__setitem__(0, t),
        listen_s=1.0,
        errors={"ugv0": "gone"},
    )
    assert probe.now_s == 1.0
    assert probe.poses["body0"].position_m[0] == stream.reads >= 10
    assert set(probe.states) == {"uav0"}
    assert probe.errors == {"ugv0": "gone"}
    assert probe.findings["uav0"][0].name == "radio"
