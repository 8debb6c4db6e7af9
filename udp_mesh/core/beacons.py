"""When this node says who it is: beacons, answers and introductions.

Theory of operation, after Trickle (RFC 6206): quick while something is new, slow while nothing is.
* A node that starts sends a few beacons in quick succession (``START_INTERVALS``), since any may be lost. They list
  whom it hears, and ask everybody else to answer (a PROBE for ``ANYBODY``).
* Who is asked answers by one broadcast in a random slot; the more nodes, the more slots. One answer serves all who
  asked meanwhile, and a beacon that is due anyway is the answer.
* Then the interval is the configured one, or longer, so that the beacons of the whole team take half of
  ``beacon_share`` of the channel. The other half is for what starts and returns.
* A node that has nobody beacons at ``ALONE_PART`` of its interval, since whom it meets may be gone in seconds. It
  promises the usual interval all the same, which it keeps as soon as it has company.
* A beacon tells when the next will come, so that nobody misses one that was never promised. It is left out while
  every peer has just had a packet of ours; but never ``MAX_OMITTED`` times in a row, for those who do not know us yet.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.airtime import airtime_s
from udp_mesh.core.broadcasts import Broadcasts
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.peer import NEVER_S, Path
from udp_mesh.core.search import PROBE_BYTES
from udp_mesh.core.state import NodeState

ANYBODY = 0  # in place of a tag; no node has it
JITTER = 0.1
START_INTERVALS = (0.1, 0.2, 0.4)
STEADY_PART = 0.5
ALONE_PART = 0.25
MAX_INTERVAL_S = 60.0
MAX_OMITTED = 2
FRESH_PART = 0.5
SLOT_S = 0.004
SLOT_AIRTIMES = 4.0
START_AIRTIMES = 10.0
INTRODUCTION_INTERVAL_S = 0.05
NEWS_AFTER_S = 0.02
_MAX_INTRODUCTIONS = 256
_MAX_ANSWERS = 1024
_FOREVER_S = float("inf")


class Beacons:
    """This node's own beacons and answers."""

    def __init__(self, state: NodeState, broadcasts: Broadcasts, *, now: float) -> None:
        self._state = state
        self._broadcasts = broadcasts
        self._at_s = now
        self._starts_sent = 0
        self._omitted = 0
        self._answers: dict[int, None] = {}  # tags of nodes that look for us
        self._answer_at_s = _FOREVER_S
        self._introductions: dict[tuple[Path, int], bytes] = {}
        self._introduced_at_s: dict[tuple[Path, int], float] = {}

    # -- what is asked of it

    def answer(self, epoch: int) -> None:
        """Tell a node that looks for this one, at once."""
        self._note_answer(epoch, NEVER_S)

    def answer_in_turn(self, epoch: int, *, now: float) -> None:
        """Tell a node that asked everybody, in a random slot."""
        slot_s = max(SLOT_S, SLOT_AIRTIMES * self._beacon_airtime_s())
        self._note_answer(epoch, now + slot_s * self._state.rng.random() * (self._team() - 1))

    def _note_answer(self, epoch: int, at_s: float) -> None:
        if len(self._answers) < _MAX_ANSWERS:
            self._answers[wire.tag_of(epoch)] = None
        self._answer_at_s = min(self._answer_at_s, at_s)

    def introduce(self, epoch: int, path: Path, *, ask: bool, now: float) -> None:
        """Tell a stranger, or a peer that knows an older epoch of us, who we are; ``ask`` for its name, too."""
        tag = wire.tag_of(epoch)
        to = (path, tag if path.via else 0)  # many may be behind a bridge
        if now - self._introduced_at_s.get(to, NEVER_S) < INTRODUCTION_INTERVAL_S:
            return
        if len(self._introduced_at_s) >= _MAX_INTRODUCTIONS:
            self._introduced_at_s.clear()
        self._introduced_at_s[to] = now
        self._introductions[path, tag] = self.hello() + (wire.encode_probe([tag]) if ask else b"")

    def tell_soon(self, *, now: float) -> None:
        """Send a beacon in a moment: a bridge has news, perhaps of several nodes at once."""
        self._answer_at_s = min(self._answer_at_s, now + NEWS_AFTER_S)

    def greet(self, tag: int, path: Path) -> None:
        """Tell a node that a bridge speaks of who we are, and ask who it is."""
        if len(self._introductions) < _MAX_INTRODUCTIONS:
            self._introductions[path, tag] = self.hello() + wire.encode_probe([tag])

    # -- time

    def next_timer(self) -> float:
        """Return when :meth:`frames` or :meth:`introductions` has something."""
        return NEVER_S if self._introductions else min(self._at_s, self._answer_at_s)

    def frames(self, *, now: float) -> bytes:
        """Return what is to be broadcast now: a beacon, an answer, both in one, or nothing."""
        is_due = now >= self._at_s
        if not is_due and now < self._answer_at_s:
            return b""
        if is_due and not self._answers and self._may_omit(now=now):
            self._omitted += 1
            self._at_s = now + self._jittered(self.interval_s())
            return b""
        heard = tuple(self._answers)
        is_start = is_due and self._starts_sent <= len(START_INTERVALS)
        if is_start:
            online = [peer.session.tag for peer in self._state.peers.values() if peer.is_online]
            heard = tuple(dict.fromkeys((*heard, *online)))
        heard = heard[: self.max_tags()]
        self._answers.clear()
        self._answer_at_s = _FOREVER_S
        self._omitted = 0
        if is_due:
            self._schedule(now=now)
        return self.hello(heard=heard) + (wire.encode_probe([ANYBODY]) if is_start else b"")

    def _schedule(self, *, now: float) -> None:
        interval_s = self.interval_s()
        if self._starts_sent < len(START_INTERVALS):
            start_s = max(START_INTERVALS[0], START_AIRTIMES * self._beacon_airtime_s())
            interval_s = min(interval_s, start_s * START_INTERVALS[self._starts_sent] / START_INTERVALS[0])
        elif not any(peer.is_online for peer in self._state.peers.values()):
            interval_s = min(interval_s, self._alone_s())
        self._starts_sent += 1
        self._at_s = now + self._jittered(interval_s)

    def _jittered(self, interval_s: float) -> float:
        return interval_s * (1 + JITTER * (2 * self._state.rng.random() - 1))

    def _may_omit(self, *, now: float) -> bool:
        if self._state.settings.bridge or self._omitted >= MAX_OMITTED or self._starts_sent <= len(START_INTERVALS):
            return False
        since_s = now - FRESH_PART * self.interval_s()
        online = [peer for peer in self._state.peers.values() if peer.is_online]
        return bool(online) and all(peer.last_sent_s >= since_s for peer in online)

    def introductions(self, *, now: float) -> list[Datagram]:
        """Return the unicasts to strangers."""
        state = self._state
        out = [self._broadcasts.stray(path, tag, frames) for (path, tag), frames in self._introductions.items()]
        self._introductions.clear()
        for datagram in out:
            state.charge(datagram.path, len(datagram.data), now=now)
        return out

    # -- how often

    def interval_s(self) -> float:
        """Return the time between beacons while nothing is new."""
        return max(self._state.settings.beacon_interval_s, self._shared_s())

    def _shared_s(self) -> float:
        """Return the least interval at which the whole team's beacons keep to their share of the channel."""
        shared_s = self._team() * self._beacon_airtime_s() / (STEADY_PART * self._state.settings.beacon_share)
        return min(shared_s, MAX_INTERVAL_S)

    def _alone_s(self) -> float:
        """Return the time between beacons of a node that has nobody; on the slowest path that it knew they are few."""
        settings = self._state.settings
        capacities_bps = (peer.congestion.capacity_bps for peer in self._state.peers.values())
        slowest_bps = min((bps for bps in capacities_bps if bps), default=_FOREVER_S)
        fair_s = 8 * PROBE_BYTES / (settings.beacon_share * slowest_bps)
        return max(ALONE_PART * settings.beacon_interval_s, self._shared_s(), fair_s)

    def _team(self) -> int:
        return 1 + sum(peer.is_online and not peer.path.via for peer in self._state.peers.values())

    def _beacon_airtime_s(self) -> float:
        settings = self._state.settings
        size_bytes = wire.HEADER_BYTES + wire.HELLO_BYTES + len(settings.name.encode())
        return self._state.broadcast_copies * airtime_s(size_bytes, channel_bps=settings.channel_bps)

    def max_tags(self) -> int:
        """Return how many tags an answer and a probe may hold, each, if both leave in one datagram."""
        room = self._state.broadcast_bytes - 2 * len(self.hello()) - wire.HEADER_BYTES - 2
        return min(wire.MAX_TAGS, room // 8)

    def hello(self, *, heard: tuple[int, ...] = ()) -> bytes:
        """Return the frame that says who this node is; ``heard``: tags of nodes that shall know that we hear them."""
        state = self._state
        floor = min((next(iter(p.lane.transfers), state.next_message_id) for p in state.peers.values()), default=0)
        slowest_s = max((c.control_interval_s(PROBE_BYTES) for c in state.carriers.values()), default=0.0)
        return wire.encode_hello(
            name=state.settings.name,
            beacon_interval_s=max(self.interval_s(), slowest_s),
            floor=min(floor, state.floor(state.broadcast)),
            heard=heard,
        )
