"""Starts a wire simulation: the shared world, a process for every endpoint, and the conductor; and ends it again."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from sim_backends.errors import SimulationError
from sim_backends.faults import Fault, check_faults
from sim_backends.truth import Truth
from sim_backends.wire.conductor import read_truth, write_faults
from sim_backends.wire.endpoints import (
    Address,
    CrazyflieEndpoint,
    Endpoint,
    LimoEndpoint,
    MavlinkEndpoint,
    check_unique,
    command_of,
    module,
)
from sim_backends.wire.modifiers import FaultTimes
from sim_backends.wire.ports import free_domain, free_loopback, free_udp_port
from sim_backends.wire.world import World
from sim_backends.world import WorldConfig

READY_S = 30.0
"""So long an endpoint may take to start; two cores that start six of them take about ten seconds."""
END_S = 2.0
"""So long it may take to end by itself."""
TAIL_LINES = 6
CONDUCTOR, MOCAP = "conductor", "motion capture"


def launch(
    config: WorldConfig,
    faults: Sequence[Fault],
    endpoints: Sequence[Endpoint],
    *,
    mocap: bool | str = True,
    zero_s: float | None = None,
    ready_s: float = READY_S,
) -> WireSimulation:
    """Starts a simulation and waits until everybody accepts clients.

    Args:
        config: the world.
        faults: that happen in it.
        endpoints: who plays which vehicle; a vehicle without one stays where it is.
        mocap: start a NatNet server: on a free loopback address, or on the one given.
        zero_s: ``time.monotonic()`` at which the truth's times begin; default: now.
        ready_s: deadline for all of them.

    Raises:
        SimulationError: an endpoint does not exist, ended or is not ready in time; nothing is left running.
    """
    check_faults(faults, [u.id for u in config.uavs], [g.id for g in config.ugvs])
    known = [v.id for v in config.vehicles]
    for endpoint in endpoints:
        if endpoint.vehicle not in known:
            raise SimulationError(f"there is no vehicle {endpoint.vehicle!r} to simulate; there are {', '.join(known)}")
    addresses = addresses_of(tuple(endpoints))
    host = (mocap if isinstance(mocap, str) else free_loopback()) if mocap else None
    folder = Path(tempfile.mkdtemp(prefix="copcs-world-"))
    simulation = WireSimulation(folder, addresses, host)
    try:
        world = World.create(folder, config)
        write_faults(folder, faults)
        simulation.watch(world, FaultTimes(config, faults))
        me = os.getpid()
        zero_s = time.monotonic() if zero_s is None else zero_s
        common = ["--world", str(folder), "--parent", str(me)]
        simulation.start(CONDUCTOR, [*module("conductor"), *common, "--zero", repr(zero_s)])
        if host is not None:
            simulation.start(MOCAP, [*module("natnet_server"), *common, "--address", host])
        for endpoint in endpoints:
            name = endpoint.vehicle
            simulation.start(name, command_of(endpoint, addresses[name], folder, me))
        simulation.wait_ready(time.monotonic() + ready_s)
    except BaseException:
        simulation.close()
        raise
    return simulation


def addresses_of(endpoints: tuple[Endpoint, ...]) -> dict[str, Address]:
    """Where each endpoint will be: as it says, or a free place.

    Raises:
        SimulationError: when two share a place, or none is free.
    """
    check_unique(endpoints)
    taken = {e.port for e in endpoints if not isinstance(e, LimoEndpoint) and e.port is not None}
    found: dict[str, Address] = {}
    domain: int | None = None
    for e in endpoints:
        match e:
            case LimoEndpoint():
                if e.domain is None and domain is None:
                    domain = free_domain()
                found[e.vehicle] = Address(
                    e.namespace or f"/{e.vehicle}", domain=domain if e.domain is None else e.domain
                )
                continue
            case CrazyflieEndpoint():
                port = e.port if e.port is not None else free_udp_port(taken)
                found[e.vehicle] = Address(f"udp://127.0.0.1:{port}")
            case MavlinkEndpoint():
                port = e.port if e.port is not None else free_udp_port(taken)
                found[e.vehicle] = Address(f"udpin:127.0.0.1:{port}", sysid=e.sysid)
        taken.add(port)
    return found


@dataclass(slots=True)
class _Process:
    """One endpoint's process and what it says."""

    name: str
    popen: subprocess.Popen[str]
    log: Path
    ready: threading.Event
    reader: threading.Thread

    def tail(self) -> str:
        """The last lines of its standard error, as one."""
        with contextlib.suppress(OSError):
            lines = self.log.read_text(errors="replace").strip().splitlines()[-TAIL_LINES:]
            return " | ".join(line.strip() for line in lines if line.strip())
        return ""


class WireSimulation:
    """A running simulation; ``launch`` makes it.

    Attributes:
        folder: of the world.
        addresses: where drivers reach each vehicle.
        mocap_host: address of the NatNet server; None where there is none.
        world: a handle to the shared world, for tests.
    """

    world: World

    def __init__(self, folder: Path, addresses: Mapping[str, Address], mocap_host: str | None) -> None:
        self.folder, self.addresses, self.mocap_host = folder, dict(addresses), mocap_host
        self._processes: dict[str, _Process] = {}
        self._truth: Truth | None = None
        self._closed = False

    def watch(self, world: World, times: FaultTimes) -> None:
        """Knows the world and its faults."""
        self.world, self._times = world, times

    def start(self, name: str, command: Sequence[str]) -> None:
        """Starts a process that will say ``ready``."""
        log = self.folder / f"{name.replace(' ', '-')}.log"
        root = str(Path(__file__).resolve().parents[2])
        paths = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
        # one thread each: the processes share few cores, and their matrices are small
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        env = {**os.environ, **threads, "PYTHONPATH": os.pathsep.join(paths)}
        with log.open("w") as errors:
            # a session of its own: Ctrl-C is for the ground station, it must not kill who is in the air
            popen = subprocess.Popen(
                list(command), stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors, text=True, env=env,
                start_new_session=True,
            )  # fmt: skip
        ready = threading.Event()
        reader = threading.Thread(target=_listen, args=(popen, ready), daemon=True, name=f"stdout of {name}")
        self._processes[name] = _Process(name, popen, log, ready, reader)
        reader.start()

    def wait_ready(self, deadline_s: float) -> None:
        """Waits until every process has said ``ready``, at most until ``time.monotonic()`` is ``deadline_s``.

        Raises:
            SimulationError: naming who ended or is late, and what it said last.
        """
        for process in self._processes.values():
            while not process.ready.wait(0.05):
                why = self.trouble()
                if why is not None:
                    raise SimulationError(why)
                if time.monotonic() > deadline_s:
                    said = process.tail() or "nothing"
                    raise SimulationError(
                        f"the simulated {process.name} was not ready in time (it said: {said}); the machine may be "
                        "too busy: try again"
                    )
        why = self.trouble()
        if why is not None:
            raise SimulationError(why)

    def process(self, name: str) -> subprocess.Popen[str]:
        """The process of a vehicle, of ``conductor`` or of ``motion capture``; for tests that pull its plug."""
        return self._processes[name].popen

    def trouble(self) -> str | None:
        """Which endpoint has ended by itself, and what it said last; None while all run."""
        for process in self._processes.values():
            code = process.popen.poll()
            if code is not None and not self._closed:
                said = process.tail() or "nothing"
                return f"the simulated {process.name} has ended (exit code {code}); it said: {said}"
        return None

    def planner_delay_s(self) -> float:
        """Arena s by which a planning call that begins now is slowed down by a scripted fault."""
        started_s = self.world.started_s
        return self._times.planner_delay_s(None if started_s is None else time.monotonic() - started_s)

    def truth(self) -> Truth:
        """The conductor's audit: at most a second old, and complete once the simulation is closed.

        Raises:
            SimulationError: when the conductor never told any.
        """
        if self._truth is not None:
            return self._truth
        return read_truth(self.folder)

    def close(self) -> None:
        """Ends every process and removes the folder; again does nothing."""
        if self._closed:
            return
        self._closed = True
        running = list(self._processes.values())
        # the conductor first: it must not take bodies for orphans whose endpoints end before it
        for group in ([p for p in running if p.name == CONDUCTOR], [p for p in running if p.name != CONDUCTOR]):
            for process in group:
                _signal(process, signal.SIGTERM)
            end_s = time.monotonic() + END_S
            for process in group:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.popen.wait(max(0.0, end_s - time.monotonic()))
            for process in group:
                if process.popen.poll() is None:
                    _signal(process, signal.SIGKILL)
                    process.popen.wait()
                process.reader.join(1.0)
                if process.popen.stdout is not None:
                    process.popen.stdout.close()
        with contextlib.suppress(SimulationError):
            self._truth = read_truth(self.folder)
        shutil.rmtree(self.folder, ignore_errors=True)


def _listen(popen: subprocess.Popen[str], ready: threading.Event) -> None:
    assert popen.stdout is not None
    with contextlib.suppress(ValueError):  # closed meanwhile
        for line in popen.stdout:
            if line.startswith("ready"):
                ready.set()


def _signal(process: _Process, number: signal.Signals) -> None:
    with contextlib.suppress(ProcessLookupError):
        process.popen.send_signal(number)
