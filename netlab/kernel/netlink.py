"""A netlink route socket that sends many messages at once and checks every answer. Knows bytes, not their meaning.

The socket belongs to the network namespace in which it was made and keeps working when the thread has moved on.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Iterator, Sequence

NLMSG_ERROR = 2
NLMSG_DONE = 3
NLM_F_ACK = 0x4
_NLM_F_CAPPED = 0x100
_NLM_F_ACK_TLVS = 0x200
_NLMSGERR_ATTR_MSG = 1
_SOL_NETLINK = 270
_NETLINK_CAP_ACK = 10
_NETLINK_EXT_ACK = 11

HEADER = struct.Struct("=IHHII")  # length, type, flags, sequence number, port
_ERROR = struct.Struct("=i")
_ATTRIBUTE = struct.Struct("=HH")

# The kernel answers a whole batch before this process reads the first answer, and drops what the receive buffer does
# not hold. An answer takes 768 bytes there, with an explanation up to twice that. An ordinary user's buffer
# (net.core.rmem_max, 208 KiB) holds a batch of 100; root's is made so large that a whole lab goes in one batch.
_ANSWER_BYTES = 2048
_ROOT_BUFFER_BYTES = 8 * 1024 * 1024
_SO_SNDBUFFORCE, _SO_RCVBUFFORCE = 32, 33  # asm-generic/socket.h
_SEQUENCE_END = 1 << 32


class NetlinkError(OSError):
    """The kernel refused message number ``position`` of a batch; ``reason`` is its own explanation, often empty."""

    def __init__(self, number: int, position: int, reason: str) -> None:
        super().__init__(number, os.strerror(number) + (f" ({reason})" if reason else ""))
        self.position = position
        self.reason = reason


class NetlinkSocket:
    """A netlink socket, by default NETLINK_ROUTE, in the namespace of the thread that makes it."""

    def __init__(self, protocol: int = socket.NETLINK_ROUTE) -> None:
        self._sock = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, protocol)
        for option in (_NETLINK_CAP_ACK, _NETLINK_EXT_ACK):
            self._sock.setsockopt(_SOL_NETLINK, option, 1)
        for option in (_SO_SNDBUFFORCE, _SO_RCVBUFFORCE):
            with contextlib.suppress(PermissionError):  # not root outside the lab's user namespace
                self._sock.setsockopt(socket.SOL_SOCKET, option, _ROOT_BUFFER_BYTES)
        self._batch_messages = self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // _ANSWER_BYTES
        # The kernel wants room beside the message (netlink_sendmsg() in net/netlink/af_netlink.c).
        self._batch_bytes = self._sock.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) // 2
        self._sequence = 0

    def fileno(self) -> int:
        """The descriptor; also good for interface ioctls in the socket's namespace."""
        return self._sock.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()

    def request(self, messages: Sequence[bytes], *, at_most: int = _SEQUENCE_END) -> None:
        """Send ``messages`` in order, as few system calls as fit, and check that the kernel took each one.

        Args:
            messages: With their headers; numbers and the flag that asks for an answer are added here.
            at_most: So many messages in one system call.

        Raises:
            NetlinkError: The first refused message. Later ones of its batch have been applied or refused as well: the
                kernel does not stop at an error.
            OSError: Answers were lost; nobody knows what has been applied.
        """
        for first, batch in _batches(messages, min(at_most, self._batch_messages), self._batch_bytes):
            sequence = self._reserve(len(batch))
            self._send(batch, sequence)
            self._check_answers(first, sequence, len(batch))

    def query(self, message: bytes) -> bytes:
        """Send one request that has one answer and return that, header included.

        Raises:
            NetlinkError: The kernel refused.
        """
        sequence = self._reserve(1)
        self._sock.sendto(_numbered(message, sequence), (0, 0))
        while True:
            for kind, number, answer in _split(self._sock.recv(1 << 16)):
                if number != sequence:
                    continue
                if kind == NLMSG_ERROR:
                    raise _error(answer, 0)
                return answer

    def dump(self, message: bytes) -> list[bytes]:
        """Send one dump request and return the messages of the answer, headers included.

        Raises:
            NetlinkError: The kernel refused.
        """
        sequence = self._reserve(1)
        self._sock.sendto(_numbered(message, sequence), (0, 0))
        answers: list[bytes] = []
        while True:
            for kind, number, answer in _split(self._sock.recv(1 << 18)):
                if number != sequence:
                    continue
                if kind == NLMSG_DONE:
                    return answers
                if kind == NLMSG_ERROR:
                    raise _error(answer, 0)
                answers.append(answer)

    def _reserve(self, count: int) -> int:
        """The first of ``count`` successive numbers: an answer to anything older is never taken for a newer one."""
        first = self._sequence if self._sequence + count <= _SEQUENCE_END else 0
        self._sequence = first + count
        return first

    def _send(self, batch: Sequence[bytes], sequence: int) -> None:
        data = bytearray()
        for number, message in enumerate(batch, start=sequence):
            data += _numbered(message, number, NLM_F_ACK)
            data += bytes(-len(data) % 4)
        self._sock.sendto(data, (0, 0))

    def _check_answers(self, first: int, sequence: int, count: int) -> None:
        failure: NetlinkError | None = None
        left = count
        while left:
            for kind, number, answer in _split(self._sock.recv(1 << 16)):
                position = number - sequence
                if kind != NLMSG_ERROR or not 0 <= position < count:
                    continue
                left -= 1
                if failure is None and _ERROR.unpack_from(answer, HEADER.size)[0]:
                    failure = _error(answer, first + position)
        if failure is not None:
            raise failure


def _numbered(message: bytes, number: int, flags: int = 0) -> bytes:
    length, kind, old_flags, _, port = HEADER.unpack_from(message)
    return HEADER.pack(length, kind, old_flags | flags, number, port) + message[HEADER.size :]


def _batches(messages: Sequence[bytes], most: int, most_bytes: int) -> Iterator[tuple[int, Sequence[bytes]]]:
    first = size = 0
    for position, message in enumerate(messages):
        if position > first and (position - first == most or size + len(message) > most_bytes):
            yield first, messages[first:position]
            first, size = position, 0
        size += len(message)
    if first < len(messages):
        yield first, messages[first:]


def _split(data: bytes) -> Iterator[tuple[int, int, bytes]]:
    """Type, sequence number and bytes of each message."""
    start = 0
    while start + HEADER.size <= len(data):
        length, kind, _, number, _ = HEADER.unpack_from(data, start)
        yield kind, number, data[start : start + length]
        start += (length + 3) & ~3


def _error(answer: bytes, position: int) -> NetlinkError:
    flags = HEADER.unpack_from(answer)[2]
    (number,) = _ERROR.unpack_from(answer, HEADER.size)
    length = HEADER.unpack_from(answer, HEADER.size + _ERROR.size)[0]
    reason = ""
    if flags & _NLM_F_ACK_TLVS:
        echoed = HEADER.size if flags & _NLM_F_CAPPED else length
        reason = (
            attributes(answer, HEADER.size + _ERROR.size + ((echoed + 3) & ~3)).get(_NLMSGERR_ATTR_MSG, b"").decode()
        )
    return NetlinkError(-number, position, reason.rstrip("\0"))


def attributes(data: bytes, start: int) -> dict[int, bytes]:
    """Return the attributes from ``start`` on by their type (flags removed); of equal types the last one."""
    found = {}
    while start + _ATTRIBUTE.size <= len(data):
        length, kind = _ATTRIBUTE.unpack_from(data, start)
        if length < _ATTRIBUTE.size:
            break
        found[kind & 0x3FFF] = data[start + _ATTRIBUTE.size : start + length]
        start += (length + 3) & ~3
    return found
