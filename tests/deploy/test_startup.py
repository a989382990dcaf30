"""Connecting a fleet: everybody at once, with a deadline, and poses for the estimators from the beginning."""

from __future__ import annotations

import ast
import io
import re
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
from rich.console import Console

from deploy import startup
from deploy.check_report import Verdict
from deploy.check_vehicles import BY_HAND, identify_fleet, settle, vehicle_rows
from deploy.display import LiveDisplay, PlainDisplay
from deploy.fleet import Fleet
from deploy.startup import Phase, connect_all
from deploy.startup_screen import StartupScreen
from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.vehicle import Command, Kind, Pose, SelfCheck, VehicleState

ROOT = Path(__file__).resolve().parents[2]


class Robot:
    """A vehicle that connects as its test wants."""

    def __init__(self, id: str, connect: Callable[[], object] = lambda: None) -> None:
        self._id, self._connect = id, connect
        self.fed: list[Pose] = []
        self.looked_at = 0
        self.closed = False
        self.findings: Callable[[], Sequence[SelfCheck]] = tuple

    @property
    def id(self) -> str:
        return self._id

    @property
    def kind(self) -> Kind:
        return "uav"

    def connect(self, deadline_s: float) -> None:
        self._connect()

    def state(self) -> VehicleState:
        self.looked_at += 1
        return VehicleState(self._id, 0.0, True, False)

    def send(self, command: Command) -> Command:
        return command

    def self_checks(self) -> Sequence[SelfCheck]:
        return self.findings()

    def feed_pose(self, pose: Pose) -> None:
        self.fed.append(pose)

    def close(self) -> None:
        self.closed = True


class Cameras:
    """Poses of every body at each reading, once connected."""

    def __init__(self, bodies: Sequence[str], clock: RealClock, fails: str | None = None) -> None:
        self.bodies, self.clock, self.fails, self.connected = bodies, clock, fails, False
        self.at = {b: (float(i), 0.0, 0.0) for i, b in enumerate(bodies)}

    def connect(self, deadline_s: float) -> None:
        if self.fails is not None:
            raise DriverError(self.fails)
        self.connected = True

    def read(self) -> Sequence[Pose]:
        if not self.connected:
            raise DriverError("not connected")
        return tuple(Pose(b, self.at[b], 0.0, self.clock.now()) for b in self.bodies)

    def close(self) -> None:
        self.connected = False


def fleet_of(*robots: Robot, fails: str | None = None) -> Fleet:
    clock = RealClock()
    bodies = {f"body of {r.id}": r.id for r in robots}
    cameras = Cameras(tuple(bodies), clock, fails)
    return Fleet({r.id: r for r in robots}, cameras, clock, "real", virtual=False, bodies=bodies, connect_s=2.0)


def wait_for(condition: Callable[[], object], deadline_s: float = 3.0) -> None:
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.005)


def refuse(why: str) -> Callable[[], None]:
    def connect() -> None:
        raise DriverError(why)

    return connect


def test_everybody_connects_at_once() -> None:
    meeting = threading.Barrier(3)
    fleet = fleet_of(*(Robot(f"r{i}", lambda: meeting.wait(2.0)) for i in range(3)))
    assert fleet.connect() == {}, "each waits for the others: one after the other nobody would be through"
    fleet.close()


def test_who_cannot_be_reached_is_named_and_the_others_connect_and_close() -> None:
    good, bad = Robot("good"), Robot("bad", refuse("bad: no answer from udp://h:1; switch it on"))
    fleet = fleet_of(good, bad)
    assert fleet.connect() == {"bad": "bad: no answer from udp://h:1; switch it on"}
    fleet.close()
    assert good.closed and bad.closed


def test_a_driver_that_hangs_is_left_behind_at_its_deadline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(startup, "GRACE_S", 0.1)
    release = threading.Event()
    clock = RealClock()
    errors = connect_all(
        {"stuck": Robot("stuck", release.wait), "good": Robot("good")}, Cameras((), clock), clock, clock.now() + 0.2,
        lambda name, phase, text: None,
    )  # fmt: skip
    release.set()
    assert list(errors) == ["stuck"]
    assert "has not answered for 0 s; check power" in errors["stuck"]


def test_a_bug_in_a_driver_is_that_vehicles_error() -> None:
    def connect() -> None:
        raise ZeroDivisionError("oh")

    fleet = fleet_of(Robot("a", connect), Robot("b"))
    assert fleet.connect() == {"a": "a: its driver failed: ZeroDivisionError: oh"}
    fleet.close()


def test_poses_are_fed_while_others_still_connect() -> None:
    early, release = Robot("early"), threading.Event()
    fleet = fleet_of(early, Robot("late", lambda: release.wait(3.0)))
    thread = threading.Thread(target=fleet.connect)
    thread.start()
    wait_for(lambda: len(early.fed) >= 3)
    assert early.looked_at >= 3, "somebody looks, as the loop will"
    assert {p.body for p in early.fed} == {"body of early"}
    release.set()
    thread.join()
    assert {p.body for p in fleet.listening.read()} == {"body of early", "body of late"}
    fleet.hand_over()
    time.sleep(0.05)
    fed = len(early.fed)
    time.sleep(0.1)
    assert len(early.fed) == fed, "the loop feeds from now on"
    assert fleet.listening is fleet.poses
    fleet.close()


def test_without_motion_capture_the_vehicles_are_still_tried() -> None:
    fleet = fleet_of(Robot("a"), fails="motion capture (optitrack at h): no answer; check that Motive streams")
    assert fleet.connect() == {"poses": "motion capture (optitrack at h): no answer; check that Motive streams"}
    fleet.close()


# --- what is shown


def test_one_line_for_who_is_ready_or_has_failed() -> None:
    stream = io.StringIO()
    with PlainDisplay(stream).progress() as tell:
        tell("cf1", "connecting", "")
        tell("cf1", "ready", "after 1.2 s")
        tell("cf2", "failed", "cf2: no answer; switch it on")
    assert stream.getvalue() == "cf1: ready after 1.2 s\ncf2: failed: no answer; switch it on\n"


def test_one_row_each_in_a_terminal() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=80)
    with LiveDisplay(console).progress() as tell:
        tell("cf1", "ready", "after 1.2 s")
        tell("cf2", "failed", "no answer; switch it on")
        tell("limo1", "connecting", "")
    assert isinstance(console.file, io.StringIO)
    shown = console.file.getvalue()
    for words in ("cf1", "after 1.2 s", "no answer; switch it on", "connecting, 0 s"):
        assert words in shown


@pytest.mark.parametrize("width", [40, 80, 200])
def test_the_rows_fit_any_width(width: int) -> None:
    screen = StartupScreen()
    told: list[tuple[str, Phase, str]] = [("cf1", "ready", "after 1 s"), ("cf2", "failed", "a long reason " * 12)]
    for name, phase, text in told:
        screen.tell(name, phase, text)
    console = Console(file=io.StringIO(), width=width)
    console.print(screen)
    assert isinstance(console.file, io.StringIO)
    assert all(len(line) <= width for line in console.file.getvalue().splitlines())


# --- what drivers found out


def found(name: str, verdict: str, text: str, value: float | None = None, unit: str = "") -> SelfCheck:
    return SelfCheck(name, verdict, text, value, unit)  # type: ignore[arg-type]


def test_one_row_a_name_with_the_worst_verdict() -> None:
    rows = vehicle_rows(
        {
            "a": [found("radio", "pass", "good"), found("mode", "warn", "armed"), found("clock", "not run", "no word")],
            "b": [found("radio", "fail", "weak", 0.2, "s"), found("mode", "warn", "armed")],
            "": [found("radio budget", "pass", "radio 0 carries a, b")],
        }
    )
    assert [(r.name, r.verdict, r.text) for r in rows] == [
        ("radio", Verdict.FAIL, "b: weak"),
        ("mode", Verdict.WARN, "a, b: armed"),
        ("clock", Verdict.NOT_RUN, "a: no word"),
        ("radio budget", Verdict.PASS, "radio 0 carries a, b"),
    ]
    assert (rows[0].measured, rows[0].unit) == (0.2, "s")


def names_in(path: Path) -> set[str]:
    """Names of findings that a driver's file may report."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "SelfCheck" and node.args:
            first = node.args[0]
            if isinstance(first, ast.Constant):
                found.add(str(first.value))
        elif isinstance(node, ast.Assign) and "SelfCheck(name" in path.read_text(encoding="utf-8"):
            target, value = node.targets[0], node.value
            if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
                target, value = target.elts[0], value.elts[0]
            if isinstance(target, ast.Name) and target.id == "name" and isinstance(value, ast.Constant):
                found.add(str(value.value))
    return found


def test_every_finding_of_a_driver_is_documented() -> None:
    text = (ROOT / "docs" / "checks.md").read_text(encoding="utf-8")
    section = text.partition("## What the vehicles")[2].partition("\n## ")[0]
    rows = {
        name
        for line in section.splitlines()
        if line.startswith("| `")
        for name in re.findall(r"`(.+?)`", line.split("|")[1])
    }
    files = [*(ROOT / "drivers").glob("*.py"), ROOT / "deploy" / "feeding.py"]
    names = set().union(*(names_in(path) for path in files)) - {"identity"} | {BY_HAND}
    assert rows == names


def test_it_waits_until_estimators_have_settled() -> None:
    robot = Robot("a")
    fleet = fleet_of(robot)
    begun_s = time.monotonic()

    def findings() -> Sequence[SelfCheck]:
        settled = time.monotonic() - begun_s > 0.5
        return [found("estimator", "pass" if settled else "not run", "words"), found("signing", "not run", "none")]

    robot.findings = findings
    settle(fleet, 5.0)
    assert 0.4 < time.monotonic() - begun_s < 2.0


def test_it_does_not_wait_for_ever() -> None:
    robot = Robot("a")
    robot.findings = lambda: [found("estimator", "fail", "does not settle")]
    begun_s = time.monotonic()
    settle(fleet_of(robot), limit_s=10.0, quiet_s=0.4)
    assert time.monotonic() - begun_s < 3.0


@pytest.mark.slow
def test_identity_is_asked_for_one_by_one() -> None:
    fleet = fleet_of(Robot("a"), Robot("b"))
    assert fleet.connect() == {}
    cameras = fleet.poses
    assert isinstance(cameras, Cameras)
    said: list[str] = []

    def obey(text: str) -> None:
        said.append(text)
        for name in ("a", "b"):
            if f"push {name} by" in text:  # the two have exchanged their names
                other = "b" if name == "a" else "a"
                x, y, z = cameras.at[f"body of {other}"]
                cameras.at[f"body of {other}"] = (x, y + 0.4, z)
            elif f"put {name} down" in text:
                cameras.at = {b: (float(i), 0.0, 0.0) for i, b in enumerate(cameras.bodies)}

    results = identify_fleet(fleet, obey)
    fleet.close()
    assert [(r.name, r.verdict) for r in results] == [(BY_HAND, "fail"), (BY_HAND, "fail")]
    assert any("push a by" in text for text in said)
