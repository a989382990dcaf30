"""The vehicles of a mission: vehicle -> type -> all, validated one by one."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le
from pydantic import Field, model_validator

from deploy.driver_options import CrazyflieSection, DriverOptions, LimoSection, MavlinkSection
from deploy.errors import InputError
from deploy.mission_errors import validate
from deploy.mission_model import XY, FleetSection, suggestion
from deploy.section import Section
from deploy.settings import NotNegative, Positive
from deploy.yaml_file import Document, KeyPath
from planner.problem import UAV_CAPACITY_J, UGV_CAPACITY_J, uav_power_w, ugv_power_w

Driver = Literal["crazyflie", "limo", "mavlink"]
DRIVERS: tuple[Driver, ...] = ("crazyflie", "limo", "mavlink")
_ENDPOINTS: dict[str, tuple[str, str]] = {
    "crazyflie": (
        r"radio://\d+/\d{1,3}/(250K|1M|2M)(/[0-9A-Fa-f]{10})?|udp://[^\s/:]+:\d{1,5}|usb://\d+",
        "radio://0/80/2M/E7E7E7E701 or udp://127.0.0.1:19850",
    ),
    "limo": (r"(/[A-Za-z][A-Za-z0-9_]*)+|/", "the ROS namespace, /limo0, or / for none"),
    "mavlink": (
        r"(udpin|udpout|tcp):[^\s:]+:\d{1,5}|/dev/\S+",
        "udpin:0.0.0.0:14540, udpout:192.168.1.7:14550, tcp:HOST:PORT or /dev/ttyUSB0",
    ),
}


class _Vehicle(Section):
    kind: Literal["uav", "ugv"]
    """UAV or UGV."""
    body: str | None = Field(default=None, min_length=1)
    """Its name in motion capture; default: its id."""
    driver: Driver | None = None
    """Which driver flies the real one; simulators need none."""
    endpoint: str | None = None
    """Crazyflie: radio URI; Limo: ROS namespace; MAVLink: connection string."""
    sysid: Annotated[int, Ge(1), Le(250)] | None = None
    """MAVLink system id of the vehicle."""
    mavlink: MavlinkSection | None = None
    """Options of driver mavlink."""
    speed_mps: Positive
    """Cruise speed in the world, m/s."""
    capacity_j: Positive
    """Energy when full, world J."""
    energy_j: Positive | None = None
    """Energy at the start, world J; default: full."""
    max_speed_mps: Positive | None = None
    """What the gate lets pass, arena m/s; default: 1.5 times the cruise speed there."""
    accel_mps2: Positive
    """Of starts and stops, arena m/s^2."""

    @property
    def options(self) -> DriverOptions | None:
        """What the file says about its driver."""
        found: DriverOptions | None = getattr(self, self.driver, None) if self.driver is not None else None
        return found

    @model_validator(mode="after")
    def _consistent(self) -> _Vehicle:
        if self.energy_j is not None and self.energy_j > self.capacity_j:
            raise ValueError(
                f"energy_j ({self.energy_j:g}) is above capacity_j ({self.capacity_j:g}); give at most that"
            )
        if self.endpoint is not None:
            if self.driver is None:
                raise ValueError(f"endpoint {self.endpoint!r} is given without driver; give crazyflie, limo or mavlink")
            pattern, example = _ENDPOINTS[self.driver]
            if not re.fullmatch(pattern, self.endpoint):
                raise ValueError(f"endpoint {self.endpoint!r} is none of a {self.driver}; write e.g. {example}")
        if self.sysid is not None and self.driver != "mavlink":
            raise ValueError(f"sysid ({self.sysid}) is only for driver mavlink; leave it out")
        if self.driver == "mavlink" and self.endpoint is not None and self.sysid is None:
            raise ValueError(f"sysid is missing for the MAVLink vehicle at {self.endpoint!r}; give its system id")
        for driver in DRIVERS:
            if getattr(self, driver, None) is not None and self.driver != driver:
                what = "there is no driver" if self.driver is None else f"driver is {self.driver}"
                raise ValueError(f"{driver} holds options of driver {driver}, but {what}; leave it out")
        return self


class UavConfig(_Vehicle):
    """One UAV. The world's values describe the aircraft that is played, the arena's the one that flies."""

    kind: Literal["uav"]
    """UAV."""
    crazyflie: CrazyflieSection | None = None
    """Options of driver crazyflie."""
    speed_mps: Positive = 10.0
    """Cruise speed in the world, m/s."""
    capacity_j: Positive = UAV_CAPACITY_J
    """Energy when full, world J."""
    reserve_fraction: Annotated[float, Ge(0), Le(0.9)] = 0.15
    """Share of capacity that may never be used."""
    power_w: tuple[float, ...] | None = Field(default=None, min_length=1, max_length=6)
    """Power in level flight over speed (world): coefficients, highest power first, W; default: the paper's cubic."""
    cruise_w: Positive | None = None
    """Power at cruise speed, W; default: from ``power_w``."""
    hover_w: Positive | None = None
    """Power at rest in the air, W; default: from ``power_w``."""
    waiting: Literal["hover", "landed"] = "hover"
    """How it waits for a UGV."""
    service_s: NotNegative = 0.0
    """Hovering at each task, mission s."""
    accel_mps2: Positive = 2.5
    """Of rest-to-rest flights, arena m/s^2."""
    climb_mps: Positive = 3.0
    """Climbing, arena m/s."""
    descent_mps: Positive = 2.0
    """Descending, arena m/s."""

    def power_at(self, speed_mps: float) -> float:
        """Power in W at a speed of the world."""
        if self.power_w is None:
            return uav_power_w(speed_mps)
        return sum(c * speed_mps**n for n, c in enumerate(reversed(self.power_w)))

    @property
    def cruise_power_w(self) -> float:
        """Power at cruise speed, W."""
        return self.cruise_w if self.cruise_w is not None else self.power_at(self.speed_mps)

    @property
    def hover_power_w(self) -> float:
        """Power at rest in the air, W."""
        return self.hover_w if self.hover_w is not None else self.power_at(0.0)

    @model_validator(mode="after")
    def _powers(self) -> UavConfig:
        for name, watts in (("cruise", self.cruise_power_w), ("hover", self.hover_power_w)):
            if not 0 < watts < 1e9:
                raise ValueError(
                    f"the power model gives {watts:g} W at {name}; give power_w for this speed, or {name}_w"
                )
        return self


class UgvConfig(_Vehicle):
    """One UGV."""

    kind: Literal["ugv"]
    """UGV."""
    limo: LimoSection | None = None
    """Options of driver limo."""
    speed_mps: Positive = 4.5
    """Driving speed in the world, m/s."""
    capacity_j: Positive = UGV_CAPACITY_J
    """Energy when full, world J."""
    power_w: tuple[float, ...] | None = Field(default=None, min_length=1, max_length=6)
    """Driving power over speed in the world: coefficients, highest power first, W; default: the paper's."""
    drive_w: Positive | None = None
    """Driving power at ``speed_mps``, W; default: from ``power_w``."""
    idle_w: NotNegative = 0.0
    """Power while standing, W."""
    charge_s: Positive | None = None
    """A recharge lasts this long and fills up, mission s; default 300 where ``charge_w`` is not given."""
    charge_w: Positive | None = None
    """Charging power, world W; instead of ``charge_s``."""
    dock_s: NotNegative | None = None
    """From arrival above the UGV to charging, mission s; default: computed from descent and braking."""
    undock_s: NotNegative | None = None
    """From the end of charging to departure at altitude, mission s; default: computed from the climb."""
    accel_mps2: Positive = 1.0
    """Of starts and stops, arena m/s^2."""
    lane_offset_m: NotNegative | None = None
    """Keeps this far right of the road's centre line, arena m; default: 0.6 separation.ugv_m, 0 on occupancy maps."""
    pad_height_m: NotNegative = 0.5
    """Height of the charging docks, arena m."""
    docks: Annotated[int, Ge(1), Le(16)] = 2
    """UAVs that can charge at once."""
    dock_spacing_m: Positive = 1.0
    """Between docks, in a row along the UGV, arena m."""
    dock_tolerance_m: Positive | None = None
    """Largest misalignment of a UAV on a dock, arena m; default: a tenth of separation.horizontal_m, at most 0.3."""
    dock_offsets_m: tuple[XY, ...] | None = None
    """Each dock relative to the UGV (x forward, y left), arena m; default: a row."""

    @model_validator(mode="after")
    def _charging(self) -> UgvConfig:
        if self.charge_s is not None and self.charge_w is not None:
            raise ValueError(f"charge_s ({self.charge_s:g}) and charge_w ({self.charge_w:g}) are both given; keep one")
        if self.dock_offsets_m is not None and len(self.dock_offsets_m) != self.docks:
            raise ValueError(
                f"dock_offsets_m has {len(self.dock_offsets_m)} entries for docks: {self.docks}; give one each"
            )
        watts = self.drive_power_w
        if not 0 < watts < 1e9:
            raise ValueError(f"the power model gives {watts:g} W at speed_mps; give power_w for this speed, or drive_w")
        return self

    @property
    def drive_power_w(self) -> float:
        """Driving power, W."""
        if self.drive_w is not None:
            return self.drive_w
        if self.power_w is None:
            return ugv_power_w(self.speed_mps)
        return sum(c * self.speed_mps**n for n, c in enumerate(reversed(self.power_w)))

    @property
    def offsets_m(self) -> tuple[XY, ...]:
        """Each dock relative to the UGV."""
        if self.dock_offsets_m is not None:
            return self.dock_offsets_m
        middle = (self.docks - 1) / 2
        return tuple(((i - middle) * self.dock_spacing_m, 0.0) for i in range(self.docks))


Vehicles = dict[str, UavConfig | UgvConfig]


@dataclass(frozen=True, eq=False)
class Fleet:
    """The vehicles by id, in order, and where each of their keys stands.

    Attributes:
        vehicles: merged and validated.
        document: the fleet file, or the mission where the fleet stands in it.
        levels: of each vehicle, the mappings that it was merged from and where they stand, first counts.
    """

    vehicles: Vehicles
    document: Document
    levels: dict[str, list[tuple[dict[str, Any], KeyPath]]]

    def error(self, vehicle: str, key: str, what: str) -> InputError:
        """An error at the place where ``key`` of ``vehicle`` was given."""
        return self.document.error(what, _origin(self.levels[vehicle], (key,)))

    @property
    def uavs(self) -> dict[str, UavConfig]:
        """UAVs by id."""
        return {name: v for name, v in self.vehicles.items() if isinstance(v, UavConfig)}

    @property
    def ugvs(self) -> dict[str, UgvConfig]:
        """UGVs by id."""
        return {name: v for name, v in self.vehicles.items() if isinstance(v, UgvConfig)}


def _origin(levels: list[tuple[dict[str, Any], KeyPath]], key: KeyPath) -> KeyPath:
    for values, place in levels:
        if key and key[0] in values:
            return (*place, *key)
    return (*levels[0][1], *key)


_KEYS = {
    "uav": set(UavConfig.model_fields) - {"kind"},
    "ugv": set(UgvConfig.model_fields) - {"kind"},
}


def fleet_of(fleet: FleetSection, document: Document, at: KeyPath) -> Fleet:
    """Merges and validates the vehicles of ``fleet``, which stands at key ``at`` of ``document``, in order.

    Raises:
        InputError: naming the file, the key where the wrong value really stands, and the remedy.
    """
    if not fleet.vehicles:
        raise document.error("the fleet has no vehicles; add at least one UAV under `vehicles`", (*at, "vehicles"))
    everything = _KEYS["uav"] | _KEYS["ugv"]
    for key in fleet.all:
        if key not in everything:
            raise document.error(f"unknown key {key!r}{suggestion(key, everything)}; remove it", (*at, "all", key))
    for name in fleet.types:
        kind = _kind(fleet.types[name], document, (*at, "types", name))
        for key in set(fleet.types[name]) - _KEYS[kind] - {"kind"}:
            what = f"unknown key {key!r}{suggestion(key, _KEYS[kind])}; correct or remove it"
            raise document.error(what, (*at, "types", name, key))
    vehicles: Vehicles = {}
    levels: dict[str, list[tuple[dict[str, Any], KeyPath]]] = {}
    for vehicle, own in fleet.vehicles.items():
        here: KeyPath = (*at, "vehicles", vehicle)
        if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,39}", vehicle):
            raise document.error(f"{vehicle!r} is no id; use up to 40 letters, digits, - _ .", here)
        type_name = own.get("type")
        if not isinstance(type_name, str) or type_name not in fleet.types:
            known = set(fleet.types)
            hint = suggestion(str(type_name), known) or f"; known are {', '.join(sorted(known)) or 'none'}"
            raise document.error(f"type is {type_name!r}, which `types` does not hold{hint}", (*here, "type"))
        common = fleet.types[type_name]
        kind = _kind(common, document, (*at, "types", type_name))
        if own.get("kind", kind) != kind:
            what = f"kind is {own['kind']!r}, but type {type_name!r} is a {kind}; leave it out"
            raise document.error(what, (*here, "kind"))
        shared = {key: value for key, value in fleet.all.items() if key in _KEYS[kind]}
        merged = {**shared, **common, **{k: v for k, v in own.items() if k != "type"}, "kind": kind}
        levels[vehicle] = [(own, here), (common, (*at, "types", type_name)), (shared, (*at, "all"))]
        model: type[UavConfig | UgvConfig] = UavConfig if kind == "uav" else UgvConfig
        vehicles[vehicle] = validate(model, merged, document, partial(_origin, levels[vehicle]))
    _unique(vehicles, document, at)
    return Fleet(vehicles, document, levels)


def _kind(values: dict[str, Any], document: Document, at: KeyPath) -> Literal["uav", "ugv"]:
    kind = values.get("kind")
    if kind == "uav":
        return "uav"
    if kind == "ugv":
        return "ugv"
    if "kind" not in values:
        raise document.error("kind is missing; give uav or ugv", (*at, "kind"))
    raise document.error(f"kind is {kind!r}; give uav or ugv", (*at, "kind"))


def _unique(vehicles: Vehicles, document: Document, at: KeyPath) -> None:
    if not any(v.kind == "uav" for v in vehicles.values()):
        raise document.error(
            f"the fleet ({', '.join(vehicles)}) has no UAV; a mission needs at least one", (*at, "vehicles")
        )
    seen: dict[tuple[str, object], str] = {}
    for vehicle, config in vehicles.items():
        values: list[tuple[str, object]] = [("body", config.body or vehicle)]
        if config.endpoint is not None:
            # One MAVLink connection may carry several vehicles, which their system ids tell apart; one ROS name may
            # exist in several domains.
            domain = config.limo.domain if isinstance(config, UgvConfig) and config.limo is not None else None
            values.append(("endpoint", (config.endpoint, config.sysid, domain)))
        for name, value in values:
            if (name, value) in seen:
                shown = value if name == "body" else config.endpoint
                raise document.error(
                    f"{name} {shown!r} is also that of {seen[name, value]!r}; give each vehicle its own",
                    (*at, "vehicles", vehicle, name),
                )
            seen[name, value] = vehicle
