"""Events, links and counters as JSON lines."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Mapping, Sequence

from udp_mesh.io.feed import event_name
from udp_mesh.io.line_feed import LineFeed
from wnet.core.events import Event
from wnet.core.snapshot import LinkState

_ENCODER = json.JSONEncoder(separators=(",", ":"))


class EventFeed(LineFeed):
    """The lines of a node."""

    def __init__(self, descriptor: int, mac: bytes) -> None:
        """``mac`` is the node's own name."""
        super().__init__(descriptor)
        self._mac = mac.hex(":")
        self._counts: dict[str, int] = {}
        self._links: list[dict[str, object]] = []

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

    def _line(self, values: Mapping[str, object]) -> None:
        if self.has_room():
            self.add_line(_ENCODER.encode(values).encode() + b"\n")


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
