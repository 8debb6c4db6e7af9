"""From one node's packet ring into the capture: a channel per interface, a message per packet."""

from __future__ import annotations

import zlib

from netlab.capture.ring import PacketRing, RingSize
from netlab.capture.schemas import Direction, encode_packet, encode_packet_names
from netlab.capture.topics import Topics


class Sniffer:
    """Records every packet at every interface of a node but loopback, both directions.

    Interfaces that appear later get their channel with their first packet.

    Raises:
        OSError: As :class:`PacketRing`.
    """

    def __init__(self, node: str, netns_fd: int, interfaces: tuple[str, ...], topics: Topics, size: RingSize) -> None:
        self.node = node
        self.packets = 0
        self.drops = 0
        self._ring = PacketRing(netns_fd, size)
        self._topics = topics
        self._by_ifindex: dict[int, tuple[int, int, bytes]] = {}
        for interface in interfaces:  # a silent interface shows in the file as well
            topics.packets(node, interface, 1)

    def fileno(self) -> int:
        """Readable when packets are ready."""
        return self._ring.fileno()

    @property
    def retire_s(self) -> float:
        """How long packets can stay in the kernel before they show here."""
        return self._ring.retire_s

    def drain(self, *, max_blocks: int = 32) -> int:
        """Record the packets that are ready, at most so many blocks; return how many packets."""
        count = 0
        for _ in range(max_blocks):
            block = self._ring.read_block()
            if block is None:
                break
            count += len(block)
            add, known = self._topics.writer.add_message, self._by_ifindex
            for t_ns, ifindex, hardware_type, outgoing, length, frame in block:
                channel, linktype, names = known.get(ifindex) or self._learn(ifindex, hardware_type)
                direction = Direction.OUTBOUND if outgoing else Direction.INBOUND
                head = encode_packet(zlib.crc32(frame), length, linktype, direction, names, len(frame))
                add(channel, t_ns, t_ns, head, frame)
        self.packets += count
        return count

    def count_drops(self) -> int:
        """Ask the kernel what it dropped since the last time; ``drops`` is the sum."""
        new = self._ring.take_drops()
        self.drops += new
        return new

    def close(self) -> None:
        """Stop sniffing."""
        self.count_drops()
        self._ring.close()

    def _learn(self, ifindex: int, hardware_type: int) -> tuple[int, int, bytes]:
        interface = self._ring.interface_name(ifindex)
        channel, linktype = self._topics.packets(self.node, interface, hardware_type)
        entry = self._by_ifindex[ifindex] = (channel, linktype, encode_packet_names(self.node, interface))
        return entry
