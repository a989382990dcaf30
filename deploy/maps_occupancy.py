"""ROS map_server files: ``map.yaml`` and the picture it names."""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray
from PIL import Image
from pydantic import Field, model_validator

from deploy.errors import InputError
from deploy.maps import Array, LoadedMap, MapGeometry, MapImage, Source, Ways
from deploy.mission_errors import validate
from deploy.section import Section
from deploy.settings import Fraction, Positive
from deploy.yaml_file import Document, read_bytes, read_yaml
from planner.occupancy import OccupancyRoads
from planner.roads import RoadError

MAX_BYTES = 50_000_000
MAX_PIXELS = 4_000_000


class MapServerFile(Section):
    """Keys of a map_server file (ROS 2 ``nav2_map_server``)."""

    image: str = Field(min_length=1)
    """Picture, relative to this file."""
    resolution: Positive
    """Side of a pixel, m."""
    origin: tuple[float, float, float]
    """Lower left corner: x, y in m, yaw in rad."""
    negate: Annotated[int, Ge(0), Le(1)] | bool = 0
    """1: white is occupied."""
    occupied_thresh: Fraction = 0.65
    """Darker than this is occupied."""
    free_thresh: Fraction = 0.25
    """Lighter than this is free; between is unknown."""
    mode: Literal["trinary"] = "trinary"
    """How to read the picture."""

    @model_validator(mode="after")
    def _ordered(self) -> MapServerFile:
        if self.free_thresh >= self.occupied_thresh:
            raise ValueError(
                f"free_thresh ({self.free_thresh:g}) is not below occupied_thresh ({self.occupied_thresh:g})"
            )
        if max(abs(c) for c in self.origin) > 1e9:
            raise ValueError(f"origin {list(self.origin)} is beyond 1e9 m; give map coordinates")
        return self


def load_occupancy_map(path: Path, clearance_m: float, unknown: str) -> LoadedMap:
    """An occupancy map on which UGVs with ``clearance_m`` drive wherever they fit.

    Raises:
        InputError: naming the file, the key, the value and the remedy.
    """
    document = read_yaml(path, "map")
    config = validate(MapServerFile, document.data, document)
    image_path = path.parent / config.image
    raw = _read_image_bytes(image_path, document)
    pixels = _pixels(raw, image_path)
    # Occupancy as map_server computes it: black is 1 unless negated.
    occupied = pixels / 255.0 if config.negate else (255 - pixels.astype(np.int16)) / 255.0
    blocked = occupied > (config.occupied_thresh if unknown == "free" else config.free_thresh)
    free: NDArray[np.bool_] = np.ascontiguousarray(~blocked[::-1])
    image = MapImage(pixels, config.resolution, config.origin)

    def make_ways(sites: Array) -> Ways:
        try:
            return OccupancyRoads(free, config.resolution, config.origin, sites, clearance_m)
        except RoadError as error:
            raise InputError(str(error), file=path) from None

    sources = (Source("map", path, document.raw), Source("image", image_path, raw))
    return LoadedMap(MapGeometry(_bounds(image), image=image), make_ways, None, sources, document.data)


def _read_image_bytes(path: Path, document: Document) -> bytes:
    try:
        return read_bytes(path, MAX_BYTES, "picture")
    except InputError as error:
        raise document.error(f"{path}: {error.what}", ("image",)) from None


def _pixels(raw: bytes, path: Path) -> NDArray[np.uint8]:
    try:
        with warnings.catch_warnings(), Image.open(io.BytesIO(raw)) as image:
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            columns, rows = image.size
            if columns * rows > MAX_PIXELS:
                what = f"{columns} x {rows} pixels are more than {MAX_PIXELS}; scale the picture down"
                raise InputError(what, file=path)
            pixels = np.array(image.convert("L"), dtype=np.uint8)
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise whatever a broken file makes them meet
        raise InputError(f"this picture cannot be read ({error}); export it again as PGM or PNG", file=path) from None
    if pixels.size == 0:
        raise InputError("this picture has no pixels; export it again", file=path)
    return pixels


def _bounds(image: MapImage) -> tuple[float, float, float, float]:
    rows, columns = image.pixels.shape
    x0, y0, yaw = image.origin
    u = np.array([0, columns, columns, 0]) * image.resolution_m
    v = np.array([0, 0, rows, rows]) * image.resolution_m
    x, y = x0 + np.cos(yaw) * u - np.sin(yaw) * v, y0 + np.sin(yaw) * u + np.cos(yaw) * v
    return (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
