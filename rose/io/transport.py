"""What carries a service's datagrams; the service does not know more of it than this."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

from rose.core.addressing import ServiceId

OnDatagram = Callable[[bytes, bool], None]
"""Called with a datagram, and whether it came from this host over loopback: its answer goes back that way."""


class Transport(ABC):
    """One service's way to all others. Sending never waits and never raises: what cannot leave now is counted."""

    #: The longest datagram that it takes whole.
    datagram_bytes: int
    #: Datagrams that could not be sent: no route, no interface, no room in the socket's buffer, no daemon.
    unsent: int = 0

    @abstractmethod
    async def open(self, sid: ServiceId, on_datagram: OnDatagram) -> None:
        """Begin; every datagram that arrives is given to ``on_datagram``.

        Raises:
            RoseError: Another program has the service's port, or there is no daemon.
        """

    @abstractmethod
    async def close(self) -> None:
        """End; no datagram is given out any more."""

    @abstractmethod
    def publish(self, datagrams: Sequence[bytes]) -> None:
        """Send to the service's own group."""

    @abstractmethod
    def send(self, to: ServiceId, datagrams: Sequence[bytes], *, local: bool = False) -> None:
        """Send to another service's unicast address; ``local``: of this host, which works without a network."""

    @abstractmethod
    def announce(self, datagrams: Sequence[bytes]) -> None:
        """Send to where hosts announce themselves."""

    @abstractmethod
    def join_announcements(self) -> None:
        """Receive what hosts announce."""

    @abstractmethod
    def join(self, sender: ServiceId) -> None:
        """Receive what a service publishes from now on, through every loss and return of the network."""

    @abstractmethod
    def leave(self, sender: ServiceId) -> None:
        """Receive it no longer."""
