"""What a few seconds of frames say about motion capture before the start: pure."""

from __future__ import annotations

import itertools
import math
import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers.vehicle import SelfCheck, Vec3

Verdict = Literal["pass", "warn", "fail", "not run"]

UNNAMED = "(unnamed)"
"""A rigid body that was added after the client connected: the client knows its number only."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame as it reached the driver.

    Attributes:
        stamp_s: receipt from the network, in the child.
        heard_s: arrival in the driver, on the same clock.
        bodies: position in m by name.
    """

    stamp_s: float
    heard_s: float
    bodies: dict[str, Vec3]


@dataclass(frozen=True, slots=True)
class HealthLimits:
    """Thresholds of the checks.

    Attributes:
        least_s: of frames that are needed to judge.
        rate_hz: warn below; estimators are usually fed at 50 to 100 Hz. A fifth of it fails.
        gap_s: warn above; the supervisor calls a pose stale after 0.2 s by default. Five times as long fails.
        hidden: warn above this share of frames in which a body is not seen; ten times as much fails.
        noise_m: warn above this standard deviation per axis at rest, five times as much fails. OptiTrack and Vicon
            have under 1 mm when calibrated.
        moving_m: a body whose mean moves more than this plus its noise from one half of the frames to the other is
            not at rest.
        frozen_s: bit-identical for longer than this is frozen: a live system is never without noise.
        jump_m: a step between two frames that no vehicle makes.
        delay_s: warn above this 99th percentile of the way from the child to the driver.
    """

    least_s: float = 0.5
    rate_hz: float = 50.0
    gap_s: float = 0.1
    hidden: float = 0.02
    noise_m: float = 0.015
    moving_m: float = 0.01
    frozen_s: float = 0.3
    jump_m: float = 0.3
    delay_s: float = 0.02


def health(
    frames: Sequence[Frame], wanted: Sequence[str], now_s: float, limits: HealthLimits | None = None
) -> list[SelfCheck]:
    """All findings about the newest frames.

    Args:
        frames: in order of receipt.
        wanted: bodies that the mission needs.
        now_s: on the clock of the stamps.
        limits: None for the defaults.
    """
    limits = limits or HealthLimits()
    span_s = frames[-1].stamp_s - frames[0].stamp_s if frames else 0.0
    if not frames or now_s - frames[-1].stamp_s > max(1.0, 5 * limits.gap_s):
        text = "no frames arrive; check that the system streams and that the network is up"
        return [SelfCheck("poses rate", "fail", text, 0.0, "Hz")]
    if span_s < limits.least_s:
        text = f"only {span_s:.1f} s of frames so far; check again in a moment"
        return [SelfCheck("poses rate", "not run", text)]
    checks = [_rate(frames, span_s, limits), _gap(frames, now_s, limits), _delay(frames, limits)]
    for body in wanted:
        checks.extend(_body(frames, body, limits))
    checks.append(_others(frames, wanted))
    return checks


def _rate(frames: Sequence[Frame], span_s: float, limits: HealthLimits) -> SelfCheck:
    rate_hz = (len(frames) - 1) / span_s
    text = f"{rate_hz:.0f} frames a second"
    verdict = _verdict(-rate_hz, -limits.rate_hz, -limits.rate_hz / 5)
    if verdict != "pass":
        text += f", {limits.rate_hz:.0f} are wanted; raise the system's rate or relieve the network"
    return SelfCheck("poses rate", verdict, text, rate_hz, "Hz")


def _gap(frames: Sequence[Frame], now_s: float, limits: HealthLimits) -> SelfCheck:
    stamps = [f.stamp_s for f in frames]
    gaps = [b - a for a, b in zip(stamps, [*stamps[1:], now_s], strict=True)]
    longest_s = max(gaps)
    jitter_s = statistics.pstdev(gaps[:-1]) if len(gaps) > 2 else 0.0
    text = f"longest gap {1e3 * longest_s:.0f} ms, jitter {1e3 * jitter_s:.1f} ms"
    verdict = _verdict(longest_s, limits.gap_s, 5 * limits.gap_s)
    if verdict != "pass":
        text += "; use a wired network and close what loads this computer"
    return SelfCheck("poses gaps", verdict, text, longest_s, "s")


def _delay(frames: Sequence[Frame], limits: HealthLimits) -> SelfCheck:
    delays = sorted(f.heard_s - f.stamp_s for f in frames)
    p99_s = delays[min(len(delays) - 1, math.ceil(0.99 * len(delays)) - 1)]
    text = f"from receipt to the program {1e3 * statistics.median(delays):.1f} ms, 99 % under {1e3 * p99_s:.1f} ms"
    verdict: Verdict = "pass" if p99_s <= limits.delay_s else "warn"
    if verdict != "pass":
        text += "; close what loads this computer"
    return SelfCheck("poses delay", verdict, text, p99_s, "s")


def _body(frames: Sequence[Frame], body: str, limits: HealthLimits) -> list[SelfCheck]:
    seen = [(f.stamp_s, f.bodies[body]) for f in frames if body in f.bodies]
    hidden = 1 - len(seen) / len(frames)
    text = f"{body} is seen in {100 * (1 - hidden):.0f} % of the frames"
    verdict = _verdict(hidden, limits.hidden, 10 * limits.hidden)
    if verdict != "pass":
        text += "; look at its markers and at what stands between it and the cameras"
    checks = [SelfCheck("poses visible", verdict, text, 1 - hidden)]
    if len(seen) >= 10:
        still_s = _frozen_s(seen)
        if still_s > limits.frozen_s:
            text = f"{body} has been the same to the last bit for {still_s:.1f} s: the system repeats an old pose"
            checks.append(SelfCheck("poses frozen", "fail", text + "; restart its streaming", still_s, "s"))
        else:
            checks.append(_noise(body, [p for _, p in seen], limits))
        checks.append(_jumps(body, [p for _, p in seen], limits))
    return checks


def _frozen_s(seen: Sequence[tuple[float, Vec3]]) -> float:
    """For how long the newest pose has been the same."""
    stamp_s, position = seen[-1]
    since_s = stamp_s
    for earlier_s, earlier in reversed(seen):
        if earlier != position:
            break
        since_s = earlier_s
    return stamp_s - since_s


def _noise(body: str, positions: Sequence[Vec3], limits: HealthLimits) -> SelfCheck:
    half = len(positions) // 2
    noise_m = moved_m = 0.0
    for axis in range(3):
        first, second = [p[axis] for p in positions[:half]], [p[axis] for p in positions[half:]]
        noise_m = max(noise_m, statistics.pstdev(first), statistics.pstdev(second))
        moved_m = max(moved_m, abs(statistics.fmean(first) - statistics.fmean(second)))
    if moved_m > limits.moving_m + noise_m / math.sqrt(half):
        return SelfCheck("poses noise", "not run", f"{body} is moving; check again when it stands still")
    text = f"{body} at rest: {1e3 * noise_m:.2f} mm"
    verdict = _verdict(noise_m, limits.noise_m, 5 * limits.noise_m)
    if verdict != "pass":
        text += "; calibrate the cameras, or mask what reflects"
    return SelfCheck("poses noise", verdict, text, noise_m, "m")


def _jumps(body: str, positions: Sequence[Vec3], limits: HealthLimits) -> SelfCheck:
    steps = [math.dist(a, b) for a, b in itertools.pairwise(positions)]
    jumps = sum(step > limits.jump_m for step in steps)
    if not jumps:
        return SelfCheck("poses jumps", "pass", f"{body} does not jump", max(steps), "m")
    text = f"{body} has jumped {jumps} times, by up to {max(steps):.2f} m: its markers are confused with others"
    return SelfCheck("poses jumps", "fail", text + "; give it a marker pattern of its own", max(steps), "m")


def _others(frames: Sequence[Frame], wanted: Sequence[str]) -> SelfCheck:
    others = sorted({name or UNNAMED for f in frames for name in f.bodies} - set(wanted))
    if not others:
        return SelfCheck("poses others", "pass", "nothing is tracked that is not of this mission", 0.0)
    text = f"{', '.join(others)} {'is' if len(others) == 1 else 'are'} tracked, too, and not of this mission"
    if UNNAMED in others:
        text += "; bodies made after the program connected have no names: start it again"
    return SelfCheck("poses others", "warn", text, float(len(others)))


def _verdict(value: float, warn: float, fail: float) -> Verdict:
    """``fail`` above the second limit, ``warn`` above the first."""
    return "fail" if value > fail else "warn" if value > warn else "pass"
