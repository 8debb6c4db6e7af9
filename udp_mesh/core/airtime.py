"""How long a datagram keeps a shared channel busy, as far as a node can know: for shares of it, not for timing."""

from __future__ import annotations

_BELOW_UDP_BYTES = 28 + 36  # IPv4 and UDP; LLC, 802.11 header and checksum
_ACKNOWLEDGE_S = 36e-6  # SIFS, preamble
_ACKNOWLEDGEMENT_BYTES = 14
_ACCESS_S = 121.5e-6  # preamble 20 us, DIFS 34 us, mean backoff 7.5 slots of 9 us


def airtime_s(size_bytes: int, *, channel_bps: float) -> float:
    """Return the airtime of a broadcast of ``size_bytes`` at the channel's basic rate.

    Source: IEEE 802.11 OFDM PHY and DCF with the least contention window; on a slow carrier the bytes dominate.
    """
    return _ACCESS_S + 8 * (size_bytes + _BELOW_UDP_BYTES) / channel_bps


def exchange_s(size_bytes: int, *, channel_bps: float) -> float:
    """Return the airtime of a unicast of ``size_bytes`` with its acknowledgement, at the channel's rate.

    Source: as :func:`airtime_s`, and SIFS 16 us, preamble 20 us and 14 bytes (IEEE 802.11-2016, 10.3.2.9).
    """
    return airtime_s(size_bytes, channel_bps=channel_bps) + _ACKNOWLEDGE_S + 8 * _ACKNOWLEDGEMENT_BYTES / channel_bps
