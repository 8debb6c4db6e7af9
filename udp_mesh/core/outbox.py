"""Publishing: what is taken, what is refused, what is dropped and why. Nothing is ever dropped without an event.

Offline destinations. A message that is already queued stays and is delivered at the peer's return, unless its lifetime
is over. A new message for an offline peer is refused (``discard``) or replaces the waiting one of its topic
(``latest``).
Limits. When the queue is full, the oldest message of the least urgent priority that has not begun to be sent goes; a
message that has begun only makes room for a more urgent one, or nothing big would ever finish on a slow link.
"""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.deadlines import Deadlines
from udp_mesh.core.events import DropReason, MessageAcked, MessageDropped, MessageQueued, RefusalReason
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
        self.queued_bytes = 0
        self._order = 0
        self._by_priority: dict[
            int, dict[int, Transfer]
        ] = {}  # by order of publication, which is the last part of a key
        self._by_topic: dict[str, dict[int, Transfer]] = {}
        self._deadlines = Deadlines()
        self._throttle = Throttle(state.scheduler)

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
        now: float,
    ) -> int:
        """Queue a message; return its id.

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
        lanes = self._lanes(message, to, now=now)
        self._make_room(message, len(lanes), may_drop=may_drop, now=now)
        state.take_message_id()
        self._throttle.push([self._add(message, lane, now=now) for lane in lanes], now=now)
        return message.message_id

    def has_room(self, topic: str, size_bytes: int) -> bool:
        """Whether a message for one destination fits into the queue without dropping another."""
        settings = self._state.settings
        messages = len(self._by_topic.get(topic, {}))
        return self.queued_bytes + size_bytes <= settings.queue_bytes and messages < settings.queue_messages

    def _lanes(self, message: Message, to: str, *, now: float) -> list[Lane]:
        state = self._state
        if to == BROADCAST_NAME:
            if message.fragment_count == 1 and message.largest_bytes <= state.broadcast_bytes:
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
        order = self._order
        self._order += 1
        key = Scheduler.key(message, order=order, prioritise=state.settings.prioritise)
        transfer = Transfer(message, lane.name, key)
        if message.keeps_latest or message.survives_offline:
            self._supersede(transfer, lane, now=now)
        lane.transfers[message.message_id] = transfer
        self._by_priority.setdefault(message.policy.priority, {})[order] = transfer
        self._by_topic.setdefault(message.topic, {})[order] = transfer
        self.queued_bytes += message.size_bytes
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
        topic = self._by_topic.get(message.topic, {})
        while len(topic) + copies > settings.queue_messages:
            victim = next((t for t in topic.values() if not t.is_started), None)
            if victim is None or not may_drop:
                raise Refused(RefusalReason.QUEUE_FULL)
            self.drop(victim, DropReason.QUEUE_FULL, now=now)
        while self.queued_bytes + copies * message.size_bytes > settings.queue_bytes:
            victim = self._least_valuable(message)
            if victim is None or not may_drop:
                raise Refused(RefusalReason.QUEUE_FULL)
            self.drop(victim, DropReason.QUEUE_FULL, now=now)

    def _least_valuable(self, newcomer: Message) -> Transfer | None:
        for priority in sorted(self._by_priority, reverse=True):
            if priority < newcomer.policy.priority:
                return None
            transfers = self._by_priority[priority].values()
            waiting = next((t for t in transfers if not t.is_started), None)
            if waiting is not None:
                return waiting
            if priority > newcomer.policy.priority and transfers:
                return next(iter(transfers))
        return None

    def drop(self, transfer: Transfer, reason: DropReason, *, now: float) -> None:
        """End a transfer without a confirmed delivery."""
        if transfer.is_done:
            return
        self._finish(transfer)
        message = transfer.message
        self._state.counters[f"dropped_{reason.value}"] += 1
        self._state.events.append(
            MessageDropped(
                now,
                message.message_id,
                message.topic,
                message.policy.priority,
                message.size_bytes,
                transfer.peer,
                reason,
                message.token,
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
                MessageAcked(now, message.message_id, message.topic, priority, transfer.peer, latency_s, message.token)
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
        """Send a message from its beginning under a new id: its receiver has forgotten what it had."""
        lane = self._state.lane(transfer.peer)
        policy = transfer.message.policy
        message = transfer.message
        self._finish(transfer)
        fresh = Message(
            self._state.take_message_id(),
            message.topic,
            message.payload,
            policy,
            datagram_bytes=datagram_bytes(
                self._state, transfer.peer, topic_bytes=len(message.topic_bytes), size_bytes=message.size_bytes
            ),
            flags=message.flags,
            token=message.token,
            now=message.queued_at_s,
        )
        self._state.scheduler.push(self._add(fresh, lane, now=now))

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

    def depths(self) -> dict[str, int]:
        """Return the messages waiting or in flight, by topic."""
        return {topic: len(transfers) for topic, transfers in self._by_topic.items()}

    def next_timer(self) -> float | None:
        """Return when the next lifetime ends, or a rate limit lets something go."""
        times = (self._deadlines.next_timer(), self._throttle.next_timer())
        return min((time for time in times if time is not None), default=None)

    def _finish(self, transfer: Transfer) -> None:
        message, order = transfer.message, transfer.key[2]
        transfer.is_done = True
        lane = self._state.lane(transfer.peer)
        del lane.transfers[message.message_id]
        if lane.newest.get(message.topic) is transfer:
            del lane.newest[message.topic]
        self._by_priority[message.policy.priority].pop(order)
        self._by_topic[message.topic].pop(order)
        if not self._by_topic[message.topic]:
            del self._by_topic[message.topic]
        self.queued_bytes -= message.size_bytes
