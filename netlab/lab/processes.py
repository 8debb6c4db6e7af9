"""The processes that run in the nodes, as the supervisor sees them: start, readiness, exit, restart.

All methods run on the supervisor's event loop; the fork server answers in microseconds, so talking to it blocks.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import os
import select
import signal
from collections.abc import Callable, Mapping
from pathlib import Path

from netlab.errors import LabError
from netlab.ipc import Channel
from netlab.lab.descriptors import ChildDescriptors, FeedOpener
from netlab.lab.output import LineSink, watch_output
from netlab.lab.process import Process, ProcessSpec, Restart, State
from netlab.lab.spawn_messages import AddNode, Exited, Spawn, Spawned


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
        with ChildDescriptors(spec, self.open_events) as child:
            env = {**self._base_env, **spec.env, **child.env}
            numbers = tuple(range(len(child.fds)))
            answer = self._spawn(Spawn(0, spec.node, child.argv, env, self._cwd, numbers), child.fds)
        process.command = child.command
        watch_output(process, child.output, self._log_dir, self.on_line)
        if answer.error:
            process.state, process.exit_status = State.EXITED, 127
            process.tail.append(answer.error)
            if child.ready is not None:
                os.close(child.ready)
            argv = " ".join(child.argv)
            raise LabError(f"{spec.node}: process '{spec.name}' cannot start: {answer.error}; argv: {argv}")
        process.pid = answer.pid
        self._by_pid[answer.pid] = process
        if child.ready is not None:
            self._watch_ready(process, child.ready)
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
        process.used_before = process.used_before.then(message.used)
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


def kill_group(pid: int, signum: int) -> None:
    """Signal a process group (every node process leads one); a group that is gone is fine."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signum)
