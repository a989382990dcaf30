"""What happens to a vehicle when this program dies without having brought it down."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Argument = str | int | float | bool | None
Arguments = Mapping[str, Argument]


@dataclass(frozen=True, slots=True)
class LastWill:
    """Instructions for the guardian, a process of its own that outlives this one.

    Attributes:
        vehicle: its id.
        module: a module of ``drivers`` with ``carry_out(arguments, height_m, deadline_s) -> str``, which opens its own
            link, brings the vehicle down (or stops it) by ``deadline_s`` on ``time.monotonic()``, and says what it did.
            Where it has a ``prepare()``, that loads before the flight what takes long to load.
        arguments: what that function needs, JSON types only.
    """

    vehicle: str
    module: str
    arguments: dict[str, Argument] = field(default_factory=dict)
