"""What both clients raise, take and return. No connection, no state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict

from udp_mesh.core.peer_status import PathStatus, PeerStatus
from udp_mesh.core.settings import Keep, Offline, Reliability
from udp_mesh.local_wire import Overrides

#: The name under which applications know it.
PeerInfo = PeerStatus


class ClientError(Exception):
    """Base of what the clients raise."""


class Refused(ClientError):
    """A message was not taken; ``reason`` is one of the daemon's refusal reasons, or ``daemon_unreachable``."""

    def __init__(self, reason: str) -> None:
        super().__init__(reason)
        self.reason = reason


class WouldBlock(ClientError):
    """The daemon does not keep up with this application; the message was not taken."""


class RequestFailed(ClientError):
    """The daemon answered a question with an error, or not in time."""


class PublishOptions(TypedDict, total=False):
    """What one publish may change of its topic's settings; what is left out, or None, stays as it is configured."""

    priority: int | None
    """0..255, lower is more urgent."""
    reliability: str | None
    """``reliable`` or ``best_effort``."""
    keep: str | None
    """``all`` or ``latest``."""
    lifetime_s: float | None
    """Above 0; infinity is for ever."""
    offline: str | None
    """``discard``, ``latest`` or ``store``."""


@dataclass(frozen=True, slots=True)
class Status:
    """Links and queues. ``queued``: messages that wait or are in flight, by topic; ``stored``: those in the file."""

    peers: tuple[PeerInfo, ...]
    queued: dict[str, int]
    stored: dict[str, int]


def overrides_of(options: PublishOptions) -> Overrides:
    """Return typed overrides.

    Raises:
        ValueError: A word is not one of its choices, or the lifetime is not positive.
    """
    lifetime_s = options.get("lifetime_s")
    reliability, keep, offline = options.get("reliability"), options.get("keep"), options.get("offline")
    if lifetime_s is not None and not lifetime_s > 0:
        raise ValueError(f"lifetime_s has to be positive, not {lifetime_s}")
    return Overrides(
        options.get("priority"),
        None if reliability is None else Reliability(reliability),
        None if keep is None else Keep(keep),
        None if offline is None else Offline(offline),
        lifetime_s,
    )


def result_of(answer: dict[str, object]) -> object:
    """Return what an answer holds.

    Raises:
        RequestFailed: It is an error.
    """
    if "error" in answer:
        raise RequestFailed(str(answer["error"]))
    return answer["result"]


def peers_of(result: object) -> list[PeerInfo]:
    """Return an answer about peers, typed."""
    return [_peer_of(entry) for entry in result] if isinstance(result, list) else []


def _peer_of(entry: dict[str, Any]) -> PeerInfo:
    return PeerInfo(**{**entry, "paths": tuple(PathStatus(**path) for path in entry.get("paths", ()))})


def table_of(result: object) -> dict[str, object]:
    """Return an answer that is an object."""
    return result if isinstance(result, dict) else {}
