"""One simulated Crazyflie without its link: packets in, packets out, and time that passes only in ``step``.

It does what the firmware's main loop does: estimate, commander, supervisor, controller; and it answers every port that
a session of cflib touches. Its clock is its own and may run slow.
"""

from __future__ import annotations

import errno
import math
import struct
from collections import deque
from dataclasses import dataclass

from sim_backends.errors import SimulationError
from sim_backends.wire.crazyflie_body import CrazyflieBody
from sim_backends.wire.crazyflie_commander import Commander
from sim_backends.wire.crazyflie_control import GRAVITY, IDLE, Controller, Drive, Estimate
from sim_backends.wire.crazyflie_dynamics import MODELS
from sim_backends.wire.crazyflie_estimator import Estimator
from sim_backends.wire.crazyflie_localization import Localization
from sim_backends.wire.crazyflie_logs import DATA, Logs
from sim_backends.wire.crazyflie_params import Params
from sim_backends.wire.crazyflie_planner import Goal
from sim_backends.wire.crazyflie_power import Power
from sim_backends.wire.crazyflie_setpoints import RpytDecoder, decode_generic
from sim_backends.wire.crazyflie_supervisor import Inputs, Supervisor
from sim_backends.wire.crazyflie_telemetry import readers
from sim_backends.wire.crtp_packets import MAX_DATA, Packet, Port
from sim_backends.wire.world import FINE, STOPPED, World

STEP_S = 0.01
"""Length of a step: log periods are multiples of it, and the attitude model (15 rad/s) is far slower."""
PROTOCOLS = range(7, 14)
"""CRTP protocol versions that can be simulated."""
SUPERVISOR_PORT, MODERN = 12, 8
"""First versions with port 9, and with recovery from crashes and disarming by time."""
FAULT_STEPS = 5


@dataclass(frozen=True, slots=True)
class CrazyflieKind:
    """Which Crazyflie it is.

    Attributes:
        variant: ``brushed`` (2.1, arms itself) or ``brushless`` (must be armed).
        protocol: CRTP protocol version, 7 to 13; below 12 there is no supervisor port.
        without: log groups that this firmware does not have.
        clock_rate: firmware seconds per second; real ones ran up to 3 % slow.
        address: last byte of its radio address, the id in packed localisation packets.
    """

    variant: str = "brushed"
    protocol: int = 12
    without: tuple[str, ...] = ()
    clock_rate: float = 1.0
    address: int = 0xE7

    def __post_init__(self) -> None:
        if self.variant not in MODELS:
            raise SimulationError(f"Crazyflie variant is {self.variant!r}; give one of {', '.join(MODELS)}")
        if self.protocol not in PROTOCOLS:
            raise SimulationError(f"Crazyflie protocol is {self.protocol}; give {PROTOCOLS[0]} to {PROTOCOLS[-1]}")
        if not 0.5 <= self.clock_rate <= 1.5:
            raise SimulationError(f"Crazyflie clock_rate is {self.clock_rate}; give 0.5 to 1.5, usually 0.97 to 1")
        if not 0 <= self.address <= 255:
            raise SimulationError(f"Crazyflie address is {self.address}; give one byte")


class Firmware:
    """The firmware and the body that it flies."""

    def __init__(self, world: World, row: int, kind: CrazyflieKind) -> None:
        self._world, self._row, self.kind = world, row, kind
        self.body = CrazyflieBody(world, row, kind.variant, STEP_S)
        self._stored: dict[str, float] = {}
        self.on = True
        self._boot()

    def _boot(self) -> None:
        kind, config = self.kind, self._world.config
        self.now_s = 0.0
        self._steps = 0
        self.console: deque[str] = deque(maxlen=40)
        self.supervisor = Supervisor(kind.variant == "brushed", kind.protocol >= MODERN, self._say)
        self.commander = Commander(kind.protocol)
        self.estimator = Estimator(config.uavs[self._row].drift_mps, 1000 * config.seed + self._row)
        self.controller = Controller(self.body.airframe)
        self.power = Power(3.2 if kind.variant == "brushed" else 3.35)
        self.params = Params(self._param_changed)
        self.params.restore(self._stored)
        self.localization = Localization(self, kind.address)
        self._rpyt = RpytDecoder()
        self.drive = Drive()
        self.estimator.reset(self.body.position_m, self.body.rpy[2], (0.0, 0.0, 0.0, 0.0))
        self.packets = 0
        table = readers(self)
        self.logs = Logs({name: r for name, r in table.items() if name.split(".")[0] not in kind.without})
        self._say("SYS: ----------------------------\n")
        name = "2.1" if kind.variant == "brushed" else "2.1 Brushless"
        self._say(f"SYS: Crazyflie {name} is up and running!\n")
        self._say("SYS: Self test passed!\n")

    def _say(self, text: str) -> None:
        self.console.append(text)

    def _param_changed(self, name: str, value: float) -> None:
        if name == "kalman.resetEstimation" and value:
            initial = tuple(self.params.values[f"kalman.initial{axis}"] for axis in ("X", "Y", "Z", "Yaw"))
            x, y, z, yaw = initial
            self.estimator.reset(self.body.position_m, self.body.rpy[2], (x, y, z, yaw))
        elif name == "stabilizer.stop" and value:
            self.supervisor.emergency_stop()
        elif name == "supervisor.prefltTimeout":
            self.supervisor.preflight_s = value / 1000
        elif name == "supervisor.landedTimeout":
            self.supervisor.landed_s = value / 1000
        elif name == "pm.lowVoltage":
            self.power.low_v = value

    @property
    def estimate(self) -> Estimate:
        """What it believes of itself."""
        e, b = self.estimator, self.body
        return Estimate(e.position(b.position_m), e.velocity(b.velocity_mps), b.rpy[2] + e.yaw_error)

    def step(self) -> list[Packet]:
        """Lets ``STEP_S`` pass; returns the log data that are due."""
        self._steps += 1
        if self._steps % FAULT_STEPS == 0:
            self.body.read_faults()
        if not self.on:
            self.body.step(Drive(), False)
            self.body.put(False, False)
            return []
        dt_s = STEP_S * self.kind.clock_rate
        self.now_s += dt_s
        self.estimator.step(dt_s)
        estimate = self.estimate
        here = Goal(estimate.position_m, estimate.velocity_mps, yaw_rad=math.remainder(estimate.yaw_rad, math.tau))
        setpoint = self.commander.step(self.now_s, here)
        supervisor = self.supervisor
        weight_n = self.body.airframe.mass_kg * GRAVITY
        supervisor.step(
            Inputs(
                self.now_s,
                supervisor.may_run and self.drive.thrust_n > IDLE * weight_n,
                self.commander.stamp_s,
                self.body.tumbled,
            )
        )
        self.commander.block(not supervisor.may_run)
        if supervisor.may_run:
            w = self.body.wander_m
            x, y, z = estimate.position_m
            felt = Estimate((x + w[0], y + w[1], z + w[2]), estimate.velocity_mps, estimate.yaw_rad)
            level_out = supervisor.state.name == "LEVEL_OUT"
            self.drive = self.controller.step(setpoint, felt, level_out, dt_s)
            # the model's heading is the true one, the controller's is the believed one
            if self.drive.thrust_n > 0.0:
                d = self.drive
                self.drive = Drive(d.roll, d.pitch, d.yaw - self.estimator.yaw_error, d.thrust_n)
                self._world.start()
        else:
            self.drive = Drive()
        if supervisor.stopped and supervisor.locked and self.body.code == FINE:
            self.body.code = STOPPED
        self.body.step(self.drive, supervisor.may_run)
        motors = not self.body.standing and supervisor.may_run
        self.power.step(self.body.battery.level, self.body.battery.charging, motors, dt_s)
        self.body.put(supervisor.armed, supervisor.locked)
        return [Packet(Port.LOG, DATA, data) for data in self.logs.due(1000.0 * self.now_s)]

    def printed(self) -> list[Packet]:
        """What it has printed on the console since the last call."""
        text = "".join(self.console).encode()
        self.console.clear()
        return [Packet(Port.CONSOLE, 0, text[i : i + MAX_DATA]) for i in range(0, len(text), MAX_DATA)]

    def handle(self, packet: Packet) -> list[Packet]:
        """Obeys a packet; returns the answers."""
        if packet.port == Port.LINK and packet.channel == 3:
            return self._power_switch(packet)
        if not self.on:
            return []
        self.packets += 1
        data = self._answer(packet)
        return [] if data is None else [Packet(packet.port, packet.channel, data)]

    def _answer(self, packet: Packet) -> bytes | None:
        port, channel, data = packet.port, packet.channel, packet.data
        if port == Port.LOG:
            return self.logs.answer(channel, data, 1000.0 * self.now_s)
        if port == Port.PARAM:
            answer = self.params.answer(channel, data)
            self._stored = self.params.stored
            return answer
        if port == Port.SETPOINT_HL:
            return self.commander.answer(data, self.now_s)
        if port == Port.LOCALIZATION:
            self.localization.take(channel, data)
            return None
        if port in (Port.SETPOINT, Port.SETPOINT_GENERIC):
            self._low_level(port, channel, data)
            return None
        if port == Port.LINK:
            return self._link(channel, data)
        if port == Port.PLATFORM:
            return self._platform(channel, data)
        if port == Port.MEM:
            return _no_memory(channel, data)
        if port == Port.SUPERVISOR and self.kind.protocol >= SUPERVISOR_PORT:
            return self._supervisor(channel, data)
        return None

    def _low_level(self, port: int, channel: int, data: bytes) -> None:
        if port == Port.SETPOINT_GENERIC and channel == 1:
            if data[:1] == b"\0":
                e = self.estimate
                self.commander.relax(Goal(e.position_m, e.velocity_mps, yaw_rad=e.yaw_rad))
            return
        setpoint = self._rpyt.decode(data) if port == Port.SETPOINT else decode_generic(data)
        if setpoint is not None:
            self.commander.client(setpoint, self.now_s)

    @staticmethod
    def _link(channel: int, data: bytes) -> bytes | None:
        if channel == 0:
            return data
        return b"Bitcraze Crazyflie".ljust(MAX_DATA, b"\0") if channel == 1 else None

    def _platform(self, channel: int, data: bytes) -> bytes | None:
        if not data:
            return None
        command = data[0]
        if channel == 0:
            if command == 1 and len(data) > 1:
                done = self.supervisor.arm(bool(data[1]))
                return bytes((1, done, self.supervisor.armed))
            if command == 2:
                done = self.supervisor.recover()
                return bytes((2, done, not self.supervisor.crashed))
            return data
        if channel == 1:
            brushed = self.kind.variant == "brushed"
            answers = {0: bytes((self.kind.protocol,)), 1: b"2026.08 (simulated)", 2: b"CF21" if brushed else b"CF21B"}
            return data[:1] + answers[command] if command in answers else None
        return None

    def _supervisor(self, channel: int, data: bytes) -> bytes | None:
        if not data:
            return None
        command, head = data[0], bytes((data[0] | 0x80,))
        if channel == 0:
            info = self.info()
            if command == 0x0C:
                return head + struct.pack("<H", info)
            return head + bytes((info >> (command - 1) & 1,)) if 1 <= command <= 0x0B else None
        if channel != 1:
            return None
        if command == 1 and len(data) > 1:
            done = self.supervisor.arm(bool(data[1]))
            return head + bytes((done, self.supervisor.armed))
        if command == 2:
            done = self.supervisor.recover()
            return head + bytes((done, not self.supervisor.crashed))
        if command == 3:
            self.supervisor.emergency_stop()
        elif command == 4:
            self.supervisor.watchdog(self.now_s)
        return None

    def info(self) -> int:
        """The supervisor's state bits."""
        planner = self.commander.planner
        return self.supervisor.info(planner.phase, planner.finished(self.now_s))

    def _power_switch(self, packet: Packet) -> list[Packet]:
        """Power commands of ``cflib.utils.power_switch``, which the radio chip takes even from a dead firmware."""
        if packet.data[:1] != b"\xfe":
            return [packet]
        command = packet.data[1] if len(packet.data) > 1 else 0
        if command in (0x01, 0x02):
            self.on = False
        elif command in (0x03, 0xF0):
            self.on = True
            self._boot()
        return [packet]


def _no_memory(channel: int, data: bytes) -> bytes | None:
    """The memory port of a vehicle without decks, EEPROM and LEDs."""
    if not data:
        return None
    if channel == 0:
        return {0: b"\0\0", 1: b"\1\0"}.get(data[0], data[:2])
    return data[:5] + bytes((errno.ENOENT,))
