"""Who looks on while the recorder records: each gets the capture's records over a socket, and never holds it up.

What goes over the socket is a stream of MCAP records (schema, channel, message, metadata) without file head and tail.
A channel is declared before its first message. An onlooker that reads too slowly loses its oldest messages; how many
it has lost so far stands in a metadata record ``netlab.lost`` in front of the next one that it gets.
Source of the record layout: https://mcap.dev/spec.
"""

from __future__ import annotations

import select
import selectors
import socket
import struct
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from mcap.records import Channel, Metadata
from mcap.records import Schema as SchemaRecord

from netlab.capture.record_file import record_bytes
from netlab.capture.records import Kind, kind_of
from netlab.capture.schemas import Schema

LOST_NAME = "netlab.lost"
_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE_FIXED = _MESSAGE.size - 9  # what the record's length counts beside the data
_MESSAGE_OPCODE = 5
_WAITING_BYTES = 8 * 1024 * 1024
_SEND_BYTES = 256 * 1024
_BY_WISH = (Kind.PACKET, Kind.VERDICT)


@dataclass(frozen=True, slots=True)
class Declaration:
    """One channel: its number, topic, schema and metadata."""

    number: int
    topic: str
    schema: Schema
    metadata: Mapping[str, str]


class Onlooker:
    """One socket with what waits for it."""

    def __init__(self, sock: socket.socket, *, packets: bool, waiting_bytes: int = _WAITING_BYTES) -> None:
        """``packets``: with the packets and the medium's verdicts; else only what is said of nodes and messages."""
        sock.setblocking(False)
        self._sock = sock
        self._packets = packets
        self._most_bytes = waiting_bytes
        self._waiting: deque[tuple[int, bytes]] = deque()  # channel, message record
        self._waiting_bytes = 0
        self._front = bytearray()  # records that are on their way
        self._schemas: dict[str, int] = {}
        self._declared: set[int] = set()
        self._told_lost = 0
        self.lost = 0

    def fileno(self) -> int:
        """The socket."""
        return self._sock.fileno()

    @property
    def is_waiting(self) -> bool:
        """Whether anything has not been sent yet."""
        return bool(self._front or self._waiting)

    def wants(self, topic: str) -> bool:
        """Whether messages of a topic are for it."""
        return self._packets or kind_of(topic) not in _BY_WISH

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Send a metadata record before all messages that wait; never lost."""
        self._front += record_bytes(Metadata(name=name, metadata=dict(values)))

    def message(self, channel: int, log_ns: int, data: bytes) -> None:
        """Queue a message; the oldest go when too much waits."""
        record = _MESSAGE.pack(_MESSAGE_OPCODE, _MESSAGE_FIXED + len(data), channel, 0, log_ns, log_ns) + data
        self._waiting.append((channel, record))
        self._waiting_bytes += len(record)
        while self._waiting_bytes > self._most_bytes and len(self._waiting) > 1:
            self._waiting_bytes -= len(self._waiting.popleft()[1])
            self.lost += 1

    def send(self, channels: list[Declaration]) -> bool:
        """Send what the socket takes; False when nobody reads any more. ``channels[i]`` declares number i + 1."""
        while self.is_waiting:
            self._fill(channels)
            try:
                sent = self._sock.send(self._front)
            except BlockingIOError:
                return True
            except OSError:
                return False
            del self._front[:sent]
        return True

    def hears_end(self) -> bool:
        """Whether the other end is closed; what it says otherwise is of no interest."""
        try:
            return not self._sock.recv(1024)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        """Hang up."""
        self._sock.close()

    def _fill(self, channels: list[Declaration]) -> None:
        if self._told_lost != self.lost and len(self._front) < _SEND_BYTES:
            self._told_lost = self.lost
            self.metadata(LOST_NAME, {"count": str(self.lost)})
        while self._waiting and len(self._front) < _SEND_BYTES:
            channel, record = self._waiting.popleft()
            self._waiting_bytes -= len(record)
            if channel not in self._declared:
                self._declare(channels[channel - 1])
            self._front += record

    def _declare(self, channel: Declaration) -> None:
        schema = channel.schema
        number = self._schemas.get(schema.name)
        if number is None:
            number = self._schemas[schema.name] = len(self._schemas) + 1
            self._front += record_bytes(
                SchemaRecord(id=number, name=schema.name, encoding=schema.encoding, data=schema.data)
            )
        record = Channel(
            id=channel.number,
            topic=channel.topic,
            message_encoding=schema.message_encoding,
            schema_id=number,
            metadata=dict(channel.metadata),
        )
        self._front += record_bytes(record)
        self._declared.add(channel.number)


class Onlookers:
    """All onlookers of one recorder, served by its selector."""

    def __init__(self, selector: selectors.BaseSelector) -> None:
        self._selector = selector
        self._all: list[Onlooker] = []
        self._of_channel: list[list[Onlooker]] = []
        self._channels: list[Declaration] = []

    def __bool__(self) -> bool:
        return bool(self._all)

    def declare(self, channel: Declaration) -> None:
        """Make the next channel known."""
        self._channels.append(channel)
        self._of_channel.append([onlooker for onlooker in self._all if onlooker.wants(channel.topic)])

    def join(self, onlooker: Onlooker, first: Iterable[tuple[int, int, bytes]]) -> None:
        """Take an onlooker in; it begins with the messages ``first``: (channel, log time, data)."""
        self._all.append(onlooker)
        self._regroup()
        for channel, log_ns, data in first:
            onlooker.message(channel, log_ns, data)
        self._selector.register(onlooker, selectors.EVENT_READ, lambda: self._listen(onlooker))
        self._serve(onlooker)

    def message(self, channel: int, log_ns: int, data: bytes) -> None:
        """Pass a message on."""
        for onlooker in self._of_channel[channel - 1]:
            onlooker.message(channel, log_ns, data)

    def metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Pass metadata on."""
        for onlooker in self._all:
            onlooker.metadata(name, values)

    def send(self) -> None:
        """Send what waits, as far as the sockets take it; the selector goes on with the rest."""
        for onlooker in tuple(self._all):
            self._serve(onlooker)

    def close(self, *, within_s: float) -> None:
        """Send what is left to those that read, then hang up; a slow one gets ``within_s`` seconds."""
        for onlooker in tuple(self._all):
            deadline = time.monotonic() + within_s
            while onlooker.send(self._channels) and onlooker.is_waiting and (left_s := deadline - time.monotonic()) > 0:
                select.select([], [onlooker], [], left_s)
            self._drop(onlooker)

    def _listen(self, onlooker: Onlooker) -> None:
        if onlooker.hears_end():
            self._drop(onlooker)
        else:
            self._serve(onlooker)

    def _serve(self, onlooker: Onlooker) -> None:
        if not onlooker.is_waiting and self._selector.get_key(onlooker).events == selectors.EVENT_READ:
            return
        if not onlooker.send(self._channels):
            self._drop(onlooker)
            return
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if onlooker.is_waiting else 0)
        key = self._selector.get_key(onlooker)
        if key.events != events:
            self._selector.modify(onlooker, events, key.data)

    def _drop(self, onlooker: Onlooker) -> None:
        if onlooker in self._all:
            self._selector.unregister(onlooker)
            self._all.remove(onlooker)
            onlooker.close()
            self._regroup()

    def _regroup(self) -> None:
        self._of_channel = [[one for one in self._all if one.wants(channel.topic)] for channel in self._channels]
