"""What the supervisor and the fork server say to each other.

A module of its own: the fork server runs as ``__main__``, whose classes would differ from the supervisor's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from netlab.lab.usage import Usage


@dataclass(frozen=True, slots=True)
class AddNode:
    """Announce a node; its network namespace comes as the message's descriptor."""

    node: str
    hosts: str
    keep: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Spawn:
    """Start a process. The message's descriptors become ``fd_numbers`` in the child; all others are closed.

    With ``tty`` the child leads a session of its own whose terminal is descriptor 0.
    """

    token: int
    node: str
    argv: tuple[str, ...]
    env: Mapping[str, str]
    cwd: str
    fd_numbers: tuple[int, ...]
    tty: bool = False


@dataclass(frozen=True, slots=True)
class Spawned:
    """Answer to a Spawn: the process id in the lab, or why it could not be started."""

    token: int
    pid: int
    error: str | None = None


@dataclass(frozen=True, slots=True)
class Exited:
    """A child ended; ``status`` is negative for a signal, as in subprocess. ``used``: over its whole life."""

    pid: int
    status: int
    used: Usage
