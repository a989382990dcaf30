"""The supervisor's rules, one by one, on a clock of its own."""

from __future__ import annotations

from sim_backends.wire.crazyflie_planner import Phase
from sim_backends.wire.crazyflie_supervisor import (
    ARMED,
    AUTO_ARM,
    CAN_BE_ARMED,
    CAN_FLY,
    CRASHED,
    FLYING,
    HL_ACTIVE,
    LOCKED,
    TUMBLED,
    Inputs,
    State,
    Supervisor,
)


class Rig:
    """A supervisor with its inputs."""

    def __init__(self, *, auto_arm: bool = True, modern: bool = True) -> None:
        self.said: list[str] = []
        self.supervisor = Supervisor(auto_arm, modern, self.said.append)
        self.now_s = self.setpoint_s = 0.0
        self.thrust = self.tilted = False
        self.silent = False

    def run(self, seconds: float) -> None:
        end_s = self.now_s + seconds
        while self.now_s < end_s - 1e-9:
            self.now_s += 0.01
            if not self.silent:
                self.setpoint_s = self.now_s
            self.supervisor.step(Inputs(self.now_s, self.thrust, self.setpoint_s, self.tilted))

    def fly(self) -> None:
        self.run(0.1)
        self.supervisor.arm(True)
        self.run(0.1)
        self.thrust = True
        self.run(0.5)
        assert self.supervisor.state is State.FLYING

    def info(self) -> int:
        return self.supervisor.info(Phase.IDLE, False)


def test_brushed_arms_itself_and_is_ready() -> None:
    rig = Rig(modern=False)
    rig.run(0.1)
    assert rig.info() == 0x0E  # as seen with real firmware


def test_brushless_waits_to_be_armed() -> None:
    rig = Rig(auto_arm=False)
    rig.run(0.1)
    assert rig.info() == CAN_BE_ARMED
    assert rig.supervisor.arm(True)
    rig.run(0.1)
    assert rig.info() == ARMED | CAN_FLY
    assert rig.said == ["SUP: Ready to fly\n"]


def test_armed_and_not_flying_disarms_after_30_s() -> None:
    rig = Rig(auto_arm=False)
    rig.run(0.1)
    rig.supervisor.arm(True)
    rig.run(29.9)
    assert rig.supervisor.armed
    rig.run(0.5)
    assert not rig.supervisor.armed
    assert rig.info() == CAN_BE_ARMED
    assert rig.said[-1] == "SUP: Disarming\n"


def test_flying_lags_two_seconds_and_landed_disarms_three_later() -> None:
    rig = Rig(auto_arm=False)
    rig.fly()
    rig.thrust = False
    rig.run(1.9)
    assert rig.info() == ARMED | CAN_FLY | FLYING
    rig.run(0.2)
    assert rig.info() == ARMED | CAN_FLY
    rig.run(2.7)
    assert rig.supervisor.armed
    rig.run(0.5)
    assert rig.info() == CAN_BE_ARMED


def test_it_can_fly_again_before_it_disarms() -> None:
    rig = Rig(auto_arm=False)
    rig.fly()
    rig.thrust = False
    rig.run(3.0)
    rig.thrust = True
    rig.run(4.0)
    assert rig.supervisor.state is State.FLYING


def test_brushed_is_ready_again_after_landing() -> None:
    rig = Rig()
    rig.fly()
    rig.thrust = False
    rig.run(6.0)
    assert rig.info() == ARMED | AUTO_ARM | CAN_FLY


def test_silence_levels_out_then_locks_until_reboot() -> None:
    rig = Rig(modern=False)
    rig.fly()
    rig.silent = True
    rig.run(0.45)
    assert rig.supervisor.state is State.FLYING
    rig.run(0.1)
    assert rig.supervisor.state is State.LEVEL_OUT
    rig.silent = False
    rig.run(0.1)
    assert rig.supervisor.state is State.FLYING
    rig.silent = True
    rig.run(2.1)
    assert rig.info() == 0x44  # as seen with real firmware
    rig.silent = rig.thrust = False
    rig.run(10.0)
    assert not rig.supervisor.arm(True)
    assert rig.supervisor.locked
    assert rig.said == ["SUP: Locked, reboot required\n"]


def test_silence_on_the_ground_is_harmless() -> None:
    rig = Rig()
    rig.silent = True
    rig.run(10.0)
    assert rig.supervisor.may_run


def test_emergency_stop_locks_in_the_air_and_on_the_ground() -> None:
    for airborne in (True, False):
        rig = Rig()
        if airborne:
            rig.fly()
        rig.run(0.1)
        rig.supervisor.emergency_stop()
        rig.run(0.05)
        assert rig.info() & LOCKED
        assert not rig.supervisor.may_run


def test_disarming_in_flight_drops_it() -> None:
    rig = Rig()
    rig.fly()
    assert rig.supervisor.arm(False)
    rig.run(0.05)
    assert rig.supervisor.locked


def test_the_watchdog_is_off_until_its_first_packet() -> None:
    rig = Rig()
    rig.fly()
    rig.run(5.0)
    for _ in range(5):
        rig.supervisor.watchdog(rig.now_s)
        rig.run(0.9)
    assert rig.supervisor.state is State.FLYING
    rig.run(0.2)
    assert rig.supervisor.locked


def test_a_crash_can_be_recovered_once_it_is_upright() -> None:
    rig = Rig(auto_arm=False)
    rig.fly()
    rig.tilted, rig.thrust = True, False
    rig.run(0.1)
    assert rig.info() == TUMBLED | CRASHED
    assert not rig.supervisor.recover()
    rig.tilted = False
    rig.run(0.1)
    assert rig.supervisor.recover()
    rig.run(0.1)
    assert rig.info() == CAN_BE_ARMED


def test_older_firmware_locks_when_it_tumbles() -> None:
    rig = Rig(modern=False)
    rig.fly()
    rig.tilted = True
    rig.run(0.1)
    assert rig.info() & LOCKED
    assert not rig.info() & CRASHED


def test_lying_on_its_side_it_is_not_ready() -> None:
    rig = Rig()
    rig.tilted = True
    rig.run(0.5)
    assert not rig.supervisor.may_run


def test_bits_of_the_high_level_commander_are_newer() -> None:
    assert Rig().supervisor.info(Phase.LANDING, False) & HL_ACTIVE
    assert not Rig(modern=False).supervisor.info(Phase.LANDING, True) >> 8


def test_a_stop_after_landing_waits_until_it_is_reset() -> None:
    rig = Rig()
    rig.fly()
    rig.thrust = False
    rig.run(2.1)
    assert rig.supervisor.state is State.LANDED
    rig.supervisor.emergency_stop()
    rig.run(0.5)
    assert not rig.supervisor.locked
    rig.run(3.0)
    assert rig.supervisor.locked
