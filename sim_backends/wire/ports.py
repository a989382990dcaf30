"""Free places on this computer: UDP ports, loopback addresses, ROS domains. Each may be taken a moment later."""

from __future__ import annotations

import random
import socket
from collections.abc import Callable, Iterable
from typing import TypeVar

from sim_backends.errors import SimulationError

T = TypeVar("T")

_claims: dict[str, socket.socket] = {}

NATNET_PORTS = (1510,)
"""OptiTrack's command port: simulations side by side need an address each. The server itself gives each client a data
port: one client of any of them listens on 1511 at every address of this computer."""
MAX_DOMAIN = 101
"""Highest ROS domain whose ports (7400 + 250 domain + ...) lie below those that Linux gives away (32768...)."""


def free_udp_port(taken: Iterable[int] = ()) -> int:
    """A UDP port that nobody has bound on the loopback."""
    avoid = set(taken)
    while True:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.bind(("127.0.0.1", 0))
            port = int(probe.getsockname()[1])
        if port not in avoid:
            return port


def free_loopback() -> str:
    """A loopback address on which a NatNet server can be: 127.0.0.1 where it can, else another one.

    No other program gets the same one as long as this one runs.

    Raises:
        SimulationError: when none was found.
    """
    rng = random.Random()
    others = (f"127.{rng.randint(1, 250)}.{rng.randint(0, 250)}.{rng.randint(2, 250)}" for _ in range(50))
    return _first(
        "127.0.0.1", others, lambda a: _claimed(a) and all(_bindable(a, p) for p in NATNET_PORTS), "loopback address"
    )


def free_domain() -> int:
    """A ROS domain in which nobody takes part on this computer.

    Raises:
        SimulationError: when none was found.
    """
    rng = random.Random()
    numbers = iter(rng.sample(range(1, MAX_DOMAIN + 1), MAX_DOMAIN))
    # the first participant of a domain binds 7400 + 250 domain + 10 and 11 (DDSI-RTPS 2.3, 9.6.1)
    return _first(
        next(numbers), numbers, lambda d: all(_bindable("0.0.0.0", 7400 + 250 * d + k) for k in (10, 11)), "ROS domain"
    )


def _first(first: T, others: Iterable[T], good: Callable[[T], bool], what: str) -> T:
    for candidate in (first, *others):
        if good(candidate):
            return candidate
    raise SimulationError(f"no free {what} was found on this computer; end other simulations")


def _claimed(address: str) -> bool:
    """Whether this program has the address: two that start at once would both find it free until a server is there."""
    if address in _claims:
        return True
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0copcs-deploy NatNet {address}")  # a name in memory, which ends with its program
    except OSError:
        claim.close()
        return False
    _claims[address] = claim
    return True


def _bindable(address: str, port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((address, port))
        except OSError:
            return False
    return True
