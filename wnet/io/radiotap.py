"""The radiotap header of a monitor-mode interface: what a receiver adds to a frame, and what a sender may ask for.

Pure. Source: radiotap.org (fields, in the order of their bits, each aligned to its own size from the header's start).
Both directions are here, because the lab's radios are the other end of this format.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

#: (size, alignment) by bit; what stands behind the last known bit is not needed.
_FIELDS = {
    0: (8, 8),  # TSFT
    1: (1, 1),  # flags
    2: (1, 1),  # rate
    3: (4, 2),  # channel
    4: (2, 2),  # FHSS
    5: (1, 1),  # signal in dBm
    6: (1, 1),  # noise in dBm
    7: (2, 2),  # lock quality
    8: (2, 2),  # TX attenuation
    9: (2, 2),  # the same in dB
    10: (1, 1),  # TX power in dBm
    11: (1, 1),  # antenna
    12: (1, 1),  # signal in dB
    13: (1, 1),  # noise in dB
    14: (2, 2),  # RX flags
    15: (2, 2),  # TX flags
    16: (1, 1),  # RTS retries
    17: (1, 1),  # data retries
    18: (8, 4),  # XChannel
    19: (3, 1),  # MCS
}
_FLAGS, _RATE, _SIGNAL, _NOISE, _TX_FLAGS, _RETRIES, _MCS = 1, 2, 5, 6, 15, 17, 19
_MORE_BITS = 1 << 31
_HEAD = struct.Struct("<BxHI")
_FLAG_FCS, _FLAG_BAD_FCS = 0x10, 0x40
_TX_NO_ACK = 0x0008
_MCS_KNOWS_BANDWIDTH, _MCS_KNOWS_INDEX, _MCS_KNOWS_GUARD = 0x01, 0x02, 0x04
_MCS_40_MHZ, _MCS_SHORT_GUARD = 0x01, 0x04
FCS_BYTES = 4

_RATE_UNIT_BPS = 500_000
_LEGACY_BPS = frozenset(round(mbit * 1e6) for mbit in (1, 2, 5.5, 11, 6, 9, 12, 18, 24, 36, 48, 54))
#: Of one stream with 20 MHz and the long guard interval (IEEE 802.11-2016, table 19-27).
_MCS_BPS = (6_500_000, 13_000_000, 19_500_000, 26_000_000, 39_000_000, 52_000_000, 58_500_000, 65_000_000)
_MCS_40_MHZ_FACTOR, _SHORT_GUARD_FACTOR = 108 / 52, 10 / 9
_STREAMS_MAX = 4
#: What a header that asks for a rate takes at most, so that members can reserve room for it.
TRANSMIT_BYTES_MAX = 14


@dataclass(frozen=True, slots=True)
class Received:
    """What a header says of the frame behind it; None is not told. ``has_fcs``: four bytes of checksum end the frame.

    ``is_echo``: a monitor shows what this very radio has sent.
    """

    length_bytes: int
    signal_dbm: float | None
    noise_dbm: float | None
    rate_bps: int | None
    has_fcs: bool
    is_bad: bool
    is_echo: bool


def decode(data: bytes) -> Received | None:
    """Read the header that ``data`` begins with; None if it is cut, of another version or impossible."""
    if len(data) < _HEAD.size:
        return None
    version, length, present = _HEAD.unpack_from(data)
    start = _HEAD.size
    more = present
    while more & _MORE_BITS and start + 4 <= min(length, len(data)):
        (more,) = struct.unpack_from("<I", data, start)
        start += 4
    if version or more & _MORE_BITS or not start <= length <= len(data):
        return None
    found = _locate(present, start)
    if any(at + _FIELDS[bit][0] > length for bit, at in found.items()):
        return None
    flags = data[found[_FLAGS]] if _FLAGS in found else 0
    return Received(
        length,
        _signed(data, found.get(_SIGNAL)),
        _signed(data, found.get(_NOISE)),
        _rate_bps(data, found),
        bool(flags & _FLAG_FCS),
        bool(flags & _FLAG_BAD_FCS),
        _TX_FLAGS in found,
    )


def _locate(present: int, start: int) -> dict[int, int]:
    """Where each known field begins, up to the first that is not known."""
    found = {}
    for bit in range(31):
        if present >> bit & 1:
            if bit not in _FIELDS:
                break
            size, alignment = _FIELDS[bit]
            found[bit] = start = (start + alignment - 1) // alignment * alignment
            start += size
    return found


def _signed(data: bytes, at: int | None) -> float | None:
    return None if at is None else float(int.from_bytes(data[at : at + 1], "little", signed=True))


def _rate_bps(data: bytes, found: dict[int, int]) -> int | None:
    if _RATE in found and data[found[_RATE]]:
        return data[found[_RATE]] * _RATE_UNIT_BPS
    if _MCS not in found:
        return None
    known, flags, index = data[found[_MCS] : found[_MCS] + 3]
    if not known & _MCS_KNOWS_INDEX or index >= _STREAMS_MAX * len(_MCS_BPS):
        return None
    bps = float(_mcs_bps(index))
    if known & _MCS_KNOWS_BANDWIDTH and flags & 3 == _MCS_40_MHZ:
        bps *= _MCS_40_MHZ_FACTOR
    if known & _MCS_KNOWS_GUARD and flags & _MCS_SHORT_GUARD:
        bps *= _SHORT_GUARD_FACTOR
    return round(bps)


def _mcs_bps(index: int) -> int:
    return _MCS_BPS[index % len(_MCS_BPS)] * (1 + index // len(_MCS_BPS))


def encode_received(*, signal_dbm: float, noise_dbm: float | None, rate_bps: float | None) -> bytes:
    """A receiver's header; figures are rounded to the format's units, and kept within -128 to 127 dBm."""
    fields: dict[int, bytes] = {_FLAGS: b"\0", _SIGNAL: _dbm(signal_dbm)}
    if noise_dbm is not None:
        fields[_NOISE] = _dbm(noise_dbm)
    return _header(fields | _rate_fields(rate_bps))


def encode_transmit(rate_bps: float | None) -> bytes:
    """A sender's header: no acknowledgement, no retries, and a rate if it is one that the format knows."""
    fields = {_TX_FLAGS: struct.pack("<H", _TX_NO_ACK), _RETRIES: b"\0"}
    return _header(fields | _rate_fields(rate_bps))


def _rate_fields(rate_bps: float | None) -> dict[int, bytes]:
    if rate_bps is None:
        return {}
    if round(rate_bps) in _LEGACY_BPS:
        return {_RATE: bytes([round(rate_bps / _RATE_UNIT_BPS)])}
    for index in range(_STREAMS_MAX * len(_MCS_BPS)):  # the fewest streams need the least signal
        if _mcs_bps(index) == round(rate_bps):
            known = _MCS_KNOWS_BANDWIDTH | _MCS_KNOWS_INDEX | _MCS_KNOWS_GUARD
            return {_MCS: bytes([known, 0, index])}
    return {}


def _header(fields: dict[int, bytes]) -> bytes:
    body = bytearray()
    present = 0
    for bit in sorted(fields):
        body += bytes(-(_HEAD.size + len(body)) % _FIELDS[bit][1])
        body += fields[bit]
        present |= 1 << bit
    return _HEAD.pack(0, _HEAD.size + len(body), present) + bytes(body)


def _dbm(value: float) -> bytes:
    return max(-128, min(127, round(value))).to_bytes(1, "little", signed=True)
