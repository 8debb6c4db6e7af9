"""Which channel a message goes to: one per topic, made when its first message comes, with its schema and metadata."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from typing import TYPE_CHECKING, Protocol

from netlab.capture import schemas
from netlab.capture.mesh_view import MeshView

if TYPE_CHECKING:
    from netlab.capture.drawing import Drawing

VERDICTS_TOPIC = "/air/verdicts"
SNAPLEN = 262144
_DRAWN = ("/map", "/poses")
_KEPT_ACTS = 10_000
_ARPHRD_TO_LINKTYPE = {
    1: 1,  # Ethernet
    772: 1,  # loopback
    803: 127,  # 802.11 with radiotap
    65534: 101,  # none: raw IP
    512: 9,  # PPP
}
_LINKTYPE_RAW_IP = 101


def packets_topic(node: str, interface: str) -> str:
    """Topic of one interface's packets."""
    return f"/{node}/{interface}/packets"


def log_topic(node: str, process: str) -> str:
    """Topic of one process's output."""
    return f"/{node}/log/{process}"


class Writer(Protocol):
    """What takes channels and messages; a file's writer, or several outlets."""

    def add_channel(self, topic: str, schema: schemas.Schema, metadata: Mapping[str, str]) -> int:
        """Declare a channel and return its number."""

    def add_message(self, channel: int, log_ns: int, publish_ns: int, head: bytes, body: bytes = b"") -> None:
        """Record ``head + body`` on a channel."""

    def keep(self, channel: int, key: Hashable, log_ns: int, data: bytes) -> None:
        """Remember a message as what stands for ``key`` on its channel from now on."""


class Topics:
    """The channels of one recorder."""

    def __init__(self, writer: Writer) -> None:
        self.writer = writer
        self._channels: dict[str, int] = {}
        self._timeline_length = 0
        #: Scenario time zero, as soon as it is known.
        self.t0_ns: int | None = None
        #: What the nodes' layer-2 meshes know.
        self.mesh = MeshView()
        self._drawing: Drawing | None = None
        self._links: dict[Hashable, Mapping[str, object]] = {}  # for a drawing that begins later

    def packets(self, node: str, interface: str, hardware_type: int) -> tuple[int, int]:
        """Return (channel, linktype) for an interface; ``hardware_type`` is its ARPHRD number."""
        linktype = _ARPHRD_TO_LINKTYPE.get(hardware_type, _LINKTYPE_RAW_IP)
        metadata = {"linktype": str(linktype), "node": node, "interface": interface, "snaplen": str(SNAPLEN)}
        return self._channel(packets_topic(node, interface), schemas.packet_schema, metadata), linktype

    def verdicts(self) -> int:
        """The channel of the medium's decisions."""
        return self._channel(VERDICTS_TOPIC, schemas.verdict_schema, {})

    def log(self, topic: str, node: str, process: str) -> int:
        """The channel of one process's output."""
        return self._channel(topic, schemas.log_schema, {"node": node, "process": process})

    def json(self, topic: str, metadata: Mapping[str, str]) -> int:
        """The channel of a topic of JSON objects."""
        return self._channel(topic, lambda: schemas.json_schema_for(topic), metadata)

    def add_json(self, topic: str, payload: Mapping[str, object], t_ns: int) -> None:
        """Record one object of the lab's own; of those with a place, also what Foxglove draws of them."""
        if topic in _DRAWN:
            self._drawn().take(topic, payload, t_ns)
            return
        if topic == "/links":
            self._links[self._stands_for(topic, payload)] = payload
            if self._drawing is not None:
                self._drawing.take(topic, payload, t_ns)
        body = json.dumps(payload, separators=(",", ":"), default=str).encode()
        channel = self.json(topic, {})
        self.writer.add_message(channel, t_ns, t_ns, body)
        self.writer.keep(channel, self._stands_for(topic, payload), t_ns, body)

    def draw(self, now_ns: int) -> None:
        """Record the scenes of links and mesh as they are now, if they are others than the last."""
        if self._drawing is not None:
            self._drawing.draw(now_ns)

    def _drawn(self) -> Drawing:
        if self._drawing is None:
            from netlab.capture.drawing import Drawing  # its schemas cost a start 60 ms that not every lab needs

            self._drawing = Drawing(self, self.mesh)
            for row in self._links.values():
                self._drawing.take("/links", row, 0)
        return self._drawing

    def scene(self, topic: str, schema: schemas.SchemaMaker, t_ns: int, data: bytes) -> None:
        """Record a message that stands for its whole topic from now on."""
        channel = self._channel(topic, schema, {})
        self.writer.add_message(channel, t_ns, t_ns, data)
        self.writer.keep(channel, None, t_ns, data)

    def _stands_for(self, topic: str, payload: Mapping[str, object]) -> Hashable:
        """What a late onlooker has to know one message of: each link and each act."""
        if topic == "/links":
            return tuple(str(payload.get(key)) for key in ("segment", "from", "to"))
        if topic == "/timeline":
            self._timeline_length += 1
            return self._timeline_length % _KEPT_ACTS
        return None

    def _channel(self, topic: str, schema: schemas.SchemaMaker, metadata: Mapping[str, str]) -> int:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self.writer.add_channel(topic, schema(), metadata)
        return channel
