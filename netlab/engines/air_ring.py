"""Frames from all far ends of the lab, read from one memory-mapped ring: no system call per frame.

The kernel's side is TPACKET_V2 (Documentation/networking/packet_mmap.rst, include/uapi/linux/if_packet.h). One socket
that is bound to no interface sees every interface of the namespace; each slot names the interface that a frame came in
at. The stamp in a slot is the time when the frame left the node (veth delivers in the sender's own system call), not
when this process woke up: delays are counted from it.
"""

from __future__ import annotations

import mmap
import socket
import struct

_SOL_PACKET = 263
_PACKET_RX_RING = 5
_PACKET_STATISTICS = 6
_PACKET_VERSION = 10
_PACKET_IGNORE_OUTGOING = 23
_TPACKET_V2 = 1
_ETH_P_ALL = 0x0003

# struct tpacket2_hdr: status, len, snaplen, mac, net, sec, nsec, vlan_tci, vlan_tpid, 4 of padding;
# struct sockaddr_ll follows: family, protocol, ifindex.
_SLOT = struct.Struct("=IIIHHIIHH8xi")
_STATUS_USER = 1
_STATUS_VLAN_VALID = 1 << 4
_STATUS_VLAN_TPID_VALID = 1 << 6
_ETH_P_8021Q = 0x8100

_HEADROOM = 256  # slot header and alignment, with room to spare
_BLOCK_BYTES = 1 << 16
_RING_BYTES = 8 << 20
SLOTS_MAX = 4096

#: (interface index, seconds and nanoseconds of CLOCK_REALTIME, frame)
Arrival = tuple[int, int, int, bytes]


class Ring:
    """The receiving socket and its ring. ``fileno()`` is readable while frames wait."""

    def __init__(self, mtu: int) -> None:
        """``mtu``: the largest of all ports. Starts receiving at once.

        Raises:
            OSError: No packet sockets here (the capability CAP_NET_RAW is missing), or no memory for the ring.
        """
        slot_bytes = 2048
        while slot_bytes < mtu + _HEADROOM:
            slot_bytes *= 2
        block_bytes = max(_BLOCK_BYTES, slot_bytes)
        slots = max(min(_RING_BYTES // slot_bytes, SLOTS_MAX), block_bytes // slot_bytes)
        # Receives at once; the kernel empties the queue when the ring replaces it.
        self._sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(_ETH_P_ALL))
        self._sock.setsockopt(_SOL_PACKET, _PACKET_VERSION, _TPACKET_V2)
        self._sock.setsockopt(_SOL_PACKET, _PACKET_IGNORE_OUTGOING, 1)
        request = struct.pack("=IIII", block_bytes, slots * slot_bytes // block_bytes, slot_bytes, slots)
        self._sock.setsockopt(_SOL_PACKET, _PACKET_RX_RING, request)
        self._map = mmap.mmap(self._sock.fileno(), slots * slot_bytes)
        self._status = memoryview(self._map).cast("I")
        self._slot_bytes = slot_bytes
        self._end = slots * slot_bytes
        self._at = 0
        self._losses = 0
        self.oversized = 0

    def fileno(self) -> int:
        """The socket's descriptor."""
        return self._sock.fileno()

    def take(self, limit: int) -> list[Arrival]:
        """Return up to ``limit`` frames that wait, oldest first; never blocks."""
        arrivals: list[Arrival] = []
        at, frames, unpack = self._at, self._map, _SLOT.unpack_from
        while len(arrivals) < limit:
            status, length, snap, mac, _net, sec, nsec, tci, tpid, ifindex = unpack(frames, at)
            if not status & _STATUS_USER:
                break
            frame = frames[at + mac : at + mac + snap]
            if status & _STATUS_VLAN_VALID:
                frame = _with_tag(frame, tci, tpid if status & _STATUS_VLAN_TPID_VALID else _ETH_P_8021Q)
            self._status[at >> 2] = 0  # the slot is the kernel's again
            at += self._slot_bytes
            if at == self._end:
                at = 0
            if snap == length:
                arrivals.append((ifindex, sec, nsec, frame))
            else:
                self.oversized += 1
        self._at = at
        return arrivals

    def losses(self) -> int:
        """Frames that found the ring full, since the start."""
        # struct tpacket_stats: packets, drops; reading clears them.
        self._losses += struct.unpack("=II", self._sock.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, 8))[1]
        return self._losses

    def close(self) -> None:
        """Stop receiving."""
        self._status.release()
        self._map.close()
        self._sock.close()


def _with_tag(frame: bytes, tci: int, tpid: int) -> bytes:
    """The kernel takes the VLAN tag out of a frame before a packet socket sees it; the other end wants it back."""
    return frame[:12] + struct.pack("!HH", tpid, tci) + frame[12:]
