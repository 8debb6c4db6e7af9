"""Where the recorder's messages go: into the file while one is open, and to whoever looks on.

Channels keep their numbers through all files of one recorder, so that a recording can end and another one begin while
producers go on. What is static (the map, the state of links, who is online) is kept, and stands first in each.
"""

from __future__ import annotations

import time
from collections.abc import Hashable, Mapping
from pathlib import Path

from netlab.capture.onlookers import Declaration, Onlooker, Onlookers
from netlab.capture.schemas import Schema
from netlab.capture.writer import CaptureWriter

_TIMELINE = "/timeline"


class Outlets:
    """One recorder's file and onlookers."""

    def __init__(self, onlookers: Onlookers) -> None:
        self._onlookers = onlookers
        self._channels: list[Declaration] = []
        self._kept: dict[tuple[int, Hashable], tuple[int, bytes]] = {}
        self._metadata: dict[str, Mapping[str, str]] = {}
        self._attachments: dict[str, bytes] = {}
        #: The file that is open.
        self.writer: CaptureWriter | None = None
        #: All files so far, for what became of them.
        self.files: list[CaptureWriter] = []

    def open(self, path: Path) -> None:
        """Begin a file, with what is known and static.

        Raises:
            OSError: It cannot be created.
        """
        writer = CaptureWriter(path)
        for name, values in self._metadata.items():
            writer.add_metadata(name, values)
        for name, data in self._attachments.items():
            writer.add_attachment(name, "application/octet-stream", data, log_ns=time.time_ns())
        for channel in self._channels:
            writer.add_channel(channel.topic, channel.schema, channel.metadata)
        for (number, _), (log_ns, data) in self._kept.items():
            if self._channels[number - 1].topic != _TIMELINE:  # acts belong to the file that saw them
                writer.add_message(number, log_ns, log_ns, data)
        self.writer = writer
        self.files.append(writer)

    def close(self) -> None:
        """Finish the file, if one is open."""
        writer, self.writer = self.writer, None
        if writer is not None:
            writer.close()

    def join(self, onlooker: Onlooker) -> None:
        """Let somebody look on from now; what is static comes first."""
        for name, values in self._metadata.items():
            onlooker.metadata(name, values)
        kept = sorted((log_ns, number, data) for (number, _), (log_ns, data) in self._kept.items())
        self._onlookers.join(onlooker, ((number, log_ns, data) for log_ns, number, data in kept))

    def add_channel(self, topic: str, schema: Schema, metadata: Mapping[str, str]) -> int:
        """Declare a channel and return its number; call once per topic."""
        channel = Declaration(len(self._channels) + 1, topic, schema, metadata)
        self._channels.append(channel)
        self._onlookers.declare(channel)
        if self.writer is not None:
            self.writer.add_channel(topic, schema, metadata)
        return channel.number

    def add_message(self, channel: int, log_ns: int, publish_ns: int, head: bytes, body: bytes = b"") -> None:
        """Record ``head + body`` on a channel, and show it."""
        if self.writer is not None:
            self.writer.add_message(channel, log_ns, publish_ns, head, body)
        if self._onlookers:
            self._onlookers.message(channel, log_ns, head + body if body else head)

    def keep(self, channel: int, key: Hashable, log_ns: int, data: bytes) -> None:
        """Remember a message as what stands for ``key`` on its channel from now on."""
        self._kept[channel, key] = (log_ns, data)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Record metadata; readers take the last record of a name."""
        self._metadata[name] = dict(values)
        if self.writer is not None:
            self.writer.add_metadata(name, values)
        self._onlookers.metadata(name, values)

    def add_attachment(self, name: str, data: bytes) -> None:
        """Have a whole file in this recording and in all later ones."""
        self._attachments[name] = data
        if self.writer is not None:
            self.writer.add_attachment(name, "application/octet-stream", data, log_ns=time.time_ns())
