"""Plane geometry: inside the geofence or not, how far from its edge, whether a path stays inside; routes as lines."""

from __future__ import annotations

import math
from functools import lru_cache

import shapely

from drivers.vehicle import Vec2


@lru_cache(maxsize=8)
def _polygon(vertices: tuple[Vec2, ...]) -> shapely.Polygon:
    polygon = shapely.Polygon(vertices)
    shapely.prepare(polygon)
    return polygon


@lru_cache(maxsize=128)
def line_of(points: tuple[Vec2, ...]) -> shapely.LineString:
    """A polyline of at least two points; made once, since routes are looked at every turn."""
    return shapely.LineString(points)


@lru_cache(maxsize=8)
def _edges(vertices: tuple[Vec2, ...]) -> tuple[tuple[float, float, float, float, float, float], ...]:
    ends = (*vertices[1:], vertices[0])
    return tuple(
        (ax, ay, by, bx - ax, by - ay, (bx - ax) ** 2 + (by - ay) ** 2)
        for (ax, ay), (bx, by) in zip(vertices, ends, strict=True)
    )


def margin_m(vertices: tuple[Vec2, ...], x: float, y: float) -> float:
    """Distance from (x, y) to the polygon's edge, in m: positive inside, negative outside.

    Without shapely, which would cost more than the sum: it is asked for every vehicle at every turn.
    """
    nearest2, inside = math.inf, False
    for ax, ay, by, dx, dy, length2 in _edges(vertices):
        px, py = x - ax, y - ay
        f = min(1.0, max(0.0, (px * dx + py * dy) / length2)) if length2 > 0.0 else 0.0
        nearest2 = min(nearest2, (px - f * dx) ** 2 + (py - f * dy) ** 2)
        if (y < ay) != (y < by) and (px * dy < py * dx) == (dy > 0.0):
            inside = not inside
    return math.sqrt(nearest2) if inside else -math.sqrt(nearest2)


def path_inside(vertices: tuple[Vec2, ...], points: tuple[Vec2, ...]) -> bool:
    """Whether the whole polyline lies inside or on the polygon."""
    if len(set(points)) == 1:
        return bool(shapely.covers(_polygon(vertices), shapely.Point(points[0])))
    return bool(shapely.covers(_polygon(vertices), shapely.linestrings(points)))
