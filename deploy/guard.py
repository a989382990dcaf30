"""What the guardian process, which watches over the flight from outside, is told.

It is started before anything is armed and told in every turn who is under way. When this program is killed or hangs,
it carries out their last wills; when the flight ends with everybody at rest, it goes home.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

from deploy.settings import Settings
from deploy.state import AIRBORNE, State, UavState, UgvPhase
from drivers.last_will import LastWill
from drivers.vehicle import StopMotors, Vehicle, VehicleState


class Guard(Protocol):
    """Whoever must know who is under way; ``drivers.guardian.Guardian``, or a test."""

    def tell(self, under_way: Mapping[str, float], now_s: float) -> None:
        """Called every turn with the height above the ground, m, of each vehicle under way; never blocks."""
        ...


def wills_of(vehicles: Mapping[str, Vehicle]) -> tuple[LastWill, ...]:
    """What is to be done for whom; who dies with this program has none."""
    return tuple(will for v in vehicles.values() if (will := v.last_will()) is not None)


def under_way(settings: Settings, state: State, vehicles: Sequence[VehicleState]) -> dict[str, float]:
    """Who must not be left alone: UAVs in the air or about to be, UGVs that drive; height above the ground in m.

    A UAV that the supervisor has given up counts as long as it says, over its link, that it flies.
    """
    flying = {v.vehicle for v in vehicles if v.airborne and v.link and not v.locked}
    found = {}
    for uav, config in zip(state.uavs, settings.uavs, strict=True):
        if (uav.phase in AIRBORNE or config.id in flying) and not _stopped(uav):
            # by a pose that has failed, or none: from as high as it may be
            height_m = uav.track.position_m[2] if uav.track is not None else settings.geofence.ceiling_m
            found[config.id] = min(max(0.0, height_m), settings.geofence.ceiling_m)
    for ugv, road in zip(state.ugvs, settings.ugvs, strict=True):
        if ugv.phase in (UgvPhase.DRIVING, UgvPhase.HOLDING):
            found[road.id] = 0.0
    return found


def _stopped(uav: UavState) -> bool:
    return uav.order is not None and isinstance(uav.order.command, StopMotors)
