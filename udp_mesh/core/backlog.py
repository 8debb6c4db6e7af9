"""Every unfinished transfer of the node, by priority and by topic: what has to be known to make room. No policy."""

from __future__ import annotations

from udp_mesh.core.messages import Message, Transfer


class Backlog:
    """Transfers in order of publication, which is the last part of their key. ``queued_bytes``: their payloads."""

    def __init__(self) -> None:
        self.queued_bytes = 0
        self._order = 0
        self._by_priority: dict[int, dict[int, Transfer]] = {}
        self._by_topic: dict[str, dict[int, Transfer]] = {}

    def take_order(self) -> int:
        """Return the place of the next transfer in the order of publication."""
        self._order += 1
        return self._order - 1

    def add(self, transfer: Transfer) -> None:
        """Hold a transfer."""
        message, order = transfer.message, transfer.key[2]
        self._by_priority.setdefault(message.policy.priority, {})[order] = transfer
        self._by_topic.setdefault(message.topic, {})[order] = transfer
        self.queued_bytes += message.size_bytes

    def replace(self, fresh: Transfer) -> None:
        """Hold a transfer in the place of the one with the same key, which has the same payload."""
        self._by_priority[fresh.message.policy.priority][fresh.key[2]] = fresh
        self._by_topic[fresh.message.topic][fresh.key[2]] = fresh

    def remove(self, transfer: Transfer) -> None:
        """Hold a transfer no longer."""
        message, order = transfer.message, transfer.key[2]
        self._by_priority[message.policy.priority].pop(order)
        self._by_topic[message.topic].pop(order)
        if not self._by_topic[message.topic]:
            del self._by_topic[message.topic]
        self.queued_bytes -= message.size_bytes

    def count(self, topic: str) -> int:
        """Return how many messages of a topic are held."""
        return len(self._by_topic.get(topic, {}))

    def depths(self) -> dict[str, int]:
        """Return the messages held, by topic."""
        return {topic: len(transfers) for topic, transfers in self._by_topic.items()}

    def oldest_waiting(self, topic: str) -> Transfer | None:
        """Return the oldest transfer of a topic of which nothing has left, None if there is none."""
        return next((t for t in self._by_topic.get(topic, {}).values() if not t.is_started), None)

    def least_valuable(self, newcomer: Message) -> Transfer | None:
        """Return what should make room for a message, None if all is worth more.

        That is the oldest of the least urgent that has not begun; one that has only for a more urgent newcomer.
        """
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
