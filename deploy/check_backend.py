"""Checks of the vehicles themselves: links, batteries, poses, and whether everybody is who and where the plan says."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from deploy.check_limits import CheckLimits
from deploy.check_report import CheckRow, Verdict, not_run
from deploy.settings import Settings
from drivers.vehicle import Pose, SelfCheck, Vec2, Vehicle, VehicleState

GROUP = "backend"
NAMES = ("links", "readiness", "batteries", "poses", "placement", "identity")


@dataclass(frozen=True, slots=True)
class BackendProbe:
    """What a backend showed when it was looked at.

    Attributes:
        now_s: when, on its clock.
        states: newest telemetry by vehicle id; missing where nothing was ever received.
        poses: newest pose by body.
        errors: why a vehicle or the motion capture ("poses") could not be reached, in its driver's words.
        findings: what the drivers found out, by vehicle id, and for the fleet as a whole under "".
    """

    now_s: float
    states: Mapping[str, VehicleState]
    poses: Mapping[str, Pose]
    errors: Mapping[str, str] = field(default_factory=dict)
    findings: Mapping[str, Sequence[SelfCheck]] = field(default_factory=dict)


class Poses(Protocol):
    """Where poses are read."""

    def read(self) -> Sequence[Pose]:
        """The newest of each body since the last call."""
        ...


def probe_backend(
    vehicles: Mapping[str, Vehicle],
    poses: Poses,
    now: Callable[[], float],
    wait_until: Callable[[float], object],
    *,
    listen_s: float = 1.0,
    errors: Mapping[str, str] | None = None,
    more: Callable[[], Sequence[SelfCheck]] = tuple,
) -> BackendProbe:
    """Listens to connected vehicles and motion capture for a moment; arms and moves nothing.

    Args:
        vehicles: by id, connected.
        poses: connected.
        now: the clock.
        wait_until: waits on that clock.
        listen_s: for how long.
        errors: of those that could not be connected.
        more: findings about the fleet as a whole.
    """
    seen: dict[str, Pose] = {}
    end = now() + listen_s
    while True:
        for pose in poses.read():
            seen[pose.body] = pose
        if now() >= end:
            break
        wait_until(min(end, now() + 0.1))
    errors = dict(errors or {})
    found: dict[str, Sequence[SelfCheck]] = {i: v.self_checks() for i, v in vehicles.items() if i not in errors}
    if "poses" not in errors:
        found[""] = more()
    return BackendProbe(now(), {i: v.state() for i, v in vehicles.items()}, seen, errors, found)


def backend_rows(settings: Settings, limits: CheckLimits, probe: BackendProbe | None) -> list[CheckRow]:
    """All checks of the backend; not run without a probe."""
    if probe is None:
        return [not_run(name, GROUP, "no backend was looked at") for name in NAMES]
    return [
        _links(settings, probe),
        _readiness(settings, probe),
        _batteries(settings, limits, probe),
        _poses(settings, probe),
        *_places(settings, probe),
    ]


def _ids(settings: Settings) -> list[str]:
    return [u.id for u in settings.uavs] + [g.id for g in settings.ugvs]


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names)


def _links(settings: Settings, probe: BackendProbe) -> CheckRow:
    """Oldest telemetry; everyone must be heard."""
    limit = settings.monitors.telemetry_stale_s
    bad = []
    ages = []
    for i in _ids(settings):
        state = probe.states.get(i)
        if i in probe.errors:
            bad.append(f"{i}: {probe.errors[i].removeprefix(f'{i}: ')}")
        elif state is None or not state.link:
            bad.append(f"{i} does not answer")
        else:
            ages.append(probe.now_s - state.stamp_s)
            if ages[-1] > limit:
                bad.append(f"{i} was last heard {ages[-1]:.1f} s ago")
    oldest = max(ages, default=None)
    if bad:
        text = f"{_listed(bad)}; check power, address and radio"
        return CheckRow("links", GROUP, Verdict.FAIL, oldest, "s", limit, text)
    text = f"all {len(ages)} vehicles answer, the oldest telemetry is {oldest or 0:.2f} s old"
    return CheckRow("links", GROUP, Verdict.PASS, oldest, "s", limit, text)


def _readiness(settings: Settings, probe: BackendProbe) -> CheckRow:
    """Vehicles that are in the air, armed, tumbled, locked or faulty before the start."""
    bad = []
    for i in _ids(settings):
        state = probe.states.get(i)
        if state is None:
            continue
        words = [w for w in ("airborne", "armed", "tumbled", "locked") if getattr(state, w)]
        if state.fault is not None:
            words.append(f"reports {state.fault!r}")
        if words:
            bad.append(f"{i} is {' and '.join(words)}")
    if bad:
        text = f"{_listed(bad)}; land, disarm or reset before the start"
        return CheckRow("readiness", GROUP, Verdict.FAIL, float(len(bad)), "vehicles", 0.0, text)
    text = "every vehicle rests, disarmed and without a fault"
    return CheckRow("readiness", GROUP, Verdict.PASS, 0.0, "vehicles", 0.0, text)


def _batteries(settings: Settings, limits: CheckLimits, probe: BackendProbe) -> CheckRow:
    """Least measured charge as a share of what the plan starts with."""
    shares = []
    silent = []
    planned = [
        (c.id, c.energy, u.capacity_j, u.energy_j) for u, c in zip(settings.problem.uavs, settings.uavs, strict=True)
    ]
    planned += [
        (c.id, c.energy, g.capacity_j, g.energy_j) for g, c in zip(settings.problem.ugvs, settings.ugvs, strict=True)
    ]
    for who, energy, capacity_j, energy_j in planned:
        state = probe.states.get(who)
        if energy != "measured" or state is None:
            continue
        if state.battery is None:
            silent.append(who)
        elif energy_j > 0:
            shares.append((state.battery * capacity_j / energy_j, who, state.battery))
    if not shares and not silent:
        text = "energies are counted by the model, no battery is asked"
        return CheckRow("batteries", GROUP, Verdict.PASS, None, "of plan", limits.battery_fail, text)
    if silent:
        text = f"{_listed(silent)} cannot tell the charge; set energy to virtual, or mend the battery's telemetry"
        return CheckRow("batteries", GROUP, Verdict.FAIL, None, "of plan", limits.battery_fail, text)
    share, who, level = min(shares)
    text = f"{who} is charged to {100 * level:.0f} %, {100 * share:.0f} % of what the plan starts with"
    if share < limits.battery_warn:
        verdict = Verdict.FAIL if share < limits.battery_fail else Verdict.WARN
        limit = limits.battery_fail if verdict is Verdict.FAIL else limits.battery_warn
        text += "; charge it, or set its energy_j to what it has and plan again"
        return CheckRow("batteries", GROUP, verdict, share, "of plan", limit, text)
    return CheckRow("batteries", GROUP, Verdict.PASS, share, "of plan", limits.battery_fail, text)


def _bodies(settings: Settings) -> dict[str, str]:
    return {u.id: u.body for u in settings.uavs} | {g.id: g.body for g in settings.ugvs}


def _poses(settings: Settings, probe: BackendProbe) -> CheckRow:
    """Age of the oldest pose; everyone must be seen."""
    limit = settings.monitors.pose_stale_s
    bad = [f"motion capture: {probe.errors['poses']}"] if "poses" in probe.errors else []
    ages = []
    for i, body in _bodies(settings).items():
        pose = probe.poses.get(body)
        if pose is None:
            bad.append(f"{i} (body {body!r}) is not seen")
            continue
        ages.append(probe.now_s - pose.stamp_s)
        if ages[-1] > limit:
            bad.append(f"the pose of {i} is {ages[-1]:.2f} s old")
    oldest = max(ages, default=None)
    if bad:
        text = f"{_listed(bad)}; check markers, body names and the motion capture's stream"
        return CheckRow("poses", GROUP, Verdict.FAIL, oldest, "s", limit, text)
    text = f"all {len(ages)} vehicles are seen, the oldest pose is {oldest or 0:.2f} s old"
    return CheckRow("poses", GROUP, Verdict.PASS, oldest, "s", limit, text)


def starts(settings: Settings) -> dict[str, Vec2]:
    """Where the plan expects each vehicle before the start, arena m."""
    found: dict[str, Vec2] = {}
    depot = settings.problem.depot_index
    for i, u in enumerate(settings.problem.uavs):
        found[u.id] = settings.pad_m(i, depot)
    for j, g in enumerate(settings.problem.ugvs):
        if g.distance_to_m is not None:
            if g.position is not None:
                found[g.id] = settings.frame.to_arena(g.position)
            continue
        found[g.id] = settings.park_m(j, depot if g.path_point is None else g.path_point)
    return found


def _places(settings: Settings, probe: BackendProbe) -> tuple[CheckRow, CheckRow]:
    """Who stands too far from its start, and who stands at somebody else's."""
    limit = settings.monitors.pose_jump_m
    expected = starts(settings)
    bodies = _bodies(settings)
    seen = {i: probe.poses[bodies[i]].position_m[:2] for i in expected if bodies[i] in probe.poses}
    if not seen:
        why = "no vehicle is seen"
        return not_run("placement", GROUP, why, "m"), not_run("identity", GROUP, why)
    off = {i: math.dist(at, expected[i]) for i, at in seen.items()}
    worst = max(off, key=off.__getitem__)
    text = f"{worst} stands {off[worst]:.2g} m from its start"
    place = CheckRow("placement", GROUP, Verdict.PASS, off[worst], "m", limit, text)
    if off[worst] > limit:
        x, y = expected[worst]
        far = sum(d > limit for d in off.values())
        text += f", {far} vehicle{'s stand' if far > 1 else ' stands'} too far off; bring it to ({x:.2f}, {y:.2f})"
        place = CheckRow("placement", GROUP, Verdict.FAIL, off[worst], "m", limit, text)
    swapped = []
    for i, at in seen.items():
        nearest = min(expected, key=lambda j: math.dist(at, expected[j]))
        # Somebody else's start counts only where it is clearly the nearer one: pads may be close.
        if nearest != i and 2 * math.dist(at, expected[nearest]) < off[i]:
            swapped.append(f"{i} (body {bodies[i]!r}) stands where {nearest} should")
    if swapped:
        text = f"{_listed(swapped)}; swap the vehicles, or their body names in the fleet"
        who = CheckRow("identity", GROUP, Verdict.FAIL, float(len(swapped)), "vehicles", 0.0, text)
    else:
        text = f"all {len(seen)} vehicles seen stand nearest to their own start"
        who = CheckRow("identity", GROUP, Verdict.PASS, 0.0, "vehicles", 0.0, text)
    return place, who
