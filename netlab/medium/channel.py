"""One radio channel that stations share: airtime, carrier sense, back-off, acknowledgements, collisions. Pure.

Theory of operation (IEEE 802.11-2016, 10.3: the distributed coordination function). Events happen in the order of
their own time, whenever the caller gets to them:

* a station *starts* when its back-off has run down (:mod:`netlab.medium.channel_contention`); for its airtime the frame
  keeps busy whoever hears it with ``cca_dbm`` or more;
* at its *end* every receiver draws (:mod:`netlab.medium.channel_receptions`). Group frames are sent once, at the lowest
  basic rate, and that is all. The addressee of a unicast frame answers SIFS later;
* until that *exchange* is over those who hear the sender wait, whether the answer comes or not: by the frame's duration
  field, and by EIFS where they could not read it, which is as long. Without an acknowledgement the sender doubles its
  window and tries again, up to the radio's ``retry_limit``. A frame that comes twice is delivered once.

Not modelled: RTS/CTS, fragments, aggregation, power saving, EIFS after group frames. Who hears only the receiver defers
from the end of the frame on, SIFS too early.
"""

from __future__ import annotations

import heapq
import math
import random
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from netlab.medium.chance import stable_seed
from netlab.medium.channel_contention import Contention
from netlab.medium.channel_receptions import Receptions, Signal
from netlab.medium.channel_records import ChannelStats, Decided, Exchange, Fate, Queued
from netlab.medium.phy import ACK_BYTES, Phy, Rate, airtime_s
from netlab.medium.rate_control import FixedRate, RateControl
from netlab.medium.segments import Port
from netlab.medium.verdicts import Verdict

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_DELIVERED = Verdict.DELIVERED


class Channel:
    """All stations of one channel. Stations are named by their port's index outside, and by their place inside."""

    def __init__(
        self,
        ports: Sequence[Port],
        phy: Phy,
        *,
        noise_dbm: float,
        seed: int,
        limit_packets: int | None = None,
        limit_bytes: int | None = None,
        rate_control: RateControl,
    ) -> None:
        """Nobody hears anybody until :meth:`set_rssi`.

        Args:
            ports: Of the stations; their nodes' names make the random generators' seeds.
            phy: The kind of radio.
            noise_dbm: Noise at every receiver.
            seed: The lab's.
            limit_packets: Most frames in a station, the one under way included; None is no limit.
            limit_bytes: The same in bytes.
            rate_control: Of unicast frames; stations are places in ``ports``.
        """
        names = [f"{port.node} {port.ifname}" for port in ports]
        self._ports = [port.index for port in ports]
        self._place = {port: place for place, port in enumerate(self._ports)}
        self._phy = phy
        self._limit_packets = math.inf if limit_packets is None else limit_packets
        self._limit_bytes = math.inf if limit_bytes is None else limit_bytes
        self._receptions = Receptions(names, phy, noise_dbm=noise_dbm, seed=seed)
        self._contention = Contention(len(ports), difs_s=phy.difs_s, slot_s=phy.slot_s)
        self._slots = [random.Random(stable_seed(seed, "back-off", name)).random for name in names]
        self._queues: list[deque[Queued]] = [deque() for _ in ports]
        self._queued_bytes = [0] * len(ports)
        self._hearers: list[tuple[int, ...]] = [(place,) for place in range(len(ports))]
        self._rates = rate_control
        self._wants_to_hear = not isinstance(rate_control, FixedRate)
        self._airtimes_s: dict[tuple[Rate, int], float] = {}
        self._on_air: list[Signal] = []
        self._ends: list[tuple[float, int, bool, Exchange]] = []  # heap; True: of the whole exchange
        self._order = 0
        self._decided: list[Decided] = []
        self._now = -math.inf
        self._stats = ChannelStats()

    @property
    def stats(self) -> ChannelStats:
        """Counters since the start."""
        return replace(self._stats)

    def set_rssi(self, rssi_dbm: NDArray[np.float64] | Sequence[Sequence[float]]) -> None:
        """Change what every receiver hears of every sender.

        Args:
            rssi_dbm: (stations, stations), ``[sender, receiver]`` in the order of ``ports``; -inf for nothing. The
                diagonal is ignored.
        """
        rows = [[float(power) for power in row] for row in rssi_dbm]
        self._receptions.set_rssi(rows)
        cca_dbm = self._phy.cca_dbm
        self._hearers = [
            tuple(other for other, power in enumerate(row) if power >= cca_dbm or other == station)
            for station, row in enumerate(rows)
        ]

    def set_outage(self, pairs: Iterable[tuple[int, int]], *, active: bool) -> None:
        """Lose what ends on these pairs of ports from now on, or end that. Their power stays: they defer as before."""
        places = {(self._place[sender], self._place[receiver]) for sender, receiver in pairs}
        self._receptions.set_outage(places, active=active)

    def rssi_dbm(self, sender: int, receiver: int) -> float:
        """How strongly port ``receiver`` hears port ``sender`` now."""
        return self._receptions.rssi_dbm(self._place[sender], self._place[receiver])

    def offer(
        self, sender: int, frame: bytes, receiver: int | None, *, now: float, tag: int = 0, rate: Rate | None = None
    ) -> list[Fate]:
        """Queue an Ethernet frame at ``sender`` for ``receiver``, None for whoever hears it.

        Call :meth:`advance` with the same ``now`` before. A ``now`` in the channel's past counts as its present.
        ``rate`` is for group frames; None is the lowest basic one.

        Returns:
            What is decided at once: nothing, or that the queue is full, for everyone whom the frame concerns.
        """
        station = self._place[sender]
        queue = self._queues[station]
        if len(queue) >= self._limit_packets or self._queued_bytes[station] + len(frame) > self._limit_bytes:
            self._stats.queue_full += 1
            audience = self._receptions.audience(station)
            concerned = [receiver] if receiver is not None else [self._ports[place] for place in audience]
            return [(port, Verdict.QUEUE_FULL) for port in concerned]
        addressee = None if receiver is None else self._place[receiver]
        size_bytes = self._phy.psdu_bytes(len(frame))
        queue.append(Queued(station, addressee, frame, now, tag, size_bytes, rate))
        self._queued_bytes[station] += len(frame)
        if len(queue) == 1:
            self._contend(station, 0, now=max(now, self._now))
        return []

    def next_event(self) -> float | None:
        """When :meth:`advance` may have something to tell, if nothing is offered before; None: never.

        Earlier events may wait until then: they happen at their own time all the same.
        """
        next_s = math.inf
        for station, start_s in enumerate(self._contention.starts_s):
            if start_s < next_s:
                next_s = min(
                    next_s, start_s + self._airtime_s(self._phy.rates[-1], self._queues[station][0].size_bytes)
                )
        for end_s, _order, is_over, _exchange in self._ends:
            next_s = min(next_s, end_s + self._phy.difs_s if is_over else end_s)
        return None if next_s == math.inf else next_s

    def advance(self, now: float) -> list[Decided]:
        """Let everything happen that is due, in order; returns what was decided meanwhile."""
        starts_s, ends = self._contention.starts_s, self._ends
        while True:
            next_s = min(starts_s)
            if ends and ends[0][0] <= next_s:
                if ends[0][0] > now:
                    break
                self._now, _order, is_over, exchange = heapq.heappop(ends)
                if is_over:
                    self._finish(exchange, now=self._now)
                else:
                    self._end(exchange, now=self._now)
            elif next_s <= now:
                self._now = next_s
                self._start(starts_s.index(next_s), now=next_s)
            else:
                break
        self._now = max(self._now, now)
        decided, self._decided = self._decided, []
        return decided

    # -- events ---------------------------------------------------------------------------------------------------

    def _contend(self, station: int, retries: int, *, now: float) -> None:
        """Draw a back-off for the station's first frame; the window doubles with every retry."""
        window = min((self._phy.cw_min + 1) << retries, self._phy.cw_max + 1)
        self._contention.want(station, int(self._slots[station]() * window), now=now)

    def _start(self, station: int, *, now: float) -> None:
        queued = self._queues[station][0]
        queued.attempts += 1
        rate = queued.rate or self._phy.group_rate
        if queued.receiver is not None:
            rate = self._rates.rate(station, queued.receiver, queued.attempts)
        duration_s = self._airtime_s(rate, queued.size_bytes)
        signal = Signal(station, now, now + duration_s, rate, queued.size_bytes)
        self._radiate(signal)
        self._stats.attempts += 1
        hearers = self._hearers[station]
        self._contention.started(station)
        self._contention.occupy(hearers, now=now)
        self._schedule(signal.end_s, False, Exchange(queued, signal, hearers))

    def _end(self, exchange: Exchange, *, now: float) -> None:
        """The frame is out: who has it?"""
        queued, signal = exchange.queued, exchange.signal
        self._on_air.remove(signal)
        if queued.receiver is None:
            heard = self._receptions.group(signal)
            if self._wants_to_hear:
                for place, verdict in heard:
                    if verdict is _DELIVERED:
                        self._hear(place, signal.sender)
            ports = self._ports
            self._decide(queued, signal.rate, [(ports[place], verdict) for place, verdict in heard], now=now)
            self._contention.release(exchange.hearers, now=now)
            self._next(queued, now=now)
            return
        answer_s = self._airtime_s(self._phy.ack_rate(signal.rate), ACK_BYTES)
        exchange.verdict = self._receptions.one(signal, queued.receiver)
        if exchange.verdict is _DELIVERED:
            self._hear(queued.receiver, queued.sender)
            if not queued.delivered:
                queued.delivered = True
                self._decide(queued, signal.rate, [(self._ports[queued.receiver], _DELIVERED)], now=now)
            self._answer(exchange, queued.receiver, now + self._phy.sifs_s, answer_s, now=now)
        self._schedule(now + self._phy.sifs_s + answer_s, True, exchange)

    def _answer(self, exchange: Exchange, receiver: int, start_s: float, answer_s: float, *, now: float) -> None:
        rate = self._phy.ack_rate(exchange.signal.rate)
        exchange.ack = Signal(receiver, start_s, start_s + answer_s, rate, ACK_BYTES)
        self._radiate(exchange.ack)
        busy = set(exchange.hearers)
        exchange.late_hearers = tuple(place for place in self._hearers[receiver] if place not in busy)
        if exchange.late_hearers:
            self._contention.occupy(exchange.late_hearers, now=now)

    def _finish(self, exchange: Exchange, *, now: float) -> None:
        """The time for an acknowledgement is over: was there one?"""
        queued, ack = exchange.queued, exchange.ack
        acked = False
        if ack is not None:
            self._on_air.remove(ack)
            acked = self._receptions.one(ack, queued.sender) is _DELIVERED
            if acked:
                self._hear(queued.sender, ack.sender)
            if exchange.late_hearers:
                self._contention.release(exchange.late_hearers, now=now)
        self._contention.release(exchange.hearers, now=now)
        assert queued.receiver is not None
        self._rates.attempted(queued.sender, queued.receiver, queued.attempts, acked=acked)
        if acked:
            self._stats.acknowledged += 1
        elif queued.attempts < self._phy.retry_limit:
            self._contend(queued.sender, queued.attempts, now=now)
            return
        else:
            self._stats.given_up += 1
            if not queued.delivered:
                fates = [(self._ports[queued.receiver], exchange.verdict)]
                self._decide(queued, exchange.signal.rate, fates, now=now)
        self._next(queued, now=now)

    def _next(self, done: Queued, *, now: float) -> None:
        queue = self._queues[done.sender]
        queue.popleft()
        self._queued_bytes[done.sender] -= len(done.frame)
        if queue:
            self._contend(done.sender, 0, now=now)

    # -- parts ----------------------------------------------------------------------------------------------------

    def _hear(self, station: int, peer: int) -> None:
        if self._wants_to_hear:
            self._rates.heard(station, peer, self._receptions.snr_db(peer, station))

    def _radiate(self, signal: Signal) -> None:
        if self._on_air:
            signal.meet(self._on_air)
        self._on_air.append(signal)
        self._stats.airtime_s += signal.end_s - signal.start_s

    def _decide(self, queued: Queued, rate: Rate, fates: list[Fate], *, now: float) -> None:
        sender = self._ports[queued.sender]
        self._decided.append(
            Decided(now, sender, queued.frame, queued.offered_s, queued.tag, fates, queued.attempts, rate)
        )

    def _schedule(self, at_s: float, is_over: bool, exchange: Exchange) -> None:
        self._order += 1
        heapq.heappush(self._ends, (at_s, self._order, is_over, exchange))

    def _airtime_s(self, rate: Rate, size_bytes: int) -> float:
        key = (rate, size_bytes)
        duration_s = self._airtimes_s.get(key)
        if duration_s is None:
            duration_s = self._airtimes_s[key] = airtime_s(rate, size_bytes)
        return duration_s
