"""The simulated Crazyflie flies in a world, without sockets and faster than real time."""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import pytest

from drivers.vehicle import Vec3
from sim_backends.errors import SimulationError
from sim_backends.wire.crazyflie_body import quaternion
from sim_backends.wire.crazyflie_firmware import STEP_S, CrazyflieKind, Firmware
from sim_backends.wire.crazyflie_supervisor import ARMED, CAN_FLY, CRASHED, FLYING, LOCKED, TUMBLED
from sim_backends.wire.crtp_packets import Packet, Port
from sim_backends.wire.world import BATTERY_EMPTY, DOCK_MISSED, MOTOR_FAILURE, STOPPED, Body, World, yaw_quaternion
from sim_backends.world import SimUav, SimUgv, WorldConfig

PAD_M = 0.25
UAV = SimUav("uav0", "u", (0.5, -0.5), tracking_noise_m=0.01, dock_noise_m=0.003, drift_mps=0.05)
UGV = SimUgv("ugv0", "g", (2.0, 1.0), yaw_rad=0.8, pad_height_m=PAD_M, dock_offsets_m=((0.1, 0.0),), charge_s=20.0)


class Rig:
    """A firmware with its world, fed with poses unless told otherwise."""

    def __init__(self, folder: Path, uav: SimUav = UAV, *, time_scale: float = 1.0, **kind: object) -> None:
        config = WorldConfig((uav,), (UGV,), time_scale=time_scale, dock_tolerance_m=0.05)
        self.world = World.create(folder, config)
        self.world.put(1, self.world.body(1))
        self.firmware = Firmware(self.world, 0, CrazyflieKind(**kind))  # type: ignore[arg-type]
        self.feeding = True
        self.steps = 0

    def run(self, seconds: float) -> None:
        for _ in range(round(seconds / STEP_S)):
            if self.feeding:
                self.feed(self.at())
            self.firmware.step()
            self.steps += 1

    def feed(self, at: Vec3) -> None:
        q = quaternion(*self.firmware.body.rpy)
        self.send(Port.LOCALIZATION, 1, struct.pack("<Bfffffff", 8, *at, *q))

    def send(self, port: int, channel: int, data: bytes) -> list[Packet]:
        return self.firmware.handle(Packet(port, channel, data))

    def high_level(self, data: bytes) -> int:
        return self.send(Port.SETPOINT_HL, 0, data)[0].data[3]

    def takeoff(self, height: float = 1.0, seconds: float = 2.0) -> int:
        return self.high_level(struct.pack("<BBff?f", 7, 0, height, 0.0, True, seconds))

    def land(self, height: float = 0.0, seconds: float = 2.0) -> int:
        return self.high_level(struct.pack("<BBff?f", 8, 0, height, 0.0, True, seconds))

    def go_to(self, at: Vec3, seconds: float, yaw: float = 0.0) -> int:
        return self.high_level(struct.pack("<BBBBfffff", 12, 0, 0, 0, *at, yaw, seconds))

    def hover_setpoint(self, vx: float, vy: float, z: float) -> None:
        self.send(Port.SETPOINT_GENERIC, 0, struct.pack("<Bffff", 10, vx, vy, 0.0, z))

    def fly(self, height: float = 1.0) -> None:
        self.run(1.0)
        assert self.takeoff(height) == 0
        self.run(3.0)
        assert self.at()[2] == pytest.approx(height, abs=0.05)

    def at(self) -> Vec3:
        return self.firmware.body.position_m

    def row(self) -> Body:
        return self.world.body(0)

    def info(self) -> int:
        return self.firmware.info()

    def off(self, goal: Vec3) -> float:
        return math.dist(self.at(), goal)

    def over_the_pad(self, height: float = 0.8) -> Vec3:
        x, y, _ = self.world.pad_m(1, 0)
        return (x, y, height)

    def fault(self, **changes: object) -> None:
        self.world.modify(0, replace(self.world.modifiers(0), **changes))  # type: ignore[arg-type]


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    return Rig(tmp_path)


def test_takes_off_hovers_and_lands(rig: Rig) -> None:
    rig.fly()
    assert rig.world.started_s is not None
    assert rig.info() & FLYING
    assert rig.row().airborne
    rig.run(5.0)
    assert rig.off((0.5, -0.5, 1.0)) < 0.1
    rig.land()
    rig.run(3.0)
    assert not rig.row().airborne
    assert rig.at()[2] == 0.0
    assert rig.info() & FLYING  # it lags
    rig.run(2.0)
    assert not rig.info() & (FLYING | TUMBLED | LOCKED)


@pytest.mark.parametrize("variant", ["brushed", "brushless"])
def test_go_to_takes_exactly_as_long_as_asked_however_fast(tmp_path: Path, variant: str) -> None:
    rig = Rig(tmp_path, variant=variant)
    rig.run(0.1)
    rig.send(Port.SUPERVISOR, 1, b"\1\1")
    rig.fly()
    rig.go_to((3.5, -0.5, 1.0), 3.0)
    fastest = 0.0
    for _ in range(300):
        rig.run(STEP_S)
        fastest = max(fastest, rig.row().speed_mps)
    assert rig.off((3.5, -0.5, 1.0)) < 0.15
    assert fastest == pytest.approx(2.1875, rel=0.1)
    rig.run(1.0)
    assert rig.off((3.5, -0.5, 1.0)) < 0.1


def test_it_turns_to_the_yaw_that_go_to_names(rig: Rig) -> None:
    rig.fly()
    rig.go_to((0.5, -0.5, 1.0), 2.0, yaw=-2.5)
    rig.run(3.0)
    assert rig.row().yaw_rad == pytest.approx(-2.5, abs=0.05)
    rig.go_to((1.5, 0.5, 1.0), 3.0, yaw=2.5)
    rig.run(4.0)
    assert rig.row().yaw_rad == pytest.approx(2.5, abs=0.05)
    assert rig.off((1.5, 0.5, 1.0)) < 0.1


def test_not_armed_it_stays_down(tmp_path: Path) -> None:
    rig = Rig(tmp_path, variant="brushless")
    rig.run(1.0)
    assert rig.takeoff() != 0
    rig.run(2.0)
    assert not rig.row().airborne
    assert not rig.row().armed
    assert rig.send(Port.SUPERVISOR, 1, b"\1\1")[0].data == b"\x81\1\1"
    rig.run(0.1)
    assert rig.row().armed
    assert rig.takeoff() == 0
    rig.run(3.0)
    assert rig.row().airborne


def test_old_firmware_arms_through_the_platform_port(tmp_path: Path) -> None:
    rig = Rig(tmp_path, variant="brushless", protocol=7)
    rig.run(0.5)
    assert rig.send(Port.SUPERVISOR, 1, b"\1\1") == []
    assert rig.send(Port.PLATFORM, 0, b"\1\1")[0].data == b"\1\1\1"
    rig.run(0.1)
    assert rig.info() == ARMED | CAN_FLY


def test_the_clock_may_run_slow(tmp_path: Path) -> None:
    rig = Rig(tmp_path, clock_rate=0.97)
    rig.run(10.0)
    assert rig.firmware.now_s == pytest.approx(9.7)


def test_without_poses_the_estimate_runs_away_and_nobody_cares(rig: Rig) -> None:
    rig.run(2.0)
    assert rig.firmware.estimator.variance < 1e-3
    rig.feeding = False
    rig.run(2.0)
    assert rig.firmware.estimator.variance > 1e-2
    rig.run(60.0)
    assert rig.firmware.estimate.position_m[2] < -5.0
    assert rig.info() & CAN_FLY
    rig.feeding = True
    rig.run(0.5)
    assert math.dist(rig.firmware.estimate.position_m, rig.at()) < 0.01


def test_it_believes_false_poses(rig: Rig) -> None:
    rig.fly()
    rig.feeding = False
    for _ in range(300):  # it is told that it stands half a metre further along x than it does
        x, y, z = rig.at()
        rig.feed((x + 0.5, y, z))
        rig.firmware.step()
    assert rig.off((0.0, -0.5, 1.0)) < 0.1


def test_a_reset_forgets_and_converges_again(rig: Rig) -> None:
    rig.run(1.0)
    rig.feeding = False
    firmware = rig.firmware
    index = list(firmware.params.values).index("kalman.resetEstimation")
    rig.send(Port.PARAM, 2, struct.pack("<HB", index, 1))
    assert firmware.estimator.variance > 1.0
    assert firmware.estimate.position_m == pytest.approx((0.0, 0.0, 0.0))
    rig.feeding = True
    rig.run(0.5)
    assert firmware.estimator.variance < 1e-3
    assert math.dist(firmware.estimate.position_m, rig.at()) < 1e-3


def test_packed_poses_are_for_its_address_alone(tmp_path: Path) -> None:
    rig = Rig(tmp_path, address=0x05)
    rig.feeding = False
    rig.send(Port.LOCALIZATION, 2, struct.pack("<Bhhh", 0x06, 9000, 0, 0) + struct.pack("<Bhhh", 0x05, 500, -500, 0))
    assert rig.firmware.estimate.position_m[0] == pytest.approx(0.5, abs=0.01)
    rig.run(1.0)
    rig.send(Port.LOCALIZATION, 1, b"\x09" + struct.pack("<BhhhI", 0x05, 600, -500, 0, 0xC0000000))
    assert rig.firmware.localization.tick_ms == pytest.approx(1000, abs=11)
    assert rig.firmware.localization.position_m[0] == pytest.approx(0.6)


def test_nonsense_is_ignored(rig: Rig) -> None:
    rig.fly()
    rig.feed((math.nan, 0.0, 0.0))
    for port in range(16):
        for channel in range(4):
            for data in (b"", b"\x03", b"\xff" * 30):
                if (port, data[:1]) not in ((Port.LOCALIZATION, b"\x03"), (Port.SUPERVISOR, b"\x03")):
                    rig.send(port, channel, data)
    assert rig.firmware.on


def test_silence_of_a_streaming_client_levels_out_and_locks(rig: Rig) -> None:
    rig.run(1.0)
    for _ in range(300):
        rig.hover_setpoint(0.0, 0.0, 0.8)
        rig.run(STEP_S)
    assert rig.at()[2] == pytest.approx(0.8, abs=0.05)
    rig.run(1.5)
    assert rig.at()[2] == pytest.approx(0.8, abs=0.1)
    assert rig.info() & FLYING
    rig.run(2.0)
    assert rig.info() & LOCKED
    assert rig.row().locked
    assert not rig.row().airborne
    assert rig.row().tumbled
    assert rig.takeoff() != 0


def test_a_streaming_client_moves_it_in_its_own_heading(rig: Rig) -> None:
    rig.fly()
    rig.go_to((0.5, -0.5, 1.0), 2.0, yaw=math.pi / 2)
    rig.run(2.5)
    for _ in range(200):
        rig.hover_setpoint(0.5, 0.0, 1.0)
        rig.run(STEP_S)
    assert rig.at()[0] == pytest.approx(0.5, abs=0.1)
    assert rig.at()[1] == pytest.approx(0.5, abs=0.25)


def test_the_high_level_commander_waits_for_the_client_to_give_back(rig: Rig) -> None:
    rig.fly()
    rig.land()
    rig.run(6.0)
    rig.send(Port.SETPOINT, 0, struct.pack("<fffH", 0, 0, 0, 0))  # close_link
    rig.run(1.0)
    rig.takeoff()
    rig.run(3.0)
    assert not rig.row().airborne
    rig.high_level(b"\3\0")
    rig.send(Port.SETPOINT_GENERIC, 1, struct.pack("<BI", 0, 0))
    rig.takeoff()
    rig.run(3.0)
    assert rig.row().airborne


def test_closing_the_link_in_flight_drops_it(rig: Rig) -> None:
    rig.fly()
    rig.send(Port.SETPOINT, 0, struct.pack("<fffH", 0, 0, 0, 0))
    rig.run(1.0)
    assert not rig.row().airborne
    assert rig.row().tumbled


def test_losing_the_link_never_lands_it(rig: Rig) -> None:
    rig.fly()
    rig.run(30.0)
    assert rig.row().airborne


@pytest.mark.parametrize(
    "stop",
    [(Port.SUPERVISOR, 1, b"\3"), (Port.LOCALIZATION, 1, b"\3")],
    ids=["supervisor", "legacy"],
)
def test_emergency_stop_in_the_air_falls_and_locks(rig: Rig, stop: tuple[int, int, bytes]) -> None:
    rig.fly()
    rig.send(*stop)
    rig.run(1.0)
    row = rig.row()
    assert (row.airborne, row.locked, row.tumbled, row.code) == (False, True, True, STOPPED)
    rig.send(Port.SUPERVISOR, 1, b"\1\1")
    assert rig.takeoff() != 0
    rig.run(2.0)
    assert not rig.row().airborne


def test_a_power_cycle_unlocks(rig: Rig) -> None:
    rig.run(0.5)
    rig.send(Port.SUPERVISOR, 1, b"\3")
    rig.run(0.5)
    assert rig.info() & LOCKED
    rig.send(Port.LINK, 3, b"\xfe\x02")
    assert rig.send(Port.LINK, 0, b"ping") == []
    rig.send(Port.LINK, 3, b"\xfe\x03")
    rig.fly()


def test_failing_motors_let_it_fall(rig: Rig) -> None:
    rig.fly()
    rig.fault(motor_fail=True)
    rig.run(1.0)
    row = rig.row()
    assert (row.airborne, row.tumbled, row.code) == (False, True, MOTOR_FAILURE)
    assert rig.info() & CRASHED
    rig.fault(motor_fail=False)  # for good
    rig.takeoff()
    rig.run(2.0)
    assert not rig.row().airborne


def test_an_empty_battery_lets_it_fall(tmp_path: Path) -> None:
    rig = Rig(tmp_path, replace(UAV, energy_j=229.6 * 6.0))
    rig.fly()
    rig.run(5.0)
    row = rig.row()
    assert row.energy_j == 0.0
    assert (row.airborne, row.tumbled, row.code) == (False, True, BATTERY_EMPTY)


def test_a_low_battery_says_so_before(tmp_path: Path) -> None:
    rig = Rig(tmp_path, replace(UAV, energy_j=0.06 * UAV.capacity_j))
    rig.fly()
    rig.run(6.0)
    assert rig.row().airborne
    assert rig.firmware.power.state == 3
    assert 3.0 < rig.firmware.power.vbat < 3.2


def test_drain_empties_faster(tmp_path: Path) -> None:
    used = []
    for name, drain in (("a", 1.0), ("b", 2.0)):
        rig = Rig(tmp_path / name)
        rig.fault(drain=drain)
        rig.fly()
        used.append(rig.row().used_j)
    assert used[1] == pytest.approx(2.0 * used[0], rel=0.01)


def dock(rig: Rig, off_m: float = 0.0) -> None:
    rig.fly()
    x, y, z = rig.over_the_pad()
    rig.go_to((x + off_m, y, z), 4.0)
    rig.run(5.0)
    rig.land(PAD_M - 0.05)
    rig.run(4.0)


def test_charges_on_a_pad_and_flies_again(tmp_path: Path) -> None:
    rig = Rig(tmp_path, replace(UAV, energy_j=100_000.0))
    dock(rig)
    row, firmware = rig.row(), rig.firmware
    assert (row.on, row.dock, row.charging) == (1, 0, True)
    assert row.position_m[2] == PAD_M
    assert firmware.power.state == 1
    rig.run(25.0)
    assert rig.row().energy_j == UAV.capacity_j
    assert rig.row().drawn_j > 100_000.0
    assert firmware.power.state == 2
    assert rig.takeoff(0.8) == 0
    rig.run(3.0)
    assert rig.row().airborne
    assert not rig.row().charging
    assert firmware.power.state == 0


def test_beside_the_contact_it_does_not_charge(rig: Rig) -> None:
    dock(rig, 0.1)
    row = rig.row()
    assert (row.on, row.charging, row.airborne, row.code) == (1, False, False, DOCK_MISSED)
    assert rig.firmware.power.state == 0


def test_no_power_no_charging(rig: Rig) -> None:
    rig.fault(charge_factor=0.0)
    dock(rig)
    assert rig.row().on == 1
    assert not rig.row().charging


def test_a_docking_misses_as_often_as_it_has_to(rig: Rig) -> None:
    rig.fault(dock_miss=1)
    dock(rig)
    assert not rig.row().charging
    assert rig.world.modifiers(0).dock_miss == 0
    x, y, _ = rig.world.pad_m(1, 0)
    assert 0.05 < math.dist(rig.at()[:2], (x, y)) < 0.15
    rig.takeoff(0.8)
    rig.run(3.0)
    rig.go_to(rig.over_the_pad(), 2.0)
    rig.run(3.0)
    rig.land(PAD_M - 0.05)
    rig.run(4.0)
    assert rig.row().charging


def test_it_rides_along_on_a_ugv(rig: Rig) -> None:
    dock(rig)
    before = rig.at()
    carrier = rig.world.body(1)
    moved = replace(carrier, position_m=(4.0, 2.0, 0.0), quaternion=yaw_quaternion(2.0), velocity_mps=(0.3, 0.0, 0.0))
    rig.world.put(1, moved)
    rig.run(0.1)
    assert math.dist(before, rig.at()) > 1.0
    assert math.dist(rig.at(), rig.world.pad_m(1, 0)) < 0.05
    assert rig.row().charging
    assert rig.row().velocity_mps == (0.3, 0.0, 0.0)


def test_it_takes_the_speed_of_the_ugv_that_it_leaves(rig: Rig) -> None:
    dock(rig)
    rig.world.put(1, replace(rig.world.body(1), velocity_mps=(0.4, 0.0, 0.0)))
    rig.run(STEP_S)
    rig.takeoff(0.8, 1.0)
    while not rig.row().airborne:
        rig.run(STEP_S)
    assert rig.row().velocity_mps[0] == pytest.approx(0.4, abs=0.05)


def test_it_may_start_on_a_dock(tmp_path: Path) -> None:
    rig = Rig(tmp_path, replace(UAV, on="ugv0", energy_j=1000.0))
    rig.run(1.0)
    assert rig.at() == pytest.approx(rig.world.pad_m(1, 0))
    assert rig.row().charging
    assert rig.takeoff(1.0) == 0
    rig.run(3.0)
    assert rig.at()[2] == pytest.approx(1.0, abs=0.05)


def test_wind_costs_energy_while_it_flies(tmp_path: Path) -> None:
    far = (4.5, -0.5, 1.0)
    used = []
    config = replace(UAV, power_w=(10.0, 0.0, 20.0))
    for name, wind in (("a", 0.0), ("b", 0.4)):
        rig = Rig(tmp_path / name, config)
        rig.fly()
        rig.fault(wind_mps=wind)
        rig.go_to(far, 6.0)
        rig.run(8.0)
        assert rig.off(far) < 0.15
        used.append(rig.row().used_j)
    assert used[1] > 1.1 * used[0]


def test_a_short_drop_is_survived(rig: Rig) -> None:
    rig.run(1.0)
    rig.takeoff(0.15, 1.0)
    rig.run(2.0)
    rig.high_level(b"\3\0")
    rig.run(1.0)
    assert not rig.row().airborne
    assert not rig.row().tumbled


@pytest.mark.parametrize(
    "kind", [{"variant": "paper"}, {"protocol": 3}, {"clock_rate": 0.0}, {"address": 300}], ids=lambda k: next(iter(k))
)
def test_impossible_kinds_are_refused(kind: dict[str, object]) -> None:
    with pytest.raises(SimulationError, match=next(iter(kind))):
        CrazyflieKind(**kind)  # type: ignore[arg-type]
