"""rose over UDP: one socket for commands, one per group that is listened to, no connection and no state.

A service must come up with the network down and be there when it returns. So the sockets bind to an address that may be
missing as yet (IP_FREEBIND), and the membership of each group is asked for again every second: the kernel answers
EADDRINUSE while it holds, and joins anew when an interface has been replaced. A second command socket on loopback lets
the host's Service Manager reach the service whatever becomes of the network.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import socket
import struct
from collections.abc import Sequence
from ipaddress import IPv4Address, IPv6Address

from rose.core.addressing import ANNOUNCE_PORT, Host, ServiceId, announce_group
from rose.core.wire import DATAGRAM_BYTES_MAX
from rose.errors import RoseError
from rose.io.interfaces import interface_of
from rose.io.transport import OnDatagram, Transport

TEND_S = 1.0
_BURST = 64
_RECEIVE_BUFFER_BYTES = 1 << 20
_DATAGRAM_MOST = 65_535
_LOOPBACK: dict[int, Host] = {4: IPv4Address("127.0.0.1"), 6: IPv6Address("::1")}
# linux/in.h and linux/in6.h; Python 3.11 does not name them.
_IP_FREEBIND, _IP_MULTICAST_ALL = 15, 49
_IPV6_FREEBIND, _IPV6_MULTICAST_ALL = 78, 29


class UdpTransport(Transport):
    """See the module's text."""

    datagram_bytes = DATAGRAM_BYTES_MAX

    def __init__(self, *, hops: int = 1, dscp: int = 0) -> None:
        """Choose how datagrams are marked.

        Args:
            hops: 1..255: how many networks multicast may reach; 1 is the subnet (a mesh is one), 0 this host alone.
            dscp: 0..63, for networks that put urgent traffic first.
        """
        self._hops, self._dscp = hops, dscp
        self._groups: dict[tuple[Host, int], socket.socket] = {}
        self._commands: list[socket.socket] = []
        self._tending: asyncio.Task[None] | None = None
        self._index: int | None = None  # of the interface that has the service's address

    async def open(self, sid: ServiceId, on_datagram: OnDatagram) -> None:
        """See :meth:`Transport.open`."""
        self._sid, self._on_datagram = sid, on_datagram
        loopback = _LOOPBACK[sid.host.version]
        addresses = [sid.host] if sid.host.is_loopback else [sid.host, loopback]
        try:
            for address in addresses:
                self._commands.append(self._command_socket(address))
        except OSError as error:
            await self.close()
            if error.errno == errno.EADDRINUSE:
                raise RoseError(f"{sid}: port {sid.port} is taken; another process is this service already") from None
            raise RoseError(f"{sid}: cannot bind port {sid.port}: {error.strerror}") from None
        self._find_interface()
        self._tending = asyncio.create_task(self._tend())

    async def close(self) -> None:
        """See :meth:`Transport.close`."""
        if self._tending is not None:
            self._tending.cancel()
            await asyncio.gather(self._tending, return_exceptions=True)
            self._tending = None
        for sock in (*self._commands, *self._groups.values()):
            asyncio.get_running_loop().remove_reader(sock)
            sock.close()
        self._commands.clear()
        self._groups.clear()

    def publish(self, datagrams: Sequence[bytes]) -> None:
        """See :meth:`Transport.publish`."""
        self._send_all((str(self._sid.group), self._sid.port), datagrams)

    def send(self, to: ServiceId, datagrams: Sequence[bytes], *, local: bool = False) -> None:
        """See :meth:`Transport.send`."""
        if local and not to.host.is_loopback:
            self._send_all((str(_LOOPBACK[to.host.version]), to.port), datagrams, self._commands[-1])
        else:
            self._send_all((str(to.host), to.port), datagrams)

    def announce(self, datagrams: Sequence[bytes]) -> None:
        """Send to where hosts announce themselves."""
        self._send_all((str(announce_group(self._sid.host)), ANNOUNCE_PORT), datagrams)

    def join(self, sender: ServiceId) -> None:
        """See :meth:`Transport.join`."""
        self._join(sender.group, sender.port)

    def leave(self, sender: ServiceId) -> None:
        """See :meth:`Transport.leave`."""
        sock = self._groups.pop((sender.group, sender.port), None)
        if sock is not None:
            asyncio.get_running_loop().remove_reader(sock)
            sock.close()

    def join_announcements(self) -> None:
        """Receive what hosts announce."""
        self._join(announce_group(self._sid.host), ANNOUNCE_PORT)

    # -- inside ---------------------------------------------------------------------------------------------------

    def _command_socket(self, address: Host) -> socket.socket:
        sock = self._socket()
        try:
            self._mark(sock, address)
            sock.bind((str(address), self._sid.port))
        except BaseException:
            sock.close()
            raise
        self._listen(sock)
        return sock

    def _socket(self) -> socket.socket:
        family = socket.AF_INET if self._sid.host.version == 4 else socket.AF_INET6
        sock = socket.socket(family, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        return sock

    def _mark(self, sock: socket.socket, address: Host) -> None:
        traffic_class = self._dscp << 2
        if address.version == 4:
            sock.setsockopt(socket.IPPROTO_IP, _IP_FREEBIND, 1)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_TOS, traffic_class)
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, self._hops)
        else:
            sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_FREEBIND, 1)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_TCLASS, traffic_class)
            sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, self._hops)

    def _listen(self, sock: socket.socket) -> None:
        asyncio.get_running_loop().add_reader(sock, self._receive, sock)

    def _receive(self, sock: socket.socket) -> None:
        is_local = sock is self._commands[-1] and len(self._commands) > 1
        for _ in range(_BURST):
            try:
                datagram = sock.recv(_DATAGRAM_MOST)
            except BlockingIOError:
                return
            except OSError:  # what a neighbour's ICMP said about an earlier datagram
                continue
            self._on_datagram(datagram, is_local)
            if sock.fileno() < 0:  # whoever got it has left the group
                return

    def _send_all(self, to: tuple[str, int], datagrams: Sequence[bytes], sock: socket.socket | None = None) -> None:
        own = self._commands[0] if sock is None else sock
        for datagram in datagrams:
            try:
                own.sendto(datagram, to)
            except OSError:
                self.unsent += 1

    def _find_interface(self) -> None:
        """Have multicast leave by the interface that has the service's address now."""
        index = interface_of(self._sid.host)
        if index in (None, self._index):
            return
        self._index = index
        own = self._commands[0]
        if self._sid.host.version == 4:
            request = struct.pack("4s4si", bytes(4), self._sid.host.packed, index)
            own.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, request)
        else:
            own.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_IF, index)

    def _join(self, group: Host, port: int) -> None:
        if (group, port) in self._groups:
            return
        sock = self._socket()
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # several services of a host may listen to one
        if group.version == 4:
            sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
        else:
            sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        sock.bind((str(group), port))
        self._groups[group, port] = sock
        self._listen(sock)
        self._hold(group, sock)

    def _hold(self, group: Host, sock: socket.socket) -> None:
        """Become a member, or be one already; where that is impossible now, the next second may do."""
        index = self._index
        if index is None:
            return
        with contextlib.suppress(OSError):
            if group.version == 4:
                request = struct.pack("4s4si", group.packed, bytes(4), index)
                sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, request)
            else:
                request = struct.pack("16sI", group.packed, index)
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, request)

    async def _tend(self) -> None:
        while True:
            await asyncio.sleep(TEND_S)
            self._find_interface()
            for (group, _port), sock in list(self._groups.items()):
                self._hold(group, sock)
