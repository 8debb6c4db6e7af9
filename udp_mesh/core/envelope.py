"""What opens the payload of a message that is stored, confirms, asks, answers, or is compressed (docs/wire.md).

Only messages that use one of these features carry it, marked by ``wire.DATA_FLAG_ENVELOPE``. Values and bytes; what
they mean is the business of :mod:`udp_mesh.core.custody` and :mod:`udp_mesh.core.inbox`.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

_STORED, _CONFIRMS, _REQUEST, _RESPONSE, _COMPRESSED = 0x01, 0x02, 0x04, 0x08, 0x10
_KNOWN = _STORED | _CONFIRMS | _REQUEST | _RESPONSE | _COMPRESSED
_STORED_PART = struct.Struct("!QQQ")  # store, sequence, floor
_REQUEST_PART = struct.Struct("!Q")
_RESPONSE_PART = struct.Struct("!QB")  # request, status
_COMPRESSED_PART = struct.Struct("!I")  # size once decompressed
_DURABLE = struct.Struct("!QQ")
MAX_ENVELOPE_BYTES = 1 + _STORED_PART.size + _REQUEST_PART.size + _RESPONSE_PART.size + _COMPRESSED_PART.size


class DurableId(NamedTuple):
    """Names a stored message for ever: its sender's store file (random, 64 bits) and the message's number in it."""

    store: int
    sequence: int


class Status(IntEnum):
    """How a request was answered."""

    ANSWERED = 0
    NOBODY = 1
    """No application at the destination has subscribed to the topic."""


@dataclass(frozen=True, slots=True)
class Envelope:
    """The features of one message; None and 0 are features that it does not use.

    ``floor``: every message of that store below it is settled with this receiver. ``original_bytes``: size of the
    payload before compression. ``confirms``: the payload is a list of durable ids that its sender has made safe.
    """

    stored: DurableId | None = None
    floor: int = 0
    request: int | None = None
    response: int | None = None
    status: int = 0
    original_bytes: int | None = None
    confirms: bool = False


def encode(envelope: Envelope) -> bytes:
    """Return the bytes that go before the payload."""
    features = _CONFIRMS if envelope.confirms else 0
    parts = b""
    if envelope.stored is not None:
        features |= _STORED
        parts += _STORED_PART.pack(*envelope.stored, envelope.floor)
    if envelope.request is not None:
        features |= _REQUEST
        parts += _REQUEST_PART.pack(envelope.request)
    if envelope.response is not None:
        features |= _RESPONSE
        parts += _RESPONSE_PART.pack(envelope.response, envelope.status)
    if envelope.original_bytes is not None:
        features |= _COMPRESSED
        parts += _COMPRESSED_PART.pack(envelope.original_bytes)
    return bytes((features,)) + parts


def decode(payload: bytes | memoryview) -> tuple[Envelope, memoryview] | None:
    """Return the envelope and what follows it; None if it is damaged or of a later version. Never raises."""
    view = memoryview(payload)
    if not len(view) or view[0] & ~_KNOWN or not view[0]:
        return None
    features, at = view[0], 1
    stored, floor, request, response, status, original_bytes = None, 0, None, None, 0, None
    try:
        if features & _STORED:
            store, sequence, floor = _STORED_PART.unpack_from(view, at)
            stored, at = DurableId(store, sequence), at + _STORED_PART.size
        if features & _REQUEST:
            (request,) = _REQUEST_PART.unpack_from(view, at)
            at += _REQUEST_PART.size
        if features & _RESPONSE:
            response, status = _RESPONSE_PART.unpack_from(view, at)
            at += _RESPONSE_PART.size
        if features & _COMPRESSED:
            (original_bytes,) = _COMPRESSED_PART.unpack_from(view, at)
            at += _COMPRESSED_PART.size
    except struct.error:
        return None
    envelope = Envelope(stored, floor, request, response, status, original_bytes, bool(features & _CONFIRMS))
    return envelope, view[at:]


def encode_ids(ids: Sequence[DurableId]) -> bytes:
    """Return the payload of a message that confirms stored messages."""
    return b"".join(_DURABLE.pack(*durable_id) for durable_id in ids)


def decode_ids(body: memoryview) -> list[DurableId]:
    """Return the confirmed messages; an incomplete last one is left out."""
    whole = len(body) - len(body) % _DURABLE.size
    return [DurableId(*pair) for pair in _DURABLE.iter_unpack(body[:whole])]
