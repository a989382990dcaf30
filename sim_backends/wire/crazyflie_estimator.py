"""The Crazyflie's own estimate of where it is: follows the poses that it is fed, whether they are true or not.

A Kalman filter's behaviour rather than one: the error of the estimate shrinks with each pose by the filter's gain and
runs away without poses, and the variance that the firmware logs as ``kalman.varP*`` tells of it. Nothing else happens
when poses stop (fact 13: the firmware takes no action).
"""

from __future__ import annotations

import math
import random

from drivers.vehicle import Vec3
from sim_backends.wire.crazyflie_planner import wrap

INITIAL_VARIANCE = 100.0
"""After a reset, m^2 (``kalman_core``: standard deviation 100 m, capped at 10 m here)."""
MAX_VARIANCE = 100.0
NOISE = 5e-4
"""Growth of the variance while poses come, m^2/s; faster the longer there was none."""
QUIET_S = 0.1
SINK_MPS2 = 0.02
"""Bias of the vertical acceleration: without poses z is lost first (fact 21: -65 m after a while)."""
TURN_S = 20.0


class Estimator:
    """Estimate = truth + error."""

    def __init__(self, drift_mps: float, seed: int) -> None:
        """Starts lost, at the origin.

        Args:
            drift_mps: how fast the estimate runs away after two seconds without poses.
            seed: of the direction in which it does.
        """
        self._drift_mps = drift_mps
        self._random = random.Random(seed)
        self._turn_s = 0.0
        self._bearing = self._random.uniform(-math.pi, math.pi)
        self.variance = INITIAL_VARIANCE
        self.yaw_variance = 1.0
        self.age_s = 0.0
        self._error = [0.0, 0.0, 0.0]
        self._rate = [0.0, 0.0, 0.0]
        self.yaw_error = 0.0
        self.held = False

    def reset(self, truth_m: Vec3, truth_yaw: float, initial: tuple[float, float, float, float]) -> None:
        """Forgets everything: it believes to be at ``initial`` (x, y, z, yaw)."""
        self._error = [initial[i] - truth_m[i] for i in range(3)]
        self._rate = [0.0, 0.0, 0.0]
        self.yaw_error = wrap(initial[3] - truth_yaw)
        self.variance, self.yaw_variance, self.age_s = INITIAL_VARIANCE, 1.0, 0.0

    def step(self, dt_s: float) -> None:
        """Lets ``dt_s`` pass without a pose."""
        self.age_s += dt_s
        grown = NOISE * dt_s * (1.0 + (self.age_s / QUIET_S) ** 2)
        self.variance = min(MAX_VARIANCE, self.variance + grown)
        if self.age_s < 2.0 * QUIET_S:
            return
        self._turn_s += dt_s
        if self._turn_s > TURN_S:
            self._turn_s, self._bearing = 0.0, self._random.uniform(-math.pi, math.pi)
        gain = 0.5 * self._drift_mps * dt_s
        self._rate[0] += gain * math.cos(self._bearing)
        self._rate[1] += gain * math.sin(self._bearing)
        self._rate[2] -= SINK_MPS2 * dt_s
        for i in range(3):
            self._error[i] += self._rate[i] * dt_s

    def pose(self, measured_m: Vec3, measured_yaw: float | None, truth_m: Vec3, truth_yaw: float, std_m: float) -> None:
        """Takes in a pose from outside.

        Args:
            measured_m: what it says.
            measured_yaw: None where it is a position only.
            truth_m: where the vehicle is.
            truth_yaw: its heading.
            std_m: parameter ``locSrv.extPosStdDev``.
        """
        gain = self.variance / (self.variance + std_m * std_m)
        for i in range(3):
            self._error[i] += gain * (measured_m[i] - truth_m[i] - self._error[i])
            self._rate[i] *= 1.0 - gain
        self.variance *= 1.0 - gain
        self.age_s = 0.0
        if measured_yaw is not None:
            self.yaw_error = wrap(self.yaw_error + max(gain, 0.1) * wrap(measured_yaw - truth_yaw - self.yaw_error))
            self.yaw_variance = max(1e-5, 0.5 * self.yaw_variance)

    def position(self, truth_m: Vec3) -> Vec3:
        """Where it believes to be."""
        e = self._error
        return (truth_m[0] + e[0], truth_m[1] + e[1], truth_m[2] + e[2])

    def velocity(self, truth_mps: Vec3) -> Vec3:
        """How fast it believes to be."""
        r = self._rate
        return (truth_mps[0] + r[0], truth_mps[1] + r[1], truth_mps[2] + r[2])
