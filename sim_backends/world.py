"""What a simulated world consists of: frozen, in the arena frame, m and s, unless a name or a line says otherwise.

Energy is the world's: a scaled-down mission drains its batteries as if it were flown at full size. ``scale`` and
``time_scale`` relate the two: a power in W acts on mission seconds, at the world's speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from sim_backends.errors import SimulationError

Vec2 = tuple[float, float]

GRID_S = 0.02
"""Period of the loop, s: the virtual clock only ever stands at multiples of it."""
UAV_POWER_W = (229.6, -1.8761, -0.5834, 0.0461)
UGV_POWER_W = (356.3, 464.8)


def line_power_w(rest_w: float, moving_w: float, speed_mps: float) -> tuple[float, float]:
    """Coefficients of the straight line through the power at rest and the power at ``speed_mps``.

    Args:
        rest_w: power at speed 0 (hovering), W.
        moving_w: power at ``speed_mps``, W.
        speed_mps: world speed, m/s.

    Returns:
        ``(c0, c1)`` for ``SimUav.power_w`` or ``SimUgv.power_w``.
    """
    return (rest_w, (moving_w - rest_w) / speed_mps)


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise SimulationError(message)


def _numbers(owner: str, obj: object, not_negative: tuple[str, ...], positive: tuple[str, ...]) -> None:
    for name in (*not_negative, *positive):
        value = getattr(obj, name)
        good = isinstance(value, int | float) and math.isfinite(value)
        good = good and (value > 0 if name in positive else value >= 0)
        limit = "above 0" if name in positive else "of at least 0"
        _require(good, f"{owner}: {name} is {value!r}; give a number {limit}")


def _power(owner: str, power_w: tuple[float, ...]) -> None:
    _require(
        1 <= len(power_w) <= 4 and all(math.isfinite(c) for c in power_w),
        f"{owner}: power_w is {power_w!r}; give 1 to 4 finite coefficients",
    )


@dataclass(frozen=True, slots=True)
class SimUav:
    """One simulated UAV.

    Attributes:
        id: vehicle id.
        body: its name in motion capture.
        start_m: where it stands at the start; ignored where ``on`` is given.
        on: the UGV on whose dock ``dock`` it starts, or None.
        dock: see ``on``.
        max_speed_mps: never flies faster.
        accel_mps2: of every change of velocity.
        climb_mps, descent_mps: limits of the vertical speed.
        tracking_noise_m: standard deviation of its wandering around the reference, horizontally.
        dock_noise_m: the same while it docks, where it sees the pad.
        drift_mps: how fast its estimate runs away without poses.
        power_w: coefficients c0 + c1 v + c2 v^2 + c3 v^3 over the world's air speed in m/s.
        capacity_j: battery when full.
        energy_j: at the start; None is full.
    """

    id: str
    body: str
    start_m: Vec2 = (0.0, 0.0)
    on: str | None = None
    dock: int = 0
    max_speed_mps: float = 15.0
    accel_mps2: float = 3.0
    climb_mps: float = 5.0
    descent_mps: float = 3.0
    tracking_noise_m: float = 0.1
    dock_noise_m: float = 0.03
    drift_mps: float = 0.1
    power_w: tuple[float, ...] = UAV_POWER_W
    capacity_j: float = 287_700.0
    energy_j: float | None = None

    def __post_init__(self) -> None:
        owner = f"simulated uav {self.id!r}"
        _numbers(
            owner,
            self,
            ("tracking_noise_m", "dock_noise_m", "drift_mps"),
            ("max_speed_mps", "accel_mps2", "climb_mps", "descent_mps", "capacity_j"),
        )
        _require(all(map(math.isfinite, self.start_m)), f"{owner}: start_m is {self.start_m!r}; give finite m")
        _require(
            self.energy_j is None or 0 <= self.energy_j <= self.capacity_j,
            f"{owner}: energy_j is {self.energy_j!r}; give J from 0 to the capacity {self.capacity_j:g}",
        )
        _power(owner, self.power_w)


@dataclass(frozen=True, slots=True)
class SimUgv:
    """One simulated UGV with charging docks.

    Attributes:
        id, body, start_m: as for UAVs.
        yaw_rad: heading at the start.
        max_speed_mps: never drives faster.
        accel_mps2: of starts and stops.
        tracking_noise_m: standard deviation of its wandering around the path while it drives.
        power_w: coefficients over the world's speed, while driving.
        idle_w: power while standing.
        capacity_j, energy_j: as for UAVs; recharges are taken from it.
        charge_s: mission s in which a recharge fills up, whatever is missing; None where ``charge_w`` is given.
        charge_w: charging power.
        pad_height_m: height of the docks.
        dock_offsets_m: each dock relative to the body frame (x forward, y left).
    """

    id: str
    body: str
    start_m: Vec2 = (0.0, 0.0)
    yaw_rad: float = 0.0
    max_speed_mps: float = 6.0
    accel_mps2: float = 1.0
    tracking_noise_m: float = 0.05
    power_w: tuple[float, ...] = UGV_POWER_W
    idle_w: float = 0.0
    capacity_j: float = 36_810_000.0
    energy_j: float | None = None
    charge_s: float | None = 300.0
    charge_w: float | None = None
    pad_height_m: float = 0.5
    dock_offsets_m: tuple[Vec2, ...] = ((0.5, 0.0), (-0.5, 0.0))

    def __post_init__(self) -> None:
        owner = f"simulated ugv {self.id!r}"
        _numbers(
            owner,
            self,
            ("tracking_noise_m", "idle_w", "pad_height_m"),
            ("max_speed_mps", "accel_mps2", "capacity_j"),
        )
        _require(all(map(math.isfinite, self.start_m)), f"{owner}: start_m is {self.start_m!r}; give finite m")
        _require(
            self.energy_j is None or 0 <= self.energy_j <= self.capacity_j,
            f"{owner}: energy_j is {self.energy_j!r}; give J from 0 to the capacity {self.capacity_j:g}",
        )
        _require(
            (self.charge_s is None) != (self.charge_w is None),
            f"{owner}: give either charge_s or charge_w, not both and not neither",
        )
        if self.charge_s is not None:
            _numbers(owner, self, ("charge_s",), ())
        else:
            _numbers(owner, self, (), ("charge_w",))
        _power(owner, self.power_w)


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """The world; validates itself.

    Attributes:
        uavs, ugvs: the vehicles, at least one.
        scale: arena m per world m.
        time_scale: arena s per mission s.
        seed: of all noise.
        step_s: the physics' fixed step, a multiple of the loop's 0.02 s; 0.02 for a lab, 0.1 for kilometres.
        pose_rate_hz, pose_latency_s: of motion capture; what is seen changes at most once a step.
        pose_noise_m, pose_noise_rad: standard deviations per axis.
        occlusions_per_s, occlusion_s: how often a body is out of sight on average, and for about how long.
        telemetry_rate_hz, telemetry_latency_s, telemetry_drop: the last is the probability of losing a message.
        command_latency_s, command_drop: the same for commands.
        gust_mps: standard deviation of a slowly changing wind; only its head component is felt, as lost speed.
        dock_tolerance_m: largest misalignment at touch-down on a dock.
        dock_range_m: a docking further away than this aborts at once.
        dock_speed_mps: a UGV that moves faster than this cannot be docked on.
        collision_m: flying UAVs closer than this collide and fall.
        estimate_mps: how fast a UAV follows a false pose that it is fed.
        drift_after_s: without poses for this long a UAV's estimate begins to drift.
        link_timeout_s: how long after the link died the SDK notices.
        lost_land_s: a UAV that lost its link lands by itself after this time.
        auto_disarm_s: a UAV disarms itself this long after it came down; None: it stays armed.
        separation_h_m, separation_v_m: cylinder around a flying UAV that the audit watches (0: not watched).
        separation_ugv_m: least distance between two UGVs that the audit watches.
        fence_m: polygon that the audit watches; empty: not watched.
        ceiling_m: altitude that the audit watches.
    """

    uavs: tuple[SimUav, ...]
    ugvs: tuple[SimUgv, ...]
    scale: float = 1.0
    time_scale: float = 1.0
    seed: int = 0
    step_s: float = 0.1
    pose_rate_hz: float = 100.0
    pose_latency_s: float = 0.01
    pose_noise_m: float = 0.01
    pose_noise_rad: float = 0.01
    occlusions_per_s: float = 0.0
    occlusion_s: float = 0.2
    telemetry_rate_hz: float = 10.0
    telemetry_latency_s: float = 0.02
    telemetry_drop: float = 0.0
    command_latency_s: float = 0.02
    command_drop: float = 0.0
    gust_mps: float = 0.0
    dock_tolerance_m: float = 0.3
    dock_range_m: float = 5.0
    dock_speed_mps: float = 0.2
    collision_m: float = 0.5
    estimate_mps: float = 2.0
    drift_after_s: float = 2.0
    link_timeout_s: float = 2.0
    lost_land_s: float = 2.0
    auto_disarm_s: float | None = None
    separation_h_m: float = 0.0
    separation_v_m: float = 0.0
    separation_ugv_m: float = 0.0
    fence_m: tuple[Vec2, ...] = field(default=())
    ceiling_m: float = math.inf

    def __post_init__(self) -> None:
        not_negative = (
            "pose_latency_s pose_noise_m pose_noise_rad occlusions_per_s occlusion_s telemetry_latency_s "
            "telemetry_drop command_latency_s command_drop gust_mps dock_speed_mps collision_m drift_after_s "
            "link_timeout_s lost_land_s separation_h_m separation_v_m separation_ugv_m"
        )
        positive = "scale time_scale step_s pose_rate_hz telemetry_rate_hz dock_tolerance_m dock_range_m estimate_mps"
        _numbers("world", self, tuple(not_negative.split()), tuple(positive.split()))
        for name in ("telemetry_drop", "command_drop"):
            _require(getattr(self, name) <= 1, f"world: {name} is {getattr(self, name)}; a probability is at most 1")
        ticks = self.step_s / GRID_S
        _require(
            round(ticks) >= 1 and abs(ticks - round(ticks)) < 1e-6,
            f"world: step_s is {self.step_s}; give a multiple of {GRID_S} s",
        )
        _require(isinstance(self.seed, int) and self.seed >= 0, f"world: seed is {self.seed!r}; give 0, 1, 2, ...")
        _require(self.ceiling_m > 0, f"world: ceiling_m is {self.ceiling_m}; give m above 0")
        _require(
            len(self.fence_m) == 0 or len(self.fence_m) >= 3,
            f"world: fence_m has {len(self.fence_m)} corners; give at least 3, or none",
        )
        _require(len(self.vehicles) > 0, "world: there are no vehicles; give at least one")
        for what, names in (("id", [v.id for v in self.vehicles]), ("body", [v.body for v in self.vehicles])):
            twice = sorted({n for n in names if names.count(n) > 1})
            _require(not twice, f"world: {what} {', '.join(twice)} is given more than once; make it unique")
        self._check_docks()

    @property
    def vehicles(self) -> tuple[SimUav | SimUgv, ...]:
        """All vehicles in the order of their numbers: UAVs, then UGVs."""
        return (*self.uavs, *self.ugvs)

    def _check_docks(self) -> None:
        docks = {g.id: len(g.dock_offsets_m) for g in self.ugvs}
        taken: set[tuple[str, int]] = set()
        for uav in self.uavs:
            if uav.on is None:
                continue
            _require(
                0 <= uav.dock < docks.get(uav.on, 0),
                f"simulated uav {uav.id!r} starts on dock {uav.dock} of {uav.on!r}, which does not exist",
            )
            _require((uav.on, uav.dock) not in taken, f"simulated uav {uav.id!r}: its dock is taken by another")
            taken.add((uav.on, uav.dock))
