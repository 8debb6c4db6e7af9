"""One stored message on its sender's side. What happens to it: :mod:`udp_mesh.core.custody`."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto

from udp_mesh.core.settings import TopicPolicy


class Phase(Enum):
    """Where a stored message stands."""

    COMMITTING = auto()
    WAITING = auto()
    FED = auto()
    SENT = auto()


@dataclass(slots=True)
class Stored:
    """One message for one destination. ``payload`` is None while only the file has it; times are monotonic seconds."""

    sequence: int
    peer: str
    topic: str
    policy: TopicPolicy
    size_bytes: int
    queued_at_s: float
    deadline_s: float
    original_bytes: int | None = None
    payload: bytes | None = None
    phase: Phase = Phase.COMMITTING
    again_at_s: float = 0.0
    is_done: bool = False
