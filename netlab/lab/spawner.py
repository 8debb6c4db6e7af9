"""The fork server: starts every process that runs in a node.

It imports the built-in programs once, stays single-threaded and small, and forks: a child enters its node's namespaces
and then either executes an argv list or calls a built-in program's ``main`` (a process of its own all the same, without
paying for the interpreter's start again). Exits go back to the supervisor. It knows nothing of scenarios.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import gc
import importlib
import os
import selectors
import signal
import socket
import sys
import termios
import traceback
from dataclasses import dataclass, field

from netlab.ipc import Channel
from netlab.kernel import syscalls
from netlab.lab.isolation import enter_new_node
from netlab.lab.spawn_messages import AddNode, Exited, Spawn, Spawned
from netlab.lab.usage import usage_at_end

#: Programs that are called in the forked child instead of executed; the key stands as argv[0].
BUILTIN_PROGRAMS = {
    "udp-mesh-daemon": "udp_mesh.daemon:main",
    "netlab-flood": "netlab.flood.daemon:main",
    "wnet-daemon": "wnet.daemon:main",
    "netlab-traffic-source": "netlab.lab.traffic:source_main",
    "netlab-traffic-sink": "netlab.lab.traffic:sink_main",
}


@dataclass(slots=True)
class _Node:
    net_fd: int
    hosts: str
    keep: tuple[str, ...]
    namespace_fds: list[int] = field(default_factory=list)


def main(argv: list[str]) -> int:
    """Run until the supervisor closes the channel."""
    parser = argparse.ArgumentParser(prog="netlab-spawner")
    parser.add_argument("--channel-fd", type=int, required=True)
    return _Spawner(Channel.from_fd(parser.parse_args(argv).channel_fd)).run()


class _Spawner:
    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._nodes: dict[str, _Node] = {}
        self._wake, wake_write = socket.socketpair()
        self._wake.setblocking(False)
        wake_write.setblocking(False)
        self._wake_write = wake_write

    def run(self) -> int:
        for target in BUILTIN_PROGRAMS.values():
            importlib.import_module(target.partition(":")[0])
        gc.collect()
        gc.freeze()  # children share these pages; the collector must not touch them
        signal.signal(signal.SIGCHLD, lambda _signum, _frame: None)
        signal.set_wakeup_fd(self._wake_write.fileno())
        selector = selectors.DefaultSelector()
        selector.register(self._channel, selectors.EVENT_READ)
        selector.register(self._wake, selectors.EVENT_READ)
        while True:
            for key, _events in selector.select():
                if key.fileobj is self._wake:
                    self._reap()
                elif not self._serve():
                    return 0

    def _serve(self) -> bool:
        try:
            message, fds = self._channel.recv()
        except (EOFError, OSError):
            return False
        match message:
            case AddNode(node, hosts, keep):
                self._nodes[node] = _Node(fds[0], hosts, keep)
            case Spawn():
                self._channel.send(self._spawn(message, fds))
                for fd in fds:
                    os.close(fd)
            case _:
                raise TypeError(f"not a request to the fork server: {message!r}")
        return True

    def _reap(self) -> None:
        with contextlib.suppress(BlockingIOError):
            self._wake.recv(4096)
        while True:
            try:
                pid, status, used = os.wait4(-1, os.WNOHANG)
            except ChildProcessError:
                return
            if pid == 0:
                return
            self._channel.send(Exited(pid, os.waitstatus_to_exitcode(status), usage_at_end(used)))

    def _spawn(self, request: Spawn, fds: list[int]) -> Spawned:
        node = self._nodes[request.node]
        try:
            if not node.namespace_fds:
                node.namespace_fds = _furnish(request.node, node)
        except OSError as error:
            return Spawned(request.token, 0, f"the node's namespaces could not be made: {error}")
        error_read, error_write = os.pipe()  # close-on-exec: end of file means the program runs
        pid = os.fork()
        if pid == 0:
            _become(request, node, fds, error_write)
        os.close(error_write)
        with os.fdopen(error_read, "rb") as pipe:
            complaint = pipe.read().decode(errors="replace")
        return Spawned(request.token, pid, complaint or None)


def _furnish(name: str, node: _Node) -> list[int]:
    """Make the node's mount, IPC and UTS namespaces in a short-lived child and keep them by descriptor."""
    parent, child = socket.socketpair()
    pid = os.fork()
    if pid == 0:
        report = b"ok"
        try:
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            syscalls.setns(node.net_fd, syscalls.CLONE_NEWNET)  # /sys must show this node's interfaces
            enter_new_node(name, node.hosts, node.keep)
        except OSError as error:
            report = str(error).encode()
        child.sendall(report)
        child.recv(1)  # until the parent holds the namespaces
        os._exit(0)
    try:
        report = parent.recv(4096)
        if report != b"ok":
            raise OSError(report.decode(errors="replace"))
        return [os.open(f"/proc/{pid}/ns/{kind}", os.O_RDONLY | os.O_CLOEXEC) for kind in ("mnt", "ipc", "uts")]
    finally:
        parent.sendall(b".")
        parent.close()
        child.close()
        with contextlib.suppress(ChildProcessError):
            os.waitpid(pid, 0)


def _become(request: Spawn, node: _Node, fds: list[int], error_write: int) -> None:
    """In the forked child: enter the node and turn into the requested program. Never returns."""
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.setsid()
        syscalls.setns(node.net_fd, syscalls.CLONE_NEWNET)
        for fd in node.namespace_fds:
            syscalls.setns(fd, 0)
        error_write = _arrange_descriptors(fds, request.fd_numbers, error_write)
        if request.tty:
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
        _enter_directory(request.cwd)
        program = BUILTIN_PROGRAMS.get(request.argv[0])
        if program is None:
            os.execvpe(request.argv[0], request.argv, dict(request.env))
        os.close(error_write)
    except OSError as error:
        os.write(error_write, f"{request.argv[0]}: {error.strerror or error}".encode())
        os._exit(127)
    os._exit(_call(program, request))


def _enter_directory(path: str) -> None:
    """A directory below a private one (/tmp, /run) is not there in a node; the command then starts in /."""
    try:
        os.chdir(path)
    except OSError:
        os.chdir("/")


def _arrange_descriptors(fds: list[int], numbers: tuple[int, ...], error_write: int) -> int:
    """Put ``fds[i]`` at ``numbers[i]``, close everything else except the error pipe, whose new number is returned."""
    top = max(numbers, default=2) + 1
    spare = [os.dup(fd) for fd in fds]  # out of each other's way
    low = [fd for fd in spare if fd < top + len(spare)]
    moved = {fd: _dup_above(fd, top + len(spare)) for fd in low}
    for fd, number in zip(spare, numbers, strict=True):
        os.dup2(moved.get(fd, fd), number, inheritable=True)
    kept_error = _dup_above(error_write, top)
    os.closerange(top, kept_error)
    os.closerange(kept_error + 1, 65536)
    for number in set(range(3, top)) - set(numbers):
        with contextlib.suppress(OSError):
            os.close(number)
    return kept_error


def _dup_above(fd: int, lowest: int) -> int:
    return fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, lowest)


def _call(program: str, request: Spawn) -> int:
    module, _, name = program.partition(":")
    os.environ.clear()
    os.environ.update(request.env)
    sys.argv = list(request.argv)
    code = 1
    try:
        # The parent's text streams may hold its buffers; open fresh ones on the new descriptors.
        sys.stdin, sys.stdout, sys.stderr = open(0), open(1, "w", buffering=1), open(2, "w", buffering=1)  # noqa: SIM115
        code = getattr(importlib.import_module(module), name)(list(request.argv[1:]))
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 1 if stop.code else 0
    except KeyboardInterrupt:
        code = 130
    except BaseException:
        traceback.print_exc()
    finally:
        with contextlib.suppress(OSError, ValueError):
            sys.stdout.flush()
            sys.stderr.flush()
    return code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
