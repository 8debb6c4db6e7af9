"""What the core tells of a peer, and the client tells an application: one record on both ends."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class PeerStatus:
    """A peer as applications see it. ``rate_bps`` is the estimated rate of the path, 0 if never measured."""

    name: str
    online: bool
    carrier: int
    address: str
    silent_for_s: float
    srtt_s: float | None
    rate_bps: float
    cwnd_bytes: int
    queue_delay_s: float
    queued_messages: int
    queued_bytes: int
