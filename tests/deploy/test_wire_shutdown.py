"""However a flight ends, everybody comes down before the links close, and nothing is left running."""

from __future__ import annotations

import math
import os
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from wire_runs import PROGRAM, nothing_left, small, small_file

from deploy import session
from deploy.fleet import Fleet
from deploy.observation import OperatorInput
from deploy.operator import ScriptedOperator
from deploy.session import run_mission
from drivers.clock import Clock

pytestmark = pytest.mark.wire
ROOT = Path(__file__).resolve().parents[2]


class Clumsy(ScriptedOperator):
    """Breaks the loop some time after something has happened."""

    def __init__(self, condition: Callable[[], bool], after_s: float) -> None:
        super().__init__()
        self._condition, self._after_s, self._at_s, self._now = condition, after_s, math.inf, lambda: 0.0

    def attach(self, clock: Clock) -> None:
        super().attach(clock)
        self._now = clock.now

    def poll(self) -> tuple[OperatorInput, ...]:
        if self._condition():
            self._at_s = min(self._at_s, self._now() + self._after_s)
        if self._now() > self._at_s:
            raise ZeroDivisionError("a bug in the loop")
        return super().poll()


def test_a_loop_that_breaks_lands_everybody_before_it_closes_the_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleets: list[Fleet] = []
    real = session.connect
    flew: list[bool] = []

    def remember(*args: object, **kwargs: object) -> Fleet:
        fleets.append(real(*args, **kwargs))  # type: ignore[arg-type]
        close = fleets[0].close

        def closing() -> None:
            flew.append(any(v.state().airborne for v in fleets[0].vehicles.values()))
            close()

        fleets[0].close = closing  # type: ignore[method-assign]
        return fleets[0]

    def all_fly() -> bool:
        return bool(fleets) and all(v.state().airborne for v in fleets[0].vehicles.values() if v.kind == "uav")

    monkeypatch.setattr(session, "connect", remember)
    with nothing_left(), pytest.raises(ZeroDivisionError):
        run_mission(small(3), out=tmp_path / "run", backend="sim", sim="wire", operator=Clumsy(all_fly, 1.0))
    assert "guardian" not in capfd.readouterr().err, "everybody was down; it had nothing to do"
    assert flew == [False], "the links were closed under somebody who flew"
    assert fleets[0].truth is not None
    truth = fleets[0].truth()
    assert truth.min_uav_distance_m < 10.0, "both were in the air when the loop broke"
    assert truth.violations == ()
    assert not any(v.airborne or v.tumbled for v in truth.vehicles.values())


def test_a_lost_terminal_brings_everybody_down(tmp_path: Path) -> None:
    mission = small_file(tmp_path / "mission", 3)
    command = [*PROGRAM, "run", str(mission), "--sim", "wire", "--out", str(tmp_path / "run")]
    env = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with nothing_left():
        program = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT, env=env
        )
        assert program.stdout is not None
        lines: list[str] = []
        killer = threading.Timer(180.0, program.kill)
        killer.start()
        for line in program.stdout:
            lines.append(line)
            if "running" in line:
                time.sleep(6.0)  # both are in the air
                program.send_signal(signal.SIGHUP)
        code = program.wait()
        killer.cancel()
    said = "".join(lines)
    assert "bringing everybody down" in said
    assert "aborted: everybody is down" in said, said
    assert code == 3
    assert "crash" not in said
    assert "guardian" not in said, "it is the program itself that handles signals"


def test_a_fleet_that_cannot_be_reached_is_named_one_by_one(tmp_path: Path) -> None:
    mission = small_file(
        tmp_path / "mission",
        localisation__mocap={"type": "optitrack", "hostname": "127.0.0.254"},
        localisation__connect_s=4.0,
    )
    command = [*PROGRAM, "run", str(mission), "--backend", "real", "--out", str(tmp_path / "run")]
    begun_s = time.monotonic()
    done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=120, check=False)
    assert time.monotonic() - begun_s < 60.0
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stdout + done.stderr
    for name in ("cf1", "cf2", "limo1", "limo2", "poses"):
        assert f"{name}: failed: " in done.stdout
    assert "check 'links' failed" in done.stderr
    assert not (tmp_path / "run").exists()
