"""What a wire simulation consists of: which endpoint plays which vehicle, where, and with which command line."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sim_backends.errors import SimulationError

LimoMode = Literal["differential", "ackermann", "mecanum"]


@dataclass(frozen=True, slots=True)
class CrazyflieEndpoint:
    """A Crazyflie that speaks CRTP over UDP.

    Attributes:
        vehicle: id in the world.
        port: UDP; None: a free one.
    """

    vehicle: str
    port: int | None = None


@dataclass(frozen=True, slots=True)
class LimoEndpoint:
    """A Limo as a ROS 2 node.

    Attributes:
        vehicle: id in the world.
        namespace: of its topics; None: ``/<vehicle>``.
        domain: ROS_DOMAIN_ID; None: an unused one, the same for all of a simulation.
        mode: how its chassis is set.
    """

    vehicle: str
    namespace: str | None = None
    domain: int | None = None
    mode: LimoMode = "differential"


@dataclass(frozen=True, slots=True)
class MavlinkEndpoint:
    """A copter or a rover with a MAVLink autopilot.

    Attributes:
        vehicle: id in the world.
        type: what it is.
        autopilot: whose dialect and habits it has.
        sysid: MAVLink system id, 1 to 250.
        port: UDP port on this computer that it sends to; None: a free one.
        origin: latitude and longitude of the arena's origin in degrees, and the arena's rotation against north up in
            degrees, counter-clockwise; None: indoors, without GPS.
    """

    vehicle: str
    type: Literal["copter", "rover"]
    autopilot: Literal["px4", "ardupilot"] = "px4"
    sysid: int = 1
    port: int | None = None
    origin: tuple[float, float, float] | None = None


Endpoint = CrazyflieEndpoint | LimoEndpoint | MavlinkEndpoint


@dataclass(frozen=True, slots=True)
class Address:
    """Where a driver reaches a simulated vehicle.

    Attributes:
        endpoint: as in a fleet file: ``udp://127.0.0.1:19850``, ``/limo1``, ``udpin:127.0.0.1:14551``.
        domain: ROS_DOMAIN_ID; None for others.
        sysid: MAVLink system id; None for others.
    """

    endpoint: str
    domain: int | None = None
    sysid: int | None = None


def module(name: str) -> list[str]:
    """The command that runs a module of this package."""
    return [sys.executable, "-m", f"sim_backends.wire.{name}"]


def command_of(endpoint: Endpoint, address: Address, folder: Path, parent: int) -> list[str]:
    """The command line that starts an endpoint at an address."""
    common = ["--world", str(folder), "--vehicle", endpoint.vehicle, "--parent", str(parent)]
    match endpoint:
        case CrazyflieEndpoint():
            return [*module("crazyflie_server"), *common, "--port", address.endpoint.rpartition(":")[2]]
        case LimoEndpoint(mode=mode):
            where = ["--namespace", address.endpoint, "--domain", str(address.domain)]
            return [*module("limo_node"), *common, *where, "--mode", mode]
        case MavlinkEndpoint():
            out = address.endpoint.removeprefix("udpin:")
            what = ["--type", endpoint.type, "--autopilot", endpoint.autopilot, "--sysid", str(endpoint.sysid)]
            origin = [] if endpoint.origin is None else ["--origin=" + ",".join(f"{v!r}" for v in endpoint.origin)]
            return [*module("mavlink_vehicle"), *common, *what, "--out", out, *origin]


def check_unique(endpoints: tuple[Endpoint, ...]) -> None:
    """Checks that every vehicle has one endpoint, and every address one vehicle.

    Raises:
        SimulationError: naming the vehicle.
    """
    seen: set[object] = set()
    for e in endpoints:
        keys: list[object] = [("vehicle", e.vehicle)]
        if isinstance(e, LimoEndpoint):
            keys.append(("namespace", e.namespace or f"/{e.vehicle}", e.domain))
        elif e.port is not None:
            keys.append(("port", e.port, e.sysid if isinstance(e, MavlinkEndpoint) else 0))
        for key in keys:
            if key in seen:
                raise SimulationError(f"{e.vehicle}: {key} is used twice; give each simulated vehicle its own")
            seen.add(key)
