"""Frames in a stream of bytes: consistent overhead byte stuffing, with a checksum. No byte of a frame is zero.

Source: S. Cheshire, M. Baker: Consistent Overhead Byte Stuffing, IEEE/ACM Transactions on Networking 7(2), 1999.
"""

from __future__ import annotations

import zlib

DELIMITER = b"\0"
CHECKSUM_BYTES = 4
_BLOCK_BYTES = 254


def overhead_bytes(size_bytes: int) -> int:
    """Return how much longer a frame is than what it carries, the delimiter after it included."""
    whole = size_bytes + CHECKSUM_BYTES
    return CHECKSUM_BYTES + 1 + whole // _BLOCK_BYTES + len(DELIMITER)


def encode(data: bytes) -> bytes:
    """Return a frame: checksum (CRC-32) added, zeros replaced, delimited."""
    out = bytearray()
    for chunk in (data + zlib.crc32(data).to_bytes(CHECKSUM_BYTES, "big")).split(b"\0"):
        while len(chunk) >= _BLOCK_BYTES:
            out.append(_BLOCK_BYTES + 1)
            out += chunk[:_BLOCK_BYTES]
            chunk = chunk[_BLOCK_BYTES:]
        out.append(len(chunk) + 1)
        out += chunk
    return bytes(out) + DELIMITER


def decode(frame: bytes) -> bytes | None:
    """Return what a frame, without its delimiter, carries; None if it was damaged. Never raises."""
    out, at = bytearray(), 0
    while at < len(frame):
        code = frame[at]
        end = at + code
        if code == 0 or end > len(frame):
            return None
        out += frame[at + 1 : end]
        if code <= _BLOCK_BYTES and end < len(frame):
            out.append(0)
        at = end
    if len(out) < CHECKSUM_BYTES:
        return None
    data = bytes(out[:-CHECKSUM_BYTES])
    return data if zlib.crc32(data).to_bytes(CHECKSUM_BYTES, "big") == out[-CHECKSUM_BYTES:] else None


class Deframer:
    """Finds the frames in what arrives, in whatever pieces. Memory is bounded by the longest frame."""

    def __init__(self, *, longest_bytes: int) -> None:
        self._longest_bytes = longest_bytes
        self._begun = bytearray()
        self._skips = False  # in the middle of something that is no frame
        self.damaged = 0

    def feed(self, data: bytes) -> list[bytes]:
        """Return what the frames carry that are complete with these bytes; count those that are damaged."""
        *ends, rest = data.split(DELIMITER)
        found = []
        for piece in ends:
            self._add(piece)
            frame, skipped = bytes(self._begun), self._skips
            self._begun.clear()
            self._skips = False
            if not frame and not skipped:
                continue  # two delimiters in a row say nothing
            carried = None if skipped else decode(frame)
            if carried is None:
                self.damaged += 1
            else:
                found.append(carried)
        self._add(rest)
        return found

    def _add(self, piece: bytes) -> None:
        if len(self._begun) + len(piece) > self._longest_bytes:
            self._skips = True
            self._begun.clear()
        elif not self._skips:
            self._begun += piece
