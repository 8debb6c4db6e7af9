"""Who talked to whom: frames and bytes of each pair of nodes and protocol, in both directions.

What counts is what left a node's interfaces; what came in elsewhere tells how much of it arrived. In a mesh a frame
counts twice, once inside the mesh interface for its ends, once per transmission for the mesh itself.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from netlab.capture.decoders import ethertype, peel, udp_of
from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.traces.model import EVERYBODY, Trace
from udp_mesh.core.wire import MAGIC

_PROTOCOLS = {1: "ICMP", 2: "IGMP", 6: "TCP", 17: "UDP", 58: "ICMPv6"}
_ETHERTYPES = {0x0806: "ARP", 0x86DD: "IPv6", 0x88CC: "LLDP"}
_IPV4, _GROUP = 0x0800, 0x01


@dataclass(slots=True)
class Flow:
    """One direction. ``arrived`` counts frames seen at the other node; None where the destination is everybody."""

    frames: int = 0
    size_bytes: int = 0
    arrived: int | None = 0


@dataclass(slots=True)
class Conversation:
    """All frames of one protocol between two nodes. ``b`` may be ``all``, or an address that is no node's.

    ``first_ns`` and ``last_ns`` are of the first and last frame that left, CLOCK_REALTIME.
    """

    a: str
    b: str
    protocol: str
    there: Flow = field(default_factory=Flow)
    """From ``a`` to ``b``."""
    back: Flow = field(default_factory=Flow)
    first_ns: int = 0
    last_ns: int = 0

    @property
    def size_bytes(self) -> int:
        """Of both directions."""
        return self.there.size_bytes + self.back.size_bytes


class Conversations:
    """Collects them from packets in the order of time."""

    def __init__(self, trace: Trace) -> None:
        self._macs = {mac: interface[0] for mac, interface in trace.macs.items()}
        self._nodes = dict(trace.addresses)  # whose an IPv4 address is; else whoever sends with it
        self._found: dict[tuple[str, str, str], Flow] = {}  # by sender, destination (an address still), protocol
        self._senders = set(trace.addresses.values())
        self._times: dict[tuple[str, str, str], list[int]] = {}
        self._arrived: dict[tuple[str, str, str], int] = {}  # by sender's address, receiver, protocol

    def packet(self, record: PacketRecord) -> None:
        """Count one packet at one interface."""
        source, destination, protocol = _ends(record.frame)
        if record.direction is Direction.OUTBOUND:
            if record.frame[6:12]:
                self._macs.setdefault(bytes(record.frame[6:12]), record.node)
            self._nodes.setdefault(source, record.node)
            self._senders.add(record.node)
            key = (record.node, destination, protocol)
            flow = self._found.setdefault(key, Flow())
            flow.frames, flow.size_bytes = flow.frames + 1, flow.size_bytes + record.original_length
            times = self._times.setdefault(key, [record.t_ns, record.t_ns])
            times[1] = record.t_ns
        elif record.direction is Direction.INBOUND and not record.frame[0] & _GROUP:
            came = (source, record.node, protocol)
            self._arrived[came] = self._arrived.get(came, 0) + 1

    def result(self) -> list[Conversation]:
        """All conversations, the one with the most bytes first."""
        found: dict[tuple[str, str, str], Conversation] = {}
        for (sender, address, protocol), flow in self._found.items():
            receiver = self._name(address)
            is_node = receiver in self._senders
            a, b = (receiver, sender) if is_node and receiver < sender else (sender, receiver)
            talk = found.setdefault((a, b, protocol), Conversation(a, b, protocol))
            side = talk.there if a == sender else talk.back
            side.frames, side.size_bytes = side.frames + flow.frames, side.size_bytes + flow.size_bytes
            first_ns, last_ns = self._times[sender, address, protocol]
            talk.first_ns, talk.last_ns = min(talk.first_ns or first_ns, first_ns), max(talk.last_ns, last_ns)
        self._count_arrivals(found)
        return sorted(found.values(), key=lambda talk: -talk.size_bytes)

    def _count_arrivals(self, found: dict[tuple[str, str, str], Conversation]) -> None:
        for talk in found.values():
            if talk.b == EVERYBODY:
                talk.there.arrived = talk.back.arrived = None
        for (address, receiver, protocol), count in self._arrived.items():
            sender = self._name(address)
            talk_of_both = found.get((min(sender, receiver), max(sender, receiver), protocol))
            if talk_of_both is not None:
                side = talk_of_both.there if talk_of_both.a == sender else talk_of_both.back
                side.arrived = (side.arrived or 0) + count

    def _name(self, address: str) -> str:
        if address in self._nodes:
            return self._nodes[address]
        if len(address) == 17 and address.count(":") == 5:
            mac = bytes.fromhex(address.replace(":", ""))
            return EVERYBODY if mac[0] & _GROUP else self._macs.get(mac, address)
        return address


def _ends(frame: bytes) -> tuple[str, str, str]:
    """Source, destination and protocol of a frame: IPv4 addresses where it has them, else those of the link."""
    mesh = peel(frame)[0]
    kind, start = ethertype(frame)
    source, destination = frame[6:12].hex(":"), frame[:6].hex(":")
    if mesh:
        return source, destination, mesh
    if kind != _IPV4 or len(frame) < start + 20:
        return source, destination, _ETHERTYPES.get(kind, f"EtherType {kind:#06x}")
    ends = ".".join(map(str, frame[start + 12 : start + 16])), ".".join(map(str, frame[start + 16 : start + 20]))
    to = destination if frame[0] & _GROUP else ends[1]
    protocol = _PROTOCOLS.get(frame[start + 9], f"IP protocol {frame[start + 9]}")
    datagram = udp_of(frame)
    if datagram is not None:
        is_ours = bytes(datagram.payload[:2]) == MAGIC
        protocol = "udp_mesh" if is_ours else f"UDP {min(datagram.source_port, datagram.destination_port)}"
    elif protocol == "TCP" and len(frame) >= start + 24:
        ports = start + (frame[start] & 0x0F) * 4
        low = min(int.from_bytes(frame[ports : ports + 2], "big"), int.from_bytes(frame[ports + 2 : ports + 4], "big"))
        protocol = f"TCP {low}"
    return ends[0], to, protocol
