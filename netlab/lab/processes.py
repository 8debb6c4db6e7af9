"""The processes that run in the nodes, as the supervisor sees them: start, readiness, output, exit, restart.

Output goes line by line to a log file of its own and, while recording, into the capture. All methods run on the
supervisor's event loop; the fork server answers in microseconds, so talking to it blocks.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import select
import signal
import socket
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

from netlab.errors import LabError
from netlab.ipc import Channel
from netlab.lab.spawn_messages import AddNode, Exited, Spawn, Spawned

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
    """One process of a node; survives restarts of the program."""

    spec: ProcessSpec
    state: State = State.STARTING
    pid: int = 0
    exit_status: int | None = None
    restarts: int = 0
    stopping: bool = False
    command: socket.socket | None = None
    tail: deque[str] = field(default_factory=lambda: deque(maxlen=TAIL_LINES))
    read_output: Callable[[], None] = lambda: None
    changed: asyncio.Event = field(default_factory=asyncio.Event)

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


#: Called for each new process with a descriptor to give to it as its event stream, or None where nobody records.
FeedOpener = Callable[[ProcessSpec], int | None]
LineSink = Callable[[str, str, str], None]  # node, process, line


class Processes:
    """All processes of the lab."""

    def __init__(self, channel: Channel, log_dir: Path, base_env: Mapping[str, str], cwd: str) -> None:
        self._channel = channel
        self._log_dir = log_dir
        self._base_env = dict(base_env)
        self._cwd = cwd
        self._tokens = itertools.count(1)
        self._by_key: dict[tuple[str, str], Process] = {}
        self._by_pid: dict[int, Process] = {}
        self._exit_waiters: dict[int, asyncio.Future[int]] = {}
        self.open_events: FeedOpener = lambda _spec: None
        self.on_line: LineSink = lambda _node, _process, _line: None
        self.on_exit: Callable[[Process], None] = lambda _process: None
        self.on_lost: Callable[[], None] = lambda: None  # the fork server is gone
        asyncio.get_running_loop().add_reader(channel.fileno(), self._on_channel)

    def add_node(self, node: str, net_fd: int, hosts: str, keep: tuple[str, ...]) -> None:
        """Make a node known to the fork server."""
        self._channel.send(AddNode(node, hosts, keep), [net_fd])

    def all(self) -> list[Process]:
        """Every process, in starting order."""
        return list(self._by_key.values())

    def get(self, node: str, name: str) -> Process:
        """Raises LabError naming the known processes when there is none of that name."""
        process = self._by_key.get((node, name))
        if process is None:
            known = ", ".join(n for owner, n in self._by_key if owner == node) or "none"
            raise LabError(f"node '{node}' has no process '{name}'; its processes: {known}")
        return process

    def start(self, spec: ProcessSpec) -> Process:
        """Start a program, or start it again.

        Raises:
            LabError: It cannot be executed; the text names argv and the reason.
        """
        process = self._by_key.setdefault((spec.node, spec.name), Process(spec))
        process.state, process.exit_status, process.stopping = State.STARTING, None, False
        with contextlib.ExitStack() as stack:
            output_read, output_write = os.pipe()
            stack.callback(os.close, output_write)
            null = os.open(os.devnull, os.O_RDONLY)
            stack.callback(os.close, null)
            fds: list[int] = [null, output_write, output_write]
            ready_read = -1
            values: dict[str, str] = {}
            if spec.waits_for_ready:
                ready_read, ready_write = os.pipe()
                stack.callback(os.close, ready_write)
                values["{ready_fd}"] = str(len(fds))
                fds.append(ready_write)
            if any("{events_fd}" in argument for argument in spec.argv):
                events_fd = self.open_events(spec)
                if events_fd is None:
                    events_fd = os.open(os.devnull, os.O_WRONLY)
                stack.callback(os.close, events_fd)
                values["{events_fd}"] = str(len(fds))
                fds.append(events_fd)
            if "{command_fd}" in spec.argv:
                process.command, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
                process.command.setblocking(False)
                stack.callback(theirs.close)
                values["{command_fd}"] = str(len(fds))
                fds.append(theirs.fileno())
            env = {**self._base_env, **spec.env}
            if "{ready_fd}" in values:
                env["READY_FD"] = values["{ready_fd}"]
            argv = tuple(values.get(argument, argument) for argument in spec.argv)
            answer = self._spawn(Spawn(0, spec.node, argv, env, self._cwd, tuple(range(len(fds)))), fds)
        self._watch_output(process, output_read)
        if answer.error:
            process.state, process.exit_status = State.EXITED, 127
            process.tail.append(answer.error)
            if ready_read >= 0:
                os.close(ready_read)
            raise LabError(f"{spec.node}: process '{spec.name}' cannot start: {answer.error}; argv: {' '.join(argv)}")
        process.pid = answer.pid
        self._by_pid[answer.pid] = process
        if spec.waits_for_ready:
            self._watch_ready(process, ready_read)
        else:
            self._mark(process, State.READY)
        return process

    def execute(
        self, node: str, argv: tuple[str, ...], env: Mapping[str, str], cwd: str, fds: list[int], *, tty: bool
    ) -> tuple[int, asyncio.Future[int]]:
        """Run a command on a node with the caller's descriptors; returns its pid and its future exit status.

        Raises:
            LabError: It cannot be executed.
        """
        answer = self._spawn(Spawn(0, node, argv, {**self._base_env, **env}, cwd, (0, 1, 2), tty), fds)
        future: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self._exit_waiters[answer.pid] = future
        if answer.error:
            raise LabError(f"{node}: {answer.error}")
        return answer.pid, future

    def stop(self, process: Process, signum: int = signal.SIGTERM) -> None:
        """Signal a process and its group; it is not started again."""
        process.stopping = True
        if process.state is not State.EXITED and process.pid:
            kill_group(process.pid, signum)

    def _spawn(self, request: Spawn, fds: list[int]) -> Spawned:
        token = next(self._tokens)
        self._channel.send(
            Spawn(token, request.node, request.argv, request.env, request.cwd, request.fd_numbers, request.tty), fds
        )
        while True:
            message, _ = self._channel.recv()
            if isinstance(message, Spawned) and message.token == token:
                return message
            # An exit that overtook the answer; handle it once the caller has filed its process.
            asyncio.get_running_loop().call_soon(self._handle, message)

    def _on_channel(self) -> None:
        # _spawn() may have read what woke this callback; a blocking read would then hang the lab.
        if not select.select([self._channel], [], [], 0)[0]:
            return
        try:
            message, _ = self._channel.recv()
        except (EOFError, OSError):
            asyncio.get_running_loop().remove_reader(self._channel.fileno())
            self.on_lost()
            return
        self._handle(message)

    def _handle(self, message: object) -> None:
        if not isinstance(message, Exited):
            return
        waiter = self._exit_waiters.pop(message.pid, None)
        if waiter is not None and not waiter.done():
            waiter.set_result(message.status)
        process = self._by_pid.pop(message.pid, None)
        if process is None:
            return
        process.read_output()  # its last words are in the pipe
        process.exit_status = message.status
        self._mark(process, State.EXITED)
        self.on_exit(process)
        if process.spec.restart is Restart.ALWAYS and not process.stopping:
            process.restarts += 1
            asyncio.get_running_loop().call_later(1.0, self._start_again, process)

    def _start_again(self, process: Process) -> None:
        if not process.stopping and process.state is State.EXITED:
            with contextlib.suppress(LabError):  # the failure is in the process's tail and its log
                self.start(process.spec)

    def _mark(self, process: Process, state: State) -> None:
        process.state = state
        process.changed.set()
        process.changed = asyncio.Event()

    def _watch_ready(self, process: Process, fd: int) -> None:
        loop = asyncio.get_running_loop()
        pid = process.pid

        def readable() -> None:
            data = os.read(fd, 64)
            loop.remove_reader(fd)
            os.close(fd)
            if data and process.pid == pid and process.state is State.STARTING:
                self._mark(process, State.READY)

        loop.add_reader(fd, readable)

    def _watch_output(self, process: Process, fd: int) -> None:
        os.set_blocking(fd, False)
        directory = self._log_dir / process.spec.node
        directory.mkdir(parents=True, exist_ok=True)
        log = (directory / f"{process.spec.name}.log").open("ab", buffering=0)
        pending = bytearray()
        loop = asyncio.get_running_loop()

        def read_some() -> bool:
            try:
                data = os.read(fd, 65536)
            except BlockingIOError:
                return False
            with contextlib.suppress(OSError):  # a full disk must not stop the lab
                log.write(data)
            pending.extend(data)
            *lines, rest = pending.split(b"\n")
            pending[:] = rest
            if not data and rest:
                lines.append(rest)
            for line in lines:
                text = line.decode(errors="replace")
                process.tail.append(text)
                self.on_line(process.spec.node, process.spec.name, text)
            if not data:
                loop.remove_reader(fd)
                os.close(fd)
                log.close()
                process.read_output = lambda: None
            return bool(data)

        def read_all() -> None:
            while read_some():
                pass

        process.read_output = read_all
        loop.add_reader(fd, read_some)


def kill_group(pid: int, signum: int) -> None:
    """Signal a process group (every node process leads one); a group that is gone is fine."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signum)


def feed_pair() -> tuple[int, int]:
    """A stream with roomy buffers between a producer in a node and the recorder: (recorder's end, producer's end)."""
    recorder, producer = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    for end in (recorder, producer):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    return recorder.detach(), producer.detach()
