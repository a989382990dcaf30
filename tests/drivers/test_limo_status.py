"""LimoStatus on the wire and what it says."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.limo_checks import Seen, checks
from drivers.limo_status import LimoStatus, charge, decode, encode, errors

# what Cyclone DDS, another implementation, put on the wire for the values beside it
FROM_CYCLONE = bytes.fromhex("00010000 01000000 13d1042e 01000000 00 00 01 00 cdcccccccccc2740 1800 01 00")
SAMPLE = LimoStatus(1_772_067_603, 0, 1, 11.9, 0x18, 1)
FINE = LimoStatus(1, 0, 1, 12.0, 0, 0)


def test_reads_what_another_implementation_wrote() -> None:
    assert decode(FROM_CYCLONE) == SAMPLE
    assert encode(SAMPLE) == FROM_CYCLONE[:-1], "but for the padding at its end"


def test_reads_the_other_byte_order() -> None:
    big = bytes.fromhex("00000000 00000001 2e04d113 00000001 00 00 01 00 4027cccccccccccd 0018 01")
    assert decode(big) == SAMPLE


@st.composite
def any_status(draw: st.DrawFn) -> LimoStatus:
    byte = st.integers(0, 255)
    words = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=9)
    stamp_ns, volts, error = st.integers(0, 2**31 * 10**9 - 1), st.floats(allow_nan=False), st.integers(0, 65535)
    return LimoStatus(draw(stamp_ns), draw(byte), draw(byte), draw(volts), draw(error), draw(byte), draw(words))


@given(any_status())
def test_what_is_written_is_read(status: LimoStatus) -> None:
    assert decode(encode(status)) == status


@given(st.binary(max_size=60) | st.binary(max_size=40).map(lambda b: b"\x00\x01\x00\x00" + b))
def test_other_bytes_are_one_clear_error(data: bytes) -> None:
    try:
        decode(data)
    except ValueError as error:
        assert str(error)


def test_truncated_is_an_error_at_every_length() -> None:
    for n in range(len(FROM_CYCLONE) - 1):
        with pytest.raises(ValueError, match=r"bytes|CDR"):
            decode(FROM_CYCLONE[:n])


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0, []),
        (0x0004, []),  # nobody holds the remote control
        (0x0001, ["battery empty"]),
        (0x0108, ["motor driver 1", "drive status"]),
        (0x8000, ["unknown error 0x8000"]),
    ],
)
def test_error_bits_in_words(code: int, words: list[str]) -> None:
    assert errors(code) == words


def test_charge_falls_with_the_voltage() -> None:
    volts = [12.6 - 0.1 * k for k in range(45)]
    levels = [charge(v) for v in volts]
    assert levels[0] == 1.0
    assert charge(8.25) == charge(0.0) == 0.0
    assert charge(13.0) == 1.0
    assert all(a >= b for a, b in itertools.pairwise(levels))
    assert max(a - b for a, b in itertools.pairwise(levels)) < 0.08, "what one step of 0.1 V can mean"


def verdicts(status: LimoStatus | None, mode: str = "differential", **seen: float) -> dict[str, str]:
    values = {"odom_age_s": 0.1, "listeners": 1, "rivals": 0, **seen}
    found = checks(Seen(status, cmd_vel="/limo1/cmd_vel", **values), mode, True, 1.0)  # type: ignore[arg-type]
    assert all(f.text for f in found)
    return {f.name: f.verdict for f in found}


def test_a_sound_limo_passes_every_check() -> None:
    assert set(verdicts(FINE).values()) == {"pass"}


@pytest.mark.parametrize(
    ("status", "mode", "seen", "name", "verdict"),
    [
        (FINE, "ackermann", {}, "mode", "fail"),
        (LimoStatus(1, 0, 1, 12.0, 0, 9), "ackermann", {}, "mode", "fail"),
        (LimoStatus(1, 0, 2, 12.0, 0, 0), "differential", {}, "control", "fail"),
        (LimoStatus(1, 0, 1, 12.0, 0x10, 0), "differential", {}, "errors", "fail"),
        (LimoStatus(1, 2, 1, 12.0, 0, 0), "differential", {}, "errors", "fail"),
        (LimoStatus(1, 0, 1, 10.2, 0, 0), "differential", {}, "battery", "warn"),
        (LimoStatus(1, 0, 1, 8.2, 0, 0), "differential", {}, "battery", "fail"),
        (FINE, "differential", {"odom_age_s": 3.0}, "telemetry", "fail"),
        (FINE, "differential", {"listeners": 0}, "commands", "fail"),
        (FINE, "differential", {"listeners": 2}, "commands", "warn"),
        (FINE, "differential", {"rivals": 1}, "commands", "warn"),
        (None, "differential", {}, "mode", "warn"),
    ],
)
def test_each_check_finds_its_fault(
    status: LimoStatus | None, mode: str, seen: dict[str, float], name: str, verdict: str
) -> None:
    found = verdicts(status, mode, **seen)
    assert found[name] == verdict
    if status is not None:
        assert [n for n, v in found.items() if v != "pass"] == [name]


def test_a_robot_without_status_is_checked_as_far_as_it_goes() -> None:
    found = {f.name: f.verdict for f in checks(Seen(None, 0.1, 1, 0, "/cmd_vel"), "differential", False, 1.0)}
    assert found["telemetry"] == found["commands"] == "pass"
    assert found["mode"] == found["battery"] == "not run"
