"""A run as its capture shows it: publications, deliveries, fragments on the senders' interfaces, what happened when.

Values only. All ``t_ns`` are CLOCK_REALTIME; :meth:`Trace.seconds` makes scenario time of them.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

from netlab.medium.verdicts import Verdict
from netlab.traces.daemon_log import DaemonLog

NS_PER_S = 1_000_000_000
EVERYBODY = "all"
Interface = tuple[str, str]  # node, interface


@dataclass(frozen=True, slots=True)
class Stream:
    """One traffic entry to one destination; lower ``priority`` is more urgent.

    ``keeps_latest``: the newest message is kept while the destination is away.
    """

    index: int
    source: str
    destination: str
    topic: str
    priority: int
    keeps_latest: bool = False

    def __str__(self) -> str:
        """Name it for a person."""
        return f"{self.topic} {self.source}->{self.destination}"


@dataclass(frozen=True, slots=True)
class Published:
    """One publish call. ``publication`` numbers the act: one publish to all makes a message of several streams."""

    stream: int
    publication: int
    seq: int
    t_ns: int
    size_bytes: int
    accepted: bool = True
    reason: str | None = None


@dataclass(frozen=True, slots=True)
class Delivery:
    """One receipt by the subscribing process."""

    stream: int
    seq: int
    published_ns: int
    t_ns: int
    size_bytes: int

    @property
    def latency_s(self) -> float:
        """From the publish call to here."""
        return (self.t_ns - self.published_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class Fragment:
    """One data fragment on an interface of its sender.

    ``destination`` is a node, ``all`` for a broadcast, empty if nothing tells. ``message`` is (publication, seq) for
    messages of netlab's own traffic, else None. ``is_copy``: its daemon sent it once more before it knew anything
    of the arrival of the one before (``redundancy``). ``address``: where a broadcast went, which a daemon with fixed
    neighbours sends to one after another; empty for all else.
    """

    t_ns: int
    interface: Interface
    epoch: int
    message_id: int
    index: int
    count: int
    priority: int
    destination: str
    frame_bytes: int
    message: tuple[int, int] | None = None
    is_copy: bool = False
    address: str = ""

    @property
    def node(self) -> str:
        """The sender."""
        return self.interface[0]


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the timeline. ``restores`` names the two nodes that can hear each other again.

    Of nodes in a mesh, ``reroutes`` names those that still had a path after this cut, ``rejoins`` those that had one
    again.
    """

    t_ns: int
    at_s: float
    label: str
    kind: str
    restores: tuple[str, str] | None = None
    reroutes: tuple[tuple[str, str], ...] = ()
    rejoins: tuple[tuple[str, str], ...] = ()


def killed_daemon(label: str) -> str | None:
    """The node whose udp_mesh daemon a timeline's step kills or starts; None if it means something else."""
    words = label.split()
    return words[3] if words[0:1] in (["kill"], ["start"]) and words[1:3] == ["udp_mesh", "on"] and words[3:] else None


@dataclass(frozen=True, slots=True)
class Window:
    """A flow's state as its sender's daemon reported it."""

    t_ns: int
    cwnd_bytes: float
    in_flight_bytes: float


@dataclass(frozen=True, slots=True)
class LinkState:
    """What the lab recorded of one directed pair of a segment from ``t_ns`` on.

    ``state``: ``up``, ``outage``, ``no_carrier`` or ``out_of_range``. ``delay_s`` and ``jitter_s`` are the link's own,
    None where nothing is said of them, as of radios; ``rate_bps`` None is unlimited or the radio's matter.
    """

    t_ns: int
    state: str
    delay_s: float | None = None
    jitter_s: float = 0.0
    rate_bps: float | None = None


@dataclass(frozen=True, slots=True)
class Remark:
    """Something worth a line beside a failure: peers that come and go, dropped messages."""

    t_ns: int
    node: str
    text: str


@dataclass(slots=True)
class LinkCounts:
    """What became of the frames of one directed pair of interfaces.

    ``lost_or_queue_full`` are frames that are missing for one of these two reasons and nobody knows for which; unless
    it is 0, ``verdicts`` has neither.
    """

    frames: int = 0
    size_bytes: int = 0
    verdicts: dict[Verdict, int] = field(default_factory=dict)
    lost_or_queue_full: int = 0


@dataclass(slots=True)
class Presence:
    """When one node held one peer online: alternating changes in the order of time."""

    t_ns: list[int] = field(default_factory=list)
    online: list[bool] = field(default_factory=list)

    def at(self, t_ns: int) -> bool:
        """Whether the peer was online; not before the first change."""
        index = bisect_right(self.t_ns, t_ns)
        return index > 0 and self.online[index - 1]


@dataclass(slots=True)
class Trace:
    """Everything the questions are asked of. Lists are in the order of time.

    Attributes:
        path: The capture, for messages to people.
        t0_ns: Scenario time zero.
        duration_s: Scenario time in which traffic was published.
        published: By stream.
        delivered: By stream.
        fragments: By sending node.
        presence: By (node, peer); empty when no daemon reported peers.
        windows: By (node, peer).
        rates_bps: Rate of the slowest link that starts at an interface, as (since t_ns, rate); None is unlimited.
        dropped_ns: When a node gave a message up, by (node, message id).
        links: By (sender, receiver).
        states: Of each directed pair of nodes on one segment, as (from, to, segment): its states in the order of time.
        segments: The segment of each interface of the plan.
        is_meshed: Whether nodes have interfaces besides those of the plan: a mesh below IP routes between them.
        macs: Whose interface an address is, as far as the run's metadata tells.
        addresses: Whose an IPv4 address is, as far as the run's metadata tells.
        daemons: What the daemons told of their messages and peers.
        notes: What is wrong with the capture.
    """

    path: str = ""
    t0_ns: int = 0
    duration_s: float = 0.0
    streams: tuple[Stream, ...] = ()
    published: dict[int, list[Published]] = field(default_factory=dict)
    delivered: dict[int, list[Delivery]] = field(default_factory=dict)
    fragments: dict[str, list[Fragment]] = field(default_factory=dict)
    timeline: list[Step] = field(default_factory=list)
    presence: dict[tuple[str, str], Presence] = field(default_factory=dict)
    windows: dict[tuple[str, str], list[Window]] = field(default_factory=dict)
    rates_bps: dict[Interface, list[tuple[int, float | None]]] = field(default_factory=dict)
    dropped_ns: dict[tuple[str, int], list[int]] = field(default_factory=dict)
    links: dict[tuple[Interface, Interface], LinkCounts] = field(default_factory=dict)
    states: dict[tuple[str, str, str], list[LinkState]] = field(default_factory=dict)
    segments: dict[Interface, str] = field(default_factory=dict)
    is_meshed: bool = False
    macs: dict[bytes, Interface] = field(default_factory=dict)
    addresses: dict[str, str] = field(default_factory=dict)
    daemons: DaemonLog = field(default_factory=DaemonLog)
    remarks: list[Remark] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def seconds(self, t_ns: int) -> float:
        """Scenario time."""
        return (t_ns - self.t0_ns) / NS_PER_S

    def is_for(self, fragment: Fragment, stream: Stream) -> bool:
        """Whether a fragment of a stream's message went to the stream's destination, too."""
        addressed = self.addresses.get(fragment.address, stream.destination)
        return addressed == stream.destination and fragment.destination in (stream.destination, EVERYBODY, "")

    def find_published(self, stream: int, seq: int) -> Published | None:
        """A stream's publication by its number."""
        return next((entry for entry in self.published.get(stream, []) if entry.seq == seq), None)

    def rate_bps(self, interface: Interface, t_ns: int) -> float | None:
        """Rate of an interface's slowest link at a time; None is unlimited."""
        changes = self.rates_bps.get(interface, [])
        index = bisect_right(changes, t_ns, key=lambda change: change[0])
        return changes[max(index - 1, 0)][1] if changes else None

    @property
    def end_ns(self) -> int:
        """When the duration was over."""
        return self.t0_ns + round(self.duration_s * NS_PER_S)
