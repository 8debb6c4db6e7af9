"""Writes events and counters as JSON lines to a descriptor, never waiting for its reader."""

from __future__ import annotations

import dataclasses
import json
import os
import time
from collections.abc import Mapping, Sequence

from udp_mesh.io.feed import event_name
from wnet.core.events import Event
from wnet.core.snapshot import LinkState

_ENCODER = json.JSONEncoder(separators=(",", ":"))
_WAITING_BYTES_MAX = 1 << 20


class EventFeed:
    """Buffered per loop turn. What the reader is too slow for is dropped in whole lines and counted."""

    def __init__(self, fd: int, mac: bytes) -> None:
        """``mac`` is the node's own name."""
        self._fd = fd
        self._mac = mac.hex(":")
        self._waiting = bytearray()
        self._lost = 0
        self._counts: dict[str, int] = {}
        self._links: list[dict[str, object]] = []
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

    def links(self, links: Sequence[LinkState]) -> None:
        """Queue the links that are usable, as frames leave over them, where anything about them has changed."""
        told = [_link(link) for link in links if link.is_usable]
        if told != self._links:
            self._links = told
            self._line({"t_ns": time.time_ns(), "event": "links", "mac": self._mac, "links": told})

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


def _link(link: LinkState) -> dict[str, object]:
    """What the routing knows of a link: no figure that changes with every frame."""
    return {
        "neighbour": link.neighbour.hex(":"),
        "member": link.member,
        "quality": round(link.quality, 3),
        "cost": None if link.cost_out is None else round(link.cost_out, 3),
        "loss_ratio": None if link.loss_out_ratio is None else round(link.loss_out_ratio, 3),
        "snr_db": None if link.snr_out_db is None else round(link.snr_out_db, 1),
        "rate_bps": link.rate_bps,
    }
