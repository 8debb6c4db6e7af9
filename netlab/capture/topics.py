"""Which channel a message goes to: one per topic, made when its first message comes, with its schema and metadata."""

from __future__ import annotations

import json
from collections.abc import Mapping

from netlab.capture import schemas
from netlab.capture.writer import CaptureWriter

VERDICTS_TOPIC = "/air/verdicts"
SNAPLEN = 262144
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


class Topics:
    """The channels of one file."""

    def __init__(self, writer: CaptureWriter) -> None:
        self.writer = writer
        self._channels: dict[str, int] = {}

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
        self.writer.add_message(self.json(topic, {}), t_ns, t_ns, body)

    def _channel(self, topic: str, schema: schemas.SchemaMaker, metadata: Mapping[str, str]) -> int:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self.writer.add_channel(topic, schema(), metadata)
        return channel
