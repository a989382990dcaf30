"""Roads given as a picture: wherever a UGV fits between the obstacles of an occupancy grid, it may drive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from skimage.graph import MCP_Geometric

from planner.problem import Point
from planner.roads import RoadError

Array = NDArray[np.float64]

# Steps to 16 neighbours: lengths of straight lines are at most 2.8 % too long (8 neighbours: 8.2 %).
_STEPS = [(i, j) for i in range(-2, 3) for j in range(-2, 3) if math.gcd(i, j) == 1]


class OccupancyRoads:
    """The ``Roads`` of an occupancy grid.

    The grid is shrunk by the UGV's clearance (its radius and some margin). From every site, distances to all cells
    are computed once over 16 neighbours, at most 2.8 % too long; routes follow them and are then pulled straight.
    """

    def __init__(
        self,
        free: NDArray[np.bool_],
        resolution_m: float,
        origin: tuple[float, float, float],
        sites: Array,
        clearance_m: float,
    ) -> None:
        """Computes the distances.

        Args:
            free: (rows, columns), the first row at the bottom (least y), True where nothing stands.
            resolution_m: side of a cell in m.
            origin: (x, y, yaw) of the lower left corner in m and rad.
            sites: (P+1, 2) in m, moved to the nearest place that the UGV can be at.
            clearance_m: least distance of the UGV's centre from anything not free.

        Raises:
            RoadError: when the UGV fits nowhere.
        """
        self._free, self.resolution_m, self.origin, self.clearance_m = free, resolution_m, origin, clearance_m
        # Outside the picture is unknown, so its rim counts as an obstacle.
        rim = np.pad(free, 1)
        self._room_m: Array = ndimage.distance_transform_edt(rim)[1:-1, 1:-1] * resolution_m - 0.5 * resolution_m
        self._open: NDArray[np.bool_] = free & (self._room_m >= clearance_m)
        if not self._open.any():
            raise RoadError(f"nowhere on the map is {clearance_m:g} m of clearance; give less, or a map with wider ways")
        away, nearest = ndimage.distance_transform_edt(~self._open, return_indices=True)
        self._away_m: Array = away * resolution_m
        self._nearest: NDArray[np.int32] = nearest
        given = np.asarray(sites, dtype=np.float64).reshape(-1, 2)
        self._sites = np.array([self._settle(site) for site in given]).reshape(-1, 2)
        self._cost = np.stack([self._costs(site) for site in self._sites]) if len(given) else np.zeros((0, *free.shape))
        self._distance_m = self._between()
        for array in (self._distance_m, self._sites):
            array.setflags(write=False)

    def with_sites(self, sites: Array) -> OccupancyRoads:
        """The same map with other sites, (P+1, 2) in m."""
        return OccupancyRoads(self._free, self.resolution_m, self.origin, sites, self.clearance_m)

    @property
    def sites(self) -> Array:
        """Positions, (P+1, 2) in m."""
        return self._sites

    @property
    def distance_m(self) -> Array:
        """Shortest distances, (P+1, P+1) in m, inf where no way leads."""
        return self._distance_m

    def distances_from(self, point: Point) -> Array:
        """Distance from ``point`` (taken to the nearest place the UGV can be at) to each site, (P+1,) in m."""
        row, column = self._open_cell(point)
        distances: Array = self._cost[:, row, column].astype(np.float64)
        return distances

    def route(self, start: Point, site: int) -> Array:
        """Polyline (n, 2) in m from ``start`` to ``site``, both ends included, pulled straight.

        Raises:
            RoadError: when no way leads there.
        """
        cell = self._open_cell(start)
        cost = self._cost[site]
        if not np.isfinite(cost[cell]):
            raise RoadError(f"no way leads from ({start[0]:g}, {start[1]:g}) to site {site}")
        cells = [cell]
        while cost[cell] > 0:
            around = [(cell[0] + i, cell[1] + j, math.hypot(i, j)) for i, j in _STEPS]
            inside = [(r, c, d) for r, c, d in around if 0 <= r < cost.shape[0] and 0 <= c < cost.shape[1]]
            # Steepest descent by what the step leaves to go, which is exact on the field that steps made.
            row, column, _ = min(inside, key=lambda s: cost[s[0], s[1]] + s[2] * self.resolution_m)
            if not cost[row, column] < cost[cell]:
                break
            cell = (row, column)
            cells.append(cell)
        first = np.asarray(start, dtype=np.float64)
        inner = [self._centre(c) for c in self._pull(cells)]
        if self._away_m[self._cell(start)] == 0.0:
            inner = inner[1:]  # the start itself is open, its cell's centre would be a detour
        line = np.array([first, *inner[:-1], self._sites[site]])
        keep = np.ones(len(line), dtype=np.bool_)
        keep[:-1] = np.hypot(*(line[1:] - line[:-1]).T) > 1e-6
        return line[keep] if keep.sum() > 1 else np.array([line[0], line[-1]])

    def offset_m(self, point: Point) -> float:
        """Distance from ``point`` to the nearest place the UGV can be at, in m; 0 within half a cell of one."""
        column, row = self._grid(point)
        r = min(max(row, 0.0), self._open.shape[0] - 1.0)
        c = min(max(column, 0.0), self._open.shape[1] - 1.0)
        outside = math.hypot(row - r, column - c) * self.resolution_m
        outside = 0.0 if outside <= self.resolution_m else outside
        return float(self._away_m[round(r), round(c)]) + outside

    def places(self, spacing_m: float) -> Array:
        """Points in the middle of the ways about ``spacing_m`` apart, (n, 2) in m, where path points may be placed."""
        size = max(1, round(spacing_m / self.resolution_m))
        widest = ndimage.maximum_filter(np.where(self._open, self._room_m, 0.0), size=2 * size + 1)
        rows, columns = np.nonzero(self._open & (self._room_m >= 0.95 * widest))
        _, first = np.unique(np.stack([rows // size, columns // size], axis=1), axis=0, return_index=True)
        return np.array([self._centre((int(rows[i]), int(columns[i]))) for i in np.sort(first)]).reshape(-1, 2)

    def _costs(self, site: Array) -> Array:
        speed = np.where(self._open, 1.0, -1.0)
        field, _ = MCP_Geometric(speed, offsets=_STEPS).find_costs([self._open_cell((float(site[0]), float(site[1])))])
        costs: Array = (field * self.resolution_m).astype(np.float32)
        return costs

    def _between(self) -> Array:
        n = len(self._sites)
        distance = np.array([self.distances_from((float(x), float(y))) for x, y in self._sites]).reshape(n, n)
        distance = np.minimum(distance, distance.T)
        distance[np.arange(n), np.arange(n)] = 0.0
        return distance

    def _settle(self, site: Array) -> Array:
        point = (float(site[0]), float(site[1]))
        if self.offset_m(point) == 0.0:
            return site
        return np.asarray(self._centre(self._open_cell(point)))

    def _grid(self, point: Point) -> tuple[float, float]:
        """Column and row, in cells, of which 0 is the centre of the first."""
        x0, y0, yaw = self.origin
        dx, dy = point[0] - x0, point[1] - y0
        c, s = math.cos(yaw), math.sin(yaw)
        return ((c * dx + s * dy) / self.resolution_m - 0.5, (-s * dx + c * dy) / self.resolution_m - 0.5)

    def _cell(self, point: Point) -> tuple[int, int]:
        column, row = self._grid(point)
        rows, columns = self._open.shape
        return min(max(round(row), 0), rows - 1), min(max(round(column), 0), columns - 1)

    def _open_cell(self, point: Point) -> tuple[int, int]:
        row, column = self._cell(point)
        return int(self._nearest[0, row, column]), int(self._nearest[1, row, column])

    def _centre(self, cell: tuple[int, int]) -> Point:
        x0, y0, yaw = self.origin
        u, v = (cell[1] + 0.5) * self.resolution_m, (cell[0] + 0.5) * self.resolution_m
        c, s = math.cos(yaw), math.sin(yaw)
        return (x0 + c * u - s * v, y0 + s * u + c * v)

    def _pull(self, cells: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Drops every cell that the straight line between two others passes by in the open."""
        kept = [cells[0]]
        i = 0
        while i < len(cells) - 1:
            far, low, high = i + 1, i + 1, len(cells) - 1
            if self._clear(cells[i], cells[high]):
                far = high
            else:
                while low < high - 1:  # visibility along a shortest path is nearly monotone: bisect
                    middle = (low + high) // 2
                    if self._clear(cells[i], cells[middle]):
                        far = low = middle
                    else:
                        high = middle
            kept.append(cells[far])
            i = far
        return kept

    def _clear(self, a: tuple[int, int], b: tuple[int, int]) -> bool:
        n = 2 * max(abs(a[0] - b[0]), abs(a[1] - b[1])) + 1
        rows = np.rint(np.linspace(a[0], b[0], n)).astype(int)
        columns = np.rint(np.linspace(a[1], b[1], n)).astype(int)
        return bool(self._open[rows, columns].all())
