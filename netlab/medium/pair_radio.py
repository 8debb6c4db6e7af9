"""One pair of radios as an impairment of its own, for engines that cannot share airtime among stations. Pure.

What is kept: who is in range, what is left of the losses after the retries, and the rate that the pair would have alone
(airtime, gaps, back-off, acknowledgement, attempts). What is lost: others' airtime, collisions, carrier sense, and the
difference between group and unicast frames, which netem cannot tell apart: group frames get through as if acknowledged.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

from netlab.medium.impairments import Impairment, LossModel, RandomLoss
from netlab.medium.phy import PHYS, Phy, Rate, airtime_s, packet_error_ratio
from netlab.medium.rate_control import ladder
from netlab.medium.segments import ChannelSpec

#: Frames of this size stand for all.
TYPICAL_BYTES = 1000
#: Beyond this residual loss a pair is out of range.
OUT_OF_RANGE_LOSS = 0.99


@lru_cache(maxsize=4096)
def as_pair(spec: ChannelSpec, snr_db: float, words: Impairment) -> Impairment | None:
    """What the kernel is told of a pair whose receiver hears the sender ``snr_db`` over the noise.

    Args:
        spec: The radios' channel.
        snr_db: May be -inf; round it, for the answers are kept.
        words: The pair's own, which act besides: delay, jitter, duplicates... Random loss adds up; any other loss
            model stands in place of the radio's losses.

    Returns:
        None where next to nothing arrives.
    """
    phy = PHYS[spec.phy]
    rate = _rate(phy, spec, snr_db)
    error_ratio = packet_error_ratio(rate, snr_db, TYPICAL_BYTES)
    residual = error_ratio**phy.retry_limit
    if residual > OUT_OF_RANGE_LOSS:
        return None
    attempts = (1.0 - residual) / (1.0 - error_ratio)
    rate_bps = 8 * TYPICAL_BYTES / (attempts * exchange_s(phy, rate, TYPICAL_BYTES))
    limits = replace(words, limit_packets=spec.limit_packets, limit_bytes=spec.limit_bytes, rssi_dbm=None)
    return replace(limits, rate_bps=rate_bps, loss=_together(words, residual))


def exchange_s(phy: Phy, rate: Rate, size_bytes: int) -> float:
    """How long a lone station is busy with one unicast frame: gap, mean back-off, frame, gap, acknowledgement."""
    back_off_s = phy.slot_s * phy.cw_min / 2
    return phy.difs_s + back_off_s + airtime_s(rate, size_bytes) + phy.sifs_s + phy.ack_s(rate)


def _rate(phy: Phy, spec: ChannelSpec, snr_db: float) -> Rate:
    if spec.rate_bps is not None:
        return phy.rate(spec.rate_bps)
    return max(ladder(phy), key=lambda rate: _goodput(phy, rate, snr_db))


def _goodput(phy: Phy, rate: Rate, snr_db: float) -> float:
    return (1.0 - packet_error_ratio(rate, snr_db, TYPICAL_BYTES)) / exchange_s(phy, rate, TYPICAL_BYTES)


def _together(words: Impairment, residual: float) -> LossModel | None:
    own = words.loss
    if own is not None and not isinstance(own, RandomLoss):
        return own
    ratio = 1.0 - (1.0 - (own.loss_ratio if own is not None else 0.0)) * (1.0 - residual)
    return replace(own, loss_ratio=ratio) if own is not None else (RandomLoss(ratio) if ratio > 1e-6 else None)
