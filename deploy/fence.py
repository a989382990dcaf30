"""Plane geometry: inside the geofence or not, how far from its edge, whether a path stays inside; routes as lines."""

from __future__ import annotations

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


def margin_m(vertices: tuple[Vec2, ...], x: float, y: float) -> float:
    """Distance from (x, y) to the polygon's edge, in m: positive inside, negative outside."""
    polygon = _polygon(vertices)
    distance_m = float(shapely.distance(polygon.exterior, shapely.points(x, y)))
    return distance_m if shapely.contains_xy(polygon, x, y) else -distance_m


def path_inside(vertices: tuple[Vec2, ...], points: tuple[Vec2, ...]) -> bool:
    """Whether the whole polyline lies inside or on the polygon."""
    if len(set(points)) == 1:
        return bool(shapely.covers(_polygon(vertices), shapely.Point(points[0])))
    return bool(shapely.covers(_polygon(vertices), shapely.linestrings(points)))
