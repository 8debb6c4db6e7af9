"""Frames of the local socket beyond plain messages: identity, stored messages, state, questions (docs/wire.md)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace

from udp_mesh import local_wire
from udp_mesh.core.envelope import DurableId, decode_ids, encode_ids
from udp_mesh.local_wire import LENGTH_BYTES, FrameType, LocalProtocolError, Message, Publish, frame

_IDENTITY = struct.Struct("!Q")
_DURABLE = struct.Struct("!QQ")
_WATCH = struct.Struct("!I")  # milliseconds
_NUMBER = struct.Struct("!Q")
_ANSWER = struct.Struct("!IB")
FAILED = 255
"""Status of an answer that the daemon gives itself; the payload is the reason."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a question. ``status``: see :class:`udp_mesh.core.envelope.Status`, or ``FAILED``."""

    request: int
    status: int
    payload: bytes


def encode_identity(client: int) -> bytes:
    """Return the frame that names an application across its connections: a random number of 64 bits."""
    return frame(FrameType.IDENTIFY, _IDENTITY.pack(client))


def decode_identity(body: memoryview) -> int:
    """Decode the body of an identity frame.

    Raises:
        LocalProtocolError: It is damaged.
    """
    if len(body) != _IDENTITY.size:
        raise LocalProtocolError("an identity has 8 bytes")
    (client,) = _IDENTITY.unpack(body)
    return int(client)


def encode_watch(interval_s: float) -> bytes:
    """Return the frame that asks for the state of links and queues every so often; 0 ends it."""
    return frame(FrameType.WATCH, _WATCH.pack(round(interval_s * 1000)))


def decode_watch(body: memoryview) -> float:
    """Decode the body of a watch frame: an interval in seconds.

    Raises:
        LocalProtocolError: It is damaged.
    """
    if len(body) != _WATCH.size:
        raise LocalProtocolError("a watch frame has 4 bytes")
    return float(_WATCH.unpack(body)[0]) / 1000


def encode_stored_message(durable_id: DurableId, message: Message) -> bytes:
    """Return the frame of a message that the application has to take."""
    return frame(FrameType.STORED_MESSAGE, _DURABLE.pack(*durable_id) + _message_body(message))


def decode_stored_message(body: memoryview) -> tuple[DurableId, Message]:
    """Decode the body of a stored message's frame."""
    return DurableId(*_DURABLE.unpack_from(body)), local_wire.decode_message(body[_DURABLE.size :])


def encode_taken(ids: Sequence[DurableId]) -> bytes:
    """Return the frame that says: the application has these stored messages."""
    return frame(FrameType.TAKEN, encode_ids(ids))


def decode_taken(body: memoryview) -> list[DurableId]:
    """Decode the body of a taken frame; an incomplete id at its end is left out."""
    return decode_ids(body)


def _message_body(message: Message) -> bytes:
    return local_wire.encode_message(message)[LENGTH_BYTES + 1 :]


def encode_ask(publish: Publish) -> bytes:
    """Return the frame of a question: as a publish."""
    return frame(FrameType.ASK, local_wire.encode_publish(publish)[LENGTH_BYTES + 1 :])


def encode_question(message: Message) -> bytes:
    """Return the frame that gives an application a question."""
    return frame(FrameType.QUESTION, _NUMBER.pack(message.reply_to) + _message_body(message))


def decode_question(body: memoryview) -> Message:
    """Decode the body of a question's frame."""
    (number,) = _NUMBER.unpack_from(body)
    return replace(local_wire.decode_message(body[_NUMBER.size :]), reply_to=number)


def encode_reply(number: int, payload: bytes) -> bytes:
    """Return the frame with which an application answers a question."""
    return frame(FrameType.ANSWER, _NUMBER.pack(number) + payload)


def decode_reply(body: memoryview) -> tuple[int, bytes]:
    """Decode the body of an application's answer.

    Raises:
        LocalProtocolError: It is damaged.
    """
    if len(body) < _NUMBER.size:
        raise LocalProtocolError("an answer has a number of 8 bytes")
    return int(_NUMBER.unpack_from(body)[0]), bytes(body[_NUMBER.size :])


def encode_answer(answer: Answer) -> bytes:
    """Return the frame that tells an application what came of its question."""
    return frame(FrameType.ANSWERED, _ANSWER.pack(answer.request, answer.status) + answer.payload)


def decode_answer(body: memoryview) -> Answer:
    """Decode the body of an answer's frame."""
    request, status = _ANSWER.unpack_from(body)
    return Answer(request, status, bytes(body[_ANSWER.size :]))
