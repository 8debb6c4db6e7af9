"""The interfaces over which nodes hear each other: Ethernet-like ones, and radios in monitor mode.

Both take and give Ethernet frames of wnet's EtherType. A monitor-mode interface also tells how strongly each was heard
and sends each at the rate that it is given; its frames go as 802.11 data behind a radiotap header.
"""

from __future__ import annotations

import errno
from typing import Protocol

from wnet.core.wire import ETHERTYPE
from wnet.io import dot11, radiotap
from wnet.io.packet_socket import PacketSocket
from wnet.core.members import Member, Reception

#: Hardware type of an interface whose frames begin with a radiotap header (linux/if_arp.h).
ARPHRD_RADIOTAP = 803
_ETHERTYPE_ALL = 0x0003
_ETHERTYPE_BYTES = ETHERTYPE.to_bytes(2, "big")
_BUSY = (errno.EAGAIN, errno.ENOBUFS)
_HEADERS_LIMIT = 1024
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

    def transmit(self, frame: bytes, rate_bps: int | None) -> str | None:
        """Send a frame; ``BUSY`` where it has to wait, another word to count where it cannot be sent, None if sent."""

    def close(self) -> None:
        """Stop."""


#: The interface takes no more now; it is writable when it does.
BUSY = "busy"
_NOT_SENT, _OVERSIZED = "not_sent", "oversized"


class EthernetPort:
    """See :class:`Port`: a wire, or a radio whose driver hides what it does."""

    def __init__(self, ifname: str, *, is_radio: bool) -> None:
        """Raises OSError as :class:`PacketSocket`."""
        self.ifname = ifname
        self._socket = PacketSocket(ifname, ETHERTYPE)
        self._receive, self._send = self._socket.receive, self._socket.send
        self.member = Member(self._socket.mac, is_radio, mtu_bytes=self._socket.mtu_bytes)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> Arrival | None:
        frame = self._receive()
        return None if frame is None else (frame, None)

    def transmit(self, frame: bytes, rate_bps: int | None) -> str | None:
        try:
            self._send(frame)
        except OSError as error:
            return _problem(error)
        return None

    def close(self) -> None:
        self._socket.close()


class MonitorPort:
    """See :class:`Port`: a radio in monitor mode."""

    def __init__(self, ifname: str, rates_bps: tuple[int, ...]) -> None:
        """``rates_bps``: what the radio can send at, rising. Raises OSError as :class:`PacketSocket`."""
        self.ifname = ifname
        self._socket = PacketSocket(ifname, _ETHERTYPE_ALL)
        self._mac = self._socket.mac
        room_bytes = self._socket.mtu_bytes - radiotap.TRANSMIT_BYTES_MAX - dot11.EXTRA_BYTES
        self.member = Member(self._mac, True, mtu_bytes=room_bytes, rates_bps=rates_bps)
        self._transmit_headers: dict[int | None, bytes] = {}
        self._known: dict[bytes, radiotap.Received | None] = {}  # receivers' headers hardly differ

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> Arrival | None:
        while (data := self._socket.receive()) is not None:
            header = self._decode(data)
            if header is None or header.is_bad or header.is_echo:
                continue
            frame = dot11.decode(data[: -radiotap.FCS_BYTES] if header.has_fcs else data, header.length_bytes)
            if frame is None or frame[12:14] != _ETHERTYPE_BYTES or frame[6:12] == self._mac:
                continue
            if header.signal_dbm is None:
                return frame, None
            return frame, Reception(header.signal_dbm, header.noise_dbm, header.rate_bps)
        return None

    def transmit(self, frame: bytes, rate_bps: int | None) -> str | None:
        head = self._transmit_headers.get(rate_bps)
        if head is None:
            head = self._transmit_headers[rate_bps] = radiotap.encode_transmit(rate_bps)
        try:
            self._socket.send(head + dot11.encode(frame))
        except OSError as error:
            return _problem(error)
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


def _problem(error: OSError) -> str:
    if error.errno in _BUSY:
        return BUSY
    return _OVERSIZED if error.errno == errno.EMSGSIZE else _NOT_SENT


def open_port(ifname: str, *, is_radio: bool, rates_bps: tuple[int, ...]) -> Port:
    """Open a member by what its interface is: one in monitor mode is found by its hardware type.

    Raises:
        OSError: No such interface, not permitted, or neither Ethernet nor radiotap; names the interface.
    """
    try:
        with_type = PacketSocket(ifname, 0)
        kind = with_type.hardware_type
        with_type.close()
        if kind == ARPHRD_RADIOTAP:
            return MonitorPort(ifname, rates_bps or OFDM_RATES_BPS)
        return EthernetPort(ifname, is_radio=is_radio)
    except OSError as error:
        raise OSError(error.errno, f"{ifname}: {error.strerror}") from error
