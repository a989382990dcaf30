"""Roads given as lines: crossings become nodes, sites move onto the nearest road, shortest paths are precomputed."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from planner.problem import Point
from planner.roads import RoadError

Array = NDArray[np.float64]
_Piece = tuple[int, float, float, float, float, float]  # index, start x y, along x y, squared length


class RoadNetwork:
    """The ``Roads`` of a set of lines.

    Every straight piece between two neighbouring vertices is an edge; crossing lines are cut where they cross. Sites
    lie on the roads and are nodes themselves, so that any route from a point runs through an end of its edge.
    Paths are kept from every site, which makes ``distances_from`` a look-up.
    """

    def __init__(self, nodes: Array, edges: NDArray[np.int64], sites: Array) -> None:
        """From noded pieces; use ``from_lines``.

        Args:
            nodes: (n, 2) in m.
            edges: (m, 2) indices into ``nodes``.
            sites: (P+1, 2) in m, moved onto the nearest road.
        """
        self._base = (nodes, edges)
        snapped, piece, _ = _snap_all(nodes, edges, sites)
        self._nodes, self._edges, self._site_nodes = _insert(nodes, edges, snapped, piece)
        start, end = self._nodes[self._edges[:, 0]], self._nodes[self._edges[:, 1]]
        self._start, self._along = start, end - start
        self._length = np.hypot(self._along[:, 0], self._along[:, 1])
        # Pieces that can be nearest to a point of a square cell, filled in when asked for: vehicles move little.
        self._cell_m = max(1e-3, float(np.ptp(self._nodes, axis=0).max()) / 128)
        self._near: dict[tuple[int, int], list[_Piece]] = {}
        self._cost, self._before = self._shortest()
        self._cost_at: Array = np.ascontiguousarray(self._cost.T)  # (n, P+1)
        n = len(snapped)
        between = self._cost[:, self._site_nodes]
        self._distance_m = np.minimum(between, between.T)
        self._distance_m[np.arange(n), np.arange(n)] = 0.0
        self._sites = snapped
        for array in (self._distance_m, self._sites):
            array.setflags(write=False)

    @classmethod
    def from_lines(cls, lines: Sequence[Array], sites: Array, *, max_offset_m: float = np.inf) -> RoadNetwork:
        """Nodes the lines and places the sites.

        Args:
            lines: polylines, each (n, 2) in m.
            sites: (P+1, 2) in m; each is moved onto the nearest road.
            max_offset_m: a site further than this from every road is an error.

        Raises:
            RoadError: when there is no road, or a site is too far from one.
        """
        shapes = [shapely.linestrings(np.asarray(line, dtype=np.float64)) for line in lines if len(line) > 1]
        if not shapes:
            raise RoadError("the map has no road; give at least one line of two points")
        noded = shapely.union_all(np.array(shapes), grid_size=1e-3)  # 1 mm: float noise must not part a crossing
        coords, owner = shapely.get_coordinates(shapely.get_parts(noded), return_index=True)
        if len(coords) == 0:
            raise RoadError("the map's roads have no length; give lines of two different points")
        nodes, index = np.unique(coords, axis=0, return_inverse=True)
        index = index.reshape(-1)
        same = owner[:-1] == owner[1:]
        edges = np.stack([index[:-1][same], index[1:][same]], axis=1).astype(np.int64)
        edges = np.unique(np.sort(edges[edges[:, 0] != edges[:, 1]], axis=1), axis=0)
        sites = np.asarray(sites, dtype=np.float64).reshape(-1, 2)
        _, _, offset = _snap_all(nodes, edges, sites)
        worst = int(np.argmax(offset)) if len(offset) else 0
        if len(offset) and offset[worst] > max_offset_m:
            x, y = sites[worst]
            raise RoadError(
                f"site {worst} at ({x:g}, {y:g}) is {offset[worst]:.1f} m from any road, {max_offset_m:g} m are allowed"
            )
        return cls(nodes, edges, sites)

    def with_sites(self, sites: Array) -> RoadNetwork:
        """The same roads with other sites, (P+1, 2) in m."""
        return RoadNetwork(*self._base, np.asarray(sites, dtype=np.float64).reshape(-1, 2))

    @property
    def sites(self) -> Array:
        """Positions on the roads, (P+1, 2) in m."""
        return self._sites

    @property
    def distance_m(self) -> Array:
        """Shortest road distances, (P+1, P+1) in m, inf where no road leads."""
        return self._distance_m

    @property
    def lines(self) -> Array:
        """All pieces of road, (m, 2, 2) in m."""
        return np.stack([self._start, self._start + self._along], axis=1)

    def distances_from(self, point: Point) -> Array:
        """Road distance from ``point`` (taken to the nearest road) to each site, (P+1,) in m."""
        piece, t, _ = self._nearest(point)
        a, b = self._edges[piece]
        length = self._length[piece]
        nearest: Array = np.minimum(self._cost_at[a] + t * length, self._cost_at[b] + (1.0 - t) * length)
        return nearest

    def route(self, start: Point, site: int) -> Array:
        """Polyline (n, 2) in m along the shortest road from ``start`` to ``site``, both ends included.

        Raises:
            RoadError: when no road leads there.
        """
        piece, t, foot = self._nearest(start)
        a, b = (int(i) for i in self._edges[piece])
        length = self._length[piece]
        via_a, via_b = self._cost[site, a] + t * length, self._cost[site, b] + (1.0 - t) * length
        if not np.isfinite(min(via_a, via_b)):
            raise RoadError(f"no road leads from ({start[0]:g}, {start[1]:g}) to site {site}")
        node = a if via_a <= via_b else b
        points = [np.asarray(start, dtype=np.float64), np.array(foot)]
        while node >= 0:
            points.append(self._nodes[node])
            node = int(self._before[site, node])
        line = np.array(points)
        keep = np.ones(len(line), dtype=np.bool_)
        keep[:-1] = np.hypot(*(line[1:] - line[:-1]).T) > 1e-6
        return line[keep] if keep.sum() > 1 else np.array([line[0], line[-1]])

    def offset_m(self, point: Point) -> float:
        """Distance from ``point`` to the nearest road in m."""
        _, _, foot = self._nearest(point)
        return math.hypot(foot[0] - point[0], foot[1] - point[1])

    def places(self, spacing_m: float) -> Array:
        """Points on the roads about ``spacing_m`` apart, (n, 2) in m, where path points may be placed."""
        counts = np.maximum(1, np.round(self._length / spacing_m).astype(int))
        piece = np.repeat(np.arange(len(counts)), counts)
        within = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
        points: Array = self._start[piece] + ((within + 0.5) / counts[piece])[:, None] * self._along[piece]
        # Curved roads have pieces shorter than the spacing: keep one point a cell.
        cell = np.floor(points / spacing_m).astype(np.int64)
        _, first = np.unique(cell, axis=0, return_index=True)
        return points[np.sort(first)]

    def _nearest(self, point: Point) -> tuple[int, float, Point]:
        """The piece of road nearest to ``point``, how far along it (0 to 1), and where."""
        x, y = point
        cell = (math.floor(x / self._cell_m), math.floor(y / self._cell_m))
        pieces = self._near.get(cell)
        if pieces is None:
            pieces = self._near[cell] = self._pieces_near(cell)
        best, found = math.inf, (0, 0.0, point)
        for index, x0, y0, dx, dy, squared in pieces:
            t = ((x - x0) * dx + (y - y0) * dy) / squared
            t = 0.0 if t < 0.0 else 1.0 if t > 1.0 else t
            fx, fy = x0 + t * dx, y0 + t * dy
            away = (fx - x) * (fx - x) + (fy - y) * (fy - y)
            if away < best:
                best, found = away, (index, t, (fx, fy))
        return found

    def _pieces_near(self, cell: tuple[int, int]) -> list[_Piece]:
        centre = (np.array(cell) + 0.5) * self._cell_m
        squared = self._length**2
        t = np.clip(((centre - self._start) * self._along).sum(axis=1) / squared, 0.0, 1.0)
        away = np.hypot(*(self._start + t[:, None] * self._along - centre).T)
        # Within the cell, distances differ by at most half its diagonal from those at its centre.
        near = np.flatnonzero(away <= away.min() + 1.4143 * self._cell_m)
        columns = (near, *self._start[near].T, *self._along[near].T, squared[near])
        return list(zip(*(column.tolist() for column in columns), strict=True))

    def _shortest(self) -> tuple[Array, NDArray[np.int32]]:
        a, b = self._edges.T
        n = len(self._nodes)
        graph = csr_array((np.tile(self._length, 2), (np.r_[a, b], np.r_[b, a])), shape=(n, n))
        cost, before = dijkstra(graph, indices=self._site_nodes, return_predecessors=True)
        return np.atleast_2d(cost), np.atleast_2d(before)

    @property
    def parts(self) -> int:
        """Number of road networks that are not connected to each other."""
        a, b = self._edges.T
        n = len(self._nodes)
        return int(connected_components(csr_array((np.ones(len(a)), (a, b)), shape=(n, n)), directed=False)[0])


def _snap_all(nodes: Array, edges: NDArray[np.int64], points: Array) -> tuple[Array, NDArray[np.int64], Array]:
    """Nearest place on the roads to each point: position (n, 2), edge (n,) and distance (n,)."""
    if len(points) == 0:
        return points, np.zeros(0, dtype=np.int64), np.zeros(0)
    pieces = np.asarray(shapely.linestrings(nodes[edges]))
    piece = np.asarray(shapely.STRtree(pieces).nearest(shapely.points(points)), dtype=np.int64)
    start, along = nodes[edges[piece, 0]], nodes[edges[piece, 1]] - nodes[edges[piece, 0]]
    t = np.clip(((points - start) * along).sum(axis=1) / (along**2).sum(axis=1), 0.0, 1.0)
    foot: Array = start + t[:, None] * along
    return foot, piece, np.hypot(*(foot - points).T)


def _insert(
    nodes: Array, edges: NDArray[np.int64], points: Array, piece: NDArray[np.int64]
) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Makes nodes of ``points``, which lie on the edges ``piece``; returns nodes, edges and the points' nodes."""
    new_nodes = list(nodes)
    whole = np.ones(len(edges), dtype=np.bool_)
    whole[piece] = False
    new_edges: list[tuple[int, int]] = [(int(a), int(b)) for a, b in edges[whole]]
    site_nodes = np.zeros(len(points), dtype=np.int64)
    for edge in sorted(set(piece.tolist())):
        a, b = (int(i) for i in edges[edge])
        on_it = np.flatnonzero(piece == edge)
        away = np.hypot(*(points[on_it] - nodes[a]).T)
        last = a
        for i in on_it[np.argsort(away, kind="stable")]:
            if np.hypot(*(points[i] - new_nodes[last])) > 1e-6:
                if np.hypot(*(points[i] - nodes[b])) <= 1e-6:
                    site_nodes[i] = b
                    continue
                new_nodes.append(points[i])
                new_edges.append((last, len(new_nodes) - 1))
                last = len(new_nodes) - 1
            site_nodes[i] = last
        new_edges.append((last, b))
    return np.array(new_nodes), np.array(new_edges, dtype=np.int64).reshape(-1, 2), site_nodes
