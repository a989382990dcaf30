"""What the planner sees: depot, tasks, path points, roads and the team, in the world frame and SI units.

Semantics: ``docs/planning.md``. File format: ``copcs-problem/1``.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError

FORMAT = "copcs-problem/1"
Waiting = Literal["landed", "hover"]
Point = tuple[float, float]

UAV_CAPACITY_J = 287_700.0
UGV_CAPACITY_J = 36_810_000.0


def uav_power_w(speed_mps: float) -> float:
    """Power of the paper's UAV in level flight at ``speed_mps``, in W; hovering is speed 0 (paper, section IV-A)."""
    return 0.0461 * speed_mps**3 - 0.5834 * speed_mps**2 - 1.8761 * speed_mps + 229.6


def ugv_power_w(speed_mps: float) -> float:
    """Power of the paper's UGV driving at ``speed_mps``, in W (paper, section IV-A)."""
    return 464.8 * speed_mps + 356.3


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise PlannerError(message)


def _check_numbers(owner: str, obj: object, at_least_zero: Sequence[str], above_zero: Sequence[str]) -> None:
    for name in at_least_zero:
        value = getattr(obj, name)
        if type(value) is float and 0.0 <= value < math.inf:
            continue  # vehicles are made anew at every review in flight: the usual case is judged at once
        _check_number(owner, name, value, above_zero=False)
    for name in above_zero:
        value = getattr(obj, name)
        if type(value) is float and 0.0 < value < math.inf:
            continue
        _check_number(owner, name, value, above_zero=True)


def _check_number(owner: str, name: str, value: object, *, above_zero: bool) -> None:
    if value is None:
        return
    if not isinstance(value, int | float) or isinstance(value, bool) or not math.isfinite(value):
        raise PlannerError(f"{owner}: {name} is {value!r}; give a finite number")
    if not (value > 0 if above_zero else value >= 0):
        raise PlannerError(f"{owner}: {name} is {value}; give a number {'above' if above_zero else 'of at least'} 0")


@dataclass(frozen=True, slots=True)
class Uav:
    """One UAV as the planner sees it.

    Attributes:
        id: unique name.
        position: where it is or, when ``ready_s`` > 0, will be then, (x, y) in m.
        energy_j: energy at ``ready_s``.
        capacity_j: energy when full; charging with constant ``charge_s`` ends there.
        reserve_j: energy that may never be used.
        speed_mps: cruise speed.
        cruise_w: power at cruise speed.
        hover_w: power at rest in the air.
        waiting: ``landed`` (waiting costs nothing) or ``hover`` (waiting costs ``hover_w``).
        service_s: hovering at each task.
        ready_s: busy until then, counted from the problem's time 0.
    """

    id: str
    position: Point
    energy_j: float = UAV_CAPACITY_J
    capacity_j: float = UAV_CAPACITY_J
    reserve_j: float = 0.0
    speed_mps: float = 10.0
    cruise_w: float = 198.599
    hover_w: float = 229.6
    waiting: Waiting = "landed"
    service_s: float = 0.0
    ready_s: float = 0.0

    def __post_init__(self) -> None:
        owner = f"uav {self.id!r}"
        _check_numbers(
            owner,
            self,
            ("energy_j", "reserve_j", "cruise_w", "hover_w", "service_s", "ready_s"),
            ("capacity_j", "speed_mps"),
        )
        _require(
            len(self.position) == 2 and all(math.isfinite(c) for c in self.position),
            f"{owner}: position is {self.position!r}; give two finite numbers",
        )
        _require(self.waiting in ("landed", "hover"), f"{owner}: waiting is {self.waiting!r}; give landed or hover")


@dataclass(frozen=True, slots=True)
class Ugv:
    """One UGV as the planner sees it.

    Attributes:
        id: unique name.
        path_point: index of the path point where it stands (at ``ready_s``); None is the depot.
        distance_to_m: road distance to each path point and, last, the depot, (P+1,); given when it is between path
            points, and then it must move before it can recharge anyone and ``path_point`` is ignored.
        position: where it is, (x, y) in m, when it is between path points (for pictures and the policy's graph).
        energy_j, capacity_j: own battery, from which driving, standing and the UAVs' recharges are taken.
        speed_mps, drive_w, idle_w: driving speed, power while driving, power while standing.
        charge_s: a recharge lasts that long and fills up; None where ``charge_w`` is given.
        charge_w: charging power, (capacity - energy) / charge_w is the duration.
        dock_s, undock_s: time to dock before and to leave after charging.
        docks: UAVs that can charge at once.
        ready_s: busy until then (its own last action, or UAVs on board that are still charging).
        dock_ready_s: when each dock is free, at most ``docks`` values; missing ones are free at 0.
    """

    id: str
    path_point: int | None = None
    energy_j: float = UGV_CAPACITY_J
    capacity_j: float = UGV_CAPACITY_J
    speed_mps: float = 4.5
    drive_w: float = 2447.9
    idle_w: float = 0.0
    charge_s: float | None = 300.0
    charge_w: float | None = None
    dock_s: float = 0.0
    undock_s: float = 0.0
    docks: int = 2
    ready_s: float = 0.0
    distance_to_m: tuple[float, ...] | None = None
    position: Point | None = None
    dock_ready_s: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        owner = f"ugv {self.id!r}"
        _check_numbers(
            owner,
            self,
            ("energy_j", "drive_w", "idle_w", "charge_s", "dock_s", "undock_s", "ready_s"),
            ("capacity_j", "speed_mps", "charge_w"),
        )
        _require(
            (self.charge_s is None) != (self.charge_w is None),
            f"{owner}: give either charge_s or charge_w, not both and not neither",
        )
        _require(isinstance(self.docks, int) and self.docks >= 1, f"{owner}: docks is {self.docks}; give at least 1")
        _require(len(self.dock_ready_s) <= self.docks, f"{owner}: dock_ready_s has more values than docks")


@dataclass(frozen=True, eq=False)
class Problem:
    """A joint planning problem; validates itself.

    Attributes:
        depot: (x, y) in m.
        tasks: (n_tasks, 2) in m.
        path_points: (P, 2) in m.
        road_distance_m: (P+1, P+1), symmetric, inf where no road leads; the last row and column are the depot.
        uavs, ugvs: the team, at least one UAV.
        visited: (n_tasks,) bool.

    Raises:
        PlannerError: on any inconsistency.
    """

    depot: Point
    tasks: NDArray[np.float64]
    path_points: NDArray[np.float64]
    road_distance_m: NDArray[np.float64]
    uavs: tuple[Uav, ...]
    ugvs: tuple[Ugv, ...]
    visited: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))

    def __post_init__(self) -> None:
        set_ = object.__setattr__
        try:
            tasks = np.array(self.tasks, dtype=np.float64).reshape(-1, 2)
            points = np.array(self.path_points, dtype=np.float64).reshape(-1, 2)
            roads = np.array(self.road_distance_m, dtype=np.float64)
            visited = np.array(self.visited, dtype=np.bool_).reshape(-1)
        except (TypeError, ValueError) as error:
            raise PlannerError(f"tasks, path_points, road_distance_m or visited has a wrong shape: {error}") from error
        if visited.size == 0:
            visited = np.zeros(len(tasks), dtype=np.bool_)
        for name, array in (
            ("tasks", tasks),
            ("path_points", points),
            ("road_distance_m", roads),
            ("visited", visited),
        ):
            array.setflags(write=False)
            set_(self, name, array)
        set_(self, "uavs", tuple(self.uavs))
        set_(self, "ugvs", tuple(self.ugvs))
        n = len(points) + 1
        _require(
            bool(np.isfinite(self.depot).all()) and len(self.depot) == 2,
            f"depot is {self.depot}; give two finite numbers",
        )
        _require(bool(np.isfinite(tasks).all()), "tasks: every coordinate must be finite")
        _require(bool(np.isfinite(points).all()), "path_points: every coordinate must be finite")
        _require(
            roads.shape == (n, n), f"road_distance_m has shape {roads.shape}; give ({n}, {n}): path points, then depot"
        )
        _require(
            not bool(np.isnan(roads).any()),
            "road_distance_m: not-a-number is not a distance; use inf where no road leads",
        )
        _require(bool((roads >= 0).all()), "road_distance_m: a distance is negative")
        _require(
            np.array_equal(roads, roads.T) or bool(np.allclose(roads, roads.T)), "road_distance_m is not symmetric"
        )
        _require(bool((np.diag(roads) == 0).all()), "road_distance_m: the diagonal must be 0")
        _require(visited.shape == (len(tasks),), f"visited has {visited.size} entries for {len(tasks)} tasks")
        _require(len(self.uavs) > 0, "uavs is empty; a mission needs at least one UAV")
        ids = [u.id for u in self.uavs] + [g.id for g in self.ugvs]
        _require(
            len(set(ids)) == len(ids), f"vehicle ids are not unique: {sorted(i for i in set(ids) if ids.count(i) > 1)}"
        )
        for g in self.ugvs:
            if g.distance_to_m is not None:
                _require(
                    len(g.distance_to_m) == n, f"ugv {g.id!r}: distance_to_m needs {n} values: path points, then depot"
                )
                _require(
                    all(d >= 0 for d in g.distance_to_m),
                    f"ugv {g.id!r}: distance_to_m has a negative value or not-a-number",
                )
            elif g.path_point is not None:
                _require(
                    0 <= g.path_point < n - 1,
                    f"ugv {g.id!r}: path_point {g.path_point} does not exist; there are {n - 1}",
                )

    @property
    def n_tasks(self) -> int:
        """Number of tasks, visited ones included."""
        return len(self.tasks)

    @property
    def depot_index(self) -> int:
        """Row of ``road_distance_m`` and of ``sites`` that is the depot."""
        return len(self.path_points)

    @cached_property
    def sites(self) -> NDArray[np.float64]:
        """Path points and, last, the depot, (P+1, 2) in m."""
        return np.vstack([self.path_points, np.array(self.depot, dtype=np.float64)])

    @cached_property
    def digest(self) -> str:
        """SHA-256 of the canonical JSON form; check results are bound to it."""
        return hashlib.sha256(json.dumps(self.to_json(), sort_keys=True).encode()).hexdigest()

    def to_json(self) -> dict[str, Any]:
        """The ``copcs-problem/1`` object."""
        roads = [[None if math.isinf(d) else d for d in row] for row in self.road_distance_m.tolist()]
        ugvs = [asdict(g) for g in self.ugvs]
        for g in ugvs:
            if g["distance_to_m"] is not None:
                g["distance_to_m"] = [None if math.isinf(d) else d for d in g["distance_to_m"]]
        return {
            "format": FORMAT,
            "depot": list(self.depot),
            "tasks": self.tasks.tolist(),
            "path_points": self.path_points.tolist(),
            "road_distance_m": roads,
            "uavs": [asdict(u) for u in self.uavs],
            "ugvs": ugvs,
            "visited": self.visited.tolist(),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> Problem:
        """Reads a ``copcs-problem/1`` object; optional members take the defaults of this file.

        Raises:
            PlannerError: naming the member that is wrong.
        """
        _require(isinstance(data, Mapping), "a problem file holds one JSON object")
        _require(data.get("format") == FORMAT, f"format is {data.get('format')!r}; this program reads {FORMAT!r}")
        known = {f.name for f in fields(cls)} | {"format"}
        _require(not set(data) - known, f"unknown members {sorted(set(data) - known)}; known are {sorted(known)}")
        for name in ("depot", "tasks", "path_points", "road_distance_m", "uavs"):
            _require(name in data, f"member {name!r} is missing")

        def distance(value: object) -> float:
            return math.inf if value is None else float(value)  # type: ignore[arg-type]

        try:
            return cls(
                depot=(float(data["depot"][0]), float(data["depot"][1])),
                tasks=data["tasks"],
                path_points=data["path_points"],
                road_distance_m=np.array([[distance(d) for d in row] for row in data["road_distance_m"]]),
                uavs=tuple(_vehicle(Uav, i, u) for i, u in enumerate(data["uavs"])),
                ugvs=tuple(_vehicle(Ugv, i, g) for i, g in enumerate(data.get("ugvs", []))),
                visited=data.get("visited", []),
            )
        except PlannerError:
            raise
        except (TypeError, ValueError, IndexError, KeyError) as error:
            raise PlannerError(f"a member has the wrong type: {error}") from error

    @classmethod
    def read(cls, path: Path) -> Problem:
        """Reads a problem file.

        Raises:
            PlannerError: when the file is missing, not JSON or wrong; the message names the file.
        """
        try:
            return cls.from_json(json.loads(path.read_text(encoding="utf-8")))
        except OSError as error:
            raise PlannerError(f"{path}: {error.strerror}") from error
        except (json.JSONDecodeError, UnicodeDecodeError, RecursionError) as error:
            raise PlannerError(f"{path}: not a JSON file: {error}") from error
        except PlannerError as error:
            raise PlannerError(f"{path}: {error}") from error


def _vehicle(kind: type[Any], index: int, data: Mapping[str, Any]) -> Any:
    name = f"{kind.__name__.lower()}s[{index}]"
    _require(isinstance(data, Mapping), f"{name} is not an object")
    known = {f.name for f in fields(kind)}
    _require(not set(data) - known, f"{name}: unknown members {sorted(set(data) - known)}; known are {sorted(known)}")
    values: dict[str, Any] = dict(data)
    values.setdefault("id", f"{kind.__name__.lower()}{index}")
    if kind is Ugv and values.get("charge_w") is not None:
        values.setdefault("charge_s", None)
    for key in ("position", "distance_to_m", "dock_ready_s"):
        if values.get(key) is not None:
            values[key] = tuple(math.inf if d is None else float(d) for d in values[key])
    _require(kind is Ugv or "position" in values, f"{name}: position is missing")
    return kind(**values)
