"""To whom a simulated NatNet server sends its frames: one data port per client, dropped when nobody listens there.

libmotioncapture 1.1 never says where it is: it binds the data port that the server names in its answer to CONNECT, with
SO_REUSEADDR, and a machine hands each unicast datagram to one socket only. Two clients on one machine therefore get
two ports.
"""

from __future__ import annotations

import socket
from dataclasses import dataclass, field

Address = tuple[str, int]

_NOWHERE = "127.88.88.88"

GRACE_S = 3.0
"""A client binds its data port only after it has read the model: until then a closed port means nothing."""


@dataclass
class _Client:
    command: Address
    port: int
    sender: socket.socket
    reservation: socket.socket | None
    since_s: float
    wants_frames: bool = field(default=False)


class Clients:
    """The clients of one server.

    Args:
        address: the server's own, from which it sends.
        data_port: of the first client on each machine, the next ones get the next free ports; 0: any free port.
    """

    def __init__(self, address: str, data_port: int) -> None:
        self._address, self._data_port = address, data_port
        self._clients: dict[Address, _Client] = {}

    def __len__(self) -> int:
        return len(self._clients)

    def meet(self, command: Address, now_s: float) -> int:
        """The data port of the client that asked from ``command``; a new one for a new client."""
        known = self._clients.get(command)
        if known is not None:
            return known.port
        kept = self._reserve(command[0])
        port = self._data_port if kept is None else int(kept.getsockname()[1])
        sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sender.setblocking(False)
        sender.bind((self._address, 0))
        sender.connect((command[0], port))  # connected, it learns when nobody listens there any more
        self._clients[command] = _Client(command, port, sender, kept, now_s)
        return port

    def begin(self, command: Address) -> None:
        """The client has the model: frames may flow."""
        if command in self._clients:
            self._clients[command].wants_frames = True

    def leave(self, command: Address) -> None:
        """The client said goodbye."""
        client = self._clients.pop(command, None)
        if client is None:
            return
        client.sender.close()
        if client.reservation is not None:
            client.reservation.close()

    def send(self, packet: bytes, now_s: float) -> None:
        """Sends one frame to everybody; forgets those that have gone."""
        for client in list(self._clients.values()):
            if not client.wants_frames:
                if now_s - client.since_s > GRACE_S:
                    self.leave(client.command)
                continue
            try:
                client.sender.send(packet)
            except ConnectionRefusedError:
                if now_s - client.since_s > GRACE_S:
                    self.leave(client.command)
            except OSError:  # full, or the network is down for a moment: a frame is lost, as on any network
                continue

    def close(self) -> None:
        """Releases the sockets."""
        for command in list(self._clients):
            self.leave(command)

    def _reserve(self, host: str) -> socket.socket | None:
        """Keeps a port for a new client; None when there is none to be had, which the client has to live with."""
        if self._data_port == 0:
            return _reserved(0)
        taken = {client.port for client in self._clients.values() if client.command[0] == host}
        ports = range(self._data_port, min(self._data_port + 100, 65536))
        return next((kept for port in ports if port not in taken and (kept := _reserved(port))), None)


def _reserved(port: int) -> socket.socket | None:
    """A socket that keeps a port (0: any) from other servers, None when it is in use.

    It is bound to an address that nobody sends to, so that it takes no frame away, and becomes shareable only then: the
    client's own socket, which is bound to every address, can join it, another reservation cannot.
    """
    kept = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        kept.bind((_NOWHERE, port))
    except OSError:
        kept.close()
        return None
    kept.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    return kept
