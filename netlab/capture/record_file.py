"""The bytes of an MCAP file: whole records only, cut back when one did not fit, and the summary at its end.

Owns the file descriptor and the offsets; knows nothing of threads and of what the messages mean.
Source of the format: https://mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

MAGIC = b"\x89MCAP0\r\n"


class RecordFile:
    """The file itself: whole records only, cut back when one did not fit, and the summary at its end."""

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o644)
        self._path = path
        self._offset = 0
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._counts: dict[int, int] = {}
        self.error: str | None = None
        self.messages = 0
        self.messages_lost = 0

    def append(self, data: bytes) -> bool:
        """Write ``data`` wholly, or not at all and remember why."""
        if self.error:
            return False
        try:
            self._write(data)
        except OSError as error:
            self.error = f"{self._path}: {error.strerror}; nothing more is captured, the run goes on"
            return False
        return True

    def append_chunk(self, chunk: Chunk, index: dict[int, list[bytes]], count: int) -> None:
        """Write a chunk with its message index."""
        start, body = self._offset, record_bytes(chunk)
        offsets, indexes, position = {}, [], start + len(body)
        for channel, entries in index.items():
            offsets[channel] = position
            data = b"".join(entries)
            part = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, len(data) + 6, channel, len(data)) + data
            indexes.append(part)
            position += len(part)
        if not self.append(body + b"".join(indexes)):
            self.messages_lost += count
            return
        self.messages += count
        for channel, entries in index.items():
            self._counts[channel] = self._counts.get(channel, 0) + len(entries)
        self._chunks.append(
            ChunkIndex(
                chunk_length=len(body),
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=position - start - len(body),
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def append_metadata(self, record: Metadata) -> None:
        """Write a metadata record."""
        start, body = self._offset, record_bytes(record)
        if self.append(body):
            self._metadata.append(MetadataIndex(offset=start, length=len(body), name=record.name))

    def append_attachment(self, record: Attachment) -> None:
        """Write an attachment."""
        start, body = self._offset, record_bytes(record)
        if self.append(body):
            self._attachments.append(
                AttachmentIndex(
                    offset=start,
                    length=len(body),
                    create_time=record.create_time,
                    log_time=record.log_time,
                    data_size=len(record.data),
                    name=record.name,
                    media_type=record.media_type,
                )
            )

    def finish(self, schemas: list[Schema], channels: list[Channel]) -> None:
        """Write the summary and close. A cut-back chunk left room for it more often than not: try even then."""
        error, self.error = self.error, None
        # Channels that no chunk on disk declares still belong into the summary: readers list them with no messages.
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*schemas]),
            (Opcode.CHANNEL, [*channels]),
            (Opcode.STATISTICS, [self._statistics(len(schemas), len(channels))]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachments]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        self.append(_summary(self._offset, groups))
        self.error = error or self.error
        os.close(self._fd)

    def _statistics(self, schema_count: int, channel_count: int) -> Statistics:
        return Statistics(
            attachment_count=len(self._attachments),
            channel_count=channel_count,
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=self.messages,
            message_end_time=max((chunk.message_end_time for chunk in self._chunks), default=0),
            message_start_time=min((chunk.message_start_time for chunk in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=schema_count,
        )

    def _write(self, data: bytes) -> None:
        view, written = memoryview(data), 0
        try:
            while written < len(view):
                written += os.write(self._fd, view[written:])
        except OSError:
            os.ftruncate(self._fd, self._offset)
            os.lseek(self._fd, self._offset, os.SEEK_SET)
            raise
        self._offset += written


def record_bytes(record: McapRecord) -> bytes:
    """Lay out one record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # the library leaves it unannotated
    return data


def _summary(offset: int, groups: list[tuple[Opcode, list[McapRecord]]]) -> bytes:
    """Lay out everything from the data end to the closing magic, for a file of ``offset`` bytes."""
    data_end = record_bytes(DataEnd(0))
    start = position = offset + len(data_end)
    parts, offsets = [], []
    for opcode, records in groups:
        body = b"".join(record_bytes(record) for record in records)
        if body:
            parts.append(body)
            offsets.append(
                record_bytes(SummaryOffset(group_opcode=opcode, group_start=position, group_length=len(body)))
            )
            position += len(body)
    summary = b"".join(parts + offsets)
    # The checksum covers the summary and the footer up to the checksum itself.
    footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, start, position)
    footer = Footer(summary_start=start, summary_offset_start=position, summary_crc=zlib.crc32(summary + footer_head))
    return data_end + summary + record_bytes(footer) + MAGIC
