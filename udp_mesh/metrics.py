"""The daemon's state as Prometheus text (exposition format 0.0.4), from what ``stats`` answers. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

_GAUGES = {
    "queued_bytes": "payload waiting or in flight",
    "reassembly_bytes": "memory reserved for partial messages",
    "stored_messages": "messages in the file that no receiver has confirmed",
    "stored_bytes": "payload of these",
    "inbox_messages": "received stored messages that no application has taken",
    "inbox_bytes": "payload of these",
}
_PEER_GAUGES = {
    "online": "whether the peer is held online",
    "srtt_s": "smoothed round-trip time in seconds",
    "rate_bps": "estimated rate of the path in bit/s",
    "queue_delay_s": "estimated queueing delay of the path in seconds",
    "cwnd_bytes": "congestion window",
    "queued_messages": "messages for this peer that wait or are in flight",
    "queued_bytes": "their payload",
}
_PREFIX = "udp_mesh"


def render(stats: Mapping[str, object]) -> str:
    """Return the text of one scrape."""
    return "".join(f"{line}\n" for line in _lines(stats))


def _lines(stats: Mapping[str, object]) -> Iterator[str]:
    node = f'node="{_escape(str(stats.get("name", "")))}"'
    counters = stats.get("counters")
    for name, value in sorted(counters.items()) if isinstance(counters, dict) else ():
        if name in _GAUGES:
            yield from _metric(name, "gauge", _GAUGES[name], [(node, value)])
        else:
            yield from _metric(f"{name}_total", "counter", name.replace("_", " "), [(node, value)])
    for key, meaning in (("queues", "messages that wait or are in flight"), ("stored", "messages in the file")):
        topics = stats.get(key)
        if isinstance(topics, dict):
            rows = [(f'{node},topic="{_escape(topic)}"', depth) for topic, depth in sorted(topics.items())]
            yield from _metric(f"topic_{key}", "gauge", f"{meaning}, by topic", rows)
    peers = stats.get("peers")
    known = [peer for peer in peers if isinstance(peer, dict)] if isinstance(peers, list) else []
    for name, meaning in _PEER_GAUGES.items():
        rows = [(f'{node},peer="{_escape(str(peer["name"]))}"', peer.get(name)) for peer in known]
        yield from _metric(f"peer_{name}", "gauge", meaning, rows)


def _metric(name: str, kind: str, meaning: str, rows: list[tuple[str, object]]) -> Iterator[str]:
    numbers = [(labels, value) for labels, value in rows if isinstance(value, int | float)]
    if numbers:
        yield f"# HELP {_PREFIX}_{name} {meaning}"
        yield f"# TYPE {_PREFIX}_{name} {kind}"
        for labels, value in numbers:
            yield (
                f"{_PREFIX}_{name}{{{labels}}} {float(value):g}"
                if isinstance(value, float)
                else (f"{_PREFIX}_{name}{{{labels}}} {int(value)}")
            )


def _escape(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
