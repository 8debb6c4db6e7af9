"""A kernel packet ring (AF_PACKET, TPACKET_V3) on all interfaces of one network namespace but loopback.

Owns one socket and its memory. The kernel fills blocks of packets without a system call per packet and hands a block
over when it is full or ``retire_ms`` old. Frames are whole: a block holds the largest frame that Linux has (64 KiB).
Source: Documentation/networking/packet_mmap.rst and include/uapi/linux/if_packet.h.
"""

from __future__ import annotations

import array
import ctypes
import fcntl
import mmap
import os
import socket
import struct
from dataclasses import dataclass
from typing import NamedTuple

from netlab.kernel.syscalls import CLONE_NEWNET, setns

_SOL_PACKET = 263
_PACKET_RX_RING = 5
_PACKET_STATISTICS = 6
_PACKET_VERSION = 10
_TPACKET_V3 = 2
_ETH_P_ALL = 3
_SO_ATTACH_FILTER = 26
_SIOCGIFNAME = 0x8910
_REQUEST = struct.Struct("=7I")  # tpacket_req3
_STATISTICS = struct.Struct("=3I")  # tpacket_stats_v3: packets, drops, freezes; reading resets them
_BLOCK_HEAD = struct.Struct("=3I")  # status, packets, offset of the first (at 8 in tpacket_block_desc)
# tpacket3_hdr (48 bytes, of which rxhash and padding are skipped) and the sockaddr_ll behind it
_PACKET = struct.Struct("=6IH6xIH14xiHB")
_STATUS_USER = 1
_STATUS_VLAN_VALID = 1 << 4
_STATUS_VLAN_TPID_VALID = 1 << 6
PACKET_OUTGOING = 4

# Classic BPF: accept whole packets unless the device is a loopback (ARPHRD_LOOPBACK).
_NO_LOOPBACK = struct.pack(
    "=HBBIHBBIHBBIHBBI",
    *(0x20, 0, 0, 0xFFFFF000 + 28),  # A = SKF_AD_HATYPE
    *(0x15, 0, 1, 772),  # if A == ARPHRD_LOOPBACK
    *(0x06, 0, 0, 0),  # drop
    *(0x06, 0, 0, 0x40000),
)


class RingPacket(NamedTuple):
    """One frame as the kernel stamped it. ``original_length`` exceeds the frame only where the kernel cut it."""

    t_ns: int
    ifindex: int
    hardware_type: int
    outgoing: bool
    original_length: int
    frame: bytes


@dataclass(frozen=True, slots=True)
class RingSize:
    """Blocks of one ring and the age in milliseconds at which the kernel hands over a block that is not full."""

    block_bytes: int
    blocks: int
    retire_ms: int

    @property
    def total_bytes(self) -> int:
        """Memory of the ring; locked, never swapped."""
        return self.block_bytes * self.blocks


def ring_size(nodes: int, *, budget_bytes: int = 256 << 20) -> RingSize:
    """Share ``budget_bytes`` among the rings of ``nodes`` nodes: 1..64 MiB each.

    Blocks are handed over every 20 ms in a small lab and every 200 ms in a large one, since each costs a wake-up.
    """
    share = min(max(budget_bytes // max(nodes, 1), 1 << 20), 64 << 20)
    block = 256 << 10 if share <= 8 << 20 else 1 << 20
    return RingSize(block, share // block, min(max(2 * nodes, 20), 200))


class PacketRing:
    """The ring of one namespace.

    Args:
        netns_fd: The namespace; the calling thread visits it and returns.
        size: From :func:`ring_size`.

    Raises:
        OSError: No CAP_NET_RAW there, no memory for the ring, or ``netns_fd`` is no network namespace.
    """

    def __init__(self, netns_fd: int, size: RingSize) -> None:
        self._size = size
        self._sock = _socket_in(netns_fd)
        try:
            self._memory = self._map()
        except OSError:
            self._sock.close()
            raise
        self._next_block = 0

    def fileno(self) -> int:
        """Readable when a block is ready."""
        return self._sock.fileno()

    @property
    def retire_s(self) -> float:
        """How long a packet can stay unseen in a block that is not full."""
        return self._size.retire_ms / 1000

    def read_block(self) -> list[RingPacket] | None:
        """Return the packets of the next ready block and give the block back to the kernel; None if none is ready."""
        base = self._next_block * self._size.block_bytes
        memory = self._memory
        status, count, offset = _BLOCK_HEAD.unpack_from(memory, base + 8)
        if not status & _STATUS_USER:
            return None
        packets, position = [], base + offset
        for _ in range(count):
            packet = _PACKET.unpack_from(memory, position)
            following, seconds, nanoseconds, captured, length, flags, mac, tci, tpid, ifindex, hatype, kind = packet
            start = position + mac
            frame = memory[start : start + captured]
            if flags & _STATUS_VLAN_VALID:  # the kernel took the tag out of the frame; captures hold it as it was sent
                tag = struct.pack("!HH", tpid if flags & _STATUS_VLAN_TPID_VALID else 0x8100, tci & 0xFFFF)
                frame, length = frame[:12] + tag + frame[12:], length + 4
            t_ns = seconds * 1_000_000_000 + nanoseconds
            packets.append(RingPacket(t_ns, ifindex, hatype, kind == PACKET_OUTGOING, length, frame))
            position += following
        struct.pack_into("=I", memory, base + 8, 0)
        self._next_block = (self._next_block + 1) % self._size.blocks
        return packets

    def take_drops(self) -> int:
        """Packets that found the ring full since the last call."""
        drops: int = _STATISTICS.unpack(self._sock.getsockopt(_SOL_PACKET, _PACKET_STATISTICS, _STATISTICS.size))[1]
        return drops

    def interface_name(self, ifindex: int) -> str:
        """Name of an interface in the ring's namespace; ``if<index>`` when it is gone already."""
        request = array.array("b", struct.pack("=16si20x", b"", ifindex))
        try:
            fcntl.ioctl(self._sock, _SIOCGIFNAME, request)
        except OSError:
            return f"if{ifindex}"
        return request.tobytes()[:16].split(b"\0", 1)[0].decode()

    def close(self) -> None:
        """Give the memory back."""
        self._memory.close()
        self._sock.close()

    def _map(self) -> mmap.mmap:
        size = self._size
        # What came in before the ring stands waits in the socket's queue, and the kernel throws that away with the
        # switch: all that the ring holds has passed this filter.
        _attach_filter(self._sock, _NO_LOOPBACK)
        self._sock.setsockopt(_SOL_PACKET, _PACKET_VERSION, _TPACKET_V3)
        # frame_size only has to divide the block; with version 3 frames are packed, not slotted.
        request = (size.block_bytes, size.blocks, 2048, size.total_bytes // 2048, size.retire_ms, 0, 0)
        self._sock.setsockopt(_SOL_PACKET, _PACKET_RX_RING, _REQUEST.pack(*request))
        return mmap.mmap(self._sock.fileno(), size.total_bytes, mmap.MAP_SHARED, mmap.PROT_READ | mmap.PROT_WRITE)


def _socket_in(netns_fd: int) -> socket.socket:
    home = os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)
    try:
        setns(netns_fd, CLONE_NEWNET)
        try:
            return socket.socket(socket.AF_PACKET, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.htons(_ETH_P_ALL))
        finally:
            setns(home, CLONE_NEWNET)
    finally:
        os.close(home)


def _attach_filter(sock: socket.socket, program: bytes) -> None:
    buffer = ctypes.create_string_buffer(program, len(program))
    # struct sock_fprog: instruction count, padding, pointer
    sock.setsockopt(
        socket.SOL_SOCKET, _SO_ATTACH_FILTER, struct.pack("@HP", len(program) // 8, ctypes.addressof(buffer))
    )
