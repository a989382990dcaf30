"""The last will of a MAVLink vehicle: its autopilot lands or holds it by itself, asked for by the guardian.

The guardian speaks as the ground station did (same system id, same key), and its heartbeats go on until the vehicle
is down, so that no failsafe of the autopilot interrupts the landing. A vehicle that a pilot steers is left alone.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from drivers import mavlink_words as w
from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.last_will import Arguments
from drivers.mavlink_ardupilot import COPTER_LAND
from drivers.mavlink_commands import Desk, Request, request
from drivers.mavlink_dialect import kind_of
from drivers.mavlink_link import Link
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_px4 import AUTO, LAND, by_pilot, custom_mode

PX4_HOLD, ROVER_HOLD = 3, 4
BY_PILOT: dict[tuple[int, str], Callable[[int], bool]] = {
    (w.PX4, "uav"): by_pilot,
    (w.PX4, "ugv"): by_pilot,
    (w.ARDUPILOT, "uav"): w.COPTER_PILOT.__contains__,
    (w.ARDUPILOT, "ugv"): w.ROVER_PILOT.__contains__,
}
OPEN_EVERY_S = 0.2
POLL_S = 0.02
STAND_S = 3.0
"""A rover that refuses to hold for so long is disarmed."""
HELD_S = 2.0
"""So long a rover in its holding mode brakes, with our heartbeats."""


@dataclass(frozen=True, slots=True)
class Rest:
    """The mode in which an autopilot brings its vehicle to rest.

    Attributes:
        name: for people.
        custom_mode: in the heartbeat.
        parameters: 2 and 3 of DO_SET_MODE.
    """

    name: str
    custom_mode: int
    parameters: tuple[float, float]


RESTS = {
    (w.PX4, "uav"): Rest("LAND", custom_mode(AUTO, LAND), (AUTO, LAND)),
    (w.PX4, "ugv"): Rest("HOLD", custom_mode(AUTO, PX4_HOLD), (AUTO, PX4_HOLD)),
    (w.ARDUPILOT, "uav"): Rest("LAND", COPTER_LAND, (COPTER_LAND, 0.0)),
    (w.ARDUPILOT, "ugv"): Rest("HOLD", ROVER_HOLD, (ROVER_HOLD, 0.0)),
}


def carry_out(arguments: Arguments, height_m: float, deadline_s: float) -> str:
    """Has a copter land where it is, a rover hold.

    Args:
        arguments: ``endpoint``, ``sysid``, and ``system_id``, ``component_id``, ``baud``,
            ``signing_key_file`` of ``MavlinkOptions``.
        height_m: the autopilot knows its own.
        deadline_s: when to give up, ``time.monotonic()``.

    Returns:
        what became of it.

    Raises:
        DriverError: when it cannot be reached.
    """
    executor = _Executor(int(arguments["sysid"] or 1))
    link = _board(arguments, executor, deadline_s)
    try:
        executor.link = link
        while executor.said is None and time.monotonic() < deadline_s:
            time.sleep(POLL_S)
    finally:
        link.leave(executor)
    if executor.said is None:
        raise DriverError(executor.trouble or f"no heartbeat of system {executor.sysid} at {link.endpoint}")
    return executor.said


def _board(arguments: Arguments, executor: _Executor, deadline_s: float) -> Link:
    """The dead program's port is released by the kernel in a moment: tried until then."""
    key = arguments["signing_key_file"]
    options = MavlinkOptions(
        system_id=int(arguments["system_id"] or 255),
        component_id=int(arguments["component_id"] or 190),
        baud=int(arguments["baud"] or 57600),
        signing_key_file=None if key is None else Path(str(key)),
    )
    clock = RealClock()
    while True:
        try:
            return Link.board(str(arguments["endpoint"]), options, clock, executor, 1.0)
        except DriverError:
            if time.monotonic() > deadline_s:
                raise
        time.sleep(OPEN_EVERY_S)


class _Executor:
    """The vehicle on the link; everything but ``said`` belongs to the link's thread.

    Attributes:
        said: what became of the vehicle, at the end.
        trouble: why it is not at rest yet.
    """

    def __init__(self, sysid: int) -> None:
        self.sysid = sysid
        self.link: Link | None = None
        self.said: str | None = None
        self.trouble: str | None = None
        self._desk = Desk(self._send, self._refused)
        self._heard: Any = None
        self._begun_s: float | None = None
        self._held_s: float | None = None

    def alive(self, now_s: float) -> bool:
        """It is the guardian's heartbeat."""
        return True

    def on_message(self, message: Any, now_s: float) -> None:
        """Takes heartbeats and acknowledgements."""
        if message.get_type() == "HEARTBEAT":
            self._heard = message
        elif message.get_type() == "COMMAND_ACK":
            self._desk.answered(message.command, message.result, now_s)
            if message.result == w.ACCEPTED and message.command != w.REQUEST_MESSAGE:
                self._desk.settled("heartbeat")
                self._desk.ask(request("heartbeat", w.REQUEST_MESSAGE, w.HEARTBEAT, loud=False), now_s)

    def pump(self, now_s: float) -> None:
        """Nothing is handed over."""

    def tick(self, now_s: float) -> None:
        """Asks for rest until the heartbeat shows it."""
        if self.link is None or self._heard is None or self.said is not None:
            return
        self._begun_s = now_s if self._begun_s is None else self._begun_s
        self._desk.tick(now_s)
        kind, armed = kind_of(self._heard.type), bool(self._heard.base_mode & w.ARMED_FLAG)
        mode = int(self._heard.custom_mode)
        rest = RESTS.get((self._heard.autopilot, kind or ""))
        if rest is None or kind is None:
            self.said = "is no vehicle that can be brought to rest; left alone"
        elif not armed:
            self.said = "landed, its motors are off" if kind == "uav" else "stands, its motors are off"
        elif mode == rest.custom_mode:
            self._desk.cancel("mode")
            self._rests(kind, rest, now_s)
        elif BY_PILOT[self._heard.autopilot, kind](mode):
            self.said = "a pilot steers it; left alone"
        else:
            self._desk.ask(request("mode", w.DO_SET_MODE, w.CUSTOM_MODE, *rest.parameters), now_s)
            if kind == "ugv" and now_s - self._begun_s > STAND_S:
                self._desk.ask(request("disarming", w.ARM_DISARM, 0.0, w.FORCE), now_s)

    def _rests(self, kind: str, rest: Rest, now_s: float) -> None:
        self.trouble = f"it is in {rest.name}, but not down yet"
        self._held_s = now_s if self._held_s is None else self._held_s
        if kind == "ugv" and now_s - self._held_s > HELD_S:
            self.said = f"stands in {rest.name}"

    def on_error(self, error: Exception) -> None:
        """Told at the end."""
        self.trouble = f"internal error: {error}"

    def _send(self, wanted: Request, confirmation: int) -> None:
        if self.link is not None:
            target = (self.sysid, w.AUTOPILOT_COMPONENT)
            self.link.send(self.sysid, "command_long", *target, wanted.command, confirmation, *wanted.parameters)

    def _refused(self, what: str, why: str) -> None:
        self.trouble = f"{what} refused: {why}"
