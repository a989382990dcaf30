import os
import signal
import threading

import pytest

from deploy import operator as operator_module
from deploy.operator import QueueOperator, ScriptedOperator, SignalOperator


class FakeClock:
    def __init__(self) -> None:
        self.time_s = 0.0

    def now(self) -> float:
        return self.time_s

    def wait_until(self, time_s: float) -> float:
        self.time_s = time_s
        return time_s


def wishes(operator: QueueOperator | ScriptedOperator) -> list[str]:
    return [wish.wish for wish in operator.poll()]


def test_ctrl_c_once_recovers_twice_stops() -> None:
    before = signal.getsignal(signal.SIGINT)
    said: list[str] = []
    with SignalOperator(said.append) as operator:
        assert wishes(operator) == []
        os.kill(os.getpid(), signal.SIGINT)
        assert wishes(operator) == ["recover"]
        os.kill(os.getpid(), signal.SIGINT)
        assert wishes(operator) == ["stop"]
        assert operator.wished == {"recover", "stop"}
    assert signal.getsignal(signal.SIGINT) is before
    assert len(said) == 2
    assert "stopping all motors" in said[1]


def test_more_presses_cannot_lose_the_stop_but_end_a_program_that_has_sent_it() -> None:
    with SignalOperator() as operator:
        for _ in range(4):
            os.kill(os.getpid(), signal.SIGINT)
        assert wishes(operator) == ["recover", "stop", "stop", "stop"]
        for _ in range(3):
            operator.poll()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_a_hanging_loop_can_be_left(monkeypatch: pytest.MonkeyPatch) -> None:
    with SignalOperator() as operator:
        os.kill(os.getpid(), signal.SIGINT)
        os.kill(os.getpid(), signal.SIGINT)
        monkeypatch.setattr(operator_module, "GIVE_UP_S", -1.0)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)
        assert wishes(operator) == ["recover", "stop"]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_the_end_of_terminal_or_service_recovers(number: signal.Signals) -> None:
    with SignalOperator() as operator:
        os.kill(os.getpid(), number)
        os.kill(os.getpid(), number)
        assert wishes(operator) == ["recover"]
        os.kill(os.getpid(), signal.SIGINT)  # somebody is there after all, and wants more
        assert wishes(operator) == ["stop"]


def test_a_flight_cannot_be_paused() -> None:
    said: list[str] = []
    with SignalOperator(said.append) as operator:
        os.kill(os.getpid(), signal.SIGTSTP)
        assert wishes(operator) == []
    assert said == ["Ctrl-Z is of no use in flight; Ctrl-C brings everybody down"]
    assert signal.getsignal(signal.SIGTSTP) is signal.SIG_DFL


def test_wishes_from_another_thread() -> None:
    operator = QueueOperator()
    operator.attach(FakeClock())
    thread = threading.Thread(target=lambda: [operator.wish("hold"), operator.wish("resume")])
    thread.start()
    thread.join()
    assert wishes(operator) == ["hold", "resume"]


def test_script() -> None:
    operator = ScriptedOperator([(20.0, "stop"), (10.0, "hold"), (10.0, "resume")])
    assert wishes(operator) == []
    clock = FakeClock()
    operator.attach(clock)
    assert wishes(operator) == []
    clock.time_s = 10.0
    assert wishes(operator) == ["hold", "resume"]
    assert wishes(operator) == []
    clock.time_s = 100.0
    assert wishes(operator) == ["stop"]
