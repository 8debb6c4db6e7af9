"""One node's mesh behind one object: frames, timers and events in, frames and events out. No clock, no socket."""

from __future__ import annotations

import random
from collections.abc import Sequence

from wnet.config import MeshConfig
from wnet.core.events import Count, Drop, Event
from wnet.core.members import Member, Outgoing, Reception
from wnet.core.snapshot import Snapshot

__all__ = ["Count", "Drop", "Member", "Mesh", "Outgoing", "Reception"]


class Mesh:
    """A node of the mesh.

    The owner calls :meth:`receive`, :meth:`originate` and, when :meth:`next_timer` has come, :meth:`handle_timer`; after
    each (or after a batch of them) it sends what :meth:`frames_to_send` gives, hands :meth:`take_delivered` to the mesh
    interface and looks at :meth:`next_event`.
    """

    def __init__(
        self,
        config: MeshConfig,
        mac: bytes,
        members: Sequence[Member],
        *,
        epoch: int,
        rng: random.Random,
        now: float,
    ) -> None:
        """Start with nothing known.

        Args:
            config: The settings.
            mac: The mesh interface's address, which names this node; no member has it.
            members: At most 16, known by their places.
            epoch: 32 bits, another one at every start; drawn at random, if there is a key from a source fit for keys.
            rng: For jitter and first sequence numbers.
            now: Monotonic seconds.
        """

    @property
    def mtu_bytes(self) -> int:
        """The MTU that the mesh interface may have: 1500, or less where a member or the seal leaves less."""
        return 1500

    @property
    def counts(self) -> dict[str, int]:
        """Everything counted so far, by the words of :class:`Count` and :class:`Drop`."""
        return {}

    def set_addresses(self, addresses: Sequence[bytes], *, now: float) -> None:
        """Tell this node's IPv4 addresses, of 4 bytes each: others then need not ask. Also learnt from its own ARP."""

    def originate(self, inner: bytes, *, now: float) -> None:
        """Take an Ethernet frame from the mesh interface: to a node, a group or all; ARP, IGMP and MLD are read."""

    def receive(self, member: int, frame: bytes, *, now: float, reception: Reception | None = None) -> None:
        """Take a frame that came from a member, from its destination address on; whatever it holds, nothing is raised."""

    def frames_to_send(self, *, now: float, room: Sequence[int] | None = None) -> list[Outgoing]:
        """Return what to send now, the most urgent first, and forget it.

        Args:
            now: Monotonic seconds; acknowledgements are awaited from here on.
            room: How many frames each member takes; None: as many as there are. What finds no room stays here, where
                more urgent frames overtake it and old ones are dropped.
        """
        return []

    def next_timer(self) -> float | None:
        """When :meth:`handle_timer` wants to be called; call it again after any other call."""
        return None

    def handle_timer(self, *, now: float) -> None:
        """Do what is due."""

    def take_delivered(self) -> list[bytes]:
        """Return, once, the Ethernet frames for the mesh interface."""
        return []

    def next_event(self) -> Event | None:
        """Return the oldest event not told yet. The newest thousand are kept."""
        return None

    def snapshot(self, *, now: float) -> Snapshot:
        """Return links, topology, routes, groups and counters."""
        raise NotImplementedError

    def count(self, what: Count | Drop) -> None:
        """Count what only the edge can see."""
