"""At which rate a station sends to a peer: fixed, or by what it heard of the peer and how its attempts fared. Pure.

Theory of :class:`AdaptiveRate`. The ladder holds the rates worth using: each step is faster than all that need less
signal. A step's threshold is the ratio at which long frames fail one time in ten. A station estimates the ratio at its
peer by that of the frames it hears from it (acknowledgements above all): with equal powers the way is the same both
ways. It picks the highest step that fits under the estimate less a margin. A failed attempt at that step raises the
margin by ``_UP_DB``, a success lowers it by ``_DOWN_DB``: it settles where a third of the attempts fail, which is where
the next step down would carry as much (neighbouring rates differ by a quarter to a half). Unequal powers, noise and
a peer in motion are so made up for; collisions cost at most ``_MOST_MARGIN_DB``. Retries step down the ladder, one step
every two attempts, as the retry chains of Linux's Minstrel do. A frame that failed to the last attempt makes the peer
unknown: until it is heard again, frames to it leave at the lowest rate.

Minstrel arrives at the same rates by sampling others with a tenth of the frames; that cost is left out.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass
from typing import Protocol

from netlab.medium.phy import Phy, Rate, threshold_db

#: For frames of this size, to fail with this ratio at the threshold.
REFERENCE_BYTES, REFERENCE_ERROR_RATIO = 1500, 0.1
_UP_DB, _DOWN_DB = 1.0, 0.5
_FIRST_MARGIN_DB, _MOST_MARGIN_DB = 1.0, 8.0
_NEWEST_WEIGHT = 0.25
_ATTEMPTS_PER_STEP = 2


class RateControl(Protocol):
    """Decides rates; told of every frame heard and every attempt made. Stations are any integers."""

    def rate(self, station: int, peer: int, attempt: int) -> Rate:
        """The rate of ``station``'s attempt number ``attempt`` (from 1) at a unicast frame to ``peer``."""
        ...

    def heard(self, station: int, peer: int, snr_db: float) -> None:
        """``station`` received a frame from ``peer``: any frame, acknowledgements too."""
        ...

    def attempted(self, station: int, peer: int, attempt: int, *, acked: bool) -> None:
        """That attempt of ``station`` was acknowledged or not."""
        ...


class FixedRate:
    """Always the same rate."""

    def __init__(self, rate: Rate) -> None:
        self._rate = rate

    def rate(self, station: int, peer: int, attempt: int) -> Rate:
        """The fixed one."""
        return self._rate

    def heard(self, station: int, peer: int, snr_db: float) -> None:
        """Changes nothing."""

    def attempted(self, station: int, peer: int, attempt: int, *, acked: bool) -> None:
        """Changes nothing."""


@dataclass(slots=True)
class _Peer:
    snr_db: float | None = None
    margin_db: float = _FIRST_MARGIN_DB


class AdaptiveRate:
    """Goes by the ratio heard and by acknowledgements; see the module's theory."""

    def __init__(self, phy: Phy) -> None:
        self._ladder = ladder(phy)
        self._thresholds_db = [threshold_db(rate, REFERENCE_BYTES, REFERENCE_ERROR_RATIO) for rate in self._ladder]
        self._retry_limit = phy.retry_limit
        self._peers: dict[tuple[int, int], _Peer] = {}

    def rate(self, station: int, peer: int, attempt: int) -> Rate:
        """The lowest while nothing was heard of ``peer``."""
        known = self._peers.get((station, peer))
        if known is None or known.snr_db is None:
            return self._ladder[0]
        step = bisect_right(self._thresholds_db, known.snr_db - known.margin_db) - 1
        return self._ladder[max(0, step - (attempt - 1) // _ATTEMPTS_PER_STEP)]

    def heard(self, station: int, peer: int, snr_db: float) -> None:
        """Moves the estimate a quarter of the way; the first frame sets it."""
        known = self._peer(station, peer)
        before = known.snr_db
        known.snr_db = snr_db if before is None else before + _NEWEST_WEIGHT * (snr_db - before)

    def attempted(self, station: int, peer: int, attempt: int, *, acked: bool) -> None:
        """Moves the margin by the attempts at the step of first choice; the last failure makes the peer unknown."""
        known = self._peer(station, peer)
        if attempt <= _ATTEMPTS_PER_STEP:
            moved_db = known.margin_db + (-_DOWN_DB if acked else _UP_DB)
            known.margin_db = min(max(0.0, moved_db), _MOST_MARGIN_DB)
        if not acked and attempt >= self._retry_limit:
            known.snr_db = None

    def _peer(self, station: int, peer: int) -> _Peer:
        known = self._peers.get((station, peer))
        if known is None:
            known = self._peers[station, peer] = _Peer()
        return known


def ladder(phy: Phy) -> tuple[Rate, ...]:
    """The rates worth using, by rising threshold: each is faster than all that need less signal."""
    steps: list[Rate] = []
    for rate in sorted(phy.rates, key=lambda rate: threshold_db(rate, REFERENCE_BYTES, REFERENCE_ERROR_RATIO)):
        if not steps or rate.bps > steps[-1].bps:
            steps.append(rate)
    return tuple(steps)
