"""Who is there: beacons, names and epochs, online and offline, and the search for peers that fell silent.

Theory of operation.
* A beacon (HELLO, broadcast) ties an epoch to a name. A new epoch of a known name is a restart; the old is retired.
* A peer that owes an answer and is silent for 0.5 s (or three probe timeouts, if longer) is offline; an idle one after
  three missed beacons. Nothing is sent to it by unicast then: the kernel would start address resolution, whose retries
  are a second apart, and the peer's return would wait for them.
* While this node has, or had in the last ten minutes, something for an offline peer, it broadcasts PROBE frames: every
  25 ms for two minutes, then each second; one for all such peers. Whom it names answers by broadcast. No back-off.
  On slow paths less often: probes take at most 2 % of what the path carried; if it was never full, one per round trip.
* Any packet revives a peer. One exception: a peer that was heard although it did not answer does not hear us; it is
  searched for, and returns when a unicast or an answer shows that it does.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.events import (
    NameConflict,
    PartialPurged,
    PeerDown,
    PeerDownReason,
    PeerUp,
    PeerUpReason,
)
from udp_mesh.core.outbox import Outbox
from udp_mesh.core.peer import NEVER_S, Path, Peer, Session
from udp_mesh.core.reassembly import Partial
from udp_mesh.core.routing import Router
from udp_mesh.core.state import NodeState
from udp_mesh.core.transmit import Transmitter

MAX_PEERS = 1024
BEACON_JITTER = 0.1
MISSED_BEACONS = 3.5  # three and some jitter
PROBE_INTERVAL_S = 0.025
PROBE_QUICK_FOR_S = 120.0
PROBE_SLOW_INTERVAL_S = 1.0
PROBE_RAREST_S = 10.0
PROBE_SHARE = 0.02
PROBE_BYTES = 128  # on the carrier, with its headers
PROBE_TRAFFIC_WITHIN_S = 600.0
CONFLICT_AFTER_S = 3.0
STALL_S = 0.05
STALL_GRACE_S = 0.1
INTRODUCTION_INTERVAL_S = 0.05
_MAX_INTRODUCTIONS = 256


def _probe_interval_s(peer: Peer) -> float:
    """Return how often to look for a peer: probes stay below a small part of what its path was seen to carry."""
    capacity_bps, rtt = peer.congestion.capacity_bps, peer.session.rtt
    unknown_s = rtt.min_s if rtt.has_sample else 0.0
    fair_s = 8 * PROBE_BYTES / (PROBE_SHARE * capacity_bps) if capacity_bps else unknown_s
    return min(max(PROBE_INTERVAL_S, fair_s), PROBE_RAREST_S)


class Liveness:
    """Peers' names, epochs and presence."""

    def __init__(self, state: NodeState, outbox: Outbox, transmitter: Transmitter, *, now: float) -> None:
        self._state = state
        self._outbox = outbox
        self._transmitter = transmitter
        self.router = Router(state, outbox)
        self._beacon_at_s = now
        self._probe_at_s = NEVER_S
        self._answers: dict[int, None] = {}  # tags of nodes that look for us
        self._introductions: dict[tuple[Path, int], bytes] = {}
        self._introduced_at_s: dict[Path, float] = {}

    # -- what was heard

    def on_hello(self, epoch: int, hello: wire.Hello, path: Path, *, now: float) -> Peer | None:
        """Return the peer that this HELLO names, created or restarted if need be; None if it cannot be believed."""
        state = self._state
        if hello.name == state.settings.name:
            self._refuse_name(hello.name, path, now=now)
            return None
        peer = state.by_epoch.get(epoch)
        if peer is None:
            peer = state.peers.get(hello.name)
            if peer is None:
                if len(state.peers) >= MAX_PEERS:
                    state.counters["too_many_peers"] += 1
                    return None
                peer = self._discover(epoch, hello.name, path, now=now)
            elif epoch in peer.retired:
                state.counters["retired_epoch"] += 1
                if now - peer.retired_at_s > CONFLICT_AFTER_S:  # no straggler: the earlier holder still runs
                    self._refuse_name(peer.name, path, now=now)
                return None
            else:
                self._restart(peer, epoch, path, now=now)
        elif peer.name != hello.name:
            state.counters["name_changed"] += 1
            return None
        if hello.beacon_interval_s > 0:
            peer.beacon_interval_s = hello.beacon_interval_s
        return peer

    def _refuse_name(self, name: str, path: Path, *, now: float) -> None:
        self._state.counters["name_conflicts"] += 1
        self._state.events.append(NameConflict(now, name, path.address))

    def _discover(self, epoch: int, name: str, path: Path, *, now: float) -> Peer:
        state = self._state
        session = Session(epoch, state.memory, now=now)
        peer = Peer(name, session, path, state.new_congestion(path.carrier, now=now), now=now)
        state.peers[name] = peer
        self._begin_session(peer, PeerUpReason.DISCOVERED, now=now)
        return peer

    def _restart(self, peer: Peer, epoch: int, path: Path, *, now: float) -> None:
        state = self._state
        old = peer.session
        del state.by_epoch[old.epoch]
        peer.retired.append(old.epoch)
        peer.retired_at_s = now
        self.report_purged(peer, old.reassembler.clear(), is_settled=False, now=now)
        peer.session = Session(epoch, state.memory, now=now)
        self._outbox.on_peer_restarted(peer, now=now)
        peer.path = path
        peer.paths.restart()
        peer.congestion.on_return(now=now)
        self._begin_session(peer, PeerUpReason.RESTARTED, now=now)

    def _begin_session(self, peer: Peer, reason: PeerUpReason, *, now: float) -> None:
        self._state.by_epoch[peer.session.epoch] = peer
        peer.session.control.append(self._hello())
        self._come_up(peer, reason, now=now)

    def heard(self, peer: Peer, path: Path, *, hears_us: bool, now: float) -> None:
        """Note a packet from a known epoch. ``hears_us``: it was addressed to this node or answers its probe."""
        peer.last_heard_s = now
        self.router.heard(peer, path, now=now)
        if hears_us:
            peer.is_proven = True
            peer.needs_evidence = False
            peer.waiting_since_s = now if len(peer.session.recovery) else None
        # Only a probe's answer can give evidence: where nobody probes, hearing the peer has to do.
        if not peer.is_online and not (peer.needs_evidence and self._is_sought(peer, now=now)):
            self._come_up(peer, PeerUpReason.RETURNED, now=now)

    def _come_up(self, peer: Peer, reason: PeerUpReason, *, now: float) -> None:
        peer.is_online = True
        peer.last_heard_s = now
        peer.waiting_since_s = None
        peer.session.ping_wanted = True  # shows the peer that we hear it, and measures the round trip
        peer.session.reassembler.touch(now=now)
        peer.congestion.on_return(now=now)
        peer.pacer.reset()
        self._state.events.append(PeerUp(now, peer.name, peer.session.epoch, peer.path.address, reason))

    def on_probe(self, epoch: int, tags: tuple[int, ...]) -> None:
        """Answer a node that looks for us."""
        if self._state.tag in tags:
            self._answers[wire.tag_of(epoch)] = None

    def introduce(self, epoch: int, path: Path, *, ask: bool, now: float) -> None:
        """Tell a stranger, or a peer that knows an older epoch of us, who we are; ``ask`` for its name, too."""
        if now - self._introduced_at_s.get(path, NEVER_S) < INTRODUCTION_INTERVAL_S:
            return
        if len(self._introduced_at_s) >= _MAX_INTRODUCTIONS:
            self._introduced_at_s.clear()
        self._introduced_at_s[path] = now
        tag = wire.tag_of(epoch)
        self._introductions[path, tag] = self._hello() + (wire.encode_probe([tag]) if ask else b"")

    # -- time

    def check(self, *, now: float) -> None:
        """Hold peers offline that have been silent for too long."""
        for peer in self._state.peers.values():
            offline_at_s = self._offline_at_s(peer)
            if not peer.is_online or now < offline_at_s:
                continue
            if now - offline_at_s > STALL_S and peer.grace_until_s < offline_at_s:
                peer.grace_until_s = now + STALL_GRACE_S  # we were not running; what it sent may still wait to be read
            else:
                self._go_down(peer, now=now)

    def _offline_at_s(self, peer: Peer) -> float:
        missed_s = peer.last_heard_s + MISSED_BEACONS * peer.beacon_interval_s
        if peer.waiting_since_s is None or not len(peer.session.recovery):
            return max(missed_s, peer.grace_until_s)
        patience_s = max(self._state.settings.suspect_after_s, 3 * peer.session.rtt.probe_timeout_s(expirations=0))
        return max(peer.waiting_since_s + patience_s, peer.grace_until_s)

    def _go_down(self, peer: Peer, *, now: float) -> None:
        was_waiting = peer.waiting_since_s is not None and len(peer.session.recovery) > 0
        reason = PeerDownReason.SILENT if was_waiting else PeerDownReason.BEACONS_MISSED
        if was_waiting and peer.waiting_since_s is not None:
            peer.needs_evidence = not peer.is_proven or peer.last_heard_s > peer.waiting_since_s
        peer.is_online = False
        peer.is_proven = False
        peer.down_since_s = now
        peer.waiting_since_s = None
        peer.session.ping_wanted = False
        for run in peer.session.recovery.abandon():
            self._outbox.retry(run, now=now)
        self._outbox.on_peer_offline(peer, now=now)
        self._state.events.append(PeerDown(now, peer.name, peer.session.epoch, reason))

    def next_timer(self, *, now: float) -> float:
        """Return when to call :meth:`check` or :meth:`datagrams` next."""
        times = [self._offline_at_s(peer) for peer in self._state.peers.values() if peer.is_online]
        times.append(self._beacon_at_s)
        probe_at_s = self._next_probe_at_s(now=now)
        if probe_at_s is not None:
            times.append(probe_at_s)
        if self._answers or self._introductions:
            times.append(NEVER_S)
        return min(times)

    def datagrams(self, *, now: float) -> list[Datagram]:
        """Return the beacons, probes and answers that are due."""
        frames = b""
        if self._answers:
            frames = self._hello(heard=tuple(self._answers)[: self._max_tags()])
            self._answers.clear()
        elif now >= self._beacon_at_s:
            frames = self._hello()
        if now >= self._beacon_at_s:
            interval_s = self._state.settings.beacon_interval_s
            self._beacon_at_s = now + interval_s * (1 + BEACON_JITTER * (2 * self._state.rng.random() - 1))
        frames += self._probe(now=now)
        out = self._transmitter.broadcast(frames, is_control=True, now=now) if frames else []
        for (path, tag), introduction in self._introductions.items():
            out.append(self._transmitter.stray(path, tag, introduction))
        self._introductions.clear()
        return out

    def _probe(self, *, now: float) -> bytes:
        due_s = self._next_probe_at_s(now=now)
        if due_s is None or due_s > now:
            return b""
        self._probe_at_s = now
        return self._hello() + wire.encode_probe(
            [peer.session.tag for peer in self._sought(now=now)][: self._max_tags()]
        )

    def _sought(self, *, now: float) -> list[Peer]:
        return [peer for peer in self._state.peers.values() if self._is_sought(peer, now=now)]

    def _is_sought(self, peer: Peer, *, now: float) -> bool:
        if peer.is_online or not self._state.settings.probe:
            return False
        return bool(peer.lane.transfers) or now - peer.last_traffic_s <= PROBE_TRAFFIC_WITHIN_S

    def _next_probe_at_s(self, *, now: float) -> float | None:
        sought = self._sought(now=now)
        if not sought:
            return None
        newest_s = max(peer.down_since_s for peer in sought)
        is_quick = now - newest_s < PROBE_QUICK_FOR_S
        interval_s = min(_probe_interval_s(peer) for peer in sought)  # a carrier carries what its best path does
        return self._probe_at_s + (interval_s if is_quick else max(interval_s, PROBE_SLOW_INTERVAL_S))

    def _max_tags(self) -> int:
        """How many tags an answer and a probe may hold, each, if both leave in one datagram."""
        room = self._state.broadcast_bytes - 2 * len(self._hello()) - wire.HEADER_BYTES - 2
        return min(wire.MAX_TAGS, room // 8)

    def _hello(self, *, heard: tuple[int, ...] = ()) -> bytes:
        state = self._state
        floor = min((next(iter(p.lane.transfers), state.next_message_id) for p in state.peers.values()), default=0)
        slowest_s = max((c.control_interval_s(PROBE_BYTES) for c in state.carriers.values()), default=0.0)
        return wire.encode_hello(
            name=state.settings.name,
            beacon_interval_s=max(state.settings.beacon_interval_s, slowest_s),
            floor=min(floor, state.floor(state.broadcast)),
            heard=heard,
        )

    def report_purged(self, peer: Peer, purged: list[tuple[int, Partial]], *, is_settled: bool, now: float) -> None:
        """Turn purged partial messages into events."""
        for message_id, partial in purged:
            self._state.counters["partials_purged"] += 1
            self._state.events.append(
                PartialPurged(now, message_id, peer.name, partial.received_count, partial.fragment_count, is_settled)
            )
