"""The medium of all ports: which pairs a frame concerns, and what becomes of it on each. Pure: no clock, no I/O.

A wire carries every frame to its other end. A radio carries group frames to every port in range, and a unicast frame to
the port that owns its destination (by the port's own address, or by a source address that its node has used: bridges
and mesh interfaces send under others) and to monitors.

Where a radio's ports share a channel, frames wait for their turn: :meth:`Medium.transmit` only queues them, and
:meth:`Medium.advance` tells later what became of them.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from netlab.medium.chance import stable_seed
from netlab.medium.impairments import Impairment
from netlab.medium.pair import Outcome, Pair
from netlab.medium.segments import Port, Segment, SegmentKind
from netlab.medium.verdicts import Verdict

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from netlab.medium.channel_records import ChannelStats
    from netlab.medium.channel_segment import Sent, SharedChannel

_LEARNED_LIMIT = 4096  # addresses per radio segment beyond the ports' own
_ROUTES_LIMIT = 4096  # remembered destinations per sender


class _Radio:
    """Who owns which address on one radio segment."""

    __slots__ = ("_learned", "_own", "monitors", "owner")

    def __init__(self, ports: Sequence[Port]) -> None:
        self._own = frozenset(port.mac for port in ports)
        self._learned: dict[bytes, None] = {}  # in order of learning
        self.owner = {port.mac: port.index for port in ports}
        self.monitors = tuple(port.index for port in ports if port.monitor)

    def learn(self, mac: bytes, port: int) -> bool:
        """Note that ``port`` sends as ``mac``; the oldest goes where there are too many. True where that is news."""
        if mac in self._own or mac[0] & 1:
            return False
        if mac not in self._learned and len(self._learned) >= _LEARNED_LIMIT:
            oldest = next(iter(self._learned))
            del self._learned[oldest], self.owner[oldest]
        self._learned[mac] = None
        self.owner[mac] = port
        return True


class Medium:
    """Every pair's state. Same ports, segments, seed and frames: same outcomes."""

    def __init__(self, ports: Sequence[Port], segments: Iterable[Segment], seed: int) -> None:
        """``ports[i].index == i``; a port is on at most one segment.

        Raises:
            ValueError: A port on two segments, or a pair across segments.
        """
        self._ports = tuple(ports)
        self._seed = seed
        self._pairs: dict[tuple[int, int], Pair] = {}
        self._named: set[tuple[int, int]] = set()
        self._audience: list[list[Pair]] = [[] for _ in ports]  # of wires and of group frames
        self._segment: list[Segment | None] = [None] * len(self._ports)
        self._radio: list[_Radio | None] = [None] * len(self._ports)
        self._routes: list[dict[bytes, tuple[Pair, ...]]] = [{} for _ in ports]
        self._counts = [0] * len(Verdict)
        self._unaddressed = 0
        self._channels: dict[str, SharedChannel] = {}
        self._channel: list[SharedChannel | None] = [None] * len(self._ports)
        self._sent: list[Sent] = []
        for segment in segments:
            self._add(segment)

    @property
    def counts(self) -> dict[Verdict, int]:
        """How often each verdict was given so far."""
        return {verdict: self._counts[verdict] for verdict in Verdict}

    @property
    def unaddressed(self) -> int:
        """Unicast frames on a radio whose destination no port owns and no monitor heard."""
        return self._unaddressed

    @property
    def channel_stats(self) -> dict[str, ChannelStats]:
        """Counters of every shared channel by its segment's name."""
        return {name: channel.stats for name, channel in self._channels.items()}

    def transmit(self, sender: int, frame: bytes, *, now: float, tag: int = 0) -> list[Outcome]:
        """Decide on ``frame`` (from its destination address on, at least 14 bytes) sent at ``now``.

        ``tag`` comes back with what a shared channel decides later; a channel's frames must come in order of ``now``.

        Returns:
            (due_s, receiver port, frame as received, verdict) per receiver, twice where duplicated; due_s is
            ``pair.DROPPED``, a negative number, where nothing arrives. Never earlier than ``now`` otherwise. On a
            shared channel nothing but what found the queue full.
        """
        radio = self._radio[sender]
        pairs: Iterable[Pair]
        if radio is None:
            pairs = self._audience[sender]
        else:
            source = frame[6:12]
            if radio.owner.get(source) != sender and radio.learn(source, sender):
                self._forget_routes()
            if (channel := self._channel[sender]) is not None:
                return self._share(channel, sender, radio, frame, now, tag)
            pairs = self._audience[sender] if frame[0] & 1 else self._route(sender, radio, frame[:6])
        outcomes: list[Outcome] = []
        for pair in pairs:
            pair.offer(frame, now, outcomes)
        self._count(outcomes)
        return outcomes

    def next_event(self) -> float | None:
        """When :meth:`advance` may have something to tell if nothing is sent before; None: never."""
        known = [at_s for channel in self._channels.values() if (at_s := channel.next_event()) is not None]
        return min(known, default=None)

    def advance(self, *, now: float) -> list[Sent]:
        """Let the shared channels work until ``now``; returns what they have decided since the last call."""
        if not self._channels:
            return []
        for channel in self._channels.values():
            self._sent += channel.advance(now)
        sent, self._sent = self._sent, []
        for done in sent:
            self._count(done.outcomes)
        return sent

    def set_pairs(self, changes: Mapping[tuple[int, int], Impairment | None]) -> None:
        """Change pairs for later frames; None takes a pair out of range.

        Raises:
            ValueError: The two ports share no segment; nothing is changed then.
        """
        self._check(changes)
        for (sender, receiver), impairment in changes.items():
            self._heard(sender, receiver).configure(impairment)
        for channel, parts in self._by_channel(changes):
            channel.set_pairs({pair: changes[pair] for pair in parts})

    def set_outage(self, pairs: Iterable[tuple[int, int]], *, active: bool) -> None:
        """Lose every later frame on ``pairs`` silently, or end that.

        Raises:
            ValueError: The two ports share no segment; nothing is changed then.
        """
        chosen = list(pairs)
        self._check(chosen)
        for sender, receiver in chosen:
            if self._channel[sender] is None:
                self._pair(sender, receiver).set_outage(active)
        for channel, parts in self._by_channel(chosen):
            channel.set_outage(parts, active=active)

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Say how strongly the ports of a shared channel hear each other: ``[sender, receiver]`` in their order, dBm.

        Raises:
            ValueError: The segment has no shared channel, or not as many ports.
        """
        if segment not in self._channels:
            raise ValueError(f"segment '{segment}' is no shared channel")
        self._channels[segment].set_rssi(rssi_dbm)

    def signals_dbm(self, sent: Sent) -> dict[int, int]:
        """How strongly each receiver of ``sent`` hears its sender, in whole dBm."""
        return self._channel_of(sent.sender).signals_dbm(sent.sender, sent.outcomes)

    def inject(self, sender: int, frame: bytes, *, rate_bps: float | None, now: float, tag: int = 0) -> list[Outcome]:
        """Send from a port in monitor mode, on a shared channel: for whoever hears it, once, at ``rate_bps``.

        As :meth:`transmit` otherwise.
        """
        channel = self._channel_of(sender)
        self._sent += channel.advance(now)
        outcomes = channel.offer(sender, frame, None, now=now, tag=tag, rate_bps=rate_bps)
        self._count(outcomes)
        return outcomes

    def noise_dbm(self, port: int) -> float:
        """The noise at a port of a shared channel."""
        return self._channel_of(port).noise_dbm

    def _channel_of(self, port: int) -> SharedChannel:
        channel = self._channel[port]
        assert channel is not None, "only radios with airtime can be in monitor mode"
        return channel

    def _share(
        self, channel: SharedChannel, sender: int, radio: _Radio, frame: bytes, now: float, tag: int
    ) -> list[Outcome]:
        receiver = None
        if not frame[0] & 1:
            receiver = radio.owner.get(frame[:6])
            if receiver is None or receiver == sender:
                self._unaddressed += 1
                return []
        self._sent += channel.advance(now)
        outcomes = channel.offer(sender, frame, receiver, now=now, tag=tag)
        self._count(outcomes)
        return outcomes

    def _by_channel(self, pairs: Iterable[tuple[int, int]]) -> Iterable[tuple[SharedChannel, list[tuple[int, int]]]]:
        """Sort the pairs that are on shared channels."""
        found: dict[int, tuple[SharedChannel, list[tuple[int, int]]]] = {}
        for pair in pairs:
            if (channel := self._channel[pair[0]]) is not None:
                found.setdefault(id(channel), (channel, []))[1].append(pair)
        return found.values()

    def _count(self, outcomes: list[Outcome]) -> None:
        counts = self._counts
        for outcome in outcomes:
            counts[outcome[3]] += 1

    def _add(self, segment: Segment) -> None:
        members = [self._ports[index] for index in segment.ports]
        radio = _Radio(members) if segment.kind is SegmentKind.RADIO else None
        for port in members:
            if self._segment[port.index] is not None:
                raise ValueError(f"{port.node} {port.ifname} is on two segments; give the node another port")
            self._segment[port.index] = segment
            self._radio[port.index] = radio
        self._check(segment.pairs)
        for (sender, receiver), impairment in sorted(segment.pairs.items(), key=lambda item: item[0]):
            self._heard(sender, receiver).configure(impairment)
        if segment.channel is not None:
            from netlab.medium.channel_segment import SharedChannel  # tables that a lab of wires does without

            channel = self._channels[segment.name] = SharedChannel(segment, members, self._seed, self._pair)
            for port in members:
                self._channel[port.index] = channel

    def _heard(self, sender: int, receiver: int) -> Pair:
        """The pair, from now on among those that group frames of ``sender`` concern."""
        pair = self._pair(sender, receiver)
        if (sender, receiver) not in self._named:
            self._named.add((sender, receiver))
            insort(self._audience[sender], pair, key=lambda other: other.receiver)
        return pair

    def _pair(self, sender: int, receiver: int) -> Pair:
        """A pair that nobody has named is out of range, and can be told of an outage all the same."""
        pair = self._pairs.get((sender, receiver))
        if pair is None:
            a, b = self._ports[sender], self._ports[receiver]
            pair = Pair(receiver, None, stable_seed(self._seed, a.node, a.ifname, b.node, b.ifname))
            self._pairs[sender, receiver] = pair
        return pair

    def _route(self, sender: int, radio: _Radio, destination: bytes) -> tuple[Pair, ...]:
        routes = self._routes[sender]
        pairs = routes.get(destination)
        if pairs is None:
            if len(routes) >= _ROUTES_LIMIT:
                routes.clear()
            owner = radio.owner.get(destination)
            hearers = sorted({owner, *radio.monitors} - {sender, None}, key=lambda port: port or 0)
            pairs = routes[destination] = tuple(self._pair(sender, port) for port in hearers if port is not None)
        if not pairs:
            self._unaddressed += 1
        return pairs

    def _forget_routes(self) -> None:
        for routes in self._routes:
            routes.clear()

    def _check(self, pairs: Iterable[tuple[int, int]]) -> None:
        for sender, receiver in pairs:
            known = 0 <= sender < len(self._ports) and 0 <= receiver < len(self._ports) and sender != receiver
            if not known or self._segment[sender] is None or self._segment[sender] is not self._segment[receiver]:
                raise ValueError(f"ports {sender} and {receiver} share no segment")
