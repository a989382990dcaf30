"""The emergency stop and what is asked at connecting: repetitions, ends, and nothing for ever."""

from __future__ import annotations

import itertools
import math

from drivers import mavlink_words as w
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_setup import OPTIONAL, PARAMETER_TRIES, Setup, Stream
from drivers.mavlink_stop import AT_LEAST_S, AT_MOST_S, EVERY_S, OFF, TERMINATE, TERMINATE_AFTER_S, Stop


def sent(stop: Stop, until_s: float, off_s: float = math.inf, terminates: bool = True) -> list[tuple[float, str]]:
    """What a stop at 0 sends, to a vehicle that obeys at ``off_s`` and has a heartbeat every second."""
    found, now_s = [], 0.0
    while now_s < until_s:
        heartbeat_s = math.floor(now_s)
        armed = heartbeat_s < off_s
        found += [(now_s, r.what) for r in stop.step(now_s, armed, heartbeat_s, terminates)]
        now_s = round(now_s + 0.02, 6)
    return found


def begun() -> Stop:
    stop = Stop()
    stop.begin(0.0)
    return stop


def test_nothing_is_sent_before_it_is_asked_for() -> None:
    assert not Stop().step(1.0, True, 0.0, True)
    assert not Stop().latched


def test_it_goes_out_at_once_and_again_and_again() -> None:
    stop = begun()
    times = [t for t, what in sent(stop, 2.0) if what == OFF.what]
    assert times[0] == 0.0
    assert max(b - a for a, b in itertools.pairwise(times)) <= EVERY_S + 0.03
    assert stop.latched
    assert not stop.shown


def test_a_confirmed_one_ends_and_stays_latched() -> None:
    stop = begun()
    times = [t for t, _ in sent(stop, 5.0, off_s=0.5)]
    assert AT_LEAST_S - EVERY_S <= max(times) <= 1.1
    assert stop.shown
    assert stop.latched


def test_a_heartbeat_of_before_confirms_nothing() -> None:
    stop = Stop()
    stop.begin(10.0)
    stop.step(10.1, False, 9.9, True)
    assert not stop.shown


def test_termination_is_for_who_does_not_obey_and_knows_it() -> None:
    when = [t for t, what in sent(begun(), 3.0) if what == TERMINATE.what]
    assert min(when) > TERMINATE_AFTER_S
    assert not [t for t, what in sent(begun(), 3.0, terminates=False) if what == TERMINATE.what]
    assert not [t for t, what in sent(begun(), 3.0, off_s=0.5) if what == TERMINATE.what and t > 1.0]


def test_it_ends_some_time() -> None:
    assert max(t for t, _ in sent(begun(), AT_MOST_S + 5.0)) <= AT_MOST_S + 0.1


def test_asked_for_again_after_its_end_it_goes_out_again() -> None:
    stop = begun()
    sent(stop, AT_MOST_S + 4.0)
    again_s = AT_MOST_S + 5.0
    assert not stop.step(again_s, True, again_s - 0.5, True)
    stop.begin(again_s)
    assert OFF in stop.step(again_s, True, again_s - 0.5, True)
    assert stop.step(again_s + 1.0, True, again_s + 0.5, True)


def test_asked_for_again_before_its_end_termination_is_not_put_off() -> None:
    stop = begun()
    for k in range(1, 10):
        stop.begin(k * 0.2)
    assert TERMINATE in stop.step(1.8, True, 1.0, True)


def test_a_reboot_releases() -> None:
    stop = begun()
    sent(stop, 3.0, off_s=0.5)
    stop.release()
    assert not stop.latched
    assert not stop.shown


def test_streams_are_asked_for_one_by_one_at_their_rates() -> None:
    setup = Setup(MavlinkOptions(telemetry_hz=20.0, status_hz=4.0))
    setup.begin(
        [Stream("A", 30, "fast"), Stream("B", 245, "status"), Stream("C", 1, "slow"), Stream("D", 148, "once")], []
    )
    asked = list(iter(setup.next_request, None))
    assert [(r.command, r.parameters[:2]) for r in asked] == [
        (w.SET_MESSAGE_INTERVAL, (30, 50_000.0)),
        (w.SET_MESSAGE_INTERVAL, (245, 250_000.0)),
        (w.SET_MESSAGE_INTERVAL, (1, 500_000.0)),
        (w.REQUEST_MESSAGE, (148, 0.0)),
    ]
    assert setup.done


def test_parameters_are_asked_for_until_they_come_or_never_will() -> None:
    setup = Setup(MavlinkOptions())
    setup.begin([], ["COM_OF_LOSS_T", "NAV_DLL_ACT", OPTIONAL[0]])
    count = dict.fromkeys(("COM_OF_LOSS_T", "NAV_DLL_ACT", OPTIONAL[0]), 0)
    now_s = 0.0
    while not setup.done:
        for name in setup.parameters_due(now_s):
            count[name] += 1
            if name == "NAV_DLL_ACT" and count[name] == 3:
                setup.take(name, 3.0, 9, bytewise=True)
        now_s += 0.05
        assert now_s < 10.0
    assert count["NAV_DLL_ACT"] == 3
    assert count["COM_OF_LOSS_T"] == PARAMETER_TRIES
    assert count[OPTIONAL[0]] < PARAMETER_TRIES
    assert setup.parameters == {"NAV_DLL_ACT": 3.0}
    setup.take("SOMETHING_ELSE", 1.0, 9, bytewise=True)
    assert "SOMETHING_ELSE" not in setup.parameters
