"""Who tells where the vehicles are: the ``localisation`` section of a mission, and its place on the globe."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from deploy.driver_options import MocapSection
from deploy.frames import Frame
from deploy.section import Section
from deploy.settings import Positive
from drivers.geodesy import GeoFrame


class Localisation(Section):
    """Who tells where the vehicles are; simulators bring their own and read only ``source``."""

    source: Literal["mocap", "vehicles"]
    """``mocap``: motion capture; ``vehicles``: each MAVLink vehicle by its own GPS, where the map is geographic."""
    mocap: MocapSection | None = None
    """The motion-capture system; wanted for ``source: mocap``."""
    connect_s: Positive = 30.0
    """So long vehicles and motion capture may take to connect and make ready, s."""

    @model_validator(mode="after")
    def _consistent(self) -> Localisation:
        if self.source == "mocap" and self.mocap is None:
            raise ValueError("source is mocap, but section mocap is missing; give its type and hostname")
        if self.source == "vehicles" and self.mocap is not None:
            raise ValueError("mocap is given, but source is vehicles; leave mocap out, or set source: mocap")
        return self


def geo_frame(frame: Frame, centre_deg: tuple[float, float] | None) -> GeoFrame:
    """The arena of an outdoor mission on the globe.

    Args:
        frame: from the map's metres to the arena.
        centre_deg: latitude and longitude around which the map was projected; None where it is not geographic.

    Raises:
        ValueError: when the map is not geographic, or the mission not flown at full size.
    """
    if centre_deg is None:
        raise ValueError(
            "source is vehicles (GPS), but the map is not in longitude and latitude; give a geographic map, or use "
            "source: mocap"
        )
    if frame.scale != 1.0:
        raise ValueError(
            f"source is vehicles (GPS), but arena.scale is {frame.scale:g}; GPS knows only full size: set it to 1"
        )
    lat, lon = centre_deg
    return GeoFrame(lat, lon, frame.rotation_rad, frame.origin_m)
