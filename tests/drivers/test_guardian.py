"""The process that brings vehicles down when the ground station dies: real processes, real pipes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from drivers.guardian import Guardian
from drivers.last_will import LastWill

STATION = """
import sys, time
from drivers.guardian import Guardian
from drivers.last_will import LastWill
notes = "tests.drivers.note_taker"
wills = [LastWill(v, notes, {"file": f"{sys.argv[1]}/{v}", "fails": v == "bad"}) for v in ("cf1", "cf2", "bad")]
guardian = Guardian(wills, silence_s=float(sys.argv[2]))
guardian.tell({"bad": 1.0, "cf1": 0.6}, 0.0)
print(guardian.pid, flush=True)
time.sleep(60)
"""


def wait_for(path: Path, timeout_s: float = 40.0) -> str:
    end_s = time.monotonic() + timeout_s
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < end_s, f"{path.name} was never written"
        time.sleep(0.02)
    return path.read_text()


def gone(pid: int, timeout_s: float = 30.0) -> bool:
    """Whether the process, which may be nobody's child any more, ends in time."""
    end_s = time.monotonic() + timeout_s
    while psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE:
        if time.monotonic() > end_s:
            return False
        time.sleep(0.02)
    return True


def station(folder: Path, silence_s: float) -> tuple[subprocess.Popen[str], int]:
    process = subprocess.Popen(
        [sys.executable, "-c", STATION, str(folder), str(silence_s)], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    return process, int(process.stdout.readline())


@pytest.mark.wire
def test_a_killed_station_leaves_its_will(tmp_path: Path) -> None:
    process, guardian = station(tmp_path, 60.0)
    process.kill()
    process.wait()
    assert wait_for(tmp_path / "cf1") == "0.6"
    assert gone(guardian)
    assert not (tmp_path / "cf2").exists(), "it was not under way"


@pytest.mark.wire
def test_a_station_that_hangs_leaves_its_will(tmp_path: Path) -> None:
    process, guardian = station(tmp_path, 0.5)
    process.send_signal(signal.SIGSTOP)
    try:
        assert wait_for(tmp_path / "cf1") == "0.6"
        assert process.wait(20.0) == -signal.SIGKILL, "it must not wake up and fly on"
    finally:
        process.kill()
        process.wait()
    assert gone(guardian)


@pytest.mark.wire
def test_a_farewell_with_everybody_down_does_nothing(tmp_path: Path) -> None:
    guardian = Guardian([LastWill("cf1", "tests.drivers.note_taker", {"file": str(tmp_path / "cf1")})])
    pid = guardian.pid
    assert pid is not None
    guardian.tell({"cf1": 1.0}, 0.0)
    guardian.tell({}, 0.1)
    guardian.close()
    guardian.close()
    guardian.wait()
    assert gone(pid)
    assert guardian.pid is None
    assert not (tmp_path / "cf1").exists()


@pytest.mark.wire
def test_the_end_of_a_flight_with_somebody_in_the_air_leaves_the_will(tmp_path: Path) -> None:
    guardian = Guardian([LastWill("cf1", "tests.drivers.note_taker", {"file": str(tmp_path / "cf1")})])
    guardian.tell({"cf1": 1.5}, 0.0)
    guardian.close()
    guardian.wait()
    assert (tmp_path / "cf1").read_text() == "1.5"
    assert guardian.pid is None


@pytest.mark.wire
def test_signals_are_the_stations_to_handle(tmp_path: Path) -> None:
    process, guardian = station(tmp_path, 60.0)
    for number in (signal.SIGINT, signal.SIGHUP, signal.SIGTERM):
        os.kill(guardian, number)
    process.kill()
    process.wait()
    assert wait_for(tmp_path / "cf1") == "0.6"
    assert gone(guardian)


@pytest.mark.wire
def test_telling_never_blocks_and_costs_next_to_nothing(tmp_path: Path) -> None:
    guardian = Guardian([], say=lambda _: None)
    pid = guardian.pid
    assert pid is not None
    os.kill(pid, signal.SIGSTOP)
    begun_s, turns = time.perf_counter(), 5000
    for turn in range(turns):
        guardian.tell({"cf1": 1.0, "cf2": 1.0}, turn * 1.0)  # each of them is sent
    each_s = (time.perf_counter() - begun_s) / turns
    print(f"one message to the guardian: {1e6 * each_s:.1f} us")
    assert each_s < 1e-4
    assert guardian.lost is not None, "its pipe was full"
    assert gone(pid), "it must not wake up and take the silence for our death"


@pytest.mark.wire
def test_nobody_under_way_needs_no_will(tmp_path: Path) -> None:
    guardian = Guardian([LastWill("cf1", "tests.drivers.note_taker", {"file": str(tmp_path / "cf1")})])
    pid = guardian.pid
    assert pid is not None
    guardian.tell({"cf1": 1.0}, 0.0)
    guardian.tell({}, 1.0)
    os.close(guardian._pipe.fileno())  # as when the station is killed
    assert gone(pid)
    assert not (tmp_path / "cf1").exists()


@pytest.mark.wire
def test_a_dead_guardian_is_a_warning_and_no_crash(caplog: pytest.LogCaptureFixture) -> None:
    guardian = Guardian([])
    pid = guardian.pid
    assert pid is not None
    os.kill(pid, signal.SIGKILL)
    assert gone(pid)
    for turn in range(3):
        guardian.tell({"cf1": 1.0}, float(turn))
    assert caplog.text.count("guardian process has died") == 1
    guardian.close()
    guardian.wait()
