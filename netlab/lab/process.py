"""One process of a node: what to run, where it stands, and how its end is told to a person. Values only."""

from __future__ import annotations

import asyncio
import signal
import socket
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from netlab.lab.usage import Usage, usage_now

TAIL_LINES = 20


class State(StrEnum):
    """Where a process stands."""

    STARTING = "starting"
    READY = "ready"
    EXITED = "exited"


class Restart(StrEnum):
    """What to do when a process ends by itself."""

    NEVER = "never"
    ALWAYS = "always"


@dataclass(frozen=True, slots=True)
class ProcessSpec:
    """What to run in a node.

    ``{ready_fd}``, ``{events_fd}`` and ``{command_fd}`` in ``argv`` become descriptor numbers in the child: the first
    is written to when the program is ready, the second takes JSON lines for the capture, the third is a SEQPACKET
    socket whose other end is ``Process.command``.
    """

    node: str
    name: str
    argv: tuple[str, ...]
    env: Mapping[str, str] = field(default_factory=dict)
    waits_for_ready: bool = False
    restart: Restart = Restart.NEVER


@dataclass(slots=True)
class Process:
    """One process of a node; survives restarts of the program. ``used_before``: by runs that have ended."""

    spec: ProcessSpec
    state: State = State.STARTING
    pid: int = 0
    exit_status: int | None = None
    restarts: int = 0
    used_before: Usage = field(default_factory=Usage)
    stopping: bool = False
    command: socket.socket | None = None
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=TAIL_LINES))
    read_output: Callable[[], None] = lambda: None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

    def usage(self) -> Usage:
        """What it has used so far, all its runs taken together."""
        return self.used_before if self.state is State.EXITED else self.used_before.then(usage_now(self.pid))

    def identity(self) -> dict[str, str]:
        """Which process it is, as plain values."""
        return {"node": self.spec.node, "process": self.spec.name}

    def describe(self) -> dict[str, Any]:
        """The process as plain values."""
        return {
            **self.identity(),
            "state": self.state,
            "pid": self.pid,
            "exit_status": self.exit_status,
            "restarts": self.restarts,
        }

    def describe_failure(self) -> str:
        """Name, argv, exit code and last log lines, for a person."""
        status = "has not started" if self.exit_status is None else describe_status(self.exit_status)
        log = "".join(f"\n    {line}" for line in self.tail) or " (it printed nothing)"
        return f"{self.spec.node}: process '{self.spec.name}' {status}; argv: {' '.join(self.spec.argv)}; log:{log}"


def describe_status(status: int) -> str:
    """``status`` as in subprocess: negative means a signal."""
    if status >= 0:
        return f"ended with exit code {status}"
    try:
        return f"was ended by {signal.Signals(-status).name}"
    except ValueError:
        return f"was ended by signal {-status}"
