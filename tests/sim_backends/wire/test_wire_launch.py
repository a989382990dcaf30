"""Wire simulations start whole or not at all, and leave nothing behind."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from sim_backends.errors import SimulationError
from sim_backends.faults import Fault, FaultKind
from sim_backends.wire.endpoints import CrazyflieEndpoint, LimoEndpoint, MavlinkEndpoint, command_of
from sim_backends.wire.launch import WireSimulation, addresses_of, launch
from sim_backends.wire.ports import free_domain, free_loopback, free_udp_port
from sim_backends.world import SimUav, SimUgv, WorldConfig

CONFIG = WorldConfig(uavs=(SimUav("u0", "a"), SimUav("u1", "b", (1.0, 0.0))), ugvs=(SimUgv("g0", "c", (3.0, 0.0)),))


def wait_for(condition: Callable[[], object], deadline_s: float = 20.0) -> None:
    end_s = time.monotonic() + deadline_s
    while not condition():
        assert time.monotonic() < end_s
        time.sleep(0.02)


# --- addresses (no processes) ---


def test_everybody_gets_an_address_of_its_own() -> None:
    found = addresses_of(
        (
            CrazyflieEndpoint("cf1"),
            CrazyflieEndpoint("cf2", port=29850),
            LimoEndpoint("limo1"),
            LimoEndpoint("limo2", namespace="/robots/two"),
            MavlinkEndpoint("quad", "copter", sysid=7),
        )
    )
    assert len({a.endpoint for a in found.values()}) == 5
    assert found["cf1"].endpoint.startswith("udp://127.0.0.1:")
    assert found["cf2"].endpoint == "udp://127.0.0.1:29850"
    assert (found["limo1"].endpoint, found["limo2"].endpoint) == ("/limo1", "/robots/two")
    assert found["limo1"].domain == found["limo2"].domain is not None
    assert found["quad"].sysid == 7


@pytest.mark.parametrize(
    "endpoints",
    [
        (CrazyflieEndpoint("cf1"), CrazyflieEndpoint("cf1")),
        (CrazyflieEndpoint("cf1", 5000), CrazyflieEndpoint("cf2", 5000)),
        (LimoEndpoint("a", "/x"), LimoEndpoint("b", "/x")),
    ],
)
def test_two_at_one_place_are_an_error(endpoints: tuple[CrazyflieEndpoint, ...]) -> None:
    with pytest.raises(SimulationError, match="used twice"):
        addresses_of(endpoints)


def test_command_lines() -> None:
    quad = MavlinkEndpoint("quad", "copter", "ardupilot", 7, 14550, (-48.5, 11.25, -30.0))
    command = command_of(quad, addresses_of((quad,))["quad"], Path("/w"), 99)
    assert command[:3] == [sys.executable, "-m", "sim_backends.wire.mavlink_vehicle"]
    words = " ".join(command[3:])
    assert words == (
        "--world /w --vehicle quad --parent 99 --type copter --autopilot ardupilot --sysid 7 --out 127.0.0.1:14550 "
        "--origin=-48.5,11.25,-30.0"
    )
    limo = LimoEndpoint("limo1", domain=5, mode="mecanum")
    words = " ".join(command_of(limo, addresses_of((limo,))["limo1"], Path("/w"), 99)[3:])
    assert words == "--world /w --vehicle limo1 --parent 99 --namespace /limo1 --domain 5 --mode mecanum"


def test_free_places_are_free() -> None:
    assert free_udp_port() != free_udp_port()
    assert free_loopback().startswith("127.")
    assert 1 <= free_domain() <= 101


def test_two_programs_that_start_at_once_get_an_address_each() -> None:
    mine = free_loopback()
    code = "from sim_backends.wire.ports import free_loopback; print(free_loopback())"
    other = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=True)
    assert other.stdout.strip() != mine == free_loopback()


def test_a_vehicle_that_is_not_there_is_named() -> None:
    with pytest.raises(SimulationError, match=r"'nobody'.*u0, u1, g0"):
        launch(CONFIG, (), [CrazyflieEndpoint("nobody")])


# --- with processes ---


@pytest.fixture
def simulation() -> Iterator[WireSimulation]:
    faults = [
        Fault(FaultKind.UGV_STALL, "g0", at_s=0.3, duration_s=1.5),
        Fault(FaultKind.PLANNER_SLOW, at_s=0.0, value=2.0),
    ]
    running = launch(CONFIG, faults, (), mocap=False)
    yield running
    running.close()


@pytest.mark.wire
def test_faults_come_and_go_after_the_first_motion(simulation: WireSimulation) -> None:
    world = simulation.world
    time.sleep(0.5)
    assert world.modifiers(2).slow == 1.0, "nobody has moved yet"
    assert simulation.planner_delay_s() == 0.0
    world.start()
    started_s = world.started_s
    assert started_s is not None
    wait_for(lambda: world.modifiers(2).slow == 0.0)
    assert time.monotonic() - started_s > 0.3
    wait_for(lambda: world.modifiers(2).slow == 1.0)
    assert time.monotonic() - started_s > 1.8
    assert simulation.planner_delay_s() == 2.0


@pytest.mark.wire
def test_who_touches_loses_its_motors_and_the_truth_tells(simulation: WireSimulation) -> None:
    world = simulation.world
    for row in (0, 1):
        world.put(row, replace(world.body(row), position_m=(0.0, 0.0, 2.0 + 0.1 * row), airborne=True))
    wait_for(lambda: world.modifiers(0).motor_fail and world.modifiers(1).motor_fail)
    # nobody writes these two rows: the conductor takes them for orphans and lets them fall
    wait_for(lambda: world.body(0).tumbled and world.body(1).tumbled)
    wait_for(lambda: len(simulation.truth().violations) >= 3)
    simulation.close()
    truth = simulation.truth()
    assert [v.kind for v in truth.violations if v.kind != "separation"] == ["collision", "crash", "crash"]
    assert truth.vehicles["u0"].position_m[2] == 0.0
    assert not simulation.folder.exists()


@pytest.mark.wire
def test_an_endpoint_that_dies_is_told_with_its_last_words(simulation: WireSimulation) -> None:
    assert simulation.trouble() is None
    words = "import sys; print('ready'); print('it hurts', file=sys.stderr); sys.exit(7)"
    simulation.start("u0", [sys.executable, "-c", words])
    wait_for(lambda: simulation.trouble() is not None)
    assert "u0 has ended (exit code 7); it said: it hurts" in str(simulation.trouble())


@pytest.mark.wire
def test_an_endpoint_that_is_not_ready_in_time_ends_the_wait(simulation: WireSimulation) -> None:
    simulation.start("u0", [sys.executable, "-c", "import time; time.sleep(60)"])
    with pytest.raises(SimulationError, match="u0 was not ready in time"):
        simulation.wait_ready(time.monotonic() + 0.5)
    begun_s = time.monotonic()
    simulation.close()
    simulation.close()
    assert time.monotonic() - begun_s < 10.0
    assert simulation.process("u0").poll() is not None


@pytest.mark.wire
def test_everybody_ends_when_the_program_is_killed() -> None:
    code = (
        "import time\n"
        "from sim_backends.wire.launch import launch\n"
        "from sim_backends.world import SimUav, WorldConfig\n"
        "s = launch(WorldConfig(uavs=(SimUav('u0', 'a'),), ugvs=()), (), ())\n"
        "print(s.folder, *(s.process(n).pid for n in ('conductor', 'motion capture')), flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        folder, *pids = program.stdout.readline().split()
        children = [int(pid) for pid in pids]
        program.send_signal(signal.SIGKILL)
        program.wait()
    assert len(children) == 2
    wait_for(lambda: not any(psutil.pid_exists(pid) for pid in children))
    assert not Path(folder).exists()
