"""The identity check: each vehicle is moved by hand in turn, and the body that moves must be the one it is said to be.

Nothing else finds two vehicles whose names are exchanged before they fly. The state machine is pure; ``identify``
runs it on a pose source with a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Literal

from drivers.clock import Clock
from drivers.errors import DriverError
from drivers.vehicle import Pose, PoseSource, SelfCheck, Vec3

Verdict = Literal["pass", "swapped", "unclear", "nothing moved", "not seen"]


@dataclass(frozen=True, slots=True)
class IdentityOptions:
    """What counts as moved; validates itself.

    Attributes:
        moved_m: far from where it stood: well above noise, and what a hand does without thinking.
        still_m, still_s: nothing moves more than this for so long before the next one is asked for.
        hold_s: the same bodies must be away for so long before it is judged.
        near_m: bodies that stood this near to the one that is moved may be carried along (UAVs on a UGV).
        seen_s: a body not seen for longer is hidden.
        smooth_s: time constant that takes the noise out of the poses.
        prompt_s: time to move a vehicle.
        settle_s: time for everything to be seen and come to rest.
    """

    moved_m: float = 0.12
    still_m: float = 0.04
    still_s: float = 1.0
    hold_s: float = 0.4
    near_m: float = 0.5
    seen_s: float = 0.5
    smooth_s: float = 0.15
    prompt_s: float = 60.0
    settle_s: float = 30.0

    def __post_init__(self) -> None:
        for name in self.__dataclass_fields__:
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise DriverError(f"identity check: {name} is {value!r}; give a number above 0")
        if self.still_m >= self.moved_m:
            raise DriverError(f"identity check: still_m {self.still_m} must be below moved_m {self.moved_m}")


@dataclass(frozen=True, slots=True)
class Identity:
    """What came out for one vehicle.

    Attributes:
        vehicle: its id.
        body: what the mission says it is in motion capture.
        verdict: see ``Verdict``.
        moved: the body that moved instead, or with it.
        text: for the operator.
    """

    vehicle: str
    body: str
    verdict: Verdict
    moved: str | None
    text: str

    def check(self) -> SelfCheck:
        """As a finding of pre-flight."""
        return SelfCheck("identity", "pass" if self.verdict == "pass" else "fail", self.text)


class _Phase(Enum):
    SETTLE = 1
    WATCH = 2
    DONE = 3


class _Body:
    """One body as it is followed: smoothed, with the place where it came to rest."""

    def __init__(self, pose: Pose, now_s: float) -> None:
        self.at_m = self.anchor_m = self.rest_m = pose.position_m
        self.seen_s = self.since_s = now_s
        self.peak_m: float | None = None  # how high it has been since somebody took it; None: nobody has
        self._stamp_s = pose.stamp_s

    def see(self, pose: Pose, now_s: float, smooth_s: float, still_m: float) -> None:
        passed_s = pose.stamp_s - self._stamp_s
        if passed_s <= 0:
            return
        part = 1 - math.exp(-passed_s / smooth_s)
        self.at_m = _between(self.at_m, pose.position_m, part)
        self._stamp_s, self.seen_s = pose.stamp_s, now_s
        if math.dist(self.at_m, self.anchor_m) > still_m:
            self.anchor_m, self.since_s = self.at_m, now_s

    def in_hand(self, still_m: float, moved_m: float) -> bool:
        """Whether it is still up where it was lifted to: a steady hand is as still as the floor."""
        if self.peak_m is None:
            return False
        height_m = self.at_m[2]
        self.peak_m = max(self.peak_m, height_m)
        if abs(height_m - self.rest_m[2]) <= still_m or height_m <= self.peak_m - moved_m:
            self.peak_m = None
        return self.peak_m is not None


class IdentityCheck:
    """The state machine; give ``step`` the newest poses again and again until ``done``.

    Args:
        wanted: body by vehicle id, in the order of the check.
        options: what counts as moved.
    """

    def __init__(self, wanted: Mapping[str, str], options: IdentityOptions | None = None) -> None:
        self._options = options or IdentityOptions()
        self._wanted = dict(wanted)
        self._queue = list(wanted)
        self._bodies: dict[str, _Body] = {}
        self._results: dict[str, Identity] = {}
        self._phase = _Phase.SETTLE
        self._since_s: float | None = None
        self._away: frozenset[str] = frozenset()
        self._away_since_s = 0.0
        self._told_hidden = False
        self._told_waiting = False

    @property
    def done(self) -> bool:
        """Whether every vehicle has a result."""
        return self._phase is _Phase.DONE

    @property
    def results(self) -> tuple[Identity, ...]:
        """What has come out so far, in the order of the vehicles."""
        return tuple(self._results[v] for v in self._wanted if v in self._results)

    def step(self, poses: Sequence[Pose], now_s: float) -> list[str]:
        """Takes fresh poses; returns what to tell the operator now."""
        for pose in poses:
            if pose.body in self._bodies:
                self._bodies[pose.body].see(pose, now_s, self._options.smooth_s, self._options.still_m)
            else:
                self._bodies[pose.body] = _Body(pose, now_s)
        if self._since_s is None:
            self._since_s = now_s
        if not self._queue:
            self._phase = _Phase.DONE
        if self._phase is _Phase.SETTLE:
            return self._settle(now_s, now_s - self._since_s)
        if self._phase is _Phase.WATCH:
            return self._watch(now_s, now_s - self._since_s)
        return []

    def _settle(self, now_s: float, waited_s: float) -> list[str]:
        hidden = [v for v in self._queue if not self._seen(self._wanted[v], now_s)]
        restless = sorted(b for b, body in self._bodies.items() if self._restless(b, body, now_s))
        if not hidden and not restless:
            for body in self._bodies.values():
                body.rest_m = body.at_m
            self._enter(_Phase.WATCH, now_s)
            vehicle = self._queue[0]
            number = len(self._wanted) - len(self._queue) + 1
            return [
                f"{number} of {len(self._wanted)}: lift or push {vehicle} by about 20 cm and hold it there;"
                " touch nothing else"
            ]
        if waited_s < self._options.settle_s:
            # for a moment everybody is restless: say so only when it lasts
            if self._told_waiting or waited_s < 3 * self._options.still_s:
                return []
            self._told_waiting = True
            return [self._waiting(hidden, restless)]
        told = []
        for vehicle in list(self._queue):
            if vehicle in hidden:
                own = self._wanted[vehicle]
                text = f"{vehicle}: motion capture does not see its body {own!r}; look at its markers and its name"
                told += self._conclude(vehicle, "not seen", None, text, now_s)
            elif restless:
                text = f"{vehicle}: {', '.join(restless)} never stood still; put everything down and check again"
                told += self._conclude(vehicle, "unclear", restless[0], text, now_s)
        return told

    def _watch(self, now_s: float, waited_s: float) -> list[str]:
        vehicle = self._queue[0]
        own = self._wanted[vehicle]
        far = {b: math.dist(body.at_m, body.rest_m) for b, body in self._bodies.items() if self._seen(b, now_s)}
        away = frozenset(b for b, far_m in far.items() if far_m > self._options.moved_m)
        if away != self._away:
            self._away, self._away_since_s = away, now_s
        if away and now_s - self._away_since_s >= self._options.hold_s:
            return self._judge(vehicle, own, {b: far[b] for b in away}, now_s)
        if waited_s > self._options.prompt_s:
            text = (
                f"{vehicle}: nothing has moved for {self._options.prompt_s:.0f} s. Is its body {own!r} really on it,"
                " and is the stream alive?"
            )
            return self._conclude(vehicle, "nothing moved", None, text, now_s)
        if not self._told_hidden and not self._seen(own, now_s):
            self._told_hidden = True
            return [f"{own!r} is hidden now; if you hold {vehicle}, let the cameras see its markers"]
        return []

    def _judge(self, vehicle: str, own: str, far_m: dict[str, float], now_s: float) -> list[str]:
        if own in far_m:
            others = [b for b in far_m if b != own and not self._carried(b, own)]
            if not others:
                text = f"{vehicle} is {own!r}: right"
                return self._conclude(vehicle, "pass", None, text, now_s)
            text = f"{vehicle}: {own!r} has moved, but {', '.join(sorted(others))}, too; move one at a time"
            return self._conclude(vehicle, "unclear", others[0], text, now_s)
        most = min(far_m, key=lambda b: self._bodies[b].rest_m[2])  # the lowest one carries the others
        if any(not self._carried(b, most) for b in far_m):
            text = f"{vehicle}: {', '.join(sorted(far_m))} have moved, {own!r} has not; move one at a time"
            return self._conclude(vehicle, "unclear", most, text, now_s)
        holder = next((v for v, body in self._wanted.items() if body == most), None)
        whose = f", which should be {holder}" if holder else ", which is not of this mission"
        text = (
            f"{vehicle} was moved and body {most!r} moved{whose}: exchange the names in motion capture, or body in"
            " the mission"
        )
        return self._conclude(vehicle, "swapped", most, text, now_s)

    def _conclude(self, vehicle: str, verdict: Verdict, moved: str | None, text: str, now_s: float) -> list[str]:
        self._results[vehicle] = Identity(vehicle, self._wanted[vehicle], verdict, moved, text)
        self._queue.remove(vehicle)
        if self._queue:
            self._enter(_Phase.SETTLE, now_s)
            return [text, f"put {vehicle} down again"] if verdict not in ("not seen", "nothing moved") else [text]
        self._enter(_Phase.DONE, now_s)
        return [text]

    def _enter(self, phase: _Phase, now_s: float) -> None:
        self._phase, self._since_s = phase, now_s
        self._away, self._away_since_s = frozenset(), now_s
        self._told_hidden = self._told_waiting = False
        if phase is _Phase.SETTLE:
            for body in self._bodies.values():
                body.anchor_m, body.since_s = body.at_m, now_s
                if math.dist(body.at_m, body.rest_m) > self._options.moved_m:
                    body.peak_m = body.at_m[2]

    def _waiting(self, hidden: list[str], restless: list[str]) -> str:
        unseen = [self._wanted[v] for v in hidden]
        parts = [f"to see {', '.join(unseen)}"] if unseen else []
        parts += [f"for {', '.join(restless)} to stand still"] if restless else []
        return f"waiting {' and '.join(parts)}"

    def _seen(self, body: str, now_s: float) -> bool:
        return body in self._bodies and now_s - self._bodies[body].seen_s <= self._options.seen_s

    def _restless(self, name: str, body: _Body, now_s: float) -> bool:
        in_hand = body.in_hand(self._options.still_m, self._options.moved_m)
        return in_hand or (self._seen(name, now_s) and now_s - body.since_s < self._options.still_s)

    def _carried(self, body: str, by: str) -> bool:
        """Whether a body stood so near another that it may be on it."""
        return math.dist(self._bodies[body].rest_m[:2], self._bodies[by].rest_m[:2]) <= self._options.near_m


def identify(
    source: PoseSource,
    wanted: Mapping[str, str],
    clock: Clock,
    say: Callable[[str], None],
    options: IdentityOptions | None = None,
) -> tuple[Identity, ...]:
    """Runs the check on a connected pose source.

    Args:
        source: a ``Mocap`` without wanted bodies also shows strangers that move.
        wanted: body by vehicle id, in the order of the check.
        clock: of the poses.
        say: tells the operator.
        options: what counts as moved.
    """
    check = IdentityCheck(wanted, options)
    while not check.done:
        for text in check.step(source.read(), clock.now()):
            say(text)
        clock.wait_until(clock.now() + 0.02)
    return check.results


def _between(a: Vec3, b: Vec3, part: float) -> Vec3:
    return (a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2]))
