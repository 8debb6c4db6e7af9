"""A radio segment with shared airtime as the medium sees it: the channel, and the pairs' words on top. Pure.

What the channel delivers goes through the pair's impairment (loss, delay, jitter, duplicate, corrupt, reorder) as if it
had just left the sender: `loss: 2%` is 2 % of what radio and retries got through, and costs no airtime. Without a
matrix of signal strengths (:meth:`SharedChannel.set_rssi`) every pair in range is heard with its impairment's
``rssi_dbm``, or ``DEFAULT_RSSI_DBM``.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from netlab.medium.channel import Channel
from netlab.medium.channel_records import ChannelStats
from netlab.medium.impairments import Impairment
from netlab.medium.pair import DROPPED, Outcome, Pair
from netlab.medium.phy import PHYS, Phy, Rate
from netlab.medium.rate_control import AdaptiveRate, FixedRate, RateControl
from netlab.medium.segments import DEFAULT_RSSI_DBM, ChannelSpec, Port, Segment
from netlab.medium.verdicts import Verdict

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_DELIVERED = Verdict.DELIVERED
_WEAKEST_DBM, _STRONGEST_DBM = -128, 127  # what a verdict's record holds


@dataclass(frozen=True, slots=True)
class Sent:
    """What became of a frame that port ``sender`` offered at ``offered_s``: outcomes as of ``Medium.transmit``.

    ``tag`` is what the caller gave with it; ``attempts`` were made until then, the last at ``rate_bps``.
    """

    sender: int
    frame: bytes
    tag: int
    offered_s: float
    attempts: int
    outcomes: list[Outcome]
    rate_bps: float


class SharedChannel:
    """The channel of one segment. Ports are named by their index."""

    def __init__(self, segment: Segment, ports: Sequence[Port], seed: int, pair: Callable[[int, int], Pair]) -> None:
        """``segment`` has a ``channel``; ``pair`` gives the state of a directed pair of its ports.

        Raises:
            ValueError: An unknown kind of radio, a rate that it lacks, or a port that monitors.
        """
        assert segment.channel is not None
        if any(port.monitor for port in ports):
            raise ValueError("a monitor on a shared channel is not available yet")
        self._pair = pair
        self._ports = tuple(port.index for port in ports)
        self._place = {port: place for place, port in enumerate(self._ports)}
        self._matrix: list[list[float]] | None = None
        self._words = [[-math.inf] * len(ports) for _ in ports]
        self._noise_dbm = segment.channel.noise_dbm
        self._phy = _phy(segment.channel)
        self._rates: dict[float, Rate | None] = {}  # of those that were asked for
        self._channel = _channel(segment.channel, self._phy, ports, seed)
        self.set_pairs(segment.pairs)

    def offer(
        self, sender: int, frame: bytes, receiver: int | None, *, now: float, tag: int, rate_bps: float | None = None
    ) -> list[Outcome]:
        """Queue a frame at ``sender``; returns what is decided at once. Advance to ``now`` first.

        ``rate_bps`` is for group frames; one that the radio does not have counts as None, its lowest basic one.
        """
        rate = None if rate_bps is None else self._rate(rate_bps)
        fates = self._channel.offer(sender, frame, receiver, now=now, tag=tag, rate=rate)
        return [(DROPPED, port, frame, verdict) for port, verdict in fates]

    def next_event(self) -> float | None:
        """When something may be decided next; None: not before another offer."""
        return self._channel.next_event()

    def advance(self, now: float) -> list[Sent]:
        """Let everything happen that is due; returns what was decided."""
        sent = []
        for decided in self._channel.advance(now):
            outcomes: list[Outcome] = []
            for port, verdict in decided.fates:
                if verdict is _DELIVERED:
                    self._pair(decided.sender, port).offer(decided.frame, decided.at_s, outcomes)
                else:
                    outcomes.append((DROPPED, port, decided.frame, verdict))
            who, what, tag, offered_s = decided.sender, decided.frame, decided.tag, decided.offered_s
            sent.append(Sent(who, what, tag, offered_s, decided.attempts, outcomes, decided.rate.bps))
        return sent

    def set_pairs(self, changes: Mapping[tuple[int, int], Impairment | None]) -> None:
        """Take note that these pairs have changed: who is in range, and how strong without a matrix."""
        for (sender, receiver), impairment in changes.items():
            power_dbm = -math.inf
            if impairment is not None:
                power_dbm = DEFAULT_RSSI_DBM if impairment.rssi_dbm is None else impairment.rssi_dbm
            self._words[self._place[sender]][self._place[receiver]] = power_dbm
        self._apply()

    def set_outage(self, pairs: Iterable[tuple[int, int]], *, active: bool) -> None:
        """Lose every later frame on ``pairs``, or end that; who hears the sender still defers to it."""
        self._channel.set_outage(pairs, active=active)

    def set_rssi(self, rssi_dbm: NDArray[np.float64]) -> None:
        """From now on this matrix says how strongly pairs in range are heard, in the order of the segment's ports.

        Raises:
            ValueError: Its shape is not (ports, ports).
        """
        count = len(self._ports)
        if rssi_dbm.shape != (count, count):
            raise ValueError(f"a matrix of {rssi_dbm.shape} for {count} radios")
        self._matrix = rssi_dbm.tolist()
        self._apply()

    def signals_dbm(self, sender: int, outcomes: Iterable[Outcome]) -> dict[int, int]:
        """How strongly the receivers of ``outcomes`` hear ``sender``, as verdict records hold it."""
        rssi_dbm = self._channel.rssi_dbm
        return {outcome[1]: _whole_dbm(rssi_dbm(sender, outcome[1])) for outcome in outcomes}

    @property
    def noise_dbm(self) -> float:
        """Noise at every receiver."""
        return self._noise_dbm

    @property
    def stats(self) -> ChannelStats:
        """The channel's counters."""
        return self._channel.stats

    def _rate(self, bps: float) -> Rate | None:
        if bps not in self._rates:
            self._rates[bps] = None
            with contextlib.suppress(ValueError):
                self._rates[bps] = self._phy.rate(bps)
        return self._rates[bps]

    def _apply(self) -> None:
        if self._matrix is None:
            self._channel.set_rssi(self._words)
            return
        self._channel.set_rssi(
            [
                [power if word != -math.inf else word for power, word in zip(row, words, strict=True)]
                for row, words in zip(self._matrix, self._words, strict=True)
            ]
        )


def _phy(spec: ChannelSpec) -> Phy:
    phy = PHYS.get(spec.phy)
    if phy is None:
        raise ValueError(f"there is no radio '{spec.phy}'; there are {', '.join(PHYS)}")
    return phy if spec.cca_dbm is None else replace(phy, cca_dbm=spec.cca_dbm)


def _channel(spec: ChannelSpec, phy: Phy, ports: Sequence[Port], seed: int) -> Channel:
    return Channel(
        ports,
        phy,
        noise_dbm=spec.noise_dbm,
        seed=seed,
        limit_packets=spec.limit_packets,
        limit_bytes=spec.limit_bytes,
        rate_control=_rate_control(spec, phy),
    )


def _rate_control(spec: ChannelSpec, phy: Phy) -> RateControl:
    return AdaptiveRate(phy) if spec.rate_bps is None else FixedRate(phy.rate(spec.rate_bps))


def _whole_dbm(power_dbm: float) -> int:
    return max(_WEAKEST_DBM, min(_STRONGEST_DBM, round(power_dbm))) if math.isfinite(power_dbm) else _WEAKEST_DBM
