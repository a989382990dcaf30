"""Every kind of plug of a lab, pulled in the air: the failsafe table's action comes in time, and nobody is harmed.

Three flights in real time over CRTP, ROS 2 and NatNet. Several plugs share one where they do not concern each other.
"""

from __future__ import annotations

import signal

import pytest
from plug_flights import Asked, Flight, Really, Script, Sent, Told, flown, mission_of
from wire_runs import nothing_left

from deploy.events import EventKind as K
from deploy.mission import Mission
from deploy.replanning import URGENT_RETRY_S
from drivers.vehicle import GoTo, Hold, Land
from planner.plan import Move, Visit
from sim_backends.wire.world import Body

pytestmark = pytest.mark.wire

UAVS = ("cf1", "cf2")
LIMO = "limo1"
EVERYBODY = (*UAVS, LIMO)
STUCK_S = 5.0
"""Less than the lab's 15 s, to be there before the flight is over; a Limo may need 3 s to turn on the spot."""
TASKS = ((140.0, -130.0), (140.0, 60.0), (-100.0, 20.0), (-100.0, 120.0), (100.0, 120.0), (100.0, -60.0))
PLAN = (
    Move(ugv=0, path_point=4),
    Visit(uav=0, task=3),
    Visit(uav=1, task=0),
    Visit(uav=0, task=4),
    Visit(uav=1, task=1),
    Visit(uav=0, task=5),
    Visit(uav=1, task=2),
)


def lab() -> Mission:
    steady = {"replanning": {"loss_ratio": 10.0, "loss_s": 1e4}, "separation.buffer_m": 0.05}  # only plugs replan
    return mission_of("lab", EVERYBODY, TASKS, monitors__ugv_stuck_s=STUCK_S, **steady)


M = lab().settings.monitors
AGAIN_S = URGENT_RETRY_S + M.planner_late_s
"""A replan waits for the one under way, and an urgent one comes so long after the last."""
BRAKE_S = 1.5
"""From cruise to rest: 0.4 m/s at 1 m/s^2, after the command has arrived; a polynomial stops gently."""
BLIND_S = 4.0
"""The same without poses: as quickly as it may, while its estimate still knows about where the floor is."""
DOWN_S = 12.0
"""From the highest layer, 1.2 m: the firmware's polynomial is 2.19 times as fast at its middle as its mean, 0.3 m/s."""


def still(body: Body) -> bool:
    return body.airborne and max(map(abs, body.velocity_mps)) < 0.1


def stands(body: Body) -> bool:
    return body.speed_mps < 0.02


def down(body: Body) -> bool:
    return not body.airborne


@pytest.fixture(scope="module")
def poses_fail() -> Flight:
    """Motion capture is frozen, swapped and stopped, each for a moment; then it is gone for good."""

    def script(f: Flight) -> Script:
        yield from f.until(lambda: f.moving(*EVERYBODY))
        frozen = f.pull(
            "motion capture frozen",
            *(Told(K.POSE_FROZEN, v, M.pose_frozen_s) for v in EVERYBODY),
            *(Sent(Hold, v, M.pose_stale_s) for v in EVERYBODY),
            *(Really("hovers", v, still, M.pose_stale_s + BRAKE_S) for v in UAVS),
            Really("stands", LIMO, stands, M.pose_stale_s + BRAKE_S),
            do=lambda: f.modify(EVERYBODY, freeze=True),
        )
        yield from f.until(lambda: f.now_s > frozen.at_s + 0.8)
        f.modify(EVERYBODY, freeze=False)
        again = f.pull("motion capture seen again after a freeze", *(Sent(GoTo, v, 2.0) for v in UAVS), do=lambda: None)
        yield from f.after(again)
        yield from f.until(lambda: f.steady(*UAVS), 5.0)
        swapped = f.pull(
            "two bodies swapped",
            *(Told(K.POSE_SWAP, v, 0.0) for v in UAVS),
            *(Sent(Hold, v, 0.0) for v in UAVS),
            *(Really("hovers", v, still, BRAKE_S) for v in UAVS),
            do=lambda: swap(f, *UAVS),
        )
        yield from f.until(lambda: f.now_s > swapped.at_s + 0.8)
        f.modify(UAVS, swap=-1)
        again = f.pull("two bodies swapped back", *(Sent(GoTo, v, 2.0) for v in UAVS), do=lambda: None)
        yield from f.after(again)
        yield from f.until(lambda: f.steady(*UAVS), 5.0)
        stopped = f.pull(
            "NatNet server stopped for a moment",
            *(Told(K.POSE_STALE, v, M.pose_stale_s) for v in EVERYBODY),
            *(Sent(Hold, v, M.pose_stale_s) for v in UAVS),
            *(Really("hovers", v, still, M.pose_stale_s + BRAKE_S) for v in UAVS),
            do=lambda: f.signal("motion capture", signal.SIGSTOP),
        )
        yield from f.until(lambda: f.now_s > stopped.at_s + 0.7)
        f.signal("motion capture", signal.SIGCONT)
        again = f.pull("NatNet server runs again", *(Sent(GoTo, v, 2.0) for v in UAVS), do=lambda: None)
        yield from f.after(again)
        yield from f.until(lambda: f.steady(*UAVS), 5.0)
        killed = f.pull(
            "NatNet server killed",
            *(Told(K.POSE_STALE, v, M.pose_stale_s) for v in UAVS),
            *(Sent(Hold, v, M.pose_stale_s) for v in UAVS),
            *(Told(K.POSE_LOST, v, M.pose_lost_s) for v in UAVS),
            *(Sent(Land, v, M.pose_lost_s) for v in UAVS),
            *(Really("is down", v, down, M.pose_lost_s + BLIND_S) for v in UAVS),
            do=lambda: f.signal("motion capture", signal.SIGKILL),
        )
        yield from f.after(killed)

    with nothing_left():
        return flown(lab(), PLAN, script)


def swap(flight: Flight, one: str, other: str) -> None:
    world = flight.simulation.world
    flight.modify([one], swap=world.row(other))
    flight.modify([other], swap=world.row(one))


@pytest.fixture(scope="module")
def links_suffer() -> Flight:
    """Both radios lose 30 % of their packets, each way, and the Limo is stuck for a while."""

    def script(f: Flight) -> Script:
        yield from f.until(lambda: f.moving(*EVERYBODY))
        f.age_s = 0.0
        lossy = f.pull("radio loses 30 %", do=lambda: f.modify(UAVS, loss=0.3))
        stuck = f.pull(
            "Limo stuck",
            Told(K.UGV_STUCK, LIMO, STUCK_S),
            Asked(None, 0, STUCK_S + AGAIN_S),
            do=lambda: f.modify([LIMO], slow=0.0),
        )
        yield from f.after(stuck)
        f.modify([LIMO], slow=1.0)
        free = f.pull("Limo free again", Told(K.RECOVERED_FROM, LIMO, 3.0), do=lambda: None)
        yield from f.after(free)
        yield from f.until(lambda: all(f.phases[v] == "down" for v in UAVS))
        lossy.notes["oldest_telemetry_s"] = f.age_s

    with nothing_left():
        return flown(lab(), PLAN, script)


@pytest.fixture(scope="module")
def vehicles_fail() -> Flight:
    """The Limo's node is killed, then a Crazyflie; then the other one falls silent."""

    def script(f: Flight) -> Script:
        yield from f.until(lambda: f.moving(*EVERYBODY))
        limo = f.pull(
            "Limo node killed",
            Told(K.TELEMETRY_STALE, LIMO, M.telemetry_stale_s),
            Sent(Hold, LIMO, M.telemetry_stale_s),
            Told(K.LINK_LOST, LIMO, M.link_lost_s),
            Asked(None, 0, M.link_lost_s + AGAIN_S),
            do=lambda: f.signal(LIMO, signal.SIGKILL),
        )
        yield from f.after(limo)
        yield from f.until(lambda: f.steady(*UAVS), 10.0)
        killed = f.pull(
            "Crazyflie server killed",
            # its port is closed at once, which the operating system tells; a radio's link is lost by its silence
            Told(K.LINK_LOST, "cf1", M.link_lost_s),
            Sent(Land, "cf1", M.link_lost_s),
            Asked(0, None, M.link_lost_s + AGAIN_S),
            Told(K.UAV_DOWN, "cf1", M.link_lost_s + 2.0),
            do=lambda: f.signal("cf1", signal.SIGKILL),
        )
        yield from f.after(killed)
        yield from f.until(lambda: f.steady("cf2"), 10.0)
        silent = f.pull(
            "Crazyflie silent",
            Told(K.TELEMETRY_STALE, "cf2", M.telemetry_stale_s),
            Sent(Hold, "cf2", M.telemetry_stale_s),
            Really("hovers", "cf2", still, M.telemetry_stale_s + BRAKE_S),
            Told(K.LINK_LOST, "cf2", M.link_lost_s),
            Sent(Land, "cf2", M.link_lost_s),
            Really("is down", "cf2", down, M.link_lost_s + DOWN_S),
            do=lambda: f.modify(["cf2"], silent=True),
        )
        yield from f.after(silent)

    with nothing_left():
        return flown(lab(), PLAN, script)


@pytest.mark.parametrize(
    "plug",
    [
        "motion capture frozen",
        "motion capture seen again after a freeze",
        "two bodies swapped",
        "two bodies swapped back",
        "NatNet server stopped for a moment",
        "NatNet server runs again",
        "NatNet server killed",
    ],
)
def test_motion_capture(poses_fail: Flight, plug: str) -> None:
    assert plug in poses_fail.pulls, poses_fail.story()
    poses_fail.pulls[plug].check()


def test_nobody_is_harmed_by_motion_capture(poses_fail: Flight) -> None:
    poses_fail.nobody_is_harmed()
    assert poses_fail.finished
    assert poses_fail.outcome.state.over


@pytest.mark.parametrize("plug", ["Limo stuck", "Limo free again"])
def test_a_stuck_limo(links_suffer: Flight, plug: str) -> None:
    assert plug in links_suffer.pulls, links_suffer.story()
    links_suffer.pulls[plug].check()


def test_a_mission_whose_radios_lose_30_percent_is_completed(links_suffer: Flight) -> None:
    links_suffer.nobody_is_harmed()
    assert links_suffer.outcome.kind == "done", links_suffer.story()
    assert all(links_suffer.outcome.state.visited)
    for vehicle in UAVS:
        assert not links_suffer.kinds(vehicle) & {K.LINK_LOST, K.COMMAND_FAILED}, links_suffer.story()
    assert links_suffer.pulls["radio loses 30 %"].notes["oldest_telemetry_s"] < M.telemetry_stale_s


@pytest.mark.parametrize("plug", ["Limo node killed", "Crazyflie server killed", "Crazyflie silent"])
def test_vehicles(vehicles_fail: Flight, plug: str) -> None:
    assert plug in vehicles_fail.pulls, vehicles_fail.story()
    vehicles_fail.pulls[plug].check()


def test_nobody_else_is_harmed_by_vehicles_that_fail(vehicles_fail: Flight) -> None:
    vehicles_fail.nobody_is_harmed("cf1", LIMO)  # their processes were killed: nobody moves or stops them any more
    crashes = [v for v in vehicles_fail.truth.violations if v.kind == "crash"]
    assert [v.vehicles for v in crashes] == [("cf1",)], "a Crazyflie without its firmware falls"
    assert vehicles_fail.outcome.state.over
