"""Datagrams in Ethernet frames of their own type, for networks without IP (docs/wire.md). Needs CAP_NET_RAW."""

from __future__ import annotations

import errno
import socket
import time
from collections import Counter
from collections.abc import Iterator

from udp_mesh.core.mesh import Datagram, Path
from udp_mesh.io.carrier import CarrierFacts, SocketCarrier

ETHERTYPE = 0x88B5  # IEEE 802, local experimental ethertype 1
_BROADCAST = bytes.fromhex("ffffffffffff")
LENGTH_BYTES = 2  # before the datagram: short frames are padded on their way
_PACKET_OUTGOING = 4
_MAX_FRAME_BYTES = 65_536
_BATCH = 64


class EthernetCarrier(SocketCarrier):
    """One interface's socket."""

    def __init__(self, facts: CarrierFacts, counters: Counter[str]) -> None:
        """Open and bind.

        Raises:
            OSError: The interface is gone, or this process may not open packet sockets.
        """
        super().__init__(facts)
        self._counters = counters
        self._buffer = memoryview(bytearray(_MAX_FRAME_BYTES))
        kind = socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC
        self.socket = socket.socket(socket.AF_PACKET, kind, 0)
        try:
            self.socket.bind((facts.name, ETHERTYPE))
        except OSError:
            self.socket.close()
            raise

    def receive(self) -> Iterator[tuple[memoryview, int, Path, float]]:
        """Yield what has arrived, at most a bounded batch."""
        for _ in range(_BATCH):
            try:
                size, address = self.socket.recvfrom_into(self._buffer)
            except BlockingIOError:
                return
            except OSError as error:
                self._counters[f"receive_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
                return
            if address[2] == _PACKET_OUTGOING:
                continue
            length = int.from_bytes(self._buffer[:LENGTH_BYTES], "big")
            if not 0 < length <= size - LENGTH_BYTES:
                self._counters["ethernet_bad_length"] += 1
                continue
            path = Path(self.facts.index, bytes(address[4]).hex(":"))
            yield self._buffer[LENGTH_BYTES : LENGTH_BYTES + length], length, path, time.monotonic()

    def send(self, datagrams: list[Datagram], *, window_bytes: int) -> None:
        """Send datagrams in order; what the socket does not take now waits."""
        waiting = [Datagram(d.path, data) for d in datagrams for data in d.segments()]
        waiting = self.backlog + waiting
        self.backlog = []
        for at, datagram in enumerate(waiting):
            target = bytes.fromhex(datagram.path.address.replace(":", "")) or _BROADCAST
            data = len(datagram.data).to_bytes(LENGTH_BYTES, "big") + datagram.data
            try:
                self.socket.sendto(data, (self.facts.name, ETHERTYPE, 0, 0, target))
            except BlockingIOError:
                self.backlog = waiting[at:]
                self._counters["send_blocked"] += 1
                return
            except OSError as error:
                self._counters[f"send_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
