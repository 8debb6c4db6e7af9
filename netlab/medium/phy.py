"""802.11 as numbers: rates, airtime, packet error ratio and the constants of medium access, by name. Pure.

A :class:`Phy` is one kind of radio, a :class:`Rate` one of its bit rates. Sizes on the air are those of the MAC frame
(PSDU); :meth:`Phy.psdu_bytes` makes one from an Ethernet frame. Sources: IEEE 802.11-2016, 17.3 (OFDM), 17.4.3
(its times), 19.3 (HT), 19.4.3 (HT airtime), 10.3 (access), 10.7.6.5 (rate of acknowledgements).

In the 2.4 GHz band SIFS is 10 us and every frame is followed by 6 us of silence (18.3.2.4); that is the same timing as
the 5 GHz band's SIFS of 16 us, which is used for both. Errors in preamble and SIGNAL field are left out: they are sent
at the lowest rate and short.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from netlab.medium.bit_errors import HIGHEST_DB, LOWEST_DB, Code, Coded, Curve, Modulation, Receiver, Uncoded, curve

_ETHERNET_HEADER_BYTES = 14
_HEADER_BYTES = 24 + 8 + 4  # MAC header, LLC/SNAP, FCS
_QOS_HEADER_BYTES = _HEADER_BYTES + 2
_OFDM_SERVICE_AND_TAIL_BITS = 16 + 6
ACK_BYTES = 14  # frame control, duration, address, FCS
_SYMBOL_S = 4e-6


@dataclass(frozen=True, slots=True, eq=False)
class Rate:
    """One bit rate of a radio; compared by identity. ``index`` is its place in ``Phy.rates``, -1 if it is basic only.

    ``bps`` is the nominal rate, ``bits_per_symbol`` the data bits in ``symbol_s``, ``preamble_s`` everything ahead of
    the data, ``overhead_bits`` service and tail. ``snr_offset_db`` is added to the link's ratio before the error curve:
    antennas that combine, power that is split between streams. ``log_survival`` is a bit's (see ``bit_errors``).
    """

    index: int
    name: str
    bps: float
    receiver: Receiver
    bits_per_symbol: float
    preamble_s: float
    symbol_s: float = _SYMBOL_S
    overhead_bits: int = _OFDM_SERVICE_AND_TAIL_BITS
    snr_offset_db: float = 0.0
    log_survival: Curve = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "log_survival", curve(self.receiver))


@dataclass(frozen=True, slots=True, eq=False)
class Phy:
    """One kind of radio; compared by identity. Times are seconds, powers dBm.

    ``rates`` are in the order of their ``index``; ``basic``, rising, those at which group frames (the first) and
    acknowledgements are sent. ``header_bytes`` is what replaces an Ethernet header on the air. A station that hears
    ``cca_dbm`` or more defers; its contention window is ``cw_min`` to ``cw_max`` slots; it tries a unicast frame
    ``retry_limit`` times.
    """

    name: str
    rates: tuple[Rate, ...]
    basic: tuple[Rate, ...]
    header_bytes: int = _HEADER_BYTES
    slot_s: float = 9e-6
    sifs_s: float = 16e-6
    cw_min: int = 15
    cw_max: int = 1023
    cca_dbm: float = -90.0
    retry_limit: int = 7

    @property
    def difs_s(self) -> float:
        """SIFS and two slots (IEEE 802.11-2016, 10.3.7)."""
        return self.sifs_s + 2 * self.slot_s

    @property
    def group_rate(self) -> Rate:
        """At which group frames are sent: the lowest basic one."""
        return self.basic[0]

    def psdu_bytes(self, frame_bytes: int) -> int:
        """Size on the air of an Ethernet frame of ``frame_bytes`` (header included, without FCS)."""
        return max(0, frame_bytes - _ETHERNET_HEADER_BYTES) + self.header_bytes

    def ack_rate(self, rate: Rate) -> Rate:
        """At which a frame sent at ``rate`` is acknowledged: the highest basic one that is not above it."""
        return max((basic for basic in self.basic if basic.bps <= rate.bps), default=self.basic[0], key=_bps)

    def ack_s(self, rate: Rate) -> float:
        """Airtime of the acknowledgement of a frame sent at ``rate``."""
        return airtime_s(self.ack_rate(rate), ACK_BYTES)

    def rate(self, bps: float) -> Rate:
        """The rate of that many bits per second; of two the one that needs less signal.

        Raises:
            ValueError: There is none; the text names those that exist.
        """
        fitting = [rate for rate in self.rates if math.isclose(rate.bps, bps, rel_tol=1e-6)]
        if not fitting:
            known = ", ".join(f"{value / 1e6:g}mbit" for value in sorted({rate.bps for rate in self.rates}))
            raise ValueError(f"{self.name} has no rate of {bps / 1e6:g}mbit; its rates are {known}")
        return min(fitting, key=lambda rate: threshold_db(rate, 1024))


def airtime_s(rate: Rate, size_bytes: int) -> float:
    """Duration of a MAC frame of ``size_bytes`` (FCS included) from the first preamble symbol to the last data symbol.

    Source: IEEE 802.11-2016, 17.4.3 (OFDM) and 19.4.3 (HT mixed format): whole symbols after the preamble.
    """
    bits = 8 * size_bytes + rate.overhead_bits
    return rate.preamble_s + rate.symbol_s * math.ceil(bits / rate.bits_per_symbol)


def packet_error_ratio(rate: Rate, snr_db: float, size_bytes: float) -> float:
    """Chance that a MAC frame of ``size_bytes`` is received wrongly at a constant ratio of ``snr_db`` (the link's).

    With interference that covers part of a frame, multiply the chances of its parts to be right, each with its own
    ratio and its share of the size.
    """
    return -math.expm1(8 * size_bytes * rate.log_survival(snr_db + rate.snr_offset_db))


def threshold_db(rate: Rate, size_bytes: int, error_ratio: float = 0.1) -> float:
    """The ratio at which frames of ``size_bytes`` err with ``error_ratio`` (by bisection, to 0.001 dB)."""
    low, high = LOWEST_DB, HIGHEST_DB
    while high - low > 1e-3:
        middle = (low + high) / 2
        low, high = (low, middle) if packet_error_ratio(rate, middle, size_bytes) <= error_ratio else (middle, high)
    return high


def _bps(rate: Rate) -> float:
    return rate.bps


_LADDER = (
    (Modulation.BPSK, Code.HALF, 1 / 2),
    (Modulation.BPSK, Code.THREE_QUARTERS, 3 / 4),
    (Modulation.QPSK, Code.HALF, 1.0),
    (Modulation.QPSK, Code.THREE_QUARTERS, 3 / 2),
    (Modulation.QAM16, Code.HALF, 2.0),
    (Modulation.QAM16, Code.THREE_QUARTERS, 3.0),
    (Modulation.QAM64, Code.TWO_THIRDS, 4.0),
    (Modulation.QAM64, Code.THREE_QUARTERS, 9 / 2),
)  # data bits per subcarrier and symbol; IEEE 802.11-2016, table 17-4
_HT_LADDER = (*_LADDER[:1], *_LADDER[2:], (Modulation.QAM64, Code.FIVE_SIXTHS, 5.0))  # tables 19-27 and 19-28
_OFDM_SUBCARRIERS, _HT_SUBCARRIERS = 48, 52
_OFDM_PREAMBLE_S = 20e-6  # training 16, SIGNAL 4
_HT_PREAMBLE_S = 32e-6  # legacy training 16, L-SIG 4, HT-SIG 8, HT-STF 4
_HT_TRAINING_S = 4e-6  # one HT-LTF per stream


def _ofdm(snr_offset_db: float = 0.0, *, basic_only: bool = False) -> tuple[Rate, ...]:
    rates = []
    for place, (modulation, code, bits) in enumerate(_LADDER):
        bits_per_symbol = _OFDM_SUBCARRIERS * bits
        bps = round(bits_per_symbol / _SYMBOL_S)
        rates.append(
            Rate(
                index=-1 if basic_only else place,
                name=f"{bps / 1e6:g}mbit",
                bps=bps,
                receiver=Coded(modulation, code),
                bits_per_symbol=bits_per_symbol,
                preamble_s=_OFDM_PREAMBLE_S,
                snr_offset_db=snr_offset_db,
            )
        )
    return tuple(rates)


def _ht(streams: int, snr_offset_db: float) -> tuple[Rate, ...]:
    rates = []
    for place, (modulation, code, bits) in enumerate(_HT_LADDER):
        index = len(_HT_LADDER) * (streams - 1) + place
        bits_per_symbol = _HT_SUBCARRIERS * bits * streams
        rates.append(
            Rate(
                index=index,
                name=f"MCS{index}",
                bps=round(bits_per_symbol / _SYMBOL_S),
                receiver=Coded(modulation, code),
                bits_per_symbol=bits_per_symbol,
                preamble_s=_HT_PREAMBLE_S + _HT_TRAINING_S * streams,
                snr_offset_db=snr_offset_db,
            )
        )
    return tuple(rates)


def _mandatory(rates: Sequence[Rate]) -> tuple[Rate, ...]:
    return tuple(rates[:5:2])  # 6, 12 and 24 Mbit/s (17.2.2)


_TWO_ANTENNAS_DB = 10 * math.log10(2)


def _phys() -> Sequence[Phy]:
    g = _ofdm()
    mrc = _TWO_ANTENNAS_DB  # one stream on two receive antennas: their powers add
    split = -_TWO_ANTENNAS_DB  # two streams share the transmit power; telling them apart uses up the second antenna
    basic, basic_mrc = (_mandatory(_ofdm(offset, basic_only=True)) for offset in (0.0, mrc))
    subt = Rate(0, "1mbit", 1_000_000, Uncoded(), 1, preamble_s=0.0, symbol_s=1e-6, overhead_bits=0)
    return (
        Phy("802.11g-20MHz", g, _mandatory(g)),
        Phy("802.11n-20MHz-1x1", _ht(1, 0.0), basic, header_bytes=_QOS_HEADER_BYTES),
        Phy("802.11n-20MHz-2x2", _ht(1, mrc) + _ht(2, split), basic_mrc, header_bytes=_QOS_HEADER_BYTES),
        Phy("subt", (subt,), (subt,)),
    )


#: Every radio by its name in a scenario.
PHYS: dict[str, Phy] = {phy.name: phy for phy in _phys()}
