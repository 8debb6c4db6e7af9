"""Reads a capture, whole or torn, in the order of time.

Reads what the file holds, not what a run should have written: any MCAP file opens, topics that are not netlab's are
left out of the records.
"""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from types import TracebackType

from google.protobuf.message import DecodeError
from mcap.records import Channel

from netlab.capture import scan as scanning
from netlab.capture.decoding import Decoder, decoder_for
from netlab.capture.records import Kind, Record, VerdictRecord, kind_of
from netlab.capture.sieve import Sieve
from netlab.errors import CaptureError

METADATA_NAME = "netlab.run"
LOSSES_NAME = "netlab.losses"
#: Told how many of how many parts of a file have been read.
OnRead = Callable[[int, int], None]
_BY_TIME = itemgetter(0)


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
        tally: Callable[[VerdictRecord, int], None] | None = None,
        with_inbound: bool = True,
    ) -> Iterator[Record]:
        """Yield records in the order of time.

        Args:
            kinds: Only these kinds; None for all.
            topics: Only these topics; None for all.
            nodes: Only topics of these nodes (verdicts have none); None for all.
            start_ns: From here on, CLOCK_REALTIME.
            end_ns: Up to before here.
            tally: Is told, in the end and in no order, of verdicts that differ in nothing but ``t_ns``, ``departs_ns``
                and ``crc32`` (then 0) and how many they were. No verdict is yielded then. For counting, far quicker.
            with_inbound: Without, packets that came in at their interface are left out.
        """
        wanted = self._decoders(kinds, topics, nodes)
        counted = self._decoders({Kind.VERDICT}, topics, nodes) if tally is not None else {}
        sieve = Sieve(counted, () if with_inbound else self._decoders({Kind.PACKET}, topics, nodes))
        for log_ns, number, data in self._messages({*wanted, *counted}, start_ns, end_ns, sieve):
            if (record := self._decoded(wanted[number], number, log_ns, data)) is not None:
                yield record
        for (number, shape), count in sieve.shapes.items():
            record = self._decoded(counted[number], number, 0, shape)
            if tally is not None and isinstance(record, VerdictRecord):
                tally(record, count)

    def counts(self) -> Counter[str]:
        """Messages per topic."""
        counted: Counter[str] = Counter()
        for _, number, _ in self._messages(set(self._scan.channels)):
            counted[self._scan.channels[number].topic] += 1
        return counted

    def _decoders(
        self, kinds: Collection[Kind] | None, topics: Collection[str] | None, nodes: Collection[str] | None
    ) -> dict[int, Decoder]:
        """Of the channels of these kinds, topics and nodes, by channel; None is all."""
        wanted = {}
        for number, channel in self._scan.channels.items():
            node = channel.topic.split("/")[1] if channel.topic.count("/") > 1 else ""
            chosen = (topics is None or channel.topic in topics) and (nodes is None or node in nodes)
            if chosen and (kinds is None or kind_of(channel.topic) in kinds):
                decoder = decoder_for(channel, self._topic(channel).schema)
                if decoder is not None:
                    wanted[number] = decoder
        return wanted

    def _decoded(self, decoder: Decoder, channel: int, log_ns: int, data: bytes) -> Record | None:
        try:
            return decoder(log_ns, data)
        except (DecodeError, ValueError):
            self._note(f"{self.path}: a message on {self._scan.channels[channel].topic} is damaged; left out")
            return None

    def _messages(
        self,
        numbers: set[int],
        start_ns: int = 0,
        end_ns: int = 1 << 64,
        sieve: Sieve | None = None,
    ) -> Iterator[scanning.Message]:
        """Merge chunks, which overlap in time, into one order."""
        pending: list[scanning.Message] = []
        places = sorted(self._scan.chunks, key=lambda place: place.start_ns)
        for number, place in enumerate(places):
            self._on_read(number, len(places))
            if place.end_ns < start_ns or place.start_ns >= end_ns or not _may_hold(place, numbers):
                continue
            done = bisect_left(pending, (place.start_ns,))
            yield from pending[:done]
            del pending[:done]
            found = scanning.messages_in(self._read(place), numbers)
            timely = (message for message in found if start_ns <= message[0] < end_ns)
            pending += sieve.sift(timely) if sieve is not None else timely
            pending.sort(key=_BY_TIME)  # stable: equal times keep the order of writing
        yield from pending

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
