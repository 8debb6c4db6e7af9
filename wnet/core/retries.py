"""What was sent and is not acknowledged yet: sending again, giving up, and noticing that a neighbour is gone.

Theory of operation (WNet paper, section III-E, with three changes that docs/wnet.md gives the reasons for).
* A frame asks for an acknowledgement where a further try could follow. Each next hop acknowledges for itself; who has
  is taken off the list, and only who has not gets the frame once more, up to ``tries`` times in all.
* A frame is awaited for the round-trip time that its links have shown (RFC 6298's estimate).
* Two frames in a row without an answer make a link suspect: what comes next takes an alternate meanwhile, and the frame
  itself too. A probe asks on. A neighbour that owes answers and says nothing for ``lost_after_s`` is lost; one that is
  heard but acknowledges nothing, after three times as long.
"""

from __future__ import annotations

import heapq
from typing import Protocol

from wnet.core import wire
from wnet.core.context import Context
from wnet.core.events import Count, Drop, LinkDownReason
from wnet.core.link import Link
from wnet.core.transmissions import Entry, Packet, Transmission
from wnet.core.wire_control import Ack

#: Between the acknowledgements of one frame's next hops: what one takes on a channel at 6 Mbit/s with its back-off
#: (IEEE 802.11: DIFS 34 us, up to 15 slots of 9 us, 100 us on air), and as much again for late processes.
ACK_TURN_S = 0.0005
_LEAST_MISSES = 3
_ONE_WAY_PATIENCE = 3.0
_LOSS_MARGIN_DB, _GAIN_MARGIN_DB, _MOST_MARGIN_DB = 1.0, 0.05, 12.0


class Owner(Protocol):
    """What :class:`Retries` asks of the rest."""

    def resend(self, transmission: Transmission, *, now: float) -> None:
        """Queue it once more, ahead of others."""

    def reroute(self, packet: Packet, entry: Entry, *, now: float) -> bool:
        """Send by another next hop what this one does not acknowledge; False if there is none."""

    def probe(self, link: Link, *, now: float) -> None:
        """Ask a neighbour for an acknowledgement, unless it is being asked already."""

    def lose(self, link: Link, reason: LinkDownReason, *, now: float) -> None:
        """Take a link out of use."""

    def probe_answered(self, link: Link, *, now: float) -> None:
        """The neighbour has acknowledged a probe."""


class Retries:
    """All transmissions that await an acknowledgement."""

    def __init__(self, context: Context, owner: Owner) -> None:
        self._config = context.config
        self._journal = context.journal
        self._owner = owner
        self._due: list[tuple[float, int, Transmission, int]] = []
        self._order = 0

    def sent(self, transmission: Transmission, *, now: float) -> None:
        """Await acknowledgements of what leaves now; its entries have got their sequences."""
        transmission.sent_at = now
        rto_s = 0.0
        for entry in transmission.entries:
            entry.link.pending[entry.sequence] = (transmission, entry, now)
            rto_s = max(rto_s, entry.link.timer.rto_s)
        turns_s = ACK_TURN_S * max(len(transmission.entries) - 1, 0)
        self._order += 1
        heapq.heappush(
            self._due,
            (now + rto_s + self._config.ack_delay_s + turns_s, self._order, transmission, transmission.attempts),
        )

    def next_due(self) -> float:
        """When the next frame has waited long enough."""
        due = self._due
        while due and (due[0][2].is_done or due[0][2].attempts != due[0][3]):
            heapq.heappop(due)
        return due[0][0] if due else float("inf")

    def acknowledge(self, link: Link, ack: Ack, *, now: float) -> None:
        """Take an acknowledgement of one neighbour."""
        pending = link.pending
        newest = pending.get(ack.newest)
        if newest is not None:
            link.timer.sample(now - newest[2], in_flight=len(pending), now=now)
            self._settle(link, newest, now)
        bits, sequence = ack.bits, ack.newest
        while bits:
            sequence = (sequence - 1) & 0xFFFF
            if bits & 1 and sequence in pending:
                self._settle(link, pending[sequence], now)
            bits >>= 1

    def _settle(self, link: Link, found: tuple[Transmission, Entry, float], now: float) -> None:
        transmission, entry, _sent_at = found
        link.answer()
        link.rate_margin_db = max(link.rate_margin_db - _GAIN_MARGIN_DB, 0.0)
        self.forget(transmission, entry)
        if transmission is link.probe:
            link.probe = None
            self._owner.probe_answered(link, now=now)

    def forget(self, transmission: Transmission, entry: Entry) -> None:
        """Await nothing of this next hop any more."""
        for sequence in (entry.sequence, *entry.earlier):
            entry.link.pending.pop(sequence, None)
        if entry in transmission.entries:
            transmission.entries.remove(entry)

    def abandon(self, link: Link) -> list[tuple[Transmission, Entry]]:
        """Forget all that is under way on a link; return it, each once."""
        found = {id(entry): (transmission, entry) for transmission, entry, _sent_at in link.pending.values()}
        for transmission, entry in found.values():
            self.forget(transmission, entry)
        link.pending.clear()
        return list(found.values())

    def handle(self, *, now: float) -> None:
        """Do what is due: send again, elsewhere, or give up."""
        while self.next_due() <= now:
            transmission = heapq.heappop(self._due)[2]
            for entry in list(transmission.entries):
                self._missed(transmission, entry, now)
            if transmission.entries and transmission.attempts < transmission.tries:
                self._journal.count(Count.RETRIED)
                self._owner.resend(transmission, now=now)
            elif transmission.entries:
                self._give_up(transmission, now)

    def _missed(self, transmission: Transmission, entry: Entry, now: float) -> None:
        link = entry.link
        link.miss(transmission.sent_at, now=now)
        link.rate_margin_db = min(link.rate_margin_db + _LOSS_MARGIN_DB, _MOST_MARGIN_DB)
        if self._is_gone(link, now):
            self._owner.lose(link, LinkDownReason.NOT_ACKNOWLEDGED, now=now)
        elif link.is_suspect:
            self._owner.probe(link, now=now)
            if self._owner.reroute(transmission.packet, entry, now=now):
                self.forget(transmission, entry)

    def _is_gone(self, link: Link, now: float) -> bool:
        if not link.is_usable or link.misses < _LEAST_MISSES:
            return False
        patience_s = max(self._config.lost_after_s, 2.0 * link.timer.rto_s)
        if now - max(link.missed_since, link.last_heard) >= patience_s:
            return True
        return now - link.missed_since >= _ONE_WAY_PATIENCE * patience_s

    def _give_up(self, transmission: Transmission, now: float) -> None:
        for entry in list(transmission.entries):
            self.forget(transmission, entry)
            packet = transmission.packet
            if entry.link.probe is transmission:
                entry.link.probe = None
                if entry.link.is_usable:
                    self._owner.probe(entry.link, now=now)
            if packet.kind in (wire.UNICAST, wire.MULTICAST, wire.ROUTED):
                size_bytes = len(packet.tail) - wire.ORIGIN_BYTES
                self._journal.drop(Drop.NOT_ACKNOWLEDGED, packet.source, packet.destination, size_bytes, now=now)
