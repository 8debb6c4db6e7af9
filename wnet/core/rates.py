"""Which rate a radio should send at: the fastest that all next hops of a frame can receive (WNet paper, III-D).

What a rate needs is taken from the error curves of 802.11's OFDM rates (10 % of 1000-byte frames lost, as the usual
NIST model has it); rates of several spatial streams, and of wider channels, from the rate per stream.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence

from wnet.core.link import Link

MARGIN_DB = 3.0
"""On top of what a rate needs: fading between the last report and now."""
_NEEDED = (  # of a 20 MHz channel and one stream: bit/s, signal to noise in dB
    *((1e6, 1.0), (2e6, 3.0), (6e6, 5.0), (9e6, 6.5), (12e6, 8.0), (18e6, 10.5), (24e6, 13.5), (36e6, 17.0)),
    *((48e6, 21.0), (54e6, 22.5), (65e6, 24.5), (72.2e6, 25.5)),
)
_RATES, _NEEDED_DB = zip(*_NEEDED, strict=True)
_DB_PER_DOUBLING = 3.0


def needed_snr_db(rate_bps: float) -> float:
    """Return the signal to noise that a rate needs, in dB; beyond 72.2 Mbit/s 3 dB for every doubling by streams."""
    extra_db = 0.0
    while rate_bps > _RATES[-1]:
        rate_bps /= 2.0
        extra_db += _DB_PER_DOUBLING
    at = bisect_right(_RATES, rate_bps)
    if at == 0:
        return float(_NEEDED_DB[0])
    if at == len(_RATES):
        return float(_NEEDED_DB[-1]) + extra_db
    low, high = _RATES[at - 1], _RATES[at]
    share = (rate_bps - low) / (high - low)
    return float(_NEEDED_DB[at - 1] + share * (_NEEDED_DB[at] - _NEEDED_DB[at - 1])) + extra_db


def fastest(rates_bps: Sequence[int], snr_db: float) -> int | None:
    """Return the fastest of some rates that a link carries, the slowest if none is safe; None if there are none."""
    if not rates_bps:
        return None
    safe = [rate for rate in rates_bps if needed_snr_db(rate) + MARGIN_DB <= snr_db]
    return max(safe, default=min(rates_bps))


def rate_for(rates_bps: Sequence[int], links: Iterable[Link]) -> int | None:
    """Return the rate for a frame to these next hops; None, the driver's choice, where one's signal is unknown.

    What a link fails to acknowledge lowers its rate for a while (``rate_margin_db``).
    """
    chosen: int | None = None
    for link in links:
        if link.told is None or link.told.snr_db is None:
            return None
        rate = fastest(rates_bps, link.told.snr_db - link.rate_margin_db)
        if rate is None:
            return None
        chosen = rate if chosen is None else min(chosen, rate)
    return chosen
