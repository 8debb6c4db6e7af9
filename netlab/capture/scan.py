"""Finds the whole records of an MCAP file without its summary, so that torn files read like sound ones.

Owns the file's outer structure; the messages inside chunks are bytes here.
"""

from __future__ import annotations

import io
import os
import struct
import zlib
from collections.abc import Container, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Metadata, Schema

from netlab.capture.record_file import MAGIC
from netlab.errors import CaptureError

_HEAD = struct.Struct("<BQ")
_MESSAGE_HEAD = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_MESSAGE = int(Opcode.MESSAGE)
_CHUNK = struct.Struct("<QQQI")  # start, end, uncompressed size, uncompressed crc
_INDEX_CHANNEL = struct.Struct("<H")
_MAX_UNCOMPRESSED = 1 << 30
_DAMAGE = (McapError, struct.error, UnicodeDecodeError, zstandard.ZstdError, MemoryError, OverflowError)


#: Log time in ns, channel, content.
Message = tuple[int, int, bytes]


@dataclass(slots=True)
class ChunkPlace:
    """Where a chunk's data lies. ``channels`` is None when no index says which channels it holds."""

    start_ns: int
    end_ns: int
    size_bytes: int
    crc32: int
    compression: str
    data_offset: int
    data_length: int
    channels: set[int] | None = None


@dataclass(slots=True)
class Scan:
    """All that a file holds outside its chunks; ``note`` says how it is damaged, None if it is sound."""

    chunks: list[ChunkPlace] = field(default_factory=list)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    note: str | None = None


def scan(file: BinaryIO, path: Path) -> Scan:
    """Read a file's outer structure up to its end or its first torn record.

    Raises:
        CaptureError: It is no MCAP file.
    """
    size = os.fstat(file.fileno()).st_size
    if file.read(len(MAGIC)) != MAGIC:
        raise CaptureError(f"{path}: {'is empty' if size == 0 else 'is not an MCAP file'}")
    found, offset, finished = Scan(), len(MAGIC), False
    while not finished:
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            break
        opcode, length = _HEAD.unpack(head)
        if offset + _HEAD.size + length > size:
            break
        finished = opcode == Opcode.FOOTER
        try:
            _take(found, file, opcode, offset + _HEAD.size, length)
        except _DAMAGE as error:
            found.note = f"damaged at byte {offset} ({error}); read up to there"
            return found
        offset += _HEAD.size + length
        file.seek(offset)
    if not finished:
        found.note = f"cut off at byte {offset} of {size}: never finished; read up to its last whole chunk"
    return found


def _take(found: Scan, file: BinaryIO, opcode: int, offset: int, length: int) -> None:
    if opcode == Opcode.CHUNK:
        found.chunks.append(_chunk_place(file, offset, length))
    elif opcode == Opcode.MESSAGE_INDEX and found.chunks:
        place = found.chunks[-1]
        place.channels = (place.channels or set()) | {_INDEX_CHANNEL.unpack(file.read(_INDEX_CHANNEL.size))[0]}
    elif opcode in (Opcode.METADATA, Opcode.ATTACHMENT, Opcode.CHANNEL, Opcode.SCHEMA):
        _take_small(found, opcode, ReadDataStream(io.BytesIO(file.read(length))))


def _take_small(found: Scan, opcode: int, stream: ReadDataStream) -> None:
    if opcode == Opcode.METADATA:
        metadata = Metadata.read(stream)
        found.metadata[metadata.name] = metadata.metadata
    elif opcode == Opcode.ATTACHMENT:
        attachment = Attachment.read(stream)
        found.attachments[attachment.name] = attachment.data
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(stream)
        found.channels[channel.id] = channel
    else:
        schema = Schema.read(stream)
        found.schemas[schema.id] = schema


def _chunk_place(file: BinaryIO, offset: int, length: int) -> ChunkPlace:
    start_ns, end_ns, size_bytes, crc32 = _CHUNK.unpack(file.read(_CHUNK.size))
    name = file.read(struct.unpack("<I", file.read(4))[0])
    data_length = struct.unpack("<Q", file.read(8))[0]
    data_offset = offset + _CHUNK.size + 4 + len(name) + 8
    if data_offset + data_length != offset + length:
        raise struct.error("a chunk's lengths disagree")
    return ChunkPlace(start_ns, end_ns, size_bytes, crc32, name.decode(), data_offset, data_length)


def read_chunk(file: BinaryIO, place: ChunkPlace) -> bytes:
    """Return a chunk's records, decompressed and checked.

    Raises:
        CaptureError: The chunk is damaged or compressed in a way that we do not know.
    """
    file.seek(place.data_offset)
    data = file.read(place.data_length)
    where = f"chunk at byte {place.data_offset}"
    if place.size_bytes > _MAX_UNCOMPRESSED:
        raise CaptureError(f"{where}: {place.size_bytes} bytes uncompressed is beyond reason")
    if place.compression == "zstd":
        try:
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=place.size_bytes)
        except zstandard.ZstdError as error:
            raise CaptureError(f"{where}: {error}") from None
    elif place.compression:
        raise CaptureError(f"{where}: compression {place.compression!r} is not available yet; zstd and none are")
    if place.crc32 and zlib.crc32(data) != place.crc32:
        raise CaptureError(f"{where}: checksum differs")
    return data


def records_in(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, start, length) of every whole record in a chunk's data."""
    offset, size = 0, len(data)
    while offset + _HEAD.size <= size:
        opcode, length = _HEAD.unpack_from(data, offset)
        offset += _HEAD.size
        if offset + length > size:
            return
        yield opcode, offset, length
        offset += length


def messages_in(data: bytes, channels: Container[int]) -> Iterator[Message]:
    """Yield the messages of some channels in a chunk's data, in the order of writing."""
    head_bytes, start, size = _MESSAGE_HEAD.size, 0, len(data)
    while start + head_bytes <= size:
        opcode, length, channel, _, log_ns, _ = _MESSAGE_HEAD.unpack_from(data, start)
        end = start + _HEAD.size + length
        if end > size:
            return
        if opcode == _MESSAGE and channel in channels:
            yield log_ns, channel, data[start + head_bytes : end]
        start = end


def declare(found: Scan, data: bytes) -> None:
    """Take a chunk's schemas and channels into ``found``."""
    for opcode, start, length in records_in(data):
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            _take_small(found, opcode, ReadDataStream(io.BytesIO(data[start : start + length])))
