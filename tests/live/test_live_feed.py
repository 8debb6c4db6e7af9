"""The live feed: what the recorder writes, seen by who looks on; without namespaces."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from netlab.capture.handle import Recorder
from netlab.capture.onlookers import Declaration, Onlooker
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, Kind
from netlab.capture.scene import Pose, map_message, poses_message
from netlab.capture.schemas import json_schema_for
from netlab.ipc import Channel
from netlab.live.feed import Feed

Follow = Callable[[], Feed]
T0_NS = 1_800_000_000_000_000_000


@pytest.fixture
def recorder(tmp_path: Path) -> Iterator[Recorder]:
    ours, theirs = Channel.pair()
    argv = [sys.executable, "-m", "netlab.capture.recorder", "--channel-fd", str(theirs.fileno())]
    process = subprocess.Popen(argv, pass_fds=[theirs.fileno()])
    theirs.close()
    handle = Recorder(ours)
    handle.open(str(tmp_path / "run.mcap"), {"name": "pair"}, {"scenario.yaml": b"name: pair\n"})
    try:
        yield handle
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        ours.close()


@pytest.fixture
def follow(recorder: Recorder) -> Iterator[Callable[[], Feed]]:
    feeds: list[Feed] = []

    def begin() -> Feed:
        ours, theirs = socket.socketpair()
        feeds.append(Feed(ours))
        recorder.subscribe(theirs.fileno(), packets=False)
        theirs.close()
        return feeds[-1]

    yield begin
    for feed in feeds:
        feed.close()


def link(state: str) -> dict[str, object]:
    return {"segment": "wire0", "from": "a", "to": "b", "state": state}


def json_records(path: Path, topic: str) -> list[dict[str, object]]:
    with Capture.open(path) as capture:
        return [record.payload for record in capture.records(topics={topic}) if isinstance(record, JsonRecord)]


def test_an_onlooker_sees_what_the_file_gets(recorder: Recorder, follow: Follow, tmp_path: Path) -> None:
    feed = follow()
    recorder.set_t0(T0_NS)
    recorder.message("/timeline", {"kind": "start", "at_s": 0.0, "label": "start"}, T0_NS)
    events, log = os.pipe(), os.pipe()
    recorder.add_feed("events", "/a/udp_mesh/events", "a", "udp_mesh", events[0])
    recorder.add_feed("log", "/a/log/udp_mesh", "a", "udp_mesh", log[0])
    os.write(events[1], b'{"t_ns": %d, "event": "peer_up", "peer": "b"}\n' % (T0_NS + 5))
    os.write(log[1], b"ready\n")
    for fd in (*events, *log):
        os.close(fd)
    recorder.close()
    seen = list(feed)
    assert feed.ended
    assert feed.metadata == {"name": "pair", "t0_ns": str(T0_NS)}
    assert feed.lost == 0
    with Capture.open(tmp_path / "run.mcap") as capture:
        assert sorted(map(str, seen)) == sorted(map(str, capture.records()))
    assert len(seen) == 3


def test_who_comes_late_gets_what_is_static(recorder: Recorder, follow: Follow) -> None:
    recorder.message("/map", map_message([]), T0_NS)
    recorder.message("/links", link("up"), T0_NS + 1)
    recorder.message("/links", link("outage"), T0_NS + 2)
    for number in range(3):
        recorder.message("/poses", poses_message([Pose("a", (0, 0, 0), 0.0, True)], number), T0_NS + 3 + number)
        recorder.message("/timeline", {"kind": "mark", "label": str(number)}, T0_NS + 3 + number)
    read, write = os.pipe()
    recorder.add_feed("events", "/a/udp_mesh/events", "a", "udp_mesh", read)
    for line in (b'{"event": "peer_up", "peer": "b"}', b'{"event": "window", "peer": "b"}'):
        os.write(write, line + b"\n")
    os.close(write)
    recorder.sync()
    feed = follow()
    recorder.close()
    seen = [record for record in feed if isinstance(record, JsonRecord)]
    by_kind = {kind: [record.payload for record in seen if record.kind is kind] for kind in Kind}
    assert len(by_kind[Kind.MAP]) == 1
    assert [row["state"] for row in by_kind[Kind.LINKS]] == ["outage"]
    assert [row["stamp_ns"] for row in by_kind[Kind.POSES]] == [T0_NS + 5]
    assert [row["label"] for row in by_kind[Kind.TIMELINE]] == ["0", "1", "2"]
    assert [row["event"] for row in by_kind[Kind.EVENT]] == ["peer_up"]


def test_an_onlooker_that_does_not_read_costs_the_file_nothing(
    recorder: Recorder, follow: Follow, tmp_path: Path
) -> None:
    feed = follow()
    text = "x" * 1000
    for number in range(20_000):
        recorder.message("/timeline", {"kind": "mark", "label": text, "number": number}, T0_NS + number)
    recorder.sync()
    recorder.message("/timeline", {"kind": "mark", "label": "last", "number": 20_000}, T0_NS + 20_000)
    seen: list[JsonRecord] = []
    while not seen or seen[-1].payload["number"] != 20_000:
        records = map(feed.decode, feed.receive(timeout_s=10.0))
        seen += [record for record in records if isinstance(record, JsonRecord)]
    assert feed.lost > 0
    assert feed.lost + len(seen) == 20_001  # nothing vanishes uncounted
    stats = recorder.close()
    assert (stats.messages, stats.messages_lost) == (20_001, 0)


def test_one_that_hangs_up_is_forgotten(recorder: Recorder, follow: Follow) -> None:
    follow().close()
    other = follow()
    for number in range(100):
        recorder.message("/timeline", {"kind": "mark", "number": number}, T0_NS + number)
    assert recorder.close().messages == 100
    assert len(list(other)) == 100


def test_the_oldest_messages_go_first() -> None:
    ours, theirs = socket.socketpair()
    onlooker = Onlooker(theirs, packets=False, waiting_bytes=10_000)
    for number in range(1000):
        onlooker.message(1, number, b'{"event": "mark", "number": %d}' % number)
    feed = Feed(ours)
    channels = [Declaration(1, "/timeline", json_schema_for("/timeline"), {})]
    assert onlooker.send(channels)
    numbers = [message.log_ns for message in feed.receive(timeout_s=5.0)]
    assert numbers == list(range(onlooker.lost, 1000))
    assert feed.lost == onlooker.lost > 0
    feed.close()
    onlooker.close()


def test_packets_come_only_if_wanted() -> None:
    a, b = socket.socketpair()
    with a, b:
        assert not Onlooker(a, packets=False).wants("/robot1/eth0/packets")
        assert not Onlooker(a, packets=False).wants("/air/verdicts")
        assert Onlooker(b, packets=True).wants("/air/verdicts")
        assert Onlooker(b, packets=False).wants("/links")


def test_a_recording_ends_and_another_one_begins(recorder: Recorder, follow: Follow, tmp_path: Path) -> None:
    feed = follow()
    recorder.message("/map", map_message([]), T0_NS)
    recorder.message("/timeline", {"kind": "mark", "label": "in the first"}, T0_NS + 1)
    recorder.close_file()
    recorder.message("/timeline", {"kind": "mark", "label": "in none"}, T0_NS + 2)
    recorder.open_file(str(tmp_path / "second.mcap"))
    recorder.message("/timeline", {"kind": "mark", "label": "in the second"}, T0_NS + 3)
    recorder.close()
    labels = {
        name: [row["label"] for row in json_records(tmp_path / name, "/timeline")]
        for name in ("run.mcap", "second.mcap")
    }
    assert labels == {"run.mcap": ["in the first"], "second.mcap": ["in the second"]}
    assert len(json_records(tmp_path / "second.mcap", "/map")) == 1  # static, so it stands in each
    with Capture.open(tmp_path / "second.mcap") as capture:
        assert not capture.notes
        assert capture.metadata == {"name": "pair"}
        assert capture.attachments == {"scenario.yaml": b"name: pair\n"}
    seen = [record.text("label") for record in feed if isinstance(record, JsonRecord) and record.kind is Kind.TIMELINE]
    assert seen == ["in the first", "in none", "in the second"]
