"""What a frame of wnet says, in one line, and which frame travels inside. Never raises on a frame."""

from __future__ import annotations

from wnet.core import wire
from wnet.core.events import Drop

ETHERTYPE = int.from_bytes(wire.ETHERTYPE, "big")
_NAMES = {
    wire.HELLO: "HELLO",
    wire.ACK: "acknowledgement",
    wire.PROBE: "probe",
    wire.UNICAST: "unicast",
    wire.MULTICAST: "forward list",
    wire.ROUTED: "routed",
    wire.FLOOD: "flood",
    wire.TC: "TC",
    wire.AGGREGATE: "aggregate",
    wire.SEALED: "sealed",
}
_CARRIERS = frozenset({wire.UNICAST, wire.MULTICAST, wire.ROUTED, wire.FLOOD})


def inner_offset(frame: bytes, start: int) -> int | None:
    """Where the whole Ethernet frame inside begins; None if there is none, or several.

    Args:
        frame: A frame of type ``ETHERTYPE``.
        start: Where its payload begins.
    """
    data = wire.decode(frame[start:]) if start < len(frame) and frame[start] in _CARRIERS else Drop.OTHER_TYPE
    return None if isinstance(data, Drop) else frame.index(data.tail, start) + wire.ORIGIN_BYTES


def inner_frame(frame: bytes, start: int) -> bytes | None:
    """The frame that begins there, up to the end of this one."""
    offset = inner_offset(frame, start)
    return None if offset is None else frame[offset:]


def describe(frame: bytes, start: int) -> str:
    """Say what the header is, or what is wrong with it."""
    kind = frame[start] if start < len(frame) else 0
    if kind not in _NAMES:
        return "wnet?"
    if kind == wire.AGGREGATE:
        bodies = wire.split(frame[start:])
        told = bodies if isinstance(bodies, Drop) else f"of {len(bodies)}"
        return f"wnet aggregate {told}"
    return f"wnet {_NAMES[kind]}{_data(frame[start:]) if kind in _CARRIERS else ''}"


def _data(body: bytes) -> str:
    data = wire.decode(body)
    if isinstance(data, Drop):
        return f" ({data})"
    sequence = wire.origin_of(data.tail)[1]
    told = f" of {wire.source_of(data.tail).hex(':')} #{sequence} hop limit {data.hop_limit}"
    for hop in data.hops:
        told += (
            f", {hop.peer_mac.hex(':')} for {len(hop.destinations)}"
            if hop.destinations
            else f", {hop.peer_mac.hex(':')}"
        )
    return told + (f", try {data.attempt + 1}" if data.attempt else "")
