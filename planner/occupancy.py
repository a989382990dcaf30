"""Roads given as a picture: wherever a UGV fits between the obstacles of an occupancy grid, it may drive."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from planner.problem import Point
from planner.roads import RoadError

Array = NDArray[np.float64]

# Steps to 16 neighbours: lengths of straight lines are at most 2.8 % too long (8 neighbours: 8.2 %).
_STEPS = [(0, 1), (1, 0), (1, 1), (1, -1), (1, 2), (1, -2), (2, 1), (2, -1)]  # and back


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
            raise RoadError(
                f"nowhere on the map is {clearance_m:g} m of clearance; give less, or a map with wider ways"
            )
        away, nearest = ndimage.distance_transform_edt(~self._open, return_indices=True)
        self._away_m: Array = away * resolution_m
        self._nearest: NDArray[np.int32] = nearest
        given = np.asarray(sites, dtype=np.float64).reshape(-1, 2)
        self._sites = np.array([self._settle(site) for site in given]).reshape(-1, 2)
        self._number = np.full(free.shape, -1, dtype=np.int64)  # of each open cell
        self._number[self._open] = np.arange(int(self._open.sum()))
        self._cells = np.argwhere(self._open)  # (n, 2) row, column
        self._cost, self._before = self._shortest()
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
        distances: Array = self._cost[:, self._number[self._open_cell(point)]]
        return distances

    def route(self, start: Point, site: int) -> Array:
        """Polyline (n, 2) in m from ``start`` to ``site``, both ends included, pulled straight.

        Raises:
            RoadError: when no way leads there.
        """
        number = int(self._number[self._open_cell(start)])
        if not np.isfinite(self._cost[site, number]):
            raise RoadError(f"no way leads from ({start[0]:g}, {start[1]:g}) to site {site}")
        cells = []
        while number >= 0:
            cells.append((int(self._cells[number, 0]), int(self._cells[number, 1])))
            number = int(self._before[site, number])
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

    def _shortest(self) -> tuple[Array, NDArray[np.int32]]:
        """Distance from each site to each open cell, (P+1, n) in m, and the cell before it on the way from the site."""
        rows, columns = self._open.shape
        starts, ends, lengths = [], [], []
        for i, j in _STEPS:
            here = self._number[: rows - i, max(0, -j) : columns - max(0, j)]
            there = self._number[i:, max(0, j) : columns - max(0, -j)]
            both = (here >= 0) & (there >= 0)
            if abs(i) + abs(j) == 3:  # a long step must not jump a corner: the cells it passes between are open, too
                u, v = (i - i // 2, j) if abs(i) == 2 else (i, j - int(math.copysign(1, j)))
                a, b = (i // 2, 0) if abs(i) == 2 else (0, int(math.copysign(1, j)))
                both &= self._shifted(a, b, here.shape, max(0, -j)) & self._shifted(u, v, here.shape, max(0, -j))
            starts.append(here[both])
            ends.append(there[both])
            lengths.append(np.full(int(both.sum()), math.hypot(i, j) * self.resolution_m))
        a_, b_, d_ = np.concatenate(starts), np.concatenate(ends), np.concatenate(lengths)
        n = len(self._cells)
        graph = csr_array((np.r_[d_, d_], (np.r_[a_, b_], np.r_[b_, a_])), shape=(n, n))
        at = [int(self._number[self._open_cell((float(x), float(y)))]) for x, y in self._sites]
        if not at:
            return np.zeros((0, n)), np.zeros((0, n), dtype=np.int32)
        cost, before = dijkstra(graph, indices=at, return_predecessors=True)
        return cost, before

    def _shifted(self, i: int, j: int, shape: tuple[int, ...], column: int) -> NDArray[np.bool_]:
        """Whether the cell (i, j) further is open, for the block of cells of ``shape`` from (0, ``column``)."""
        shifted: NDArray[np.bool_] = self._open[i : i + shape[0], column + j : column + j + shape[1]]
        return shifted

    def _between(self) -> Array:
        n = len(self._sites)
        distance: Array = np.array([self.distances_from((float(x), float(y))) for x, y in self._sites]).reshape(n, n)
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
