"""What a receiver makes of a frame on a shared channel: signal against noise and whoever transmits meanwhile. Pure.

Theory of operation. A frame arrives with the chance that its rate, its length and its ratio of signal to noise give
(:mod:`netlab.medium.phy`). Where other transmissions overlap it, their powers at the receiver add to the noise for as
long as they last, and the chances of the parts multiply; so the stronger of two frames may survive (capture), and of
equal ones none. A station that transmits hears nothing meanwhile.

One number is drawn per frame and receiver, from a generator of the pair's own, whatever happens: the draw depends on
the seed, the pair and the number of its frames alone. It also tells why a frame was lost: ``COLLISION`` where it would
have arrived without the others, ``LOST`` where not even then.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from netlab.medium.chance import stable_seed
from netlab.medium.phy import ACK_BYTES, Phy, Rate, packet_error_ratio, threshold_db
from netlab.medium.verdicts import Verdict

#: A frame is out of range where even an acknowledgement at the lowest rate would get through less often than this.
_HEARD_RATIO = 1e-3
_STEPS_PER_DB = 10  # of the ratio for which a chance is remembered
_CHANCES_LIMIT = 1 << 16
_DELIVERED, _LOST, _COLLISION = Verdict.DELIVERED, Verdict.LOST, Verdict.COLLISION
_OUTAGE, _OUT_OF_RANGE = Verdict.OUTAGE, Verdict.OUT_OF_RANGE


@dataclass(slots=True, eq=False)
class Signal:
    """A transmission of ``size_bytes`` (MAC frame) by station ``sender``; ``others`` overlap it in time."""

    sender: int
    start_s: float
    end_s: float
    rate: Rate
    size_bytes: int
    others: list[Signal] = field(default_factory=list)
    _parts: list[tuple[float, list[int]]] = field(default_factory=list)

    @property
    def parts(self) -> list[tuple[float, list[int]]]:
        """The frame, cut where others begin and end: (share of its duration, senders meanwhile)."""
        if not self._parts:
            edges = {self.start_s, self.end_s}
            for other in self.others:
                edges |= {max(other.start_s, self.start_s), min(other.end_s, self.end_s)}
            for begin_s, end_s in pairwise(sorted(edges)):
                meanwhile = [o.sender for o in self.others if o.start_s <= begin_s < o.end_s]
                self._parts.append(((end_s - begin_s) / (self.end_s - self.start_s), meanwhile))
        return self._parts

    def meet(self, on_air: Sequence[Signal]) -> None:
        """Note which of ``on_air`` overlap this one, on both sides."""
        for other in on_air:
            if other.end_s > self.start_s and other.start_s < self.end_s:
                other.others.append(self)
                self.others.append(other)


#: A receiver, its draw, and its chance to get a frame undisturbed (negative: none).
Chances = list[tuple[int, Callable[[], float], float]]


class Receptions:
    """Draws for all pairs of stations of one channel."""

    def __init__(self, names: Sequence[str], phy: Phy, *, noise_dbm: float, seed: int) -> None:
        """``names`` of the stations make their generators' seeds."""
        self._names = names
        self._seed = seed
        self._noise_dbm = noise_dbm
        self._noise_mw = 10 ** (noise_dbm / 10)
        rates = (*phy.rates, *phy.basic)
        self._least_snr_db = min(threshold_db(rate, ACK_BYTES, 1 - _HEARD_RATIO) for rate in rates)
        count = len(names)
        self._rssi_dbm: list[list[float]] = [[-math.inf] * count for _ in names]
        self._power_mw: list[list[float]] = []
        self._audience: list[list[int]] = [[] for _ in names]
        self._cut: set[tuple[int, int]] = set()
        self._draws: dict[tuple[int, int], Callable[[], float]] = {}
        self._chances: dict[tuple[Rate, int, int], float] = {}
        self._groups: dict[tuple[int, int, Rate], Chances] = {}

    def set_rssi(self, rssi_dbm: list[list[float]]) -> None:
        """How strongly each receiver hears each sender: ``[sender][receiver]``, -inf for not at all."""
        self._rssi_dbm = rssi_dbm
        self._power_mw = [[10 ** (power / 10) for power in row] for row in rssi_dbm]
        least_dbm = self._noise_dbm + self._least_snr_db
        for sender, row in enumerate(rssi_dbm):
            known = self._audience[sender]
            now = [r for r, power in enumerate(row) if power >= least_dbm and r != sender]
            if now != known:
                self._audience[sender] = sorted({*known, *now})
        self._groups.clear()

    def set_outage(self, pairs: set[tuple[int, int]], *, active: bool) -> None:
        """Lose every frame on ``pairs``, or end that; their power stays."""
        self._cut = self._cut | pairs if active else self._cut - pairs
        self._groups.clear()

    def audience(self, sender: int) -> list[int]:
        """Whom a group frame of ``sender`` concerns: who hears it, or once did."""
        return self._audience[sender]

    def snr_db(self, sender: int, receiver: int) -> float:
        """Ratio of signal to noise without interference."""
        return self._rssi_dbm[sender][receiver] - self._noise_dbm

    def rssi_dbm(self, sender: int, receiver: int) -> float:
        """How strongly ``receiver`` hears ``sender`` now."""
        return self._rssi_dbm[sender][receiver]

    def group(self, signal: Signal) -> list[tuple[int, Verdict]]:
        """What each receiver in the sender's audience makes of a group frame."""
        key = (signal.sender, signal.size_bytes, signal.rate)
        chances = self._groups.get(key)
        if chances is None:
            chances = self._groups[key] = self._prepare(signal)
        if signal.others:
            return [(receiver, self.one(signal, receiver)) for receiver, _draw, _chance in chances]
        return [
            (receiver, _DELIVERED if draw() < chance else self._reason(signal.sender, receiver))
            for receiver, draw, chance in chances
        ]

    def one(self, signal: Signal, receiver: int) -> Verdict:
        """What one receiver makes of a frame."""
        sender = signal.sender
        drawn = self._draw(sender, receiver)()
        reason = self._reason(sender, receiver)
        if reason is not _LOST or drawn >= (undisturbed := self._chance(signal, self.snr_db(sender, receiver))):
            return reason
        if not signal.others:
            return _DELIVERED
        return _DELIVERED if drawn < undisturbed * self._survival(signal, receiver, undisturbed) else _COLLISION

    def _prepare(self, signal: Signal) -> Chances:
        sender, chances = signal.sender, []
        for receiver in self._audience[sender]:
            heard = self._reason(sender, receiver) is _LOST
            chance = self._chance(signal, self.snr_db(sender, receiver)) if heard else -1.0
            chances.append((receiver, self._draw(sender, receiver), chance))
        return chances

    def _reason(self, sender: int, receiver: int) -> Verdict:
        """Why a frame that does not arrive is lost, others aside."""
        if (sender, receiver) in self._cut:
            return _OUTAGE
        return _OUT_OF_RANGE if self.snr_db(sender, receiver) < self._least_snr_db else _LOST

    def _survival(self, signal: Signal, receiver: int, undisturbed: float) -> float:
        """How much others reduce the chance of a frame to arrive, 0..1. Ask when it is over: others may yet come."""
        power_dbm, power_mw = self._rssi_dbm[signal.sender][receiver], self._power_mw
        arrives = 1.0
        for share, others in signal.parts:
            if receiver in others:
                return 0.0
            noise_mw = self._noise_mw
            for other in others:
                noise_mw += power_mw[other][receiver]
            chance = self._chance(signal, power_dbm - 10 * math.log10(noise_mw))
            if chance <= 0.0:
                return 0.0
            arrives *= chance**share
        return min(1.0, arrives / undisturbed)

    def _chance(self, signal: Signal, snr_db: float) -> float:
        if snr_db == -math.inf:
            return 0.0
        step = round(snr_db * _STEPS_PER_DB)
        key = (signal.rate, step, signal.size_bytes)
        chance = self._chances.get(key)
        if chance is None:
            if len(self._chances) >= _CHANCES_LIMIT:
                self._chances.clear()
            chance = 1 - packet_error_ratio(signal.rate, step / _STEPS_PER_DB, signal.size_bytes)
            self._chances[key] = chance
        return chance

    def _draw(self, sender: int, receiver: int) -> Callable[[], float]:
        draw = self._draws.get((sender, receiver))
        if draw is None:
            seed = stable_seed(self._seed, "reception", self._names[sender], self._names[receiver])
            draw = self._draws[sender, receiver] = random.Random(seed).random
        return draw
