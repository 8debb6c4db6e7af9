from __future__ import annotations

import itertools
import os
import socket
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from netlab.capture.feeds import log_level, make_feed
from netlab.capture.messages import AddFeed, FeedKind
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, LogLine, Record, VerdictRecord
from netlab.capture.schemas import LogLevel
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.medium.verdicts import VERDICT_RECORD, Verdict

PORTS = [("a", "eth0"), ("b", "eth0")]


def record(kind: FeedKind, topic: str, pieces: Iterable[bytes]) -> tuple[list[Record], int]:
    """Feed ``pieces`` one read at a time; return what the file holds and how many lines were dropped."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "feed.mcap"
        writer = CaptureWriter(path)
        theirs, ours = socket.socketpair()
        feed = make_feed(AddFeed(kind, topic, "a", "daemon"), theirs.detach(), Topics(writer), PORTS)
        for piece in pieces:
            ours.sendall(piece)
            assert feed.drain()
        ours.close()
        assert not feed.drain()
        feed.close()
        writer.close()
        with Capture.open(path) as capture:
            return list(capture.records()), feed.dropped


def cut(data: bytes, places: Sequence[int]) -> list[bytes]:
    ends = sorted({place % (len(data) + 1) for place in places} | {0, len(data)})
    return [data[start:end] for start, end in itertools.pairwise(ends) if end > start]


PLACES = st.lists(st.integers(0, 10_000), max_size=6)


@settings(max_examples=40, deadline=None)
@given(PLACES, st.booleans())
def test_events_survive_any_cut_of_the_stream(places: list[int], newline_at_end: bool) -> None:
    lines = [b'{"t_ns": %d, "event": "peer_up", "peer": "b"}' % (1000 + number) for number in range(5)]
    data = b"\n".join(lines) + (b"\n" if newline_at_end else b"")
    records, dropped = record(FeedKind.EVENTS, "/a/udp_mesh/events", cut(data, places))
    assert dropped == 0
    assert [entry.t_ns for entry in records] == [1000, 1001, 1002, 1003, 1004]
    assert all(isinstance(entry, JsonRecord) and entry.node == "a" and entry.text("peer") == "b" for entry in records)


@settings(max_examples=40, deadline=None)
@given(PLACES, st.lists(st.sampled_from(Verdict), min_size=1, max_size=20))
def test_verdicts_survive_any_cut_of_the_stream(places: list[int], verdicts: list[Verdict]) -> None:
    data = b"".join(
        VERDICT_RECORD.pack(50 + i, 60 + i, 7, 100, 0, 1, verdict, 3, -62) for i, verdict in enumerate(verdicts)
    )
    records, dropped = record(FeedKind.VERDICTS, "/air/verdicts", cut(data, places))
    assert dropped == 0
    assert [entry.verdict for entry in records if isinstance(entry, VerdictRecord)] == verdicts
    first = records[0]
    assert isinstance(first, VerdictRecord)
    assert (first.sender, first.receiver, first.departs_ns, first.crc32) == (("a", "eth0"), ("b", "eth0"), 60, 7)
    assert (first.attempts, first.rssi_dbm) == (3, -62)


def test_an_unknown_port_is_still_recorded_and_a_torn_record_counted() -> None:
    data = VERDICT_RECORD.pack(1, 2, 3, 4, 0, 9, 1, 0, 0)
    (entry,), dropped = record(FeedKind.VERDICTS, "/air/verdicts", [data + data[:5]])
    assert isinstance(entry, VerdictRecord)
    assert entry.receiver == ("", "port9")
    assert (entry.attempts, entry.rssi_dbm) == (0, None)
    assert dropped == 1


@pytest.mark.parametrize("bad", [b"not json", b"[1, 2]", b"17", b'{"t_ns": 5', b"\xff\xfe", b"[" * 5000])
def test_lines_that_are_no_object_are_counted(bad: bytes) -> None:
    good = b'{"t_ns": 9, "event": "window"}\n'
    records, dropped = record(FeedKind.EVENTS, "/a/udp_mesh/events", [good + bad + b"\n\n" + good])
    assert len(records) == 2
    assert dropped == 1


@pytest.mark.parametrize("stamp", [b'"soon"', b"-5", b"1e30", b"null", b"99999999999999999999999"])
def test_an_event_without_a_usable_stamp_gets_the_time_of_reading(stamp: bytes) -> None:
    (entry,), dropped = record(FeedKind.EVENTS, "/a/x/events", [b'{"event": "odd", "t_ns": ' + stamp + b"}\n"])
    assert dropped == 0
    assert isinstance(entry, JsonRecord)
    assert entry.t_ns == entry.payload["t_ns"] > 1_700_000_000_000_000_000


def test_an_endless_line_is_dropped_not_kept_in_memory() -> None:
    pieces = [b"x" * 65536] * 20 + [b"\nhello\n"]
    records, dropped = record(FeedKind.LOG, "/a/log/daemon", pieces)
    assert dropped == 1
    assert [entry.message for entry in records if isinstance(entry, LogLine)][-1] == "hello"


def test_log_lines_keep_their_text_whatever_its_bytes() -> None:
    records, _ = record(FeedKind.LOG, "/a/log/daemon", [b"caf\xc3\xa9 \xff\r\n", b"ERROR: no route\nlast"])
    lines = [entry for entry in records if isinstance(entry, LogLine)]
    assert [line.message for line in lines] == ["café \\xff", "ERROR: no route", "last"]
    assert [line.level for line in lines] == [LogLevel.INFO, LogLevel.ERROR, LogLevel.INFO]
    assert {(line.node, line.process) for line in lines} == {("a", "daemon")}


def test_level_words_count_near_the_start_only() -> None:
    assert log_level("12:00:01 [WARN] low battery") is LogLevel.WARNING
    assert log_level("critical failure") is LogLevel.FATAL
    assert log_level("terror") is LogLevel.INFO
    assert log_level("x" * 80 + " ERROR") is LogLevel.INFO


def test_closing_a_feed_takes_what_is_still_in_the_pipe(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "late.mcap")
    theirs, ours = os.pipe()
    feed = make_feed(AddFeed(FeedKind.LOG, "/a/log/d", "a", "d"), theirs, Topics(writer), [])
    os.write(ours, b"one\ntwo\n")
    feed.close()  # the producer still holds its end
    os.close(ours)
    writer.close()
    with Capture.open(tmp_path / "late.mcap") as capture:
        assert [entry.message for entry in capture.records() if isinstance(entry, LogLine)] == ["one", "two"]
