"""The last will of a Limo, or of any ROS 2 robot with ``cmd_vel``: it is told to stop by a node of the guardian's."""

from __future__ import annotations

import time

from drivers.clock import RealClock
from drivers.errors import DriverError
from drivers.last_will import Arguments

EVERY_S = 0.05
STOP_S = 2.0
"""So long it is told to stop once it hears: a robot whose driver keeps the last command has then got several."""


def prepare() -> None:
    """Loads ROS 2."""
    import drivers.limo_ros  # noqa: F401, PLC0415  half a second, for those alone who have a Limo


def carry_out(arguments: Arguments, height_m: float, deadline_s: float) -> str:
    """Stops it.

    Args:
        arguments: ``namespace``, ``domain``, and ``stop_mps``, the forward speed that means standing.
        height_m: of no interest.
        deadline_s: when to give up, ``time.monotonic()``.

    Returns:
        what became of it.

    Raises:
        DriverError: when nobody listens.
    """
    from drivers.limo_ros import RosRobot  # noqa: PLC0415  as above

    namespace, domain = str(arguments["namespace"]), arguments["domain"]
    vehicle = namespace.strip("/") or "robot"
    ros = RosRobot(vehicle, namespace, None if domain is None else int(domain), False, RealClock(), lambda: None)
    stop = (float(arguments["stop_mps"] or 0.0), 0.0, 0.0)
    heard_s: float | None = None
    try:
        while (now_s := time.monotonic()) < deadline_s:
            if heard_s is None and ros.listeners():
                heard_s = now_s
            ros.publish(*stop)
            if heard_s is not None and now_s > heard_s + STOP_S:
                return "was told to stop"
            time.sleep(EVERY_S)
    finally:
        ros.close(stop)
    raise DriverError(f"nobody listens to {ros.cmd_vel} in ROS domain {ros.domain}")
