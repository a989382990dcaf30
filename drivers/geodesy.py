"""The arena of an outdoor mission on the globe: longitude and latitude to metres and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from drivers.vehicle import Vec2

if TYPE_CHECKING:
    from pyproj import Transformer


@dataclass(frozen=True)
class GeoFrame:
    """An azimuthal equidistant plane around a point, turned into the arena.

    Attributes:
        lat_deg, lon_deg: where the plane's origin lies, WGS 84.
        rotation_rad: from the plane (x east, y north) to the arena, counter-clockwise.
        origin_m: where the plane's origin lies in the arena.
    """

    lat_deg: float
    lon_deg: float
    rotation_rad: float = 0.0
    origin_m: Vec2 = (0.0, 0.0)

    @cached_property
    def _transformer(self) -> Transformer:
        from pyproj import Transformer  # noqa: PLC0415  0.3 s that indoor missions need not wait for

        plane = f"+proj=aeqd +lat_0={self.lat_deg!r} +lon_0={self.lon_deg!r} +datum=WGS84 +units=m"
        return Transformer.from_crs("EPSG:4326", plane, always_xy=True)

    def to_arena(self, lat_deg: float, lon_deg: float) -> Vec2:
        """A point of the globe in the arena, m."""
        east, north = self._transformer.transform(lon_deg, lat_deg)
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        return (self.origin_m[0] + c * east - s * north, self.origin_m[1] + s * east + c * north)

    def to_globe(self, arena_m: Vec2) -> tuple[float, float]:
        """A point of the arena as (latitude, longitude) in degrees."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        x, y = arena_m[0] - self.origin_m[0], arena_m[1] - self.origin_m[1]
        lon, lat = self._transformer.transform(c * x + s * y, -s * x + c * y, direction="INVERSE")
        return (lat, lon)
