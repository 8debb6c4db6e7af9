"""Tells senders which of their stored messages are safe here, many at a time, as messages of the mesh itself."""

from __future__ import annotations

from dataclasses import dataclass, field

from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.envelope import DurableId, Envelope
from udp_mesh.core.mesh import MeshCore, Refused
from udp_mesh.core.settings import TopicPolicy

TOPIC = "udp_mesh/confirm"
_IDS_PER_MESSAGE = 64
_MAX_WAITING = 65_536  # of one sender; beyond it the oldest are forgotten, and the sender asks by repeating
_HEAD = envelopes.encode(Envelope(confirms=True))


@dataclass(slots=True)
class _Waiting:
    priority: int = 255
    ids: dict[DurableId, None] = field(default_factory=dict)


class Confirmations:
    """What has yet to be confirmed, by sender."""

    def __init__(self, core: MeshCore) -> None:
        self._core = core
        self._waiting: dict[str, _Waiting] = {}

    def add(self, source: str, priority: int, durable_id: DurableId) -> None:
        """Confirm a message with the next :meth:`send`, as urgently as the message itself was."""
        waiting = self._waiting.setdefault(source, _Waiting())
        waiting.ids[durable_id] = None
        waiting.priority = min(waiting.priority, priority)
        if len(waiting.ids) > _MAX_WAITING:
            del waiting.ids[next(iter(waiting.ids))]

    def send(self, *, now: float) -> None:
        """Send what the transport takes; the rest waits, for the sender's return if it is offline."""
        for source, waiting in list(self._waiting.items()):
            while waiting.ids and self._core.is_online(source):
                ids = list(waiting.ids)[:_IDS_PER_MESSAGE]
                try:
                    self._core.publish(
                        TOPIC,
                        _HEAD + envelopes.encode_ids(ids),
                        to=source,
                        policy=TopicPolicy(waiting.priority),
                        flags=wire.DATA_FLAG_ENVELOPE,
                        now=now,
                    )
                except Refused:
                    break
                for durable_id in ids:
                    del waiting.ids[durable_id]
            if not waiting.ids:
                del self._waiting[source]
