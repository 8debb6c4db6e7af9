"""The interfaces over which nodes hear each other: Ethernet-like ones, and radios in monitor mode.

Both take and give Ethernet frames of wnet's EtherType. A monitor-mode interface also tells how strongly each was heard
and sends each at the rate that it is given; its frames go as 802.11 data behind a radiotap header.
"""

from __future__ import annotations

import errno
import math
import struct
from typing import Protocol

from wnet.core.events import Count, Drop
from wnet.core.members import Member, Reception
from wnet.core.wire import ETHERTYPE
from wnet.io import dot11, radiotap
from wnet.io.packet_socket import PacketSocket

#: Hardware type of an interface whose frames begin with a radiotap header (linux/if_arp.h).
ARPHRD_RADIOTAP = 803
_ETHERTYPE_ALL = 0x0003
_HEADERS_LIMIT = 1024
_MAC_BYTES = 6
#: Of the rates of 802.11g, in bits per second.
OFDM_RATES_BPS = tuple(mbit * 1_000_000 for mbit in (6, 9, 12, 18, 24, 36, 48, 54))

Arrival = tuple[bytes, Reception | None]


class Port(Protocol):
    """One member, open."""

    ifname: str
    member: Member

    def fileno(self) -> int:
        """Readable when frames wait."""

    def receive(self) -> Arrival | None:
        """The next frame and how it was heard; None when there is none now."""

    def room(self, *, now: float) -> int:
        """How many frames it takes now; where 0, one that arrives or :meth:`frees_at` makes room."""

    def frees_at(self) -> float | None:
        """When there is room again if nothing arrives; None: there is."""

    def transmit(self, frame: bytes, rate_bps: int | None, *, now: float) -> Count | Drop | None:
        """Send a frame; what to count where that is impossible."""

    def close(self) -> None:
        """Stop."""


#: Frames for an interface that says nothing of its queue before others get their turn.
_BURST_FRAMES = 16
#: Frames given to a radio that it has not reported as sent: the one on the air, and the next.
_WINDOW_FRAMES = 2
#: A radio that does not report a frame for so long does not report any.
_REPORT_LIMIT_S = 0.25


class EthernetPort:
    """See :class:`Port`: a wire, or a radio whose driver hides what it does."""

    def __init__(self, ifname: str, *, is_radio: bool) -> None:
        """Raises OSError as :class:`PacketSocket`."""
        self.ifname = ifname
        self._socket = PacketSocket(ifname, int.from_bytes(ETHERTYPE, "big"))
        self._receive, self._send = self._socket.receive, self._socket.send
        self.member = Member(self._socket.mac, is_radio, mtu_bytes=self._socket.mtu_bytes)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> Arrival | None:
        frame = self._receive()
        return None if frame is None else (frame, None)

    def room(self, *, now: float) -> int:
        return _BURST_FRAMES

    def frees_at(self) -> float | None:
        return None

    def transmit(self, frame: bytes, rate_bps: int | None, *, now: float) -> Count | Drop | None:
        try:
            self._send(frame)
        except OSError as error:
            return _problem(error)
        return None

    def close(self) -> None:
        self._socket.close()


class MonitorPort:
    """See :class:`Port`: a radio in monitor mode.

    Most drivers show a frame once more when they are through with it (mac80211 does wherever the hardware reports).
    Until then few are given to it, so that what waits does so in the mesh, where urgent frames overtake.
    """

    def __init__(self, ifname: str, rates_bps: tuple[int, ...], mac: bytes) -> None:
        """``rates_bps``: what the radio can send at, rising; ``mac``: the address of its frames, empty for its own.

        Raises:
            OSError: As :class:`PacketSocket`; or the interface has no address and none is given.
        """
        self.ifname = ifname
        self._socket = PacketSocket(ifname, _ETHERTYPE_ALL)
        self._mac = mac or self._socket.mac
        if len(self._mac) != _MAC_BYTES:
            self._socket.close()
            raise OSError(errno.EADDRNOTAVAIL, "it has no address of its own; give its member a mac")
        self._socket.attach_filter(_for_or_from(self._mac))
        room_bytes = self._socket.mtu_bytes - radiotap.TRANSMIT_BYTES_MAX - dot11.EXTRA_BYTES
        self.member = Member(self._mac, True, mtu_bytes=room_bytes, rates_bps=rates_bps)
        self._unreported = 0
        self._reports = True
        self._sent_s = -math.inf
        self._transmit_headers: dict[int | None, bytes] = {}
        self._known: dict[bytes, radiotap.Received | None] = {}  # receivers' headers hardly differ

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> Arrival | None:
        while (data := self._socket.receive()) is not None:
            header = self._decode(data)
            if header is None or header.is_bad:
                continue
            if header.is_echo:
                self._unreported = max(0, self._unreported - 1)
                self._reports = True
                continue
            frame = dot11.decode(data[: -radiotap.FCS_BYTES] if header.has_fcs else data, header.length_bytes)
            if frame is None or frame[12:14] != ETHERTYPE or frame[6:12] == self._mac:
                continue
            if header.signal_dbm is None:
                return frame, None
            return frame, Reception(header.signal_dbm, header.noise_dbm, header.rate_bps)
        return None

    def room(self, *, now: float) -> int:
        if self._unreported and now >= self._sent_s + _REPORT_LIMIT_S:
            self._unreported = 0
            self._reports = False
        return _WINDOW_FRAMES - self._unreported if self._reports else _BURST_FRAMES

    def frees_at(self) -> float | None:
        return self._sent_s + _REPORT_LIMIT_S if self._reports and self._unreported >= _WINDOW_FRAMES else None

    def transmit(self, frame: bytes, rate_bps: int | None, *, now: float) -> Count | Drop | None:
        head = self._transmit_headers.get(rate_bps)
        if head is None:
            head = self._transmit_headers[rate_bps] = radiotap.encode_transmit(rate_bps)
        try:
            self._socket.send(head + dot11.encode(frame))
        except OSError as error:
            return _problem(error)
        self._unreported += 1
        self._sent_s = now
        return None

    def close(self) -> None:
        self._socket.close()

    def _decode(self, data: bytes) -> radiotap.Received | None:
        head = data[: int.from_bytes(data[2:4], "little")]
        if head in self._known:
            return self._known[head]
        if len(self._known) >= _HEADERS_LIMIT:  # a driver that stamps every frame
            self._known.clear()
        header = self._known[head] = radiotap.decode(head)
        return header


def _for_or_from(mac: bytes) -> bytes:
    """A program that accepts radiotap frames to groups, to ``mac`` and from it, by the last four bytes of that.

    In monitor mode a busy channel would wake up every node for every frame of the others.
    """
    (last,) = struct.unpack("!I", mac[2:])
    steps = (
        (0x30, 0, 0, 3),  # A = upper byte of the radiotap header's length
        (0x64, 0, 0, 8),  # A <<= 8
        (0x07, 0, 0, 0),  # X = A
        (0x30, 0, 0, 2),  # A = lower byte
        (0x0C, 0, 0, 0),  # A += X
        (0x07, 0, 0, 0),  # X = A
        (0x50, 0, 0, 4),  # A = first byte of the receiver's address
        (0x45, 4, 0, 1),  # a group: accept
        (0x40, 0, 0, 6),  # A = the address's last four bytes
        (0x15, 2, 0, last),  # equal: accept
        (0x40, 0, 0, 12),  # A = those of the sender's
        (0x15, 0, 1, last),  # equal: accept, else not
        (0x06, 0, 0, 0x40000),
        (0x06, 0, 0, 0),
    )
    return b"".join(struct.pack("=HBBI", *step) for step in steps)


def _problem(error: OSError) -> Count | Drop:
    return Drop.OVERSIZED if error.errno == errno.EMSGSIZE else Count.NOT_SENT


def open_port(ifname: str, *, is_radio: bool = False, rates_bps: tuple[int, ...] = (), mac: bytes = b"") -> Port:
    """Open a member by what its interface is: one in monitor mode, which alone needs the rest, tells by its type.

    Raises:
        OSError: No such interface, not permitted, or neither Ethernet nor radiotap; names the interface.
    """
    try:
        with_type = PacketSocket(ifname, 0)
        kind = with_type.hardware_type
        with_type.close()
        if kind == ARPHRD_RADIOTAP:
            return MonitorPort(ifname, rates_bps or OFDM_RATES_BPS, mac)
        return EthernetPort(ifname, is_radio=is_radio)
    except OSError as error:
        raise OSError(error.errno, f"{ifname}: {error.strerror}") from error
