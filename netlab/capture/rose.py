"""What a datagram of rose says, in one line. Never raises on bytes."""

from __future__ import annotations

from rose.core.types import known_type
from rose.core.wire import MAGIC, Fault, Flag, Header, Kind, decode

_NAMES = {
    Kind.PUBLICATION: "publishes",
    Kind.COMMAND: "commands",
    Kind.ANSWER: "answers",
    Kind.ANNOUNCEMENT: "announces",
}


def header_of(payload: bytes | memoryview) -> Header | None:
    """Return the header of a UDP payload; None if it is none of rose's."""
    if bytes(payload[:2]) != MAGIC:
        return None
    header = decode(payload)
    return None if isinstance(header, Fault) else header


def describe(header: Header) -> str:
    """Say what a datagram is."""
    info = known_type(header.type_id)
    part = f" part {header.part + 1}/{header.parts}" if header.parts > 1 else ""
    refused = " (refused)" if header.flags & Flag.REFUSED else ""
    sealed = " sealed" if header.flags & Flag.SEALED else ""
    name = info.name if info else f"type {header.type_id.hex()}"
    return f"rose {header.sender} {_NAMES[header.kind]}{refused} #{header.sequence}{part} {name}{sealed}"
