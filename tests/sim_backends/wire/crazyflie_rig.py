"""The simulated Crazyflie's process, its world and the motion capture that a test plays; waiting and logging."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

from cflib.crazyflie import Crazyflie
from cflib.crazyflie.log import LogConfig
from cflib.crazyflie.syncCrazyflie import SyncCrazyflie
from cflib.crazyflie.syncLogger import SyncLogger

from sim_backends.wire.world import Modifiers, World
from sim_backends.world import SimUav, SimUgv, WorldConfig

ROOT = Path(__file__).parents[3]
FLYING, LOCKED = 0x10, 0x40
UAV = SimUav("uav0", "u", (0.3, -0.2), tracking_noise_m=0.01, dock_noise_m=0.003, energy_j=200_000.0)
UGV = SimUgv("ugv0", "g", (1.0, -0.2), pad_height_m=0.2, dock_offsets_m=((0.0, 0.0),), charge_s=60.0)


class Server:
    """The process, its world, and the motion capture that this test plays."""

    def __init__(self, folder: Path, *options: str) -> None:
        config = WorldConfig((UAV,), (UGV,), dock_tolerance_m=0.05)
        self.world = World.create(folder / "world", config)
        self.world.put(1, self.world.body(1))
        self.cache = str(folder / "cache")
        command = [sys.executable, "-m", "sim_backends.wire.crazyflie_server", "--world", str(self.world.folder)]
        self.process = subprocess.Popen(
            [*command, "--port", "0", *options], cwd=ROOT, stdout=subprocess.PIPE, text=True
        )
        assert self.process.stdout is not None
        word, _, self.uri = self.process.stdout.readline().strip().partition(" ")
        assert word == "ready"
        self.address = ("127.0.0.1", int(self.uri.rpartition(":")[2]))

    def stop(self) -> None:
        self.process.terminate()
        self.process.wait(20.0)

    @contextlib.contextmanager
    def connected(self, *, feed: bool = True) -> Iterator[SyncCrazyflie]:
        with SyncCrazyflie(self.uri, cf=Crazyflie(rw_cache=self.cache)) as scf:
            scf.wait_for_params()
            over = threading.Event()
            eyes = threading.Thread(target=self._feed, args=(scf.cf, over))
            if feed:
                eyes.start()
            try:
                yield scf
            finally:
                over.set()
                if feed:
                    eyes.join()

    def _feed(self, cf: Crazyflie, over: threading.Event) -> None:
        while not over.wait(0.02):
            body = self.world.body(0)
            cf.extpos.send_extpose(*map(float, body.position_m), *map(float, body.quaternion))

    def fault(self, **changes: object) -> None:
        self.world.modify(0, replace(Modifiers(swap=0), **changes))  # type: ignore[arg-type]

        for _ in range(2):  # the turn under way may have looked before
            turn_s = self.world.body(0).time_s
            until(lambda before_s=turn_s: self.world.body(0).time_s != before_s)

    def height(self) -> float:
        return float(self.world.body(0).position_m[2])


def until(condition: Callable[[], bool], what: str = "", seconds: float = 30.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, f"did not happen in time: {what}"
        time.sleep(0.02)


def log_rows(scf: SyncCrazyflie, names: tuple[str, ...], count: int, period_ms: int = 20) -> list[dict[str, float]]:
    config = LogConfig("test", period_ms)
    for name in names:
        config.add_variable(name)
    rows: list[dict[str, float]] = []
    with SyncLogger(scf, config) as logger:
        for _, row, _ in logger:
            rows.append(row)
            if len(rows) >= count:
                break
    return rows


def info(scf: SyncCrazyflie) -> int:
    return int(log_rows(scf, ("supervisor.info",), 1)[0]["supervisor.info"])
