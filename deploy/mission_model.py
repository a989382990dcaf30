"""The keys of ``mission.yaml``; every default is written here or in ``deploy.settings``, once."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from annotated_types import Ge, Le
from pydantic import BaseModel, Discriminator, Field, Tag, field_validator, model_validator

from deploy.check_limits import CheckLimits
from deploy.events import Action, EventKind
from deploy.failsafe import override_problem
from deploy.localisation import Localisation
from deploy.section import Section
from deploy.settings import Monitors, NotNegative, Positive, Replanning, Separation
from planner.solve import DEFAULT_METHOD, METHODS
from sim_backends.faults import Fault

Count = Annotated[int, Ge(1), Le(10_000)]
Seed = Annotated[int, Ge(0), Le(2**32 - 1)]
XY = tuple[float, float]


class LonLat(Section):
    """A geographic point (WGS 84)."""

    lon: Annotated[float, Ge(-180), Le(180)]
    """Longitude in degrees, east positive."""
    lat: Annotated[float, Ge(-90), Le(90)]
    """Latitude in degrees, north positive."""


def _point_kind(value: Any) -> str:
    return "lonlat" if isinstance(value, dict | LonLat) else "xy"


Place = Annotated[Annotated[XY, Tag("xy")] | Annotated[LonLat, Tag("lonlat")], Discriminator(_point_kind)]
"""``[x, y]`` in world m, or ``{lon: .., lat: ..}`` in degrees where the map is geographic."""


class MapSection(Section):
    """What UGVs may drive on, and what is drawn."""

    file: str
    """GeoJSON road network (``.geojson``, ``.json``) or ROS map_server file (``.yaml``), relative to this file."""
    coordinates: Literal["auto", "lonlat", "metric"] = "auto"
    """Of a GeoJSON: degrees or metres; ``auto`` asks the file (``"copcs_units": "m"`` or a ``crs``), else degrees."""
    max_offset_m: Positive = 50.0
    """Depot and path points are moved onto the road; further away than this (world m) is an error."""
    clearance_m: NotNegative = 1.0
    """Of an occupancy map: least distance of a UGV's centre from obstacles, world m."""
    unknown: Literal["blocked", "free"] = "blocked"
    """Of an occupancy map: whether a UGV may drive where the map does not know."""


class PathPoints(Section):
    """Where UGVs may stop and charge: exactly one of ``points``, ``file`` and ``place``."""

    points: tuple[Place, ...] | None = Field(default=None, min_length=1, max_length=500)
    """Given one by one."""
    file: str | None = None
    """CSV (columns x, y or lon, lat) or GeoJSON points, relative to this file."""
    place: Annotated[int, Ge(1), Le(200)] | None = None
    """How many the program places along the roads: central and well spread, always the same ones."""

    @model_validator(mode="after")
    def _one_source(self) -> PathPoints:
        _exactly_one(self, "points", "file", "place")
        return self


class RandomTasks(Section):
    """Tasks drawn uniformly from the map."""

    count: Count
    """How many."""
    seed: Seed | None = None
    """Default: the mission's seed."""


class Tasks(Section):
    """What is to be visited: exactly one of ``points``, ``file`` and ``random``."""

    points: tuple[Place, ...] | None = Field(default=None, min_length=1, max_length=10_000)
    """Given one by one."""
    file: str | None = None
    """CSV (columns x, y or lon, lat and, if wanted, id) or GeoJSON points, relative to this file."""
    random: RandomTasks | None = None
    """Drawn by the program."""
    max_distance_m: Positive | None = None
    """A task further than this (world m) from every path point and the depot is an error; none is drawn there."""

    @model_validator(mode="after")
    def _one_source(self) -> Tasks:
        _exactly_one(self, "points", "file", "random")
        return self


def _exactly_one(section: BaseModel, *names: str) -> None:
    given = [name for name in names if getattr(section, name) is not None]
    if len(given) != 1:
        raise ValueError(f"exactly one of {', '.join(names)} is wanted, given: {', '.join(given) or 'none'}")


class Layers(Section):
    """Cruise altitudes: UAV 0 flies in the lowest layer, each further UAV one higher, and again from below."""

    lowest_m: Positive = 30.0
    """Altitude of the lowest layer, arena m."""
    spacing_m: Positive | None = None
    """Between layers, arena m; default: separation.vertical_m + separation.buffer_m, and never less."""


class Arena(Section):
    """Where it is flown, and how the world is shrunk into it."""

    scale: Positive = 1.0
    """Arena metres per world metre."""
    rotation_deg: float = 0.0
    """From world to arena, counter-clockwise, degrees."""
    origin_m: XY = (0.0, 0.0)
    """Where the world's origin lies in the arena, arena m."""
    time_scale: Positive = 1.0
    """Arena seconds per mission second."""
    geofence_m: tuple[XY, ...] | None = Field(default=None, min_length=3, max_length=1000)
    """Vertices of a simple polygon, arena m; default: the map's bounds and ``fence_margin_m`` around them."""
    fence_margin_m: NotNegative = 100.0
    """Of the default geofence, arena m."""
    ceiling_m: Positive = 120.0
    """Highest altitude, arena m."""
    soft_margin_m: NotNegative = 10.0
    """This close to the geofence or the ceiling is a warning, arena m."""
    layers: Layers = Layers()
    """Cruise altitudes."""
    pad_spacing_m: Positive | None = None
    """Between landing places of UAVs at a site, arena m; default and least: separation.horizontal_m + buffer_m."""
    parking_spacing_m: Positive | None = None
    """Between stopping places of UGVs at a site, arena m; default and least: separation.ugv_m."""


class Energy(Section):
    """Where the energies that the supervisor watches come from."""

    uavs: Literal["virtual", "measured"] = "measured"
    """``measured`` by the battery, or ``virtual``: by the planner's model (a small vehicle plays a large one)."""
    ugvs: Literal["virtual", "measured"] = "measured"
    """Likewise."""


class ReplanBudget(Section):
    """What one replan in flight may take."""

    time_s: Positive | None = 1.0
    """Wall-clock time, s."""
    iterations: Annotated[int, Ge(1)] | None = None
    """Iterations instead of or beside ``time_s``: makes simulated runs repeatable on any machine."""


class Planner(Section):
    """Who plans, and for how long."""

    method: str = Field(default=DEFAULT_METHOD, min_length=1)
    """Name of the method."""
    time_s: Positive | None = 5.0
    """Wall-clock time for the first plan, s."""
    iterations: Annotated[int, Ge(1)] | None = None
    """Iterations instead of or beside ``time_s``, whichever is first."""
    seed: Seed | None = None
    """Default: the mission's seed."""
    options: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """The method's own."""
    replan: ReplanBudget = ReplanBudget()
    """Budget in flight."""

    @field_validator("method")
    @classmethod
    def _known_method(cls, method: str) -> str:
        if method not in METHODS:
            hint = suggestion(method, set(METHODS)) or f"; choose one of {', '.join(METHODS)}"
            raise ValueError(f"{method!r} is no planning method{hint}")
        return method

    @model_validator(mode="after")
    def _budget(self) -> Planner:
        for name, budget in (("", self), ("replan.", self.replan)):
            if budget.time_s is None and budget.iterations is None:
                raise ValueError(f"{name}time_s and {name}iterations are both null, so planning would never end")
        return self


class RandomFaults(Section):
    """Faults drawn by the simulator."""

    count: Count
    """How many."""
    seed: Seed
    """Of the draw."""


class FleetSection(Section):
    """The fleet: ``file`` or the fleet itself. Values go vehicle -> type -> all; the first that is given counts."""

    file: str | None = None
    """A fleet file, relative to this file."""
    all: dict[str, Any] = Field(default_factory=dict)
    """Defaults for every vehicle that knows the key."""
    types: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Defaults by type."""
    vehicles: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """The vehicles by id, in order of priority."""


def _names() -> str:
    return ", ".join(action.name.lower() for action in Action)


class MissionConfig(Section):
    """A mission."""

    version: Literal[1]
    """Of this format."""
    name: str = Field(default="mission", min_length=1, max_length=80, pattern=r"^[^\x00-\x1f/\\]+$")
    """For reports and run folders."""
    seed: Seed = 1
    """Of everything random that names no seed of its own."""
    map: MapSection
    """The map file and how to read it."""
    depot: Place
    """Where all vehicles start and end."""
    path_points: PathPoints
    """Where UGVs may stop and charge."""
    tasks: Tasks
    """What is to be visited."""
    fleet: FleetSection
    """The vehicles."""
    arena: Arena = Arena()
    """Where it is flown."""
    localisation: Localisation | None = None
    """Who tells where the vehicles are; simulators can do without."""
    energy: Energy = Energy()
    """Where energies come from."""
    planner: Planner = Planner()
    """Who plans."""
    separation: Separation = Separation()
    """Least distances between vehicles."""
    monitors: Monitors = Monitors()
    """Thresholds."""
    replanning: Replanning = Replanning()
    """When to plan anew in flight."""
    failsafe: dict[str, str] = Field(default_factory=dict)
    """Overrides of the failsafe table: ``event`` or ``event/situation`` to action."""
    checks: CheckLimits = CheckLimits()
    """What a plan must hold."""
    faults: tuple[Fault, ...] = Field(default=(), max_length=1000)
    """Scripted faults; simulators only."""
    random_faults: RandomFaults | None = None
    """Faults drawn by the simulator."""

    @field_validator("failsafe")
    @classmethod
    def _known_events(cls, table: dict[str, str]) -> dict[str, str]:
        events = {str(kind) for kind in EventKind}
        for row, action in table.items():
            event = row.partition("/")[0]
            if event not in events:
                raise ValueError(f"{row!r} is no event{suggestion(event, events)}; give `event` or `event/situation`")
            if action not in {a.name.lower() for a in Action}:
                raise ValueError(f"{action!r} (for {row!r}) is no action; choose one of {_names()}")
            wrong = override_problem(row, action)
            if wrong is not None:
                raise ValueError(wrong)
        return table


def suggestion(word: str, known: set[str]) -> str:
    """``, did you mean 'x'?`` where one of ``known`` is close to ``word``, else nothing."""
    import difflib  # noqa: PLC0415  only on errors

    close = difflib.get_close_matches(word, sorted(known), n=1, cutoff=0.6)
    return f", did you mean {close[0]!r}?" if close else ""
