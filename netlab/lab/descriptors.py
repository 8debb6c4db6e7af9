"""The descriptors that a new process gets, and our ends of them."""

from __future__ import annotations

import contextlib
import os
import socket
from collections.abc import Callable
from types import TracebackType

from netlab.lab.process import ProcessSpec

#: Called for each new process with a descriptor to give to it as its event stream, or None where nobody records.
FeedOpener = Callable[[ProcessSpec], int | None]


class ChildDescriptors:
    """Standard streams and what ``argv`` asks for; leaving the context closes the child's ends here.

    Attributes:
        fds: The child's descriptors; ``fds[i]`` becomes number i.
        argv: With the numbers filled in.
        env: Additions to the child's environment.
        output: Our end of its standard output and error.
        ready: Our end of its ready pipe, None where nobody waits for it.
        command: Our end of its command socket, None where it takes no commands.
    """

    def __init__(self, spec: ProcessSpec, open_events: FeedOpener) -> None:
        self._spec = spec
        self._open_events = open_events
        self._child_ends = contextlib.ExitStack()
        self.fds: list[int] = []
        self.argv: tuple[str, ...] = ()
        self.env: dict[str, str] = {}
        self.output = -1
        self.ready: int | None = None
        self.command: socket.socket | None = None

    def __enter__(self) -> ChildDescriptors:
        spec = self._spec
        self.output, write = os.pipe()
        self._give(os.open(os.devnull, os.O_RDONLY))
        self._give(write)
        self.fds.append(write)
        values: dict[str, str] = {}
        if spec.waits_for_ready:
            self.ready, ready_write = os.pipe()
            values["{ready_fd}"] = self.env["READY_FD"] = self._give(ready_write)
        if "{events_fd}" in spec.argv:
            events = self._open_events(spec)
            values["{events_fd}"] = self._give(os.open(os.devnull, os.O_WRONLY) if events is None else events)
        if "{command_fd}" in spec.argv:
            self.command, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
            self.command.setblocking(False)
            values["{command_fd}"] = self._give(theirs.detach())
        self.argv = tuple(values.get(argument, argument) for argument in spec.argv)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child_ends.close()

    def _give(self, fd: int) -> str:
        """Hand a descriptor to the child; returns the number that it will have there."""
        self._child_ends.callback(os.close, fd)
        self.fds.append(fd)
        return str(len(self.fds) - 1)
