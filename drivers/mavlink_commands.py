"""The command protocol: resend until acknowledged, wait while it is in progress, and tell what was refused.

An acknowledgement is not the effect: whoever wants something asks again until the telemetry shows it. No I/O, no clock.
Source: https://mavlink.io/en/services/command.html.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from drivers import mavlink_words as w

RESEND_S = 0.5
TRIES = 4
"""The first and three repetitions."""
PROGRESS_S = 5.0
"""After IN_PROGRESS the final answer may take so long."""
AGAIN_S = 1.5
"""An accepted command whose effect does not show is sent again after this: heartbeats come once a second."""
BACK_OFF_S = 1.0
"""A temporarily rejected command is tried again after this."""
REJECTIONS = 4
"""So many temporary rejections in a row are a refusal."""

Parameters = tuple[float, float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class Request:
    """A COMMAND_LONG and what it is for.

    Attributes:
        what: in words, for the operator; names the request.
        command: MAV_CMD.
        parameters: its seven.
        loud: a refusal is worth telling.
    """

    what: str
    command: int
    parameters: Parameters
    loud: bool = True


@dataclass(frozen=True, slots=True)
class _Pending:
    request: Request
    sent_s: float
    tries: int
    until_s: float | None = None


def request(what: str, command: int, *parameters: float, loud: bool = True) -> Request:
    """A request with zeros for the parameters that are not given."""
    p = (*parameters, *(0.0,) * (7 - len(parameters)))
    return Request(what, command, (p[0], p[1], p[2], p[3], p[4], p[5], p[6]), loud)


class Desk:
    """The commands of one vehicle: one pending at a time for each MAV_CMD, as the protocol demands.

    Args:
        send: puts a request with its ``confirmation`` on the wire.
        refused: told of a refusal: what, and why in words.
    """

    def __init__(self, send: Callable[[Request, int], None], refused: Callable[[str, str], None]) -> None:
        self._send, self._refused = send, refused
        self._pending: dict[int, _Pending] = {}
        self._waiting: dict[int, list[Request]] = {}
        self._rest_s: dict[str, float] = {}
        self._rejections: dict[str, int] = {}

    def ask(self, wanted: Request, now_s: float) -> None:
        """Sends a request unless it is under way, or was answered a moment ago."""
        pending = self._pending.get(wanted.command)
        if pending is not None and pending.request == wanted:
            return
        if now_s < self._rest_s.get(wanted.what, -1.0):
            return
        if pending is not None and pending.request.what != wanted.what and wanted.command != w.ARM_DISARM:
            queue = self._waiting.setdefault(wanted.command, [])
            if wanted not in queue:
                queue.append(wanted)
            return
        # a newer wish for the same thing replaces the older one
        self._start(wanted, now_s)

    def at_once(self, wanted: Request, now_s: float) -> None:
        """Sends a request now, whatever is under way."""
        self._start(wanted, now_s)

    def settled(self, what: str) -> None:
        """The effect shows, or is wanted no more: the next request of that name goes out at once."""
        self._rest_s.pop(what, None)
        self._rejections.pop(what, None)

    def cancel(self, what: str) -> None:
        """It is wanted no more: an unanswered one must not be repeated when it could do harm by now."""
        for command, pending in list(self._pending.items()):
            if pending.request.what == what:
                del self._pending[command]
        for queue in self._waiting.values():
            queue[:] = [r for r in queue if r.what != what]

    def clear(self) -> None:
        """Nothing is wanted any more."""
        self._pending.clear()
        self._waiting.clear()

    @property
    def idle(self) -> bool:
        """Nothing is under way."""
        return not self._pending

    def _start(self, wanted: Request, now_s: float) -> None:
        self._pending[wanted.command] = _Pending(wanted, now_s, 1)
        self._send(wanted, 0)

    def answered(self, command: int, result: int, now_s: float) -> None:
        """Takes a COMMAND_ACK."""
        pending = self._pending.get(command)
        if pending is None:
            return
        wanted = pending.request
        if result == w.IN_PROGRESS:
            self._pending[command] = replace(pending, until_s=now_s + PROGRESS_S)
            return
        self._done(command, now_s)
        if result == w.ACCEPTED:
            self._rest_s[wanted.what] = now_s + AGAIN_S
            self._rejections.pop(wanted.what, None)
            return
        self._rest_s[wanted.what] = now_s + BACK_OFF_S
        count = self._rejections.get(wanted.what, 0) + 1
        self._rejections[wanted.what] = count
        # ArduPilot says FAILED for "not yet" as well (arming before the estimator is ready)
        if result in (w.BUSY, w.FAILED) and count < REJECTIONS:
            return
        self._rejections.pop(wanted.what, None)
        if wanted.loud:
            self._refused(wanted.what, w.RESULTS.get(result, f"result {result}"))

    def tick(self, now_s: float) -> None:
        """Resends what was not answered in time."""
        for command, pending in list(self._pending.items()):
            if pending.until_s is not None:
                if now_s >= pending.until_s:
                    self._give_up(command, pending.request, now_s)
            elif now_s - pending.sent_s >= RESEND_S:
                if pending.tries >= TRIES:
                    self._give_up(command, pending.request, now_s)
                    continue
                self._pending[command] = replace(pending, sent_s=now_s, tries=pending.tries + 1)
                self._send(pending.request, pending.tries)

    def _give_up(self, command: int, wanted: Request, now_s: float) -> None:
        self._done(command, now_s)
        self._rest_s[wanted.what] = now_s + BACK_OFF_S
        if wanted.loud:
            self._refused(wanted.what, "no answer")

    def _done(self, command: int, now_s: float) -> None:
        del self._pending[command]
        queue = self._waiting.get(command)
        if queue:
            self._start(queue.pop(0), now_s)
