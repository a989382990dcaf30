"""What a vehicle is asked when it connects: telemetry at its rates, single messages, parameters. No I/O, no clock."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers import mavlink_words as w
from drivers.mavlink_commands import Request, request
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_telemetry import parameter_value

PARAMETER_EVERY_S = 0.4
PARAMETER_TRIES = 6
OPTIONAL = ("MAV_GCS_SYSID", "EKF2_EV_CTRL")
"""Parameters of other versions: an unknown one has no answer and is not worth waiting for."""
OPTIONAL_TRIES = 2
SLOW_HZ = 2.0


@dataclass(frozen=True, slots=True)
class Stream:
    """A message that is asked for.

    Attributes:
        name, number: of the message.
        rate: ``fast`` and ``status`` as the options say, ``slow`` twice a second, ``once``.
        needed: without it there is no flight; others may come late or never.
    """

    name: str
    number: int
    rate: Literal["fast", "status", "slow", "once"]
    needed: bool = False


COMMON_STREAMS = (
    Stream("ATTITUDE", w.ATTITUDE, "fast", needed=True),
    Stream("SYS_STATUS", w.SYS_STATUS, "slow", needed=True),
    Stream("BATTERY_STATUS", w.BATTERY_STATUS, "slow"),
)


def where_streams(outdoors: bool) -> tuple[Stream, ...]:
    """Positions come only once the estimator has one: they cannot be waited for before poses are fed."""
    if outdoors:
        position = Stream("GLOBAL_POSITION_INT", w.GLOBAL_POSITION, "fast")
        return (position, Stream("GPS_RAW_INT", w.GPS_RAW_INT, "slow"))
    return (Stream("LOCAL_POSITION_NED", w.LOCAL_POSITION, "fast"),)


class Setup:
    """The questions to one vehicle and how far they have got.

    Attributes:
        parameters: values by name, as far as they were answered.
    """

    def __init__(self, options: MavlinkOptions) -> None:
        self.parameters: dict[str, float] = {}
        self._options = options
        self._streams: list[Stream] = []
        self._tries: dict[str, tuple[int, float]] = {}

    def begin(self, streams: Sequence[Stream], parameters: Sequence[str]) -> None:
        """Asks for everything, after connecting and after a reboot."""
        self._tries = dict.fromkeys(parameters, (0, -math.inf))
        self._streams = list(streams)

    @property
    def done(self) -> bool:
        """Everything has been asked for and the parameters are answered or given up."""
        return not self._streams and not self._tries

    def next_request(self) -> Request | None:
        """The next message to ask for: one after another, as only one command of a kind may be pending."""
        if not self._streams:
            return None
        stream = self._streams.pop(0)
        if stream.rate == "once":
            return request(f"message {stream.name}", w.REQUEST_MESSAGE, stream.number, loud=False)
        hz = {"fast": self._options.telemetry_hz, "status": self._options.status_hz}.get(stream.rate, SLOW_HZ)
        return request(f"rate of {stream.name}", w.SET_MESSAGE_INTERVAL, stream.number, 1e6 / hz, loud=False)

    def parameters_due(self, now_s: float) -> list[str]:
        """Names to ask for now."""
        due = []
        for name, (tries, at_s) in list(self._tries.items()):
            if now_s - at_s < PARAMETER_EVERY_S:
                continue
            if tries >= (OPTIONAL_TRIES if name in OPTIONAL else PARAMETER_TRIES):
                del self._tries[name]
                continue
            self._tries[name] = (tries + 1, now_s)
            due.append(name)
        return due

    def take(self, name: str, value: float, kind: int, bytewise: bool) -> None:
        """Takes a PARAM_VALUE; what nobody asked for is nothing."""
        if name in self._tries or name in self.parameters:
            self.parameters[name] = parameter_value(value, kind, bytewise)
            self._tries.pop(name, None)
