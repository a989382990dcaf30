"""MAVLink drivers and simulated vehicles over real sockets: faults, refusals, signing, liveness, clean ends."""

from __future__ import annotations

import logging
import os
import pty
import select
import socket
import threading
import tty
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.limits import PoseBook, UavLimits, UgvLimits
from drivers.mavlink import MavlinkUav, MavlinkUgv, TelemetryPoses
from drivers.mavlink_options import MavlinkOptions
from drivers.vehicle import Arm, Dock, Drive, GoTo, Land, Pose, StopMotors, TakeOff
from sim_backends.wire.world import Modifiers
from tests.drivers.mavlink_team import CONFIG, Team, WorldPoses, start, stop, team

pytestmark = pytest.mark.wire
KEY = bytes(range(7, 39))
LIMITS = UavLimits(3.0, 3.0, 1.5, 1.5, 20.0)


def copter(endpoint: str, sysid: int = 1, options: MavlinkOptions | None = None) -> MavlinkUav:
    return MavlinkUav(
        f"uav{sysid}", endpoint, body=f"b{sysid}", sysid=sysid, limits=LIMITS, pads={}, book=PoseBook(), frame=None,
        clock=RealClock(), options=options or MavlinkOptions(),
    )  # fmt: skip


def connect(vehicle: MavlinkUav | MavlinkUgv, within_s: float = 20.0) -> None:
    vehicle.connect(vehicle._clock.now() + within_s)


@pytest.fixture
def alone(request: pytest.FixtureRequest) -> Iterator[int]:
    """A copter in a world of its own; its port."""
    process, port = start(["--type", "copter", *getattr(request, "param", ())])
    yield port
    stop(process)


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as s:
        s.bind(("127.0.0.1", 0))
        return int(s.getsockname()[1])


# ------------------------------------------------------------------------------------------------- connecting


def test_nobody_there_is_said_within_the_deadline() -> None:
    vehicle = copter(f"udpout:127.0.0.1:{free_port()}")
    before_s = vehicle._clock.now()
    with pytest.raises(DriverError, match=r"uav1: no heartbeat of system 1 at udpout:127.*check power"):
        connect(vehicle, 1.0)
    assert vehicle._clock.now() - before_s < 5.0
    assert not vehicle.state().link
    assert not [t for t in threading.enumerate() if t.name.startswith("mavlink")]


def test_somebody_else_is_named(alone: int) -> None:
    vehicle = copter(f"udpout:127.0.0.1:{alone}", sysid=7)
    with pytest.raises(DriverError, match=r"system 7 .* heard system 1 \(PX4 quadrotor\)"):
        connect(vehicle, 4.0)


def test_a_copter_is_no_rover(alone: int) -> None:
    vehicle = MavlinkUgv(
        "ugv0", f"udpout:127.0.0.1:{alone}", body="b", sysid=1, limits=UgvLimits(1.0, 1.0), book=PoseBook(), frame=None,
        clock=RealClock(),
    )  # fmt: skip
    with pytest.raises(DriverError, match=r"ugv0: system 1 .* is a PX4 quadrotor, not a rover"):
        connect(vehicle)


@pytest.mark.parametrize(
    "endpoint", ["udp", "udpin:nowhere:x", "carrier pigeon", "tcp:127.0.0.1:1", "/dev/ttyNothing", "udpin:1.2.3.4:0"]
)
def test_unusable_endpoints_are_errors_that_name_them(endpoint: str) -> None:
    with pytest.raises(DriverError, match="uav1: MAVLink endpoint"):
        connect(copter(endpoint), 1.0)


def test_our_own_system_id_is_refused() -> None:
    with pytest.raises(DriverError, match="255"):
        copter("udpin:127.0.0.1:0", sysid=255)


def test_poses_by_telemetry_need_the_globe() -> None:
    with pytest.raises(DriverError, match="uav1"):
        TelemetryPoses([copter("udpin:127.0.0.1:0")])


def test_several_vehicles_share_an_endpoint_and_its_thread() -> None:
    port = free_port()
    arguments = ["--type", "copter", "--out", f"127.0.0.1:{port}"]
    started = [start([*arguments, "--sysid", str(k)]) for k in (1, 2, 3)]
    vehicles = [copter(f"udpin:127.0.0.1:{port}", sysid=k) for k in (1, 2, 3)]
    try:
        for vehicle in vehicles:
            connect(vehicle)
        assert len([t for t in threading.enumerate() if t.name.startswith("mavlink")]) == 1
        assert all(v.state().link for v in vehicles)
        with pytest.raises(DriverError, match="two vehicles have the system id 2"):
            connect(copter(f"udpin:127.0.0.1:{port}", sysid=2))
        vehicles[0].close()
        assert vehicles[1].state().link, "the others stay"
    finally:
        for vehicle in vehicles:
            vehicle.close()
        for process, _ in started:
            stop(process)
    assert not [t for t in threading.enumerate() if t.name.startswith("mavlink")]


def test_speaks_tcp() -> None:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        port = s.getsockname()[1]
    process, _ = start(["--type", "copter", "--tcp", str(port)])
    vehicle = copter(f"tcp:127.0.0.1:{port}")
    try:
        connect(vehicle)
        assert vehicle.state().link
        assert next(f for f in vehicle.self_checks() if f.name == "firmware").verdict == "pass"
    finally:
        vehicle.close()
        stop(process)


def test_speaks_over_a_serial_line(alone: int) -> None:
    """The other end of a pseudo-terminal is bridged to the vehicle's socket."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    over = threading.Event()

    def bridge() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            wire.connect(("127.0.0.1", alone))
            while not over.is_set():
                ready, _, _ = select.select([ours, wire], [], [], 0.1)
                if ours in ready:
                    wire.send(os.read(ours, 65535))
                if wire in ready:
                    os.write(ours, wire.recv(65535))

    thread = threading.Thread(target=bridge)
    thread.start()
    vehicle = copter(f"{os.ttyname(theirs)}:57600")
    try:
        connect(vehicle)
        assert vehicle.state().link
        assert next(f for f in vehicle.self_checks() if f.name == "firmware").verdict == "pass"
    finally:
        vehicle.close()
        over.set()
        thread.join()
        os.close(ours)
        os.close(theirs)


# ---------------------------------------------------------------------------------------------------- signing


def signed(tmp_path: Path, key: bytes = KEY) -> MavlinkOptions:
    path = tmp_path / f"key{key[0]}"
    path.write_bytes(key)
    path.chmod(0o600)
    return MavlinkOptions(signing_key_file=path)


@pytest.mark.parametrize("alone", [("--signing-key", KEY.hex())], indirect=True)
def test_signed_vehicles_answer_only_to_the_key(alone: int, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    endpoint = f"udpout:127.0.0.1:{alone}"
    caplog.set_level(logging.DEBUG)
    with pytest.raises(DriverError, match="its packets are signed: give the same key"):
        connect(copter(endpoint), 4.0)
    with pytest.raises(DriverError, match="not signed with our key"):
        connect(copter(endpoint, options=signed(tmp_path, bytes(32))), 4.0)
    vehicle = copter(endpoint, options=signed(tmp_path))
    connect(vehicle)
    try:
        found = {f.name: f.verdict for f in vehicle.self_checks()}
        assert found["signing"] == "pass"
        assert found["firmware"] == "pass", "it answers"
        (tmp_path / f"key{KEY[0]}").chmod(0o644)
        assert {f.name: f.verdict for f in vehicle.self_checks()}["signing"] == "warn"
    finally:
        vehicle.close()
    assert KEY.hex() not in caplog.text
    assert repr(KEY) not in caplog.text


# ----------------------------------------------------------------------------------------------------- faults


@pytest.fixture(params=["px4", "ardupilot"])
def autopilot(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def test_a_dead_loop_lets_the_vehicle_land_by_itself(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=True, vehicles=("uav0",)) as made:
        h = made.harness
        h.fly()
        begun_s = h.clock.now()
        # the loop hangs: nobody calls the driver, whose thread lives on
        while made.world.body(0).airborne:
            h.clock.wait_until(h.clock.now() + 0.1)
            assert h.clock.now() - begun_s < 40.0, "it stayed up"
        print(f"{autopilot}: down {h.clock.now() - begun_s:.1f} s after the loop's last call")
        # and when the loop comes back it is there, on the ground, and stays there
        h.wait_for(lambda: h.state("uav0").link and not h.state("uav0").armed)
        h.wait(1.0)
        assert made.truth("uav0")[2] == 0.0
        assert h.state("uav0").fault is not None


def test_a_lost_link_shows_and_the_vehicle_lands_by_itself(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=True, vehicles=("uav0",)) as made:
        h = made.harness
        h.fly()
        begun_s = h.clock.now()
        made.world.modify(0, Modifiers(lost=True))
        h.wait_for(lambda: not h.state("uav0").link)
        print(f"{autopilot}: link lost after {h.clock.now() - begun_s:.1f} s")
        stamp_s = h.state("uav0").stamp_s
        assert stamp_s <= begun_s + 1.0, "stamps are of the receipt"
        h.wait_for(lambda: not made.world.body(0).airborne, 20.0)
        print(f"{autopilot}: down after {h.clock.now() - begun_s:.1f} s")
        made.world.modify(0, Modifiers())
        h.wait_for(lambda: h.state("uav0").link and not h.state("uav0").armed)
        assert made.truth("uav0")[2] == 0.0, "it did not take off again"


def test_a_silent_vehicle_still_obeys(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=True, vehicles=("uav0",)) as made:
        h = made.harness
        h.fly()
        made.world.modify(0, Modifiers(silent=True))
        h.wait_for(lambda: h.clock.now() - h.state("uav0").stamp_s > 1.3)
        h.vehicles["uav0"].send(Land("uav0", 1.0))
        h.wait_for(lambda: not made.world.body(0).airborne)
        h.wait_for(lambda: not made.world.body(0).armed)


def test_a_killed_vehicle_shows_and_everything_ends_cleanly(tmp_path: Path) -> None:
    with team(tmp_path, "px4", outdoors=True, vehicles=("uav0",)) as made:
        h = made.harness
        h.fly()
        made.kill("uav0")
        h.wait_for(lambda: not h.state("uav0").link)
        h.vehicles["uav0"].send(Land("uav0", 1.0))
        h.wait(0.5)
        h.vehicles["uav0"].close()
        assert not [t for t in threading.enumerate() if t.name.startswith("mavlink")]


def test_thirty_percent_loss_is_flown_through(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=False, vehicles=("uav0",)) as made:
        h = made.harness
        made.world.modify(0, Modifiers(loss=0.3))
        x, y, z = h.fly()
        h.vehicles["uav0"].send(GoTo("uav0", (x + 2.0, y, z), 1.0))
        h.wait_for(lambda: h.distance("uav0", (x + 2.0, y, z)) < 0.2)
        h.vehicles["uav0"].send(Land("uav0", 1.0))
        h.wait_for(lambda: not h.state("uav0").airborne and not h.state("uav0").armed)
        radio = next(f for f in h.vehicles["uav0"].self_checks() if f.name == "radio")
        assert radio.value is not None
        assert 0.1 < radio.value < 0.4


def test_an_emergency_stop_gets_through_losses(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=False, vehicles=("uav0",)) as made:
        h = made.harness
        h.fly()
        made.world.modify(0, Modifiers(loss=0.6))
        begun_s = h.clock.now()
        h.vehicles["uav0"].send(StopMotors("uav0"))
        while made.world.body(0).armed:
            h.clock.wait_until(h.clock.now() + 0.02)
            assert h.clock.now() - begun_s < 6.0
        print(f"{autopilot}: motors off {h.clock.now() - begun_s:.2f} s after the command at 60 % loss")
        h.wait_for(lambda: h.state("uav0").locked)
        assert not h.state("uav0").armed


def test_a_refused_arming_says_why(autopilot: str, tmp_path: Path) -> None:
    low = replace(CONFIG, uavs=(replace(CONFIG.uavs[0], energy_j=0.0),))
    with team(tmp_path, autopilot, outdoors=True, vehicles=("uav0",), config=low) as made:
        h = made.harness
        h.vehicles["uav0"].send(Arm("uav0"))
        h.wait_for(lambda: "attery" in (h.state("uav0").fault or ""))
        assert "arming refused" in (h.state("uav0").fault or "")
        assert not h.state("uav0").armed


def test_a_docking_beside_the_contact_climbs_out_again(autopilot: str, tmp_path: Path) -> None:
    half = replace(CONFIG, uavs=(replace(CONFIG.uavs[0], energy_j=140_000.0),))
    with team(tmp_path, autopilot, outdoors=False, config=half) as made:
        h = made.harness
        h.fly()
        made.world.modify(0, Modifiers(dock_miss=1))
        over = made.world.pad_m(1, 0)
        h.vehicles["uav0"].send(GoTo("uav0", (over[0], over[1], 1.5), 1.2))
        h.wait_for(lambda: h.distance("uav0", (over[0], over[1], 1.5)) < 0.15)
        h.vehicles["uav0"].send(Dock("uav0", "ugv0", 0, 0.6, 2.0))
        h.wait_for(lambda: not h.state("uav0").airborne)
        h.wait_for(lambda: h.state("uav0").airborne and h.pose("uav0").position_m[2] > 1.8)
        assert "dock missed" in (h.state("uav0").fault or "")
        h.vehicles["uav0"].send(Dock("uav0", "ugv0", 0, 0.6, 2.0))
        h.wait_for(lambda: h.state("uav0").charging)
        assert h.state("uav0").fault is None


def test_a_rover_stands_when_its_pose_is_stale(autopilot: str, tmp_path: Path) -> None:
    with team(tmp_path, autopilot, outdoors=False, vehicles=("ugv0",)) as made:
        h = made.harness
        h.arm("ugv0")
        h.vehicles["ugv0"].send(Drive("ugv0", ((0.0, 1.5), (4.0, 1.5)), 0.8))
        h.wait_for(lambda: h.pose("ugv0").position_m[0] > 0.5)
        assert isinstance(h.poses, WorldPoses)
        h.poses.hidden = {"ugv0"}
        row = made.world.row("ugv0")
        h.wait_for(lambda: made.world.body(row).speed_mps < 0.02)
        stood = made.truth("ugv0")
        h.wait(1.0)
        assert made.truth("ugv0") == pytest.approx(stood, abs=0.02)
        h.poses.hidden = set()
        h.wait_for(lambda: h.distance("ugv0", (4.0, 1.5, 0.0)) < 0.2)


def test_both_drive_in_one_world(tmp_path: Path) -> None:
    with team(tmp_path, "px4", outdoors=True) as made:
        h = made.harness
        drive_and_fly(made)
        assert isinstance(h.poses, TelemetryPoses)
        for name in ("uav0", "ugv0"):
            assert h.pose(name).position_m == pytest.approx(made.truth(name), abs=0.15), "telemetry is the truth"
            assert isinstance(h.pose(name), Pose)


def drive_and_fly(made: Team) -> None:
    h = made.harness
    h.arm("ugv0")
    h.fly()
    h.vehicles["ugv0"].send(Drive("ugv0", ((0.0, 1.5), (1.5, 1.5)), 0.8))
    h.vehicles["uav0"].send(GoTo("uav0", (1.5, 0.0, 1.5), 1.0))
    h.wait_for(lambda: h.distance("ugv0", (1.5, 1.5, 0.0)) < 0.2 and h.distance("uav0", (1.5, 0.0, 1.5)) < 0.2)
    h.vehicles["uav0"].send(TakeOff("uav0", 2.0, 1.0))
    h.wait_for(lambda: h.distance("uav0", (1.5, 0.0, 2.0)) < 0.2)


def test_heights_are_right_for_who_starts_on_a_pad(autopilot: str, tmp_path: Path) -> None:
    aboard = replace(CONFIG, uavs=(replace(CONFIG.uavs[0], on="ugv0"),))
    with team(tmp_path, autopilot, outdoors=True, config=aboard) as made:
        h = made.harness
        h.wait_for(lambda: abs(h.pose("uav0").position_m[2] - 0.3) < 0.1)
        h.fly()
        h.wait_for(lambda: abs(made.truth("uav0")[2] - 1.5) < 0.15)
        h.vehicles["uav0"].send(Dock("uav0", "ugv0", 0, 0.6, 2.0))
        h.wait_for(lambda: h.state("uav0").charging)
