"""How good a link is, as a number in (0, 1], and what it costs: the WNet paper's equations 1, 2 and 4, ETX and ETT.

The equations are damaged in the scan that is at hand; docs/wnet.md tells how each was read and why.
"""

from __future__ import annotations

import math

from wnet.config import MeshConfig, Metric
from wnet.core.wire_control import Attributes

WORST_QUALITY = 1e-3
"""No quality is held worse than this, so that costs stay finite: a bad link is still better than none."""
FRAME_BITS = 8 * 1000
"""What ETT reckons the time of: the 1000-byte frames of the paper's test."""
UNKNOWN_RATE_BPS = 6e6


def signal_quality(snr_db: float, *, scale_db: float) -> float:
    """Map signal over noise to 0..1: little changes at strong signals, much at weak ones.

    Args:
        snr_db: Received signal minus noise; 0 or less is worth nothing.
        scale_db: Decibels for 1 - 1/e, above 0.

    Source: WNet (ROBOCOMM 2007), equation 2.
    """
    return 1.0 - math.exp(-max(snr_db, 0.0) / scale_db)


def sigmoid_quality(ratio: float, *, base: float, steepness: float) -> float:
    """Map a loss ratio or a utilisation to 0..1: nearly 1 up to a threshold of ``1 / steepness``, then steeply down.

    Args:
        ratio: 0..1.
        base: b of the paper, above 1: how steep.
        steepness: c of the paper, above 0.

    Source: WNet (ROBOCOMM 2007), equation 4.
    """
    exponent = (steepness * ratio - 1.0) * math.log(base)
    return 1.0 / (1.0 + math.exp(min(exponent, 700.0)))


def geometric_mean(qualities: list[tuple[float, float]]) -> float:
    """Return the weighted geometric mean of (quality, weight) pairs; 1 if no weight is above 0.

    Source: WNet (ROBOCOMM 2007), equation 1.
    """
    total = sum(weight for _quality, weight in qualities)
    if total <= 0:
        return 1.0
    return math.exp(sum(w * math.log(max(q, 1e-12)) for q, w in qualities if w > 0) / total)


def link_quality(
    attributes: Attributes, sender_utilisation: float, receiver_utilisation: float, config: MeshConfig
) -> float:
    """Return a directed link's quality, WORST_QUALITY..1. An unknown signal is left out of the mean."""
    base, steepness = config.utilisation_base, config.utilisation_steepness
    parts = [
        (
            sigmoid_quality(attributes.loss_ratio, base=config.loss_base, steepness=config.loss_steepness),
            config.loss_weight,
        )
    ]
    if attributes.snr_db is not None:
        parts.append((signal_quality(attributes.snr_db, scale_db=config.signal_scale_db), config.signal_weight))
    if config.utilisation_weight > 0:
        ends = [
            (sigmoid_quality(ratio, base=base, steepness=steepness), 1.0)
            for ratio in (sender_utilisation, receiver_utilisation)
        ]
        parts.append((geometric_mean(ends), config.utilisation_weight))
    return max(geometric_mean(parts), WORST_QUALITY)


def etx(loss_out_ratio: float, loss_in_ratio: float) -> float:
    """Return the expected number of transmissions until frame and acknowledgement have arrived, 1 or more.

    Source: De Couto et al., MobiCom 2003, section 3.1.
    """
    return 1.0 / max((1.0 - loss_out_ratio) * (1.0 - loss_in_ratio), WORST_QUALITY)


def ett_s(loss_out_ratio: float, loss_in_ratio: float, rate_bps: int | None) -> float:
    """Return the expected time to get a frame of 1000 bytes across, in seconds.

    Source: Draves, Padhye, Zill, MobiCom 2004, section 3.1.
    """
    return etx(loss_out_ratio, loss_in_ratio) * FRAME_BITS / (rate_bps or UNKNOWN_RATE_BPS)


def link_cost(out: Attributes, back: Attributes, quality: float, metric: Metric) -> float:
    """Return what the Dijkstra algorithm adds for a link, above 0. ``back`` is the opposite direction.

    The paper says only that links are weighted by quality; 1/Q is ours: perfect links then count hops.
    """
    if metric is Metric.QUALITY:
        return 1.0 / quality
    if metric is Metric.ETX:
        return etx(out.loss_ratio, back.loss_ratio)
    return 1000.0 * ett_s(out.loss_ratio, back.loss_ratio, out.rate_bps)
