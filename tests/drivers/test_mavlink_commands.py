"""The command protocol: repetitions, progress, refusals."""

from __future__ import annotations

import pytest

from drivers import mavlink_words as w
from drivers.mavlink_commands import (
    AGAIN_S,
    BACK_OFF_S,
    PROGRESS_S,
    REJECTIONS,
    RESEND_S,
    TRIES,
    Desk,
    Request,
    request,
)

ARM = request("arming", w.ARM_DISARM, 1.0)
DISARM = request("disarming", w.ARM_DISARM, 0.0)
MODE = request("mode", w.DO_SET_MODE, 1.0, 6.0)


class Wire:
    def __init__(self) -> None:
        self.sent: list[tuple[str, int]] = []
        self.refused: list[tuple[str, str]] = []
        self.desk = Desk(self.send, lambda what, why: self.refused.append((what, why)))

    def send(self, wanted: Request, confirmation: int) -> None:
        self.sent.append((wanted.what, confirmation))


@pytest.fixture
def wire() -> Wire:
    return Wire()


def test_unanswered_is_repeated_with_a_rising_confirmation_and_then_given_up(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    now_s = 0.0
    while now_s < 5.0:
        now_s += 0.05
        wire.desk.tick(now_s)
    assert wire.sent == [("arming", k) for k in range(TRIES)]
    assert wire.refused == [("arming", "no answer")]
    assert wire.desk.idle


def test_asking_again_while_it_is_under_way_sends_nothing(wire: Wire) -> None:
    for k in range(5):
        wire.desk.ask(ARM, 0.05 * k)
    assert wire.sent == [("arming", 0)]


def test_accepted_without_effect_is_sent_again_later(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.answered(w.ARM_DISARM, w.ACCEPTED, 0.1)
    wire.desk.ask(ARM, 0.1 + 0.9 * AGAIN_S)
    assert len(wire.sent) == 1
    wire.desk.ask(ARM, 0.1 + 1.1 * AGAIN_S)
    assert len(wire.sent) == 2


def test_settled_means_that_the_next_goes_out_at_once(wire: Wire) -> None:
    wire.desk.ask(MODE, 0.0)
    wire.desk.answered(w.DO_SET_MODE, w.ACCEPTED, 0.1)
    wire.desk.settled("mode")
    wire.desk.ask(MODE, 0.2)
    assert len(wire.sent) == 2


def test_progress_is_waited_for(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.answered(w.ARM_DISARM, w.IN_PROGRESS, 0.1)
    wire.desk.tick(0.1 + 0.9 * PROGRESS_S)
    assert wire.sent == [("arming", 0)]
    assert not wire.refused
    wire.desk.answered(w.ARM_DISARM, w.ACCEPTED, 0.1 + 0.95 * PROGRESS_S)
    wire.desk.tick(10.0)
    assert wire.desk.idle
    assert not wire.refused


def test_progress_without_end_is_given_up(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.answered(w.ARM_DISARM, w.IN_PROGRESS, 0.1)
    wire.desk.tick(0.2 + PROGRESS_S)
    assert wire.refused == [("arming", "no answer")]


@pytest.mark.parametrize("result", [w.DENIED, w.UNSUPPORTED])
def test_denied_is_told_at_once(wire: Wire, result: int) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.answered(w.ARM_DISARM, result, 0.1)
    assert wire.refused == [("arming", w.RESULTS[result])]


@pytest.mark.parametrize("result", [w.BUSY, w.FAILED])
def test_not_now_is_tried_again_and_told_in_the_end(wire: Wire, result: int) -> None:
    now_s = 0.0
    for _ in range(REJECTIONS):
        assert not wire.refused
        wire.desk.ask(ARM, now_s)
        wire.desk.answered(w.ARM_DISARM, result, now_s + 0.1)
        wire.desk.ask(ARM, now_s + 0.5 * BACK_OFF_S)
        now_s += 0.2 + BACK_OFF_S
    assert len(wire.sent) == REJECTIONS
    assert wire.refused == [("arming", w.RESULTS[result])]


def test_a_newer_wish_replaces_the_older(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.ask(DISARM, 0.1)
    wire.desk.tick(0.1 + 1.1 * RESEND_S)
    assert wire.sent == [("arming", 0), ("disarming", 0), ("disarming", 1)]


def test_different_commands_do_not_wait_for_each_other_but_equal_numbers_do(wire: Wire) -> None:
    first = request("rate of A", w.SET_MESSAGE_INTERVAL, 1.0)
    second = request("rate of B", w.SET_MESSAGE_INTERVAL, 2.0)
    wire.desk.ask(first, 0.0)
    wire.desk.ask(second, 0.0)
    wire.desk.ask(MODE, 0.0)
    assert [what for what, _ in wire.sent] == ["rate of A", "mode"]
    wire.desk.answered(w.SET_MESSAGE_INTERVAL, w.ACCEPTED, 0.1)
    assert [what for what, _ in wire.sent] == ["rate of A", "mode", "rate of B"]


def test_an_answer_that_nobody_waits_for_is_nothing(wire: Wire) -> None:
    wire.desk.answered(w.NAV_TAKEOFF, w.DENIED, 0.0)
    assert not wire.refused


def test_quiet_requests_are_refused_quietly(wire: Wire) -> None:
    wire.desk.ask(request("rate", w.SET_MESSAGE_INTERVAL, 1.0, loud=False), 0.0)
    wire.desk.answered(w.SET_MESSAGE_INTERVAL, w.UNSUPPORTED, 0.1)
    assert not wire.refused


def test_what_is_wanted_no_more_is_not_repeated(wire: Wire) -> None:
    wire.desk.ask(ARM, 0.0)
    wire.desk.ask(MODE, 0.0)
    wire.desk.cancel("arming")
    wire.desk.tick(1.1 * RESEND_S)
    assert wire.sent == [("arming", 0), ("mode", 0), ("mode", 1)]
    wire.desk.answered(w.ARM_DISARM, w.DENIED, 0.7)
    assert not wire.refused
    wire.desk.clear()
    assert wire.desk.idle


def test_cancelled_while_it_waits_for_its_turn(wire: Wire) -> None:
    wire.desk.ask(request("rate of A", w.SET_MESSAGE_INTERVAL, 1.0), 0.0)
    wire.desk.ask(request("rate of B", w.SET_MESSAGE_INTERVAL, 2.0), 0.0)
    wire.desk.cancel("rate of B")
    wire.desk.answered(w.SET_MESSAGE_INTERVAL, w.ACCEPTED, 0.1)
    assert wire.desk.idle
