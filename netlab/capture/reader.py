"""Reads a capture, whole or torn, in the order of time.

Reads what the file holds, not what a run should have written: any MCAP file opens, topics that are not netlab's are
left out of the records.
"""

from __future__ import annotations

import struct
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from google.protobuf.message import DecodeError
from mcap.opcode import Opcode
from mcap.records import Channel

from netlab.capture import scan as scanning
from netlab.capture.decoding import Decoder, decoder_for
from netlab.capture.records import Kind, Record, kind_of
from netlab.errors import CaptureError

METADATA_NAME = "netlab.run"
LOSSES_NAME = "netlab.losses"
#: Told how many of how many parts of a file have been read.
OnRead = Callable[[int, int], None]
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time


@dataclass(frozen=True, slots=True)
class Topic:
    """One channel of the file. ``node``, ``interface`` or ``process`` are empty where they do not apply."""

    name: str
    kind: Kind
    schema: str
    metadata: dict[str, str]


class Capture:
    """An open capture; a context manager.

    Attributes:
        path: The file.
        metadata: The record ``netlab.run``: scenario text, seed, versions, engine, ``t0_ns``...; empty if missing.
        losses: How many messages the recorder had to leave out, by topic; None if it did not come to say so.
        attachments: File name to content.
        notes: What is wrong with the file, for a person; grows as damaged chunks are met.
    """

    def __init__(self, path: Path, on_read: OnRead = lambda done, total: None) -> None:
        """Open a file; see :meth:`open`."""
        self.path = path
        self._on_read = on_read
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise CaptureError(f"{path}: {error.strerror}") from None
        try:
            self._scan = scanning.scan(self._file, path)
            self.notes: list[str] = [f"{path}: {self._scan.note}"] if self._scan.note else []
            self._declare_all()
        except BaseException:
            self._file.close()
            raise
        self.metadata: dict[str, str] = self._scan.metadata.get(METADATA_NAME, {})
        lacking = self._scan.metadata.get(LOSSES_NAME)
        self.losses = None if lacking is None else {topic: int(count) for topic, count in lacking.items()}
        self.attachments: dict[str, bytes] = self._scan.attachments

    @classmethod
    def open(cls, path: Path | str, on_read: OnRead = lambda done, total: None) -> Capture:
        """Open a capture. ``on_read`` hears how far a reading of :meth:`records` has come.

        Raises:
            CaptureError: There is no such file, or it is no MCAP file. A torn file opens, with a note.
        """
        return cls(Path(path), on_read)

    def __enter__(self) -> Capture:
        """Return itself."""
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: BaseException | None, _trace: TracebackType | None
    ) -> None:
        """Close the file."""
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def t0_ns(self) -> int:
        """Scenario time zero; without one (a run that never became ready) the first record's time."""
        text = self.metadata.get("t0_ns", "")
        if text.isdigit():
            return int(text)
        return self.start_ns

    @property
    def start_ns(self) -> int:
        """Time of the first record."""
        return min((chunk.start_ns for chunk in self._scan.chunks), default=0)

    @property
    def end_ns(self) -> int:
        """Time of the last record."""
        return max((chunk.end_ns for chunk in self._scan.chunks), default=0)

    @property
    def topics(self) -> list[Topic]:
        """All channels, sorted by name."""
        topics = [self._topic(channel) for channel in self._scan.channels.values()]
        return sorted(topics, key=lambda topic: topic.name)

    def records(
        self,
        kinds: Collection[Kind] | None = None,
        *,
        topics: Collection[str] | None = None,
        nodes: Collection[str] | None = None,
        start_ns: int = 0,
        end_ns: int = 1 << 64,
    ) -> Iterator[Record]:
        """Yield records in the order of time.

        Args:
            kinds: Only these kinds; None for all.
            topics: Only these topics; None for all.
            nodes: Only topics of these nodes (verdicts have none); None for all.
            start_ns: From here on, CLOCK_REALTIME.
            end_ns: Up to before here.
        """
        wanted: dict[int, Decoder] = {}
        for number, channel in self._scan.channels.items():
            node = channel.topic.split("/")[1] if channel.topic.count("/") > 1 else ""
            chosen = (topics is None or channel.topic in topics) and (nodes is None or node in nodes)
            kind = kind_of(channel.topic)
            if (
                chosen
                and (kinds is None or kind in kinds)
                and (decoder := decoder_for(channel, self._topic(channel).schema))
            ):
                wanted[number] = decoder
        for number, log_ns, data in self._messages(set(wanted), start_ns, end_ns):
            try:
                yield wanted[number](log_ns, data)
            except (DecodeError, ValueError):
                self._note(f"{self.path}: a message on {self._scan.channels[number].topic} is damaged; left out")

    def counts(self) -> Counter[str]:
        """Messages per topic."""
        counted: Counter[str] = Counter()
        for number, _, _ in self._messages(set(self._scan.channels), 0, 1 << 64):
            counted[self._scan.channels[number].topic] += 1
        return counted

    def _messages(self, numbers: set[int], start_ns: int, end_ns: int) -> Iterator[tuple[int, int, bytes]]:
        """Merge chunks, which overlap in time, into one order: (channel, time, data)."""
        pending: list[tuple[int, int, int, bytes]] = []
        serial = 0  # keeps the order of writing among equal times
        places = sorted(self._scan.chunks, key=lambda place: place.start_ns)
        for number, place in enumerate(places):
            self._on_read(number, len(places))
            if place.end_ns < start_ns or place.start_ns >= end_ns or not _may_hold(place, numbers):
                continue
            done = bisect_left(pending, (place.start_ns,))
            for log_ns, _, number, data in pending[:done]:
                yield number, log_ns, data
            del pending[:done]
            for number, log_ns, data in self._chunk_messages(place):
                if number in numbers and start_ns <= log_ns < end_ns:
                    pending.append((log_ns, serial, number, data))
                    serial += 1
            pending.sort()
        for log_ns, _, number, data in pending:
            yield number, log_ns, data

    def _chunk_messages(self, place: scanning.ChunkPlace) -> Iterator[tuple[int, int, bytes]]:
        data = self._read(place)
        for opcode, start, length in scanning.records_in(data):
            if opcode == Opcode.MESSAGE:
                number, _, log_ns, _ = _MESSAGE.unpack_from(data, start)
                yield number, log_ns, data[start + _MESSAGE.size : start + length]

    def _declare_all(self) -> None:
        """A sound file repeats its channels in the summary; a torn one has them in its chunks only."""
        if self._scan.note is not None or not self._scan.channels:
            for place in self._scan.chunks:
                scanning.declare(self._scan, self._read(place))

    def _read(self, place: scanning.ChunkPlace) -> bytes:
        try:
            return scanning.read_chunk(self._file, place)
        except CaptureError as error:
            self._note(f"{self.path}: {error}; skipped")
            return b""

    def _note(self, text: str) -> None:
        if text not in self.notes:
            self.notes.append(text)

    def _topic(self, channel: Channel) -> Topic:
        schema = self._scan.schemas.get(channel.schema_id)
        return Topic(channel.topic, kind_of(channel.topic), schema.name if schema else "", channel.metadata)


def _may_hold(place: scanning.ChunkPlace, numbers: set[int]) -> bool:
    return place.channels is None or not place.channels.isdisjoint(numbers)
