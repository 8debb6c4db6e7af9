"""How strongly pairs hear each other now, for whoever asks: the last strengths that the engine was given. No I/O."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from netlab.engines.base import LabPlan, Pair
from netlab.medium.segments import ChannelSpec, Segment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_SHORT_FRAME_BYTES = 200


class Signals:
    """Strengths of the segments that have them; pairs of all others have none."""

    def __init__(self, plan: LabPlan) -> None:
        self._segment_of: dict[int, Segment] = {
            port: segment for segment in plan.segments if segment.channel is not None for port in segment.ports
        }
        self._place = {port: segment.ports.index(port) for port, segment in self._segment_of.items()}
        self._rows: dict[str, list[list[float]]] = {}
        self._matrices: dict[str, NDArray[np.float64]] = {}

    def set(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Take note of a segment's strengths, ``[sender, receiver]`` in the order of its ports."""
        self._rows[segment] = rssi_dbm.tolist()
        self._matrices[segment] = rssi_dbm

    def heard(self, segment: Segment) -> NDArray[np.bool_]:
        """:meth:`is_heard` of all pairs of a segment with strengths, ``[sender, receiver]``."""
        assert segment.channel is not None
        return self._matrices[segment.name] - segment.channel.noise_dbm >= least_snr_db(segment.channel.phy)

    def rssi_dbm(self, pair: Pair) -> float | None:
        """How strongly the receiver hears the sender; -inf for not at all, None where nobody has said."""
        segment = self._segment_of.get(pair[0])
        if segment is None or segment.name not in self._rows or pair[1] not in segment.ports:
            return None
        return self._rows[segment.name][self._place[pair[0]]][self._place[pair[1]]]

    def snr_db(self, pair: Pair) -> float | None:
        """The same, over the noise."""
        power_dbm = self.rssi_dbm(pair)
        return None if power_dbm is None else power_dbm - self._channel(pair).noise_dbm

    def is_heard(self, pair: Pair) -> bool:
        """Whether at least half of the short frames at the lowest rate arrive; True where nobody has said."""
        snr_db = self.snr_db(pair)
        return snr_db is None or snr_db >= least_snr_db(self._channel(pair).phy)

    def _channel(self, pair: Pair) -> ChannelSpec:
        channel = self._segment_of[pair[0]].channel
        assert channel is not None
        return channel


@lru_cache(maxsize=64)
def least_snr_db(phy: str) -> float:
    """The ratio at which half of the short group frames arrive."""
    from netlab.medium.phy import PHYS, threshold_db

    return threshold_db(PHYS[phy].group_rate, _SHORT_FRAME_BYTES, 0.5)
