"""What came first after each restoration: a probe, an answer, a delivery. What the waterfall of reconnects shows. Pure.

Any datagram of udp_mesh that reaches the other node after the restoration is a *probe*: it is how a node finds out. The
*answer* is the first one that then comes back to the node that sent it. The *delivery* is the first fresh application
message (see :mod:`netlab.traces.reconnects`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from netlab.capture.decoders import mesh_of, udp_of
from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.traces.model import Trace
from netlab.traces.reconnects import Reconnect
from udp_mesh.core.wire import tag_of

#: So long after a restoration without a delivery its packets are still looked at.
PATIENCE_S = 5.0


@dataclass(frozen=True, slots=True)
class Fall:
    """One restoration. Times in seconds since then; None where it did not happen until the next one or the end.

    ``prober`` sent the first probe that arrived, at ``probe_s``; ``heard_s`` is its arrival.
    """

    reconnect: Reconnect
    prober: str | None
    probe_s: float | None
    heard_s: float | None
    answer_s: float | None

    @property
    def delivery_s(self) -> float | None:
        """The first fresh message's arrival at the application."""
        return self.reconnect.delay_s


def span_ns(trace: Trace, reconnect: Reconnect) -> tuple[int, int]:
    """From when to when packets of a reconnect matter."""
    wait_s = PATIENCE_S if reconnect.delay_s is None else min(reconnect.delay_s + 0.1, PATIENCE_S)
    return reconnect.restored_ns, min(reconnect.restored_ns + round(wait_s * 1e9), trace.end_ns + 1_000_000_000)


def fall(reconnect: Reconnect, packets: Iterable[PacketRecord]) -> Fall:
    """Find the first probe and answer among the packets of a reconnect's :func:`span_ns`, in the order of time."""
    sent: dict[tuple[str, int], int] = {}  # node and checksum -> when
    epochs: dict[str, int] = {}
    prober, probe_ns, heard_ns = "", 0, 0
    for record in packets:
        if record.node not in reconnect.between:
            continue
        datagram = udp_of(record.frame, record.linktype)
        mesh = mesh_of(datagram) if datagram is not None else None
        if mesh is None:
            continue
        if record.direction is Direction.OUTBOUND:
            sent[record.node, record.crc32] = record.t_ns
            epochs[record.node] = tag_of(mesh.epoch)
            continue
        other = next(node for node in reconnect.between if node != record.node)
        left_ns = sent.get((other, record.crc32))
        if left_ns is None:
            continue
        if not prober:
            prober, probe_ns, heard_ns = other, left_ns, record.t_ns
        elif record.node == prober and left_ns >= heard_ns and mesh.destination_tag in (0, epochs[prober]):
            return _fall(reconnect, prober, probe_ns, heard_ns, record.t_ns)
    return _fall(reconnect, prober, probe_ns, heard_ns, None)


def _fall(reconnect: Reconnect, prober: str, probe_ns: int, heard_ns: int, answer_ns: int | None) -> Fall:
    def since_s(t_ns: int) -> float:
        return (t_ns - reconnect.restored_ns) / 1e9

    if not prober:
        return Fall(reconnect, None, None, None, None)
    answer_s = None if answer_ns is None else since_s(answer_ns)
    return Fall(reconnect, prober, since_s(probe_ns), since_s(heard_ns), answer_s)
