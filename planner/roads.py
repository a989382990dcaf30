"""What UGVs may drive on: shortest road distances and the polylines that realise them, in the world frame."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from planner.errors import PlannerError
from planner.problem import Point


class RoadError(PlannerError):
    """A point cannot be reached by road."""


class Roads(Protocol):
    """Roads between sites. A *site* is a path point (index 0..P-1) or the depot (index P)."""

    @property
    def sites(self) -> NDArray[np.float64]:
        """Positions, (P+1, 2) in m."""
        ...

    @property
    def distance_m(self) -> NDArray[np.float64]:
        """Shortest road distances, (P+1, P+1), symmetric, inf where no road leads."""
        ...

    def distances_from(self, point: Point) -> NDArray[np.float64]:
        """Road distance from ``point`` (taken to the nearest road) to each site, (P+1,) in m."""
        ...

    def route(self, start: Point, site: int) -> NDArray[np.float64]:
        """Polyline (n, 2) in m along the shortest road from ``start`` to ``site``, both ends included.

        Raises:
            RoadError: when no road leads there.
        """
        ...

    def offset_m(self, point: Point) -> float:
        """Distance from ``point`` to the nearest place a UGV may be, in m; 0 on the road."""
        ...
