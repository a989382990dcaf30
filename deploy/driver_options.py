"""The drivers' own options as sections of mission and fleet files; keys, defaults and limits are written over there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from drivers.errors import DriverError
from drivers.mavlink_options import MavlinkOptions
from drivers.mocap_options import MocapOptions


def _section(options: type[Any]) -> type[Any]:
    """A subclass whose mistakes are ``ValueError``s, which validation turns into an error with file and key."""

    def post_init(self: Any) -> None:
        try:
            options.__post_init__(self)
        except DriverError as error:
            raise ValueError(str(error)) from None

    names = {"__post_init__": post_init, "__doc__": options.__doc__, "__module__": __name__, "__slots__": ()}
    return dataclass(frozen=True)(type(options.__name__, (options,), names))


if TYPE_CHECKING:
    MavlinkSection = MavlinkOptions
    MocapSection = MocapOptions
else:
    MavlinkSection = _section(MavlinkOptions)
    MocapSection = _section(MocapOptions)

DriverOptions = MavlinkOptions
