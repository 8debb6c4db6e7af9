"""From a capture to pcapng: every packet message becomes one packet, with the medium's reasons as comments."""

from __future__ import annotations

from collections import deque
from pathlib import Path

from netlab.capture.pcapng import INBOUND, OUTBOUND, PcapngWriter
from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.capture.schemas import Direction
from netlab.capture.topics import SNAPLEN
from netlab.errors import CaptureError
from netlab.medium.verdicts import Verdict

# The medium decides on a frame after the sender's interface saw it; its process may be a while in getting to it.
_DECIDED_WITHIN_NS = 500_000_000
_STAMP_SLACK_NS = 1_000_000
_FLAGS = {Direction.INBOUND: INBOUND, Direction.OUTBOUND: OUTBOUND, Direction.UNKNOWN: 0}
_REASONS = {
    Verdict.LOST: "lost on the way",
    Verdict.QUEUE_FULL: "dropped: queue full",
    Verdict.OUTAGE: "dropped: outage",
    Verdict.OUT_OF_RANGE: "dropped: out of range",
    Verdict.CORRUPTED: "corrupted on the way",
    Verdict.DUPLICATED: "duplicated on the way",
    Verdict.REORDERED: "delivered ahead of others",
    Verdict.COLLISION: "lost: drowned by another transmission",
}


def export_pcapng(capture: Capture, path: Path) -> int:
    """Write all packets of a capture, in the order of time; return how many.

    Raises:
        CaptureError: The file cannot be written.
    """
    verdicts = VerdictIndex(capture)
    count = 0
    try:
        with path.open("wb") as file:
            writer = PcapngWriter(file, application="netlab export", comment=_comment(capture))
            numbers = _declare(capture, writer)
            for record in capture.records({Kind.PACKET}):
                if not isinstance(record, PacketRecord):
                    continue
                key = (record.node, record.interface)
                if key not in numbers:
                    numbers[key] = _interface(writer, *key, record.linktype)
                writer.add_packet(
                    numbers[key],
                    record.t_ns,
                    record.frame,
                    original_length=record.original_length,
                    direction=_FLAGS[record.direction],
                    comments=verdicts.comments(record),
                )
                count += 1
    except OSError as error:
        raise CaptureError(f"{path}: {error.strerror}") from None
    return count


class VerdictIndex:
    """The medium's remarkable decisions by sender interface and frame, to be matched with the sender's packets."""

    def __init__(self, capture: Capture) -> None:
        self._waiting: dict[tuple[tuple[str, str], int], deque[VerdictRecord]] = {}
        for record in capture.records({Kind.VERDICT}):
            if isinstance(record, VerdictRecord):
                # Deliveries stay in: without them a reason would slip to an earlier frame of the same bytes.
                self._waiting.setdefault((record.sender, record.crc32), deque()).append(record)

    def take(self, packet: PacketRecord) -> list[VerdictRecord]:
        """Return the decisions on an outgoing packet. Packets of one interface must come in the order of time."""
        waiting = self._waiting.get(((packet.node, packet.interface), packet.crc32))
        if not waiting or packet.direction is not Direction.OUTBOUND:
            return []
        while waiting and waiting[0].t_ns < packet.t_ns - _STAMP_SLACK_NS:
            waiting.popleft()
        taken: list[VerdictRecord] = []
        receivers: set[tuple[str, str]] = set()
        while waiting and waiting[0].t_ns <= packet.t_ns + _DECIDED_WITHIN_NS:
            record = waiting[0]
            if record.receiver in receivers and record.verdict is not Verdict.DUPLICATED:
                break  # the next frame of the same bytes begins
            receivers.add(record.receiver)
            taken.append(waiting.popleft())
        return taken

    def comments(self, packet: PacketRecord) -> tuple[str, ...]:
        """What became of an outgoing packet, one line per receiver that did not simply get it."""
        return tuple(
            f"{record.receiver[0]}/{record.receiver[1]}: {_REASONS[record.verdict]}"
            for record in self.take(packet)
            if record.verdict in _REASONS
        )


def _declare(capture: Capture, writer: PcapngWriter) -> dict[tuple[str, str], int]:
    numbers = {}
    for topic in capture.topics:
        if topic.kind is Kind.PACKET and topic.schema == "netlab.Packet":
            _, node, interface, _ = topic.name.split("/")
            linktype = topic.metadata.get("linktype", "1")
            numbers[node, interface] = _interface(writer, node, interface, int(linktype) if linktype.isdigit() else 1)
    return numbers


def _interface(writer: PcapngWriter, node: str, interface: str, linktype: int) -> int:
    return writer.add_interface(f"{node}/{interface}", linktype=linktype, snaplen=SNAPLEN)


def _comment(capture: Capture) -> str:
    name = capture.metadata.get("name", capture.path.name)
    return f"scenario {name}, seed {capture.metadata.get('seed', '?')}, t0 {capture.t0_ns} ns"
