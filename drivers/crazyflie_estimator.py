"""When a Crazyflie's estimate may be trusted: reset it, then wait until its variance has settled. Pure.

``supervisor.info`` says "can fly" with an estimate 65 m off, so nothing else shows it. The gate is the one of cflib's
``reset_estimator`` (ten samples of ``kalman.varPX/PY/PZ``, each within 0.001), which has no time limit of its own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

from drivers.vehicle import Pose

VARIANCES = ("kalman.varPX", "kalman.varPY", "kalman.varPZ")
RESET_S = 0.1
LOST_M2 = 0.05
"""A settled estimate that has got so bad again (poses stopped, the vehicle was carried away) is reset."""

Phase = Literal["no poses", "resetting", "settling", "ready", "failed"]


@dataclass(frozen=True, slots=True)
class SetParameter:
    """An order to the vehicle: set a parameter."""

    name: str
    value: float


@dataclass
class EstimatorGate:
    """Follows one vehicle's estimator; ``step`` says what to set.

    Attributes:
        window_s: how long the variances must have stood still.
        samples: fewest samples in that time.
        spread: greatest difference among them, m^2.
        timeout_s: after a reset; then it is reset again.
        poses_s: external poses must have come for so long before a reset makes sense.
        can_tell: the vehicle logs the variances; where it does not, the window passes unseen.
    """

    window_s: float
    samples: int
    spread: float
    timeout_s: float
    poses_s: float = 0.3
    can_tell: bool = True
    phase: Phase = "no poses"
    resets: int = 0
    variance_m2: float | None = None
    _since_s: float = 0.0
    _first_pose_s: float | None = None
    _last_pose_s: float = 0.0
    _seen: deque[tuple[float, tuple[float, ...]]] = field(default_factory=deque)

    @property
    def ready(self) -> bool:
        """Whether the estimate has settled on the poses."""
        return self.phase == "ready"

    def restart(self) -> None:
        """The vehicle has rebooted: everything from the start."""
        self.phase, self._first_pose_s, self.variance_m2 = "no poses", None, None
        self._seen.clear()

    def fed(self, now_s: float) -> None:
        """A pose went out."""
        if self._first_pose_s is None or now_s - self._last_pose_s > 1.0:
            self._first_pose_s = now_s
        self._last_pose_s = now_s

    def logged(self, now_s: float, variances: Sequence[float]) -> None:
        """A sample of the variances came in, m^2."""
        self.variance_m2 = max(variances)
        if self.phase in ("settling", "failed"):
            self._seen.append((now_s, tuple(variances)))

    def step(self, now_s: float, pose: Pose | None) -> list[SetParameter]:
        """What to set now; not to be called in the air, where a reset would be a fall.

        Args:
            now_s: the time.
            pose: newest pose fed; the reset starts there.
        """
        match self.phase:
            case "no poses" if pose is not None and self._first_pose_s is not None:
                if self._last_pose_s - self._first_pose_s >= self.poses_s:
                    return self._reset(now_s, pose)
            case "resetting" if now_s - self._since_s >= RESET_S:
                self.phase, self._since_s = "settling", now_s
                self._seen.clear()
                return [SetParameter("kalman.resetEstimation", 0)]
            case "settling" | "failed":
                if self._settled(now_s):
                    self.phase = "ready"
                elif now_s - self._since_s > self.timeout_s:
                    if pose is not None and now_s - self._last_pose_s < 1.0:
                        return self._reset(now_s, pose)
                    self.phase = "failed"
            case "ready" if self.variance_m2 is not None and self.variance_m2 > LOST_M2:
                self.restart()
            case _:
                pass
        return []

    def _reset(self, now_s: float, pose: Pose) -> list[SetParameter]:
        self.phase, self._since_s = "resetting", now_s
        self.resets += 1
        x, y, z = pose.position_m
        return [
            SetParameter("stabilizer.estimator", 2),
            SetParameter("kalman.initialX", x),
            SetParameter("kalman.initialY", y),
            SetParameter("kalman.initialZ", z),
            SetParameter("kalman.initialYaw", pose.yaw_rad),
            SetParameter("kalman.resetEstimation", 1),
        ]

    def _settled(self, now_s: float) -> bool:
        # poses that stopped meanwhile would let the variance grow, but slowly: ask for them, too
        if now_s - self._since_s < self.window_s or now_s - self._last_pose_s > 0.5:
            return False
        if not self.can_tell:
            return True
        while self._seen and self._seen[0][0] < now_s - 1.2 * self.window_s:
            self._seen.popleft()
        if len(self._seen) < self.samples or self._seen[-1][0] - self._seen[0][0] < 0.8 * self.window_s:
            return False
        return all(max(column) - min(column) < self.spread for column in zip(*(v for _, v in self._seen), strict=True))
