"""What every carrier offers to the daemon's loop, whatever is under it, and what the core is told of it."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Protocol

from udp_mesh.config_carriers import CarrierKind
from udp_mesh.core.mesh import Datagram, Path


@dataclass(frozen=True, slots=True)
class CarrierFacts:
    """A carrier that could be open now. It is opened anew when anything of this changes.

    ``name`` is an interface or a device; ``address`` and ``broadcast`` are texts as the kind writes them.
    """

    index: int
    kind: CarrierKind
    name: str
    interface_index: int = 0
    address: str = ""
    broadcast: str = ""
    mtu_bytes: int = 65_507
    """Longest datagram, without the carrier's own headers."""
    rate_bps: float = 0.0
    baud: int = 0
    neighbours: tuple[str, ...] | None = None
    """Addresses of fixed neighbours; None: broadcast."""


class CarrierSocket(Protocol):
    """An open carrier."""

    facts: CarrierFacts

    @property
    def is_broken(self) -> bool:
        """Whether it has to be closed, and opened again when it is there again."""

    @property
    def is_blocked(self) -> bool:
        """Whether it has refused datagrams that have to leave before anything else does."""

    @property
    def wants_write(self) -> bool:
        """Whether :meth:`send` should be called as soon as it takes more."""

    def fileno(self) -> int:
        """The descriptor to wait for."""

    def receive(self) -> Iterator[tuple[memoryview, int, Path, float]]:
        """Yield what has arrived: datagrams, the length of each, path, monotonic seconds. Valid until the next one."""

    def send(self, datagrams: list[Datagram], *, window_bytes: int) -> None:
        """Send datagrams of this carrier in order; keeps what is not taken now."""

    def close(self) -> None:
        """Close it."""


class SocketCarrier:
    """What carriers over one socket share. ``backlog``: refused by the full socket; leaves before anything else."""

    is_broken = False
    socket: socket.socket

    def __init__(self, facts: CarrierFacts) -> None:
        self.facts = facts
        self.backlog: list[Datagram] = []

    @property
    def is_blocked(self) -> bool:
        """Whether the socket was full."""
        return bool(self.backlog)

    @property
    def wants_write(self) -> bool:
        """Whether the socket was full."""
        return bool(self.backlog)

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self.socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()
