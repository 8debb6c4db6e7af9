"""The flood of one node, pure: frames in, frames out, no clock and no socket.

Theory. A frame that enters at the mesh interface is sent once on every member. A frame that comes from a member and was
not seen before goes to the mesh interface if it is for this node or a group, and is sent again on every member, except
where that is pointless: at its destination, with its hop limit used up, and on the wire that it came from. On the radio
that it came from it must go out again, for others hear this node who did not hear the last one. Nothing is learned from
frames, neither who is where nor which way is good.

On radios a relayed frame waits a random time first: those who heard the same frame would otherwise all send it at the
same moment. The order of frames is kept on every member, which makes later ones wait a little longer.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from netlab.flood.duplicates import Duplicates
from netlab.flood.wire import BROADCAST, INNER_AT, Fault, Header, decode, encode, relayed
from netlab.medium.meshes import FloodOptions

#: Relayed frames that wait on one member; more are dropped. Only a jitter of seconds or a storm gets there.
QUEUE_LIMIT = 1000


@dataclass(frozen=True, slots=True)
class Member:
    """One interface of the mesh: its address, and whether it is a radio (else a wire between two nodes)."""

    mac: bytes
    is_radio: bool


class Count(StrEnum):
    """What the flood counts beside the faults of :class:`~netlab.flood.wire.Fault`, in frames.

    ``ORIGINATED``, ``RELAYED``: sent on a member, once per member. ``DELIVERED``: given to the mesh interface.
    """

    ORIGINATED = "originated"
    RELAYED = "relayed"
    DELIVERED = "delivered"
    DUPLICATE = "duplicate"
    OWN = "own"
    HOP_LIMIT = "hop_limit"
    QUEUE_FULL = "queue_full"
    OVERSIZED = "oversized"
    NOT_SENT = "not_sent"


Sending = tuple[int, bytes]  # (member's place, frame)


class Flooder:
    """One node's flood; the caller sends what :meth:`originate` and :meth:`due` return."""

    def __init__(
        self, mac: bytes, members: Sequence[Member], options: FloodOptions, *, epoch: int, rng: random.Random
    ) -> None:
        """``mac`` is the mesh interface's; ``epoch`` 0..65535 differs from that of the node's last starts."""
        self._mac = mac
        self._options = options
        self._epoch = epoch
        self._rng = rng
        self._sequence = 0
        self._heads = [BROADCAST + member.mac for member in members]
        self._is_radio = [member.is_radio for member in members]
        self._waiting: list[deque[tuple[float, bytes]]] = [deque() for _ in members]
        self._duplicates = Duplicates()
        self._counts: dict[Count | Fault, int] = dict.fromkeys((*Count, *Fault), 0)

    @property
    def counts(self) -> dict[str, int]:
        """Frames counted so far, by the words of :class:`Count` and :class:`~netlab.flood.wire.Fault`."""
        return {str(name): value for name, value in self._counts.items()}

    def originate(self, inner: bytes) -> list[Sending]:
        """Return what to send for a frame of this node, at least an Ethernet header, from the mesh interface."""
        self._sequence = (self._sequence + 1) & 0xFFFFFFFF
        header = Header(self._options.hop_limit, len(inner), self._mac, self._epoch, self._sequence)
        tail = encode(header, inner)
        self._counts[Count.ORIGINATED] += len(self._heads)
        return [(member, head + tail) for member, head in enumerate(self._heads)]

    def receive(self, member: int, frame: bytes, *, now: float) -> bytes | None:
        """Take a frame that came from ``member``; return the frame inside if the mesh interface is to have it.

        Args:
            member: Place of the member in the sequence given at the start.
            frame: From its destination address on.
            now: Monotonic seconds.
        """
        header = decode(frame)
        if isinstance(header, Fault):
            self._counts[header] += 1
            return None
        if header.originator == self._mac:
            self._counts[Count.OWN] += 1
            return None
        if not self._duplicates.is_new(header.originator, header.epoch, header.sequence, now=now):
            self._counts[Count.DUPLICATE] += 1
            return None
        is_mine = frame[INNER_AT : INNER_AT + 6] == self._mac
        if not is_mine:
            self._relay(member, frame, header.hop_limit - 1, now)
            if not frame[INNER_AT] & 1:
                return None
        self._counts[Count.DELIVERED] += 1
        return frame[INNER_AT : INNER_AT + header.length_bytes]

    def due(self, *, now: float) -> list[Sending]:
        """Return, once, the relayed frames whose time has come; on every member none before an earlier one."""
        found: list[Sending] = []
        for member, waiting in enumerate(self._waiting):
            while waiting and waiting[0][0] <= now:
                found.append((member, waiting.popleft()[1]))
        self._counts[Count.RELAYED] += len(found)
        return found

    def next_due(self) -> float | None:
        """When :meth:`due` next has something; None while nothing waits."""
        return min((waiting[0][0] for waiting in self._waiting if waiting), default=None)

    def count(self, what: Count) -> None:
        """Count what only the edge can see."""
        self._counts[what] += 1

    def _relay(self, arrival: int, frame: bytes, hop_limit: int, now: float) -> None:
        if hop_limit <= 0:
            self._counts[Count.HOP_LIMIT] += 1
            return
        tail = relayed(frame, hop_limit)
        for member, waiting in enumerate(self._waiting):
            due = now
            if self._is_radio[member]:
                due += self._rng.random() * self._options.jitter_s
            elif member == arrival:
                continue
            if len(waiting) >= QUEUE_LIMIT:
                self._counts[Count.QUEUE_FULL] += 1
                continue
            waiting.append((due, self._heads[member] + tail))
