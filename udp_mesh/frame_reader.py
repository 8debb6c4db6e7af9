"""Cuts the byte stream between a daemon and an application into frames, without copying large ones."""

from __future__ import annotations

from udp_mesh.local_wire import LENGTH_BYTES, MAX_FRAME_BYTES, LocalProtocolError

_CHUNK_BYTES = 64 * 1024
_LARGE_BYTES = _CHUNK_BYTES // 2

Frame = tuple[int, memoryview]


class FrameReader:
    """Receive into :meth:`buffer`, then say with :meth:`filled` how much arrived.

    Small frames are cut from one buffer that is used again and again; a large one is received into memory of its own,
    which its body then is.
    """

    def __init__(self) -> None:
        self._chunk = memoryview(bytearray(_CHUNK_BYTES))
        self._chunk_bytes = 0  # of an incomplete frame, at the beginning of the chunk
        self._large: memoryview | None = None
        self._large_bytes = 0

    def buffer(self) -> memoryview:
        """Return where the next bytes belong; never empty."""
        if self._large is not None:
            return self._large[self._large_bytes :]
        return self._chunk[self._chunk_bytes :]

    def filled(self, size_bytes: int) -> list[Frame]:
        """Take the first bytes of what :meth:`buffer` returned; return each complete frame's type and body.

        Raises:
            LocalProtocolError: A frame is impossible.
        """
        if self._large is None:
            return self._cut(self._chunk_bytes + size_bytes)
        self._large_bytes += size_bytes
        if self._large_bytes < len(self._large):
            return []
        frame, self._large = self._large, None
        return [(frame[0], frame[1:])]

    def _cut(self, end: int) -> list[Frame]:
        frames: list[Frame] = []
        at = 0
        length = 0
        while end - at > LENGTH_BYTES:
            body = at + LENGTH_BYTES
            length = int.from_bytes(self._chunk[at:body], "big")
            if not 0 < length <= MAX_FRAME_BYTES:
                raise LocalProtocolError(f"a frame of {length} bytes; at most {MAX_FRAME_BYTES}")
            if length > end - body:
                break
            frames.append((self._chunk[body], memoryview(bytes(self._chunk[body + 1 : body + length]))))
            at = body + length
            length = 0
        self._keep(at, end, length)
        return frames

    def _keep(self, at: int, end: int, length: int) -> None:
        """Keep an incomplete frame: in memory of its own if it is large, else at the beginning of the chunk."""
        if length > _LARGE_BYTES:
            self._large = memoryview(bytearray(length))
            self._large_bytes = end - at - LENGTH_BYTES
            self._large[: self._large_bytes] = self._chunk[at + LENGTH_BYTES : end]
            self._chunk_bytes = 0
            return
        if at:
            self._chunk[: end - at] = self._chunk[at:end]
        self._chunk_bytes = end - at
