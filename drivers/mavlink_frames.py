"""The arena in MAVLink's words and back, all in one place: NED vectors, headings, latitude and longitude.

Indoors the vehicle's local frame is made by the poses it is fed: north is the arena's y, east its x, down its -z; a
heading of 0 looks along y. Outdoors the arena lies on the globe as its ``GeoFrame`` says. Heights: the arena's z is
0 on its floor, which is one height above sea level per vehicle, by that vehicle's own estimate (``floor_amsl_m``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.geodesy import GeoFrame
from drivers.vehicle import Vec3


def wrap(angle_rad: float) -> float:
    """The same angle in -pi..pi."""
    return math.atan2(math.sin(angle_rad), math.cos(angle_rad))


@dataclass(frozen=True)
class MavlinkFrame:
    """Conversions of one vehicle.

    Attributes:
        geo: the arena on the globe; None: local frame by motion capture.
        floor_amsl_m: of the arena's floor; outdoors only.
    """

    geo: GeoFrame | None = None
    floor_amsl_m: float = 0.0

    @property
    def rotation_rad(self) -> float:
        """From (x east, y north) to the arena, counter-clockwise."""
        return 0.0 if self.geo is None else self.geo.rotation_rad

    def to_ned(self, arena: Vec3) -> Vec3:
        """A vector of the arena as north, east, down; indoors a position, too."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        x, y, z = arena
        return (-s * x + c * y, c * x + s * y, -z)

    def from_ned(self, ned: Vec3) -> Vec3:
        """North, east, down as a vector of the arena."""
        c, s = math.cos(self.rotation_rad), math.sin(self.rotation_rad)
        north, east, down = ned
        return (c * east - s * north, s * east + c * north, -down)

    def to_heading(self, yaw_rad: float) -> float:
        """A yaw in the arena as clockwise from north, -pi..pi."""
        return wrap(0.5 * math.pi - (yaw_rad - self.rotation_rad))

    def from_heading(self, heading_rad: float) -> float:
        """Clockwise from north as a yaw in the arena, -pi..pi."""
        return wrap(0.5 * math.pi - heading_rad + self.rotation_rad)

    def to_global(self, arena_m: Vec3) -> tuple[int, int, float]:
        """A position as latitude and longitude in 1e-7 degrees and m above sea level; outdoors only."""
        assert self.geo is not None
        lat, lon = self.geo.to_globe((arena_m[0], arena_m[1]))
        return (round(lat * 1e7), round(lon * 1e7), arena_m[2] + self.floor_amsl_m)

    def from_global(self, lat_e7: int, lon_e7: int, amsl_mm: int) -> Vec3:
        """The numbers of GLOBAL_POSITION_INT as a position in the arena; outdoors only."""
        assert self.geo is not None
        x, y = self.geo.to_arena(lat_e7 * 1e-7, lon_e7 * 1e-7)
        return (x, y, amsl_mm * 1e-3 - self.floor_amsl_m)
