"""What the core knows of a carrier: its number, how long a datagram may be there, and perhaps how fast it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

UNLIMITED_BYTES = 65_507
CONTROL_SHARE = 0.1
MAX_BROADCAST_WAIT_S = 1.0  # behind what a carrier of known rate has still to send
NEVER_S = float("-inf")


class Path(NamedTuple):
    """Where datagrams go: a carrier (by the number its owner gave it) and an address there.

    The core does not look into the address; the empty one means every node on the carrier. ``via``: 0 if the node
    itself is there; otherwise a bridge is, and this is the number of the link behind it (``NodeState.links``).
    """

    carrier: int
    address: str
    via: int = 0


@dataclass(slots=True)
class Carrier:
    """A way to reach other nodes, one datagram at a time, each to one of them or to all; or a link behind a bridge."""

    index: int
    mtu_bytes: int = UNLIMITED_BYTES
    """Longest datagram that fits, without the carrier's own headers."""
    rate_bps: float = 0.0
    """What it carries, where that is known and slow (a serial line); 0: congestion control finds out."""
    neighbours: tuple[str, ...] | None = None
    """Addresses to which broadcasts go one by one; None: the carrier has a broadcast."""
    busy_until_s: float = NEVER_S
    """When what was sent has left; only where the rate is known."""
    control_at_s: float = NEVER_S
    """When it may take the next beacon or probe."""

    def on_sent(self, size_bytes: int, *, now: float) -> None:
        """Charge a datagram to a carrier of known rate."""
        if self.rate_bps:
            self.busy_until_s = max(self.busy_until_s, now) + 8 * size_bytes / self.rate_bps

    def control_interval_s(self, size_bytes: int) -> float:
        """Return how far apart beacons of this size are at least, so that they take a tenth of the carrier."""
        return 8 * size_bytes / (CONTROL_SHARE * self.rate_bps) if self.rate_bps else 0.0

    def takes_control(self, *, now: float) -> bool:
        """Whether a beacon or probe may leave."""
        return not self.rate_bps or now >= self.control_at_s

    def on_control(self, size_bytes: int, *, now: float) -> None:
        """Count a beacon or probe that leaves."""
        self.control_at_s = now + self.control_interval_s(size_bytes)
