"""The life of every application message: published, sent in fragments, delivered."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.traces.model import Delivery, Fragment, Published, Stream, Trace
from netlab.traces.streams import first_deliveries


@dataclass(frozen=True, slots=True)
class MessageLife:
    """One message of one stream. ``fragments_sent`` counts transmissions, ``copies`` those of redundancy."""

    stream: Stream
    published: Published
    delivery: Delivery | None
    receipts: int
    fragments: int
    fragments_sent: int
    first_sent_ns: int | None
    copies: int = 0

    @property
    def retransmissions(self) -> int:
        """Transmissions of fragments that had been sent before, on any interface, copies excepted."""
        return self.fragments_sent - self.fragments - self.copies


def message_lives(trace: Trace) -> list[MessageLife]:
    """All messages in the order of their publication."""
    lives = [life for stream in trace.streams for life in _lives(trace, stream)]
    return sorted(lives, key=lambda life: life.published.t_ns)


def _lives(trace: Trace, stream: Stream) -> list[MessageLife]:
    sent: dict[tuple[int, int], list[Fragment]] = {}
    for fragment in trace.fragments.get(stream.source, []):
        if fragment.message is not None and trace.is_for(fragment, stream):
            sent.setdefault(fragment.message, []).append(fragment)
    first = {delivery.seq: delivery for delivery in first_deliveries(trace, stream.index)}
    receipts: dict[int, int] = {}
    for delivery in trace.delivered.get(stream.index, []):
        receipts[delivery.seq] = receipts.get(delivery.seq, 0) + 1
    lives = []
    for entry in trace.published.get(stream.index, []):
        fragments = sent.get((entry.publication, entry.seq), [])
        lives.append(
            MessageLife(
                stream,
                entry,
                first.get(entry.seq),
                receipts.get(entry.seq, 0),
                len({fragment.index for fragment in fragments}),
                len(fragments),
                fragments[0].t_ns if fragments else None,
                sum(fragment.is_copy for fragment in fragments),
            )
        )
    return lives
