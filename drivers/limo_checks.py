"""What a Limo shows of itself before the start, judged. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from drivers import limo_status
from drivers.limo_status import LimoStatus
from drivers.vehicle import SelfCheck

LOW_V = 10.5
"""Below this a tenth of the charge is left, about four minutes of driving."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What is known of it.

    Attributes:
        status: its newest status.
        odom_age_s: since its newest odometry.
        listeners: subscriptions that ``cmd_vel`` reaches.
        rivals: other publishers of ``cmd_vel``.
        cmd_vel: name of that topic.
    """

    status: LimoStatus | None
    odom_age_s: float
    listeners: int
    rivals: int
    cmd_vel: str


def checks(seen: Seen, mode: str, has_status: bool, stale_s: float) -> Sequence[SelfCheck]:
    """Findings on mode, control, errors, battery, telemetry and commands.

    Args:
        seen: what is known of it.
        mode: planned motion mode.
        has_status: it should have a status.
        stale_s: odometry older than this has ceased.
    """
    found = [_odometry(seen, stale_s), _commands(seen)]
    if seen.status is None:
        text = "no status has arrived" if has_status else "this robot has no limo_status"
        verdict: Literal["warn", "not run"] = "warn" if has_status else "not run"
        return [*found, *(SelfCheck(name, verdict, text) for name in ("mode", "control", "errors", "battery"))]
    return [*found, _mode(seen.status, mode), _control(seen.status), _errors(seen.status), _battery(seen.status)]


def _odometry(seen: Seen, stale_s: float) -> SelfCheck:
    if seen.odom_age_s <= stale_s:
        return SelfCheck("telemetry", "pass", "odometry arrives", round(seen.odom_age_s, 3), "s")
    return SelfCheck("telemetry", "fail", "odometry has ceased; look at the robot's ROS driver and the network")


def _commands(seen: Seen) -> SelfCheck:
    if seen.listeners == 0:
        return SelfCheck("commands", "fail", f"nobody listens to {seen.cmd_vel}; start the robot's ROS driver")
    if seen.listeners > 1:
        return SelfCheck(
            "commands", "warn",
            f"{seen.listeners} nodes listen to {seen.cmd_vel}; two robots on one topic both drive", seen.listeners,
        )  # fmt: skip
    if seen.rivals > 0:
        return SelfCheck(
            "commands", "warn",
            f"{seen.rivals} other nodes publish on {seen.cmd_vel}; stop teleoperation and navigation", seen.rivals,
        )  # fmt: skip
    return SelfCheck("commands", "pass", f"one robot listens to {seen.cmd_vel}, nobody else commands it")


def _mode(status: LimoStatus, mode: str) -> SelfCheck:
    modes = limo_status.MOTION_MODES
    really = modes[status.motion_mode] if status.motion_mode < len(modes) else f"number {status.motion_mode}"
    if really == mode:
        return SelfCheck("mode", "pass", f"motion mode {mode}")
    return SelfCheck(
        "mode", "fail",
        f"its motion mode is {really}, the fleet file says {mode}; set up its wheels and pins, or change the file",
    )  # fmt: skip


def _control(status: LimoStatus) -> SelfCheck:
    if status.control_mode == limo_status.COMMANDED:
        return SelfCheck("control", "pass", "follows ROS")
    return SelfCheck(
        "control", "fail",
        f"control mode {status.control_mode}: it does not follow ROS; switch the remote control or the app off",
    )  # fmt: skip


def _errors(status: LimoStatus) -> SelfCheck:
    words = limo_status.errors(status.error_code)
    if status.vehicle_state != limo_status.NORMAL:
        words = [*words, f"vehicle state {status.vehicle_state}"]
    if not words:
        return SelfCheck("errors", "pass", "reports none")
    return SelfCheck("errors", "fail", f"reports {', '.join(words)}; switch it off and on, then look at its manual")


def _battery(status: LimoStatus) -> SelfCheck:
    volts = status.battery_v
    if volts <= limo_status.CUT_OFF_V:
        return SelfCheck("battery", "fail", "is at its cut-off voltage; charge it", volts, "V")
    if volts < LOW_V:
        return SelfCheck("battery", "warn", f"is below {LOW_V} V; charge it", volts, "V")
    return SelfCheck("battery", "pass", f"{limo_status.charge(volts):.0%} by its voltage", volts, "V")
