"""How one Crazyflie is connected and flown: every number with its reason."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from pathlib import Path

from drivers.crazyflie_battery import LIPO_CURVE, is_curve
from drivers.errors import DriverError


def default_cache() -> Path:
    """Where tables of contents are kept between flights; they are the same for one firmware everywhere."""
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base) if base else Path.home() / ".cache") / "copcs-deploy" / "crazyflie"


@dataclass(frozen=True, slots=True)
class CrazyflieOptions:
    """Settings of the driver; s, m, m/s and ms as the names say.

    Raises:
        DriverError: when a number is out of range.
    """

    cache: Path | None = None
    """Folder of cached tables of contents; they shorten connecting by seconds. None: the user's cache folder."""
    answer_s: float = 2.0
    """An attempt to connect without any packet for so long is dropped and begun anew on a fresh link."""
    fast_ms: int = 50
    """Period of state and position: at most so late is a state seen. 20 blocks/s a vehicle leave a radio room."""
    slow_ms: int = 200
    """Period of battery, variances and radio, on which nothing waits for less than a second."""
    telemetry_s: float = 1.5
    """No log for so long counts as a lost link: 30 periods of the fast block."""
    send_attitude: bool = True
    """Send the heading as well. Without it (markers that show no heading) the vehicle's own heading drifts."""
    attitude_std_rad: float = 0.5
    """``locSrv.extQuatStdDev``: how little the sent attitude counts. It knows only the heading and claims to be level:
    with the firmware's own 0.0045 it would talk a tilted vehicle into being level. 0.5 leaves the tilt to the vehicle's
    own sensors and still ties its heading down, within about half a minute."""
    pose_rate_hz: float = 100.0
    """No more poses than this are passed on; more than the radio carries would delay each of them."""
    pose_s: float = 0.5
    """An older pose is stale: docking aborts, and motions are no longer compared with it."""
    converge_s: float = 5.0
    """The estimate's variance must have stood still for so long: ten samples of 500 ms, as cflib's own helper asks."""
    converge_samples: int = 10
    """Fewest samples in that time."""
    converge_m2: float = 0.001
    """Greatest difference of the variances among them, as in cflib's helper."""
    converge_timeout_s: float = 20.0
    """Then the estimator is reset again and a check says so; a good one settles within two seconds."""
    charge_confirm_s: float = 3.0
    """The charger must answer within, after touch-down; ``pm.state`` takes about a second."""
    dock_range_m: float = 0.5
    """A docking from further away aborts: it should begin above the dock."""
    dock_speed_mps: float = 0.05
    """A dock that moves faster than motion capture's noise aborts the docking."""
    align_s: float = 10.0
    """Misaligned for so long above a dock aborts."""
    touch_m: float = 0.08
    """Height above the dock at which it aligns for the last time; below, its own downwash pushes it about."""
    astray_m: float = 0.3
    """So far off its set-point, for a second, a command was lost; normal tracking stays within 0.1 m."""
    cruise: bool = True
    """Fly long legs at constant speed where the firmware can (protocol 8 and later), else in one polynomial."""
    battery_curve: tuple[tuple[float, float], ...] = LIPO_CURVE
    """(V, share of the usable energy) of the battery without load; the firmware's own table."""
    battery_sag_v: float = 0.25
    """By which flying lowers the voltage, with the standard battery: compare ``pm.vbat`` before and after a start."""
    reconnect: bool = True
    """Connect again when the link is lost: a vehicle that still hovers can then be landed."""

    def __post_init__(self) -> None:
        for name in (
            "answer_s", "telemetry_s", "pose_rate_hz", "pose_s", "converge_s", "converge_m2", "converge_timeout_s",
            "attitude_std_rad", "charge_confirm_s", "dock_range_m", "dock_speed_mps", "align_s", "touch_m", "astray_m",
        ):  # fmt: skip
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise DriverError(f"crazyflie options: {name} is {value!r}; give a number above 0")
        for name in ("fast_ms", "slow_ms"):
            if not 10 <= getattr(self, name) <= 2540:
                raise DriverError(f"crazyflie options: {name} is {getattr(self, name)!r}; give 10 to 2540 ms")
        if self.converge_samples < 2:
            raise DriverError(f"crazyflie options: converge_samples is {self.converge_samples}; give 2 or more")
        if self.converge_s * 1000 < 0.8 * self.converge_samples * self.slow_ms:
            raise DriverError(
                f"crazyflie options: {self.converge_samples} samples every {self.slow_ms} ms do not fit into "
                f"converge_s {self.converge_s:g}; lengthen it or lower slow_ms"
            )
        if not (math.isfinite(self.battery_sag_v) and self.battery_sag_v >= 0):
            raise DriverError(f"crazyflie options: battery_sag_v is {self.battery_sag_v!r}; give V, 0 or more")
        if not is_curve(self.battery_curve):
            raise DriverError("crazyflie options: battery_curve needs two or more (V, share) with rising V, 0..1")
