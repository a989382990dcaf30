"""What a few seconds of frames say about motion capture: a table of streams and verdicts."""

from __future__ import annotations

import random
import re
from collections.abc import Callable

import pytest

from drivers.mocap_health import Frame, HealthLimits, health
from drivers.vehicle import SelfCheck, Vec3


def stream(
    *,
    rate_hz: float = 100.0,
    seconds: float = 3.0,
    noise_m: float = 0.0005,
    place: Callable[[float], Vec3] = lambda _: (1.0, 2.0, 0.0),
    seen: Callable[[float], bool] = lambda _: True,
    kept: Callable[[float], bool] = lambda _: True,
    delay_s: float = 0.0005,
    others: tuple[str, ...] = (),
) -> list[Frame]:
    rng = random.Random(1)
    frames = []
    for k in range(round(rate_hz * seconds)):
        t = k / rate_hz
        x, y, z = place(t)
        bodies = {name: (0.0, 0.0, rng.gauss(0, 0.001)) for name in others}
        if seen(t):
            bodies["a"] = (x + rng.gauss(0, noise_m), y + rng.gauss(0, noise_m), z + rng.gauss(0, noise_m))
        if kept(t):
            frames.append(Frame(t, t + delay_s, bodies))
    return frames


def found(frames: list[Frame], now_s: float | None = None, wanted: tuple[str, ...] = ("a",)) -> dict[str, SelfCheck]:
    now_s = frames[-1].stamp_s + 0.01 if now_s is None else now_s
    return {check.name: check for check in health(frames, wanted, now_s)}


def test_a_healthy_stream_passes() -> None:
    checks = found(stream())
    assert {check.verdict for check in checks.values()} == {"pass"}
    assert set(checks) == {
        "poses rate", "poses gaps", "poses delay", "poses visible", "poses noise", "poses jumps", "poses others",
    }  # fmt: skip
    assert checks["poses rate"].value == pytest.approx(100.0)
    assert checks["poses noise"].value == pytest.approx(0.0005, rel=0.2)


@pytest.mark.parametrize(
    ("frames", "name", "verdict", "text"),
    [
        (stream(rate_hz=30), "poses rate", "warn", "30 frames a second, 50 are wanted"),
        (stream(rate_hz=5), "poses rate", "fail", "5 frames"),
        (stream(kept=lambda t: not 1 < t < 1.3), "poses gaps", "warn", "longest gap 3[0-9]{2} ms"),
        (stream(kept=lambda t: not 1 < t < 1.9), "poses gaps", "fail", "longest gap"),
        (stream(delay_s=0.05), "poses delay", "warn", "99 % under 50.0 ms"),
        (stream(seen=lambda t: not 1 < t < 1.2), "poses visible", "warn", "a is seen in 9[34] %"),
        (stream(seen=lambda t: t < 1.5), "poses visible", "fail", "markers"),
        (stream(seen=lambda t: False), "poses visible", "fail", "seen in 0 %"),
        (stream(noise_m=0.02), "poses noise", "warn", "calibrate"),
        (stream(noise_m=0.08), "poses noise", "fail", "calibrate"),
        (stream(noise_m=0.0), "poses frozen", "fail", "same to the last bit for 3.0 s"),
        (stream(place=lambda t: (0.1 * t, 0.0, 0.0)), "poses noise", "not run", "moving"),
        (stream(place=lambda t: (float(1 < t < 1.05), 0.0, 0.0)), "poses jumps", "fail", "2 times, by up to 1.00 m"),
        (stream(others=("b", "c")), "poses others", "warn", "b, c are tracked"),
        (stream(others=("",)), "poses others", "warn", r"\(unnamed\) is tracked.*start it again"),
    ],
)
def test_what_is_wrong_is_found(frames: list[Frame], name: str, verdict: str, text: str) -> None:
    check = found(frames)[name]
    assert check.verdict == verdict
    assert re.search(text, check.text), check.text


def test_a_stream_that_has_ended_fails() -> None:
    assert found(stream(), now_s=10.0) == {
        "poses rate": SelfCheck(
            "poses rate",
            "fail",
            "no frames arrive; check that the system streams and that the network is up",
            0.0,
            "Hz",
        )
    }
    assert health([], ("a",), 0.0)[0].verdict == "fail"


def test_too_few_frames_are_no_verdict() -> None:
    checks = found(stream(seconds=0.2))
    assert [check.verdict for check in checks.values()] == ["not run"]


def test_a_short_freeze_within_the_limit_is_none() -> None:
    frames = stream(seconds=2.0)
    frames += [Frame(2.0 + k / 100, 2.0 + k / 100, frames[-1].bodies) for k in range(20)]
    assert "poses frozen" not in found(frames)
    frames += [Frame(2.2 + k / 100, 2.2 + k / 100, frames[-1].bodies) for k in range(20)]
    assert found(frames)["poses frozen"].verdict == "fail"


def test_limits_are_the_callers() -> None:
    frames = stream(noise_m=0.02)
    verdicts = {c.name: c.verdict for c in health(frames, ("a",), 3.0, HealthLimits(noise_m=0.03))}
    assert verdicts["poses noise"] == "pass"
