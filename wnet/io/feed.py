"""Writes events and counters as JSON lines to a descriptor, never waiting for its reader."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Mapping

from udp_mesh.io.feed import event_name
from wnet.core.events import Event

_ENCODER = json.JSONEncoder(separators=(",", ":"))
_WAITING_BYTES_MAX = 1 << 20


class EventFeed:
    """Buffered per loop turn. What the reader is too slow for is dropped in whole lines and counted."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._waiting = bytearray()
        self._lost = 0
        self._counts: dict[str, int] = {}
        os.set_blocking(fd, False)

    def add(self, event: Event) -> None:
        """Queue an event."""
        names = [field.name for field in dataclasses.fields(event) if field.name != "now"]
        fields = {name: _plain(getattr(event, name)) for name in names}
        t_ns = int(event.now * 1e9) + time.time_ns() - time.monotonic_ns()
        self._line({"t_ns": t_ns, "event": event_name(type(event)), **fields})

    def stats(self, counts: Mapping[str, int]) -> None:
        """Queue the counters, where one has changed; those that are 0 are left out."""
        told = {name: value for name, value in counts.items() if value}
        if told != self._counts:
            self._counts = told
            self._line({"t_ns": time.time_ns(), "event": "stats", **told})

    def flush(self) -> None:
        """Write what the reader takes now; the rest waits for the next call."""
        if not self._waiting:
            return
        try:
            del self._waiting[: os.write(self._fd, self._waiting)]
        except BlockingIOError:
            return
        except OSError:  # nobody reads any more
            self._waiting.clear()

    def _line(self, values: Mapping[str, object]) -> None:
        if len(self._waiting) > _WAITING_BYTES_MAX:
            self._lost += 1
            return
        if self._lost:
            lost, self._lost = self._lost, 0
            self._line({"t_ns": time.time_ns(), "event": "events_lost", "count": lost})
        self._waiting += _ENCODER.encode(values).encode() + b"\n"


def _plain(value: object) -> object:
    """MAC addresses as people write them."""
    return value.hex(":") if isinstance(value, bytes) else value
