"""The report: its numbers, its page, its pictures, and that the documentation names every key."""

from __future__ import annotations

import json
import re
from dataclasses import fields, replace
from pathlib import Path

import fabricated_run
import numpy as np
import pytest

from deploy.errors import DeployError, InputError
from deploy.events import Action, Event, EventKind, Severity
from deploy.frames import Frame
from deploy.recording import Recorder, read
from deploy.report import Lateness, Report, build, collect, from_recording, make
from deploy.report_charts import WAITING, _actual_bars, _clipped, _in_force, _within
from deploy.report_history import standstills
from deploy.report_html import clock, kj, km, metres, page
from deploy.status import Status, VehicleStatus

DOCS = Path(__file__).resolve().parents[2] / "docs" / "recordings.md"
POWER_W = 200.0


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """The fabricated run with an event whose text tries to break the page."""
    folder = tmp_path_factory.mktemp("run")
    settings = fabricated_run.settings()
    with Recorder(folder, fabricated_run.meta(name="<b>lab & field</b>"), settings) as recorder:
        fabricated_run.write(recorder, settings, dt=5.0)
    return folder, settings, make(folder, settings, fabricated_run.drawing())


def by_hand(state="done", visited=True, **meta):
    """uav0 flies 100 s at 200 W over 1 km, charges 10 kJ at ugv1 in 50 s, flies 50 s, visits its task; ugv0 drives."""
    rows = []
    for t in range(0, 201, 10):
        if t < 100:
            uav = ((t * 10.0, 0.0, 30.0), "flying", 100_000.0 - POWER_W * t, "task 3")
        elif t < 150:
            uav = ((1000.0, 0.0, 1.0), "charging", 80_000.0 + 200.0 * (t - 100), "recharge at ugv1")
        else:
            left = 90_000.0 - POWER_W * (t - 150)
            uav = ((1000.0, (t - 150) * 10.0, 30.0), "flying" if t < 200 else "down", left, "task 4")
        given = min(10_000.0, max(0.0, 200.0 * (t - 100)))
        status = Status(
            now_s=5.0 + t, mission_s=float(t), mission_state=state if t == 200 else "running",
            tasks_visited=tuple(t >= {3: 100, 4: 200}.get(i, 0 if visited else 999) for i in range(15)),
            plan_number=0, predicted_makespan_s=None,
            vehicles=(
                VehicleStatus("uav0", "uav", uav[1], uav[0], 0.0, uav[2], 0.5, uav[3], None, None),
                VehicleStatus("uav1", "uav", "on_pad", (5000.0, 300.0, 0.0), 0.0, 287_700.0, 1.0, "", None, None),
                VehicleStatus("ugv0", "ugv", "driving", (t * 4.0, 50.0, 0.0), 0.0, 1e6 - 5e2 * t, 0.5, "", None, None),
                VehicleStatus("ugv1", "ugv", "parked", (1000.0, 0.0, 0.0), 0.0, 1e6 - given, 0.5, "", None, None),
            ),
        )  # fmt: skip
        rows.append(status)
    first = Event(5.0 + 100, EventKind.TASK_VISITED, Severity.INFO, "uav0", Action.NOTE, "task 3 visited")
    late = Event(5.0 + 120, EventKind.UGV_STUCK, Severity.WARNING, "ugv0", Action.WARN, "stuck")
    problem = fabricated_run.problem()
    given_visits = np.array([visited and i not in (3, 4) for i in range(15)])
    settings = replace(fabricated_run.settings(), problem=replace(problem, visited=given_visits))
    return collect(fabricated_run.meta(**meta), settings, rows, (first, late), (), Lateness(21, 205.0, 0.001, 0.01))


def test_numbers_by_hand():
    report = build(by_hand())
    assert report.outcome == "done"
    assert (report.tasks_total, report.tasks_visited) == (15, 15)
    assert (report.makespan_actual_s, report.makespan_planned_s, report.duration_s) == (200.0, None, 200.0)
    assert report.uav_energy_j == pytest.approx(100 * POWER_W + 50 * POWER_W)
    assert report.energy_given_j == pytest.approx(10_000.0)
    assert report.ugv_energy_j == pytest.approx(500.0 * 200)
    assert report.recharges == 1
    assert [(v.task, v.uav, v.time_s) for v in report.visits] == [(3, "uav0", 100.0), (4, "uav0", 200.0)]
    uav0, uav1, ugv0, ugv1 = report.vehicles
    assert (uav0.tasks, uav0.recharges, uav0.moving_s, uav0.charging_s) == (2, 1, 150.0, 50.0)
    assert uav0.distance_m == pytest.approx(1500.0)
    assert uav0.min_energy_margin_j == pytest.approx(80_000.0 - fabricated_run.RESERVE_J)
    assert (uav1.tasks, uav1.distance_m, uav1.energy_used_j) == (0, 0.0, 0.0)
    assert (ugv0.moving_s, ugv0.distance_m, ugv0.recharges) == (200.0, pytest.approx(800.0), 0)
    assert (ugv1.recharges, ugv1.energy_used_j) == (1, pytest.approx(0.0))
    assert report.events == {"task_visited": 1, "ugv_stuck": 1}
    assert report.severities == {"info": 1, "warning": 1, "error": 0, "critical": 0}
    assert report.safety_violations == ()


def test_a_charge_without_words_belongs_to_the_nearest_ugv():
    history = by_hand()
    silent = replace(history, doing=np.where(history.phase == "charging", "", history.doing))
    assert build(silent).vehicles[3].recharges == 1


def test_a_ugv_that_stalls_on_its_way_stands():
    history = by_hand()
    place = history.position_m.copy()
    place[8:14, 2] = place[8, 2]  # from 80 s to 130 s
    stalled = replace(history, position_m=place)
    (span,) = standstills(stalled, 2)
    assert (span.start_s, span.end_s) == (80.0, 130.0)
    ugv0 = build(stalled).vehicles[2]
    assert (ugv0.moving_s, ugv0.waiting_s) == (150.0, 50.0)
    assert standstills(stalled, 0) == standstills(history, 2) == []
    assert (80.0 / 60, 130.0 / 60, WAITING) in _actual_bars(stalled, 2, "red")


def test_a_plan_is_drawn_while_it_is_in_force(run):
    history = from_recording(read(run[0]), run[1])
    (first, begin, change), (second, again, end) = _in_force(history)
    assert (first, second) == history.plans
    assert (begin, end) == (-np.inf, np.inf)
    assert change == again == pytest.approx(1300.0 / 60)
    bars = [(0.0, 10.0, "a"), (15.0, 30.0, "b"), (40.0, 50.0, "c")]
    assert _clipped(bars, 5.0, 20.0) == [(5.0, 10.0, "a"), (15.0, 20.0, "b")]
    x, y = _within([0.0, 10.0, 20.0], [0.0, 100.0, 0.0], 5.0, np.inf)
    assert (x.tolist(), y.tolist()) == ([5.0, 10.0, 20.0], [50.0, 100.0, 0.0])
    assert _within([0.0, 1.0], [0.0, 1.0], 2.0, 3.0)[0].size == 0


def test_outcomes():
    assert build(by_hand(state="aborted")).outcome == "aborted"
    assert build(by_hand(state="running")).outcome == "failed"
    unfinished = build(by_hand(visited=False))
    assert (unfinished.outcome, unfinished.tasks_visited, unfinished.makespan_actual_s) == ("failed", 2, None)
    assert build(replace(by_hand(), truncated=True)).outcome == "failed"
    assert build(by_hand(), outcome="failed").outcome == "failed"


def test_an_empty_recording_has_a_report(tmp_path):
    settings = fabricated_run.settings()
    Recorder(tmp_path, fabricated_run.meta(), settings).close()
    report = make(tmp_path, settings, fabricated_run.drawing())
    assert (report.outcome, report.tasks_visited, report.makespan_actual_s) == ("failed", 0, None)
    assert "Mission failed" in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_the_fabricated_run(run):
    _, _, report = run
    assert (report.outcome, report.tasks_visited, report.recharges) == ("done", 15, 4)
    assert report.makespan_planned_s == fabricated_run.plan(fabricated_run.FIRST).makespan_s
    assert report.makespan_planned_s < report.makespan_actual_s < report.makespan_planned_s * 1.1
    (replan,) = report.replans
    assert (replan.number, replan.time_s, replan.reason) == (1, 1300.0, "ugv1 is late")
    assert [v.kind for v in report.safety_violations] == ["energy"]  # its waiting costs more than its makers thought
    assert report.safety_violations[0].vehicles == ("uav0",)


def test_report_json_is_the_report(run):
    folder, _, report = run
    data = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    assert data["format"] == "copcs-report/1"
    assert list(data) == [f.name for f in fields(Report)]
    assert data["seed"] == 7
    assert data["versions"]["python"] == report.versions["python"]
    again = build(from_recording(read(folder), run[1]))
    assert again.to_json() == (folder / "report.json").read_bytes()


def test_every_key_is_documented():
    text = DOCS.read_text(encoding="utf-8")
    section = text[text.index("## report.json") :]
    named = re.findall(r"^\| `([a-z_0-9]+)` ", section, flags=re.MULTILINE)
    assert named == [f.name for f in fields(Report)]


def test_every_channel_is_documented(run):
    from mcap.reader import make_reader  # noqa: PLC0415

    with (run[0] / "recording.mcap").open("rb") as stream:
        topics = {c.topic for c in make_reader(stream).get_summary().channels.values()}
    text = DOCS.read_text(encoding="utf-8")
    for topic in topics:
        general = re.sub(r"/pose/.*", "/pose/VEHICLE", topic)
        assert f"`{general}`" in text, topic


def test_the_page_needs_nothing_else_and_says_what_happened(run):
    text = (run[0] / "report.html").read_text(encoding="utf-8")
    for url in re.findall(r"(?:https?:)?//[^\s\"'<>)]+", text):
        assert url.startswith(("http://www.w3.org/", "https://www.w3.org/")), url
    assert not re.search(r"<(script|link|img|iframe|object)\b|@import|url\((?!#)", text)
    assert text.count("<svg") == 4
    assert "<b>lab" not in text
    assert "&lt;b&gt;lab &amp; field" in text
    for words in (
        "Mission done",
        "15 of 15",
        "ugv1 is late",
        "4.1 % later",
        "copcs-deploy run fabricated.yaml --seed 7",
    ):
        assert words in text


def test_a_page_without_plans_or_positions():
    history = by_hand()
    text = page(build(history), history, fabricated_run.drawing())
    assert "Least separation" in text


def test_an_arena_run_is_reported_in_world_terms(tmp_path):
    settings = fabricated_run.settings(Frame(scale=4e-4, rotation_rad=0.5, origin_m=(-2.0, -2.0), time_scale=0.02))
    with Recorder(tmp_path, fabricated_run.meta(), settings) as recorder:
        fabricated_run.write(recorder, settings, dt=5.0)
    report = build(from_recording(read(tmp_path), settings))
    assert report.vehicles[0].distance_m == pytest.approx(23_578, rel=0.01)
    assert report.replans[0].time_s == pytest.approx(1300.0)


def test_what_cannot_be_read_or_written_is_a_clear_error(tmp_path, run):
    with pytest.raises(InputError, match="no such file"):
        make(tmp_path, run[1], fabricated_run.drawing())
    (run[0] / "report.json").unlink()
    (run[0] / "report.json").mkdir()
    with pytest.raises(DeployError, match="cannot write the report"):
        make(run[0], run[1], fabricated_run.drawing())
    (run[0] / "report.json").rmdir()


def test_figures_for_people():
    assert (clock(59.6), clock(3_725.0), clock(None), clock(-3.0), clock(-0.5)) == (
        "1:00", "1:02:05", "–", "−0:03", "0:00",
    )  # fmt: skip
    assert (km(12_345.0), km(12.3), km(None)) == ("12.35 km", "12.3 m", "–")
    assert (kj(-23_900.0), kj(1.15e6), kj(None)) == ("−23.9 kJ", "1.15 MJ", "–")
    assert (metres(0.314), metres(31.4), metres(3141.0), metres(None)) == ("0.31 m", "31.4 m", "3,141 m", "–")
