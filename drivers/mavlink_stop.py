"""The emergency stop: repeated until a heartbeat confirms it. No I/O, no clock.

Neither autopilot locks a vehicle whose motors were stopped by force (PX4 does when flight termination is needed), so
the driver does: it arms it no more until it has been rebooted.
"""

from __future__ import annotations

import math

from drivers import mavlink_words as w
from drivers.mavlink_commands import Request, request

EVERY_S = 0.1
AT_LEAST_S = 0.5
"""Repeated for so long even when it seems confirmed: the heartbeat may have been under way."""
TERMINATE_AFTER_S = 0.7
"""Without effect for so long, flight termination is asked for as well."""
AT_MOST_S = 20.0
"""Afterwards a vehicle that is armed again is somebody else's business, until the stop is asked for again."""
OFF = request("emergency stop", w.ARM_DISARM, 0.0, w.FORCE)
SHOW = request("heartbeat", w.REQUEST_MESSAGE, w.HEARTBEAT)
"""Its effect shows with a heartbeat, which otherwise comes once a second."""
TERMINATE = request("flight termination", w.DO_FLIGHT_TERMINATION, 1.0)


class Stop:
    """The stop of one vehicle.

    Attributes:
        shown: a heartbeat has confirmed it.
    """

    def __init__(self) -> None:
        self.shown = False
        self._since_s: float | None = None
        self._sent_s = -math.inf

    @property
    def latched(self) -> bool:
        """Asked for, and not rebooted since."""
        return self._since_s is not None

    def begin(self, now_s: float) -> None:
        """The operator or the supervisor asks for it; again starts anew where it was over."""
        if self._since_s is None or self.shown or now_s - self._since_s > AT_MOST_S:
            self._since_s, self.shown = now_s, False
        self._sent_s = -math.inf

    def release(self) -> None:
        """The vehicle was rebooted."""
        self._since_s, self.shown = None, False

    def step(self, now_s: float, armed: bool, heartbeat_s: float, terminates: bool) -> tuple[Request, ...]:
        """What to send now, without waiting for any answer.

        Args:
            now_s: time.
            armed: by the newest heartbeat.
            heartbeat_s: receipt of that.
            terminates: the autopilot knows flight termination.
        """
        if self._since_s is None:
            return ()
        passed_s = now_s - self._since_s
        off = not armed and heartbeat_s > self._since_s
        self.shown = self.shown or off
        if (off and passed_s > AT_LEAST_S) or passed_s > AT_MOST_S or now_s - self._sent_s < EVERY_S:
            return ()
        self._sent_s = now_s
        if terminates and passed_s > TERMINATE_AFTER_S and not off:
            return (OFF, TERMINATE, SHOW)
        return (OFF, SHOW)
