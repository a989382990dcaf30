"""The links of MAVLink vehicles, cut in the field: the failsafe table's action in time, and nobody is harmed.

One flight in real time. A cut link takes the poses with it here: they come by telemetry.
"""

from __future__ import annotations

import signal

import pytest
from plug_flights import Asked, Flight, Really, Script, Sent, Told, flown, mission_of
from wire_runs import nothing_left

from deploy.events import EventKind as K
from deploy.mission import Mission
from deploy.replanning import URGENT_RETRY_S
from drivers.vehicle import Hold, Land
from planner.plan import Move, Visit
from sim_backends.wire.world import Body

pytestmark = pytest.mark.wire

QUAD, OTHER, ROVER = "quad1", "quad2", "rover1"
TASKS = ((-350.0, 140.0), (-265.0, 115.0), (-270.0, 75.0))
PLAN = (Move(ugv=0, path_point=0), Visit(uav=0, task=0), Visit(uav=1, task=1), Visit(uav=1, task=2))
"""quad1 flies away from the others, quad2 the other way, and the rover along its track."""
ROVER_STOPS_S, OFFBOARD_S = 4.0, 3.0
"""ArduPilot's rover stops 3 s after the last set-point; PX4 acts 1 s after it and brakes."""


def field() -> Mission:
    steady = {"replanning": {"loss_ratio": 10.0, "loss_s": 1e4}}  # only plugs replan
    low = {"arena.layers": {"lowest_m": 8.0, "spacing_m": 10.0}}
    return mission_of("field", (QUAD, OTHER, ROVER), TASKS, **steady, **low)


M = field().settings.monitors
AGAIN_S = URGENT_RETRY_S + M.planner_late_s


def hovers(body: Body) -> bool:
    return body.airborne and max(map(abs, body.velocity_mps)) < 0.5


def stands(body: Body) -> bool:
    return body.speed_mps < 0.05


def down(body: Body) -> bool:
    return not body.airborne


@pytest.fixture(scope="module")
def links_cut() -> Flight:
    """A copter's link is dead both ways, then a rover's autopilot stops."""

    def script(f: Flight) -> Script:
        yield from f.until(lambda: f.moving(QUAD, OTHER))
        cut = f.pull(
            "MAVLink copter: link cut",
            Told(K.POSE_STALE, QUAD, M.pose_stale_s),
            Sent(Hold, QUAD, M.pose_stale_s),
            Told(K.TELEMETRY_STALE, QUAD, M.telemetry_stale_s),
            Told(K.POSE_LOST, QUAD, M.pose_lost_s),
            Sent(Land, QUAD, M.pose_lost_s),
            Told(K.LINK_LOST, QUAD, M.link_lost_s),
            Asked(0, None, M.link_lost_s + AGAIN_S),
            Really("stops by its own failsafe", QUAD, hovers, OFFBOARD_S + 5.0),
            Really("is down by its own failsafe", QUAD, down, 60.0),
            do=lambda: f.modify([QUAD], lost=True),
        )
        yield from f.until(lambda: f.moving(ROVER) and f.now_s > cut.at_s + M.link_lost_s, 20.0)
        f.pull(
            "MAVLink rover: autopilot stopped",
            Told(K.POSE_STALE, ROVER, M.pose_stale_s),
            Sent(Hold, ROVER, M.pose_stale_s),
            Told(K.TELEMETRY_STALE, ROVER, M.telemetry_stale_s),
            Told(K.LINK_LOST, ROVER, M.link_lost_s),
            Asked(None, 0, M.link_lost_s + AGAIN_S),
            Really("stands", ROVER, stands, ROVER_STOPS_S),
            do=lambda: f.signal(ROVER, signal.SIGSTOP),
        )
        yield from f.until(lambda: all(p.complete for p in f.pulls.values()), 90.0)

    with nothing_left():
        return flown(field(), PLAN, script)


@pytest.mark.parametrize("plug", ["MAVLink copter: link cut", "MAVLink rover: autopilot stopped"])
def test_links(links_cut: Flight, plug: str) -> None:
    assert plug in links_cut.pulls, links_cut.story()
    links_cut.pulls[plug].check()


def test_nobody_else_is_harmed(links_cut: Flight) -> None:
    links_cut.nobody_is_harmed(ROVER)  # whose process does not run any more
    assert links_cut.outcome.state.over
    assert all(links_cut.outcome.state.visited), links_cut.story()
