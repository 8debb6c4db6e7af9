"""What became of a message, and the frames of the local socket that tell it (docs/wire.md). No sockets."""

from __future__ import annotations

import math
import struct
from dataclasses import dataclass
from enum import StrEnum

from udp_mesh.local_wire import FrameType, LocalProtocolError, frame

_TRACKED = struct.Struct("!IQ")
_FATE = struct.Struct("!IBBdB")
_FOLLOW = struct.Struct("!IQ")


class Outcome(StrEnum):
    """How a message ended at one destination."""

    ACKNOWLEDGED = "acknowledged"
    """The node has all of it; a stored message is safe in its file."""
    FAILED = "failed"
    """It was given up before that; the reason says why."""
    UNKNOWN = "unknown"
    """Nobody can tell any more, for example because the receiver was restarted while it was on its way."""


_OUTCOMES = list(Outcome)


@dataclass(frozen=True, slots=True)
class Fate:
    """What became of a message at ``peer``.

    ``reason``: empty if it was acknowledged, else why not: a drop or refusal reason of the daemon,
    ``daemon_unreachable``, ``settled_unseen`` (it ended while nobody could be told) or ``not_followed``.
    ``latency_s``: from the daemon's taking it to the acknowledgement; None otherwise.
    ``may_have_arrived``: whether a message that was not acknowledged can have been delivered all the same.
    """

    peer: str
    outcome: Outcome
    reason: str = ""
    latency_s: float | None = None
    may_have_arrived: bool = False


def unknown(peer: str, reason: str) -> Fate:
    """Return the fate of a message that nobody can tell."""
    return Fate(peer, Outcome.UNKNOWN, reason, may_have_arrived=True)


@dataclass(frozen=True, slots=True)
class Tracked:
    """The daemon has a tracked message. The k-th of ``peers`` has it as ``message_id``, a stored one plus k.

    ``peers`` is empty if the daemon took it in an earlier life and does not know for whom.
    """

    request: int
    message_id: int
    peers: tuple[str, ...]


def encode_tracked(tracked: Tracked) -> bytes:
    """Return the frame that says to which nodes a tracked message goes."""
    names = [name.encode() for name in tracked.peers]
    body = b"".join(bytes((len(name),)) + name for name in names)
    return frame(FrameType.TRACKED, _TRACKED.pack(tracked.request, tracked.message_id) + body)


def decode_tracked(body: memoryview) -> Tracked:
    """Decode the body of a tracked frame."""
    request, message_id = _TRACKED.unpack_from(body)
    names, at = [], _TRACKED.size
    while at < len(body):
        end = at + 1 + body[at]
        names.append(str(body[at + 1 : end], "utf-8"))
        at = end
    return Tracked(request, message_id, tuple(names))


def encode_fate(request: int, fate: Fate) -> bytes:
    """Return the frame that tells what became of a tracked message at one destination."""
    peer = fate.peer.encode()
    latency_s = math.nan if fate.latency_s is None else fate.latency_s
    head = _FATE.pack(request, _OUTCOMES.index(fate.outcome), fate.may_have_arrived, latency_s, len(peer))
    return frame(FrameType.FATE, head + peer + fate.reason.encode())


def decode_fate(body: memoryview) -> tuple[int, Fate]:
    """Decode the body of a fate frame: the publish's request number, and the fate."""
    request, outcome, may_have_arrived, latency_s, peer_bytes = _FATE.unpack_from(body)
    peer = str(body[_FATE.size : _FATE.size + peer_bytes], "utf-8")
    reason = str(body[_FATE.size + peer_bytes :], "utf-8")
    known_s = None if math.isnan(latency_s) else latency_s
    return request, Fate(peer, _OUTCOMES[outcome], reason, known_s, bool(may_have_arrived))


def encode_follow(request: int, sequence: int, peer: str) -> bytes:
    """Return the frame with which an application asks, on a new connection, for the fate of a stored message."""
    return frame(FrameType.FOLLOW, _FOLLOW.pack(request, sequence) + peer.encode())


def decode_follow(body: memoryview) -> tuple[int, int, str]:
    """Decode the body of a follow frame: request, sequence, peer.

    Raises:
        LocalProtocolError: It is damaged.
    """
    if len(body) < _FOLLOW.size:
        raise LocalProtocolError("a follow frame has a head of 12 bytes")
    request, sequence = _FOLLOW.unpack_from(body)
    return request, sequence, str(body[_FOLLOW.size :], "utf-8")
