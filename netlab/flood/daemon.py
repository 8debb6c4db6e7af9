"""The process that is a node's flood: the mesh interface's tap on one side, the members' packet sockets on the other.

``netlab-flood --interface flood0 --wire eth0 --radio radio0``. One thread, one loop. It ends on SIGTERM, or when its
tap is gone. Members may go down and come back. Once a second, where something has changed, and at its end it writes
what it has counted to ``--events-fd``; at its end also to its log.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import json
import os
import random
import select
import signal
import socket
import sys
import time
from collections.abc import Sequence

from netlab.flood.flooder import Count, Flooder, Member, Sending
from netlab.flood.wire import ETHERTYPE
from netlab.kernel import syscalls, tun
from netlab.medium.meshes import FloodOptions

_SO_RCVBUFFORCE = 33
_RECEIVE_BUFFER_BYTES = 4 << 20
_FRAME_BYTES_MAX = 65_536
# Frames taken from one descriptor before the others and the relayed frames get their turn.
_BURST = 32
_REPORT_S = 1.0
# The epoch of each start: the clock in steps of 10 ms, so that it comes again after 11 minutes at the earliest.
_EPOCHS_PER_S, _EPOCHS = 100, 1 << 16
_ENDED_BY_SIGTERM = 128 + signal.SIGTERM


class _Port:
    """A member's packet socket, which stays usable when the interface goes down and comes back."""

    def __init__(self, ifname: str, *, is_radio: bool) -> None:
        self._socket = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
        self._socket.setblocking(False)
        try:  # past the limit that is for those without the right
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER_BYTES)
        except OSError:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        self._socket.bind((ifname, ETHERTYPE))
        mac: bytes = self._socket.getsockname()[4]
        self.member = Member(mac, is_radio)

    def fileno(self) -> int:
        return self._socket.fileno()

    def receive(self) -> bytes | None:
        """The next frame; None when there is none now, also because the interface has just gone down."""
        try:
            return self._socket.recv(_FRAME_BYTES_MAX)
        except OSError:
            return None

    def send(self, frame: bytes) -> Count | None:
        """Send a frame; what to count where that is impossible."""
        try:
            self._socket.send(frame)
        except OSError as error:
            return Count.OVERSIZED if error.errno == errno.EMSGSIZE else Count.NOT_SENT
        return None


class _Daemon:
    def __init__(self, options: argparse.Namespace) -> None:
        self._tap = tun.open_tap(options.interface)
        os.set_blocking(self._tap, False)
        self._ports = [_Port(name, is_radio=False) for name in options.wire]
        self._ports += [_Port(name, is_radio=True) for name in options.radio]
        self._flooder = Flooder(
            _mac(options.interface),
            [port.member for port in self._ports],
            FloodOptions(options.hop_limit, options.jitter),
            epoch=int(time.monotonic() * _EPOCHS_PER_S) % _EPOCHS,
            rng=random.Random(options.seed),
        )
        self._events_fd: int | None = options.events_fd
        self._reported: dict[str, int] = {}
        self._wake, wake_write = socket.socketpair()
        wake_write.setblocking(False)
        self._wake_write = wake_write

    def run(self) -> int:
        """Carry frames until SIGTERM; returns the exit status."""
        signal.signal(signal.SIGTERM, lambda _signum, _frame: None)
        signal.set_wakeup_fd(self._wake_write.fileno())
        waited_for: list[socket.socket | int | _Port] = [self._wake, self._tap, *self._ports]
        report_at_s = time.monotonic() + _REPORT_S
        while True:
            now = time.monotonic()
            if now >= report_at_s:
                self._report()
                report_at_s = now + _REPORT_S
            due_s = self._flooder.next_due()
            until_s = report_at_s if due_s is None else min(due_s, report_at_s)
            readable = select.select(waited_for, [], [], max(0.0, until_s - now))[0]
            if self._wake in readable:
                break
            self._take(readable)
        self._report()
        print(json.dumps(self._flooder.counts))
        return _ENDED_BY_SIGTERM

    def _take(self, readable: Sequence[socket.socket | int | _Port]) -> None:
        """Take a burst from everything that has frames; send what is due in between."""
        for _ in range(_BURST if self._tap in readable else 0):
            inner = self._read_tap()
            if inner is None:
                break
            self._send(self._flooder.originate(inner))
        for place, port in enumerate(self._ports):
            if port in readable:
                self._receive(place, port)
        self._send(self._flooder.due(now=time.monotonic()))

    def _receive(self, place: int, port: _Port) -> None:
        for _ in range(_BURST):
            frame = port.receive()
            if frame is None:
                return
            now = time.monotonic()
            inner = self._flooder.receive(place, frame, now=now)
            self._send(self._flooder.due(now=now))
            if inner is not None:
                with contextlib.suppress(OSError):  # the mesh interface is down
                    os.write(self._tap, inner)

    def _read_tap(self) -> bytes | None:
        try:
            return os.read(self._tap, _FRAME_BYTES_MAX)
        except OSError as error:
            if error.errno == errno.EBADFD:
                raise SystemExit("the mesh interface was deleted; nothing is left to flood for") from None
            return None

    def _send(self, sendings: Sequence[Sending]) -> None:
        for place, frame in sendings:
            problem = self._ports[place].send(frame)
            if problem is not None:
                self._flooder.count(problem)

    def _report(self) -> None:
        counts = self._flooder.counts
        if self._events_fd is None or counts == self._reported:
            return
        self._reported = counts
        line = json.dumps({"t_ns": time.time_ns(), "event": "stats", **counts})
        with contextlib.suppress(OSError):  # nobody records any more
            os.write(self._events_fd, line.encode() + b"\n")


def _mac(ifname: str) -> bytes:
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as sock:
        sock.bind((ifname, 0))
        mac: bytes = sock.getsockname()[4]
        return mac


def _arguments(argv: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="netlab-flood", description="Flood every frame over all members.")
    parser.add_argument("--interface", required=True, help="the mesh interface, a tap; made if it is not there")
    parser.add_argument("--wire", action="append", default=[], help="a member that joins two nodes")
    parser.add_argument("--radio", action="append", default=[], help="a member that several nodes hear")
    parser.add_argument("--hop-limit", type=int, default=FloodOptions().hop_limit)
    parser.add_argument("--jitter", type=float, default=FloodOptions().jitter_s, help="seconds")
    parser.add_argument("--seed", default="", help="of the jitter")
    parser.add_argument("--ready-fd", type=int)
    parser.add_argument("--events-fd", type=int)
    return parser.parse_args(argv)


def main(argv: list[str]) -> int:
    """Flood in the calling process's network namespace until SIGTERM; returns the exit status."""
    options = _arguments(argv)
    syscalls.set_timerslack_ns(1)
    with contextlib.suppress(OSError):  # it stands for a part of the kernel
        os.setpriority(os.PRIO_PROCESS, 0, -20)
    try:
        daemon = _Daemon(options)
    except OSError as error:
        print(f"netlab-flood: {options.interface}: {error}", file=sys.stderr)
        return 1
    if options.ready_fd is not None:
        os.write(options.ready_fd, b"ready\n")
        os.close(options.ready_fd)
    return daemon.run()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
