"""What the kernel can tell about the frames of each pair that did not arrive, for an engine that sees no frame.

Theory (net/sched/sch_netem.c, net/sched/act_mirred.c). netem has one counter for what its loss model takes and for what
finds its queue full. But to the filter that handed the frame over it answers differently: "queued" after a loss, "not
queued" when the queue was full, and then the filter's mirror action counts an overlimit. So overlimits by target are
the full queues. The same counter also moves when the target is down or without carrier, which happens at the far ends
of veths only:

* while the lab itself has pulled the cable, the count is left out;
* when the node has taken its interface down, the far end's count of lost carriers tells, and nothing is claimed.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence

from netlab.engines.base import Pair, PairCounters
from netlab.kernel.counters import QdiscCounters, carrier_losses, mirred_refusals, root_qdiscs
from netlab.kernel.netlink import NetlinkSocket

_NONE = QdiscCounters("none", waiting=0, drops=0, requeues=0)


class Counters:
    """Reads the counters of all pairs; has to be told around every change of a carrier."""

    def __init__(self, sock: NetlinkSocket, shapes: Mapping[Pair, int], far_ends: Mapping[int, int]) -> None:
        """Begin to count.

        Args:
            sock: In the namespace of the far ends.
            shapes: Where each pair's netem is, as an interface index.
            far_ends: Interface index of each port's far end.
        """
        self._sock = sock
        self._shapes = shapes
        self._far_ends = far_ends
        self._pulled: dict[int, int] = {}  # interface index -> refusals when its cable was pulled
        self._unplugged_refusals: dict[int, int] = {}
        self._losses = carrier_losses(sock)

    @contextlib.contextmanager
    def around_carrier(self, ports: Sequence[int], *, up: bool) -> Iterator[None]:
        """Around the change of these ports' cables; if it fails, all is counted as before.

        Raises:
            OSError: The kernel refuses.
        """
        refusals = mirred_refusals(self._sock)
        pulled, unplugged = dict(self._pulled), dict(self._unplugged_refusals)
        for index in (self._far_ends[port] for port in ports):
            now = refusals.get(index, 0)
            if not up:
                self._pulled[index] = now
            elif index in self._pulled:  # what was refused since then had no carrier
                since = now - self._pulled.pop(index)
                self._unplugged_refusals[index] = self._unplugged_refusals.get(index, 0) + since
        try:
            yield
        except BaseException:
            self._pulled, self._unplugged_refusals = pulled, unplugged
            raise
        if up:  # the carrier that the pull has cost is no news
            losses = carrier_losses(self._sock)
            self._losses |= {index: losses.get(index, 0) for index in (self._far_ends[port] for port in ports)}

    def read(self) -> dict[Pair, PairCounters]:
        """Counts since bring-up.

        Raises:
            OSError: The kernel refuses.
        """
        refusals, losses, qdiscs = mirred_refusals(self._sock), carrier_losses(self._sock), root_qdiscs(self._sock)
        found = {}
        for pair, index in self._shapes.items():
            qdisc = qdiscs.get(index, _NONE)
            refused = self._pulled.get(index, refusals.get(index, 0)) - self._unplugged_refusals.get(index, 0)
            undisturbed = index in self._pulled or losses.get(index) == self._losses.get(index)
            queue_full = _queue_full(refused, qdisc.drops, undisturbed=undisturbed)
            found[pair] = PairCounters(queue_full, waiting=qdisc.waiting, reordered=qdisc.requeues)
        return found


def _queue_full(refused: int, drops: int, *, undisturbed: bool) -> int | None:
    """Frames that found the queue full: refused at the hand-over, and dropped by netem; None if nobody can tell."""
    if not refused or not drops:
        return 0
    return refused if undisturbed and refused <= drops else None
