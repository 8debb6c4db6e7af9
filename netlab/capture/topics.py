"""Which channel a message goes to: one per topic, made when its first message comes, with its schema and metadata."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping
from typing import Protocol

from netlab.capture import schemas

VERDICTS_TOPIC = "/air/verdicts"
SNAPLEN = 262144
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
        """Record one object of the lab's own."""
        body = json.dumps(payload, separators=(",", ":"), default=str).encode()
        channel = self.json(topic, {})
        self.writer.add_message(channel, t_ns, t_ns, body)
        self.writer.keep(channel, self._stands_for(topic, payload), t_ns, body)

    def _stands_for(self, topic: str, payload: Mapping[str, object]) -> Hashable:
        """What a late onlooker has to know one message of: each link, each act, and one map and one set of poses."""
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
