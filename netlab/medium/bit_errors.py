"""From the signal-to-noise ratio to the error ratio of one decoded bit, for the modulations and codes of 802.11. Pure.

Theory: the ratio of wrong bits behind the demodulator follows from the modulation (white Gaussian noise, no equaliser
loss); the hard-decision Viterbi decoder is bounded by the union over the code's distance spectrum, with
D = sqrt(4 p (1 - p)). Source: Pei and Henderson, "Validation of OFDM error rate model in ns-3" (Boeing, 2010), known
as the NIST model of ns-3; spectra of the punctured 802.11 code as tabulated there (rate 5/6: Haccoun and Begin, IEEE
Trans. Communications 37(11), 1989, table V). Real receivers decode with soft decisions: against EMANE's curves for
128-byte frames the bound asks for 1 to 3 dB more at 6 Mbit/s and is within 1.2 dB at 54 Mbit/s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache

#: From here to there a curve is tabulated; below every bit is a coin toss, above errors are beyond counting.
LOWEST_DB, HIGHEST_DB, STEP_DB = -20.0, 50.0, 0.05
_PER_DB = 1 / STEP_DB
_WORST = 0.5


class Modulation(Enum):
    """Constellation: (factor, divisor) of the bit error ratio ``factor * erfc(sqrt(snr / divisor))``."""

    BPSK = (1 / 2, 1.0)
    QPSK = (1 / 2, 2.0)
    QAM16 = (3 / 8, 10.0)
    QAM64 = (7 / 24, 42.0)

    def bit_error_ratio(self, snr: float) -> float:
        """Wrong bits over all bits ahead of the decoder; ``snr`` is linear, at least 0."""
        factor: float = self.value[0]
        divisor: float = self.value[1]
        return factor * math.erfc(math.sqrt(snr / divisor))


class Code(Enum):
    """Rate of the convolutional code: (bits in per step, first exponent, its increment, the spectrum's weights)."""

    HALF = (1, 10, 2, (36, 211, 1404, 11633, 77433, 502690, 3322763, 21292910, 134365911))
    TWO_THIRDS = (2, 6, 1, (3, 70, 285, 1276, 6160, 27128, 117019, 498860, 2103891, 8784123))
    THREE_QUARTERS = (3, 5, 1, (42, 201, 1492, 10469, 62935, 379644, 2253373, 13073811, 75152755, 428005675))
    FIVE_SIXTHS = (
        5, 4, 1,
        (92, 528, 8694, 79453, 792114, 7375573, 67884974, 610875423, 5427275376, 47664215639),
    )  # fmt: skip

    def decoded_error_ratio(self, bit_error_ratio: float) -> float:
        """Wrong bits over all bits behind the decoder, at most 1/2; ``bit_error_ratio`` is 0..1/2 ahead of it."""
        step, first, increment, weights = self.value
        d = math.sqrt(4 * bit_error_ratio * (1 - bit_error_ratio))
        terms = (weight * math.pow(d, first + increment * place) for place, weight in enumerate(weights))
        bound: float = math.fsum(terms) / (2 * step)
        return min(_WORST, bound)


@dataclass(frozen=True, slots=True)
class Coded:
    """802.11 OFDM: a modulation behind a convolutional code."""

    modulation: Modulation
    code: Code

    def bit_error_ratio(self, snr: float) -> float:
        """Wrong bits over all decoded bits; ``snr`` is linear, per subcarrier."""
        return self.code.decoded_error_ratio(self.modulation.bit_error_ratio(snr))


@dataclass(frozen=True, slots=True)
class Uncoded:
    """The DARPA SubT simulator's receiver: ``erfc(sqrt(snr))`` per bit, at most 1/2.

    Source: osrf/subt, subt_rf_model; its packet error takes the size in bytes for bits, which is not followed here.
    """

    def bit_error_ratio(self, snr: float) -> float:
        """Wrong bits over all bits; ``snr`` is linear."""
        return min(_WORST, math.erfc(math.sqrt(snr)))


Receiver = Coded | Uncoded


class Curve:
    """The natural logarithm of a bit's chance to be right, as a function of the ratio in dB.

    From a table in steps of ``STEP_DB`` with linear interpolation (relative error of the bit error ratio below 2 %,
    that is 0.002 dB), since a busy channel asks for it a hundred thousand times a second.
    """

    __slots__ = ("_receiver", "_table")

    def __init__(self, receiver: Receiver) -> None:
        self._receiver = receiver
        steps = range(round((HIGHEST_DB - LOWEST_DB) / STEP_DB) + 1)
        ratios = [10 ** ((LOWEST_DB + STEP_DB * step) / 10) for step in steps]
        self._table = [math.log1p(-receiver.bit_error_ratio(ratio)) for ratio in ratios]

    def __call__(self, snr_db: float) -> float:
        """Zero at most; constant beyond the ends of the table."""
        table = self._table
        place = (snr_db - LOWEST_DB) * _PER_DB
        if place <= 0:
            return table[0]
        index = int(place)
        if index >= len(table) - 1:
            return table[-1]
        left = table[index]
        return left + (table[index + 1] - left) * (place - index)

    def __reduce__(self) -> tuple[Callable[[Receiver], Curve], tuple[Receiver]]:
        """Pickle the receiver; the table is made anew."""
        return curve, (self._receiver,)


@lru_cache(maxsize=64)
def curve(receiver: Receiver) -> Curve:
    """The receiver's curve, made once."""
    return Curve(receiver)
