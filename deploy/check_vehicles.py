"""What the drivers found out about their vehicles and the motion capture, as rows of the checks: one row a name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from deploy.check_report import CheckRow, Verdict
from deploy.fleet import Fleet
from drivers.mocap_identity import IdentityCheck
from drivers.vehicle import SelfCheck

GROUP = "vehicles"
SETTLE_S = 25.0
"""So long estimators may take from the first pose on; a Crazyflie's own gate gives up after 20 s."""
QUIET_S = 8.0
"""When nothing has changed for so long, waiting longer will not help; a Crazyflie's variance is watched for 5 s."""
LOOK_S = 0.2
SETTLING = frozenset({"estimator", "pose path", "position", "satellites", "pre-arm", "supervisor", "poses rate"})
"""Findings that get better by themselves soon after connecting."""
_ORDER = (Verdict.PASS, Verdict.NOT_RUN, Verdict.WARN, Verdict.FAIL)
EVERYBODY = ""
"""Whose findings concern the fleet as a whole."""
BY_HAND = "identity by hand"


def settle(fleet: Fleet, limit_s: float = SETTLE_S, quiet_s: float = QUIET_S) -> None:
    """Waits until what settles by itself has settled, or nothing changes any more."""
    begun_s = changed_s = fleet.clock.now()
    before: list[tuple[str, str, str]] | None = None
    while fleet.clock.now() < begun_s + limit_s:
        open_: list[tuple[str, str, str]] = [
            (vehicle, f.name, f.verdict)
            for vehicle, found in findings(fleet).items()
            for f in found
            if f.name in SETTLING and f.verdict in ("fail", "not run")
        ]
        if not open_:
            return
        if open_ != before:
            before, changed_s = open_, fleet.clock.now()
        if fleet.clock.now() - changed_s > quiet_s:
            return
        fleet.clock.wait_until(fleet.clock.now() + LOOK_S)


def identify_fleet(fleet: Fleet, say: Callable[[str], None]) -> list[SelfCheck]:
    """Asks for each vehicle to be moved by hand, and sees whether its own body moves.

    Args:
        fleet: connected.
        say: tells the operator what to do.
    """
    check = IdentityCheck({vehicle: body for body, vehicle in fleet.bodies.items()})
    while not check.done:
        for text in check.step(fleet.listening.read(), fleet.clock.now()):
            say(text)
        fleet.clock.wait_until(fleet.clock.now() + 0.02)
    return [SelfCheck(BY_HAND, r.check().verdict, r.text) for r in check.results]


def findings(fleet: Fleet) -> dict[str, Sequence[SelfCheck]]:
    """By vehicle id, and for the fleet as a whole."""
    found: dict[str, Sequence[SelfCheck]] = {name: v.self_checks() for name, v in fleet.vehicles.items()}
    found[EVERYBODY] = fleet.checks()
    return found


def vehicle_rows(found: Mapping[str, Sequence[SelfCheck]]) -> list[CheckRow]:
    """One row for each name, with the worst verdict of all vehicles; the text names who has not passed."""
    by_name: dict[str, list[tuple[str, SelfCheck]]] = {}
    for vehicle, checks in found.items():
        for check in checks:
            by_name.setdefault(check.name, []).append((vehicle, check))
    return [_row(name, checks) for name, checks in by_name.items()]


def _row(name: str, checks: Sequence[tuple[str, SelfCheck]]) -> CheckRow:
    worst = max((Verdict(c.verdict) for _, c in checks), key=_ORDER.index)
    shown = [(vehicle, c) for vehicle, c in checks if Verdict(c.verdict) is worst]
    value, unit = (shown[0][1].value, shown[0][1].unit) if len(shown) == 1 else (None, "")
    if worst is Verdict.FAIL:
        shown += [(vehicle, c) for vehicle, c in checks if Verdict(c.verdict) is Verdict.WARN]
    # without a unit it is a count or a level, which the text tells better than a table that thinks of shares
    return CheckRow(name, GROUP, worst, value if unit else None, unit, None, _words(shown))


def _words(checks: Sequence[tuple[str, SelfCheck]]) -> str:
    """Who shows what; the same words once."""
    words: dict[str, list[str]] = {}
    for vehicle, check in checks:
        words.setdefault(check.text, []).append(vehicle)
    named = {text: ", ".join(w for w in who if w != EVERYBODY) for text, who in words.items()}
    return "; ".join(f"{who}: {text}" if who else text for text, who in named.items())
