"""Radios with a phy on the netem engine: every pair by itself, since no qdisc shares airtime among interfaces.

Strengths become impairments of pairs (:mod:`netlab.medium.pair_radio`), rounded to a decibel, and only pairs that have
changed are told to the kernel, at every second matrix or, of many pairs, at every fourth: a tick of 50 ms would keep it
busy with nothing else.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from netlab.engines.base import Engine, LabPlan, Pair, PairCounters
from netlab.medium.impairments import Impairment
from netlab.medium.pair_radio import as_pair
from netlab.medium.segments import DEFAULT_RSSI_DBM, ChannelSpec, Segment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_log = logging.getLogger(__name__)
_EVERY, _EVERY_OF_MANY = 2, 4
_MANY_PAIRS = 500  # in all segments
WARNING = "netem cannot share airtime among radios: each pair has its own rate and losses; engine: air shares it"


def without_airtime(plan: LabPlan) -> LabPlan:
    """The plan that the netem engine gets: radios with a phy as pairs, at the strengths that the scenario gives.

    No radio is in monitor mode there: a pair has no rates, and nobody tells how strongly it heard.
    """
    ports = tuple(replace(port, radiotap=False) for port in plan.ports)
    return replace(plan, ports=ports, segments=tuple(_apart(segment) for segment in plan.segments))


class NetemRadios:
    """See :class:`netlab.engines.base.Engine`. ``pairs`` is an engine made of ``without_airtime(plan)``."""

    name = "netem"

    def __init__(self, plan: LabPlan, pairs: Engine) -> None:
        self._pairs = pairs
        self._segments = {segment.name: segment for segment in plan.segments if segment.channel is not None}
        self._channel_of: dict[int, ChannelSpec] = {
            port: segment.channel
            for segment in self._segments.values()
            if segment.channel is not None
            for port in segment.ports
        }
        self._words: dict[Pair, Impairment | None] = {
            (sender, receiver): segment.pairs.get((sender, receiver))
            for segment in self._segments.values()
            for sender in segment.ports
            for receiver in segment.ports
            if sender != receiver
        }
        self._rssi_dbm: dict[Pair, float] = {}
        self._told = {pair: _heard(self._channel_of[pair[0]], words) for pair, words in self._words.items()}
        self._matrices = dict.fromkeys(self._segments, 0)
        self._every = _EVERY if len(self._words) <= _MANY_PAIRS else _EVERY_OF_MANY
        _log.warning("%s", WARNING)

    @property
    def namespace_fds(self) -> dict[str, int]:
        """Network namespace of every node, held open for the lab's life."""
        return self._pairs.namespace_fds

    def bring_up(self) -> float:
        """Create everything; see the inner engine."""
        return self._pairs.bring_up()

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs; the strengths of radios stay as they were given last."""
        self._tell({pair: words for pair, words in changes.items() if pair not in self._words})
        mine = {pair: words for pair, words in changes.items() if pair in self._words}
        self._tell({pair: self._impairment(pair, words) for pair, words in mine.items()})
        self._words.update(mine)

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Let a segment's strengths take effect, at every few matrices."""
        due = self._matrices[segment] % self._every == 0
        self._matrices[segment] += 1
        if not due:
            return
        ports = self._segments[segment].ports
        for sender, row in zip(ports, rssi_dbm.tolist(), strict=True):
            self._rssi_dbm |= {(sender, port): power for port, power in zip(ports, row, strict=True) if port != sender}
        wanted = {pair: self._impairment(pair, self._words[pair]) for pair in self._words if pair[0] in set(ports)}
        self._tell({pair: new for pair, new in wanted.items() if new != self._told[pair]})

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """See the inner engine."""
        self._pairs.set_outage(pairs, active=active)

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """See the inner engine."""
        self._pairs.set_carrier(ports, up=up)

    def record_verdicts(self, fd: int) -> None:
        """See the inner engine."""
        self._pairs.record_verdicts(fd)

    def pair_counters(self) -> dict[Pair, PairCounters]:
        """See the inner engine."""
        return self._pairs.pair_counters()

    def timing(self) -> dict[str, float] | None:
        """See the inner engine."""
        return self._pairs.timing()

    def problem(self) -> str | None:
        """See the inner engine."""
        return self._pairs.problem()

    def close(self) -> None:
        """See the inner engine."""
        self._pairs.close()

    def _impairment(self, pair: Pair, words: Impairment | None) -> Impairment | None:
        return _heard(self._channel_of[pair[0]], words, self._rssi_dbm.get(pair))

    def _tell(self, changes: Mapping[Pair, Impairment | None]) -> None:
        if changes:
            self._pairs.set_pairs(dict(changes))
            self._told |= {pair: new for pair, new in changes.items() if pair in self._told}


def _heard(channel: ChannelSpec, words: Impairment | None, rssi_dbm: float | None = None) -> Impairment | None:
    """``rssi_dbm`` None: what the words say, or else everybody's default."""
    if words is None:
        return None
    if rssi_dbm is None:
        rssi_dbm = DEFAULT_RSSI_DBM if words.rssi_dbm is None else words.rssi_dbm
    snr_db = rssi_dbm - channel.noise_dbm
    return None if snr_db == float("-inf") else as_pair(channel, round(snr_db), words)


def _apart(segment: Segment) -> Segment:
    if segment.channel is None:
        return segment
    heard = {pair: _heard(segment.channel, words) for pair, words in segment.pairs.items()}
    pairs = {pair: impairment for pair, impairment in heard.items() if impairment is not None}
    return replace(segment, channel=None, pairs=pairs)
