"""A place of its own for every vehicle at every site: UGVs next to the site, UAV pads around them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from deploy.frames import Vec2

_ROW = 4  # as many UGVs stand in a row; more would reach too far from the site
_TURNS = 8


@dataclass(frozen=True, slots=True)
class Slots:
    """Offsets from any site, arena m.

    Attributes:
        pads: of each UAV.
        parks: of each UGV.
        reach_m: no vehicle at a site is further from it than this, docks included.
    """

    pads: tuple[Vec2, ...]
    parks: tuple[Vec2, ...]
    reach_m: float

    def turned(self, angle_rad: float) -> Slots:
        """All of it turned around the site."""
        c, s = math.cos(angle_rad), math.sin(angle_rad)

        def turn(p: Vec2) -> Vec2:
            return (round(c * p[0] - s * p[1], 6), round(s * p[0] + c * p[1], 6))

        return Slots(tuple(map(turn, self.pads)), tuple(map(turn, self.parks)), self.reach_m)


def make_slots(n_uavs: int, docks: Sequence[Sequence[Vec2]], pad_spacing_m: float, parking_spacing_m: float) -> Slots:
    """Packs the slots closely: parks first, since UGVs stay near the road, then pads.

    A pad keeps ``pad_spacing_m`` from every other pad and from every dock of a parked UGV, whichever way it heads:
    one UAV may land on its pad while another docks.

    Args:
        n_uavs: how many pads.
        docks: of each UGV, its docks relative to it.
        pad_spacing_m: least distance between pads.
        parking_spacing_m: least distance between parks.
    """
    radius = [max((math.hypot(*dock) for dock in own), default=0.0) for own in docks]
    # Two UAVs may dock at two UGVs side by side, too.
    parking_m = (
        max([parking_spacing_m, *(pad_spacing_m + 2 * r for r in radius)]) if len(docks) > 1 else parking_spacing_m
    )
    parks: list[Vec2] = []
    if len(docks) <= _ROW:
        middle = (len(docks) - 1) / 2
        parks = [((i - middle) * parking_m, 0.0) for i in range(len(docks))]
    else:
        for _ in docks:
            parks.append(_nearest_free([(park, parking_m) for park in parks], parking_m))
    pads: list[Vec2] = []
    for _ in range(n_uavs):
        taken = [(park, pad_spacing_m + r) for park, r in zip(parks, radius, strict=True)]
        pads.append(_nearest_free([*taken, *((pad, pad_spacing_m) for pad in pads)], pad_spacing_m))
    reach = max(
        [math.hypot(*pad) for pad in pads] + [math.hypot(*park) + r for park, r in zip(parks, radius, strict=True)],
        default=0.0,
    )
    return Slots(tuple(pads), tuple(parks), reach)


def best_turn(slots: Slots, off_road_m: Callable[[Vec2], float]) -> Slots:
    """Turns the slots so that parked UGVs stand as little off the road as possible, then UAV pads likewise.

    Args:
        slots: to turn.
        off_road_m: how far the place with this offset is from where UGVs may be, at the worst of all sites.
    """

    def cost(turned: Slots) -> tuple[float, float]:
        parks = max((off_road_m(park) for park in turned.parks), default=0.0)
        return (round(parks, 3), round(sum(off_road_m(pad) for pad in turned.pads), 3))

    return min((slots.turned(math.pi * i / _TURNS) for i in range(2 * _TURNS)), key=cost)


def _nearest_free(taken: Sequence[tuple[Vec2, float]], step_m: float) -> Vec2:
    """The place closest to the site that keeps its distance from all of ``taken``: (place, least distance)."""
    ring = 0
    while True:
        radius = ring * step_m / 12
        n = 36 if ring else 1
        for i in range(n):
            angle = math.pi / 2 + 2 * math.pi * i / n  # the row of UGVs runs along x, so begin at its side
            place = (round(radius * math.cos(angle), 6), round(radius * math.sin(angle), 6))
            if all(math.dist(place, other) >= least - 1e-6 for other, least in taken):
                return place
        ring += 1
