"""The recorder's process: one loop over the supervisor's channel, the nodes' packet rings and the feeds.

Started as ``python -m netlab.capture.recorder --channel-fd N`` or by :func:`main` from a process that imported it
already. Ends on ``Close``, on SIGTERM and when the supervisor is gone; in each case the file is finished properly.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import selectors
import signal
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from types import FrameType

from netlab.capture.feeds import Feed, make_feed
from netlab.capture.messages import (
    AddFeed,
    AddInterfaces,
    Close,
    CloseFile,
    Done,
    Message,
    Notice,
    Open,
    OpenFile,
    RecorderStats,
    SetMetadata,
    Subscribe,
    Sync,
)
from netlab.capture.onlookers import Onlooker, Onlookers
from netlab.capture.outlets import Outlets
from netlab.capture.ring import RingSize, ring_size
from netlab.capture.sniffer import Sniffer
from netlab.capture.topics import Topics
from netlab.ipc import Channel

METADATA_NAME = "netlab.run"
LOSSES_NAME = "netlab.losses"
_FLUSH_EVERY_S = 1.0
_TELL_WITHIN_S = 0.2
_LAST_SEND_S = 0.5  # for onlookers that do not read
_LAST_FEED_WAIT_S = 0.05  # producers end before Close; this is for what is still in their sockets


class Recorder:
    """All that the process holds. ``run`` returns when it is time to end."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._selector = selectors.DefaultSelector()
        self._selector.register(channel, selectors.EVENT_READ, self._control)
        self._onlookers = Onlookers(self._selector)
        self._outlets = Outlets(self._onlookers)
        self._topics: Topics | None = None
        self._metadata: dict[str, str] = {}
        self._ports: list[tuple[str, str]] = []
        self._ring_size: RingSize = ring_size(2)
        self._sniffers: list[Sniffer] = []
        self._feeds: list[Feed] = []
        self._dropped_lines = 0
        self._errors: list[str] = []
        self._told_drops: set[str] = set()
        self._told_error = False
        self._ending = False
        self._answer_close = False

    def run(self) -> None:
        """Record until told to end, then finish the file."""
        next_flush = time.monotonic() + _FLUSH_EVERY_S
        while not self._ending:
            for key, _ in self._selector.select(min(max(next_flush - time.monotonic(), 0), _TELL_WITHIN_S)):
                key.data()
            self._onlookers.send()
            self._tell_error()
            if (now := time.monotonic()) >= next_flush:
                self._every_second()
                next_flush = now + _FLUSH_EVERY_S
        stats = self._finish()
        if self._answer_close:
            self._send(stats)

    def end(self) -> None:
        """Finish at the next turn of the loop."""
        self._ending = True

    def wake_on(self, sock: socket.socket) -> None:
        """Turn the loop when a signal handler wrote to the other end of ``sock``."""
        self._selector.register(sock, selectors.EVENT_READ, lambda: sock.recv(64))

    def _control(self) -> None:
        try:
            message, fds = self._channel.recv()
        except (EOFError, OSError):  # the supervisor is gone: what it ran is gone too
            self._ending = True
            return
        try:
            self._handle(message, fds)
        except OSError as error:
            self._errors.append(f"{type(message).__name__}: {error}")

    def _handle(self, message: object, fds: list[int]) -> None:
        match message:
            case Open():
                self._open(message)
                self._answer()
            case AddInterfaces():
                self._add_sniffer(message, fds)
            case AddFeed():
                self._add_feed(message, fds[0])
            case Message() if self._topics:
                self._topics.add_json(message.topic, message.payload, message.t_ns)
            case SetMetadata() if self._topics:
                self._metadata |= message.values
                self._outlets.add_metadata(METADATA_NAME, self._metadata)
                if "t0_ns" in message.values:
                    self._topics.t0_ns = int(message.values["t0_ns"])
            case Subscribe() if self._topics:
                self._outlets.join(Onlooker(socket.socket(fileno=fds[0]), packets=message.packets))
            case OpenFile() if self._topics:
                self._outlets.close()
                self._open_file(message.path)
                self._answer()
            case CloseFile():
                self._outlets.close()
                self._answer()
            case Sync():
                self._answer()
            case Close():
                self._answer_close = self._ending = True
            case _:
                self._errors.append(f"{type(message).__name__} before the file was opened")

    def _open(self, request: Open) -> None:
        self._metadata = dict(request.metadata)
        self._outlets.add_metadata(METADATA_NAME, self._metadata)
        for name, data in request.attachments.items():
            self._outlets.add_attachment(name, data)
        if not self._open_file(request.path):
            return
        self._topics = Topics(self._outlets)
        self._ports = [(port["node"], port["interface"]) for port in json.loads(self._metadata.get("ports", "[]"))]
        self._ring_size = ring_size(request.nodes)

    def _open_file(self, path: str) -> bool:
        try:
            self._outlets.open(Path(path))
        except OSError as error:
            self._errors.append(f"{path}: {error.strerror}")
            return False
        self._told_error = False
        return True

    def _add_sniffer(self, request: AddInterfaces, fds: list[int]) -> None:
        try:
            if self._topics is None:
                self._errors.append(f"interfaces of {request.node} before the file was opened")
                return
            sniffer = Sniffer(request.node, fds[0], request.interfaces, self._topics, self._ring_size)
        except OSError as error:
            self._errors.append(f"cannot sniff at {request.node}: {error}")
            return
        finally:
            for fd in fds:  # the ring's socket keeps the namespace
                os.close(fd)
        self._sniffers.append(sniffer)
        self._selector.register(sniffer, selectors.EVENT_READ, sniffer.drain)

    def _add_feed(self, request: AddFeed, fd: int) -> None:
        if self._topics is None:
            os.close(fd)
            self._errors.append(f"feed {request.topic} before the file was opened")
            return
        feed = make_feed(request, fd, self._topics, self._ports)
        self._feeds.append(feed)
        self._selector.register(feed, selectors.EVENT_READ, lambda: self._drain_feed(feed))

    def _drain_feed(self, feed: Feed) -> None:
        if not feed.drain():
            self._selector.unregister(feed)
            self._feeds.remove(feed)
            feed.close()
            self._dropped_lines += feed.dropped

    def _tell_error(self) -> None:
        """The background thread may fail at any time; a person hears of it once."""
        writer = self._outlets.writer
        if writer and writer.error and not self._told_error:
            self._told_error = True
            self._send(Notice(writer.error))

    def _every_second(self) -> None:
        if self._topics is not None:
            self._topics.draw(time.time_ns())
        if self._outlets.writer is not None:
            self._outlets.writer.flush()
        for sniffer in self._sniffers:
            if sniffer.count_drops() and sniffer.node not in self._told_drops:
                self._told_drops.add(sniffer.node)
                self._send(Notice(f"the capture missed packets at {sniffer.node}: this machine is too slow for them"))

    def _finish(self) -> RecorderStats:
        self._drain_rings()
        deadline = time.monotonic() + _LAST_FEED_WAIT_S
        while self._feeds and select.select(self._feeds, [], [], max(deadline - time.monotonic(), 0))[0]:
            for feed in select.select(self._feeds, [], [], 0)[0]:
                self._drain_feed(feed)
        for feed in self._feeds:
            feed.close()
            self._dropped_lines += feed.dropped
        if self._topics is not None:
            self._outlets.add_metadata(LOSSES_NAME, self._losses())
        self._outlets.close()
        self._onlookers.close(within_s=_LAST_SEND_S)
        return self._stats()

    def _drain_rings(self) -> None:
        """Packets of the last moments sit in blocks that the kernel hands over only when they are old enough."""
        if not self._sniffers:
            return
        deadline = time.monotonic() + 2 * self._sniffers[0].retire_s
        poll = select.poll()
        by_fd = {sniffer.fileno(): sniffer for sniffer in self._sniffers}
        for fd in by_fd:
            poll.register(fd, select.POLLIN)
        while (left := deadline - time.monotonic()) > 0:
            for fd, _ in poll.poll(left * 1000):
                by_fd[fd].drain()
        for sniffer in self._sniffers:
            sniffer.close()

    def _losses(self) -> dict[str, str]:
        """What the file lacks, by topic, so that it tells so itself."""
        packets = {f"/{sniffer.node}/*/packets": str(sniffer.drops) for sniffer in self._sniffers if sniffer.drops}
        return {**packets, "lines of feeds": str(self._dropped_lines)}

    def _stats(self) -> RecorderStats:
        files = self._outlets.files
        return RecorderStats(
            messages=sum(file.messages_written for file in files),
            packets=sum(sniffer.packets for sniffer in self._sniffers),
            kernel_drops={sniffer.node: sniffer.drops for sniffer in self._sniffers if sniffer.drops},
            write_errors=tuple(file.error for file in files if file.error),
            messages_lost=sum(file.messages_lost for file in files),
            feed_lines_dropped=self._dropped_lines,
        )

    def _answer(self) -> None:
        errors, self._errors = tuple(self._errors), []
        self._send(Done(errors))

    def _send(self, message: object) -> None:
        with contextlib.suppress(OSError):  # nobody there to listen: the file matters more
            self._channel.send(message)


def main(argv: Sequence[str] | None = None) -> int:
    """Run the process; returns its exit code."""
    parser = argparse.ArgumentParser(prog="netlab.capture.recorder")
    parser.add_argument("--channel-fd", type=int, required=True)
    recorder = Recorder(Channel.from_fd(parser.parse_args(argv).channel_fd))
    wake, wakened = socket.socketpair()
    wake.setblocking(False)
    recorder.wake_on(wakened)

    def on_sigterm(_number: int, _frame: FrameType | None) -> None:
        recorder.end()

    signal.signal(signal.SIGTERM, on_sigterm)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the supervisor decides
    signal.set_wakeup_fd(wake.fileno())
    recorder.run()
    return 0


if __name__ == "__main__":
    sys.exit(main())
