"""A UDP socket on one interface: bursts out in one system call where the device allows it, batches in.

The kernel's queue is kept short on purpose: what waits there, our priorities no longer rule.
"""

from __future__ import annotations

import errno
import socket
import sys
import time
from collections import Counter
from collections.abc import Iterator

from udp_mesh.config_carriers import CarrierKind
from udp_mesh.core.mesh import Datagram, Path
from udp_mesh.io.carrier import CarrierFacts, SocketCarrier
from udp_mesh.io.dscp import tos_of

_UDP_SEGMENT = 103
_UDP_GRO = 104
_SO_SNDBUFFORCE = 32
_SO_RCVBUFFORCE = 33
_MSG_CONFIRM = 0x800
_CONFIRM_WITHIN_S = 1.0
_SEND_BUFFER_BYTES = 128 * 1024
_MAX_SEND_BUFFER_BYTES = 8 * 1024 * 1024
_RECEIVE_BUFFER_BYTES = 4 * 1024 * 1024
_MAX_SEGMENTS = 44
_MAX_BURST_BYTES = 63_000
_MAX_DATAGRAM_BYTES = 65_536
_BATCH_BYTES = 256 * 1024
_LEAST_BYTES = 4096  # what a small datagram counts for, so that a batch of them is bounded in time
_MAX_HEARD = 1024
_ANCILLARY_BYTES = socket.CMSG_SPACE(4)


class UdpCarrier(SocketCarrier):
    """One interface's socket, IPv4 or IPv6."""

    def __init__(self, facts: CarrierFacts, port: int, counters: Counter[str], *, marks: bool = False) -> None:
        """Open and bind; ``marks``: whether the IP header tells the priority (:mod:`udp_mesh.io.dscp`).

        Raises:
            OSError: The port is in use, or the interface is gone.
        """
        super().__init__(facts)
        self._port = port
        self._counters = counters
        self.marks = marks
        self._heard_at_s: dict[str, float] = {}
        self._has_segmentation = True
        self._send_buffer_bytes = _SEND_BUFFER_BYTES
        self._buffer = memoryview(bytearray(_MAX_DATAGRAM_BYTES))
        self._is_ipv6 = facts.kind is CarrierKind.UDP6
        family = socket.AF_INET6 if self._is_ipv6 else socket.AF_INET
        self.socket = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK | socket.SOCK_CLOEXEC)
        try:
            self._configure()
            self.socket.bind(("", port))
        except OSError:
            self.socket.close()
            raise

    def _configure(self) -> None:
        sock = self.socket
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, self.facts.name.encode() + b"\0")
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        if self._is_ipv6:
            number = self.facts.interface_index
            group = socket.inet_pton(socket.AF_INET6, self.facts.broadcast) + number.to_bytes(4, sys.byteorder)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, number)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_LOOP, 0)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        _set_buffer(sock, socket.SO_RCVBUF, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
        try:
            sock.setsockopt(socket.IPPROTO_UDP, _UDP_GRO, 1)
        except OSError:
            self._counters["without_receive_offload"] += 1

    def receive(self) -> Iterator[tuple[memoryview, int, Path, float]]:
        """Yield what has arrived, at most a bounded batch: datagrams, the length of each, path, monotonic seconds.

        The bytes are valid only until the next one is asked for.
        """
        budget = _BATCH_BYTES
        while budget > 0:
            try:
                size, ancillary, _flags, (address, port, *_scope) = self.socket.recvmsg_into(
                    [self._buffer], _ANCILLARY_BYTES
                )
            except BlockingIOError:
                return
            except OSError as error:
                self._counters[f"receive_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
                return
            budget -= max(size, _LEAST_BYTES)
            now = time.monotonic()
            if port != self._port:
                self._counters["bad_source_port"] += 1
                continue
            path = self._heard(address.partition("%")[0], now)
            yield self._buffer[:size], _segment_bytes(ancillary) or size, path, now

    def _heard(self, address: str, now: float) -> Path:
        heard = self._heard_at_s
        if len(heard) >= _MAX_HEARD and address not in heard:
            heard.clear()
        heard[address] = now
        return Path(self.facts.index, address)

    def send(self, datagrams: list[Datagram], *, window_bytes: int) -> None:
        """Send datagrams of this carrier in order; what the socket does not take now waits in :attr:`backlog`.

        ``window_bytes`` may be in flight by right: where the kernel counts what is under way (netem), that has to fit.
        """
        waiting = self.backlog + datagrams if self.backlog else datagrams
        self.backlog = []
        at = 0
        while at < len(waiting):
            end = self._burst_end(waiting, at)
            try:
                self._send_burst(waiting[at:end])
            except BlockingIOError:
                if self._grow(window_bytes):
                    continue
                self.backlog = waiting[at:]
                self._counters["send_blocked"] += 1
                return
            except OSError as error:
                is_burst = end - at > 1 or waiting[at].segment_bytes
                if is_burst and error.errno in (errno.EIO, errno.EINVAL, errno.EMSGSIZE, errno.EOPNOTSUPP):
                    self._has_segmentation = False
                    self._counters["without_send_offload"] += 1
                    waiting = [single for burst in waiting[at:] for single in _singles(burst)]
                    at = 0
                    continue
                self._counters[f"send_{errno.errorcode.get(error.errno or 0, 'error')}"] += 1
            at = end

    def _grow(self, window_bytes: int) -> bool:
        """Make room in the socket for twice the window, if there is less; whether that helped."""
        wanted = min(2 * window_bytes, _MAX_SEND_BUFFER_BYTES)
        if wanted <= self._send_buffer_bytes:
            return False
        self._send_buffer_bytes = wanted
        before = self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
        _set_buffer(self.socket, socket.SO_SNDBUF, _SO_SNDBUFFORCE, wanted)
        return self.socket.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) > before

    def _burst_end(self, datagrams: list[Datagram], at: int) -> int:
        """Return the end of what may leave in one call: segments of one length, of which only the last is shorter."""
        first = datagrams[at]
        path, size = first.path, _length(first)
        total, end = len(first.data), at + 1
        while self._has_segmentation and path.address and end < len(datagrams) and not total % size:
            following = datagrams[end]
            total += len(following.data)
            fits = _length(following) == size or (not following.segment_bytes and len(following.data) < size)
            if (
                following.path != path
                or not fits
                or not self._marked_alike(first, following)
                or total > _MAX_BURST_BYTES
                or total > _MAX_SEGMENTS * size
            ):
                break
            end += 1
        return end

    def _marked_alike(self, first: Datagram, second: Datagram) -> bool:
        return not self.marks or tos_of(first.priority) == tos_of(second.priority)

    def _send_burst(self, burst: list[Datagram]) -> None:
        first = burst[0]
        if first.segment_bytes and not self._has_segmentation:
            raise OSError(errno.EOPNOTSUPP, "no segmentation")
        address = first.path.address or self.facts.broadcast
        is_alive = time.monotonic() - self._heard_at_s.get(first.path.address, -1e9) < _CONFIRM_WITHIN_S
        flags = _MSG_CONFIRM if is_alive else 0  # the neighbour answers: the kernel need not ask again
        ancillary = []
        if len(burst) > 1 or first.segment_bytes:
            ancillary.append((socket.IPPROTO_UDP, _UDP_SEGMENT, _length(first).to_bytes(2, sys.byteorder)))
        if self.marks:
            level = (socket.IPPROTO_IPV6, socket.IPV6_TCLASS) if self._is_ipv6 else (socket.IPPROTO_IP, socket.IP_TOS)
            ancillary.append((*level, tos_of(first.priority).to_bytes(4, sys.byteorder)))
        target = (address, self._port, 0, self.facts.interface_index) if self._is_ipv6 else (address, self._port)
        self.socket.sendmsg([datagram.data for datagram in burst], ancillary, flags, target)


def _set_buffer(sock: socket.socket, option: int, forced_option: int, size_bytes: int) -> None:
    """Set a buffer's size, beyond the system's limit if this process has the right."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, forced_option, size_bytes)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, option, size_bytes)


def _length(datagram: Datagram) -> int:
    """Return the length of the datagrams in a burst."""
    return datagram.segment_bytes or max(1, len(datagram.data))


def _singles(burst: Datagram) -> list[Datagram]:
    return [Datagram(burst.path, data, 0, burst.priority) for data in burst.segments()]


def _segment_bytes(ancillary: list[tuple[int, int, bytes]]) -> int:
    for level, kind, data in ancillary:
        if level == socket.IPPROTO_UDP and kind == _UDP_GRO:
            return int.from_bytes(data[:4], sys.byteorder)
    return 0
