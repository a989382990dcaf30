"""Landing precisely on a UGV's dock with a high-level commander that only knows rest-to-rest motions. Pure.

Above the dock it aligns by short ``go_to``s, each at rest before the next. Then one smooth descent leads to a hand's
breadth above the dock; while it runs, the target is shifted a few times a second by what the error to the pad asks
for, over the time that is left, so that the overlapping polynomials are nearly the same. Aligned there at rest, it
lands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from drivers.crazyflie_motion import Segment, SetPoint, rest_to_rest_s
from drivers.limits import UavLimits
from drivers.vehicle import Vec2, Vec3


@dataclass(frozen=True, slots=True)
class DockRules:
    """What a docking tolerates.

    Attributes:
        tolerance_m: misalignment at touch-down.
        range_m: a dock further away aborts at once.
        pad_speed_mps: a faster one aborts.
        align_s: misaligned for so long aborts.
        touch_m: height above the dock from which it lands.
    """

    tolerance_m: float
    range_m: float
    pad_speed_mps: float
    align_s: float
    touch_m: float


@dataclass(frozen=True, slots=True)
class DockView:
    """What a docking vehicle sees.

    Attributes:
        now_s: the time.
        position_m: itself in motion capture; None when that is stale.
        pad_m: the dock; None when its pose is stale.
        pad_speed_mps: how fast it moves.
        set_point: where the vehicle's set-point is.
        segment: the motion under way or the last one.
    """

    now_s: float
    position_m: Vec3 | None
    pad_m: Vec3 | None
    pad_speed_mps: float
    set_point: SetPoint
    segment: Segment


@dataclass(frozen=True, slots=True)
class Move:
    """Go to a point within a time."""

    end_m: Vec3
    duration_s: float


@dataclass(frozen=True, slots=True)
class Brake:
    """Stop where you are."""


@dataclass(frozen=True, slots=True)
class Descend:
    """Land on ``height_m`` within a time; the motors stop there."""

    height_m: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Abort:
    """Climb away."""

    why: str


@dataclass(frozen=True, slots=True)
class Touched:
    """It stands on the dock."""


Decision = Move | Brake | Descend | Abort | Touched | None
GAIN = 0.7
SETTLE_S = 0.3
SHIFT_EVERY_S = 0.2
SHIFT_FROM_M = 0.012
LAST_SHIFT_S = 0.8
"""Later shifts would have to be violent; the last hand's breadth is flown from rest anyway."""


@dataclass
class Docking:
    """One attempt to dock."""

    rules: DockRules
    limits: UavLimits
    speed_mps: float
    stage: Literal["align", "descend", "settle", "land", "touched"] = "align"
    _blocked_s: float | None = None
    _settling_s: float | None = None
    _shifted_s: float = -math.inf
    _error_m: Vec2 | None = field(default=None)
    _before_s: float | None = None

    def step(self, view: DockView) -> Decision:
        """What to do next; None is to go on."""
        lowest = self.stage == "land" and view.now_s > view.segment.end_s - 0.5 * view.segment.duration_s
        if view.position_m is None or view.pad_m is None:
            # so near the dock it can no longer see, stopping halfway is worse than going on
            return self._touch(view) if lowest else Abort("a pose is stale")
        off, above = self._look(view, view.position_m, view.pad_m)
        rules = self.rules
        if not lowest:
            if off > rules.range_m:
                return Abort(f"the dock is {off:.2f} m away")
            if view.pad_speed_mps > rules.pad_speed_mps:
                return Abort("the dock moves")
            if above < -0.03:
                return Abort("it is below the dock")
        aligned = off <= max(rules.tolerance_m, 0.3 * above)
        if aligned:
            self._blocked_s = None
        elif self._blocked_s is None:
            self._blocked_s = view.now_s
        if self._blocked_s is not None and view.now_s - self._blocked_s > rules.align_s and not lowest:
            return Abort(f"{off:.2f} m beside the dock for {rules.align_s:g} s")
        match self.stage:
            case "align":
                return self._align(view, off, above, view.pad_m)
            case "descend":
                return self._descend(view, aligned, view.pad_m)
            case "settle":
                return self._settle(view, off, view.pad_m)
            case "land" if not lowest and off > 1.5 * rules.tolerance_m and above > 0.03:
                return Abort(f"{off:.2f} m beside the dock at touch-down")
            case "land":
                return self._touch(view)
            case _:
                return None

    def _look(self, view: DockView, position_m: Vec3, pad_m: Vec3) -> tuple[float, float]:
        """Distance beside and above the dock; smooths the error by which motions are shifted."""
        ex, ey = pad_m[0] - position_m[0], pad_m[1] - position_m[1]
        dt = 0.0 if self._before_s is None else view.now_s - self._before_s
        self._before_s = view.now_s
        if self._error_m is None:
            self._error_m = (ex, ey)
        f = 1.0 - math.exp(-dt / 0.15)
        self._error_m = (self._error_m[0] + f * (ex - self._error_m[0]), self._error_m[1] + f * (ey - self._error_m[1]))
        return math.hypot(ex, ey), position_m[2] - pad_m[2]

    def _corrected(self, view: DockView, gain: float) -> Vec2:
        assert self._error_m is not None
        x, y, _ = view.set_point.position_m
        return (x + gain * self._error_m[0], y + gain * self._error_m[1])

    def _settled(self, view: DockView) -> bool:
        return view.set_point.resting and view.now_s > view.segment.end_s + SETTLE_S

    def _align(self, view: DockView, off: float, above: float, pad_m: Vec3) -> Decision:
        if not self._settled(view):
            return None
        here = view.set_point.position_m
        if off <= 0.7 * max(self.rules.tolerance_m, 0.3 * above):
            if above <= self.rules.touch_m + 0.03:
                self.stage, self._settling_s = "settle", None
                return None
            self.stage, self._shifted_s = "descend", view.now_s
            end = (*self._corrected(view, GAIN), pad_m[2] + self.rules.touch_m)
            return Move(end, rest_to_rest_s(here, end, self.speed_mps, self.limits))
        beside = (*self._corrected(view, GAIN if off < 0.1 else 1.0), here[2])
        return Move(beside, rest_to_rest_s(here, beside, self.limits.max_speed_mps, self.limits))

    def _descend(self, view: DockView, aligned: bool, pad_m: Vec3) -> Decision:
        if not aligned:
            self.stage = "align"
            return Brake()
        left_s = view.segment.end_s - view.now_s
        if self._settled(view):
            self.stage, self._settling_s = "settle", None
            return None
        if left_s < LAST_SHIFT_S or view.now_s - self._shifted_s < SHIFT_EVERY_S:
            return None
        x, y = self._corrected(view, 1.0)
        z = pad_m[2] + self.rules.touch_m
        if math.dist((x, y, z), view.segment.end_m) < SHIFT_FROM_M:
            return None
        shifted = Segment(view.set_point, (x, y, z), left_s, view.now_s)
        speed, acceleration = shifted.peaks()
        if speed > 1.3 * max(self.speed_mps, 0.1) or acceleration > self.limits.accel_mps2:
            return None
        self._shifted_s = view.now_s
        return Move((x, y, z), left_s)

    def _settle(self, view: DockView, off: float, pad_m: Vec3) -> Decision:
        if not self._settled(view):
            return None
        if self._settling_s is None:
            self._settling_s = view.now_s
        if view.now_s - self._settling_s > self.rules.align_s:
            return Abort(f"it does not keep still above the dock ({off:.2f} m)")
        assert self._error_m is not None
        here = view.set_point.position_m
        if math.hypot(*self._error_m) <= 0.5 * self.rules.tolerance_m and off <= 0.8 * self.rules.tolerance_m:
            self.stage = "land"
            down = (here[0], here[1], pad_m[2])
            return Descend(pad_m[2], max(0.6, rest_to_rest_s(here, down, self.speed_mps, self.limits)))
        if math.hypot(*self._error_m) <= 0.5 * self.rules.tolerance_m:
            return None
        beside = (*self._corrected(view, GAIN), pad_m[2] + self.rules.touch_m)
        return Move(beside, max(0.6, rest_to_rest_s(here, beside, self.limits.max_speed_mps, self.limits)))

    def _touch(self, view: DockView) -> Decision:
        if view.now_s < view.segment.end_s + SETTLE_S:
            return None
        if view.position_m is not None and view.pad_m is not None and view.position_m[2] < view.pad_m[2] - 0.06:
            return Abort("it came down beside the dock")
        self.stage = "touched"
        return Touched()
