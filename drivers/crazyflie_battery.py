"""How full a Crazyflie's battery is. Pure.

The vehicle's own ``pm.batteryLevel`` comes from the voltage in steps of ten and forgets that the voltage sags under the
load of flying (``pm_stm32f4.c``): a full battery in flight reads as half empty. So the share is taken from the voltage
here, with the sag added back while the motors run.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

Curve = Sequence[tuple[float, float]]

LIPO_CURVE = (
    (3.00, 0.0), (3.78, 0.1), (3.83, 0.2), (3.87, 0.3), (3.89, 0.4), (3.92, 0.5), (3.96, 0.6), (4.00, 0.7), (4.04, 0.8),
    (4.10, 0.9), (4.20, 1.0),
)  # fmt: skip
"""Share over V without load: the firmware's own table."""
SMOOTH_S = 3.0
"""The curve is flat, 10 mV are some percent: noise has to be smoothed, and energy changes slowly."""
SETTLE_S = 1.5
"""After the motors start or stop, the voltage says nothing for so long."""
CHARGED = 2
"""``pm.state``."""
CHARGING_V = 0.05
"""A charger lifts the voltage by about that."""


def interpolate(curve: Curve, volts: float) -> float:
    """The share at ``volts``, linear between the points of the curve and flat beyond them."""
    i = bisect_right([v for v, _ in curve], volts)
    if i == 0 or i == len(curve):
        return curve[min(i, len(curve) - 1)][1]
    (v0, s0), (v1, s1) = curve[i - 1], curve[i]
    return s0 + (s1 - s0) * (volts - v0) / (v1 - v0)


def is_curve(curve: Curve) -> bool:
    """Whether it has two points or more, rising volts and shares within 0..1."""
    rising = all(a[0] < b[0] for a, b in pairwise(curve))
    return len(curve) >= 2 and rising and all(0.0 <= share <= 1.0 for _, share in curve)


@dataclass
class BatteryGauge:
    """The gauge of one vehicle.

    Attributes:
        curve: share over V without load.
        sag_v: by which flying lowers the voltage.
        share: 0..1; None before anything was told.
    """

    curve: Curve
    sag_v: float
    share: float | None = None
    _loaded: bool | None = None
    _changed_s: float = 0.0
    _before_s: float = 0.0

    def put(self, now_s: float, values: Mapping[str, float], loaded: bool, charging: bool) -> None:
        """Takes the newest log values.

        Args:
            now_s: the time.
            values: with ``pm.vbat`` in V, or ``pm.batteryLevel`` in percent where that is all there is.
            loaded: the motors carry it.
            charging: the charger works.
        """
        volts, level = values.get("pm.vbat"), values.get("pm.batteryLevel")
        if volts is None:
            self.share = self.share if level is None else min(max(level / 100.0, 0.0), 1.0)
            return
        if loaded != self._loaded:
            first = self._loaded is None
            self._loaded, self._changed_s = loaded, now_s - (SETTLE_S if first else 0.0)
        dt, self._before_s = now_s - self._before_s, now_s
        if self.share is not None and now_s - self._changed_s < SETTLE_S:
            return
        if values.get("pm.state") == CHARGED:
            self.share = 1.0
            return
        share = interpolate(self.curve, volts + (self.sag_v if loaded else 0.0) - (CHARGING_V if charging else 0.0))
        f = 1.0 if self.share is None else min(1.0, dt / SMOOTH_S)
        known = share if self.share is None else self.share
        share = known + f * (share - known)
        # what is being charged never gets emptier, whatever its voltage says
        self.share = max(share, known) if charging else share
