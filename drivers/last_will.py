"""What happens to a vehicle when this program dies without having brought it down."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class LastWill:
    """Instructions for the guardian, a process of its own that outlives this one.

    Attributes:
        vehicle: its id.
        module: a module of ``drivers`` with ``carry_out(arguments, height_m, deadline_s) -> str``, which opens its own
            link, brings the vehicle down (or stops it) by ``deadline_s`` on ``time.monotonic()``, and says what it did.
        arguments: what that function needs, JSON types only.
    """

    vehicle: str
    module: str
    arguments: dict[str, str | int | float | bool | None] = field(default_factory=dict)
