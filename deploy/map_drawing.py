"""A mission's map as the pictures draw it."""

from __future__ import annotations

import math

import numpy as np
import shapely
from numpy.typing import NDArray

from deploy.drawing import Array, MapDrawing
from deploy.maps import MapGeometry, MapImage

_KINDS = {"wood": "forest", "block": "building"}
_UNKNOWN = 205  # map_server's grey
STREAM_M = 15.0
"""A stream is drawn so wide that it shows at the size of the map it is on."""


def drawing_of(geometry: MapGeometry) -> MapDrawing:
    """The drawing; a rotated occupancy image is turned upright."""
    polygons: dict[str, list[Array]] = {}
    for area in geometry.areas:
        polygons.setdefault(_KINDS.get(area.kind, area.kind), []).append(area.outline)
    for kind, line in geometry.lines:
        if kind == "stream" and len(line) > 1:
            outline = shapely.LineString(line).buffer(STREAM_M / 2)
            if isinstance(outline, shapely.Polygon):
                polygons.setdefault("water", []).append(np.asarray(outline.exterior.coords))
    x0, y0, x1, y1 = geometry.bounds
    image, extent = _upright(geometry.image) if geometry.image is not None else (None, None)
    return MapDrawing(
        extent=(x0, x1, y0, y1),
        lines=geometry.roads,
        polygons={kind: tuple(outlines) for kind, outlines in polygons.items()},
        image=image,
        image_extent=extent,
    )


def _upright(image: MapImage) -> tuple[NDArray[np.uint8], tuple[float, float, float, float]]:
    """Pixels of an image without yaw, first row at the top, and what they cover (x0, x1, y0, y1)."""
    rows, columns = image.pixels.shape
    ox, oy, yaw = image.origin
    c, s, r = math.cos(yaw), math.sin(yaw), image.resolution_m
    corners = np.array([(0, 0), (columns, 0), (0, rows), (columns, rows)], dtype=np.float64) * r
    turned = np.array([ox, oy]) + corners @ np.array([[c, s], [-s, c]])
    (x0, y0), (x1, y1) = turned.min(axis=0), turned.max(axis=0)
    extent = (float(x0), float(x1), float(y0), float(y1))
    if math.isclose(c, 1.0):
        return image.pixels, extent
    xs = np.arange(x0 + r / 2, x1, r)
    ys = np.arange(y1 - r / 2, y0, -r)
    dx, dy = np.meshgrid(xs - ox, ys - oy)
    column = np.floor((c * dx + s * dy) / r).astype(int)
    row = rows - 1 - np.floor((-s * dx + c * dy) / r).astype(int)
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    pixels = np.full(dx.shape, _UNKNOWN, dtype=np.uint8)
    pixels[inside] = image.pixels[row[inside], column[inside]]
    return pixels, extent
