"""How much may be in flight to a peer, and how fast it may leave: the interface and the fixed window of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from udp_mesh.core.rtt import RttEstimator


@dataclass(frozen=True, slots=True)
class AckSample:
    """What one acknowledgement says about a path. ``one_way_s`` is meaningful up to a constant, None without a sample.

    ``newest_bytes``: size of the packet that gave ``one_way_s``; ``received_us``: its arrival, see :class:`Ack`.
    ``in_flight_bytes``: what is still on its way. ``is_limited``: the window, not the application, held the sender
    back. ``lost_packets``: found lost with it.
    """

    acked_bytes: int
    acked_packets: int
    lost_packets: int
    one_way_s: float | None
    received_us: int
    newest_bytes: int
    rate_bps: float
    is_limited: bool
    in_flight_bytes: int


class CongestionControl(Protocol):
    """Decides the window of one peer."""

    @property
    def cwnd_bytes(self) -> int:
        """Bytes that may be in flight."""

    @property
    def pacing_rate_bps(self) -> float | None:
        """How fast they may leave; None is unpaced."""

    @property
    def ack_spacing_bytes(self) -> float:
        """Bytes after which an acknowledgement is worth its airtime; 0: with every second packet."""

    @property
    def urgent_packets(self) -> int:
        """Packets that may exceed the window and the pace, if no more than this many as urgent are in flight."""

    @property
    def queue_delay_s(self) -> float:
        """Estimated queueing delay on the forward path."""

    @property
    def rate_bps(self) -> float:
        """Estimated rate at which the path delivers; 0 before the first sample."""

    @property
    def capacity_bps(self) -> float:
        """The same, if the path was ever full; else 0, for what was sent says little about what could have been."""

    @property
    def datagram_bytes(self) -> int:
        """Largest datagram worth sending on this path."""

    def on_ack(self, sample: AckSample, *, rtt: RttEstimator, now: float) -> None:
        """Take an acknowledgement's sample."""

    def on_return(self, *, now: float) -> None:
        """The peer is back: delays measured before may no longer hold, the rate is still the best guess."""


class FixedWindow:
    """``packets`` in flight whatever happens: what the udp_mesh paper does with 3 (section IV.C.3)."""

    urgent_packets = 0
    pacing_rate_bps: float | None = None
    ack_spacing_bytes = 0.0
    queue_delay_s = 0.0
    capacity_bps = 0.0

    def __init__(self, packets: int, *, datagram_bytes: int) -> None:
        self.cwnd_bytes = packets * datagram_bytes
        self.datagram_bytes = datagram_bytes
        self.rate_bps = 0.0

    def on_ack(self, sample: AckSample, *, rtt: RttEstimator, now: float) -> None:
        """Only the rate estimate moves."""
        if sample.rate_bps:
            self.rate_bps += 0.125 * (sample.rate_bps - self.rate_bps)

    def on_return(self, *, now: float) -> None:
        """Nothing depends on the path."""
