"""The protocol of one node, without clock or sockets: bytes and time in, bytes and events out.

Its owner calls, in any order: :meth:`MeshCore.receive_datagram` or :meth:`MeshCore.receive_burst` for what arrives,
:meth:`MeshCore.publish` for what the applications send, :meth:`MeshCore.handle_timer` when :meth:`MeshCore.next_timer`
has passed; and after each of them :meth:`MeshCore.datagrams_to_send` and :meth:`MeshCore.next_event` until both are
exhausted.
"""

from __future__ import annotations

from dataclasses import replace
from random import Random
from typing import TYPE_CHECKING

from udp_mesh.core.bridge import Bridge
from udp_mesh.core.carriers import UNLIMITED_BYTES, Carrier
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.events import DropReason, Event, RefusalReason
from udp_mesh.core.links import Links
from udp_mesh.core.liveness import Liveness
from udp_mesh.core.outbox import Outbox, Refused
from udp_mesh.core.peer import Path
from udp_mesh.core.peer_status import PeerStatus
from udp_mesh.core.peer_view import peer_status
from udp_mesh.core.receive import Receiver
from udp_mesh.core.settings import Settings, TopicPolicy
from udp_mesh.core.state import NodeState
from udp_mesh.core.transmit import Transmitter

if TYPE_CHECKING:
    from udp_mesh.core.guard import Guard

__all__ = ["Datagram", "MeshCore", "Path", "PeerStatus", "Refused", "new_epoch"]

HOUSEKEEPING_INTERVAL_S = 1.0


def new_epoch(rng: Random) -> int:
    """Return a random 64-bit epoch whose short form is not 0, which means a broadcast."""
    return rng.getrandbits(32) << 32 | rng.randrange(1, 1 << 32)


class MeshCore:
    """One node's protocol. Every ``now`` is monotonic seconds of one clock, never decreasing."""

    def __init__(self, settings: Settings, *, epoch: int, rng: Random, now: float) -> None:
        self._state = NodeState(settings, epoch=epoch, rng=rng)
        self._outbox = Outbox(self._state)
        self._transmitter = Transmitter(self._state, self._outbox)
        links = Links(self._state)
        self._bridge = Bridge(self._state, links)
        broadcasts = self._transmitter.broadcasts
        self._liveness = Liveness(self._state, self._outbox, broadcasts, self._bridge, links, now=now)
        self._receiver = Receiver(self._state, self._outbox, self._liveness, self._bridge, links)
        self._guard: Guard | None = None
        self._resting_guard: Guard | None = None
        self._use_keys(settings.keys)
        self._housekeeping_at_s = now + HOUSEKEEPING_INTERVAL_S
        self._now = now

    @property
    def epoch(self) -> int:
        """This start of this node."""
        return self._state.epoch

    @property
    def settings(self) -> Settings:
        """The settings in force."""
        return self._state.settings

    def add_carrier(
        self,
        carrier: int,
        *,
        mtu_bytes: int = UNLIMITED_BYTES,
        rate_bps: float = 0.0,
        neighbours: tuple[str, ...] | None = None,
    ) -> None:
        """Broadcast on this carrier from now on; its beacon leaves with the next one due.

        Args:
            carrier: Its number, as in every :class:`Path`.
            mtu_bytes: Longest datagram that fits, without the carrier's own headers.
            rate_bps: What it carries, where that is known and slow; 0 leaves it to congestion control.
            neighbours: Addresses to which broadcasts go one by one, besides those of peers that are heard; None: the
                carrier has a broadcast.
        """
        self._state.carriers[carrier] = Carrier(carrier, mtu_bytes, rate_bps, neighbours)

    def remove_carrier(self, carrier: int) -> None:
        """Stop using a carrier; peers behind it are heard elsewhere or fall silent."""
        self._state.carriers.pop(carrier, None)

    def receive_datagram(self, data: bytes | memoryview, path: Path, *, now: float) -> None:
        """Take a datagram that came from ``path``. Bad ones are counted by reason; nothing is raised."""
        self._now = now
        if self._guard is not None:
            self._guard.burst(data, max(1, len(data)), path, now=now)
        else:
            self._receiver.datagram(data, path, now=now)

    def receive_burst(self, data: bytes | memoryview, segment_bytes: int, path: Path, *, now: float) -> None:
        """Take datagrams that arrived together, each ``segment_bytes`` long (the last may be shorter).

        As :meth:`receive_datagram` for each of them, only faster.
        """
        self._now = now
        (self._guard or self._receiver).burst(data, segment_bytes, path, now=now)

    def datagrams_to_send(self, *, now: float) -> list[Datagram]:
        """Return what has to leave now, in this order; call again until it is empty."""
        self._now = now

        def own_priority(carrier: int) -> int | None:
            return self._transmitter.most_urgent(carrier, now=now)

        passed_on = self._bridge.datagrams(own_priority, now=now)  # as they came: sealed by their sender
        datagrams = self._liveness.datagrams(now=now) + self._transmitter.datagrams(now=now)
        return passed_on + (datagrams if self._guard is None else self._guard.seal(datagrams))

    def next_timer(self) -> float:
        """Return when :meth:`handle_timer` has to be called at the latest; it may be in the past."""
        times = [self._liveness.next_timer(now=self._now), self._housekeeping_at_s]
        parts = (self._outbox.next_timer(), self._transmitter.next_timer(now=self._now))
        for time in (*parts, self._bridge.next_timer(now=self._now)):
            if time is not None:
                times.append(time)
        for peer in self._state.peers.values():
            due_s = peer.session.recovery.next_timer() if peer.is_online else None
            if due_s is not None:
                times.append(due_s)
        return min(times)

    def handle_timer(self, *, now: float) -> None:
        """Do what time demands: losses, probe timeouts, lifetimes, silent peers, stale partial messages."""
        self._now = now
        self._liveness.check(now=now)
        self._outbox.expire(now=now)
        for peer in self._state.peers.values():
            self._receiver.recovery_timer(peer, now=now)
        if now >= self._housekeeping_at_s:
            self._housekeeping_at_s = now + HOUSEKEEPING_INTERVAL_S
            for peer in self._state.peers.values():
                purged = peer.session.reassembler.purge_stale(now=now, is_online=peer.is_online)
                self._liveness.report_purged(peer, purged, is_settled=False, now=now)

    def _use_keys(self, keys: tuple[bytes, ...]) -> None:
        guard = self._guard or self._resting_guard  # the same one for ever: its numbers must not begin anew
        if not keys:
            self._guard, self._resting_guard = None, guard
        elif guard is not None:
            guard.use(keys)
            self._guard = guard
        else:
            from udp_mesh.core.guard import Guard  # with a key only: it needs the package cryptography

            self._guard = Guard(keys, self._state, self._receiver, self._liveness)

    def next_event(self) -> Event | None:
        """Return the oldest event not yet returned, None if there is none."""
        return self._state.events.popleft() if self._state.events else None

    def publish(
        self,
        topic: str,
        payload: bytes | memoryview,
        *,
        to: str,
        policy: TopicPolicy | None = None,
        may_drop: bool = True,
        flags: int = 0,
        token: int = 0,
        is_tracked: bool = False,
        now: float,
    ) -> int:
        """Queue a message for the node named ``to``, or for ``all``; return its message id.

        Args:
            topic: 1..255 bytes of UTF-8.
            payload: Opaque; at most 16 MiB. Not copied: do not change it afterwards.
            policy: Overrides the topic's configured policy.
            may_drop: Whether a full queue makes room by dropping; otherwise it refuses.
            flags: ``wire.DATA_FLAG_ENVELOPE`` if the payload begins with an envelope.
            token: Comes back in the events that tell what has become of the message.
            is_tracked: Never broadcast it: each node acknowledges it. See :meth:`destinations`.
            now: Monotonic seconds.

        Raises:
            Refused: It was not taken; ``reason`` says why.
        """
        self._now = now
        chosen = policy or self._state.settings.policy(topic)
        try:
            return self._outbox.publish(
                topic,
                payload,
                to=to,
                policy=chosen,
                may_drop=may_drop,
                flags=flags,
                token=token,
                is_tracked=is_tracked,
                now=now,
            )
        except Refused as refusal:
            if may_drop or refusal.reason is not RefusalReason.QUEUE_FULL:  # who waits for room tries again
                self._state.counters[f"refused_{refusal.reason.value}"] += 1
            raise

    def destinations(self, message_id: int) -> list[str]:
        """Return for which nodes a message that was just published waits, ``all`` for a broadcast."""
        return self._outbox.destinations(message_id)

    def withdraw(self, peer: str, token: int, reason: DropReason, *, now: float) -> None:
        """Drop the messages for a peer that were published with this token; what has left may arrive all the same."""
        held = self._state.peers.get(peer)
        for transfer in list(held.lane.transfers.values()) if held else ():
            if transfer.message.token == token:
                self._outbox.drop(transfer, reason, now=now)

    def has_room(self, topic: str, size_bytes: int) -> bool:
        """Whether a message for one destination fits into the queue without dropping another."""
        return self._outbox.has_room(topic, size_bytes)

    def is_online(self, name: str) -> bool:
        """Whether a node of this name was heard and is not held offline."""
        peer = self._state.peers.get(name)
        return peer is not None and peer.is_online

    def seek(self, name: str, *, now: float) -> None:
        """Count as traffic what waits for a node outside this core, so that it is probed for while it is offline."""
        peer = self._state.peers.get(name)
        if peer is not None:
            peer.last_traffic_s = now

    def window_bytes(self, carrier: int) -> int:
        """Return how much may be in flight on a carrier, over all peers that are reached by it."""
        peers = self._state.peers.values()
        return sum(p.congestion.cwnd_bytes for p in peers if p.is_online and p.path.carrier == carrier)

    def peers(self, *, now: float) -> list[PeerStatus]:
        """Return the state of every node ever heard in this epoch."""
        return [peer_status(self._state, peer, now=now) for peer in self._state.peers.values()]

    def stats(self) -> dict[str, int]:
        """Return all counters since the start; drops and refusals by reason."""
        counters = dict(self._state.counters)
        counters["queued_bytes"] = self._outbox.backlog.queued_bytes
        counters["reassembly_bytes"] = self._state.memory.reserved_bytes
        sessions = [peer.session for peer in self._state.peers.values()]
        counters["packets_lost"] = sum(session.recovery.lost_packets for session in sessions)
        counters["spurious_losses"] = sum(session.recovery.spurious_losses for session in sessions)
        return counters

    def queue_depths(self) -> dict[str, int]:
        """Return the messages waiting or in flight, by topic."""
        return self._outbox.backlog.depths()

    def reconfigure(self, settings: Settings, *, now: float) -> None:
        """Use other settings from now on; messages that are queued keep their place and fragments.

        Raises:
            ValueError: The name would change; that takes a restart.
        """
        state = self._state
        if settings.name != state.settings.name:
            raise ValueError("a node's name cannot change while it runs; restart it")
        window_changes = (settings.window, settings.packet_bytes, settings.shared_bps) != (
            state.settings.window,
            state.settings.packet_bytes,
            state.settings.shared_bps,
        )
        if settings.keys != state.settings.keys:
            self._use_keys(settings.keys)
        state.settings = replace(settings)
        state.memory.limit_bytes = settings.reassembly_bytes
        self._now = now
        if window_changes:
            for peer in state.peers.values():
                peer.congestion = state.new_congestion(peer.path, now=now)
                peer.pacer.reset()
