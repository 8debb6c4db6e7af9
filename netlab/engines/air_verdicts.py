"""Verdict records on their way to the recorder: buffered in bounded memory, never waited for."""

from __future__ import annotations

import contextlib
import socket
import time
import zlib
from collections.abc import Mapping

from netlab.medium.pair import DROPPED, Outcome
from netlab.medium.verdicts import VERDICT_RECORD

_BUFFER_BYTES = 4 << 20
# Whole records in one piece of the kernel's memory, taken or refused as a whole (unix_stream_sendmsg): several
# processes may write to one stream.
_CHUNK_BYTES = 1 << 14
_NS_PER_S = 1_000_000_000
_NO_SIGNAL: Mapping[int, int] = {}


class VerdictStream:
    """Writes to one stream socket that it owns. ``lost`` counts records for which there was no room."""

    def __init__(self, fd: int) -> None:
        self._sock = socket.socket(fileno=fd)
        self._sock.setblocking(False)
        self._buffer = bytearray()
        self.lost = 0

    def fileno(self) -> int:
        """The socket's descriptor; writable when :meth:`flush` can go on."""
        return self._sock.fileno()

    @property
    def pending(self) -> bool:
        """Whether records wait."""
        return bool(self._buffer)

    def add(
        self,
        outcomes: list[Outcome],
        frame: bytes,
        sender: int,
        now: float,
        arrived_ns: int,
        *,
        attempts: int = 0,
        rssi_dbm: Mapping[int, int] = _NO_SIGNAL,
    ) -> None:
        """Note what became of ``frame``; ``now`` is the medium's time for the instant ``arrived_ns`` (realtime).

        Of 802.11 radios also the ``attempts`` made and how strongly each receiver hears the sender.
        """
        if len(self._buffer) > _BUFFER_BYTES:
            self.lost += len(outcomes)
            return
        crc, size = zlib.crc32(frame), len(frame)
        for due, receiver, _sent, verdict in outcomes:
            departs_ns = 0 if due == DROPPED else arrived_ns + round((due - now) * _NS_PER_S)
            signal = rssi_dbm.get(receiver, 0)
            self._buffer += VERDICT_RECORD.pack(
                arrived_ns, departs_ns, crc, size, sender, receiver, verdict, attempts, signal
            )

    def flush(self) -> None:
        """Write what the socket takes at once. A reader that went away takes everything, unseen."""
        while self._buffer:
            try:
                sent = self._sock.send(memoryview(self._buffer)[:_CHUNK_BYTES].tobytes())
            except BlockingIOError:
                return
            except OSError:
                self.lost += len(self._buffer) // VERDICT_RECORD.size
                sent = len(self._buffer)
            del self._buffer[:sent]

    def close(self, patience_s: float = 0.5) -> None:
        """Write the rest, waiting a little for a slow reader."""
        deadline = time.monotonic() + patience_s
        self.flush()
        while self._buffer and (left_s := deadline - time.monotonic()) > 0:
            self._sock.settimeout(left_s)
            with contextlib.suppress(TimeoutError):
                self.flush()
        self.lost += len(self._buffer) // VERDICT_RECORD.size
        self._sock.close()
