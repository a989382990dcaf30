"""What a MAVLink vehicle shows of itself before the start, judged. Pure."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers import mavlink_words as w
from drivers.mavlink_dialect import Dialect, Parameters
from drivers.mavlink_options import MavlinkOptions
from drivers.mavlink_telemetry import Telemetry, version_text
from drivers.vehicle import Kind, Pose, SelfCheck

OLDEST = {"PX4": (1, 14), "ArduPilot": (4, 3)}
"""Firmware that the drivers were written after."""
AGREE_M = 0.3
"""Largest distance between its own estimate and motion capture; what indoor flights keep from each other."""
BATTERY_LOW = 0.3


@dataclass(frozen=True)
class Shown:
    """Everything that the checks look at.

    Attributes:
        pose: newest trusted pose of motion capture, None outdoors.
        streams_missing: messages that were asked for and did not come.
        unsigned: packets without or with a wrong signature while signing.
        key_is_open: others than the owner can read the signing key.
    """

    kind: Kind
    dialect: Dialect
    options: MavlinkOptions
    telemetry: Telemetry
    parameters: Parameters
    outdoors: bool
    pose: Pose | None
    now_s: float
    streams_missing: tuple[str, ...] = ()
    signing: bool = False
    unsigned: int = 0
    key_is_open: bool = False
    lost: float = 0.0


def findings(shown: Shown) -> list[SelfCheck]:
    """All checks, each name once."""
    return [
        _firmware(shown),
        _mode(shown),
        _estimator(shown),
        _position(shown),
        *([_gps(shown)] if shown.outdoors else []),
        _battery(shown),
        *([_charger(shown)] if shown.kind == "uav" else []),
        _prearm(shown),
        _pilot(shown),
        _radio(shown),
        _signing(shown),
        *shown.dialect.death_checks(shown.parameters, shown.options.system_id),
    ]


def _firmware(s: Shown) -> SelfCheck:
    version = s.telemetry.version
    if not version:
        return SelfCheck("firmware", "not run", f"{s.dialect.name} does not tell its version")
    text = f"{s.dialect.name} {version_text(version)}"
    oldest = OLDEST[s.dialect.name]
    if (version >> 24 & 0xFF, version >> 16 & 0xFF) < oldest:
        return SelfCheck("firmware", "warn", f"{text} is older than {oldest[0]}.{oldest[1]}: update it")
    return SelfCheck("firmware", "pass", text)


def _mode(s: Shown) -> SelfCheck:
    name = s.dialect.mode_name(s.telemetry.custom_mode)
    if s.telemetry.armed:
        return SelfCheck("mode", "warn", f"{name}, already armed: disarm it before the start")
    return SelfCheck("mode", "pass", f"{name}, disarmed")


def _estimator(s: Shown) -> SelfCheck:
    flags = s.telemetry.ekf_flags
    if flags is None:
        return SelfCheck("estimator", "not run", "it does not tell the state of its estimator")
    wanted = {w.EKF_ATTITUDE: "attitude", w.EKF_VELOCITY_HORIZONTAL: "velocity"}
    if s.kind == "uav":
        wanted[w.EKF_ALTITUDE] = "height"
    missing = [name for bit, name in wanted.items() if not flags & bit]
    if not flags & (w.EKF_POSITION_ABSOLUTE | w.EKF_POSITION_RELATIVE) or flags & w.EKF_CONSTANT_POSITION:
        missing.append("position")
    if missing:
        source = "satellites" if s.outdoors else "motion-capture poses and its settings for external vision"
        return SelfCheck("estimator", "fail", f"no {', '.join(missing)}: wait, or look at {source}")
    return SelfCheck("estimator", "pass", "attitude, velocity and position are estimated")


def _position(s: Shown) -> SelfCheck:
    t = s.telemetry
    if t.position_m is None or s.now_s - t.position_s > 2.0:
        return SelfCheck("position", "fail", "it sends no position; wait for its estimator")
    if s.pose is None or s.outdoors:
        x, y, z = t.position_m
        return SelfCheck("position", "pass", f"({x:.1f}, {y:.1f}, {z:.1f}) m by its own estimate")
    # a rover's height means nothing
    n = 3 if s.kind == "uav" else 2
    off = math.dist(t.position_m[:n], s.pose.position_m[:n])
    if off > AGREE_M:
        text = f"its own estimate is {off:.2f} m from motion capture: restart its estimator, check the axes"
        return SelfCheck("position", "fail", text, off, "m")
    return SelfCheck("position", "pass", f"{off:.2f} m from motion capture", off, "m")


def _gps(s: Shown) -> SelfCheck:
    fix, n = s.telemetry.gps_fix, s.telemetry.satellites
    names = {0: "no receiver", 1: "no fix", 2: "2D", 3: "3D", 4: "3D with corrections", 5: "RTK float", 6: "RTK fixed"}
    if fix is None:
        return SelfCheck("satellites", "not run", "it does not tell about its receiver")
    text = f"{names.get(fix, f'fix {fix}')}" + ("" if n is None else f", {n} satellites")
    if fix < 3:
        return SelfCheck("satellites", "fail", f"{text}: give it a view of the sky and wait", n)
    if fix < 5:
        return SelfCheck("satellites", "warn", f"{text}: precise enough to fly, not to dock; use RTK for docking", n)
    return SelfCheck("satellites", "pass", text, n)


def _battery(s: Shown) -> SelfCheck:
    level = s.telemetry.battery
    if level is None:
        return SelfCheck("battery", "warn", "it does not tell its charge; set up its battery monitor")
    if level < BATTERY_LOW:
        return SelfCheck("battery", "warn", f"{level:.0%}: charge it", level)
    return SelfCheck("battery", "pass", f"{level:.0%}", level)


def _charger(s: Shown) -> SelfCheck:
    if s.telemetry.charging is None:
        text = "the battery monitor tells neither charge state nor current: standing on a pad will count as charging"
        return SelfCheck("charger", "warn", text)
    return SelfCheck("charger", "pass", "the battery monitor can confirm charging")


def _prearm(s: Shown) -> SelfCheck:
    if s.telemetry.health is None:
        return SelfCheck("pre-arm", "not run", "it does not tell whether it could be armed")
    present, _, health = s.telemetry.health
    if not present & w.SENSOR_PREARM:
        return SelfCheck("pre-arm", "not run", "it does not tell whether it could be armed")
    if not health & w.SENSOR_PREARM:
        why = s.telemetry.why(s.now_s - 35.0) or "look at its messages in QGroundControl"
        return SelfCheck("pre-arm", "warn", f"it would refuse to arm at the moment: {why}")
    return SelfCheck("pre-arm", "pass", "it could be armed")


def _pilot(s: Shown) -> SelfCheck:
    health = s.telemetry.health
    if health is None or not health[0] & w.SENSOR_RC_RECEIVER:
        return SelfCheck("remote control", "not run", "no receiver is seen: have a pilot's kill switch at hand")
    if not health[2] & w.SENSOR_RC_RECEIVER:
        return SelfCheck("remote control", "warn", "its receiver hears no remote control: switch that on")
    return SelfCheck("remote control", "pass", "heard; a pilot can take over")


def _radio(s: Shown) -> SelfCheck:
    if s.streams_missing:
        text = f"{', '.join(s.streams_missing)} did not come: the link is too slow, or the firmware lacks them"
        return SelfCheck("radio", "warn", text)
    if s.lost > 0.1:
        text = f"{s.lost:.0%} of its packets are lost: move the antenna or lower telemetry_hz"
        return SelfCheck("radio", "warn", text, s.lost)
    return SelfCheck("radio", "pass", f"{s.lost:.1%} of its packets are lost", s.lost)


def _signing(s: Shown) -> SelfCheck:
    if not s.signing:
        return SelfCheck("signing", "not run", "packets are not signed: anybody in range of the radio may command it")
    if s.key_is_open:
        return SelfCheck("signing", "warn", "others can read the key file: make it readable for its owner alone")
    if s.unsigned:
        return SelfCheck("signing", "warn", f"{s.unsigned} packets without a good signature were dropped", s.unsigned)
    return SelfCheck("signing", "pass", "packets are signed")
