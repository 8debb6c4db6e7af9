"""What a running lab records, as it is recorded: the onlooker's end of :mod:`netlab.capture.onlookers`.

with Lab("topologies/pair.yaml", capture="pair.mcap") as lab, lab.feed() as feed:
    lab.begin()
    for record in feed:
        ...

A feed begins with what is static: metadata, map, links, poses, who is online, all acts so far. It ends when the lab's
recorder does. It never holds the lab up: who reads too slowly loses the oldest messages, counted in ``Feed.lost``.
"""

from __future__ import annotations

import io
import select
import socket
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType

from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from netlab.capture.decoding import Decoder, decoder_for
from netlab.capture.onlookers import LOST_NAME
from netlab.capture.reader import METADATA_NAME
from netlab.capture.records import Record
from netlab.capture.scan import records_in
from netlab.lab import registry
from netlab.lab.control import ControlClient

_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_READ_BYTES = 256 * 1024


@dataclass(frozen=True, slots=True)
class FeedMessage:
    """One message as it stands in the capture: bytes, with the channel and schema that say what they mean."""

    channel: Channel
    schema: Schema
    log_ns: int
    data: bytes

    @property
    def topic(self) -> str:
        """The channel's topic."""
        return self.channel.topic


class Feed:
    """An open feed; a context manager. Iterate over it for decoded records, or over :meth:`messages` for bytes.

    Attributes:
        metadata: The record ``netlab.run``, as known by now (``t0_ns`` is added when the scenario begins).
        lost: How many messages were lost because this end was too slow.
        ended: Whether the lab's recorder has ended.
    """

    def __init__(self, sock: socket.socket) -> None:
        """Take over a connected stream socket."""
        self.metadata: dict[str, str] = {}
        self.lost = 0
        self.ended = False
        self._sock = sock
        self._sock.setblocking(False)
        self._rest = b""
        self._channels: dict[int, Channel] = {}
        self._schemas: dict[int, Schema] = {}
        self._decoders: dict[int, Decoder | None] = {}

    def __enter__(self) -> Feed:
        """Return itself."""
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Hang up."""
        self.close()

    def __iter__(self) -> Iterator[Record]:
        """Yield decoded records until the lab's recorder ends; waits for them."""
        for message in self.messages():
            if (record := self.decode(message)) is not None:
                yield record

    def fileno(self) -> int:
        """The socket, for a selector."""
        return self._sock.fileno()

    def messages(self) -> Iterator[FeedMessage]:
        """Yield messages until the lab's recorder ends; waits for them."""
        while not self.ended:
            yield from self.receive(timeout_s=None)

    def receive(self, *, timeout_s: float | None = 0.0) -> list[FeedMessage]:
        """The messages that are there, after waiting for some at most ``timeout_s`` (None: as long as it takes)."""
        if self.ended or not select.select([self._sock], [], [], timeout_s)[0]:
            return []
        try:
            data = self._sock.recv(_READ_BYTES)
        except BlockingIOError:
            return []
        except OSError:  # the recorder was killed
            data = b""
        self.ended = not data
        return list(self._take(self._rest + data))

    def decode(self, message: FeedMessage) -> Record | None:
        """What a message says; None if it is not netlab's or makes no sense."""
        number = message.channel.id
        if number not in self._decoders:
            self._decoders[number] = decoder_for(message.channel, message.schema.name)
        decoder = self._decoders[number]
        try:
            return None if decoder is None else decoder(message.log_ns, message.data)
        except (DecodeError, ValueError):
            return None

    def close(self) -> None:
        """Hang up."""
        self.ended = True
        self._sock.close()

    def _take(self, data: bytes) -> Iterator[FeedMessage]:
        end = 0
        for opcode, start, length in records_in(data):
            end = start + length
            if opcode == Opcode.MESSAGE:
                number, _, log_ns, _ = _MESSAGE.unpack_from(data, start)
                channel = self._channels[number]
                yield FeedMessage(channel, self._schemas[channel.schema_id], log_ns, data[start + _MESSAGE.size : end])
            else:
                self._take_other(opcode, ReadDataStream(io.BytesIO(data[start:end])))
        self._rest = data[end:]

    def _take_other(self, opcode: int, stream: ReadDataStream) -> None:
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self._channels[channel.id] = channel
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(stream)
            if metadata.name == METADATA_NAME:
                self.metadata = metadata.metadata
            elif metadata.name == LOST_NAME:
                self.lost = int(metadata.metadata["count"])


def follow(folder: registry.LabFolder, *, packets: bool = False) -> Feed:
    """Follow a running lab, also one in the background. ``packets``: with packets and the medium's verdicts.

    Raises:
        LabError: The lab is gone, records nothing, or its capture is finished.
    """
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    theirs.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    try:
        connection = ControlClient(folder.control_socket)
        try:
            connection.request({"do": "subscribe", "packets": packets}, [theirs.fileno()])
        finally:
            connection.close()
    except BaseException:
        ours.close()
        raise
    finally:
        theirs.close()
    return Feed(ours)


def follow_lab(name: str | None = None, *, packets: bool = False) -> Feed:
    """Follow the lab called ``name``, or the only one that is running.

    Raises:
        LabError: There is none, more than one fits, or it cannot be followed.
    """
    return follow(registry.find(name), packets=packets)
