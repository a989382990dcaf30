"""The one contract that every driver and every backend keeps.

A test module derives from ``UavContract``, ``UgvContract`` or ``DockContract`` and gives a fixture ``harness``. Nothing
here knows what is behind it: time passes only through the clock, vehicles show only their states and poses.
"""

from __future__ import annotations

import importlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field

import pytest

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.vehicle import (
    Arm,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Land,
    Pose,
    PoseSource,
    StopMotors,
    TakeOff,
    Vec2,
    Vec3,
    Vehicle,
    VehicleState,
)


@dataclass
class Harness:
    """One team on its clock, plus the sizes that suit it.

    Attributes:
        bodies: motion-capture name of each vehicle id.
        uav, ugv: the ids under test; the UAV stands on the floor, away from the UGV.
        altitude_m, leg_m: how high and how far the tests fly; they drive as far.
        speed_mps: commanded speeds.
        tolerance_m: how near is there.
        pad_offset_m: dock 0 of the UGV in its body frame.
        pad_height_m: height of the docks.
        timeout_s: longest wait for anything.
    """

    vehicles: dict[str, Vehicle]
    poses: PoseSource
    clock: Clock
    bodies: dict[str, str]
    uav: str = "uav0"
    ugv: str = "ugv0"
    altitude_m: float = 10.0
    leg_m: float = 30.0
    speed_mps: float = 5.0
    tolerance_m: float = 0.5
    pad_offset_m: Vec2 = (0.0, 0.0)
    pad_height_m: float = 0.5
    timeout_s: float = 60.0
    seen: dict[str, Pose] = field(default_factory=dict)

    def connect(self) -> None:
        self.poses.connect(self.clock.now() + self.timeout_s)
        for vehicle in self.vehicles.values():
            vehicle.connect(self.clock.now() + self.timeout_s)
        self.wait_for(lambda: all(body in self.seen for body in self.bodies.values()))
        self.wait(1.0)

    def turn(self, until_s: float) -> None:
        """One turn of a loop as it really runs: let time pass, read poses, feed them."""
        self.clock.wait_until(min(until_s, self.clock.now() + 0.1))
        for pose in self.poses.read():
            self.seen[pose.body] = pose
            for vehicle, body in self.bodies.items():
                if body == pose.body:
                    self.vehicles[vehicle].feed_pose(pose)

    def wait(self, duration_s: float) -> None:
        end_s = self.clock.now() + duration_s
        while self.clock.now() < end_s:
            self.turn(end_s)

    def wait_for(self, condition: Callable[[], bool], timeout_s: float | None = None) -> None:
        end_s = self.clock.now() + (self.timeout_s if timeout_s is None else timeout_s)
        while not condition():
            assert self.clock.now() < end_s, "it did not happen in time"
            self.turn(end_s)

    def pose(self, vehicle: str) -> Pose:
        return self.seen[self.bodies[vehicle]]

    def state(self, vehicle: str) -> VehicleState:
        return self.vehicles[vehicle].state()

    def distance(self, vehicle: str, to: Vec3) -> float:
        return math.dist(self.pose(vehicle).position_m, to)

    def arm(self, vehicle: str) -> None:
        self.vehicles[vehicle].send(Arm(vehicle))
        self.wait_for(lambda: self.state(vehicle).armed)

    def fly(self) -> Vec3:
        """Brings the UAV up; returns where it hovers."""
        self.arm(self.uav)
        x, y, _ = self.pose(self.uav).position_m
        self.vehicles[self.uav].send(TakeOff(self.uav, self.altitude_m, self.speed_mps))
        there = (x, y, self.altitude_m)
        self.wait_for(lambda: self.distance(self.uav, there) < self.tolerance_m)
        self.wait_for(lambda: self.state(self.uav).airborne)
        return there

    def is_still(self, vehicle: str, during_s: float = 2.0) -> bool:
        before = self.pose(vehicle).position_m
        self.wait(during_s)
        return self.distance(vehicle, before) < 2 * self.tolerance_m


class CommonContract:
    """What UAVs and UGVs have in common; ``vehicle_id`` says who is meant."""

    @pytest.fixture
    def vehicle_id(self, harness: Harness) -> str:
        raise NotImplementedError

    def test_has_an_id_and_a_kind(self, harness: Harness, vehicle_id: str) -> None:
        vehicle = harness.vehicles[vehicle_id]
        assert vehicle.id == vehicle_id == vehicle.state().vehicle
        assert vehicle.kind in ("uav", "ugv")

    def test_is_not_armed_by_connecting(self, harness: Harness, vehicle_id: str) -> None:
        assert harness.state(vehicle_id).link
        assert not harness.state(vehicle_id).armed

    def test_arming_and_disarming_show_in_the_state(self, harness: Harness, vehicle_id: str) -> None:
        harness.arm(vehicle_id)
        harness.vehicles[vehicle_id].send(Disarm(vehicle_id))
        harness.wait_for(lambda: not harness.state(vehicle_id).armed)

    def test_stamps_advance_with_time_and_never_run_ahead(self, harness: Harness, vehicle_id: str) -> None:
        before = harness.state(vehicle_id).stamp_s
        assert harness.state(vehicle_id).stamp_s == before, "asking must not change anything"
        harness.wait(2.0)
        after = harness.state(vehicle_id).stamp_s
        assert before < after <= harness.clock.now()

    def test_poses_are_stamped_and_finite(self, harness: Harness, vehicle_id: str) -> None:
        before = harness.pose(vehicle_id)
        harness.wait(1.0)
        pose = harness.pose(vehicle_id)
        assert before.stamp_s < pose.stamp_s <= harness.clock.now()
        assert all(map(math.isfinite, (*pose.position_m, pose.yaw_rad, pose.stamp_s)))

    def test_each_pose_is_read_once(self, harness: Harness, vehicle_id: str) -> None:
        harness.wait(0.5)
        first = harness.poses.read()
        assert not {(p.body, p.stamp_s) for p in first} & {(p.body, p.stamp_s) for p in harness.poses.read()}

    def test_its_last_will_can_be_told_to_another_process(self, harness: Harness, vehicle_id: str) -> None:
        will = harness.vehicles[vehicle_id].last_will()
        if will is None:
            return  # it ends with this program
        assert will.vehicle == vehicle_id
        assert json.loads(json.dumps(will.arguments)) == will.arguments
        assert callable(importlib.import_module(will.module).carry_out)

    def test_self_checks_are_sound_and_arm_nothing(self, harness: Harness, vehicle_id: str) -> None:
        findings = harness.vehicles[vehicle_id].self_checks()
        assert not [f for f in findings if f.verdict == "fail"]
        assert len({f.name for f in findings}) == len(findings)
        assert all(f.text and f.verdict in ("pass", "warn", "not run") for f in findings)
        assert not harness.state(vehicle_id).armed

    def test_refuses_a_command_for_another(self, harness: Harness, vehicle_id: str) -> None:
        with pytest.raises(DriverError, match=vehicle_id):
            harness.vehicles[vehicle_id].send(Arm("somebody else"))

    def test_arming_twice_is_arming(self, harness: Harness, vehicle_id: str) -> None:
        harness.arm(vehicle_id)
        harness.vehicles[vehicle_id].send(Arm(vehicle_id))
        harness.wait(1.0)
        assert harness.state(vehicle_id).armed

    def test_stop_works_unarmed_and_locks(self, harness: Harness, vehicle_id: str) -> None:
        harness.vehicles[vehicle_id].send(StopMotors(vehicle_id))
        harness.wait_for(lambda: harness.state(vehicle_id).locked)
        harness.vehicles[vehicle_id].send(Arm(vehicle_id))
        harness.wait(1.0)
        assert not harness.state(vehicle_id).armed

    def test_hold_on_the_ground_changes_nothing(self, harness: Harness, vehicle_id: str) -> None:
        harness.arm(vehicle_id)
        harness.vehicles[vehicle_id].send(Hold(vehicle_id))
        assert harness.is_still(vehicle_id)
        assert not harness.state(vehicle_id).airborne

    def test_closing_twice_is_closing(self, harness: Harness, vehicle_id: str) -> None:
        harness.vehicles[vehicle_id].close()
        harness.vehicles[vehicle_id].close()
        assert not harness.state(vehicle_id).link
        with pytest.raises(DriverError, match=vehicle_id):
            harness.vehicles[vehicle_id].send(Arm(vehicle_id))
        harness.poses.close()
        harness.poses.close()


class UavContract(CommonContract):
    """Every UAV."""

    @pytest.fixture
    def vehicle_id(self, harness: Harness) -> str:
        return harness.uav

    def test_nothing_moves_until_armed(self, harness: Harness) -> None:
        uav, start = harness.uav, harness.pose(harness.uav).position_m
        harness.vehicles[uav].send(TakeOff(uav, harness.altitude_m, harness.speed_mps))
        harness.vehicles[uav].send(GoTo(uav, (start[0] + harness.leg_m, start[1], harness.altitude_m), 1.0))
        assert harness.is_still(uav, 3.0)
        assert not harness.state(uav).airborne

    def test_refuses_to_drive(self, harness: Harness) -> None:
        with pytest.raises(DriverError, match=harness.uav):
            harness.vehicles[harness.uav].send(Drive(harness.uav, ((0.0, 0.0),), 1.0))

    def test_refuses_numbers_that_are_none(self, harness: Harness) -> None:
        for command in (
            GoTo(harness.uav, (math.nan, 0.0, harness.altitude_m), 1.0),
            GoTo(harness.uav, (0.0, 0.0, harness.altitude_m), math.inf),
            TakeOff(harness.uav, math.inf, 1.0),
            Land(harness.uav, 0.0),
        ):
            with pytest.raises(DriverError, match=harness.uav):
                harness.vehicles[harness.uav].send(command)

    def test_take_off_reaches_its_altitude_vertically(self, harness: Harness) -> None:
        there = harness.fly()
        harness.wait(2.0)
        assert harness.distance(harness.uav, there) < harness.tolerance_m

    def test_says_what_it_really_sent(self, harness: Harness) -> None:
        there = harness.fly()
        sent = harness.vehicles[harness.uav].send(GoTo(harness.uav, there, 1e6))
        assert isinstance(sent, GoTo)
        assert 0 < sent.speed_mps < 1e6

    def test_goes_there_no_faster_than_told(self, harness: Harness) -> None:
        x, y, z = harness.fly()
        speed, uav = 0.5 * harness.speed_mps, harness.uav
        harness.vehicles[uav].send(GoTo(uav, (x + harness.leg_m, y, z), speed))
        start_s, track = harness.clock.now(), [harness.pose(uav)]
        while harness.distance(uav, (x + harness.leg_m, y, z)) > harness.tolerance_m:
            harness.wait(0.1)
            track.append(harness.pose(uav))
            assert harness.clock.now() - start_s < harness.timeout_s
        assert all(abs(p.position_m[1] - y) < harness.tolerance_m for p in track), "straight"
        assert all(abs(p.position_m[2] - z) < harness.tolerance_m for p in track), "level"
        for early, late in zip(track, track[10:], strict=False):
            most = speed * (late.stamp_s - early.stamp_s) + harness.tolerance_m
            assert math.dist(early.position_m, late.position_m) <= most
        assert harness.is_still(uav)

    def test_a_repeated_command_changes_nothing(self, harness: Harness) -> None:
        x, y, z = harness.fly()
        uav, there = harness.uav, (x + harness.leg_m, y, z)
        end_s = harness.clock.now() + harness.timeout_s
        while harness.distance(uav, there) > harness.tolerance_m:
            harness.vehicles[uav].send(GoTo(uav, there, harness.speed_mps))
            harness.wait(0.3)
            assert harness.clock.now() < end_s
        assert harness.is_still(uav)

    def test_a_repeated_take_off_changes_nothing(self, harness: Harness) -> None:
        there = harness.fly()
        harness.vehicles[harness.uav].send(TakeOff(harness.uav, harness.altitude_m, harness.speed_mps))
        assert harness.is_still(harness.uav)
        assert harness.distance(harness.uav, there) < harness.tolerance_m

    def test_hold_brakes_and_hovers(self, harness: Harness) -> None:
        x, y, z = harness.fly()
        uav = harness.uav
        harness.vehicles[uav].send(GoTo(uav, (x + harness.leg_m, y, z), 0.5 * harness.speed_mps))
        harness.wait_for(lambda: harness.pose(uav).position_m[0] > x + 0.3 * harness.leg_m)
        harness.vehicles[uav].send(Hold(uav))
        harness.wait(3.0)
        assert harness.is_still(uav, 3.0)
        assert harness.pose(uav).position_m[0] < x + 0.9 * harness.leg_m
        assert harness.state(uav).airborne

    def test_disarming_in_the_air_is_refused(self, harness: Harness) -> None:
        there = harness.fly()
        harness.vehicles[harness.uav].send(Disarm(harness.uav))
        harness.wait(2.0)
        assert harness.state(harness.uav).armed
        assert harness.distance(harness.uav, there) < harness.tolerance_m

    def test_lands_where_it_is(self, harness: Harness) -> None:
        x, y, _ = harness.fly()
        harness.vehicles[harness.uav].send(Land(harness.uav, harness.speed_mps))
        harness.wait_for(lambda: not harness.state(harness.uav).airborne)
        harness.wait(1.0)
        assert harness.distance(harness.uav, (x, y, 0.0)) < harness.tolerance_m
        assert not harness.state(harness.uav).tumbled
        assert not harness.state(harness.uav).locked

    def test_flies_again_after_a_landing(self, harness: Harness) -> None:
        harness.fly()
        harness.vehicles[harness.uav].send(Land(harness.uav, harness.speed_mps))
        harness.wait_for(lambda: not harness.state(harness.uav).airborne)
        harness.wait(1.0)
        harness.fly()

    def test_emergency_stop_in_the_air_stops_the_motors(self, harness: Harness) -> None:
        harness.fly()
        uav = harness.uav
        harness.vehicles[uav].send(StopMotors(uav))
        harness.wait_for(lambda: harness.state(uav).locked and not harness.state(uav).airborne, 10.0)
        harness.wait_for(lambda: harness.pose(uav).position_m[2] < harness.tolerance_m, 10.0)
        for command in (Arm(uav), TakeOff(uav, harness.altitude_m, harness.speed_mps)):
            harness.vehicles[uav].send(command)
        harness.wait(3.0)
        state = harness.state(uav)
        assert state.locked
        assert not state.armed
        assert not state.airborne
        assert harness.pose(uav).position_m[2] < harness.tolerance_m


class UgvContract(CommonContract):
    """Every UGV."""

    @pytest.fixture
    def vehicle_id(self, harness: Harness) -> str:
        return harness.ugv

    def path(self, harness: Harness) -> tuple[Vec2, ...]:
        x, y, _ = harness.pose(harness.ugv).position_m
        return ((x, y), (x + harness.leg_m, y), (x + harness.leg_m, y + 0.5 * harness.leg_m))

    def drive(self, harness: Harness) -> Vec3:
        path = self.path(harness)
        harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, harness.speed_mps))
        return (*path[-1], harness.pose(harness.ugv).position_m[2])

    def test_nothing_moves_until_armed(self, harness: Harness) -> None:
        self.drive(harness)
        assert harness.is_still(harness.ugv, 3.0)

    def test_refuses_to_fly(self, harness: Harness) -> None:
        for command in (TakeOff(harness.ugv, 1.0, 1.0), Land(harness.ugv, 1.0)):
            with pytest.raises(DriverError, match=harness.ugv):
                harness.vehicles[harness.ugv].send(command)

    def test_refuses_numbers_that_are_none(self, harness: Harness) -> None:
        for path, speed in (((), 1.0), (((math.nan, 0.0),), 1.0), (((0.0, 0.0),), math.nan)):
            with pytest.raises(DriverError, match=harness.ugv):
                harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, speed))

    def test_follows_its_path_and_stops_at_the_end(self, harness: Harness) -> None:
        path = self.path(harness)
        harness.arm(harness.ugv)
        end = self.drive(harness)
        start_s, passed_corner = harness.clock.now(), False
        while harness.distance(harness.ugv, end) > harness.tolerance_m:
            harness.wait(0.1)
            x, y, _ = harness.pose(harness.ugv).position_m
            near = min(abs(y - path[0][1]), abs(x - path[1][0]))
            assert near < harness.tolerance_m, f"off the path by {near} m"
            passed_corner |= math.dist((x, y), path[1]) < 2 * harness.tolerance_m
            assert harness.clock.now() - start_s < harness.timeout_s
        assert passed_corner
        assert harness.is_still(harness.ugv)

    def test_hold_brakes_and_the_same_path_goes_on(self, harness: Harness) -> None:
        harness.arm(harness.ugv)
        start, path = harness.pose(harness.ugv).position_m, self.path(harness)
        end = (*path[-1], start[2])
        harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, harness.speed_mps))
        harness.wait_for(lambda: harness.distance(harness.ugv, start) > 0.3 * harness.leg_m)
        harness.vehicles[harness.ugv].send(Hold(harness.ugv))
        harness.wait(3.0)
        assert harness.is_still(harness.ugv)
        assert harness.distance(harness.ugv, end) > harness.tolerance_m
        harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, harness.speed_mps))
        harness.wait_for(lambda: harness.distance(harness.ugv, end) < harness.tolerance_m)

    def test_a_repeated_command_changes_nothing(self, harness: Harness) -> None:
        harness.arm(harness.ugv)
        path = self.path(harness)
        end = (*path[-1], harness.pose(harness.ugv).position_m[2])
        end_s = harness.clock.now() + harness.timeout_s
        while harness.distance(harness.ugv, end) > harness.tolerance_m:
            harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, harness.speed_mps))
            harness.wait(0.5)
            assert harness.clock.now() < end_s
        harness.vehicles[harness.ugv].send(Drive(harness.ugv, path, harness.speed_mps))
        assert harness.is_still(harness.ugv)

    def test_emergency_stop_stops_and_locks(self, harness: Harness) -> None:
        ugv, start = harness.ugv, harness.pose(harness.ugv).position_m
        harness.arm(ugv)
        end = self.drive(harness)
        harness.wait_for(lambda: harness.distance(ugv, start) > 0.2 * harness.leg_m)
        harness.vehicles[ugv].send(StopMotors(ugv))
        harness.wait_for(lambda: harness.state(ugv).locked)
        harness.wait(2.0)
        harness.vehicles[ugv].send(Arm(ugv))
        self.drive(harness)
        assert harness.is_still(ugv)
        assert not harness.state(ugv).armed
        assert harness.distance(ugv, end) > harness.tolerance_m


class DockContract:
    """A UAV and a UGV that charges it."""

    def over_the_pad(self, harness: Harness) -> Vec3:
        pose = harness.pose(harness.ugv)
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        ox, oy = harness.pad_offset_m
        x, y = pose.position_m[0] + c * ox - s * oy, pose.position_m[1] + s * ox + c * oy
        return (x, y, harness.altitude_m)

    def dock(self, harness: Harness) -> Vec3:
        """Flies to the pad and docks; returns the pad's place."""
        harness.fly()
        uav, over = harness.uav, self.over_the_pad(harness)
        harness.vehicles[uav].send(GoTo(uav, over, harness.speed_mps))
        harness.wait_for(lambda: harness.distance(uav, over) < harness.tolerance_m)
        harness.wait(1.0)
        harness.vehicles[uav].send(Dock(uav, harness.ugv, 0, 0.5 * harness.speed_mps, harness.altitude_m))
        harness.wait_for(lambda: harness.state(uav).charging)
        return (over[0], over[1], harness.pad_height_m)

    def test_docks_charges_and_takes_off_again(self, harness: Harness) -> None:
        pad = self.dock(harness)
        assert not harness.state(harness.uav).airborne
        assert harness.distance(harness.uav, pad) < harness.tolerance_m
        before = harness.state(harness.uav).battery
        harness.wait(5.0)
        after = harness.state(harness.uav).battery
        if before is not None and after is not None:
            assert after >= before
        harness.fly()
        harness.wait_for(lambda: not harness.state(harness.uav).charging)

    def test_aborts_upward_when_the_ugv_is_elsewhere(self, harness: Harness) -> None:
        x, y, z = harness.fly()
        dock = Dock(harness.uav, harness.ugv, 0, 0.5 * harness.speed_mps, z + 1.0)
        harness.vehicles[harness.uav].send(dock)
        harness.wait_for(lambda: harness.distance(harness.uav, (x, y, z + 1.0)) < harness.tolerance_m)
        harness.wait(3.0)
        assert harness.state(harness.uav).airborne
        assert not harness.state(harness.uav).charging

    def test_emergency_stop_on_the_pad_locks(self, harness: Harness) -> None:
        pad = self.dock(harness)
        uav = harness.uav
        harness.vehicles[uav].send(StopMotors(uav))
        harness.wait_for(lambda: harness.state(uav).locked)
        for command in (Arm(uav), TakeOff(uav, harness.altitude_m, harness.speed_mps)):
            harness.vehicles[uav].send(command)
        harness.wait(3.0)
        assert harness.distance(uav, pad) < harness.tolerance_m
