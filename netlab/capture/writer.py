"""An MCAP file that is written at packet rates and survives full disks and crashes.

Records are laid out by the ``mcap`` library's record classes; only the message itself, of which there are tens of
thousands per second, is packed here. A finished chunk is compressed and written by one background thread (zstandard
and ``write`` both release the interpreter lock). Nothing is buffered behind a chunk: what was flushed is in the file.

After a failed write the file is cut back to its last whole record and nothing more is written but the summary,
so that what is on the disk stays readable. Source of the format: https://mcap.dev/spec.
"""

from __future__ import annotations

import queue
import struct
import threading
import zlib
from collections.abc import Hashable, Mapping
from pathlib import Path

import zstandard
from mcap.records import Attachment, Channel, Chunk, Header, Metadata
from mcap.records import Schema as SchemaRecord

from netlab.capture.record_file import MAGIC, RecordFile, record_bytes
from netlab.capture.schemas import Schema

_MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
_INDEX_ENTRY = struct.Struct("<QQ")
_MESSAGE_FIXED = _MESSAGE.size - 9  # what the record's length counts beside the data
_QUEUED_CHUNKS = 48  # bounds memory when the disk is slow; after that the rings fill and the kernel counts drops


class _ChunkInProgress:
    """Message records and their index, not yet compressed."""

    __slots__ = ("count", "end_ns", "index", "parts", "size_bytes", "start_ns")

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.size_bytes = 0
        self.count = 0
        self.start_ns = 1 << 63
        self.end_ns = 0
        self.index: dict[int, list[bytes]] = {}

    def append_record(self, record: bytes) -> None:
        self.parts.append(record)
        self.size_bytes += len(record)


class CaptureWriter:
    """Writes one MCAP file. Not for use from several threads; ``close`` must be called.

    Args:
        path: The file; created or overwritten.
        chunk_bytes: Uncompressed size after which a chunk is handed to the background thread.

    Raises:
        OSError: The file cannot be created.
    """

    def __init__(self, path: Path, *, chunk_bytes: int = 512 * 1024, level: int = 1) -> None:
        self._file = RecordFile(path)
        self._chunk_bytes = chunk_bytes
        self._compressor = zstandard.ZstdCompressor(level=level)
        self._chunk = _ChunkInProgress()
        self._schemas: dict[str, SchemaRecord] = {}
        self._channels: list[Channel] = []
        self._sequences: list[int] = [0]
        self._queue: queue.Queue[_ChunkInProgress | Attachment | Metadata | None] = queue.Queue(_QUEUED_CHUNKS)
        self._thread = threading.Thread(target=self._drain, name="capture-writer", daemon=True)
        self._file.append(MAGIC + record_bytes(Header("", "netlab")))
        self._thread.start()

    @property
    def error(self) -> str | None:
        """Why nothing more reaches the disk, or None. Set from the background thread, once."""
        return self._file.error

    @property
    def messages_written(self) -> int:
        """Messages in chunks that are wholly on disk."""
        return self._file.messages

    @property
    def messages_lost(self) -> int:
        """Messages that were accepted but never reached the disk."""
        return self._file.messages_lost

    def add_channel(self, topic: str, schema: Schema, metadata: Mapping[str, str]) -> int:
        """Declare a channel and return its number; call once per topic."""
        record = self._schemas.get(schema.name)
        if record is None:
            record = SchemaRecord(
                id=len(self._schemas) + 1, name=schema.name, encoding=schema.encoding, data=schema.data
            )
            self._schemas[schema.name] = record
            self._chunk.append_record(record_bytes(record))
        channel = Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=schema.message_encoding,
            schema_id=record.id,
            metadata=dict(metadata),
        )
        self._channels.append(channel)
        self._sequences.append(0)
        self._chunk.append_record(record_bytes(channel))
        return channel.id

    def add_message(self, channel: int, log_ns: int, publish_ns: int, head: bytes, body: bytes = b"") -> None:
        """Record ``head + body`` on a channel. Blocks only when the disk is ``_QUEUED_CHUNKS`` chunks behind."""
        chunk = self._chunk
        entry = _INDEX_ENTRY.pack(log_ns, chunk.size_bytes)
        entries = chunk.index.get(channel)
        if entries is None:
            chunk.index[channel] = [entry]
        else:
            entries.append(entry)
        sequence = self._sequences[channel]
        self._sequences[channel] = sequence + 1
        length = _MESSAGE_FIXED + len(head) + len(body)
        chunk.parts += (_MESSAGE.pack(5, length, channel, sequence & 0xFFFFFFFF, log_ns, publish_ns), head, body)
        chunk.size_bytes += length + 9
        chunk.count += 1
        if log_ns < chunk.start_ns:
            chunk.start_ns = log_ns
        if log_ns > chunk.end_ns:
            chunk.end_ns = log_ns
        if chunk.size_bytes >= self._chunk_bytes:
            self.flush()

    def keep(self, channel: int, key: Hashable, log_ns: int, data: bytes) -> None:
        """A file needs no memory."""

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Record a metadata record; readers take the last one of a name."""
        self._queue.put(Metadata(name=name, metadata=dict(values)))

    def add_attachment(self, name: str, media_type: str, data: bytes, *, log_ns: int) -> None:
        """Record a whole file."""
        self._queue.put(Attachment(create_time=log_ns, log_time=log_ns, name=name, media_type=media_type, data=data))

    def flush(self) -> None:
        """Hand the chunk in progress to the background thread, if it holds any message."""
        if self._chunk.count:
            self._queue.put(self._chunk)
            self._chunk = _ChunkInProgress()

    def close(self) -> None:
        """Write what is left and the summary. A file whose disk is full stays readable without it."""
        self.flush()
        self._queue.put(None)
        self._thread.join()
        self._file.finish(list(self._schemas.values()), self._channels)

    def _drain(self) -> None:
        while (item := self._queue.get()) is not None:
            if isinstance(item, _ChunkInProgress):
                self._write_chunk(item)
            elif isinstance(item, Metadata):
                self._file.append_metadata(item)
            else:
                self._file.append_attachment(item)

    def _write_chunk(self, chunk: _ChunkInProgress) -> None:
        if self._file.error:
            self._file.messages_lost += chunk.count
            return
        data = b"".join(chunk.parts)
        record = Chunk(
            compression="zstd",
            data=self._compressor.compress(data),
            message_start_time=chunk.start_ns,
            message_end_time=chunk.end_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        self._file.append_chunk(record, chunk.index, chunk.count)
