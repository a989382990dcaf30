"""What the Crazyflie tells of its battery: voltage under load, the coarse level, the charger's state.

Source: ``pm_stm32f4.c`` of the firmware; the energy itself is the world's (``physics.UavBattery``).
"""

from __future__ import annotations

from bisect import bisect_right

BATTERY, CHARGING, CHARGED, LOW_POWER, SHUTDOWN = range(5)
CURVE_V = (3.00, 3.78, 3.83, 3.87, 3.89, 3.92, 3.96, 4.00, 4.04, 4.10, 4.20)
"""Open-circuit voltage at 0, 10, ... 100 percent; the firmware's table up to 90."""
SAG_V = 0.25
"""Under the load of flying."""
LOW_S = 5.0


def rest_v(level: float) -> float:
    """Voltage without load at ``level`` (0..1)."""
    at = max(0.0, min(1.0, level)) * (len(CURVE_V) - 1)
    i = min(int(at), len(CURVE_V) - 2)
    return CURVE_V[i] + (at - i) * (CURVE_V[i + 1] - CURVE_V[i])


def percent(vbat: float) -> int:
    """The firmware's level: steps of ten, from the voltage alone, 90 at the most."""
    return 10 * max(0, min(9, bisect_right(CURVE_V, vbat) - 1))


class Power:
    """The power management's view, updated in each step."""

    def __init__(self, low_v: float) -> None:
        """Starts with a full battery.

        Args:
            low_v: below this for 5 s the state is ``LOW_POWER``; below 3.0 V for as long ``SHUTDOWN``.
        """
        self.low_v, self.critical_v = low_v, 3.0
        self.vbat = CURVE_V[-1]
        self.state = BATTERY
        self._low_s = self._critical_s = 0.0

    def step(self, level: float, charging: bool, motors: bool, dt_s: float) -> None:
        """Lets ``dt_s`` pass.

        Args:
            level: of the battery, 0..1.
            charging: the charger has contact.
            motors: they carry the vehicle.
            dt_s: firmware seconds.
        """
        target = rest_v(level) - (SAG_V if motors else 0.0) + (0.05 if charging and level < 1.0 else 0.0)
        self.vbat += (target - self.vbat) * min(1.0, dt_s / 0.3)
        if charging:
            self.state = CHARGED if level >= 1.0 else CHARGING
            self._low_s = self._critical_s = 0.0
            return
        self._low_s = self._low_s + dt_s if self.vbat < self.low_v else 0.0
        self._critical_s = self._critical_s + dt_s if self.vbat < self.critical_v else 0.0
        self.state = SHUTDOWN if self._critical_s > LOW_S else LOW_POWER if self._low_s > LOW_S else BATTERY
