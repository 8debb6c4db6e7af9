"""One directed pair of ports: what happens to each frame, in sch_netem's order. Pure: no clock, no I/O.

Theory of operation (netem_enqueue in net/sched/sch_netem.c, Linux 6.x), per frame:

1. duplicate? 2. lost? (both: the one copy goes on) 3. corrupt one bit? 4. queue limit: frames that wait for their
departure, delayed ones included. 5. the copy goes through 2-7 on its own, ahead of the original, and is not copied
again. 6. every ``reorder_gap``-th frame, with ``reorder_ratio``: departs at once. 7. delay; with a rate, the frame
starts when the last queued one has departed, and the time that it waits for that counts towards its delay.

Draws come from one generator per pair, made from a stable seed at the first draw. They depend on the frames of this
pair alone. A change of the impairment keeps generator, correlation, loss state and queue.

The queue here only *counts*: the caller holds the frames until they are due. Entries whose time has come are swept out
when the queue looks full or has doubled, not one by one.
"""

from __future__ import annotations

import random
from collections.abc import Callable
from heapq import heappop, heappush

from netlab.medium.chance import Chance
from netlab.medium.delay import Jitter
from netlab.medium.impairments import Impairment, RandomLoss
from netlab.medium.loss import LossProcess, make_loss
from netlab.medium.verdicts import Verdict

#: (due_s or ``DROPPED``, receiver port, frame, verdict): plain tuples, one or two per frame and receiver.
Outcome = tuple[float, int, bytes, Verdict]
#: ``due_s`` of what never arrives; real ones are >= 0.
DROPPED = -1.0

_SWEEP_FROM = 64
_BITS_PER_BYTE = 8
# Bound once: looking a member up on an enum costs as much as the rest of a perfect pair's work.
_DELIVERED, _LOST, _QUEUE_FULL = Verdict.DELIVERED, Verdict.LOST, Verdict.QUEUE_FULL
_OUTAGE, _OUT_OF_RANGE = Verdict.OUTAGE, Verdict.OUT_OF_RANGE


class Pair:
    """The state of one directed pair. ``offer(frame, now, outcomes)`` appends what becomes of a frame."""

    __slots__ = (
        "_corrupt",
        "_counter",
        "_delay_s",
        "_duplicate",
        "_impairment",
        "_jitter",
        "_last_due",
        "_limit",
        "_limit_bytes",
        "_loss",
        "_loss_ratio",
        "_outage",
        "_queue",
        "_queued_bytes",
        "_random",
        "_reorder",
        "_rng",
        "_s_per_byte",
        "_seed",
        "_sweep_at",
        "offer",
        "receiver",
    )

    offer: Callable[[bytes, float, list[Outcome]], None]

    def __init__(self, receiver: int, impairment: Impairment | None, seed: int) -> None:
        """``impairment`` None: out of range. ``seed``: from :func:`netlab.medium.chance.stable_seed`."""
        self.receiver = receiver
        self._seed = seed
        self._rng: random.Random | None = None
        self._outage = False
        self._queue: list[tuple[float, int]] = []  # heap of (due_s, size_bytes)
        self._queued_bytes = 0
        self._sweep_at = _SWEEP_FROM
        self._last_due = 0.0
        self._counter = 0
        self._loss: LossProcess | None = None
        self._jitter: Jitter | None = None
        self._duplicate: Chance | None = None
        self._corrupt: Chance | None = None
        self._reorder: Chance | None = None
        self.configure(impairment)

    @property
    def impairment(self) -> Impairment | None:
        """What is in force; None is out of range."""
        return self._impairment

    def configure(self, impairment: Impairment | None) -> None:
        """Change what happens to later frames; those under way keep their time."""
        self._impairment = impairment
        if impairment is not None:
            self._take(impairment)
        self._choose()

    def set_outage(self, active: bool) -> None:
        """Lose every later frame silently, or end that."""
        self._outage = active
        self._choose()

    def _take(self, imp: Impairment) -> None:
        self._delay_s = imp.delay_s
        self._s_per_byte = _BITS_PER_BYTE / imp.rate_bps if imp.rate_bps else 0.0
        self._limit = imp.limit_packets
        self._limit_bytes = imp.limit_bytes
        plain_loss = isinstance(imp.loss, RandomLoss) and not imp.loss.correlation
        self._loss_ratio = imp.loss.loss_ratio if plain_loss and isinstance(imp.loss, RandomLoss) else 0.0
        self._loss = None if imp.loss is None else make_loss(imp.loss, self._generator(), self._loss)
        self._jitter = Jitter(imp, self._generator(), self._jitter) if imp.jitter_s else None
        self._duplicate = self._chance(imp.duplicate_ratio, imp.duplicate_correlation, self._duplicate)
        self._corrupt = self._chance(imp.corrupt_ratio, imp.corrupt_correlation, self._corrupt)
        self._reorder = self._chance(imp.reorder_ratio, imp.reorder_correlation, self._reorder)

    def _chance(self, ratio: float, correlation: float, before: Chance | None) -> Chance | None:
        return Chance(self._generator(), ratio, correlation, before) if ratio else None

    def _generator(self) -> random.Random:
        if self._rng is None:
            # 2.5 kB each: a perfect or distant pair never pays for it.
            self._rng = random.Random(self._seed)
            self._random = self._rng.random
        return self._rng

    def _choose(self) -> None:
        """Pick the shortest way through for the impairment in force."""
        imp = self._impairment
        if imp is None:
            self.offer = self._offer_out_of_range
        elif self._outage:
            self.offer = self._offer_outage
        elif self._is_special(imp):
            self.offer = self._offer_any
        elif imp.delay_s:
            self.offer = self._offer_plain
        else:
            self.offer = self._offer_prompt

    def _is_special(self, imp: Impairment) -> bool:
        draws = imp.jitter_s or imp.duplicate_ratio or imp.reorder_ratio or imp.corrupt_ratio
        loss = imp.loss is not None and not (isinstance(imp.loss, RandomLoss) and not imp.loss.correlation)
        limit = imp.limit_bytes is not None or (imp.limit_packets is not None and imp.limit_packets < 1)
        return bool(draws or loss or limit or imp.rate_bps)

    # -- ways through ---------------------------------------------------------------------------------------------

    def _offer_out_of_range(self, frame: bytes, _now: float, outcomes: list[Outcome]) -> None:
        outcomes.append((DROPPED, self.receiver, frame, _OUT_OF_RANGE))

    def _offer_outage(self, frame: bytes, _now: float, outcomes: list[Outcome]) -> None:
        outcomes.append((DROPPED, self.receiver, frame, _OUTAGE))

    def _offer_prompt(self, frame: bytes, now: float, outcomes: list[Outcome]) -> None:
        """Independent loss or none, and nothing that makes a frame wait."""
        if self._loss_ratio and self._random() < self._loss_ratio:
            outcomes.append((DROPPED, self.receiver, frame, _LOST))
        else:
            outcomes.append((now, self.receiver, frame, _DELIVERED))

    def _offer_plain(self, frame: bytes, now: float, outcomes: list[Outcome]) -> None:
        """Independent loss or none, constant delay, a limit in packets: most links of most scenarios."""
        if self._loss_ratio and self._random() < self._loss_ratio:
            outcomes.append((DROPPED, self.receiver, frame, _LOST))
            return
        queue = self._queue
        if len(queue) >= self._sweep_at or (self._limit is not None and len(queue) >= self._limit):
            self._sweep(now)
            if self._limit is not None and len(queue) >= self._limit:
                outcomes.append((DROPPED, self.receiver, frame, _QUEUE_FULL))
                return
        due = now + self._delay_s
        self._wait(due, len(frame))
        outcomes.append((due, self.receiver, frame, _DELIVERED))

    def _offer_any(self, frame: bytes, now: float, outcomes: list[Outcome]) -> None:
        duplicated = self._duplicate is not None and self._duplicate.hit()
        lost = self._loss is not None and self._loss.lost()
        if lost and not duplicated:
            outcomes.append((DROPPED, self.receiver, frame, _LOST))
            return
        sent, verdict = self._corrupted(frame)
        if self._is_full(now, len(frame)):
            outcomes.append((DROPPED, self.receiver, frame, _QUEUE_FULL))
            return
        if duplicated and not lost:
            self._offer_copy(frame, now, outcomes)
        due, at_once = self._departure(len(frame), now)
        if at_once and verdict is _DELIVERED:
            verdict = Verdict.REORDERED
        outcomes.append((due, self.receiver, sent, verdict))

    def _offer_copy(self, frame: bytes, now: float, outcomes: list[Outcome]) -> None:
        """A copy that gets lost in its turn was never noticed: it leaves no outcome."""
        if self._loss is not None and self._loss.lost():
            return
        sent, _verdict = self._corrupted(frame)
        if not self._is_full(now, len(frame)):
            due, _at_once = self._departure(len(frame), now)
            outcomes.append((due, self.receiver, sent, Verdict.DUPLICATED))

    def _corrupted(self, frame: bytes) -> tuple[bytes, Verdict]:
        if self._corrupt is None or not frame or not self._corrupt.hit():
            return frame, _DELIVERED
        rng = self._generator()
        changed = bytearray(frame)
        changed[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)
        return bytes(changed), Verdict.CORRUPTED

    def _departure(self, size_bytes: int, now: float) -> tuple[float, bool]:
        """Return (due_s, whether it leaves at once ahead of the delayed ones) and queue the frame."""
        imp = self._impairment
        assert imp is not None
        if self._reorder is not None and self._counter >= imp.reorder_gap - 1 and self._reorder.hit():
            self._counter = 0
            return now, True
        delay_s = self._delay_s if self._jitter is None else self._jitter.draw_s()
        start = now
        if self._s_per_byte:
            if self._last_due > now:
                start = self._last_due
                delay_s = max(0.0, delay_s - (start - now))
            delay_s += size_bytes * self._s_per_byte
        self._counter += 1
        due = start + delay_s
        if due > now:
            self._wait(due, size_bytes)
        return due, False

    # -- the queue ------------------------------------------------------------------------------------------------

    def _wait(self, due: float, size_bytes: int) -> None:
        heappush(self._queue, (due, size_bytes))
        self._queued_bytes += size_bytes
        if due > self._last_due:
            self._last_due = due

    def _is_full(self, now: float, size_bytes: int) -> bool:
        """Whether a frame more would exceed the limit, as netem counts packets and bfifo counts bytes."""
        if len(self._queue) >= self._sweep_at or self._looks_full(size_bytes):
            self._sweep(now)
        return self._looks_full(size_bytes)

    def _looks_full(self, size_bytes: int) -> bool:
        return (self._limit is not None and len(self._queue) >= self._limit) or (
            self._limit_bytes is not None and self._queued_bytes + size_bytes > self._limit_bytes
        )

    def _sweep(self, now: float) -> None:
        queue = self._queue
        while queue and queue[0][0] <= now:
            self._queued_bytes -= heappop(queue)[1]
        self._sweep_at = max(_SWEEP_FROM, 2 * len(queue))
