"""How many Crazyflies each radio carries. Pure: reads only their URIs."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from urllib.parse import urlparse

from drivers.vehicle import SelfCheck

VEHICLES_PER_RADIO = 4
"""A Crazyradio serves one vehicle at a time: poses, logs and repeats of more than four make each other late."""


def radio_of(uri: str) -> str | None:
    """The radio that a URI names, ``0`` or a serial number; None where it is no radio link."""
    parsed = urlparse(uri)
    return (parsed.netloc.upper() or "0") if parsed.scheme == "radio" else None


def channel_of(uri: str) -> str:
    """Channel, rate and address of a radio URI: what must differ between vehicles."""
    return urlparse(uri).path.strip("/").upper()


def vehicles_by_radio(uris: Mapping[str, str]) -> dict[str, list[str]]:
    """Vehicle ids by the radio that carries them; ``uris`` by vehicle id."""
    found: dict[str, list[str]] = defaultdict(list)
    for vehicle, uri in uris.items():
        radio = radio_of(uri)
        if radio is not None:
            found[radio].append(vehicle)
    return dict(found)


def radio_checks(uris: Mapping[str, str], most: int = VEHICLES_PER_RADIO) -> list[SelfCheck]:
    """One finding a radio: more than ``most`` vehicles is a warning, two vehicles at one address a failure."""
    checks = []
    for radio, vehicles in sorted(vehicles_by_radio(uris).items()):
        n = len(vehicles)
        addresses = [channel_of(uris[v]) for v in vehicles]
        names = ", ".join(vehicles)
        if len(set(addresses)) < n:
            text = f"radio {radio}: two of {names} have the same channel and address; give each its own"
            checks.append(SelfCheck("radio budget", "fail", text, n, "vehicles"))
        elif n > most:
            text = f"radio {radio} carries {names}: more than {most}; add a radio or slow down the poses"
            checks.append(SelfCheck("radio budget", "warn", text, n, "vehicles"))
        else:
            text = f"radio {radio} carries {names}"
            checks.append(SelfCheck("radio budget", "pass", text, n, "vehicles"))
    return checks
