"""The kinematic backend: vehicles and motion capture of a simulated world on a virtual clock, in process.

It is reached like the real thing, through ``drivers.vehicle`` and ``drivers.clock``, and is deterministic: the same
configuration, faults and commands at the same times give the same world to the last bit, however often it is looked at.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.vehicle import (
    Arm,
    Command,
    Disarm,
    Dock,
    Drive,
    GoTo,
    Hold,
    Kind,
    Land,
    Pose,
    PoseSource,
    SelfCheck,
    StopMotors,
    TakeOff,
    Vehicle,
    VehicleState,
)
from sim_backends import kernel
from sim_backends.arrays import build_arrays
from sim_backends.commands import Receiver, is_sound, limited
from sim_backends.fault_script import NEVER, FaultScript
from sim_backends.faults import Fault, check_faults
from sim_backends.truth import CODES, Truth, read_truth
from sim_backends.world import GRID_S, WorldConfig

TICKS_PER_S = round(1 / GRID_S)
ANY = (Arm, Disarm, Hold, StopMotors)
UAV_COMMANDS = (*ANY, TakeOff, GoTo, Land, Dock)
UGV_COMMANDS = (*ANY, Drive)
ORDER = (Arm, Disarm, TakeOff, GoTo, Land, Dock, Drive, Hold, StopMotors)


@dataclass(frozen=True)
class KinematicBackend:
    """Everything that a run needs.

    Attributes:
        vehicles: by id, UAVs first.
        poses: the motion capture.
        clock: virtual; ``wait_until`` lets the world go on.
        world: for tests and benchmarks.
    """

    vehicles: dict[str, Vehicle]
    poses: PoseSource
    clock: Clock
    world: KinematicWorld

    def truth(self) -> Truth:
        """The audit until now."""
        return self.world.truth()

    def planner_delay_s(self) -> float:
        """Arena s by which a planning call that begins now is slowed down by a scripted fault."""
        return self.world.script.planner_delay_s(self.clock.now())


def build(config: WorldConfig, faults: Sequence[Fault] = ()) -> KinematicBackend:
    """A world at time 0.

    Raises:
        SimulationError: when a fault names a vehicle that does not exist or is of the wrong kind.
    """
    world = KinematicWorld(config, faults)
    vehicles: dict[str, Vehicle] = {v.id: KinematicVehicle(world, b) for b, v in enumerate(world.configs)}
    return KinematicBackend(vehicles, KinematicPoses(world), VirtualClock(world), world)


class KinematicWorld:
    """Owns the arrays; steps them; delivers commands and faults at the steps where they are due."""

    def __init__(self, config: WorldConfig, faults: Sequence[Fault]) -> None:
        check_faults(faults, [u.id for u in config.uavs], [g.id for g in config.ugvs])
        self.config = config
        self.configs = config.vehicles
        self.n_uav = len(config.uavs)
        self.tick = 0
        self.step = 0
        self.arrays = build_arrays(config)
        self.script = FaultScript(config, faults, self.arrays)
        self._ticks_per_step = round(config.step_s / GRID_S)
        self._receiver = Receiver(self.arrays, [g.id for g in config.ugvs])
        # the latency is the same for all, so that commands arrive in the order in which they were sent
        self._queue: deque[tuple[int, int, Command]] = deque()
        a = self.arrays
        kernel.observe(a.world[0], a.uavs, a.ugvs, a.out, a.hist, a.fence, a.records, a.open, 0)

    @property
    def now_s(self) -> float:
        """The virtual time, s."""
        return self.tick / TICKS_PER_S

    def send(self, b: int, command: Command) -> None:
        """Puts a command for vehicle ``b`` on its way, unless it gets lost."""
        config = self.config
        due = math.ceil((self.now_s + config.command_latency_s) / config.step_s - 1e-9)
        # one moment, one fate: repeating a command within a step must not help
        purpose = 32 + ORDER.index(type(command))
        if config.command_drop and kernel.uniform(config.seed, b, due, purpose) < config.command_drop:
            return
        self._queue.append((due, b, command))

    def advance(self, time_s: float) -> None:
        """Goes on to ``time_s`` or to where the loop may notice something, on the loop's grid."""
        if time_s <= self.now_s:
            return
        # rounding must neither skip a tick of the grid nor leave a loop that waits for time_s without progress
        tick = max(math.ceil(time_s * TICKS_PER_S - 1e-6), self.tick + 1)
        target, a = tick // self._ticks_per_step, self.arrays
        while self.step < target:
            self._deliver()
            stop = min(target, self._queue[0][0] if self._queue else NEVER, self.script.next_step)
            self.step, noticed = kernel.advance(
                a.world, a.uavs, a.ugvs, a.docks, a.out, a.hist, a.path, a.fence, a.records, a.open, self.step, stop
            )
            if noticed:
                # ticks between steps pass too: never before the time at which the loop stood
                self.tick = max(self.step * self._ticks_per_step, self.tick)
                return
        self.tick = tick

    def _deliver(self) -> None:
        while self._queue and self._queue[0][0] <= self.step:
            _, b, command = self._queue.popleft()
            n, to = self.n_uav, self._receiver
            if to.uav(b, command) if b < n else to.ugv(b - n, command):
                self.script.start(self.step)
        if self.script.next_step <= self.step:
            self.script.apply(self.step)

    def feed(self, b: int, pose: Pose) -> None:
        """Hands a pose to the estimator of UAV ``b``."""
        u, out = self.arrays.uavs[b], self.arrays.out[b]
        if u["lost"]:
            return
        u["fed_t"] = self.now_s
        if pose.stamp_s >= out["pose_stamp"]:
            u["trusting"] = bool(out["freeze"] or out["jump_x"] or out["jump_y"] or out["swap"] != b)

    def truth(self) -> Truth:
        """The audit until now."""
        return read_truth(self.config, self.arrays, self.step)


class VirtualClock:
    """Time that passes only in ``wait_until``."""

    def __init__(self, world: KinematicWorld) -> None:
        self._world = world

    def now(self) -> float:
        """Current time in s."""
        return self._world.now_s

    def wait_until(self, time_s: float) -> float:
        """Lets the world go on to ``time_s``, rounded up to the loop's grid, or to an earlier noticeable change."""
        self._world.advance(time_s)
        return self._world.now_s


class KinematicPoses:
    """Motion capture of the simulated world."""

    def __init__(self, world: KinematicWorld) -> None:
        self._out = world.arrays.out
        self._bodies = [v.body for v in world.configs]
        self._read = [-math.inf] * len(self._bodies)
        self._connected = False

    def connect(self, deadline_s: float) -> None:
        """Connects at once."""
        self._connected = True

    def read(self) -> Sequence[Pose]:
        """The newest pose of each body received since the last call.

        Raises:
            DriverError: when it is not connected.
        """
        if not self._connected:
            raise DriverError("motion capture (kinematic): not connected; call connect first")
        stamps = self._out["pose_stamp"].tolist()
        fresh = [b for b, stamp in enumerate(stamps) if stamp > self._read[b]]
        if not fresh:
            return ()
        self._read = stamps
        xs, ys, zs, yaws = (self._out[name].tolist() for name in ("px", "py", "pz", "pyaw"))
        return tuple(Pose(self._bodies[b], (xs[b], ys[b], zs[b]), yaws[b], stamps[b]) for b in fresh)

    def close(self) -> None:
        """Stops reading; again does nothing."""
        self._connected = False


class KinematicVehicle:
    """One simulated vehicle behind the drivers' interface."""

    def __init__(self, world: KinematicWorld, b: int) -> None:
        self._world, self._b = world, b
        self._id = world.configs[b].id
        self._connected = False
        self._docks = {g.id: len(g.dock_offsets_m) for g in world.config.ugvs}

    @property
    def id(self) -> str:
        """Its id in the fleet."""
        return self._id

    @property
    def kind(self) -> Kind:
        """``uav`` or ``ugv``."""
        return "uav" if self._b < self._world.n_uav else "ugv"

    def connect(self, deadline_s: float) -> None:
        """Connects at once.

        Raises:
            DriverError: when its link is dead.
        """
        if not self._world.arrays.out[self._b]["link"]:
            raise DriverError(f"{self._id}: its link is dead (scripted fault); wait until it is back")
        self._connected = True

    def state(self) -> VehicleState:
        """The newest telemetry received."""
        out = self._world.arrays.out[self._b]
        flags = int(out["flags"])
        return VehicleState(
            vehicle=self._id,
            stamp_s=float(out["tele_stamp"]),
            link=self._connected and bool(out["link"]),
            armed=bool(flags & kernel.ARMED),
            airborne=bool(flags & kernel.AIRBORNE),
            tumbled=bool(flags & kernel.TUMBLED),
            locked=bool(flags & kernel.LOCKED),
            charging=bool(flags & kernel.CHARGING),
            battery=float(out["battery"]),
            fault=CODES.get(flags // kernel.CODE),
        )

    def send(self, command: Command) -> Command:
        """Puts ``command``, its speed limited to what the vehicle can do, on its way.

        Raises:
            DriverError: not connected, not for this vehicle, of the wrong kind, or with unusable values.
        """
        self._check(command)
        index = self._b if self.kind == "uav" else self._b - self._world.n_uav
        sent = limited(command, self._world.arrays, index)
        self._world.send(self._b, sent)
        return sent

    def _check(self, command: Command) -> None:
        name = type(command).__name__
        if command.vehicle != self._id:
            raise DriverError(f"{self._id}: {name} is for {command.vehicle!r}; send it to that vehicle")
        if not isinstance(command, UAV_COMMANDS if self.kind == "uav" else UGV_COMMANDS):
            raise DriverError(f"{self._id}: a {self.kind} cannot do {name}")
        if not self._connected:
            raise DriverError(f"{self._id}: not connected; call connect first")
        if not is_sound(command):
            raise DriverError(f"{self._id}: {command} has a number that is not finite or a speed that is not above 0")
        if isinstance(command, Drive) and not command.path_m:
            raise DriverError(f"{self._id}: Drive has an empty path; give at least one point")
        if isinstance(command, Dock) and not 0 <= command.dock < self._docks.get(command.onto, 0):
            raise DriverError(f"{self._id}: there is no dock {command.dock} on {command.onto!r}")

    def self_checks(self) -> Sequence[SelfCheck]:
        """None: a simulated body has no firmware, estimator or radio of its own."""
        return ()

    def feed_pose(self, pose: Pose) -> None:
        """Hands ``pose`` to the UAV's estimator; a UGV has none."""
        if self._connected and self.kind == "uav":
            self._world.feed(self._b, pose)

    def last_will(self) -> None:
        """None: a simulated body ends with the program."""

    def close(self) -> None:
        """Releases the link; again does nothing."""
        self._connected = False
