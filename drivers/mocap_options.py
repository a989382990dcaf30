"""How to reach a motion-capture system, and how its axes lie in the arena; validated on construction."""

from __future__ import annotations

import difflib
import ipaddress
import math
from dataclasses import dataclass
from typing import Literal

from drivers.errors import DriverError
from drivers.vehicle import Vec3

TYPES = ("mock", "vicon", "optitrack", "qualisys", "vrpn")
"""Back ends in the wheel of ``motioncapture`` 1.1 that work; others raise "Unknown motion capture type!"."""


@dataclass(frozen=True, slots=True)
class MocapOptions:
    """One motion-capture system.

    Attributes:
        type: one of ``TYPES``.
        hostname: where its server runs, name or address; not for ``mock``.
        port: None is the system's own: OptiTrack's command port 1510, Qualisys 22222, Vicon 801, VRPN 3883.
        interface_ip: OptiTrack with multicast on a computer with several networks: the address of ours there.
        up: the axis that points up in the stream. Motive streams y unless its "Up Axis" is set to z; the client of
            Vicon asks for z itself.
        yaw_rad: of the system's x axis in the arena.
        translation_m: of the system's origin in the arena.
        attempt_s: an attempt to connect is given up after this and made again: OptiTrack is asked by UDP, and one
            lost packet hangs its client for ever. A server in the same network answers within 0.1 s.
        bodies_s: once frames arrive, bodies not seen for this long are missing. Seconds, because cameras may be
            waking up.
        silence_s: without a frame for this long the client is killed and connects again. Longer than the supervisor
            needs to call a pose lost (1 s): nothing is given up by reconnecting then.
        retry_s, retry_max_s: pause before reconnecting, doubled each time up to the second.
        mock_bodies: names and places for ``mock``.
        mock_rate_hz: of ``mock``.
    """

    type: str
    hostname: str | None = None
    port: int | None = None
    interface_ip: str | None = None
    up: Literal["y", "z"] = "z"
    yaw_rad: float = 0.0
    translation_m: Vec3 = (0.0, 0.0, 0.0)
    attempt_s: float = 3.0
    bodies_s: float = 3.0
    silence_s: float = 2.0
    retry_s: float = 0.5
    retry_max_s: float = 5.0
    mock_bodies: tuple[tuple[str, Vec3], ...] = ()
    mock_rate_hz: int = 100

    def __post_init__(self) -> None:
        if self.type not in TYPES:
            near = difflib.get_close_matches(str(self.type).lower(), TYPES, 1)
            hint = f"; did you mean {near[0]}?" if near else ""
            raise DriverError(f"motion capture: type is {self.type!r}; give one of {', '.join(TYPES)}{hint}")
        self._check_place()
        self._check_numbers()

    @property
    def where(self) -> str:
        """What messages call it."""
        at = f" at {self.hostname}" if self.hostname else ""
        return f"motion capture ({self.type}{at}{f':{self.port}' if self.port else ''})"

    def settings(self) -> dict[str, str]:
        """What ``motioncapture.connect`` takes for this type (libmotioncapture 1.1, ``motioncapture.cpp``)."""
        if self.type == "mock":
            bodies = ";".join(f"{name}({x},{y},{z},1,0,0,0)" for name, (x, y, z) in self.mock_bodies)
            return {"rigid_bodies": bodies, "frequency": str(self.mock_rate_hz)}
        assert self.hostname is not None  # checked on construction
        if self.type in ("vicon", "vrpn"):  # these take the port in the name
            return {"hostname": self.hostname if self.port is None else f"{self.hostname}:{self.port}"}
        settings = {"hostname": self.hostname}
        if self.port is not None:
            settings["port_command" if self.type == "optitrack" else "port"] = str(self.port)
        if self.interface_ip is not None:
            settings["interface_ip"] = self.interface_ip
        return settings

    def _check_place(self) -> None:
        mock = self.type == "mock"
        if mock and (self.hostname or self.port):
            raise DriverError("motion capture (mock): it has no hostname and no port; leave them out")
        if not mock and not (self.hostname and self.hostname.strip() == self.hostname):
            raise DriverError(f"motion capture ({self.type}): hostname is {self.hostname!r}; give its server's address")
        if mock and not self.mock_bodies:
            raise DriverError("motion capture (mock): mock_bodies is empty; give the names and places of its bodies")
        if not mock and self.mock_bodies:
            raise DriverError(f"{self.where}: mock_bodies is only for type mock; leave it out")
        for name, place in self.mock_bodies:
            if not name or any(c in name for c in "();") or not all(map(math.isfinite, place)):
                raise DriverError(f"motion capture (mock): body {name!r} at {place!r}; give a plain name and finite m")
        if self.port is not None and not 1 <= self.port <= 65535:
            raise DriverError(f"motion capture ({self.type}): port is {self.port}; give 1 to 65535")
        if self.interface_ip is not None:
            if self.type != "optitrack":
                raise DriverError(f"{self.where}: interface_ip is only for optitrack; leave it out")
            try:
                ipaddress.IPv4Address(self.interface_ip)
            except ValueError:
                raise DriverError(
                    f"{self.where}: interface_ip is {self.interface_ip!r}; give this computer's numeric IPv4 address"
                ) from None

    def _check_numbers(self) -> None:
        if self.up not in ("y", "z"):
            raise DriverError(f"{self.where}: up is {self.up!r}; give y or z")
        if not all(map(math.isfinite, (self.yaw_rad, *self.translation_m))):
            raise DriverError(f"{self.where}: yaw_rad and translation_m must be finite numbers")
        for name in ("attempt_s", "bodies_s", "silence_s", "retry_s", "retry_max_s", "mock_rate_hz"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise DriverError(f"{self.where}: {name} is {value!r}; give a number above 0")
