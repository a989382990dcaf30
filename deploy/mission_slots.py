"""A place of its own for every vehicle at every site: UGVs next to the site, UAV pads around them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from deploy.frames import Vec2


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
    parks: list[Vec2] = []
    for _ in docks:
        parks.append(_nearest_free([(park, parking_spacing_m) for park in parks], parking_spacing_m))
    pads: list[Vec2] = []
    for _ in range(n_uavs):
        taken = [(park, pad_spacing_m + r) for park, r in zip(parks, radius, strict=True)]
        pads.append(_nearest_free([*taken, *((pad, pad_spacing_m) for pad in pads)], pad_spacing_m))
    reach = max(
        [math.hypot(*pad) for pad in pads] + [math.hypot(*park) + r for park, r in zip(parks, radius, strict=True)],
        default=0.0,
    )
    return Slots(tuple(pads), tuple(parks), reach)


def _nearest_free(taken: Sequence[tuple[Vec2, float]], step_m: float) -> Vec2:
    """The place closest to the site that keeps its distance from all of ``taken``: (place, least distance)."""
    ring = 0
    while True:
        radius = ring * step_m / 8
        n = max(1, 24 * (ring > 0))
        for i in range(n):
            # Begin sideways (y): in the picture pads then lie above and below the row of UGVs.
            angle = math.pi / 2 * (len(taken) and 1) + 2 * math.pi * i / n
            place = (round(radius * math.cos(angle), 6), round(radius * math.sin(angle), 6))
            if all(math.dist(place, other) >= least - 1e-6 for other, least in taken):
                return place
        ring += 1
