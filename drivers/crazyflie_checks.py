"""What a connected Crazyflie shows of itself before the start, as checks. Pure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivers.crazyflie_bits import Bits, Values, words
from drivers.vehicle import SelfCheck

SUPERVISOR_PROTOCOL = 12
OLDEST_PROTOCOL = 7
"""CRTP protocol of the oldest firmware whose commands this driver speaks (2024)."""
WEAK_DBM = -75.0
POOR_PERCENT = 70.0
SLOW_LINK_S = 0.1


@dataclass(frozen=True, slots=True)
class Facts:
    """What the checks look at.

    Attributes:
        protocol: CRTP protocol version.
        values: newest log values.
        missing: wanted log variables that the firmware does not have.
        bits: the supervisor's.
        estimator: phase of the estimator's gate.
        resets: how often it was reset.
        variance_m2: largest variance of the position.
        quality: of the radio link, percent.
        latency_s: round trip, 95th percentile.
        fed: poses that went out.
        tick_moves: ``locSrvZ.tick`` has moved since poses go out; None where it is not logged.
        heading: headings go out with the poses.
    """

    protocol: int
    values: Values
    missing: Sequence[str]
    bits: Bits | None
    estimator: str
    resets: int
    variance_m2: float | None
    quality: float | None
    latency_s: float | None
    fed: int
    tick_moves: bool | None
    heading: bool


def self_checks(facts: Facts) -> list[SelfCheck]:
    """All of them, each once."""
    return [
        _firmware(facts),
        _variables(facts),
        _supervisor(facts),
        _estimator(facts),
        _pose_path(facts),
        _heading(facts),
        _battery(facts),
        _charger(facts),
        _radio(facts),
        _latency(facts),
    ]


def _firmware(f: Facts) -> SelfCheck:
    if f.protocol >= SUPERVISOR_PROTOCOL:
        return SelfCheck("firmware", "pass", f"CRTP protocol {f.protocol}", f.protocol)
    if f.protocol >= OLDEST_PROTOCOL:
        text = f"CRTP protocol {f.protocol} is older than {SUPERVISOR_PROTOCOL}: old ways are used; update the firmware"
        return SelfCheck("firmware", "warn", text, f.protocol)
    text = f"CRTP protocol {f.protocol} is too old to fly by high-level commands; update the firmware"
    return SelfCheck("firmware", "fail", text, f.protocol)


def _variables(f: Facts) -> SelfCheck:
    if not f.missing:
        return SelfCheck("log variables", "pass", "all are there")
    text = f"the firmware does not log {', '.join(f.missing)}: what depends on them is not checked"
    return SelfCheck("log variables", "warn", text, len(f.missing))


def _supervisor(f: Facts) -> SelfCheck:
    if f.bits is None:
        return SelfCheck("supervisor", "fail", "it does not say whether it may fly; update the firmware")
    wrong = words(f.bits)
    if wrong is not None:
        return SelfCheck("supervisor", "fail", wrong)
    if f.bits.can_fly or f.bits.can_be_armed:
        how = "arms itself" if f.bits.auto_arm else "waits to be armed"
        return SelfCheck("supervisor", "pass", f"ready to fly, {how}")
    return SelfCheck("supervisor", "fail", "not ready to fly: it must stand level and still after switching on")


def _estimator(f: Facts) -> SelfCheck:
    value, unit = f.variance_m2, "m2"
    match f.estimator:
        case "ready" if value is None:
            return SelfCheck("estimator", "warn", "reset; it does not log its variance, so nobody knows how good it is")
        case "ready":
            return SelfCheck("estimator", "pass", "has settled on the poses", value, unit)
        case "no poses":
            text = "has got no poses yet; feed motion capture first"
            return SelfCheck("estimator", "not run", text, value, unit)
        case "resetting" | "settling" if f.resets <= 1:
            return SelfCheck("estimator", "not run", "is settling; wait a few seconds", value, unit)
        case _:
            text = f"has not settled after {f.resets} resets; check body and axes in motion capture"
            return SelfCheck("estimator", "fail", text, value, unit)


def _pose_path(f: Facts) -> SelfCheck:
    if f.fed == 0:
        return SelfCheck("pose path", "not run", "no pose was sent yet")
    if f.tick_moves is None:
        return SelfCheck("pose path", "not run", "the firmware does not log locSrvZ.tick; nobody knows what arrives")
    if f.tick_moves:
        return SelfCheck("pose path", "pass", "poses arrive in the vehicle", f.fed, "poses")
    return SelfCheck("pose path", "fail", "poses go out but do not arrive; check radio and firmware", f.fed, "poses")


def _heading(f: Facts) -> SelfCheck:
    if f.heading:
        return SelfCheck("heading", "pass", "headings are sent with the poses")
    text = "only positions are sent: set it down along the x axis, its heading drifts; see option send_attitude"
    return SelfCheck("heading", "warn", text)


def _battery(f: Facts) -> SelfCheck:
    volts = f.values.get("pm.vbat")
    if "pm.batteryLevel" in f.values or volts is not None:
        return SelfCheck("battery telemetry", "pass", "the battery is reported", volts, "V")
    return SelfCheck("battery telemetry", "warn", "no pm.* is logged: its battery is unknown; watch the clock")


def _charger(f: Facts) -> SelfCheck:
    if "pm.state" in f.values:
        return SelfCheck("charger telemetry", "pass", "pm.state tells whether it charges")
    return SelfCheck("charger telemetry", "warn", "pm.state is not logged: charging is taken from standing on a dock")


def _radio(f: Facts) -> SelfCheck:
    rssi = f.values.get("radio.rssi")
    if f.quality is None and rssi is None:
        return SelfCheck("radio", "not run", "this link shows no quality")
    # the firmware logs the magnitude of a negative number
    dbm = None if rssi is None else -abs(rssi)
    poor = (f.quality is not None and f.quality < POOR_PERCENT) or (dbm is not None and dbm < WEAK_DBM)
    value, unit = (f.quality, "%") if f.quality is not None else (dbm, "dBm")
    if poor:
        return SelfCheck("radio", "warn", "the link is weak; move the radio or change the channel", value, unit)
    return SelfCheck("radio", "pass", "the link is good", value, unit)


def _latency(f: Facts) -> SelfCheck:
    if f.latency_s is None:
        return SelfCheck("link latency", "not run", "no echo came back yet")
    if f.latency_s > SLOW_LINK_S:
        text = "commands take long; fewer vehicles a radio or a better place for it"
        return SelfCheck("link latency", "warn", text, 1000 * f.latency_s, "ms")
    return SelfCheck("link latency", "pass", "commands arrive in time", 1000 * f.latency_s, "ms")
