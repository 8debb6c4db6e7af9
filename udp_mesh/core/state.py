"""What the parts of one core share: settings, peers, the queue, events, counters. No rules."""

from __future__ import annotations

from collections import Counter, deque
from random import Random

from udp_mesh.core import wire
from udp_mesh.core.carriers import NEVER_S, UNLIMITED_BYTES, Carrier, Path
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
        self.links: dict[int, Carrier] = {}  # behind bridges, by the ``via`` of paths
        self.events: deque[Event] = deque()
        self.counters: Counter[str] = Counter()
        self.next_message_id = 0

    def peer_of_tag(self, tag: int) -> Peer | None:
        """Return the peer whose present epoch has this short form."""
        return next((peer for epoch, peer in self.by_epoch.items() if wire.tag_of(epoch) == tag), None)

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

    def hops(self, path: Path) -> list[Carrier]:
        """Return the carrier of a path, and the link behind the bridge if there is one."""
        carrier = self.carriers.get(path.carrier)
        hops = [] if carrier is None else [carrier]
        return [*hops, self.links[path.via]] if path.via else hops

    def packet_bytes(self, path: Path) -> int:
        """Return the largest datagram for a path, before it is sealed."""
        mtu_bytes = min((hop.mtu_bytes for hop in self.hops(path)), default=UNLIMITED_BYTES)
        return self.settings.packet_bytes - max(0, self.settings.payload_bytes - mtu_bytes)

    def rate_bps(self, path: Path) -> float:
        """Return what a path carries where that is known beforehand, else 0."""
        return min((hop.rate_bps for hop in self.hops(path) if hop.rate_bps), default=0.0)

    def charge(self, path: Path, size_bytes: int, *, now: float) -> None:
        """Charge a datagram to what carries it."""
        for hop in self.hops(path):
            hop.on_sent(size_bytes, now=now)

    def free_at_s(self, path: Path) -> float:
        """Return when a path of known rate has sent what it was given: what waits there, priorities do not rule."""
        if path.via:
            return max(hop.busy_until_s for hop in self.hops(path))
        carrier = self.carriers.get(path.carrier)
        return NEVER_S if carrier is None else carrier.busy_until_s

    def broadcast_paths(self, carrier: Carrier) -> list[Path]:
        """Return where a broadcast goes: to all at once, or where neighbours are fixed, to each and to who is heard."""
        if carrier.neighbours is None:
            return [Path(carrier.index, "")]
        heard = [p.path.address for p in self.peers.values() if p.is_online and p.path.carrier == carrier.index]
        return [Path(carrier.index, address) for address in dict.fromkeys((*carrier.neighbours, *heard))]

    def has_broadcast(self, path: Path) -> bool:
        """Whether what is broadcast reaches whoever is behind this path."""
        carrier = self.carriers.get(path.carrier)
        return not path.via and carrier is not None and carrier.neighbours is None

    @property
    def broadcast_copies(self) -> int:
        """How many datagrams a broadcast is on the carrier where it is most, at least 1."""
        return max((len(self.broadcast_paths(carrier)) for carrier in self.carriers.values()), default=1) or 1

    @property
    def broadcast_bytes(self) -> int:
        """Largest datagram that fits every carrier, and every bridged peer's link, before it is sealed."""
        paths = [Path(carrier, "") for carrier in self.carriers]
        if self.links:
            paths += [peer.path for peer in self.peers.values() if peer.is_online and peer.path.via]
        return min(map(self.packet_bytes, paths), default=self.settings.packet_bytes)

    def new_congestion(self, path: Path, *, now: float) -> CongestionControl:
        """Return the congestion control that the settings ask for."""
        if self.settings.window:
            return FixedWindow(self.settings.window, datagram_bytes=self.packet_bytes(path))
        return DelayControl(
            datagram_bytes=self.packet_bytes(path),
            rate_bps=self.rate_bps(path),
            shared_bps=self.settings.shared_bps,
            now=now,
        )
