"""Frames between the daemon and local applications, over a Unix stream socket. Layouts: docs/wire.md, last section.

Every frame: length of what follows (4 bytes, big endian), type (1 byte), body. Both ends run as the same user.
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass, replace
from enum import IntEnum
from typing import TypeVar

from udp_mesh.core.settings import MAX_MESSAGE_BYTES, Keep, Offline, Reliability, TopicPolicy

MAX_FRAME_BYTES = MAX_MESSAGE_BYTES + 4096
_LENGTH = struct.Struct("!I")
LENGTH_BYTES = _LENGTH.size
_PUBLISH = struct.Struct("!IBhBBBdBB")
_MESSAGE = struct.Struct("!BQBB")
_VERDICT = struct.Struct("!IQ")
_LOST = struct.Struct("!I")
_UNSET = 255
FLAG_WANT_VERDICT = 1
FLAG_WAIT = 2
FLAG_TRACK = 4


class FrameType(IntEnum):
    """Below 64 from an application, others from the daemon."""

    PUBLISH = 1
    SUBSCRIBE = 2
    UNSUBSCRIBE = 3
    REQUEST = 4
    IDENTIFY = 5
    TAKEN = 6
    WATCH = 7
    ASK = 8
    ANSWER = 9
    FOLLOW = 10
    WELCOME = 64
    MESSAGE = 65
    PEERS = 66
    VERDICT = 67
    LOST = 68
    RESPONSE = 69
    STORED_MESSAGE = 70
    STATUS = 71
    QUESTION = 72
    ANSWERED = 73
    TRACKED = 74
    FATE = 75


class LocalProtocolError(Exception):
    """The other end sent what is no frame; the connection has to be closed."""


@dataclass(frozen=True, slots=True)
class Overrides:
    """What one publish call changes of its topic's policy; None leaves a setting. ``lifetime_s``: inf is forever."""

    priority: int | None = None
    reliability: Reliability | None = None
    keep: Keep | None = None
    offline: Offline | None = None
    lifetime_s: float | None = None

    def apply(self, policy: TopicPolicy) -> TopicPolicy:
        """Return the policy with the changes."""
        lifetime_s = policy.lifetime_s if self.lifetime_s is None else self.lifetime_s
        return replace(
            policy,
            priority=policy.priority if self.priority is None else self.priority,
            reliability=self.reliability or policy.reliability,
            keep=self.keep or policy.keep,
            offline=self.offline or policy.offline,
            lifetime_s=None if lifetime_s is not None and math.isinf(lifetime_s) else lifetime_s,
        )


@dataclass(frozen=True, slots=True)
class Publish:
    """An application's wish to send. ``waits``: hold it, and what follows, until there is room in the queue.

    ``is_tracked``: tell what becomes of it; see :mod:`udp_mesh.local_fates`.
    """

    request: int
    topic: str
    payload: bytes | memoryview
    to: str
    overrides: Overrides
    wants_verdict: bool
    waits: bool
    is_tracked: bool = False


@dataclass(frozen=True, slots=True)
class Message:
    """A message that this node has received. ``received_ns``: CLOCK_REALTIME at the daemon.

    ``reply_to``: the number of a question that expects an answer, 0 for any other message.
    """

    topic: str
    payload: bytes
    source: str
    priority: int
    received_ns: int
    reply_to: int = 0


@dataclass(frozen=True, slots=True)
class Verdict:
    """What became of a publish; ``reason`` is empty if it was taken."""

    request: int
    message_id: int
    reason: str


def frame(kind: FrameType, body: bytes) -> bytes:
    """Return a complete frame."""
    return b"".join((_LENGTH.pack(1 + len(body)), bytes((kind,)), body))


def json_frame(kind: FrameType, value: object) -> bytes:
    """Return a frame with a JSON body."""
    return frame(kind, json.dumps(value).encode())


_Choice = TypeVar("_Choice", Reliability, Keep, Offline)


def _code(kind: type[_Choice], value: _Choice | None) -> int:
    return _UNSET if value is None else list(kind).index(value)


def _choice(kind: type[_Choice], code: int) -> _Choice | None:
    return None if code == _UNSET else list(kind)[code]


def encode_publish(publish: Publish) -> bytes:
    """Return the frame of a publish; topic and destination have at most 255 bytes each."""
    topic, to, overrides = publish.topic.encode(), publish.to.encode(), publish.overrides
    flags = FLAG_WANT_VERDICT * publish.wants_verdict | FLAG_WAIT * publish.waits | FLAG_TRACK * publish.is_tracked
    head = _PUBLISH.pack(
        publish.request,
        flags,
        -1 if overrides.priority is None else overrides.priority,
        _code(Reliability, overrides.reliability),
        _code(Keep, overrides.keep),
        _code(Offline, overrides.offline),
        math.nan if overrides.lifetime_s is None else overrides.lifetime_s,
        len(topic),
        len(to),
    )
    return b"".join(
        (
            _LENGTH.pack(1 + len(head) + len(topic) + len(to) + len(publish.payload)),
            bytes((FrameType.PUBLISH,)),
            head,
            topic,
            to,
            publish.payload,
        )
    )


def decode_publish(body: memoryview) -> Publish:
    """Decode the body of a publish frame.

    Raises:
        LocalProtocolError: It is damaged.
    """
    try:
        request, flags, priority, reliability, keep, offline, lifetime_s, topic_bytes, to_bytes = _PUBLISH.unpack_from(
            body
        )
        at = _PUBLISH.size
        if at + topic_bytes + to_bytes > len(body):
            raise LocalProtocolError("a publish frame is shorter than its names")
        return Publish(
            request=request,
            topic=str(body[at : at + topic_bytes], "utf-8"),
            to=str(body[at + topic_bytes : at + topic_bytes + to_bytes], "utf-8"),
            payload=body[at + topic_bytes + to_bytes :],
            overrides=Overrides(
                priority=None if priority < 0 else priority,
                reliability=_choice(Reliability, reliability),
                keep=_choice(Keep, keep),
                offline=_choice(Offline, offline),
                lifetime_s=None if math.isnan(lifetime_s) else lifetime_s,
            ),
            wants_verdict=bool(flags & FLAG_WANT_VERDICT),
            waits=bool(flags & FLAG_WAIT),
            is_tracked=bool(flags & FLAG_TRACK),
        )
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise LocalProtocolError(f"bad publish frame: {error}") from error


def encode_message(message: Message) -> bytes:
    """Return the frame of a received message."""
    return encode_message_head(message) + message.payload


def encode_message_head(message: Message) -> bytes:
    """Return what precedes the payload in the frame of a received message."""
    source, topic = message.source.encode(), message.topic.encode()
    head = _MESSAGE.pack(message.priority, message.received_ns, len(source), len(topic))
    length = 1 + len(head) + len(source) + len(topic) + len(message.payload)
    return b"".join((_LENGTH.pack(length), bytes((FrameType.MESSAGE,)), head, source, topic))


def decode_message(body: memoryview) -> Message:
    """Decode the body of a message frame."""
    priority, received_ns, source_bytes, topic_bytes = _MESSAGE.unpack_from(body)
    at = _MESSAGE.size
    return Message(
        topic=str(body[at + source_bytes : at + source_bytes + topic_bytes], "utf-8"),
        payload=bytes(body[at + source_bytes + topic_bytes :]),
        source=str(body[at : at + source_bytes], "utf-8"),
        priority=priority,
        received_ns=received_ns,
    )


def encode_verdict(verdict: Verdict) -> bytes:
    """Return the frame that answers a publish."""
    return frame(FrameType.VERDICT, _VERDICT.pack(verdict.request, verdict.message_id) + verdict.reason.encode())


def decode_verdict(body: memoryview) -> Verdict:
    """Decode the body of a verdict frame."""
    request, message_id = _VERDICT.unpack_from(body)
    return Verdict(request, message_id, str(body[_VERDICT.size :], "utf-8"))


def encode_lost(count: int) -> bytes:
    """Return the frame that tells a slow subscriber how many messages it has missed since the last one."""
    return frame(FrameType.LOST, _LOST.pack(min(count, 0xFFFFFFFF)))


def decode_lost(body: memoryview) -> int:
    """Decode the body of a lost frame."""
    (count,) = _LOST.unpack_from(body)
    return int(count)
