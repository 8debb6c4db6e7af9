"""A UDP socket on one interface: bursts out in one system call where the device allows it, batches in.

The kernel's queue is kept short on purpose: what waits there, our priorities no longer rule.
"""

from __future__ import annotations

import errno
import socket
import time
from collections import Counter
from collections.abc import Iterator

from udp_mesh.core.mesh import Datagram, Path
from udp_mesh.io.interfaces import Interface

_UDP_SEGMENT = 103
_UDP_GRO = 104
_SO_RCVBUFFORCE = 33
_MSG_CONFIRM = 0x800
_CONFIRM_WITHIN_S = 1.0
_SEND_BUFFER_BYTES = 128 * 1024
_RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024
_MAX_SEGMENTS = 44
_MAX_BURST_BYTES = 63_000
_MAX_DATAGRAM_BYTES = 65_536
_BATCH = 32
_MAX_HEARD = 1024
_ANCILLARY_BYTES = socket.CMSG_SPACE(4)


class UdpCarrier:
    """One interface's socket."""

    def __init__(self, interface: Interface, port: int, counters: Counter[str]) -> None:
        """Open and bind.

        Raises:
            OSError: The port is in use, or the interface is gone.
        """
        self.interface = interface
        self.backlog: list[Datagram] = []  # refused by the full socket; leaves before anything else
        self._port = port
        self._counters = counters
        self._heard_s: dict[str, float] = {}
        self._has_segmentation = True
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            self._configure()
            self.socket.bind(("", port))
        except OSError:
            self.socket.close()
            raise

    def _configure(self) -> None:
        sock = self.socket
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, self.interface.name.encode() + b"\0")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        try:
            sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
        except PermissionError:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        try:
            sock.setsockopt(socket.IPPROTO_UDP, _UDP_GRO, 1)
        except OSError:
            self._counters["without_receive_offload"] += 1

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self.socket.fileno()

    def receive(self) -> Iterator[tuple[memoryview, Path, float]]:
        """Yield what has arrived, at most a bounded batch, each with its arrival in monotonic seconds."""
        for _ in range(_BATCH):
            try:
                data, ancillary, _flags, (address, port) = self.socket.recvmsg(_MAX_DATAGRAM_BYTES, _ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError as error:
                self._counters[f"receive_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
                return
            now = time.monotonic()
            if port != self._port:
                self._counters["bad_source_port"] += 1
                continue
            self._note_heard(address, now)
            path = Path(self.interface.index, address)
            view = memoryview(data)
            size = _segment_bytes(ancillary) or len(view)
            for start in range(0, len(view), max(size, 1)):
                yield view[start : start + size], path, now

    def _note_heard(self, address: str, now: float) -> None:
        if len(self._heard_s) >= _MAX_HEARD:
            self._heard_s.clear()
        self._heard_s[address] = now

    def send(self, datagrams: list[Datagram]) -> None:
        """Send datagrams of this carrier in order; what the socket does not take now waits in :attr:`backlog`."""
        waiting = self.backlog + datagrams if self.backlog else datagrams
        self.backlog = []
        at = 0
        while at < len(waiting):
            end = self._burst_end(waiting, at)
            try:
                self._send_burst(waiting[at:end])
            except BlockingIOError:
                self.backlog = waiting[at:]
                self._counters["send_blocked"] += 1
                return
            except OSError as error:
                if end - at > 1 and error.errno in (errno.EIO, errno.EINVAL, errno.EMSGSIZE, errno.EOPNOTSUPP):
                    self._has_segmentation = False
                    self._counters["without_send_offload"] += 1
                    continue
                self._counters[f"send_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
            at = end

    def _burst_end(self, datagrams: list[Datagram], at: int) -> int:
        path, data = datagrams[at]
        end, size, total = at + 1, len(data), len(data)
        while self._has_segmentation and path.address and end < len(datagrams) and end - at < _MAX_SEGMENTS:
            following = datagrams[end]
            total += len(following.data)
            if following.path != path or len(following.data) > size or total > _MAX_BURST_BYTES:
                break
            end += 1
            if len(following.data) < size:
                break  # only the last segment may be shorter
        return end

    def _send_burst(self, burst: list[Datagram]) -> None:
        first = burst[0]
        address = first.path.address or self.interface.broadcast
        is_alive = time.monotonic() - self._heard_s.get(first.path.address, -1e9) < _CONFIRM_WITHIN_S
        flags = _MSG_CONFIRM if is_alive else 0  # the neighbour answers: the kernel need not ask again
        ancillary = []
        if len(burst) > 1:
            ancillary.append((socket.IPPROTO_UDP, _UDP_SEGMENT, len(first.data).to_bytes(2, "little")))
        self.socket.sendmsg([datagram.data for datagram in burst], ancillary, flags, (address, self._port))

    def close(self) -> None:
        """Close the socket."""
        self.socket.close()


def _segment_bytes(ancillary: list[tuple[int, int, bytes]]) -> int:
    for level, kind, data in ancillary:
        if level == socket.IPPROTO_UDP and kind == _UDP_GRO:
            return int.from_bytes(data[:4], "little")
    return 0
