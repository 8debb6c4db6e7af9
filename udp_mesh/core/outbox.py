"""Publishing: what is taken, what is refused, what is dropped and why. Nothing is ever dropped without an event.

Offline destinations. A message that is already queued stays and is delivered at the peer's return, unless its lifetime
is over. A new message for an offline peer is refused (``discard``) or replaces the waiting one of its topic
(``latest``).
Limits. When the queue is full, the oldest message of the least urgent priority that has not begun to be sent goes; a
message that has begun only makes room for a more urgent one, or nothing big would ever finish on a slow link.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.backlog import Backlog
from udp_mesh.core.deadlines import Deadlines
from udp_mesh.core.events import (
    DropReason,
    MessageAcked,
    MessageBegunAnew,
    MessageDropped,
    MessageQueued,
    RefusalReason,
)
from udp_mesh.core.fragment_size import datagram_bytes
from udp_mesh.core.messages import Message, Transfer
from udp_mesh.core.peer import Lane, Peer
from udp_mesh.core.recovery import SentRun
from udp_mesh.core.scheduler import Scheduler
from udp_mesh.core.settings import BROADCAST_NAME, MAX_MESSAGE_BYTES, TopicPolicy
from udp_mesh.core.state import NodeState
from udp_mesh.core.throttle import Throttle


class Refused(Exception):
    """A message was not taken; nothing was queued and no event follows."""

    def __init__(self, reason: RefusalReason) -> None:
        super().__init__(reason.value)
        self.reason = reason


class Outbox:
    """Every unfinished transfer of the node, within its limits."""

    def __init__(self, state: NodeState) -> None:
        self._state = state
        self.backlog = Backlog()
        self._deadlines = Deadlines()
        self._throttle = Throttle(state.scheduler, state.events)

    def publish(
        self,
        topic: str,
        payload: bytes | memoryview,
        *,
        to: str,
        policy: TopicPolicy,
        may_drop: bool,
        flags: int = 0,
        token: int = 0,
        is_tracked: bool = False,
        now: float,
    ) -> int:
        """Queue a message; return its id. ``is_tracked``: it is not broadcast, so that every receiver acknowledges it.

        Raises:
            Refused: With the reason; see :class:`RefusalReason`.
        """
        state = self._state
        encoded = topic.encode()
        if not 0 < len(encoded) <= min(wire.MAX_TOPIC_BYTES, state.broadcast_bytes // 2):
            raise Refused(RefusalReason.BAD_TOPIC)
        if not 0 <= policy.priority <= 255 or (policy.lifetime_s is not None and policy.lifetime_s <= 0):
            raise Refused(RefusalReason.BAD_POLICY)
        if len(payload) > min(MAX_MESSAGE_BYTES, state.settings.queue_bytes):
            raise Refused(RefusalReason.TOO_LARGE)
        message = Message(
            state.next_message_id,
            topic,
            payload,
            policy,
            datagram_bytes=datagram_bytes(state, to, topic_bytes=len(encoded), size_bytes=len(payload)),
            flags=flags,
            token=token,
            now=now,
        )
        if message.fragment_count > wire.MAX_FRAGMENTS:
            raise Refused(RefusalReason.TOO_LARGE)
        lanes = self._lanes(message, to, may_broadcast=not is_tracked, now=now)
        self._make_room(message, len(lanes), may_drop=may_drop, now=now)
        state.take_message_id()
        self._throttle.push([self._add(message, lane, now=now) for lane in lanes], now=now)
        return message.message_id

    def has_room(self, topic: str, size_bytes: int) -> bool:
        """Whether a message for one destination fits into the queue without dropping another."""
        settings = self._state.settings
        has_bytes = self.backlog.queued_bytes + size_bytes <= settings.queue_bytes
        return has_bytes and self.backlog.count(topic) < settings.queue_messages

    def destinations(self, message_id: int) -> list[str]:
        """Return the nodes to which a message is on its way; ``all`` if it waits to be broadcast."""
        lanes = [self._state.broadcast, *(peer.lane for peer in self._state.peers.values())]
        return [lane.name for lane in lanes if message_id in lane.transfers]

    def _lanes(self, message: Message, to: str, *, may_broadcast: bool, now: float) -> list[Lane]:
        state = self._state
        if to == BROADCAST_NAME:
            if may_broadcast and message.fragment_count == 1 and message.largest_bytes <= state.broadcast_bytes:
                return [state.broadcast]
            peers = [p for p in state.peers.values() if self._takes(p, message, now=now)]
            if not peers:
                raise Refused(RefusalReason.PEER_OFFLINE)
            return [peer.lane for peer in peers]
        peer = state.peers.get(to)
        if peer is None:
            raise Refused(RefusalReason.OWN_NAME if to == state.settings.name else RefusalReason.UNKNOWN_PEER)
        if not self._takes(peer, message, now=now):
            raise Refused(RefusalReason.PEER_OFFLINE)
        return [peer.lane]

    @staticmethod
    def _takes(peer: Peer, message: Message, *, now: float) -> bool:
        peer.last_traffic_s = now  # also of a refused message: it is worth probing for this peer
        return peer.is_online or message.survives_offline

    def _add(self, message: Message, lane: Lane, *, now: float) -> Transfer:
        state = self._state
        key = Scheduler.key(message, order=self.backlog.take_order(), prioritise=state.settings.prioritise)
        transfer = Transfer(message, lane.name, key)
        if message.keeps_latest or message.survives_offline:
            self._supersede(transfer, lane, now=now)
        lane.transfers[message.message_id] = transfer
        self.backlog.add(transfer)
        self._deadlines.watch(transfer)
        state.events.append(
            MessageQueued(
                now,
                message.message_id,
                message.topic,
                message.policy.priority,
                message.size_bytes,
                message.fragment_count,
                lane.name,
            )
        )
        return transfer

    def _supersede(self, newest: Transfer, lane: Lane, *, now: float) -> None:
        topic = newest.message.topic
        older = lane.newest.get(topic)
        peer = self._state.peers.get(lane.name)
        is_offline = peer is not None and not peer.is_online
        # A message under way is finished, or a topic faster than the link would never deliver anything.
        replaces = newest.message.keeps_latest or is_offline
        if older is not None and not older.is_done and replaces and (is_offline or not older.is_started):
            self.drop(older, DropReason.SUPERSEDED, now=now)
        lane.newest[topic] = newest

    def _make_room(self, message: Message, copies: int, *, may_drop: bool, now: float) -> None:
        settings = self._state.settings
        while self.backlog.count(message.topic) + copies > settings.queue_messages:
            victim = self.backlog.oldest_waiting(message.topic)
            if victim is None or not may_drop:
                raise Refused(RefusalReason.QUEUE_FULL)
            self.drop(victim, DropReason.QUEUE_FULL, now=now)
        while self.backlog.queued_bytes + copies * message.size_bytes > settings.queue_bytes:
            victim = self.backlog.least_valuable(message)
            if victim is None or not may_drop:
                raise Refused(RefusalReason.QUEUE_FULL)
            self.drop(victim, DropReason.QUEUE_FULL, now=now)

    def drop(self, transfer: Transfer, reason: DropReason, *, now: float) -> None:
        """End a transfer without a confirmed delivery."""
        if transfer.is_done:
            return
        may_have_arrived = transfer.is_fully_sent
        self._finish(transfer)
        message = transfer.message
        self._state.counters[f"dropped_{reason.value}"] += 1
        self._state.events.append(
            MessageDropped(
                now,
                message.published_id,
                message.topic,
                message.policy.priority,
                message.size_bytes,
                transfer.peer,
                reason,
                message.token,
                may_have_arrived,
            )
        )

    def acknowledge(self, run: SentRun, *, now: float) -> None:
        """Note that packets have arrived; report messages that are complete with them."""
        for transfer, index in run.parts:
            if transfer.is_done or not transfer.acknowledge(index, run.packet_count) or not transfer.is_complete:
                continue
            self._finish(transfer)
            message = transfer.message
            latency_s = now - message.queued_at_s
            priority = message.policy.priority
            self._state.counters["messages_acked"] += 1
            self._state.events.append(
                MessageAcked(
                    now, message.published_id, message.topic, priority, transfer.peer, latency_s, message.token
                )
            )

    def sent_broadcast(self, transfer: Transfer) -> None:
        """Forget a broadcast that has left: nobody will acknowledge it."""
        self._finish(transfer)

    def retry(self, run: SentRun, *, now: float) -> None:
        """Queue the fragments of lost packets again, at their own priority; best-effort messages end here."""
        for transfer, first in run.parts:
            if transfer.is_done:
                continue
            indices = [
                index
                for index in range(first, first + run.packet_count)
                if not transfer.was_repeated_after(index, run.packet_number + index - first)
            ]
            if not transfer.message.is_reliable:
                if any(not transfer.has_copy(index) for index in indices):
                    self.drop(transfer, DropReason.LOST, now=now)
            elif transfer.send_again(indices):
                self._state.scheduler.push(transfer)

    def start_over(self, transfer: Transfer, *, now: float) -> None:
        """Send a message from its beginning under a new id on the wire: its receiver has forgotten what it had.

        Its place in the queue and its id in events stay. Of a topic of which only the newest counts it ends if there
        is a newer one; and it ends if it is too long for the fragments that the path takes now.
        """
        state, old = self._state, transfer.message
        lane = state.lane(transfer.peer)
        newest = lane.newest.get(old.topic)
        if old.keeps_latest and newest is not None and newest is not transfer:
            self.drop(transfer, DropReason.SUPERSEDED, now=now)
            return
        room_bytes = datagram_bytes(state, transfer.peer, topic_bytes=len(old.topic_bytes), size_bytes=old.size_bytes)
        message = old.cut_anew(state.take_message_id(), datagram_bytes=room_bytes)
        if message.fragment_count > wire.MAX_FRAGMENTS:
            self.drop(transfer, DropReason.PATH_TOO_SMALL, now=now)
            return
        fresh = Transfer(message, transfer.peer, transfer.key)
        transfer.is_done = True
        del lane.transfers[old.message_id]
        lane.transfers[message.message_id] = fresh
        if newest is transfer:
            lane.newest[old.topic] = fresh
        self.backlog.replace(fresh)
        self._deadlines.watch(fresh)
        state.events.append(MessageBegunAnew(now, message.published_id, message.message_id, transfer.peer))
        if not self._throttle.replace(transfer, fresh):
            state.scheduler.push(fresh)

    def on_peer_offline(self, peer: Peer, *, now: float) -> None:
        """Reliable messages wait for the peer's return; a best-effort one that has begun is lost."""
        for transfer in list(peer.lane.transfers.values()):
            if transfer.is_started and not transfer.message.is_reliable:
                self.drop(transfer, DropReason.PEER_OFFLINE, now=now)

    def on_peer_restarted(self, peer: Peer, *, now: float) -> None:
        """Messages that may have reached the old epoch end as unknown; the others begin anew."""
        for transfer in list(peer.lane.transfers.values()):
            if transfer.is_fully_sent:
                self.drop(transfer, DropReason.PEER_RESTARTED, now=now)
            elif transfer.is_started:
                transfer.start_over()
                self._state.scheduler.push(transfer)

    def expire(self, *, now: float) -> None:
        """Drop every message whose lifetime is over; let go what a rate limit holds no longer."""
        for transfer in self._deadlines.due(now=now):
            self.drop(transfer, DropReason.EXPIRED, now=now)
        self._throttle.release(now=now)

    def next_timer(self) -> float | None:
        """Return when the next lifetime ends, or a rate limit lets something go."""
        times = (self._deadlines.next_timer(), self._throttle.next_timer())
        return min((time for time in times if time is not None), default=None)

    def _finish(self, transfer: Transfer) -> None:
        message = transfer.message
        transfer.is_done = True
        lane = self._state.lane(transfer.peer)
        del lane.transfers[message.message_id]
        if lane.newest.get(message.topic) is transfer:
            del lane.newest[message.topic]
        self.backlog.remove(transfer)
