"""What a node remembers of another node, and of one epoch of it. State only; the rules are elsewhere."""

from __future__ import annotations

from collections import deque
from collections.abc import Container
from dataclasses import dataclass, field

from udp_mesh.core import wire
from udp_mesh.core.ack_requests import AckRequests
from udp_mesh.core.acks import AckTracker
from udp_mesh.core.carriers import Path
from udp_mesh.core.congestion import CongestionControl
from udp_mesh.core.messages import Transfer
from udp_mesh.core.pacer import Pacer
from udp_mesh.core.paths import Paths
from udp_mesh.core.reassembly import Reassembler, ReassemblyMemory
from udp_mesh.core.recovery import Recovery
from udp_mesh.core.rtt import RttEstimator

REMEMBERED_EPOCHS = 16
NEVER_S = float("-inf")

__all__ = ["NEVER_S", "REMEMBERED_EPOCHS", "Lane", "Path", "Peer", "Session"]


@dataclass(slots=True)
class Lane:
    """Unfinished transfers to one destination, by message id, in order of publication."""

    name: str
    transfers: dict[int, Transfer] = field(default_factory=dict)
    newest: dict[str, Transfer] = field(default_factory=dict)
    """By topic, for topics of which only the newest message is kept."""


class Session:
    """What holds for one epoch of a peer only."""

    def __init__(self, epoch: int, memory: ReassemblyMemory, *, now: float) -> None:
        self.epoch = epoch
        self.tag = wire.tag_of(epoch)
        self.rtt = RttEstimator()
        self.recovery = Recovery(rtt=self.rtt, now=now)
        self.acks = AckTracker()
        self.ack_requests = AckRequests()
        self.reassembler = Reassembler(memory)
        self.floor_sent = 0
        self.control: list[bytes] = []  # frames for the next datagram
        self.greeting: list[bytes] = []  # frames that go ahead of whatever is sent first
        self.ping_wanted = False
        self.reply_path: Path | None = None  # by which the newest packet came that asks for an acknowledgement
        self.probe_credits = 0  # packets that may leave whatever the window says


class Peer:
    """Another node, by name. Its queue, window and rate survive outages; a restart replaces only the session."""

    def __init__(self, name: str, session: Session, path: Path, congestion: CongestionControl, *, now: float) -> None:
        self.lane = Lane(name)
        self.session = session
        self.congestion = congestion
        self.pacer = Pacer()
        self.path = path
        self.paths = Paths()
        self.is_online = False
        self.is_proven = False  # has shown that it hears us since it was last held offline
        self.needs_evidence = False  # hearing it is not enough: it did not hear us
        self.beacon_interval_s = 1.0
        self.last_heard_s = now
        self.last_sent_s = NEVER_S
        self.waiting_since_s: float | None = None  # oldest unanswered packet since it last showed that it hears us
        self.grace_until_s = NEVER_S  # not held offline before: this node itself was asleep
        self.down_since_s = NEVER_S
        self.last_traffic_s = NEVER_S
        self.last_window_event_s = NEVER_S
        self.was_limited = False
        self.backlog_priority = 255  # the most urgent of what it said waits there
        self.backlog_until_s = NEVER_S
        self.retired: deque[int] = deque(maxlen=REMEMBERED_EPOCHS)
        self.retired_at_s = NEVER_S

    def ack_path(self, carriers: Container[int]) -> Path:
        """Return by which path an acknowledgement goes: back the way the newest packet came."""
        reply = self.session.reply_path
        return self.path if reply is None or reply.carrier not in carriers else reply

    @property
    def name(self) -> str:
        """The node's name."""
        return self.lane.name
