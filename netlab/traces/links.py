"""What became of frames between interfaces, for runs whose medium gives no verdicts on single frames.

A frame that left one interface arrived at another if the same bytes came in there. Why a frame is missing is told by
what the lab recorded of the pair: its state when the frame was sent (outage, out of range, no carrier), and the
kernel's counters at the beginning and at the end (frames that found the queue full, frames still in it). The rest was
lost by the loss model. Without counters, lost and queue full are not told apart.

Of equal frames that are under way at the same time it is not known which one is missing, only how many are. A frame
sent in the instant of a change of state may be put down to the state before. Where frames take no time their arrivals
may be recorded before their departures: within one instant an arrival waits for its departure.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.model import Interface, LinkCounts

_GROUP = 0x01  # the bit of a destination address that makes it broadcast or multicast
_MISSING_WHILE = {
    "outage": Verdict.OUTAGE,
    "no_carrier": Verdict.OUTAGE,  # a pulled cable is an administrative cut
    "out_of_range": Verdict.OUT_OF_RANGE,
}
Pair = tuple[Interface, Interface]


@dataclass(frozen=True, slots=True)
class KernelCounts:
    """The kernel's counters of a pair at one time, in frames; see :class:`netlab.engines.base.PairCounters`."""

    queue_full: int | None
    waiting: int
    reordered: int


@dataclass(slots=True)
class _Sent:
    """Frames of the same bytes: who sends them, how many, who got how many, and to whom they could not get."""

    sender: Interface
    count: int = 0
    cut: Mapping[Interface, Verdict] = field(default_factory=dict)
    arrived: dict[Interface, int] = field(default_factory=dict)


@dataclass(slots=True)
class _Offered:
    frames: int = 0
    size_bytes: int = 0

    def add(self, size_bytes: int) -> None:
        self.frames += 1
        self.size_bytes += size_bytes


@dataclass(slots=True)
class _Fate:
    """What is known of the frames of one pair."""

    unicast: _Offered = field(default_factory=_Offered)
    arrived: int = 0
    copies: int = 0
    changed: int = 0  # frames that nobody sent, from a sender whose frames are corrupted on the way
    corrupts: bool = False
    cut: dict[Verdict, int] = field(default_factory=dict)  # sent while they could not arrive, and did not
    first: KernelCounts | None = None
    last: KernelCounts | None = None

    @property
    def queue_full(self) -> int | None:
        """Between the first and the last counters; None if that is not known."""
        if self.first is None or self.last is None or self.first is self.last:
            return None
        if self.first.queue_full is None or self.last.queue_full is None:
            return None
        return self.last.queue_full - self.first.queue_full

    @property
    def reordered(self) -> int:
        return self.last.reordered - self.first.reordered if self.first and self.last else 0


class PacketLinks:
    """Counts frames per directed pair of interfaces. Packets and states must come in the order of time.

    Args:
        macs: The address of each interface, from the run's metadata; interfaces without one get no entry.
    """

    def __init__(self, macs: dict[bytes, Interface]) -> None:
        self._macs = macs
        self._interfaces = frozenset(macs.values())  # of the plan: a mesh interface's frames travel inside theirs
        self._sent: dict[int, _Sent] = {}  # by the frame's checksum
        self._group: dict[Interface, _Offered] = {}
        self._fates: dict[Pair, _Fate] = {}
        self._cut: dict[Interface, dict[Interface, Verdict]] = {}  # by sender; replaced, never changed
        self._instant_ns = 0
        self._early: list[PacketRecord] = []  # arrivals of this instant that nobody has sent yet

    def state(self, pair: Pair, state: str, *, corrupts: bool = False, counts: KernelCounts | None = None) -> None:
        """A pair's state from now on, and the kernel's counters now, where they were asked for."""
        fate, cut = self._fate(pair), dict(self._cut.get(pair[0], {}))
        cut.pop(pair[1], None)
        if state in _MISSING_WHILE:
            cut[pair[1]] = _MISSING_WHILE[state]
        self._cut[pair[0]] = cut
        fate.corrupts |= corrupts
        if counts is not None:
            fate.first, fate.last = fate.first or counts, counts

    def packet(self, record: PacketRecord) -> None:
        """Count one packet at one interface."""
        if record.t_ns != self._instant_ns:
            self._end_instant()
            self._instant_ns = record.t_ns
        here, target = (record.node, record.interface), self._macs.get(record.frame[:6])
        if here not in self._interfaces:
            return
        if record.direction is not Direction.OUTBOUND:
            self._early.append(record) if self._is_early(here, record) else self._inbound(record)
        elif record.frame[:1] and (record.frame[0] & _GROUP or target is not None):
            self._leaves(here, target, record)
            self._admit_early()

    def counts(self) -> dict[Pair, LinkCounts]:
        """One entry per pair that was addressed by unicast or over which anything ever arrived."""
        self._end_instant()
        links = {}
        for pair, fate in sorted(self._fates.items()):
            group = self._group.get(pair[0], _Offered())
            frames = fate.unicast.frames + group.frames
            if frames and (fate.unicast.frames or fate.arrived):
                links[pair] = _link(fate, frames, fate.unicast.size_bytes + group.size_bytes)
        return links

    def _admit_early(self) -> None:
        still_early: list[PacketRecord] = []
        for record in self._early:
            if self._is_early((record.node, record.interface), record):
                still_early.append(record)
            else:
                self._inbound(record)
        self._early = still_early

    def _end_instant(self) -> None:
        early, self._early = self._early, []
        for record in early:
            self._inbound(record)

    def _is_early(self, here: Interface, record: PacketRecord) -> bool:
        sent = self._sent.get(record.crc32)
        return sent is None or sent.arrived.get(here, 0) >= sent.count

    def _inbound(self, record: PacketRecord) -> None:
        here, target = (record.node, record.interface), self._macs.get(record.frame[:6])
        if (sent := self._sent.get(record.crc32)) is None:
            sender = self._macs.get(record.frame[6:12])
            if sender is not None and (fate := self._fates.get((sender, here))) and fate.corrupts:
                fate.changed += 1
        elif target in (here, None) and here != sent.sender:
            self._arrives(here, sent)

    def _fate(self, pair: Pair) -> _Fate:
        return self._fates.setdefault(pair, _Fate())

    def _leaves(self, here: Interface, target: Interface | None, record: PacketRecord) -> None:
        cut = self._cut.get(here, {})
        if target is None:
            self._group.setdefault(here, _Offered()).add(record.original_length)
        else:
            self._fate((here, target)).unicast.add(record.original_length)
            cut = {target: cut[target]} if target in cut else {}
        for receiver, verdict in cut.items():
            missing = self._fate((here, receiver)).cut
            missing[verdict] = missing.get(verdict, 0) + 1
        sent = self._sent.get(record.crc32)
        if sent is None or sent.sender != here:
            sent = self._sent[record.crc32] = _Sent(here)
        sent.count += 1
        sent.cut = cut

    def _arrives(self, here: Interface, sent: _Sent) -> None:
        fate = self._fate((sent.sender, here))
        arrived = sent.arrived[here] = sent.arrived.get(here, 0) + 1
        if arrived > sent.count:
            fate.copies += 1
            return
        fate.arrived += 1
        if here in sent.cut:
            fate.cut[sent.cut[here]] -= 1


def _link(fate: _Fate, frames: int, size_bytes: int) -> LinkCounts:
    corrupted = min(fate.changed, frames - fate.arrived)
    reordered = min(fate.reordered, fate.arrived)
    missing = max(0, frames - fate.arrived - corrupted - sum(fate.cut.values()))
    waiting = min(missing, fate.last.waiting) if fate.last else 0  # their fate is open, so they do not count at all
    frames, missing = frames - waiting, missing - waiting
    queue_full = fate.queue_full
    told = {
        Verdict.DELIVERED: fate.arrived - reordered,
        Verdict.CORRUPTED: corrupted,
        Verdict.DUPLICATED: fate.copies,
        Verdict.REORDERED: reordered,
        **fate.cut,
    }
    untold = 0
    if queue_full is not None:
        told[Verdict.QUEUE_FULL] = min(queue_full, missing)
        told[Verdict.LOST] = missing - told[Verdict.QUEUE_FULL]
    else:
        untold = missing
    return LinkCounts(
        # As with verdicts, an extra copy is one more entry.
        frames=frames + fate.copies,
        size_bytes=size_bytes,
        verdicts={verdict: count for verdict, count in told.items() if count},
        lost_or_queue_full=untold,
    )
