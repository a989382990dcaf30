"""Maps: what UGVs may drive on, and what a person wants to see around it. Two kinds of file, one result."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from planner.roads import Roads

Array = NDArray[np.float64]
Bounds = tuple[float, float, float, float]
Project = Callable[[Array], Array]
Region = BaseGeometry


class Ways(Roads, Protocol):
    """Roads whose sites can be chosen."""

    def with_sites(self, sites: Array) -> Ways:
        """The same roads with other sites, (P+1, 2) in m."""
        ...

    def places(self, spacing_m: float) -> Array:
        """Where path points may be placed, (n, 2) in m, about ``spacing_m`` apart."""
        ...


@dataclass(frozen=True, eq=False)
class Area:
    """A polygon for pictures, world m.

    Attributes:
        kind: ``water``, ``building``, ``block``, ``wood``, ``field``, or what else the map says.
        outline: (n, 2), closed.
        holes: each (n, 2), closed.
    """

    kind: str
    outline: Array
    holes: tuple[Array, ...] = ()


@dataclass(frozen=True, eq=False)
class MapImage:
    """An occupancy map's picture.

    Attributes:
        pixels: (rows, columns) of grey values, the first row at the top (greatest y).
        resolution_m: side of a pixel, world m.
        origin: (x, y, yaw) of the lower left corner, world m and rad.
    """

    pixels: NDArray[np.uint8]
    resolution_m: float
    origin: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class MapGeometry:
    """What to draw, world frame in m.

    Attributes:
        bounds: (least x, least y, greatest x, greatest y); tasks lie within.
        roads: polylines, each (n, 2).
        lines: other polylines with their kind (``stream``).
        areas: polygons, in drawing order.
        image: of an occupancy map.
    """

    bounds: Bounds
    roads: tuple[Array, ...] = ()
    lines: tuple[tuple[str, Array], ...] = ()
    areas: tuple[Area, ...] = ()
    image: MapImage | None = None


@dataclass(frozen=True, slots=True)
class Source:
    """A file that the mission was made from.

    Attributes:
        role: ``mission``, ``fleet``, ``map``, ``image``, ``tasks`` or ``path_points``.
        path: where it was read from.
        raw: its bytes then.
    """

    role: str
    path: Path
    raw: bytes = field(repr=False)


@dataclass(frozen=True, eq=False)
class LoadedMap:
    """A map as loaded.

    Attributes:
        geometry: for pictures.
        make_ways: the roads with given sites, (P+1, 2) in world m.
        project: longitude and latitude in degrees (n, 2) to world m; None where the map is not geographic.
        sources: the files read.
        data: the map_server file's keys, for copying; None for GeoJSON.
        centre_deg: latitude and longitude around which ``project`` projects; None without it.
    """

    geometry: MapGeometry
    make_ways: Callable[[Array], Ways]
    project: Project | None
    sources: tuple[Source, ...]
    data: dict[str, Any] | None = None
    centre_deg: tuple[float, float] | None = None
