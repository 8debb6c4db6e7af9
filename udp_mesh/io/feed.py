"""Events as JSON lines."""

from __future__ import annotations

import dataclasses
import json
import re
import time

from udp_mesh.core.events import Event, MessageDelivered
from udp_mesh.io.line_feed import LineFeed

_ENCODER = json.JSONEncoder(separators=(",", ":"))
_HIDDEN = ("now", "payload", "flags", "token")


class EventFeed(LineFeed):
    """The lines of a node's events."""

    def add(self, event: Event) -> None:
        """Queue an event."""
        if self.has_room():
            self.add_line(encode_event(event, offset_ns=time.time_ns() - time.monotonic_ns()))


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
