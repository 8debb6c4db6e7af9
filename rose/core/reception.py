"""What a subscriber knows of one sender: what is missing, what came twice, how old things are. Pure.

Theory. A sender numbers its publications from its start (its epoch) on. A number that is passed over counts as lost
until it comes after all; one that was taken already is dropped. Parts of one message wait for each other until a later
message of the sender is complete or the limit ``partial_after_s`` is over: then what there is, is given out as it is,
or counted as incomplete where that is of no use.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from rose.core.addressing import ServiceId
from rose.core.parts import Assembled, assemble
from rose.core.types import Message
from rose.core.wire import Fault, Flag, Header
from rose.errors import TypeMismatchError

#: Publications behind the newest one that still count when they come late.
WINDOW = 256
#: Messages whose parts are waited for at the same time, and their parts in bytes; the oldest goes first.
PENDING_MAX = 8
PENDING_BYTES_MAX = 16 << 20


@dataclass(frozen=True, slots=True)
class Sample:
    """One received message and what is known about its way.

    Attributes:
        message: The message, or as much of it as arrived.
        sender: Who published it.
        sequence: Its number since the sender's start.
        lost_before: Publications that are missing between this one and the newest before it.
        is_late: A newer one of the same sender was given out before.
        is_restart: The sender has started anew since the last one.
        age_s: Between publication and receipt, if both clocks agree; else off by their difference.
        delay_variation_s: How much longer it took than the quickest one of this sender; needs no common clock.
        completeness: 0..1, part of the sliced array that arrived; 1 for everything else.
        missing: Ranges [first, end) of the sliced array that hold no data.
    """

    message: Message
    sender: ServiceId
    sequence: int
    lost_before: int
    is_late: bool
    is_restart: bool
    age_s: float
    delay_variation_s: float
    completeness: float
    missing: tuple[tuple[int, int], ...]


@dataclass(slots=True)
class Counters:
    """Totals of one sender, over its restarts. ``lost``: passed over and not come since; in messages."""

    delivered: int = 0
    partial: int = 0
    incomplete: int = 0
    lost: int = 0
    restarts: int = 0
    faults: dict[Fault, int] = field(default_factory=dict)


@dataclass(slots=True)
class _Pending:
    header: Header
    parts: list[bytes | None]
    since: float
    size_bytes: int = 0


class Reception:
    """Receives what one sender publishes as one type."""

    def __init__(self, sender: ServiceId, cls: type[Message], *, partial_after_s: float = 0.1) -> None:
        """``partial_after_s``: how long parts of a message wait for the missing ones."""
        self.sender = sender
        self.counters = Counters()
        self.last_seen: float | None = None
        self.cls = cls
        self._partial_after_s = partial_after_s
        self._epoch_ns = 0
        self._newest = -1
        self._seen = 0  # bit i: number newest - i was taken
        self._restarted = False
        self._least_delay_s = float("inf")
        self._pending: dict[int, _Pending] = {}

    def receive(self, header: Header, payload: bytes, *, now: float, wall_ns: int) -> list[Sample]:
        """Take one datagram; return what can be given out, in the order of numbers.

        Args:
            header: Its sender is this one's.
            payload: What follows the header, opened if it was sealed.
            now: Monotonic seconds.
            wall_ns: Nanoseconds since 1970 by this host's clock.
        """
        if header.epoch_ns != self._epoch_ns and not self._begin_epoch(header):
            return []
        self.last_seen = now
        if self._was_taken(header.sequence):
            self._count(Fault.DUPLICATE)
            return []
        if header.parts == 1:
            return self._due(now, wall_ns, before=header.sequence) + self._finish(header, [payload], wall_ns)
        pending = self._pending.get(header.sequence)
        if pending is None:
            pending = self._pending[header.sequence] = _Pending(header, [None] * header.parts, now)
        if len(pending.parts) != header.parts or pending.parts[header.part] is not None:
            self._count(Fault.DUPLICATE if len(pending.parts) == header.parts else Fault.MALFORMED)
            return []
        pending.parts[header.part] = payload
        pending.size_bytes += len(payload)
        given_out = self._bound_pending(wall_ns)
        if header.sequence in self._pending and None not in pending.parts:
            given_out += self._due(now, wall_ns, before=header.sequence)
            given_out += self._give_up_waiting(header.sequence, wall_ns)
        return given_out

    def next_due(self) -> float | None:
        """When :meth:`due` next has something to do; None while nothing waits."""
        return min((pending.since + self._partial_after_s for pending in self._pending.values()), default=None)

    def due(self, *, now: float, wall_ns: int) -> list[Sample]:
        """Return the messages whose missing parts are no longer waited for."""
        return self._due(now, wall_ns, before=None)

    def age_s(self, *, now: float) -> float:
        """Return the seconds since anything of the sender was heard; infinity if nothing ever was."""
        return float("inf") if self.last_seen is None else now - self.last_seen

    def _begin_epoch(self, header: Header) -> bool:
        """Whether the datagram opens the sender's newest epoch; what is left of an older one is counted and dropped."""
        if header.epoch_ns < self._epoch_ns:
            self._count(Fault.STALE)
            return False
        self._restarted = self._epoch_ns != 0
        self.counters.restarts += self._restarted
        self.counters.incomplete += len(self._pending)
        self._pending.clear()
        self._epoch_ns = header.epoch_ns
        self._newest, self._seen = -1, 0
        return True

    def _due(self, now: float, wall_ns: int, *, before: int | None) -> list[Sample]:
        over = [
            number
            for number, pending in sorted(self._pending.items())
            if (number < before if before is not None else pending.since + self._partial_after_s <= now)
        ]
        return [sample for number in over for sample in self._give_up_waiting(number, wall_ns)]

    def _give_up_waiting(self, number: int, wall_ns: int) -> list[Sample]:
        pending = self._pending.pop(number)
        return self._finish(pending.header, pending.parts, wall_ns)

    def _bound_pending(self, wall_ns: int) -> list[Sample]:
        given_out: list[Sample] = []
        while len(self._pending) > PENDING_MAX or (
            len(self._pending) > 1 and sum(p.size_bytes for p in self._pending.values()) > PENDING_BYTES_MAX
        ):
            given_out += self._give_up_waiting(min(self._pending), wall_ns)
        return given_out

    def _finish(self, header: Header, parts: list[bytes | None], wall_ns: int) -> list[Sample]:
        try:
            assembled = assemble(parts, self.cls, header.type_id, is_sliced=bool(header.flags & Flag.SLICED))
        except TypeMismatchError:
            if None in parts:
                self.counters.incomplete += 1
            else:
                self._count(Fault.UNDECODABLE)
            return []
        return [self._sample(header, assembled, wall_ns)]

    def _sample(self, header: Header, assembled: Assembled, wall_ns: int) -> Sample:
        lost_before, is_late = self._take(header.sequence)
        age_s = (wall_ns - header.published_ns) / 1e9
        self._least_delay_s = min(self._least_delay_s, age_s)
        restarted, self._restarted = self._restarted, False
        self.counters.delivered += 1
        self.counters.partial += assembled.completeness < 1.0
        return Sample(
            message=assembled.message,
            sender=self.sender,
            sequence=header.sequence,
            lost_before=lost_before,
            is_late=is_late,
            is_restart=restarted,
            age_s=age_s,
            delay_variation_s=age_s - self._least_delay_s,
            completeness=assembled.completeness,
            missing=assembled.missing,
        )

    def _was_taken(self, number: int) -> bool:
        behind = self._newest - number
        return behind >= WINDOW or (behind >= 0 and bool(self._seen >> behind & 1))

    def _take(self, number: int) -> tuple[int, bool]:
        """Remember a number; return how many before it are missing, and whether it comes late."""
        ahead = number - self._newest
        if ahead <= 0:
            self._seen |= 1 << -ahead
            self.counters.lost = max(0, self.counters.lost - 1)
            return 0, True
        lost = 0 if self._newest < 0 else ahead - 1  # what was published before we came is not lost
        self._seen = (self._seen << ahead | 1) & ((1 << WINDOW) - 1) if ahead < WINDOW else 1
        self._newest = number
        self.counters.lost += lost
        return lost, False

    def _count(self, fault: Fault) -> None:
        self.counters.faults[fault] = self.counters.faults.get(fault, 0) + 1
