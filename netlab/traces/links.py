"""What became of frames between interfaces, told from packets alone: for runs whose medium gives no verdicts.

A frame that left one interface arrived at another if the same bytes came in there. Why a frame is missing cannot be
told: all that is missing counts as lost, frames that were corrupted on the way included. Of equal frames that are under
way at the same time only one is found again.
"""

from __future__ import annotations

from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.model import Interface, LinkCounts

_GROUP = 0x01  # the bit of a destination address that makes it broadcast or multicast


class PacketLinks:
    """Counts frames per directed pair of interfaces. Packets must come in the order of time.

    Args:
        macs: The address of each interface, from the run's metadata; interfaces without one get no entry.
    """

    def __init__(self, macs: dict[bytes, Interface]) -> None:
        self._macs = macs
        # By the frame's checksum: who sent such a frame last, and who has it already (further copies do not count).
        self._sent: dict[int, tuple[Interface, set[Interface]]] = {}
        self._unicast: dict[tuple[Interface, Interface], list[int]] = {}  # frames, bytes
        self._group: dict[Interface, list[int]] = {}
        self._arrived: dict[tuple[Interface, Interface], int] = {}

    def packet(self, record: PacketRecord) -> None:
        """Count one packet at one interface."""
        here, target = (record.node, record.interface), self._macs.get(record.frame[:6])
        if record.direction is Direction.OUTBOUND:
            if record.frame[:1] and record.frame[0] & _GROUP:
                offered = self._group.setdefault(here, [0, 0])
            elif target is not None:
                offered = self._unicast.setdefault((here, target), [0, 0])
            else:
                return
            self._sent[record.crc32] = (here, {here})
            offered[0] += 1
            offered[1] += record.original_length
        elif target in (here, None) and (sent := self._sent.get(record.crc32)) and here not in sent[1]:
            sent[1].add(here)
            self._arrived[sent[0], here] = self._arrived.get((sent[0], here), 0) + 1

    def counts(self) -> dict[tuple[Interface, Interface], LinkCounts]:
        """One entry per pair that was addressed by unicast or over which anything ever arrived."""
        links = {}
        for pair in sorted(self._unicast.keys() | self._arrived.keys()):
            unicast, group = self._unicast.get(pair, [0, 0]), self._group.get(pair[0], [0, 0])
            frames, arrived = unicast[0] + group[0], self._arrived.get(pair, 0)
            if frames:
                verdicts = {Verdict.DELIVERED: arrived, Verdict.LOST: frames - arrived}
                known = {verdict: count for verdict, count in verdicts.items() if count}
                links[pair] = LinkCounts(frames, unicast[1] + group[1], known)
        return links
