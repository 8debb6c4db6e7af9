"""JSON lines to a descriptor, never waiting for its reader. For the events of all our daemons."""

from __future__ import annotations

import json
import os
import time

_WAITING_BYTES_MAX = 1 << 20


class LineFeed:
    """Buffered until :meth:`flush`. What the reader is too slow for is dropped in whole lines and counted."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._waiting = bytearray()
        self._lost = 0
        os.set_blocking(descriptor, False)

    def has_room(self) -> bool:
        """Whether a line may be added now. One that may not is counted; how many, the next one that may tells."""
        if len(self._waiting) > _WAITING_BYTES_MAX:
            self._lost += 1
            return False
        if self._lost:
            lost = {"t_ns": time.time_ns(), "event": "events_lost", "count": self._lost}
            self._waiting += json.dumps(lost).encode() + b"\n"
            self._lost = 0
        return True

    def add_line(self, line: bytes) -> None:
        """Queue a line, with its end; only where there is room."""
        self._waiting += line

    def flush(self) -> None:
        """Write what the reader takes now; the rest waits for the next call."""
        if not self._waiting:
            return
        try:
            written = os.write(self._descriptor, self._waiting)
        except BlockingIOError:
            return
        except OSError:  # nobody reads any more
            self._waiting.clear()
            return
        del self._waiting[:written]
