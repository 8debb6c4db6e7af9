"""Byte streams from the lab's processes, cut into messages: JSON lines, packed verdicts, text lines.

A feed never raises on what it reads: lines that make no sense are counted and left out.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import select
import time
from typing import Protocol

from netlab.capture.messages import AddFeed, FeedKind
from netlab.capture.schemas import LogLevel, encode_attempts, encode_log, encode_verdict, encode_verdict_ends
from netlab.capture.topics import Topics
from netlab.medium.verdicts import VERDICT_RECORD

_READ_BYTES = 256 * 1024
_MAX_LINE_BYTES = 1024 * 1024
_MESH_PROCESS = "wnet"
_PRESENCE = ("peer_up", "peer_down")  # events that a state is made of


class Feed(Protocol):
    """One stream. The recorder reads it when it is readable and closes it at its end."""

    dropped: int

    def fileno(self) -> int:
        """The descriptor to wait for."""

    def drain(self) -> bool:
        """Record what is there; False at the end of the stream."""

    def close(self) -> None:
        """Record what is left over and close the descriptor."""


def make_feed(request: AddFeed, fd: int, topics: Topics, ports: list[tuple[str, str]]) -> Feed:
    """Build the feed that a request asks for. It owns ``fd`` from now on."""
    os.set_blocking(fd, False)
    if request.kind is FeedKind.VERDICTS:
        return VerdictFeed(fd, topics, ports)
    if request.kind is FeedKind.LOG:
        return LogFeed(fd, topics, request)
    return EventFeed(fd, topics, request)


class _Stream:
    """Non-blocking reads with what was left over from the last one."""

    def __init__(self, fd: int) -> None:
        self.dropped = 0
        self._fd = fd
        self._rest = b""

    def fileno(self) -> int:
        return self._fd

    def drain(self) -> bool:
        try:
            data = os.read(self._fd, _READ_BYTES)
        except BlockingIOError:
            return True
        except OSError:  # the producer's end was reset: the same as its end
            return False
        if not data:
            return False
        self._rest = self._take(self._rest + data)
        return True

    def close(self) -> None:
        while self.drain() and self._readable():
            pass
        self._finish()
        with contextlib.suppress(OSError):
            os.close(self._fd)

    def _readable(self) -> bool:
        return bool(select.select([self._fd], [], [], 0)[0])

    def _take(self, data: bytes) -> bytes:
        raise NotImplementedError

    def _finish(self) -> None:
        raise NotImplementedError


class _Lines(_Stream):
    """Cuts at newlines; a last line without one counts when the stream ends."""

    def __init__(self, fd: int, topics: Topics, request: AddFeed) -> None:
        super().__init__(fd)
        self._topics = topics
        self._request = request

    def _take(self, data: bytes) -> bytes:
        *lines, rest = data.split(b"\n")
        now_ns = time.time_ns()
        for line in lines:
            if line.strip():
                self._line(line, now_ns)
        if len(rest) > _MAX_LINE_BYTES:
            self.dropped += 1
            return b""
        return rest

    def _finish(self) -> None:
        if self._rest.strip():
            self._line(self._rest, time.time_ns())
        self._rest = b""

    def _line(self, line: bytes, now_ns: int) -> None:
        raise NotImplementedError


class EventFeed(_Lines):
    """JSON objects, one per line, each with its own ``t_ns``; without one the time of reading is taken."""

    def __init__(self, fd: int, topics: Topics, request: AddFeed) -> None:
        super().__init__(fd, topics, request)
        self._mesh_node = topics.mesh.begin(request.node) if request.process == _MESH_PROCESS else None

    def close(self) -> None:
        super().close()
        if self._mesh_node is not None:
            self._topics.mesh.end(self._mesh_node)

    def _line(self, line: bytes, now_ns: int) -> None:
        try:
            record = json.loads(line)
        except (ValueError, RecursionError):
            record = None
        if not isinstance(record, dict):
            self.dropped += 1
            return
        request = self._request
        t_ns = record.get("t_ns")
        if not isinstance(t_ns, int) or not 0 <= t_ns < 1 << 63:
            record["t_ns"] = t_ns = now_ns
            line = json.dumps(record).encode()
        channel = self._topics.json(request.topic, {"node": request.node, "process": request.process})
        self._topics.writer.add_message(channel, t_ns, t_ns, line)
        if self._mesh_node is not None:
            self._topics.mesh.take(self._mesh_node, record)
        if record.get("event") in _PRESENCE:
            self._topics.writer.keep(channel, str(record.get("peer")), t_ns, line)


_LEVEL = re.compile(r"\b(DEBUG|INFO|WARN|WARNING|ERROR|CRITICAL|FATAL)\b", re.IGNORECASE)
_LEVELS = {
    "DEBUG": LogLevel.DEBUG,
    "INFO": LogLevel.INFO,
    "WARN": LogLevel.WARNING,
    "WARNING": LogLevel.WARNING,
    "ERROR": LogLevel.ERROR,
    "CRITICAL": LogLevel.FATAL,
    "FATAL": LogLevel.FATAL,
}
_LEVEL_WITHIN = 64  # a level stands near the start of a line; further on it is prose


def log_level(text: str) -> LogLevel:
    """Guess a line's level from the level word near its start; INFO without one."""
    match = _LEVEL.search(text[:_LEVEL_WITHIN])
    return _LEVELS[match[1].upper()] if match else LogLevel.INFO


class LogFeed(_Lines):
    """Output of a process, stamped when read."""

    def _line(self, line: bytes, now_ns: int) -> None:
        text = line.decode(errors="backslashreplace").rstrip("\r")
        data = encode_log(now_ns, log_level(text), self._request.process, text)
        channel = self._topics.log(self._request.topic, self._request.node, self._request.process)
        self._topics.writer.add_message(channel, now_ns, now_ns, data)


class VerdictFeed(_Stream):
    """Packed ``VERDICT_RECORD``s of the processes that carry frames; port numbers become names."""

    def __init__(self, fd: int, topics: Topics, ports: list[tuple[str, str]]) -> None:
        super().__init__(fd)
        self._topics = topics
        self._ports = ports
        self._ends: dict[tuple[int, int], bytes] = {}

    def _take(self, data: bytes) -> bytes:
        whole = len(data) - len(data) % VERDICT_RECORD.size
        add, channel, ends = self._topics.writer.add_message, self._topics.verdicts(), self._ends
        for record in VERDICT_RECORD.iter_unpack(memoryview(data)[:whole]):
            arrived_ns, departs_ns, crc32, length, sender, receiver, verdict, attempts, rssi_dbm = record
            pair = ends.get((sender, receiver)) or self._learn(sender, receiver)
            body = encode_verdict(pair, verdict, departs_ns, length, crc32)
            add(channel, arrived_ns, arrived_ns, body + encode_attempts(attempts, rssi_dbm) if attempts else body)
        return data[whole:]

    def _finish(self) -> None:
        self.dropped += bool(self._rest)
        self._rest = b""

    def _learn(self, sender: int, receiver: int) -> bytes:
        pair = self._ends[sender, receiver] = encode_verdict_ends(self._name(sender), self._name(receiver))
        return pair

    def _name(self, port: int) -> tuple[str, str]:
        return self._ports[port] if port < len(self._ports) else ("", f"port{port}")
