"""What the parts of one core share: settings, peers, the queue, events, counters. No rules."""

from __future__ import annotations

from collections import Counter, deque
from random import Random

from udp_mesh.core import wire
from udp_mesh.core.carriers import Carrier, Path
from udp_mesh.core.congestion import CongestionControl, FixedWindow
from udp_mesh.core.delay_control import DelayControl
from udp_mesh.core.events import Event
from udp_mesh.core.peer import Lane, Peer
from udp_mesh.core.reassembly import ReassemblyMemory
from udp_mesh.core.scheduler import Scheduler
from udp_mesh.core.settings import BROADCAST_NAME, Settings


class NodeState:
    """One node."""

    def __init__(self, settings: Settings, *, epoch: int, rng: Random) -> None:
        self.settings = settings
        self.epoch = epoch
        self.tag = wire.tag_of(epoch)
        self.rng = rng
        self.memory = ReassemblyMemory(settings.reassembly_bytes)
        self.scheduler = Scheduler()
        self.peers: dict[str, Peer] = {}
        self.by_epoch: dict[int, Peer] = {}
        self.broadcast = Lane(BROADCAST_NAME)
        self.carriers: dict[int, Carrier] = {}
        self.events: deque[Event] = deque()
        self.counters: Counter[str] = Counter()
        self.next_message_id = 0

    def lane(self, name: str) -> Lane:
        """Return the lane of a known destination."""
        return self.broadcast if name == BROADCAST_NAME else self.peers[name].lane

    def take_message_id(self) -> int:
        """Return a new message id."""
        self.next_message_id += 1
        return self.next_message_id - 1

    def floor(self, lane: Lane) -> int:
        """Return the least message id that is not settled for this destination, broadcasts included."""
        return min(
            next(iter(lane.transfers), self.next_message_id), next(iter(self.broadcast.transfers), self.next_message_id)
        )

    def packet_bytes(self, carrier: int) -> int:
        """Return the largest datagram for a carrier, before it is sealed."""
        known = self.carriers.get(carrier)
        beyond = 0 if known is None else max(0, self.settings.payload_bytes - known.mtu_bytes)
        return self.settings.packet_bytes - beyond

    def is_rated(self, path: Path) -> bool:
        """Whether what the path's carrier takes is known beforehand."""
        carrier = self.carriers.get(path.carrier)
        return carrier is not None and carrier.rate_bps > 0

    def charge(self, path: Path, size_bytes: int, *, now: float) -> None:
        """Charge a datagram to its carrier."""
        carrier = self.carriers.get(path.carrier)
        if carrier is not None:
            carrier.on_sent(size_bytes, now=now)

    @property
    def broadcast_bytes(self) -> int:
        """Largest datagram that fits every carrier, before it is sealed."""
        return min((self.packet_bytes(carrier) for carrier in self.carriers), default=self.settings.packet_bytes)

    def new_congestion(self, carrier: int, *, now: float) -> CongestionControl:
        """Return the congestion control that the settings ask for."""
        if self.settings.window:
            return FixedWindow(self.settings.window, datagram_bytes=self.packet_bytes(carrier))
        return DelayControl(datagram_bytes=self.packet_bytes(carrier), now=now)
