"""Writes events as JSON lines to a descriptor, never waiting for its reader."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import time

from udp_mesh.core.events import Event, MessageDelivered

_ENCODER = json.JSONEncoder(separators=(",", ":"))
_HIDDEN = ("now", "payload", "flags", "token")
_MAX_WAITING_BYTES = 1024 * 1024


class EventFeed:
    """Buffered per loop turn. What the reader is too slow for is dropped in whole lines and counted."""

    def __init__(self, fd: int) -> None:
        self._fd = fd
        self._waiting = bytearray()
        self._lost = 0
        os.set_blocking(fd, False)

    def add(self, event: Event) -> None:
        """Queue an event."""
        if len(self._waiting) > _MAX_WAITING_BYTES:
            self._lost += 1
            return
        if self._lost:
            lost = {"t_ns": time.time_ns(), "event": "events_lost", "count": self._lost}
            self._waiting += json.dumps(lost).encode() + b"\n"
            self._lost = 0
        self._waiting += encode_event(event, offset_ns=time.time_ns() - time.monotonic_ns())

    def flush(self) -> None:
        """Write what the reader takes now; the rest waits for the next call."""
        if not self._waiting:
            return
        try:
            written = os.write(self._fd, self._waiting)
        except BlockingIOError:
            return
        except OSError:  # nobody reads any more
            self._waiting.clear()
            return
        del self._waiting[:written]


def encode_event(event: Event, *, offset_ns: int) -> bytes:
    """Return one JSON line. ``offset_ns``: CLOCK_REALTIME minus the monotonic clock of the event's ``now``.

    A payload is replaced by its size.
    """
    name, fields = _shape(type(event))
    values: dict[str, object] = {"t_ns": int(event.now * 1e9) + offset_ns, "event": name}
    for field in fields:
        values[field] = getattr(event, field)
    if isinstance(event, MessageDelivered):
        values["size_bytes"] = len(event.payload)
    return _ENCODER.encode(values).encode() + b"\n"


def event_name(kind: type[object]) -> str:
    """Return the name of an event in JSON: ``MessageQueued`` -> ``message_queued``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.__name__).lower()


_shapes: dict[str, tuple[str, tuple[str, ...]]] = {}


def _shape(kind: type[Event]) -> tuple[str, tuple[str, ...]]:
    """Return the name of an event and of its fields; worked out once for each kind."""
    shape = _shapes.get(kind.__name__)
    if shape is None:
        fields = tuple(field.name for field in dataclasses.fields(kind) if field.name not in _HIDDEN)
        shape = _shapes[kind.__name__] = event_name(kind), fields
    return shape
