"""Who is there: names and epochs, online and offline.

Theory of operation.
* A beacon (HELLO, broadcast) ties an epoch to a name. A new epoch of a known name is a restart; the old is retired.
  Epochs have no order, so a straggler of a former life may retire the present one; that one, still speaking when the
  other has long been silent, is taken back.
  When this node says who it is: :mod:`udp_mesh.core.beacons`.
* In a small team a newcomer is greeted at once by unicast. In a larger one those greetings would be many: it gets our
  broadcast answer, and the greeting goes ahead of the first packet that there is for it.
* A peer that owes an answer and is silent for 0.5 s (or three probe timeouts, if longer) is offline; an idle one after
  three missed beacons. Nothing is sent to it by unicast then: the kernel would start address resolution, whose retries
  are a second apart, and the peer's return would wait for them.
* While this node has something for an offline peer, it searches for it: :mod:`udp_mesh.core.search`.
* Any packet revives a peer. One exception: a peer that was heard although it did not answer does not hear us; it is
  searched for, and returns when a unicast or an answer shows that it does.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.beacons import ANYBODY, Beacons
from udp_mesh.core.bridge import Bridge
from udp_mesh.core.bridge_queue import QUEUE_S
from udp_mesh.core.broadcasts import Broadcasts
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.events import (
    NameConflict,
    PartialPurged,
    PeerDown,
    PeerDownReason,
    PeerUp,
    PeerUpReason,
)
from udp_mesh.core.links import Links
from udp_mesh.core.outbox import Outbox
from udp_mesh.core.packets import Link
from udp_mesh.core.paths import Paths
from udp_mesh.core.peer import Path, Peer, Session
from udp_mesh.core.reassembly import Partial
from udp_mesh.core.routing import Router
from udp_mesh.core.search import PROBE_TRAFFIC_WITHIN_S, Search
from udp_mesh.core.state import NodeState

MAX_PEERS = 1024
SMALL_TEAM = 2  # peers that are greeted by unicast
MISSED_BEACONS = 3.5  # three and some jitter
CONFLICT_AFTER_S = 3.0
STALL_S = 0.05
STALL_GRACE_S = 0.1
TELL_AGAIN_S = 0.25


class Liveness:
    """Peers' names, epochs and presence."""

    def __init__(
        self, state: NodeState, outbox: Outbox, broadcasts: Broadcasts, bridge: Bridge, links: Links, *, now: float
    ) -> None:
        self._state = state
        self._bridge = bridge
        self._links = links
        self._outbox = outbox
        self._broadcasts = broadcasts
        self.router = Router(state, outbox)
        self._beacons = Beacons(state, broadcasts, now=now)
        self._search = Search(state)
        self._told_again_at_s = now

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
                if now - peer.retired_at_s <= CONFLICT_AFTER_S:  # a straggler
                    return None
                self._refuse_name(peer.name, path, now=now)  # the earlier holder still runs
                if peer.is_online:
                    return None
                peer.retired.remove(epoch)  # and the later one does not: it was itself a straggler, of a life before
                self._restart(peer, epoch, path, now=now)
            else:
                self._restart(peer, epoch, path, now=now)
        elif peer.name != hello.name:
            state.counters["name_changed"] += 1
            return None
        told = self._links.way(wire.tag_of(epoch), path) if path.via else None
        if told is not None:
            peer.beacon_interval_s = told.interval_s  # its own beacons are not heard here
        elif hello.beacon_interval_s > 0:
            peer.beacon_interval_s = hello.beacon_interval_s
        return peer

    def _refuse_name(self, name: str, path: Path, *, now: float) -> None:
        self._state.counters["name_conflicts"] += 1
        self._state.events.append(NameConflict(now, name, path.address))

    def _discover(self, epoch: int, name: str, path: Path, *, now: float) -> Peer:
        state = self._state
        session = Session(epoch, state.memory, now=now)
        peer = Peer(name, session, path, state.new_congestion(path, now=now), now=now)
        peer.paths = Paths(state.links)
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
        is_small = len(self._state.peers) <= SMALL_TEAM
        (peer.session.control if is_small else peer.session.greeting).append(self._beacons.hello())
        self._come_up(peer, reason, now=now)

    def heard(self, peer: Peer, path: Path, *, hears_us: bool, now: float) -> None:
        """Note a packet from a known epoch. ``hears_us``: it was addressed to this node or answers its probe."""
        peer.last_heard_s = now
        self.router.heard(peer, path, now=now)
        if hears_us:
            peer.is_proven = True
            peer.needs_evidence = False
            peer.session.greeting.clear()
            peer.waiting_since_s = now if len(peer.session.recovery) else None
        # Only a probe's answer can give evidence: where nobody probes, hearing the peer has to do.
        if not peer.is_online and not (peer.needs_evidence and self._search.is_sought(peer, now=now)):
            self._come_up(peer, PeerUpReason.RETURNED, now=now)

    def _come_up(self, peer: Peer, reason: PeerUpReason, *, now: float) -> None:
        peer.is_online = True
        peer.last_heard_s = now
        peer.waiting_since_s = None
        is_small = len(self._state.peers) <= SMALL_TEAM
        if is_small or peer.lane.transfers or now - peer.last_traffic_s <= PROBE_TRAFFIC_WITHIN_S:
            peer.session.ping_wanted = True  # shows the peer that we hear it, and measures the round trip
        peer.session.reassembler.touch(now=now)
        peer.congestion.on_return(now=now)
        peer.pacer.reset()
        self._links.met(peer.session.tag)
        if self._state.settings.bridge and not peer.path.via:
            self._beacons.tell_soon(now=now)
        self._state.events.append(PeerUp(now, peer.name, peer.session.epoch, peer.path.address, reason))

    def on_probe(self, epoch: int, tags: tuple[int, ...], heard: tuple[int, ...], path: Path, *, now: float) -> None:
        """Answer a node that looks for us, or that asks everybody except those that it has ``heard``."""
        is_asked = self._state.tag in tags or (ANYBODY in tags and self._state.tag not in heard)
        if is_asked and not self._state.has_broadcast(path):
            self._beacons.introduce(epoch, path, ask=False, now=now)
        elif self._state.tag in tags:
            self._beacons.answer(epoch)
        elif ANYBODY in tags and self._state.tag not in heard:
            peer = self._state.by_epoch.get(epoch)
            if peer is None or not peer.session.control:  # else a greeting is about to leave
                self._beacons.answer_in_turn(epoch, now=now)
        self._search.heard_searching(epoch, tags, now=now)
        if self._state.settings.bridge:
            self._help_to_find(tags, path, now=now)

    def _help_to_find(self, tags: tuple[int, ...], path: Path, *, now: float) -> None:
        """Look on the other carriers for those who are sought on one; say it if they are there."""
        for peer in (self._state.peer_of_tag(tag) for tag in tags):
            if peer is not None and not peer.is_online:
                peer.last_traffic_s = now
            elif peer is not None and self._bridge.reaches(peer.session.tag, path) and now >= self._told_again_at_s:
                self._told_again_at_s = now + TELL_AGAIN_S
                self._beacons.tell_soon(now=now)

    def on_link(self, bridge: Peer, link: Link, path: Path, *, now: float) -> None:
        """Take what a bridge says of whom it reaches; its word stands for the beacons of a peer that is behind it."""
        for peer, told in self._links.take(bridge, link, path, self._beacons.greet, now=now):
            if peer.is_online:
                self.router.heard(peer, told.way, now=now)
                if peer.path.via:
                    peer.last_heard_s, peer.beacon_interval_s = now, told.interval_s

    def introduce(self, epoch: int, path: Path, *, ask: bool, now: float) -> None:
        """Tell a stranger, or a peer that knows an older epoch of us, who we are; ``ask`` for its name, too."""
        self._beacons.introduce(epoch, path, ask=ask, now=now)

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
        if peer.path.via and self._state.rate_bps(peer.path):
            patience_s += QUEUE_S  # others may wait at the bridge, too
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
        times.append(self._beacons.next_timer())
        probe_at_s = self._search.next_timer(now=now)
        if probe_at_s is not None:
            times.append(probe_at_s)
        return min(times)

    def datagrams(self, *, now: float) -> list[Datagram]:
        """Return the beacons, probes and answers that are due."""
        frames = self._beacons.frames(now=now)
        tells = bool(frames) and self._state.settings.bridge
        sought = self._search.tags(now=now)
        if sought:
            probe = wire.encode_probe(sought[: self._beacons.max_tags()])
            frames = (frames or self._beacons.hello()) + probe

        def link_frames(carrier: int, room_bytes: int) -> bytes:
            return self._bridge.link_frames(carrier, room_bytes, now=now) if tells else b""

        out = self._broadcasts.control(frames, link_frames, now=now) if frames else []
        return out + self._beacons.introductions(now=now)

    def report_purged(self, peer: Peer, purged: list[tuple[int, Partial]], *, is_settled: bool, now: float) -> None:
        """Turn purged partial messages into events."""
        for message_id, partial in purged:
            self._state.counters["partials_purged"] += 1
            self._state.events.append(
                PartialPurged(now, message_id, peer.name, partial.received_count, partial.fragment_count, is_settled)
            )
